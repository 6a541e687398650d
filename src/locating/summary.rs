//! What was found, in figures: for people, and as JSON.

use std::{fmt, ops::Range};

use serde::Serialize;

use super::{Car, Laps, LocatedRecording, On, Part, Row, network::NetworkSummary};
use lapwing_core::{
    motion::around,
    words::{self, count},
};
use lapwing_sim::{camera::Camera, locate::Located};

/// Numbers around a middle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// Their mean.
    pub mean: f64,
    /// Their standard deviation.
    pub deviation: f64,
    /// 95 % of them are no farther from 0.
    pub p95: f64,
    /// None is farther from 0.
    pub largest: f64,
}

/// How wrong something was found, in metres and degrees: the median, and what 95 % stay within.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Errors {
    /// How often it was compared.
    pub rows: usize,
    /// The median error.
    pub median: f64,
    /// 95 % are no larger.
    pub p95: f64,
    /// If the size of each error was stated, as a standard deviation: the share within two of these, 0.95 if they are right.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub within_two_sd: Option<f64>,
}

/// Errors against what the simulator told.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AgainstTruth {
    /// Of the offset, in metres.
    pub offset_m: Errors,
    /// Of the heading, in degrees.
    pub heading_deg: Option<Errors>,
    /// Of the place along the road, in metres.
    pub place_m: Option<Errors>,
}

/// Where the side cameras were found, each located by itself as if it were the centre one, against where they sit on the
/// car: 0.806 m to the left and 0.825 m to the right.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sides {
    /// Errors of both.
    pub errors_m: Errors,
    /// The mean of where the left camera was found, in metres to the right of the centre one.
    pub left_m: f64,
    /// The same of the right one.
    pub right_m: f64,
}

/// A drive on a road.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Placed {
    /// The road's name.
    pub track: String,
    /// Whether it was driven against the track's direction.
    pub reversed: bool,
    /// Laps, by the places found.
    pub laps: f64,
    /// The share of its pictures whose place is known.
    pub located: f64,
    /// From the lane's middle, in metres, positive to the right.
    pub offset_m: Option<Spread>,
    /// From the lane's direction, in degrees, positive to the right.
    pub heading_deg: Option<Spread>,
    /// The share of the located pictures more than 1 m and more than 2 m from the lane's middle.
    pub beyond: [f64; 2],
    /// The medians of how sure that is, as standard deviations: metres along the road, metres across, degrees; absent if no
    /// place is known.
    pub unsure: Option<[f64; 3]>,
    /// Moments whose place is not known, as the first and the last of each run of them.
    pub not_seen: Vec<(usize, usize)>,
    /// If the recording or a table tells its place: how wrong what was found is.
    pub against_truth: Option<AgainstTruth>,
    /// If the side cameras were located.
    pub sides: Option<Sides>,
    /// How its car went and turned, against what its speed and its steering say.
    pub car: Option<Car>,
}

/// A drive.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PartSummary {
    /// Its first and last moment with a picture, counted over the recording from 0.
    pub moments: (usize, usize),
    /// Pictures.
    pub pictures: usize,
    /// Metres driven, by speed and time.
    pub way_m: f64,
    /// On which road; absent if that is not known.
    #[serde(flatten)]
    pub on: Option<Placed>,
    /// Why its road is unknown, or why none of its pictures was located on it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unknown: Option<String>,
    /// Whether a keyboard steered whose release is at once.
    pub released_at_once: bool,
    /// What a network sees in its pictures, if one was asked.
    pub network: Option<NetworkSummary>,
}

/// All of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// The recording.
    pub source: String,
    /// Its drives.
    pub drives: Vec<PartSummary>,
    /// What its laps say of one another; absent if it shows no place twice.
    pub laps: Option<Laps>,
    /// Pictures that could not be looked at.
    pub unreadable: usize,
    /// Whether a keyboard steered whose release is at once, in one of the drives or more.
    pub released_at_once: bool,
    /// Why nothing is known of the side cameras, if they were asked for and `sides` is empty in all drives.
    pub no_sides: Option<String>,
}

impl Summary {
    /// Of what was found in the centre pictures and, if they were located, in the left and the right ones.
    pub fn new(source: String, found: &LocatedRecording, sides: Option<&[LocatedRecording; 2]>) -> Self {
        let drive = |(i, part): (usize, &Part)| {
            let network = NetworkSummary::new(found, part, sides);
            let sides = sides.and_then(|sides| {
                let [left, right] = sides.each_ref().map(|side| side.parts.get(i).and_then(|part| part.on.as_ref()));
                part.on.as_ref().and_then(|on| beside(on, left?, right?))
            });
            let first = found.rows[part.rows.start].moment;
            PartSummary {
                moments: (first, found.rows[part.rows.end - 1].moment),
                pictures: part.rows.len(),
                way_m: part.way_m,
                on: part.on.as_ref().map(|on| Placed { sides, ..placed(on, &found.rows[part.rows.clone()]) }),
                unknown: part.unknown.clone(),
                released_at_once: found.released_at_once.iter().any(|drive| drive.contains(&first)),
                network,
            }
        };
        let drives: Vec<_> = found.parts.iter().enumerate().map(drive).collect();
        Self {
            source,
            no_sides: sides.and_then(|sides| no_sides(sides, &drives)),
            released_at_once: drives.iter().any(|drive| drive.released_at_once),
            drives,
            laps: found.laps.clone(),
            unreadable: found.unreadable.0,
        }
    }
}

/// How `pictures` says that a recording has no picture of a camera.
const NO_PICTURE: &str = "the recording names no picture of this camera";

/// Why none of the drives has side cameras.
fn no_sides(sides: &[LocatedRecording; 2], drives: &[PartSummary]) -> Option<String> {
    let of_network = |drive: &PartSummary| drive.network.as_ref().is_some_and(|network| network.sides.is_some());
    let of_road = |drive: &PartSummary| drive.on.as_ref().is_some_and(|on| on.sides.is_some());
    if drives.iter().any(|drive| of_network(drive) || of_road(drive)) {
        return None;
    }
    Some(match sides.iter().find_map(|side| side.unreadable.1.as_deref()) {
        Some(why) if why == NO_PICTURE => "the recording has none".to_owned(),
        Some(why) => why.to_owned(),
        None => "no moment's pictures of the centre camera and of both side cameras were located".to_owned(),
    })
}

fn placed(on: &On, rows: &[Row]) -> Placed {
    let On { reversed, drive } = on;
    let seen: Vec<&Located> = drive.places.iter().flatten().collect();
    let lanes: Vec<_> = seen.iter().map(|located| located.pose.in_lane(&drive.track)).collect();
    let offsets: Vec<f64> = lanes.iter().map(|lane| lane.offset_m).collect();
    let headings: Vec<f64> = lanes.iter().map(|lane| lane.heading_rad.to_degrees()).collect();
    let share = |count: usize, of: usize| count as f64 / of.max(1) as f64;
    let beyond = |metres: f64| share(offsets.iter().filter(|offset| offset.abs() > metres).count(), offsets.len());
    let median = |of: &dyn Fn(&Located) -> f64| {
        Errors::of(seen.iter().map(|located| of(located)).collect()).map_or(0.0, |errors| errors.median)
    };
    let length_m = drive.track.length();
    let ways = seen.windows(2).map(|pair| around(pair[1].pose.s_m - pair[0].pose.s_m, length_m));
    Placed {
        track: on.road().to_owned(),
        reversed: *reversed,
        laps: ways.sum::<f64>().abs() / length_m,
        located: share(seen.len(), rows.len()),
        offset_m: Spread::of(&offsets),
        heading_deg: Spread::of(&headings),
        beyond: [1.0, 2.0].map(beyond),
        unsure: (!seen.is_empty()).then(|| {
            [
                median(&|located| located.deviation.s_m),
                median(&|located| located.deviation.offset_m),
                median(&|located| located.deviation.heading_rad.to_degrees()),
            ]
        }),
        not_seen: unseen(&drive.places)
            .into_iter()
            .map(|of| (rows[of.start].moment, rows[of.end - 1].moment))
            .collect(),
        against_truth: against_truth(on, rows),
        sides: None,
        car: Car::of(&on.drive, rows),
    }
}

/// Runs of rows whose place is not known.
fn unseen(places: &[Option<Located>]) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = vec![];
    for (i, _) in places.iter().enumerate().filter(|(_, place)| place.is_none()) {
        match runs.last_mut() {
            Some(run) if run.end == i => run.end = i + 1,
            _ => runs.push(i..i + 1),
        }
    }
    runs
}

pub(super) fn against_truth(on: &On, rows: &[Row]) -> Option<AgainstTruth> {
    let track = &on.drive.track;
    let (mut offsets, mut headings, mut places) = (vec![], vec![], vec![]);
    // Where the car was follows from where it was before, not from where it was found: that may be far away.
    let mut true_m = None;
    for (row, located) in rows.iter().zip(&on.drive.places) {
        let Some(truth) = row.truth else { continue };
        let before_m = true_m.filter(|_| row.broken.is_none());
        true_m = truth.position.map(|position| track.locate(position, before_m).station.s);
        let Some(located) = located else { continue };
        let lane = located.pose.in_lane(track);
        let sd = located.deviation;
        offsets.push((lane.offset_m - truth.offset_m, sd.offset_m));
        let turned = truth.heading_deg.map(|heading_deg| lane.heading_rad.to_degrees() - heading_deg);
        headings.extend(turned.map(|error| (error, sd.heading_rad.to_degrees())));
        places.extend(true_m.map(|true_m| (around(located.pose.s_m - true_m, track.length()), sd.s_m)));
    }
    let offset_m = Errors::with_sd(&offsets)?;
    Some(AgainstTruth { offset_m, heading_deg: Errors::with_sd(&headings), place_m: Errors::with_sd(&places) })
}

fn beside(center: &On, left: &On, right: &On) -> Option<Sides> {
    Sides::of([left, right].map(|side| {
        let both = center.drive.places.iter().zip(&side.drive.places).filter_map(|(a, b)| a.as_ref().zip(b.as_ref()));
        let seen = |(center, beside): (&Located, &Located)| {
            let right_m = (beside.pose.offset_m - center.pose.offset_m) * center.pose.direction();
            (center.pose.heading_rad.cos().abs(), right_m)
        };
        both.map(seen).collect()
    }))
}

impl Sides {
    /// Of pictures in which the left camera, and the right one, are seen besides the centre one: the cosine of the car's heading
    /// against its lane, and how far to the right of the centre one the other is seen, in metres.
    pub(super) fn of(seen: [Vec<(f64, f64)>; 2]) -> Option<Self> {
        let (mut errors, mut means) = (vec![], [f64::NAN; 2]);
        for ((seen, camera), mean) in seen.iter().zip([Camera::LEFT, Camera::RIGHT]).zip(&mut means) {
            errors.extend(seen.iter().map(|(along, right_m)| right_m - camera.mount.position.x * along));
            let rights: Vec<f64> = seen.iter().map(|(_, right_m)| *right_m).collect();
            *mean = Spread::of(&rights).map_or(f64::NAN, |spread| spread.mean);
        }
        let [left_m, right_m] = means;
        Some(Self { errors_m: Errors::of(errors)?, left_m, right_m })
    }
}

impl Spread {
    pub(super) fn of(numbers: &[f64]) -> Option<Self> {
        let n = numbers.len() as f64;
        let mean = numbers.iter().sum::<f64>() / n;
        let deviation = (numbers.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt();
        let Errors { p95, .. } = Errors::of(numbers.to_vec())?;
        let largest = numbers.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        Some(Self { mean, deviation, p95, largest })
    }

    /// In words, with the unit.
    pub(super) fn told(&self, unit: &str) -> String {
        let Self { mean, deviation, p95, largest } = self;
        format!(
            "mean {mean:+.2}{unit}, standard deviation {deviation:.2}{unit}, 95 % within {p95:.2}{unit}, largest {largest:.2}{unit}"
        )
    }
}

impl Errors {
    pub(super) fn of(errors: Vec<f64>) -> Option<Self> {
        let mut sizes: Vec<f64> = errors.into_iter().map(f64::abs).collect();
        sizes.sort_by(f64::total_cmp);
        let at = |share: f64| sizes.get(((sizes.len() as f64 * share) as usize).min(sizes.len().saturating_sub(1)));
        Some(Self { rows: sizes.len(), median: *at(0.5)?, p95: *at(0.95)?, within_two_sd: None })
    }

    /// Of errors, and the standard deviation that was stated for each.
    pub(super) fn with_sd(errors: &[(f64, f64)]) -> Option<Self> {
        let within = errors.iter().filter(|(error, sd)| error.abs() <= 2.0 * sd).count();
        let of = Self::of(errors.iter().map(|(error, _)| *error).collect())?;
        Some(Self { within_two_sd: Some(within as f64 / of.rows as f64), ..of })
    }

    /// In words, with the unit.
    pub(super) fn told(&self, unit: &str) -> String {
        let stated = |share: f64| format!(", {:.1} % within two stated standard deviations", 100.0 * share);
        let stated = self.within_two_sd.map_or_else(String::new, stated);
        format!("median {:.3}{unit}, 95 % within {:.3}{unit}{stated}", self.median, self.p95)
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.source)?;
        for drive in &self.drives {
            write!(f, "{drive}")?;
        }
        for (line, told) in self.laps.iter().flat_map(Laps::told).enumerate() {
            write!(f, "\n  {:<12} {told}", if line == 0 { "laps" } else { "" })?;
        }
        if let Some(why) = &self.no_sides {
            write!(f, "\nside cameras cannot be measured: {why}")?;
        }
        if self.released_at_once {
            let moments = |drive: &PartSummary| format!("{} to {}", drive.moments.0, drive.moments.1);
            let drives: Vec<_> = self.drives.iter().filter(|drive| drive.released_at_once).map(moments).collect();
            let some = drives.len() < self.drives.len();
            let of = if some { format!(", moments {}", drives.join(", ")) } else { String::new() };
            write!(f, "\nsteered by keyboard{of}: when a key is released, the steering is zero at once")?;
        }
        if self.unreadable > 0 {
            write!(f, "\n{} could not be looked at", count(self.unreadable, "picture"))?;
        }
        Ok(())
    }
}

impl fmt::Display for PartSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (first, last) = self.moments;
        let pictures = count(self.pictures, "picture");
        let Some(on) = &self.on else {
            let why = self.unknown.as_ref().map_or_else(String::new, |why| format!(": {why}"));
            write!(f, "\nmoments {first} to {last}: {pictures}, {:.0} m, on no known road{why}", self.way_m)?;
            return self.network.as_ref().map_or(Ok(()), |network| write!(f, "{network}"));
        };
        let road = words::road(&on.track, on.reversed);
        write!(f, "\n{road}: moments {first} to {last}, {pictures}, {:.0} m", self.way_m)?;
        let mut line = |label: &str, what: String| write!(f, "\n  {label:<12} {what}");
        line("located", format!("{:.1} % of them, {:.2} laps", 100.0 * on.located, on.laps))?;
        self.unknown.as_ref().map_or(Ok(()), |why| line("", why.clone()))?;
        if let Some(offset) = &on.offset_m {
            let [beyond_1, beyond_2] = on.beyond.map(|share| 100.0 * share);
            line("offset", offset.told(" m"))?;
            line("", format!("{beyond_1:.1} % of the pictures beyond 1 m, {beyond_2:.1} % beyond 2 m"))?;
        }
        on.heading_deg.as_ref().map_or(Ok(()), |heading| line("heading", heading.told("\u{b0}")))?;
        if let Some([place, offset, heading]) = on.unsure {
            let across = format!("offset {offset:.2} m, heading {heading:.2}\u{b0}");
            line("uncertainty", format!("{across}, place {place:.1} m (medians)"))?;
        }
        if let [first, ..] = on.not_seen[..] {
            let most = on.not_seen.iter().max_by_key(|(from, to)| to - from).copied().unwrap_or(first);
            let runs = count(on.not_seen.len(), "gap");
            line("not seen", format!("{runs}, the longest from moment {} to {}", most.0, most.1))?;
        }
        if let Some(AgainstTruth { offset_m, heading_deg, place_m }) = &on.against_truth {
            line("error", format!("offset: {}", offset_m.told(" m")))?;
            heading_deg.as_ref().map_or(Ok(()), |of| line("", format!("heading: {}", of.told("\u{b0}"))))?;
            place_m.as_ref().map_or(Ok(()), |of| line("", format!("place: {}", of.told(" m"))))?;
        }
        if let Some(Car { way, turning, late_s, r }) = on.car {
            let turned = format!("turned {turning:.2} of what was steered, {late_s:.2} s later (r {r:.3})");
            line("car", format!("went {way:.3} of what its speed says, {turned}"))?;
        }
        on.sides.as_ref().map_or(Ok(()), |sides| line("side cameras", sides.to_string()))?;
        self.network.as_ref().map_or(Ok(()), |network| write!(f, "{network}"))
    }
}

impl fmt::Display for Sides {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { errors_m, left_m, right_m } = self;
        let means = format!("on average {left_m:+.2} and {right_m:+.2} m, they sit at -0.81 and +0.82");
        write!(f, "{} ({means})", errors_m.told(" m"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nothing was located, for this reason.
    fn nothing(why: Option<&str>) -> LocatedRecording {
        LocatedRecording {
            parts: vec![],
            rows: vec![],
            released_at_once: vec![],
            network: None,
            laps: None,
            unreadable: (usize::from(why.is_some()), why.map(str::to_owned)),
        }
    }

    #[test]
    fn where_nothing_is_known_of_side_cameras_that_were_asked_for_json_and_text_say_why() {
        let center = nothing(None);
        for (why, told) in [
            (Some(NO_PICTURE), "the recording has none"),
            (Some("left.jpg: expected 320x160 pixels, got 2x2"), "left.jpg: expected 320x160 pixels, got 2x2"),
            (None, "no moment's pictures of the centre camera and of both side cameras were located"),
        ] {
            let summary = Summary::new("lake".into(), &center, Some(&[nothing(why), nothing(why)]));
            assert_eq!(serde_json::to_value(&summary).unwrap()["no_sides"], told);
            assert!(summary.to_string().contains(&format!("side cameras cannot be measured: {told}")), "{summary}");
        }
        let unasked = Summary::new("lake".into(), &center, None);
        assert_eq!(serde_json::to_value(&unasked).unwrap()["no_sides"], serde_json::Value::Null);
    }

    #[test]
    fn the_share_of_errors_within_two_stated_deviations_is_told_where_deviations_were_stated() {
        let errors = Errors::with_sd(&[(0.1, 0.1), (-0.2, 0.1), (0.3, 0.1), (0.0, 0.1)]).unwrap();
        assert_eq!(errors.within_two_sd, Some(0.75));
        assert!(errors.told(" m").ends_with("75.0 % within two stated standard deviations"), "{errors:?}");
        assert!(!Errors::of(vec![0.1]).unwrap().told(" m").contains("stated"));
    }
}
