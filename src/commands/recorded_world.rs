//! The world of `drive --world`: a known road, and what recordings show of it.

use std::{
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
};

use anyhow::bail;

use crate::{known::Roads, locating::from_table};
use lapwing_core::{config::ConfigError, recording::CameraPosition, words::count};
use lapwing_score::results::Seen;
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
        let Conditions { latency_ms, dropped, .. } = setup.conditions;
        if setup.conditions != (Conditions { latency_ms, dropped, ..Conditions::default() }) {
            let why = "expected latency_ms or dropped with --world: light and weather are those of the recordings";
            return Err(ConfigError::Value { layer: "--conditions".into(), why: why.into() }.into());
        }
        if !lanes.is_empty() && lanes.len() != recordings.len() {
            let recordings = count(recordings.len(), "recording");
            let why = format!("expected one file for each of {recordings}, got {}", lanes.len());
            return Err(ConfigError::Value { layer: "--lane".into(), why }.into());
        }
        let roads = Roads::with(&track.into_iter().map(str::to_owned).collect::<Vec<_>>());
        let mut drives = vec![];
        for (i, path) in recordings.iter().enumerate() {
            if let Some(table) = lanes.get(i) {
                drives.push((path.clone(), from_table(path, table, &roads)?));
                continue;
            }
            match super::locate::located(path, CameraPosition::Center, &roads)?.drive() {
                Some(drive) => drives.push((path.clone(), drive)),
                None => bail!(
                    "{}: expected a drive on a known road, got none (lapwing locate says more): if it was on another \
                     road, name that with --track FILE.toml",
                    path.display()
                ),
            }
        }
        let wanted = track.map(|name| Track::open(name).map(|track| track.file().name.clone())).transpose()?;
        let places = |of: &dyn Fn(&LocatedDrive, f64) -> bool| {
            let each = drives.iter().flat_map(|(_, drive)| drive.places.iter().flatten().map(move |at| (drive, at)));
            each.filter(|(drive, at)| of(drive, at.pose.direction())).count()
        };
        let most = drives.iter().map(|(_, drive)| &drive.track).max_by_key(|track| {
            let name = &track.file().name;
            (wanted.as_ref() == Some(name), places(&|drive, _| drive.track.file().name == *name))
        });
        let Some(road) = most.cloned() else { bail!("--world: expected a recording") };
        let name = &road.file().name;
        if let Some(wanted) = wanted.filter(|wanted| wanted != name) {
            bail!("--world: expected drives on {wanted}, got some on {name}");
        }
        let along = |reversed: bool| {
            places(&|drive, direction| drive.track.file().name == *name && (direction < 0.0) == reversed)
        };
        let (forwards, backwards) = (along(false), along(true));
        let all = places(&|_, _| true);
        let reversed = backwards > forwards;
        let moments = forwards.max(backwards);
        let way = if reversed { ", the other way round" } else { "" };
        if all > moments {
            let left_out = count(all - moments, "picture");
            say!("--world: {left_out} of another road or direction than {name}{way} are left out");
        }
        drives.retain(|(_, drive)| drive.track.file().name == *name);
        let views = Views::open(&road, reversed, &drives)?;
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
        let each = f64::from(sights.recorded.max(1));
        if let (number, Some(why)) = &sights.unusable {
            say!("--world: {number} recorded pictures could not be used, the first: {why}");
        }
        Seen {
            moments: self.moments,
            covered: self.covered,
            recorded: sights.recorded,
            drawn: sights.drawn,
            apart_m: sights.apart_m / each,
            filled_mean: sights.filled.0 / each,
            filled_most: sights.filled.1,
        }
    }
}
