//! Places that a recording shows more than once: its laps, held against one another.
//!
//! Two pictures of a place tell by themselves where one was taken beside the other ([`Warp::again`]), whatever is drawn. If the
//! drive is located right, that is where it says.

use std::{collections::BTreeMap, fmt, path::Path};

use rayon::prelude::*;
use serde::Serialize;

use super::{
    Errors,
    network::{ByNetwork, NetworkLane},
    pictures::decoded,
};
use lapwing_core::{
    motion::{around, turn},
    perception::Frame,
    recording::{Picture, Recording, RecordingError},
};
use lapwing_sim::{
    along::{Again, Beside, Warp},
    locate::{InLane, LocatedDrive, Pose},
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
    /// How far it is from what a network sees, of such places of which it is sure of both pictures; `None` if no network was
    /// asked, or there are none.
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
    let told = pairs.par_iter().filter_map(|pair| {
        looked_at();
        let [first, second] = pair.map(|row| {
            let mut frame = Frame::default();
            decoded(wanted.get(&row)?.as_ref(), &mut frame).is_ok().then_some(frame)
        });
        Some((*pair, warp.again(&first?, &second?)?))
    });
    Ok(against(pairs.len(), &told.collect::<Vec<_>>(), drive, network))
}

/// Where a picture was taken: in metres to the right of the lane's middle, and radians clockwise from its direction.
#[derive(Debug, Clone, Copy)]
struct Seen {
    offset_m: f64,
    heading_rad: f64,
}

/// Holds what pairs of pictures, by their rows, tell of one another against the other ways.
fn against(
    places: usize,
    told: &[([usize; 2], Again)],
    drive: &LocatedDrive,
    network: Option<&ByNetwork>,
) -> Option<Laps> {
    let drawn = |row| drive.in_lane(row).map(|InLane { offset_m, heading_rad, .. }| Seen { offset_m, heading_rad });
    let seen = |network: &ByNetwork, row| {
        let NetworkLane { offset_m, heading_deg, .. } = network.sure(row)?;
        Some(Seen { offset_m, heading_rad: heading_deg.to_radians() })
    };
    Some(Laps {
        places,
        drawn: Apart::of(told, drawn)?,
        network: network.and_then(|network| Apart::of(told, |row| seen(network, row))),
    })
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
    /// Of pairs whose pictures are alike, from where another way sees both.
    fn of(told: &[([usize; 2], Again)], seen: impl Fn(usize) -> Option<Seen>) -> Option<Self> {
        let alike = told.iter().filter(|(_, again)| again.alike >= ALIKE);
        let apart = alike.filter_map(|(pair, again)| {
            let [first, second] = pair.map(&seen);
            Some(apart(first?, second?, again.beside))
        });
        let (offsets, headings): (Vec<f64>, Vec<f64>) = apart.unzip();
        Some(Self { offset_m: Errors::of(offsets)?, heading_deg: Errors::of(headings)? })
    }
}

/// How far where the second picture was seen beside the first is from where another way sees both: metres across the road, and
/// degrees.
fn apart(first: Seen, second: Seen, beside: Beside) -> (f64, f64) {
    let across_m = beside.offset_m * first.heading_rad.cos() + beside.ahead_m * first.heading_rad.sin();
    let heading_rad = turn(beside.heading_rad - (second.heading_rad - first.heading_rad));
    (across_m - (second.offset_m - first.offset_m), heading_rad.to_degrees())
}

impl Laps {
    /// In words, a line each.
    pub(super) fn told(&self) -> impl Iterator<Item = String> {
        let Self { places, drawn, network } = self;
        let alike = drawn.offset_m.rows;
        let of_places =
            format!("{places} places seen again, {alike} in pictures that are alike; from the drawn road: {drawn}");
        let of_network =
            network.as_ref().map(|apart| format!("from the network, at {} of them: {apart}", apart.offset_m.rows));
        [Some(of_places), of_network].into_iter().flatten()
    }
}

impl fmt::Display for Apart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "offset {}, heading {}", self.offset_m.told(" m"), self.heading_deg.told("\u{b0}"))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use lapwing_sim::{locate::Located, track::Track};

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
        let told = [(20, 0.9), (21, 0.9), (22, 0.5)].map(|(row, alike)| ([row, row + 150], Again { beside, alike }));
        // A network sees the second lap 0.3 m farther to the right than it is and turned by a degree more, and is unsure of one
        // picture.
        let lane = |(row, place): (usize, &Option<Located>)| {
            let InLane { offset_m, heading_rad, .. } = place.unwrap().pose.in_lane(&drive.track);
            let (further_m, turned_deg) = if row < 150 { (0.0, 0.0) } else { (0.3, 1.0) };
            let deviation = (if row == 171 { 0.9 } else { 0.05 }, 0.3);
            let heading_deg = heading_rad.to_degrees() + turned_deg;
            Some(NetworkLane { offset_m: offset_m + further_m, heading_deg, deviation })
        };
        let rows = drive.places.iter().enumerate().map(lane).collect();
        let network = ByNetwork { model: "lane (a file)".into(), rows };
        let laps = against(300, &told, &drive, Some(&network)).unwrap();
        let figures = |Apart { offset_m, heading_deg }: &Apart| (offset_m.rows, offset_m.median, heading_deg.median);
        let (pairs, offset_m, heading_deg) = figures(&laps.drawn);
        assert!(pairs == 2 && (offset_m - 0.1).abs() < 1e-9 && heading_deg < 1e-9, "{:?}", laps.drawn);
        let seen = laps.network.clone().unwrap();
        let (pairs, offset_m, heading_deg) = figures(&seen);
        assert!(pairs == 1 && (offset_m - 0.2).abs() < 1e-9 && (heading_deg - 1.0).abs() < 1e-9, "{seen:?}");
        let lines: Vec<_> = laps.told().collect();
        assert!(lines[0].starts_with(
            "300 places seen again, 2 in pictures that are alike; from the drawn road: offset median 0.100 m"
        ));
        assert!(lines[1].starts_with("from the network, at 1 of them: offset median 0.200 m"), "{lines:?}");
        let alone = against(300, &told, &drive, None).unwrap();
        assert_eq!((alone.told().count(), alone.network), (1, None));
        assert_eq!(against(300, &told[2..], &drive, None), None, "pictures that are not alike say nothing");
    }
}
