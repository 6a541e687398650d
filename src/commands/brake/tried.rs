//! `lapwing brake trial`: the closed loop, without and with a guard.

use std::{
    fs,
    io::{self, IsTerminal},
    path::Path,
};

use anyhow::{Context, bail};
use base64::{Engine, prelude::BASE64_STANDARD};
use indicatif::ProgressBar;

use super::super::{Ended, guards, interrupted, outputs, outputs::Usage, print, undriven_layers};
use crate::{
    cli::BrakeTrial,
    film::{Film, FilmError},
};
use lapwing_core::{guard::GuardModel, perception::Frame, words::count};
use lapwing_score::emergency::trial::{self, TrialDrive, TrialGuard, TrialOutcome, TrialResult};
use lapwing_sim::{
    braking::{Braker, Case, Kind, Layer, Outcome, Places, Trial, TrialOptions, Tried, trials, try_all},
    camera::{Camera, Renderer},
};

/// Telemetries a second.
const HZ: f64 = 15.0;
/// The size of a film, in pixels, and which of the telemetries it shows: one in two, and no more than 40 s of laps. So a page with
/// all films is a few megabytes.
const FILM: (usize, usize) = (320, 180);
const SHOWN: u32 = 2;
const MOST_SHOWN: u32 = 300;

/// The result, in its folder.
const RESULT_NAME: &str = "trial.json";

pub(super) fn run(arguments: &BrakeTrial, config: Option<&Path>) -> anyhow::Result<Ended> {
    arguments.out.as_deref().map_or(Ok(()), check_new)?;
    let settings = guards::layers(undriven_layers(config)?, &arguments.guard)?.resolve()?;
    // Other numbers of threads round differently, and the drives are on all processors as it is.
    #[cfg(feature = "networks")]
    lapwing_learn::nn::runtime::set_threads(1);
    let guard = guards::load(&settings.brake)?;
    let guard = guard.as_deref();
    let interrupted = interrupted();
    let defaults = TrialOptions::default();
    let options = TrialOptions {
        cases: chosen(&arguments.cases, defaults.cases),
        layers: chosen(&arguments.layers, defaults.layers),
        speeds_mph: chosen(&arguments.speeds, defaults.speeds_mph),
        seeds: arguments.seeds,
        laps: arguments.laps,
        part: arguments.part,
    };
    check_layers(&options)?;
    let (planned, mut places) = (trials(&options), Places::default());
    let bar = if io::stderr().is_terminal() { ProgressBar::new(1) } else { ProgressBar::hidden() };
    let tried = try_all(&planned, guard, &mut places, |done, of| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
        !interrupted.is_pressed()
    })?;
    bar.finish_and_clear();
    let result = TrialResult {
        planned: planned.len(),
        interrupted: tried.len() < planned.len(),
        ..TrialResult::of(guard.map(told_of), arguments.part.name(), tried.iter().map(driven).collect())
    };
    let json = serde_json::to_string_pretty(&result)?;
    // Of no drive there is nothing to keep.
    if let Some(folder) = arguments.out.as_ref().filter(|_| !tried.is_empty()) {
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        outputs::write(&folder.join(RESULT_NAME), &json)?;
        let films = films(&result, &tried, guard, &places, folder)?;
        outputs::write(&folder.join("trial.html"), &trial::render(&result, &films))?;
    }
    print(&if arguments.json { json } else { result.to_string() })?;
    Ok(if result.interrupted { Ended::Failed } else { Ended::Passed })
}

/// Whether a trial can be written into a folder, and none is there.
fn check_new(folder: &Path) -> anyhow::Result<()> {
    let result = folder.join(RESULT_NAME);
    if result.symlink_metadata().is_ok() {
        bail!("{} is the result of an earlier trial: nothing is overwritten, choose another folder", result.display());
    }
    outputs::check_folder(folder)
}

/// Says which cases are left out, as they have none of the layers; at least one must remain.
fn check_layers(options: &TrialOptions) -> Result<(), Usage> {
    let (left_out, layers) = (options.left_out(), listed(&options.layers));
    if left_out.is_empty() {
        return Ok(());
    }
    let named = listed(&left_out);
    if left_out.len() == options.cases.len() {
        let own: Vec<Layer> = Layer::ALL.into_iter().filter(|layer| plays(&left_out, *layer)).collect();
        let own = listed(&own);
        return Err(Usage(format!("--layers: expected layers of {named}, which are {own}, got {layers}")));
    }
    say!("left out, because they have none of the layers {layers}: {named}");
    Ok(())
}

/// Whether one of the cases has this layer.
fn plays(cases: &[Case], layer: Layer) -> bool {
    cases.iter().any(|case| case.layers().any(|own| own == layer))
}

/// Names, one after the other.
fn listed(all: &[impl ToString]) -> String {
    all.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

/// What a trial says about its guard.
fn told_of(guard: &dyn GuardModel) -> TrialGuard {
    TrialGuard {
        name: guard.name().to_owned(),
        threshold: guard.guard().limits().fires,
        sha256: guard.sha256().map(str::to_owned),
    }
}

/// What was asked for, each once: twice, the same drives would count twice. If nothing was, the default.
fn chosen<T: Clone + PartialEq>(asked: &[T], default: Vec<T>) -> Vec<T> {
    let mut each = Vec::new();
    for one in asked {
        if !each.contains(one) {
            each.push(one.clone());
        }
    }
    if each.is_empty() { default } else { each }
}

/// A drive, as it is counted.
fn driven(tried: &Tried) -> TrialDrive {
    let Tried { trial, without, perfect, with } = tried;
    let told = |outcome: &Outcome| TrialOutcome {
        impact_mph: outcome.impact_mph,
        reduction_mph: outcome.reduction_mph,
        activations: outcome.activations,
        braked_s: outcome.braked_s,
        hardest_g: outcome.hardest_g,
        time_s: outcome.frames as f64 / HZ,
    };
    TrialDrive {
        case: trial.case.to_string(),
        hazard: trial.case.kind() == Kind::Hazard,
        layer: trial.layer.to_string(),
        track: trial.track.clone(),
        speed_mph: trial.speed_mph,
        seed: trial.seed,
        laps: trial.laps,
        without: told(without),
        avoidable: perfect.as_ref().map(|perfect| perfect.impact_mph.is_none()),
        with: with.as_ref().map(told),
    }
}

/// The film of the worst drive of each case, in `FOLDER/films` and as text.
fn films(
    result: &TrialResult,
    tried: &[Tried],
    guard: Option<&dyn GuardModel>,
    places: &Places,
    folder: &Path,
) -> anyhow::Result<Vec<trial::Film>> {
    let (media, ending) = if cfg!(feature = "films") { ("video/mp4", "mp4") } else { ("image/gif", "gif") };
    let folder = folder.join("films");
    fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    let mut made = vec![];
    for case in Case::ALL {
        let Some(worst) = result.worst(case.name()) else { continue };
        let same = |tried: &&Tried| {
            let Trial { case, seed, track, speed_mph, .. } = &tried.trial;
            (case.name(), *seed, track, *speed_mph) == (worst.case.as_str(), worst.seed, &worst.track, worst.speed_mph)
        };
        let Some(Tried { trial, .. }) = tried.iter().find(same) else { continue };
        let path = folder.join(format!("{case}.{ending}"));
        film(trial, guard, places, &path)?;
        let bytes = fs::read(&path).with_context(|| path.display().to_string())?;
        made.push(trial::Film {
            title: format!("{case}, {}, {} mph, {}, seed {}", worst.layer, worst.speed_mph, worst.track, worst.seed),
            told: told(worst),
            media,
            base64: BASE64_STANDARD.encode(bytes),
        });
    }
    Ok(made)
}

/// What came of a drive, in words.
fn told(drive: &TrialDrive) -> String {
    let TrialOutcome { impact_mph, activations, hardest_g, .. } = drive.with.unwrap_or(drive.without);
    let hit = impact_mph.map_or("nothing was hit".into(), |mph| format!("hit at {mph:.1} mph"));
    let avoidable = match drive.avoidable {
        Some(false) => ", which could not be avoided",
        _ => "",
    };
    let braked = if activations > 0 {
        format!("; the guard braked {}, {hardest_g:.2} g", count(activations, "time"))
    } else {
        String::new()
    };
    format!("{hit}{avoidable}{braked}")
}

fn film(trial: &Trial, guard: Option<&dyn GuardModel>, places: &Places, path: &Path) -> anyhow::Result<()> {
    let braker = guard.map_or(Braker::Nobody, Braker::Guard);
    let (mut film, mut drawn, mut telemetries) = (Film::create(path, FILM.0, FILM.1, HZ / f64::from(SHOWN))?, None, 0);
    let (camera, mut frame) = (Camera::follow(FILM.0, FILM.1), Frame::default());
    trial.drive(places, braker, &mut |world| {
        let renderer = drawn.get_or_insert_with(|| Renderer::new(world.setup().scenery.clone()));
        telemetries += 1;
        if telemetries % SHOWN != 1 || telemetries / SHOWN >= MOST_SHOWN {
            return Ok(());
        }
        world.draw(renderer, &camera, &mut frame);
        film.frame(&frame).map_err(|error: FilmError| error.into())
    })?;
    film.finish()?;
    Ok(())
}
