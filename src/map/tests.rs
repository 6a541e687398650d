use std::{collections::BTreeSet, fs};

use lapwing_sim::track::{Edge, RandomTrack, Side, Stretch};

use super::*;

fn lap(track: &Track, speed_mph: impl Fn(f64) -> f64) -> Vec<DrivenPoint> {
    let steps = 1000;
    let s = |i: u32| track.length() * f64::from(i) / f64::from(steps);
    (0..steps).map(|i| DrivenPoint { position: track.point(s(i), 0.5), speed_mph: speed_mph(s(i)) }).collect()
}

fn with_stretches(stretches: Vec<Stretch>) -> Track {
    let mut file = Track::named("lake").unwrap().file().clone();
    file.stretches = stretches;
    Track::new(file).unwrap()
}

fn texts(sheet: &Sheet) -> Vec<&str> {
    let text = |shape: &'_ Shape| matches!(shape, Shape::Text { .. });
    sheet
        .shapes
        .iter()
        .filter(|s| text(s))
        .map(|s| if let Shape::Text { text, .. } = s { &**text } else { "" })
        .collect()
}

fn length_of(points: &[Point]) -> f64 {
    points.windows(2).map(|p| (p[1].0 - p[0].0).hypot(p[1].1 - p[0].1)).sum()
}

/// Pixels of lines in that colour.
fn drawn(sheet: &Sheet, wanted: Colour) -> f64 {
    sheet
        .shapes
        .iter()
        .map(|s| {
            if let Shape::Line { points, colour, .. } = s
                && *colour == wanted
            {
                length_of(points)
            } else {
                0.0
            }
        })
        .sum()
}

#[test]
fn everything_lies_on_the_sheet() {
    for name in Track::NAMES {
        let track = Track::named(name).unwrap();
        let mut line = lap(&track, |_| 20.0);
        line.push(DrivenPoint { position: track.point(200.0, 60.0), speed_mph: 5.0 }); // far off
        let marks = [Mark { position: track.point(500.0, -40.0), kind: MarkKind::Crash }];
        for width in [400.0, 1200.0] {
            let sheet = sheet(&track, &line, &marks, width);
            assert!(sheet.width == width && sheet.height > 100.0 && sheet.height < 2.0 * width, "{}", sheet.height);
            for shape in &sheet.shapes {
                let points = match shape {
                    Shape::Area { points, .. } | Shape::Line { points, .. } => points.clone(),
                    Shape::Text { at, text } => vec![*at, (at.0 + text.len() as f64 * LETTER, at.1)],
                    Shape::Picture { at, .. } => vec![*at],
                };
                for (x, y) in points {
                    assert!((0.0..=sheet.width).contains(&x) && (0.0..=sheet.height).contains(&y), "{name}: {shape:?}");
                }
            }
        }
    }
}

#[test]
fn the_scale_bar_is_as_long_as_it_says() {
    let track = Track::named("lake").unwrap();
    let sheet = sheet(&track, &lap(&track, |_| 20.0), &[], 1200.0);
    let of_speed: f64 = (0..LEVELS).map(|level| drawn(&sheet, speed_colour(level))).sum();
    let px_per_m = of_speed / track.length();
    let bar = sheet.shapes.iter().rev().find_map(|s| match s {
        Shape::Line { points, colour: INK, .. } if length_of(points) > 20.0 => Some(length_of(points)),
        _ => None,
    });
    assert!(texts(&sheet).contains(&"100 m"));
    assert!((bar.unwrap() / px_per_m - 100.0).abs() < 1.0, "{bar:?} at {px_per_m} pixels a metre");
}

#[test]
fn the_line_is_coloured_by_speed_and_not_drawn_where_the_car_was_put() {
    let track = Track::named("lake").unwrap();
    let slow_half = |s: f64| if s < track.length() / 2.0 { 0.0 } else { 30.0 };
    let mut line = lap(&track, slow_half);
    let whole = sheet(&track, &line, &[], 1200.0);
    let (slow, fast) = (drawn(&whole, speed_colour(0)), drawn(&whole, speed_colour(LEVELS - 1)));
    assert!((slow / fast - 1.0).abs() < 0.01, "{slow} slow, {fast} fast");
    line.drain(600..900);
    let cut = sheet(&track, &line, &[], 1200.0);
    assert!((drawn(&cut, speed_colour(LEVELS - 1)) / fast - 0.4).abs() < 0.02);
    assert!(texts(&whole).contains(&"30 mph"));
    assert!(texts(&sheet(&track, &lap(&track, |_| 31.0), &[], 1200.0)).contains(&"40 mph"));
    assert!(!texts(&sheet(&track, &[], &[], 1200.0)).contains(&"30 mph"));
}

#[test]
fn what_stands_along_the_road_is_drawn_where_it_is_and_named() {
    let stretch = |edge, side, from_m, to_m| Stretch { from_m, to_m, side, edge };
    let bare = sheet(&with_stretches(vec![]), &[], &[], 1200.0);
    let track = with_stretches(vec![
        stretch(Edge::Kerb, Side::Left, 100.0, 200.0),
        stretch(Edge::Water, Side::Right, 1100.0, 50.0),
        stretch(Edge::Bridge, Side::Both, 600.0, 650.0),
    ]);
    let full = sheet(&track, &[], &[], 1200.0);
    for name in ["kerb", "water", "bridge"] {
        assert!(texts(&full).contains(&name) && !texts(&bare).contains(&name), "{name}");
    }
    assert!(!texts(&full).contains(&"rock"));
    let px_per_m = px_per_m(&track);
    let offset = |edge: Edge| track.half_width() + edge.stands_off_m() + road::look(edge).1 / 2.0;
    // Along the outside of a bend there is more of it than along the road.
    let along = |from: f64, metres: f64, offset: f64| -> f64 {
        let point = |i: u32| track.point(from + metres * f64::from(i) / 100.0, offset);
        (0..100).map(|i| point(i).distance(point(i + 1))).sum()
    };
    for (edge, metres) in [
        (Edge::Kerb, along(100.0, 100.0, -offset(Edge::Kerb))),
        (Edge::Water, along(1100.0, track.length() - 1050.0, offset(Edge::Water))),
        (Edge::Bridge, along(600.0, 50.0, offset(Edge::Bridge)) + along(600.0, 50.0, -offset(Edge::Bridge))),
    ] {
        let in_legend = 18.0;
        let got = (drawn(&full, road::look(edge).0) - in_legend) / px_per_m;
        assert!((got - metres).abs() < 3.0, "{edge:?}: {got:.1} m, expected about {metres:.1} m");
    }
}

fn px_per_m(track: &Track) -> f64 {
    let line = lap(track, |_| 0.0);
    drawn(&sheet(track, &line, &[], 1200.0), speed_colour(0)) / track.length()
}

#[test]
fn a_png_has_road_where_the_road_is() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map.png");
    let track = Track::named("mountain").unwrap();
    let marks = [Mark { position: track.point(450.0, 0.0), kind: MarkKind::Crash }];
    draw(&track, &lap(&track, |_| 30.0), &marks, &path, 900).unwrap();
    let picture = image::load_from_memory(&fs::read(&path).unwrap()).unwrap().to_rgb8();
    assert_eq!(picture.width(), 900);
    let share = |wanted: Colour| {
        picture.pixels().filter(|p| p.0 == wanted).count() as f64 / f64::from(picture.width() * picture.height())
    };
    assert!(share(PAPER) > 0.7);
    assert!(share([0x5b, 0x52, 0x4a]) > 0.01, "asphalt");
    assert!(share(speed_colour(LEVELS - 1)) > 0.002, "the driven line");
    assert!(share(CRASH) > 1e-5 && share(INK) > 1e-4, "the mark and the letters");
    let colours: BTreeSet<_> = picture.pixels().map(|p| p.0).collect();
    assert!(colours.len() > 100, "edges are smooth");
}

/// Where a road crosses itself, if it does.
fn crossing(track: &Track) -> Option<DVec3> {
    let stations = track.stations();
    let along = |a: f64, b: f64| (a - b).abs().min(track.length() - (a - b).abs());
    let crosses = |(s, place): (f64, DVec3)| {
        let near = |at: DVec3| (at - place).with_y(0.0).length() < 1.5;
        stations.iter().any(|other| along(s, other.s) > 50.0 && near(other.position))
    };
    stations.iter().map(|station| (station.s, station.position)).find(|at| crosses(*at)).map(|(_, place)| place)
}

#[test]
fn a_road_has_no_hole_where_it_crosses_itself() {
    let roads = (0..60).filter_map(|seed| {
        let random = RandomTrack { seed, crossings: true, ..RandomTrack::default() };
        let track = Track::new(random.build().unwrap()).unwrap();
        let place = crossing(&track)?;
        Some((seed, track, place))
    });
    let crossed: Vec<_> = roads.take(3).collect();
    assert_eq!(crossed.len(), 3);
    for (seed, track, place) in crossed {
        // A mark tells where on the sheet that is.
        let marks = [Mark { position: place, kind: MarkKind::OffRoad }];
        let marked = sheet(&track, &[], &marks, 1200.0);
        let mark = marked.shapes.iter().find_map(|shape| match shape {
            Shape::Area { points, colour: OFF_ROAD } => Some((points[0].0 as usize, points[1].1 as usize)),
            _ => None,
        });
        let (x, y) = mark.unwrap();
        let picture = sheet(&track, &[], &[], 1200.0).frame().unwrap();
        let is_paper = |x: usize, y: usize| picture.rgb()[3 * (y * picture.width() + x)..][..3] == PAPER;
        let mut near = (x - 4..=x + 4).flat_map(|x| (y - 4..=y + 4).map(move |y| (x, y)));
        assert!(!near.any(|(x, y)| is_paper(x, y)), "{seed}: paper where the road crosses itself, at {x}, {y}");
    }
}

#[test]
fn an_svg_is_well_formed_and_the_same_each_time() {
    let dir = tempfile::tempdir().unwrap();
    let mut file = Track::named("jungle").unwrap().file().clone();
    file.name = "<jungle> & \"co\"".into();
    let track = Track::new(file).unwrap();
    let line = [&lap(&track, |s| s % 30.0)[..], &[DrivenPoint { position: DVec3::NAN, speed_mph: 1.0 }]].concat();
    let svg = ["a.svg", "b.SVG"].map(|name| {
        draw(&track, &line, &[], dir.path().join(name), 1000).unwrap();
        fs::read_to_string(dir.path().join(name)).unwrap()
    });
    assert_eq!(svg[0], svg[1]);
    assert!(svg[0].contains("&lt;jungle&gt; &amp; \"co\": 149"));
    assert!(!svg[0].contains("NaN") && !svg[0].contains("inf"));
    assert_eq!(svg[0].matches("<text").count(), svg[0].matches("</text>").count());
    assert!(svg[0].starts_with("<svg ") && svg[0].ends_with("</svg>\n"));
}

#[test]
fn labels_keep_off_the_road() {
    for name in Track::NAMES {
        let track = Track::named(name).unwrap();
        let sheet = sheet(&track, &[], &[], 1200.0);
        let road: Vec<&Vec<Point>> = sheet
            .shapes
            .iter()
            .filter_map(|s| match s {
                Shape::Area { points, .. } if points.len() > 20 => Some(points),
                _ => None,
            })
            .collect();
        let on_road = sheet.shapes.iter().filter(|shape| {
            let Shape::Text { at, text } = shape else { return false };
            let middle = (at.0 + text.len() as f64 * LETTER / 2.0, at.1);
            road.iter().any(|points| points.iter().any(|p| (p.0 - middle.0).hypot(p.1 - middle.1) < 8.0))
        });
        assert_eq!(on_road.count(), 0, "{name}");
    }
}

#[test]
fn what_cannot_be_a_map_is_refused() {
    let track = Track::named("lake").unwrap();
    let error = |path: &str, width| draw(&track, &[], &[], path, width).unwrap_err().to_string();
    assert_eq!(error("map.pdf", 800), "map.pdf: expected the name of a picture that ends in .svg or .png");
    assert_eq!(error("map.svg", 10), "map.svg: expected a map 400 to 8000 pixels wide, got 10");
    assert!(error("no/such/folder/map.svg", 800).starts_with("cannot write the picture no/such/folder/map.svg: "));
}
