//! The world of `drive --world`: a known road, and what recordings show of it.

use std::{
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
};

use anyhow::bail;
use serde_json::json;

use crate::{known::Roads, locating::table_of};
use lapwing_core::{config::ConfigError, words::count};
use lapwing_score::{odometry::words, results::Seen};
use lapwing_sim::{
    along::{Sights, Views},
    camera::Scenery,
    conditions::Conditions,
    locate::LocatedDrive,
    track::Track,
    world::{Setup, Simulation},
};

/// The pictures of recordings, along the road on which most of them were driven, in the direction of most of them.
pub(super) struct Recorded {
    views: Option<Views>,
    sights: Arc<Mutex<Sights>>,
    /// Where the recordings are, moments with pictures, and the share of the road that they show.
    sources: Vec<String>,
    moments: usize,
    covered: f64,
}

impl Recorded {
    /// Locates the recordings, and makes their road that of the setup.
    pub(super) fn open(
        recordings: &[PathBuf],
        lanes: &[PathBuf],
        track: Option<&str>,
        setup: &mut Setup,
    ) -> anyhow::Result<Self> {
        if let Some(got) = light_and_weather(&setup.conditions) {
            let why = format!(
                "expected only latency_ms or dropped with --world, got {got}: light and weather are those of the recordings"
            );
            return Err(ConfigError::Value { layer: "--conditions".into(), why }.into());
        }
        if !lanes.is_empty() && lanes.len() != recordings.len() {
            let recordings = count(recordings.len(), "recording");
            let why = format!("expected one file for each of {recordings}, got {}", lanes.len());
            return Err(ConfigError::Value { layer: "--lane".into(), why }.into());
        }
        let roads = Roads::with(&track.into_iter().map(str::to_owned).collect::<Vec<_>>());
        let mut drives = vec![];
        for (i, path) in recordings.iter().enumerate() {
            super::locate::warn_of_assumed_times(path)?;
            if let Some(table) = lanes.get(i) {
                let table = table_of(path, table, &roads)?;
                if table.elsewhere > 0 {
                    let (path, left_out) = (path.display(), count(table.elsewhere, "located picture"));
                    say!("--world: {path}: leaving out {left_out}, taken on an unknown road: name it with --track");
                }
                drives.extend(table.drives().into_iter().map(|drive| (path.clone(), drive)));
                continue;
            }
            let found = super::locate::centre(path, &roads)?;
            let located = found.drives();
            if located.is_empty() {
                let why = found.unknown().join("; ");
                bail!("{}: expected a drive on a known road, got none: {why}", path.display());
            }
            drives.extend(located.into_iter().map(|drive| (path.clone(), drive)));
        }
        let wanted = track.map(|name| Track::open(name).map(|track| track.file().name.clone())).transpose()?;
        let on = |road: &str| {
            let here = drives.iter().filter(|(_, drive)| drive.track.file().name == road);
            here.map(|(_, drive)| both_ways(drive)).fold([0_usize; 2], |[a, b], [c, d]| [a + c, b + d])
        };
        let most = drives.iter().map(|(_, drive)| &drive.track).max_by_key(|track| {
            let name = &track.file().name;
            (wanted.as_ref() == Some(name), on(name).iter().sum::<usize>())
        });
        let Some(road) = most.cloned() else { bail!("--world: expected a recording") };
        let name = &road.file().name;
        if let Some(wanted) = wanted.filter(|wanted| wanted != name) {
            bail!(
                "--world: expected drives on {wanted}, got some on {name}: leave out --track to drive on {name}, or \
                 name recordings of {wanted}"
            );
        }
        let [forwards, backwards] = on(name);
        let reversed = backwards > forwards;
        let moments = forwards.max(backwards);
        for left_out in left_out(&drives, name, reversed) {
            say!("--world: {left_out}");
        }
        drives.retain(|(_, drive)| drive.track.file().name == *name && both_ways(drive)[usize::from(reversed)] > 0);
        let views = Views::open(&road, reversed, &drives)?;
        if let Some(why) = views.why_blank() {
            bail!("--world: expected usable pictures of {name}, got none; the first cannot be used: {why}");
        }
        for (i, (path, _)) in drives.iter().enumerate() {
            if let Some(no_sides) = no_sides(views.without_side_cameras(i)) {
                say!("--world: {}: {no_sides}", path.display());
            }
        }
        setup.track = views.track().clone();
        setup.scenery = Arc::new(Scenery::new(&setup.track));
        let sources = drives.iter().map(|(path, _)| path.display().to_string()).collect();
        let (sights, covered) = (views.sights(), views.covered());
        Ok(Self { views: Some(views), sights, sources, moments, covered })
    }

    /// The simulation, seen by these recordings.
    pub(super) fn show(&mut self, simulation: Simulation) -> Simulation {
        match self.views.take() {
            Some(views) => simulation.seen_by(views),
            None => simulation,
        }
    }

    /// Where the recordings are.
    pub(super) fn sources(&self) -> &[String] {
        &self.sources
    }

    /// What was seen so far.
    pub(super) fn seen(&self) -> Seen {
        let sights = self.sights.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let mean = |sum: f64| (sights.recorded > 0).then(|| sum / f64::from(sights.recorded));
        if let (number, Some(why)) = &sights.unusable {
            say!(
                "--world: {} could not be used; the first, because: {why}",
                count(*number as usize, "recorded picture")
            );
        }
        Seen {
            moments: self.moments,
            covered: self.covered,
            recorded: sights.recorded,
            drawn: sights.drawn,
            apart_m: mean(sights.apart_m),
            filled_mean: mean(sights.filled.0),
            filled_most: (sights.recorded > 0).then_some(sights.filled.1),
        }
    }

    /// Why nothing of the drive was seen in recorded pictures, if that is so.
    pub(super) fn unseen(&self) -> Option<String> {
        let sights = self.sights.lock().unwrap_or_else(PoisonError::into_inner);
        (sights.recorded == 0 && sights.drawn > 0).then(|| {
            let drawn = count(sights.drawn as usize, "picture");
            format!("--world: expected recorded pictures where the car drove, got none: all {drawn} were drawn")
        })
    }
}

/// What recordings already have, of the conditions that were asked for.
fn light_and_weather(conditions: &Conditions) -> Option<String> {
    let (asked, usual) = (json!(conditions), json!(Conditions::default()));
    let possible = |name: &str| ["latency_ms", "dropped"].contains(&name);
    let asked = asked.as_object().into_iter().flatten();
    let other = asked.filter(|(name, value)| !possible(name) && usual.get(name.as_str()) != Some(*value));
    let other: Vec<_> = other.map(|(name, value)| format!("{name}={value}")).collect();
    (!other.is_empty()).then(|| other.join(","))
}

/// How many pictures were taken in the track's direction, and how many the other way round.
fn both_ways(drive: &LocatedDrive) -> [usize; 2] {
    let places = || drive.places.iter().flatten();
    let backwards = places().filter(|at| at.pose.direction() < 0.0).count();
    [places().count() - backwards, backwards]
}

/// What is left out of each recording, as it was taken on another road than this one, or the other way round.
fn left_out(drives: &[(PathBuf, LocatedDrive)], road: &str, reversed: bool) -> Vec<String> {
    let mut told = vec![];
    for (path, drive) in drives {
        let there = &drive.track.file().name;
        let of = drives.iter().filter(|(other, _)| other == path);
        let all: usize = of.flat_map(|(_, drive)| both_ways(drive)).sum();
        for (way, number) in [false, true].into_iter().zip(both_ways(drive)) {
            if number == 0 || (there == road && way == reversed) {
                continue;
            }
            let number = if number == all { "all".to_owned() } else { format!("{number} of") };
            let (path, all) = (path.display(), count(all, "located picture"));
            let (there, here) = (words(there, way), words(road, reversed));
            told.push(format!("{path}: leaving out {number} {all}, taken on {there}: the road is {here}"));
        }
    }
    told
}

/// What is said of a recording of whose moments so many, out of all, lack side cameras.
pub(super) fn no_sides((without, all): (usize, usize)) -> Option<String> {
    let some = if without < all { format!(" in {without} of {}", count(all, "picture")) } else { String::new() };
    (without > 0).then(|| format!("no side cameras{some}, so more is filled in the further the car is off"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use lapwing_sim::locate::{Located, Pose};

    /// A drive on a road, of so many pictures, and as many the other way round.
    fn drive(road: &str, [forwards, backwards]: [usize; 2]) -> LocatedDrive {
        let track = Arc::new(Track::open(road).unwrap());
        let place = |reversed| Some(Located::known(Pose::from_lane(&track, 9.0, reversed, 0.0, 0.0)));
        let places = [vec![place(false); forwards], vec![None], vec![place(true); backwards]].concat();
        LocatedDrive { places, track }
    }

    #[test]
    fn what_is_left_out_is_told_for_each_recording_and_road() {
        let of = |path: &str, road: &str, pictures: [usize; 2]| (PathBuf::from(path), drive(road, pictures));
        let drives = [
            of("first", "lake", [700, 10]),
            of("clockwise", "lake", [0, 700]),
            of("joined", "jungle", [40, 0]),
            of("joined", "lake", [5, 0]),
        ];
        let told = left_out(&drives, "lake", false);
        assert_eq!(
            told,
            [
                "first: leaving out 10 of 710 located pictures, taken on lake, the other way round: the road is lake",
                "clockwise: leaving out all 700 located pictures, taken on lake, the other way round: the road is lake",
                "joined: leaving out 40 of 45 located pictures, taken on jungle: the road is lake",
            ]
        );
        let told = left_out(&drives[..2], "lake", true);
        let one =
            "first: leaving out 700 of 710 located pictures, taken on lake: the road is lake, the other way round";
        assert_eq!(told, [one]);
    }

    #[test]
    fn missing_side_cameras_are_told_with_how_many() {
        let told = |without| no_sides((without, 9)).unwrap_or_default();
        assert_eq!(told(0), "");
        assert_eq!(told(2), "no side cameras in 2 of 9 pictures, so more is filled in the further the car is off");
        assert_eq!(told(9), "no side cameras, so more is filled in the further the car is off");
    }

    #[test]
    fn conditions_that_recordings_have_are_named() {
        let asked = Conditions { rain: 0.5, latency_ms: 80.0, ..Conditions::default() };
        assert_eq!(light_and_weather(&asked).as_deref(), Some("rain=0.5"));
        assert_eq!(light_and_weather(&Conditions { latency_ms: 80.0, dropped: 0.1, ..Conditions::default() }), None);
    }
}
