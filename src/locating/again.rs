//! Places that a recording shows more than once: its laps, held against one another.
//!
//! Two pictures of a place tell by themselves where one was taken beside the other ([`Warp::again`]), whatever is drawn. If the
//! drive is located right, that is where it says.

use std::{collections::BTreeMap, fmt, path::Path};

use rayon::prelude::*;
use serde::Serialize;

use super::{Errors, pictures::decoded};
use lapwing_core::{
    motion::{around, turn},
    perception::Frame,
    recording::{Picture, Recording, RecordingError},
};
use lapwing_sim::{
    along::{Again, Warp},
    locate::{LocatedDrive, Pose},
};

/// Pictures are of one place if no farther apart than this along the road, in metres, …
const PLACE_M: f64 = 0.75;
/// … and of another lap if so many pictures lie between them.
const LAP: usize = 100;
/// So many places are looked at, spread over the drive.
const MOST: usize = 200;
/// Pictures that are less alike than this say nothing of one another.
const ALIKE: f64 = 0.6;

/// What laps say of one another.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Laps {
    /// Places that were seen twice, and of which two pictures were held against one another.
    pub places: usize,
    /// How far the offset of one from the other is from that of where they were located, in metres; of places whose pictures
    /// are alike.
    pub offset_m: Errors,
    /// The same of the heading, in degrees.
    pub heading_deg: Errors,
}

/// Holds the laps of a recording against one another; `None` if it shows no place twice, or no such pictures are alike.
/// `looked_at` is called for each pair of pictures.
///
/// # Errors
/// What cannot be read of the recording. A picture that cannot is left out.
pub fn look(path: &Path, drive: &LocatedDrive, looked_at: impl Fn() + Sync) -> Result<Option<Laps>, RecordingError> {
    let pairs = pairs(drive);
    if pairs.is_empty() {
        return Ok(None);
    }
    let mut wanted: BTreeMap<usize, Option<Picture>> = pairs.iter().flatten().map(|row| (*row, None)).collect();
    for (row, moment) in Recording::open(path)?.seen().enumerate() {
        if let Some(picture) = wanted.get_mut(&row) {
            *picture = moment?.pictures[0].take();
        }
    }
    let warp = Warp::new();
    let apart = pairs.par_iter().filter_map(|pair| {
        looked_at();
        let [first, second] = pair.map(|row| {
            let mut frame = Frame::default();
            decoded(wanted.get(&row)?.as_ref(), &mut frame).is_ok().then_some(frame)
        });
        apart(drive, *pair, warp.again(&first?, &second?)?)
    });
    let (offsets, headings): (Vec<f64>, Vec<f64>) = apart.unzip();
    let errors = Errors::of(offsets).zip(Errors::of(headings));
    Ok(errors.map(|(offset_m, heading_deg)| Laps { places: pairs.len(), offset_m, heading_deg }))
}

/// Rows of one place in different laps, spread over the drive.
fn pairs(drive: &LocatedDrive) -> Vec<[usize; 2]> {
    let pose = |row: usize| drive.places[row].map(|located| located.pose);
    let known: Vec<_> = (0..drive.places.len()).filter_map(|row| Some((row, pose(row)?))).collect();
    let again = |&(row, here): &(usize, Pose)| {
        let later = known.iter().filter(|(other, _)| *other > row + LAP);
        let same = later.filter(|(_, there)| there.direction() == here.direction());
        let off = |s_m: f64| around(s_m - here.s_m, drive.track.length()).abs();
        let nearest = same.min_by(|a, b| off(a.1.s_m).total_cmp(&off(b.1.s_m)))?;
        (off(nearest.1.s_m) <= PLACE_M).then_some([row, nearest.0])
    };
    let pairs: Vec<_> = known.iter().filter_map(again).collect();
    let step = pairs.len().div_ceil(MOST).max(1);
    pairs.into_iter().step_by(step).collect()
}

/// How far where the second picture was seen beside the first is from where both were located: metres across the road, and
/// degrees.
fn apart(drive: &LocatedDrive, pair: [usize; 2], Again { beside, alike }: Again) -> Option<(f64, f64)> {
    let [first, second] = pair.map(|row| drive.in_lane(row));
    let (first, second) = (first?, second?);
    let across_m = beside.offset_m * first.heading_rad.cos() + beside.ahead_m * first.heading_rad.sin();
    let offset_m = across_m - (second.offset_m - first.offset_m);
    let heading_rad = turn(beside.heading_rad - (second.heading_rad - first.heading_rad));
    (alike >= ALIKE).then(|| (offset_m, heading_rad.to_degrees()))
}

impl fmt::Display for Laps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { places, offset_m, heading_deg } = self;
        write!(f, "{} of {places} places seen again: offsets differ by {}", offset_m.rows, offset_m.told(" m"))?;
        write!(f, ", headings by {}", heading_deg.told("\u{b0}"))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use lapwing_sim::{along::Beside, locate::Located, track::Track};

    /// Two laps of the lake, a picture every 7 m, the second one 0.5 m to the right and turned.
    fn laps() -> LocatedDrive {
        let pose = |i: usize| {
            let (s_m, first) = ((i % 150) as f64 * 7.0, i < 150);
            let (s_m, offset_m, heading_rad) = if first { (s_m, 0.0, 0.1) } else { (s_m + 0.3, 0.5, -0.05) };
            Pose { s_m, offset_m, heading_rad, pitch_rad: 0.0 }
        };
        let places = (0..300).map(|i| Some(Located::known(pose(i)))).collect();
        LocatedDrive { track: Arc::new(Track::named("lake").unwrap()), places }
    }

    #[test]
    fn pictures_of_one_place_in_two_laps_are_pairs_and_one_lap_has_none() {
        let mut drive = laps();
        assert_eq!(pairs(&drive), (0..150).map(|i| [i, i + 150]).collect::<Vec<_>>());
        // One that drives the other way round sees something else.
        drive.places[150] = drive.places[150].map(|it| Located::known(Pose { heading_rad: 3.1, ..it.pose }));
        assert_eq!(pairs(&drive)[0], [1, 151]);
        drive.places.truncate(150);
        assert!(pairs(&drive).is_empty());
    }

    #[test]
    fn what_two_pictures_tell_is_held_against_the_lane_and_only_if_they_are_alike() {
        let drive = laps();
        let (sin, cos) = 0.1_f64.sin_cos();
        // In the axes of the first car, which is turned.
        let beside = Beside { offset_m: 0.6 * cos - 0.3 * sin, ahead_m: 0.3 * cos + 0.6 * sin, heading_rad: -0.15 };
        let (offset_m, heading_deg) = apart(&drive, [20, 170], Again { beside, alike: 0.9 }).unwrap();
        assert!((offset_m - 0.1).abs() < 1e-9 && heading_deg.abs() < 1e-9, "{offset_m} m, {heading_deg} degrees");
        assert_eq!(apart(&drive, [20, 170], Again { beside, alike: 0.5 }), None);
    }
}
