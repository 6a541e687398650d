//! `lapwing locate`: where a recording was driven, and where in its lane the car was in each picture.

use std::{
    io::{self, IsTerminal},
    path::{Path, PathBuf},
    time::Duration,
};

use indicatif::{ProgressBar, ProgressStyle};

use super::{Ended, outputs};
#[cfg(feature = "networks")]
use crate::locating::network::look;
use crate::{
    cli,
    known::Roads,
    locating::{Driven, LocateError, LocatedRecording, Summary, again, drawn, truth_of},
};
use lapwing_core::{
    recording::{CameraPosition, Recording, RecordingError},
    words::count,
};
#[cfg(feature = "networks")]
use lapwing_learn::models::LaneModel;
use lapwing_sim::track::Track;

pub(super) fn run(arguments: &cli::Locate) -> anyhow::Result<Ended> {
    arguments.tracks.iter().try_for_each(|name| Track::open(name).map(drop))?;
    let inputs = [Some(&arguments.recording), arguments.truth.as_ref()].into_iter().flatten().map(PathBuf::as_path);
    outputs::check_apart([&arguments.csv, &arguments.frames, &arguments.plot].into_iter().flatten())?;
    arguments.csv.as_deref().map_or(Ok(()), |csv| outputs::check_beside(csv, inputs))?;
    [&arguments.frames, &arguments.plot].into_iter().flatten().try_for_each(|path| outputs::check_drawing(path))?;
    let roads = Roads::with(&arguments.tracks);
    warn_of_assumed_times(&arguments.recording)?;
    #[cfg(feature = "networks")]
    let network = arguments.network.as_ref().map(LaneModel::load).transpose()?;
    let truth = arguments.truth.as_ref().map(|path| truth_of(&arguments.recording, path, &roads)).transpose()?;
    let driven = found(&arguments.recording, &roads)?;
    let of = |name: &str, camera: CameraPosition| -> anyhow::Result<LocatedRecording> {
        let mut found = located(&driven, camera)?;
        #[cfg(feature = "networks")]
        if let Some(model) = &network {
            let bar = bar();
            found.network = Some(look(&arguments.recording, camera, model, || bar.inc(1))?);
            bar.finish_and_clear();
        }
        if let Some(truth) = &truth {
            let elsewhere = found.tell(truth);
            if elsewhere > 0 {
                let pictures = count(elsewhere, "picture");
                say!("{name} camera: {pictures} not compared: --truth places them on another road");
            }
        }
        if let (number, Some(why)) = &found.unreadable {
            let pictures = count(*number, "picture");
            say!("{name} camera: {pictures} could not be looked at, the first: {why}");
        }
        Ok(found)
    };
    let mut found = of("centre", CameraPosition::Center)?;
    if let Some(drive) = found.drive() {
        let bar = bar();
        found.laps = again::look(&arguments.recording, &drive, found.network.as_ref(), || bar.inc(1))?;
        bar.finish_and_clear();
    }
    let sides = if arguments.sides {
        Some([of("left", CameraPosition::Left)?, of("right", CameraPosition::Right)?])
    } else {
        None
    };
    let source = arguments.recording.display().to_string();
    let summary = Summary::new(source, &found, sides.as_ref());
    // A failed write does not affect the other results.
    let written = [
        arguments.csv.as_deref().map(|path| outputs::write(path, &found.csv())),
        arguments.frames.as_deref().map(|path| Ok(drawn::frames(&arguments.recording, &found)?.write(path)?)),
        arguments.plot.as_deref().map(|path| Ok(drawn::weaving(&found).write(path)?)),
    ];
    let printed = if arguments.json {
        super::print(&serde_json::to_string_pretty(&summary)?)
    } else {
        super::print(&summary.to_string())
    };
    written.into_iter().flatten().collect::<anyhow::Result<()>>()?;
    printed?;
    let nothing = summary.drives.iter().all(|drive| {
        let seen = drive.network.as_ref().is_some_and(|network| network.seen > 0.0);
        !seen && drive.on.as_ref().is_none_or(|on| on.located == 0.0)
    });
    Ok(if nothing { Ended::Failed } else { Ended::Passed })
}

/// Says so if the times of a recording's pictures are assumed.
pub(super) fn warn_of_assumed_times(path: &Path) -> Result<(), RecordingError> {
    if let Some(note) = assumed_times(path)? {
        say!("warning: {}: {note}", path.display());
    }
    Ok(())
}

/// What to say if the times of a recording's pictures are assumed, on which all depends that follows how the car moved.
pub(super) fn assumed_times(path: &Path) -> Result<Option<String>, RecordingError> {
    let untimed = Recording::open(path)?.untimed();
    let pictures = count(untimed, "picture");
    Ok((untimed > 0).then(|| {
        format!(
            "the names of {pictures} hold no time, so 15 a second are assumed: if it was another number, places and distances are \
             wrong, and pictures may not be located; name them as the simulator does (center_YYYY_MM_DD_HH_MM_SS_mmm.jpg)"
        )
    }))
}

/// Locates a recording by its centre camera, with a line of progress.
pub(super) fn centre(path: &Path, roads: &Roads) -> Result<LocatedRecording, LocateError> {
    located(&found(path, roads)?, CameraPosition::Center)
}

/// Looks where a recording was driven, with a line of progress.
fn found(path: &Path, roads: &Roads) -> Result<Driven, LocateError> {
    let bar = bar();
    let found = Driven::find(path, roads, || bar.inc(1));
    bar.finish_and_clear();
    found
}

/// Locates the pictures of a camera, with a line of progress.
fn located(driven: &Driven, camera: CameraPosition) -> Result<LocatedRecording, LocateError> {
    let bar = bar();
    let found = driven.locate(camera, || bar.inc(1));
    bar.finish_and_clear();
    found
}

/// A line of progress, if stderr is a terminal.
fn bar() -> ProgressBar {
    if !io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{spinner} {pos} pictures located, {per_sec}, {elapsed}");
    let bar = ProgressBar::new_spinner().with_style(style.expect("the template is written here"));
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}
