//! A verb's results, printed or in a file, and its diagnostics.
//!
//! A result that could not be delivered is a failure (exit status 1), whatever else the verb achieved. Files to write
//! at the end are checked before the beginning: their format, and whether they can be written.

use std::{
    error::Error,
    ffi::OsStr,
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
#[cfg(feature = "networks")]
use serde::Serialize;

#[cfg(feature = "simulator")]
use crate::film::{Film, FilmError};
use lapwing_core::{
    config::ConfigError,
    files,
    recording::{is_run_name, udacity},
};
#[cfg(feature = "networks")]
use lapwing_learn::{
    braking::{BrakingModelError, BrakingTrainError},
    dataset::DatasetError,
    marl::MarlError,
    train::TrainError,
};
use lapwing_score::{
    drawing::{self, DrawingError},
    suite::SuiteError,
};
#[cfg(feature = "simulator")]
use lapwing_sim::{conditions::ConditionsError, scenario::ScenarioError, spec::SpecError, track::TrackError};

/// The result is lost: stdout's disk is full, or its reader is gone.
#[derive(Debug, thiserror::Error)]
#[error("the result could not be printed: {0}")]
pub(super) struct Unprinted(io::Error);

/// Wrong usage that no other error says.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(super) struct Usage(pub(super) String);

/// Prints a result, whole.
///
/// # Errors
/// [`Unprinted`], also if the reader has closed the pipe.
pub(super) fn print(text: &str) -> Result<(), Unprinted> {
    let (mut stdout, text) = (io::stdout().lock(), super::terminal::uncontrolled(text));
    writeln!(stdout, "{text}").and_then(|()| stdout.flush()).map_err(Unprinted)
}

/// A result as JSON, the keys of its objects in alphabetical order.
#[cfg(feature = "networks")]
pub(super) fn sorted_json(result: &impl Serialize) -> Result<String, serde_json::Error> {
    serde_json::to_string_pretty(&serde_json::to_value(result)?)
}

/// Whether a result could be written into a file at the end of the work. It never overwrites a recording, a network, or settings,
/// a recipe or a road in TOML.
pub(super) fn check(path: &Path) -> anyhow::Result<()> {
    let what = match path.extension().and_then(OsStr::to_str) {
        Some("safetensors" | "onnx" | "pt") => Some("a network"),
        Some("toml") => Some("a TOML file"),
        _ => None,
    };
    if let Some(what) = what.filter(|_| path.is_file()) {
        bail!("{}: it is {what}, which would be lost; name another file", cannot(path));
    }
    check_any(path)
}

/// Whether a file could be written. No recording is ever overwritten.
fn check_any(path: &Path) -> anyhow::Result<()> {
    if is_recording(path) {
        bail!("{}: it is a recording, which would be lost; name another file", cannot(path));
    }
    files::check(path).with_context(|| cannot(path))
}

/// Whether a result could be written into a file that is none of those from which the work begins.
pub(super) fn check_beside<'a>(path: &Path, inputs: impl IntoIterator<Item = &'a Path>) -> anyhow::Result<()> {
    check_is_no_input(path, inputs)?;
    check(path)
}

/// Whether a network could be, which may replace another one.
#[cfg(feature = "networks")]
pub(super) fn check_network<'a>(path: &Path, inputs: impl IntoIterator<Item = &'a Path>) -> anyhow::Result<()> {
    check_is_no_input(path, inputs)?;
    check_any(path)
}

fn check_is_no_input<'a>(path: &Path, inputs: impl IntoIterator<Item = &'a Path>) -> anyhow::Result<()> {
    let own = place(path);
    if own.is_some() && inputs.into_iter().any(|input| place(input) == own) {
        bail!("{}: it is also an input, which would be lost; name another file", cannot(path));
    }
    Ok(())
}

/// Whether each of these results has a file of its own: the last one written would replace the others.
pub(super) fn check_apart<'a>(paths: impl IntoIterator<Item = &'a PathBuf>) -> Result<(), Usage> {
    let mut places = vec![];
    // Of what is no file, such as a terminal, nothing is replaced.
    for path in paths.into_iter().filter(|path| !path.exists() || path.is_file()) {
        let own = place(path);
        if own.is_some() && places.contains(&own) {
            let path = path.display();
            return Err(Usage(format!("{path}: expected a different file for each result, got this one twice")));
        }
        places.push(own);
    }
    Ok(())
}

/// Where a file is, or would be; `None` if there is no such folder.
pub(super) fn place(path: &Path) -> Option<PathBuf> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let new = || Some(fs::canonicalize(folder).ok()?.join(path.file_name()?));
    fs::canonicalize(path).ok().or_else(new)
}

/// Whether a file is there that is called as recordings are; a link is what it leads to.
fn is_recording(path: &Path) -> bool {
    fs::canonicalize(path).is_ok_and(|path| {
        path.is_file() && (is_run_name(&path) || path.file_name().is_some_and(|name| name == udacity::LOG_NAME))
    })
}

/// Whether a drawing could be.
pub(super) fn check_drawing(path: &Path) -> anyhow::Result<()> {
    drawing::SheetFormat::of(path)?;
    check(path)
}

/// Whether a film could be.
#[cfg(feature = "simulator")]
pub(super) fn check_film(path: &Path) -> anyhow::Result<()> {
    Ok(Film::check(path)?)
}

/// Whether a folder could be made, or files in it.
pub(super) fn check_folder(path: &Path) -> anyhow::Result<()> {
    files::check_folder(path).with_context(|| cannot(path))
}

/// Writes a file, whole or not at all.
pub(super) fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    files::write(path, text.as_bytes()).with_context(|| cannot(path))
}

fn cannot(path: &Path) -> String {
    format!("{}: cannot be written", path.display())
}

/// Whether an error says that something was asked for that does not exist (exit status 2): a setting, a track, a scenario,
/// conditions, a format.
pub(super) fn is_usage(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        cause.is::<ConfigError>()
            || cause.is::<SuiteError>()
            || cause.is::<Usage>()
            || matches!(cause.downcast_ref(), Some(DrawingError::Kind { .. }))
            || is_usage_of_networks(cause)
            || is_usage_of_the_simulator(cause)
    })
}

#[cfg(feature = "networks")]
fn is_usage_of_networks(cause: &(dyn Error + 'static)) -> bool {
    use DatasetError::{Selected, Setting, Target};
    let is_of_data = |error: &DatasetError| matches!(error, Setting { .. } | Selected { .. } | Target { .. });
    matches!(cause.downcast_ref(), Some(MarlError::Setting { .. } | MarlError::Recipe { .. }))
        || matches!(cause.downcast_ref(), Some(BrakingModelError::Threshold { .. }))
        || matches!(cause.downcast_ref(), Some(BrakingTrainError::Setting { .. } | BrakingTrainError::Recipe(_)))
        || cause.downcast_ref().is_some_and(|error| match error {
            TrainError::Setting { .. } | TrainError::Recipe(_) => true,
            TrainError::Dataset(error) => is_of_data(error),
            _ => false,
        })
        || cause.downcast_ref().is_some_and(is_of_data)
}

#[cfg(not(feature = "networks"))]
fn is_usage_of_networks(_: &(dyn Error + 'static)) -> bool {
    false
}

#[cfg(feature = "simulator")]
fn is_usage_of_the_simulator(cause: &(dyn Error + 'static)) -> bool {
    cause.is::<ConditionsError>()
        || cause.is::<ScenarioError>()
        || cause.is::<SpecError>()
        || cause.is::<TrackError>()
        || matches!(cause.downcast_ref(), Some(FilmError::Kind { .. } | FilmError::Rate { .. }))
}

#[cfg(not(feature = "simulator"))]
fn is_usage_of_the_simulator(_: &(dyn Error + 'static)) -> bool {
    false
}
