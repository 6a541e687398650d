//! What was found, for people to look at: the lane drawn into pictures, and how the car weaved along it.

use std::path::Path;

use super::{LocateError, LocatedRecording, On, Part, network::ByNetwork, pictures::decoded};
use lapwing_core::{perception::Frame, recording::Recording, words};
use lapwing_score::drawing::{
    Colour, LINE_PX, MARGIN, Point, Shape, Sheet,
    chart::{Axis, Chart, Marks, Series, stack},
};
use lapwing_sim::{
    camera::Scenery,
    locate::{Located, Overlay},
};

/// Pictures on a sheet, at most, and how many side by side.
const PICTURES: usize = 40;
const ACROSS: usize = 4;
/// Rows of a picture below this show the bonnet.
const BONNET: f64 = 132.0;
/// The road's edges, the lane's middle, the line that the car would take straight on.
const EDGE: Colour = [255, 0, 255];
const LANE: Colour = [0, 230, 255];
/// What a network sees.
const NETWORK: Colour = [120, 120, 120];
/// What is drawn from the bottom up.
const OFFSET: &str = "metres right of the lane's middle";

/// Pictures from all over a recording, with the road's edges and the lane's middle drawn in where they were found.
///
/// # Errors
/// [`LocateError::Recording`]
pub fn frames(path: &Path, found: &LocatedRecording) -> Result<Sheet, LocateError> {
    let every = found.rows.len().div_ceil(PICTURES).max(1);
    let (mut shapes, mut frame, mut shown) = (vec![], Frame::default(), 0);
    let mut overlays: Vec<Option<Overlay>> = found.parts.iter().map(|_| None).collect();
    let moments = Recording::open(path)?.seen();
    let (mut width, mut height) = (320.0, 160.0);
    for (i, moment) in moments.enumerate().step_by(every) {
        let moment = moment?;
        if decoded(moment.pictures[0].as_ref(), &mut frame).is_err() {
            continue;
        }
        (width, height) = (frame.width() as f64, frame.height() as f64);
        let (column, row) = ((shown % ACROSS) as f64, (shown / ACROSS) as f64);
        let at = (MARGIN + column * (width + MARGIN), MARGIN + LINE_PX + row * (height + MARGIN + LINE_PX));
        shown += 1;
        shapes.push(Shape::Picture { at, frame: frame.clone() });
        let part = found.parts.iter().zip(&mut overlays).find(|(part, _)| part.rows.contains(&i));
        let place = part.and_then(|(part, overlay)| Some((part.on.as_ref()?, i - part.rows.start, overlay)));
        let place = place.and_then(|(on, i, overlay)| Some((on, on.drive.places.get(i).copied().flatten()?, overlay)));
        let told = match place {
            None => format!("moment {}: not seen", moment.row),
            Some((on, located, overlay)) => {
                let overlay = overlay.get_or_insert_with(|| {
                    Overlay::new(on.drive.track.clone(), Scenery::new(&on.drive.track).into(), super::SIZE)
                });
                draw(on, &located, overlay, at, &mut shapes);
                let lane = located.pose.in_lane(&on.drive.track);
                let s_m = located.pose.s_m.rem_euclid(on.drive.track.length());
                let degrees = lane.heading_rad.to_degrees();
                format!("moment {}: {s_m:.0} m, {:+.2} m, {degrees:+.1} deg", moment.row, lane.offset_m)
            }
        };
        shapes.push(Shape::text((at.0, at.1 - LINE_PX / 2.0), 0.0, told));
    }
    let rows = shown.div_ceil(ACROSS) as f64;
    Ok(Sheet {
        width: MARGIN + ACROSS as f64 * (width + MARGIN),
        height: MARGIN + rows * (height + MARGIN + LINE_PX),
        title: format!("Where the lane is: {}", path.display()),
        shapes,
    })
}

fn draw(on: &On, located: &Located, overlay: &Overlay, at: Point, shapes: &mut Vec<Shape>) {
    let half = on.drive.track.half_width();
    let lane_m = located.pose.direction() * on.drive.track.file().driving_line_m;
    for (offset_m, colour) in [(-half, EDGE), (half, EDGE), (lane_m, LANE)] {
        let within = |(x, y): &Point| (0.0..super::SIZE.0 as f64).contains(x) && (0.0..BONNET).contains(y);
        let line = overlay.line(located.pose, offset_m);
        for piece in line.split(|point| !within(point)).filter(|piece| piece.len() > 1) {
            let points = piece.iter().map(|(x, y)| (at.0 + x, at.1 + y)).collect();
            shapes.push(Shape::Line { points, colour, width: 1.0 });
        }
    }
}

/// How far from the lane's middle the car was along the road, lap by lap: a chart for each drive on a known road. A drive on
/// an unknown one has a chart of what a network sees from moment to moment, if one was asked.
pub fn weaving(found: &LocatedRecording) -> Sheet {
    let charts = found.parts.iter().filter_map(|part| match (&part.on, &found.network) {
        (Some(on), network) => Some(chart(on, part, network.as_ref())),
        (None, Some(network)) => Some(moments(found, part, network)),
        (None, None) => None,
    });
    stack(&charts.collect::<Vec<_>>(), 1200, 420)
}

/// What a network sees from moment to moment.
fn moments(found: &LocatedRecording, part: &Part, network: &ByNetwork) -> Chart {
    let seen = part.rows.clone().map(|i| {
        let offset_m = network.sure(i).map_or(f64::NAN, |lane| lane.offset_m);
        (found.rows[i].moment as f64, offset_m)
    });
    let x = Axis::new("moment");
    let series = vec![Series::new("a network", Marks::Line(seen.collect()))];
    Chart { series, ..Chart::new("How the car weaved on no known road", x, Axis::new(OFFSET)) }
}

fn chart(on: &On, part: &Part, network: Option<&ByNetwork>) -> Chart {
    let (track, length_m) = (&on.drive.track, on.drive.track.length());
    let mut laps: Vec<Vec<Point>> = vec![vec![]];
    let mut last = None;
    for located in &on.drive.places {
        let point =
            located.map(|located| (located.pose.s_m.rem_euclid(length_m), located.pose.in_lane(track).offset_m));
        let around =
            last.zip(point).is_some_and(|(before, (s_m, _)): (f64, Point)| (before - s_m).abs() > length_m / 2.0);
        if around {
            laps.push(vec![]);
        }
        last = point.map(|(s_m, _)| s_m).or(last);
        if let Some(lap) = laps.last_mut() {
            lap.push(point.unwrap_or((f64::NAN, f64::NAN)));
        }
    }
    let (left, right) =
        (-track.half_width() - track.file().driving_line_m, track.half_width() - track.file().driving_line_m);
    let name = |i: usize| if laps.len() > 1 { format!("lap {}", i + 1) } else { String::new() };
    let lines = laps.iter().enumerate().map(|(i, lap)| Series::new(name(i), Marks::Line(lap.clone())));
    let mut series: Vec<_> = lines.collect();
    if let Some(network) = network {
        let point = |(i, located): (usize, &Option<Located>)| {
            Some((located.as_ref()?.pose.s_m.rem_euclid(length_m), network.sure(part.rows.start + i)?.offset_m))
        };
        let points = on.drive.places.iter().enumerate().filter_map(point).collect();
        series.push(Series { colour: Some(NETWORK), ..Series::new("a network", Marks::Points(points)) });
    }
    for (name, edge) in [("the road's edges", left), ("", right)] {
        series
            .push(Series { colour: Some(EDGE), ..Series::new(name, Marks::Line(vec![(0.0, edge), (length_m, edge)])) });
    }
    let x = Axis::new("metres along the road").from_to(0.0, length_m);
    let y = Axis::new(OFFSET);
    Chart { series, ..Chart::new(format!("How the car weaved: {}", words::road(on.road(), on.reversed)), x, y) }
}
