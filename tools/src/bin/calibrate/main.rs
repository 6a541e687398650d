//! Compares the car of `lapwing_sim::vehicle` with recordings of the stock simulator's.
//!
//! ```text
//! cargo run --release -p lapwing-tools --bin calibrate -- ../shared/recordings/lake ../shared/recordings/jungle
//! ```
//!
//! For each folder with a `driving_log.csv` it rolls the car out for 5 s from every recorded state with the recorded
//! steering, throttle and brake, and compares speeds; and it drives the car with the recorded steering at the recorded
//! speed and compares its yaw rate with the one seen in the pictures.
//!
//! Slopes matter. A folder named like a track is located on it by heading over distance, or by a table of `--lane`, and
//! speeds are compared three times: as if the road were level; with the track's grades; and with the pitch seen in the pictures, which the
//! track's grades only stabilise in the long run. Recorded speeds affect the grades only through the odometry that
//! finds the place, but the time constant with which pictures and track are mixed was chosen on the jungle recording by
//! the very error printed here.

#![allow(clippy::print_stdout)] // its result, for us to read

mod compare;
mod recording;
mod route;
mod turns;

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use clap::Parser;
use lapwing_sim::{locate::LaneTable, track::Track};
use serde::Serialize;

/// Holds the simulator's car against recordings of the stock simulator.
#[derive(Parser)]
struct Arguments {
    /// Folders with driving_log.csv and IMG; one called lake, jungle or mountain lies on that track.
    #[arg(required = true)]
    folders: Vec<PathBuf>,
    /// The track of all of them, a name or a file, instead of the one that the folder's name says.
    #[arg(long)]
    track: Option<String>,
    /// Where the car was in each picture, as `lapwing locate --csv` writes it: a table for each folder, instead of a search by
    /// heading alone.
    #[arg(long)]
    lane: Vec<PathBuf>,
    /// Prints JSON instead of tables.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct CalibrationReport {
    recording: String,
    rows: usize,
    seconds: f64,
    /// Rows at which the car hits something or stands against it.
    contact_rows: Vec<usize>,
    /// Rows left out of the roll-outs: their 5 s hold such a row.
    left_out_contact: usize,
    /// Rows left out because the recording ends within 5 s.
    left_out_end: usize,
    track: Option<Placed>,
    speeds: Vec<SpeedsCompared>,
    yaw: compare::YawRates,
}

#[derive(Serialize)]
struct Placed {
    name: String,
    from_m: f64,
    to_m: f64,
    misfit_rad: f64,
}

#[derive(Serialize)]
struct SpeedsCompared {
    grades: &'static str,
    all_rows: bool,
    horizons: Vec<compare::Speeds>,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let mut reports = Vec::new();
    let (folders, tables) = (arguments.folders.len(), arguments.lane.len());
    ensure!(tables == 0 || tables == folders, "--lane: expected a table for each of {folders} folders, got {tables}");
    for (i, folder) in arguments.folders.iter().enumerate() {
        let report = examine(folder, arguments.track.as_deref(), arguments.lane.get(i).map(PathBuf::as_path))?;
        if !arguments.json {
            print(&report);
        }
        reports.push(report);
    }
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&reports)?);
    }
    Ok(())
}

fn examine(folder: &Path, track: Option<&str>, lane: Option<&Path>) -> Result<CalibrationReport> {
    let name = folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let rows = recording::read(folder)?;
    let turns = turns::between(&rows)?;
    ensure!(turns.len() + 1 == rows.len(), "{name}: expected {} turns, got {}", rows.len() - 1, turns.len());
    let track = track.or_else(|| Track::NAMES.into_iter().find(|known| *known == name));
    let track = track.map(|name| Track::open(name).map(|track| (name.to_owned(), track))).transpose()?;
    let table = lane.map(|lane| LaneTable::of(folder, lane, Track::open)).transpose()?;
    let route = track.as_ref().and_then(|(_, track)| match &table {
        Some(table) => route::told(&rows, &turns, track, table),
        None => route::locate(&rows, &turns, track),
    });

    let level = vec![0.0; rows.len()];
    let mut grades = vec![("level", &level)];
    if let Some(route) = &route {
        grades.extend([("track", &route.track), ("pictures", &route.seen)]);
    }
    let mut speeds = Vec::new();
    for (grades, values) in grades {
        for all_rows in [false, true] {
            speeds.push(SpeedsCompared { grades, all_rows, horizons: compare::speeds(&rows, values, all_rows) });
        }
    }
    let used = |all: bool| speeds.iter().find(|c| c.all_rows == all).map_or(0, |c| c.horizons[0].rows);
    let (kept, all) = (used(false), used(true));
    Ok(CalibrationReport {
        recording: name,
        rows: rows.len(),
        seconds: rows[rows.len() - 1].time,
        contact_rows: rows.iter().enumerate().filter(|(_, row)| row.contact).map(|(i, _)| i).collect(),
        left_out_contact: all - kept,
        left_out_end: rows.len() - all,
        track: track.zip(route).map(|((name, _), route)| Placed {
            name,
            from_m: route.from_to.0,
            to_m: route.from_to.1,
            misfit_rad: route.misfit,
        }),
        speeds,
        yaw: compare::yaw(&rows, &turns),
    })
}

fn print(report: &CalibrationReport) {
    let CalibrationReport { recording, rows, seconds, contact_rows, yaw, .. } = report;
    println!("{recording}: {rows} rows, {seconds:.1} s");
    match &report.track {
        Some(Placed { name, from_m, to_m, misfit_rad }) => {
            println!(
                "  on {name} from {from_m:.0} m to {to_m:.0} m, heading over 24 m within {misfit_rad:.3} rad (median)"
            )
        }
        None => println!("  on no track that its headings fit: taken as level"),
    }
    println!("  hits something, or stands against it, at rows {}", ranges(contact_rows));
    println!(
        "  left out of roll-outs: {} rows whose 5 s hold such a row, {} less than 5 s before the end",
        report.left_out_contact, report.left_out_end
    );
    println!("  speed, model less recording, mph     rows      after 1 s       after 2 s       after 5 s");
    for SpeedsCompared { grades, all_rows, horizons } in &report.speeds {
        let which = if *all_rows { "with contacts" } else { "rows kept" };
        print!("    grades: {grades:<9} {which:<14} {:>8}", horizons[0].rows);
        for speeds in horizons {
            print!("   {:5.2} ({:+5.2})", speeds.rmse_mph, speeds.bias_mph);
        }
        println!();
    }
    println!("                                                  RMSE (bias)");
    println!(
        "  yaw rate: {} pairs, correlation {:.4}, slope {:.3} (inverse {:.3}), RMSE {:.2} degrees/s",
        yaw.pairs, yaw.correlation, yaw.slope, yaw.inverse_slope, yaw.rmse_deg_s
    );
    let [still, contact, unseen] = yaw.left_out;
    println!("  left out of yaw: {still} pairs under 1 m/s, {contact} in contact, {unseen} with too little to see\n");
}

/// `3-5, 9`
fn ranges(rows: &[usize]) -> String {
    let mut text = Vec::new();
    for run in rows.chunk_by(|a, b| a + 1 == *b) {
        match run {
            [only] => text.push(only.to_string()),
            [first, .., last] => text.push(format!("{first}-{last}")),
            [] => {}
        }
    }
    if text.is_empty() { "none".into() } else { text.join(", ") }
}
