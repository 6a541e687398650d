//! Places that a recording shows more than once: its laps, held against one another.
//!
//! Two pictures of a place tell by themselves where one was taken beside the other ([`Warp::again`]), whatever is drawn. If the
//! drive is located right, that is where it says.

use std::{collections::BTreeMap, fmt, path::Path};

use rayon::prelude::*;
use serde::Serialize;

use super::{Errors, network::ByNetwork, pictures::decoded};
use lapwing_core::{
    motion::{around, turn},
    perception::Frame,
    recording::{Picture, Recording, RecordingError},
};
use lapwing_sim::{
    along::{Again, Beside, Warp},
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
    /// How far what they say is from where they were located on the drawn road; of places whose pictures are alike.
    #[serde(flatten)]
    pub drawn: Apart,
    /// How far it is from what a network sees, if one was asked and is sure of both pictures of such a place.
    pub network: Option<Apart>,
}

/// How far what two pictures say of one another is from what another way says of both.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Apart {
    /// The offset of one from the other, in metres.
    pub offset_m: Errors,
    /// The heading of one against the other, in degrees.
    pub heading_deg: Errors,
}

/// Holds the laps of a recording against one another; `None` if it shows no place twice, or no such pictures are alike.
/// `network` is what a network sees in its pictures. `looked_at` is called for each pair of pictures.
///
/// # Errors
/// What cannot be read of the recording. A picture that cannot is left out.
pub fn look(
    path: &Path,
    drive: &LocatedDrive,
    network: Option<&ByNetwork>,
    looked_at: impl Fn() + Sync,
) -> Result<Option<Laps>, RecordingError> {
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
    let alike = pairs.par_iter().filter_map(|pair| {
        looked_at();
        let [first, second] = pair.map(|row| {
            let mut frame = Frame::default();
            decoded(wanted.get(&row)?.as_ref(), &mut frame).is_ok().then_some(frame)
        });
        let again = warp.again(&first?, &second?)?;
        (again.alike >= ALIKE).then_some((*pair, again))
    });
    Ok(Pictures { places: pairs.len(), alike: alike.collect() }.against(drive, network))
}

/// What pairs of pictures say of one another.
struct Pictures {
    /// How many pairs were looked at.
    places: usize,
    /// Those that are alike, by their rows.
    alike: Vec<([usize; 2], Again)>,
}

impl Pictures {
    fn against(&self, drive: &LocatedDrive, network: Option<&ByNetwork>) -> Option<Laps> {
        let drawn = |row| drive.in_lane(row).map(|lane| (lane.offset_m, lane.heading_rad));
        let seen =
            |network: &ByNetwork, row| network.sure(row).map(|lane| (lane.offset_m, lane.heading_deg.to_radians()));
        Some(Laps {
            places: self.places,
            drawn: Apart::of(&self.alike, drawn)?,
            network: network.and_then(|network| Apart::of(&self.alike, |row| seen(network, row))),
        })
    }
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

impl Apart {
    /// Of pairs of rows whose pictures are alike, and of where another way sees a row: its offset in metres and its heading in
    /// radians.
    fn of(alike: &[([usize; 2], Again)], seen: impl Fn(usize) -> Option<(f64, f64)>) -> Option<Self> {
        let apart = alike.iter().filter_map(|(pair, again)| {
            let [first, second] = pair.map(&seen);
            Some(apart(first?, second?, again.beside))
        });
        let (offsets, headings): (Vec<f64>, Vec<f64>) = apart.unzip();
        Some(Self { offset_m: Errors::of(offsets)?, heading_deg: Errors::of(headings)? })
    }
}

/// How far where the second picture was seen beside the first is from where another way sees both: metres across the road, and
/// degrees.
fn apart(first: (f64, f64), second: (f64, f64), beside: Beside) -> (f64, f64) {
    let across_m = beside.offset_m * first.1.cos() + beside.ahead_m * first.1.sin();
    let heading_rad = turn(beside.heading_rad - (second.1 - first.1));
    (across_m - (second.0 - first.0), heading_rad.to_degrees())
}

impl fmt::Display for Laps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { places, drawn, network } = self;
        write!(f, "{} of {places} places seen again: {drawn}", drawn.offset_m.rows)?;
        let Some(network) = network else { return Ok(()) };
        write!(f, "\n{:15}from the network, at {} of them: {network}", "", network.offset_m.rows)
    }
}

impl fmt::Display for Apart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (offset, heading) = (self.offset_m.told(" m"), self.heading_deg.told("\u{b0}"));
        write!(f, "offsets differ by {offset}, headings by {heading}")
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::locating::network::NetworkLane;
    use lapwing_sim::{
        locate::{InLane, Located},
        track::Track,
    };

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
    fn what_two_pictures_tell_is_held_against_the_drawn_road_and_against_what_a_network_is_sure_of() {
        let drive = laps();
        let (sin, cos) = 0.1_f64.sin_cos();
        // In the axes of the first car, which is turned.
        let beside = Beside { offset_m: 0.6 * cos - 0.3 * sin, ahead_m: 0.3 * cos + 0.6 * sin, heading_rad: -0.15 };
        let pictures = Pictures {
            places: 300,
            alike: [20, 21].map(|row| ([row, row + 150], Again { beside, alike: 0.9 })).into(),
        };
        // A network sees the second lap 0.2 m farther to the right than it is, and is unsure of one picture.
        let lane = |row: usize, place: Option<Located>| {
            let InLane { offset_m, heading_rad, .. } = place.unwrap().pose.in_lane(&drive.track);
            let offset_m = offset_m + if row < 150 { 0.0 } else { 0.2 };
            let deviation = (if row == 171 { 0.9 } else { 0.05 }, 0.3);
            NetworkLane { offset_m, heading_deg: heading_rad.to_degrees(), deviation }
        };
        let rows = drive.places.iter().enumerate().map(|(row, place)| Some(lane(row, *place))).collect();
        let network = ByNetwork { model: "lane (a file)".into(), rows };
        let laps = pictures.against(&drive, Some(&network)).unwrap();
        assert_eq!((laps.places, laps.drawn.offset_m.rows), (300, 2));
        let Apart { offset_m, heading_deg } = laps.drawn;
        assert!((offset_m.median - 0.1).abs() < 1e-9 && heading_deg.median < 1e-9, "{offset_m:?}, {heading_deg:?}");
        let Apart { offset_m, heading_deg } = laps.network.unwrap();
        assert_eq!(offset_m.rows, 1);
        assert!((offset_m.median - 0.1).abs() < 1e-9 && heading_deg.median < 1e-9, "{offset_m:?}, {heading_deg:?}");
        assert_eq!(pictures.against(&drive, None).unwrap().network, None);
        assert_eq!(Pictures { alike: vec![], ..pictures }.against(&drive, None), None);
    }
}
