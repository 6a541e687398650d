//! `lapwing replay --closed-loop`: drive along a recording.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use anyhow::Context;
use serde_json::json;

use super::{
    Ended, outputs,
    recorded_world::no_sides,
    replay::{ReplayBar, with_flag_hint},
    thresholds,
};
use crate::{
    cli,
    film::Film,
    known::Roads,
    locating::{self, LocateError, Part},
};
use lapwing_core::{
    config::ConfigError,
    drive::{DriveDigest, Eventful, Observer, ObserverError},
    driver::Driver,
    perception::Frame,
    protocol::Dialect,
    recording::{ModelId, Recorder, RecorderOptions, RunHeader},
    turn::Turn,
    words::count,
};
use lapwing_score::judged::{self, Judged};
use lapwing_score::results::{Along, AlongRows, ScoredDrive};
use lapwing_score::score::{self, Figure};
use lapwing_sim::{
    along::{ClosedLoopError, Limit, Measured, Protocol, RecordedWorld, SIZE, Sights, Sources, Yaw},
    locate::LocatedDrive,
    track::Track,
};

/// The limits of the Rally Estonia study.
const RALLY_ESTONIA_M: [Limit; 2] = [Limit::Metres(1.0), Limit::Metres(2.0)];
/// How many times larger a film is than the picture, along and across.
const ENLARGED: usize = 2;
/// How long an intervention is shown in a film, in seconds.
const SHOWN_S: f64 = 0.5;

pub(super) fn run(arguments: &cli::Replay, config: Option<&Path>) -> anyhow::Result<Ended> {
    let layers = thresholds::layers(super::layers(config, &arguments.driving)?, &arguments.thresholds)?;
    let mut settings = layers.resolve()?;
    arguments.film.as_deref().map_or(Ok(()), outputs::check_film)?;
    arguments.recordings.as_deref().map_or(Ok(()), outputs::check_folder)?;
    settings.model.threads = 1; // as `drive`: the same bytes everywhere
    let model = super::load_model(&settings)?;
    super::suits_our_cameras(&model)?;
    let name = model.name().to_owned();
    let source = arguments.source.display().to_string();
    let yaw = if arguments.by_steering { Yaw::Steering } else { Yaw::Pictures };
    let (protocol, limit) = (arguments.protocol.into(), limit(arguments)?);
    let open = |located| {
        let rows = arguments.rows.clone().unwrap_or(0..usize::MAX);
        RecordedWorld::within(&arguments.source, rows, limit, yaw, located).map_err(by_flag)
    };
    // To locate takes minutes: what cannot be driven along is told before.
    open(None)?;
    let mut notes = Vec::from_iter(super::locate::assumed_times(&arguments.source)?);
    let (located, of_lane) = if arguments.from_path { (None, vec![]) } else { located(arguments)? };
    notes.extend(of_lane);
    for note in &notes {
        say!("warning: {source}: {note}");
    }
    let gearing = located.as_ref().map_or(Ok(1.0), |drive| locating::gearing(&arguments.source, drive))?;
    let mut world = open(located)?.by(protocol).geared(gearing);
    if arguments.limit == Some(Limit::Road) && !world.knows_the_lane_somewhere() {
        let why = "road needs a known lane, and the lane is not known in any row: give a number of metres, such as 1, or name the road \
                   with --track FILE.toml";
        return Err(ConfigError::Value { layer: "--limit".into(), why: why.into() }.into());
    }
    let limit = world.limit();
    let (rows, read, stood) = world.rows();
    let config = json!({
        "settings": settings,
        "world": {
            "closed_loop_on": source,
            "limit": limit.key(),
            "limit_m": limit.metres(),
            "protocol": protocol.key(),
            "from_path": arguments.from_path,
            "by_steering": arguments.by_steering,
            "gearing": gearing,
            "rows": arguments.rows.as_ref().map(|rows| [rows.start, rows.end]),
        },
    });
    let header = RunHeader {
        name_hint: Some(format!("{}-closed-loop", world.name())),
        dialect: Some(Dialect::SelfOracle),
        model: Some(ModelId::of(&model)),
        ..RunHeader::new(world.kind(), config, jiff::Timestamp::now())
    };
    let mut film = arguments.film.as_deref().map(|path| PilotFilm::new(path, &world)).transpose()?;
    let mut driver = Driver::new(model.pilot(), &settings.control, Instant::now);
    // Last, so that an earlier failure leaves no run.
    let options = RecorderOptions { queue: settings.recording.queue, ..RecorderOptions::default() };
    let recorder = arguments.recordings.as_deref().map(|dir| Recorder::create(dir, header, options)).transpose()?;
    let (mut bar, mut interrupted) = (ReplayBar::new(Some(rows as u64)), super::interrupted());
    let began = Instant::now();
    let observers: &mut [&mut dyn Observer<_>] = &mut [&mut recorder.as_ref(), &mut bar, &mut interrupted, &mut film];
    let judged = judged::run(&mut world, &mut driver, observers);
    let wall = began.elapsed();
    let report = recorder.and_then(super::close);
    let Judged { mut card, driven } = judged.with_context(|| source.clone())?;
    card.notes.extend(notes);
    let DriveDigest { fingerprint, frames, bad_frames, .. } = &driven;
    let filmed = film.map(|film| film.film.finish()).transpose();
    let missed = score::missed(&settings.thresholds, &card);
    let Sources { lane, pictures, steering } = world.sources();
    let Sights { recorded, apart_m, filled: (filled, filled_most), .. } = *world.sights();
    let [apart_m, filled_mean] = [apart_m, filled].map(|sum| sum / f64::from(recorded.max(1)));
    let of_another_lap = world.of_another_lap();
    let run = report.as_ref().map(|report| report.path.display().to_string());
    let result = if arguments.json {
        let how = AlongRows {
            frames: *frames,
            unseen_frames: *bad_frames,
            rows_read: read,
            rows_standing: stood,
            turned_by_lane: lane,
            turned_by_pictures: pictures,
            turned_by_steering: steering,
            gearing,
            of_another_lap,
            apart_m,
            filled_mean,
            filled_most,
            fingerprint,
            times_real_time: card.value(Figure::TimeS).unwrap_or(0.0) / wall.as_secs_f64().max(1e-9),
            run,
        };
        let (limit, limit_m) = (limit.key(), limit.metres());
        let who = Along { pilot: &name, source: &source, limit, limit_m, protocol: protocol.key() };
        serde_json::to_string_pretty(&ScoredDrive { who, card: &card, how, missed: &missed })?
    } else {
        let unseen = match bad_frames {
            0 => String::new(),
            bad => format!("; no network saw {bad} of them"),
        };
        let line = |label: &str, what: String| format!("\n  {label:<17} {what}");
        let further = match protocol {
            Protocol::Dave2 => "",
            Protocol::RallyEstonia => ", two seconds further on",
        };
        let or_path = match limit {
            Limit::Road if !world.knows_the_lane() => {
                format!(", or {} m from the recorded path where the lane is not known", limit.metres())
            }
            Limit::Metres(_) if arguments.limit.is_none() && protocol == Protocol::Dave2 && !arguments.from_path => {
                let known = if world.knows_the_lane_somewhere() { "along most of the way" } else { "anywhere" };
                format!(", as the lane is not known {known}")
            }
            _ => String::new(),
        };
        let mut text = format!("{name} along {source}, put back beyond {limit}{or_path}{further}\n{card}");
        text += &line(
            "frames",
            format!(
                "{frames} in {:.1} s, {:.0}/s{unseen}; the car is stationary in {stood} of {read}",
                wall.as_secs_f64(),
                *frames as f64 / wall.as_secs_f64().max(1e-9)
            ),
        );
        let turning =
            format!("from the lane {}, from pictures {pictures}, from steering {steering}", count(lane, "time"));
        text += &line("recorded turning", turning);
        if (gearing - 1.0_f64).abs() >= 0.005 {
            let turned =
                format!("both cars turn {gearing:.2} times as far as the simulator's, as the recorded one did");
            text += &line("gearing", turned);
        }
        let another = 100.0 * f64::from(of_another_lap) / f64::from(recorded.max(1));
        let taken = format!("{apart_m:.2} m away on average; {of_another_lap} ({another:.1} %) in another lap");
        text += &line("pictures taken", taken);
        let [mean, most] = [filled_mean, filled_most].map(|share| 100.0 * share);
        let no_sides = no_sides(world.without_side_cameras()).map_or_else(String::new, |told| format!("; {told}"));
        text += &line("filled in", format!("{mean:.1} % of rows 60 to 134 on average, {most:.1} % at most{no_sides}"));
        text += &line("fingerprint", fingerprint[..16].to_owned());
        text += &run.map_or_else(String::new, |run| line("run", run));
        if let Ok(Some(place)) = &filmed {
            text += &line("film", place.clone());
        }
        text
    };
    let printed = super::print(&result);
    let ended = thresholds::ended_whole(&card, &settings.thresholds, &missed);
    super::whole(report)?;
    filmed?;
    printed?;
    match driven.bad_in_words() {
        Some(Err(too_many)) if !arguments.allow_bad_frames => {
            say!("{}: {}", arguments.source.display(), with_flag_hint(&too_many));
            Ok(Ended::Failed)
        }
        _ => Ok(ended),
    }
}

/// Where the recording was driven, if it was on a known road: of several, on the one that most of the rows show; and why the lane is
/// not known elsewhere.
fn located(arguments: &cli::Replay) -> anyhow::Result<(Option<LocatedDrive>, Vec<String>)> {
    arguments.tracks.iter().try_for_each(|name| Track::open(name).map(drop))?;
    let roads = Roads::with(&arguments.tracks);
    let rows = arguments.rows.clone().unwrap_or(0..usize::MAX);
    let from_path = "there, offsets are from the recorded path";
    let mut notes = vec![];
    let drives = match &arguments.lane {
        Some(table) => locating::table_of(&arguments.source, table, &roads)?.drives(),
        None => match super::locate::centre(&arguments.source, &roads) {
            Ok(found) => {
                let is_driven = |part: &&Part| part.rows.start < rows.end && rows.start < part.rows.end;
                notes.extend(found.parts.iter().filter(is_driven).filter_map(|part| {
                    let why = part.unknown.as_ref()?;
                    let [first, last] = [part.rows.start, part.rows.end - 1].map(|row| found.rows[row].moment);
                    Some(format!("the lane is not known in moments {first} to {last}: {why}; {from_path}"))
                }));
                found.drives()
            }
            // The world says the same, in the words of a drive along a recording.
            Err(LocateError::NoPictures { .. } | LocateError::Recording(_)) => vec![],
            Err(error) => return Err(error.into()),
        },
    };
    let known = |drive: &LocatedDrive| {
        let places = drive.places.iter().enumerate();
        places.filter(|(row, place)| place.is_some() && rows.contains(row)).count()
    };
    let all: usize = drives.iter().map(known).sum();
    // `max_by_key` takes the last of several that are equal: reversed, that is the first road.
    let Some(most) = drives.into_iter().rev().max_by_key(known) else { return Ok((None, notes)) };
    if known(&most) < all {
        let elsewhere = count(all - known(&most), "located picture");
        let road = &most.track.file().name;
        notes.push(format!("{elsewhere} taken on another road than {road}: {from_path}; see --rows"));
    }
    Ok((Some(most), notes))
}

/// The flag that an error is about, if it is about one.
fn by_flag(error: ClosedLoopError) -> anyhow::Error {
    match error {
        ClosedLoopError::Rows { rows, got, .. } => {
            let why = format!("expected rows of 0 to {rows}, got {}..{}", got.start, got.end);
            ConfigError::Value { layer: "--rows".into(), why }.into()
        }
        error => error.into(),
    }
}

/// The limit that was asked for, which some protocols prescribe.
fn limit(arguments: &cli::Replay) -> anyhow::Result<Option<Limit>> {
    match (arguments.protocol, arguments.limit) {
        (cli::ProtocolKind::Dave2, Some(Limit::Road)) if arguments.from_path => {
            let why = "expected a number of metres with --from-path, which knows no road, got road: \
                       give metres, such as 1, or leave out --from-path";
            Err(ConfigError::Value { layer: "--limit".into(), why: why.into() }.into())
        }
        (cli::ProtocolKind::Dave2, limit) => Ok(limit),
        (cli::ProtocolKind::RallyEstonia, None) => Ok(Some(Limit::Metres(2.0))),
        (cli::ProtocolKind::RallyEstonia, Some(limit)) if RALLY_ESTONIA_M.contains(&limit) => Ok(Some(limit)),
        (cli::ProtocolKind::RallyEstonia, Some(limit)) => {
            let got = match limit {
                Limit::Road => limit.key().to_owned(),
                Limit::Metres(metres) => metres.to_string(),
            };
            let why = format!("expected 1 or 2 with --protocol rally-estonia, got {got}");
            Err(ConfigError::Value { layer: "--limit".into(), why }.into())
        }
    }
}

/// A film of what the pilot sees, with its offset and heading.
struct PilotFilm {
    film: Film,
    frame: Frame,
    interventions: u32,
    marked_until: Duration,
}

impl PilotFilm {
    fn new(path: &Path, world: &RecordedWorld) -> anyhow::Result<Self> {
        let (width, height) = (SIZE.0 * ENLARGED, SIZE.1 * ENLARGED);
        let frame = Frame::new(width, height, vec![0; width * height * 3]).context("a film without pixels")?;
        let film = Film::create(path, width, height, world.hz())?;
        Ok(Self { film, frame, interventions: 0, marked_until: Duration::ZERO })
    }
}

impl Observer<RecordedWorld> for PilotFilm {
    fn turn(&mut self, world: &RecordedWorld, turn: &Turn) -> Result<(), ObserverError> {
        let at = turn.at();
        let (width, height) = (self.frame.width(), self.frame.height());
        let from = world.picture();
        for (i, pixel) in self.frame.rgb_mut().chunks_exact_mut(3).enumerate() {
            let (x, y) = (i % width / ENLARGED, i / width / ENLARGED);
            pixel.copy_from_slice(&from.pixel(x, y).unwrap_or_default());
        }
        if world.interventions() > self.interventions {
            self.interventions = world.interventions();
            self.marked_until = at + Duration::from_secs_f64(SHOWN_S);
        }
        let mut bar = |left: f64, right: f64, top: usize, bottom: usize, colour: [u8; 3]| {
            let (left, right) = (left.clamp(0.0, width as f64) as usize, right.clamp(0.0, width as f64) as usize);
            for y in top..bottom.min(height) {
                let row = &mut self.frame.rgb_mut()[y * width * 3..(y + 1) * width * 3];
                row[left.min(right) * 3..left.max(right) * 3]
                    .chunks_exact_mut(3)
                    .for_each(|p| p.copy_from_slice(&colour));
            }
        };
        // A scale from limit to limit: the line in between, the car's offset below, its heading as a dash.
        let Measured { offset_m, heading_rad, limits_m: (left_m, right_m), .. } = world.measured();
        let (middle, reach) = (width as f64 / 2.0, width as f64 / 4.0);
        let at_metres = |metres: f64| middle + reach * (2.0 * metres - left_m - right_m) / (right_m - left_m);
        let at_offset = at_metres(offset_m);
        bar(middle - reach, middle + reach, 8, 10, WHITE);
        for tick in [left_m, 0.0, right_m] {
            bar(at_metres(tick) - 1.0, at_metres(tick) + 1.0, 4, 14, WHITE);
        }
        bar(at_offset - 4.0, at_offset + 4.0, 3, 15, YELLOW);
        bar(at_offset, at_offset + reach * heading_rad.to_degrees() / 10.0, 16, 19, YELLOW);
        if at < self.marked_until {
            bar(0.0, width as f64, height - 8, height, RED);
            bar(0.0, width as f64, 0, 3, RED);
        }
        Ok(self.film.frame(&self.frame)?)
    }
}

const WHITE: [u8; 3] = [255; 3];
const YELLOW: [u8; 3] = [255, 210, 0];
const RED: [u8; 3] = [220, 30, 30];
