//! What a recording tells of its car: whether it went as far as its speed says, and turned as much as its steering says.

use std::path::Path;

use serde::Serialize;

use super::{Row, rows::by_steering};
use lapwing_core::{motion::around, recording::RecordingError};
use lapwing_sim::locate::LocatedDrive;

/// Rows that are compared in one go: what is wrong in single ones is evened out.
const TOGETHER: usize = 10;
/// So many of those must tell it.
const ENOUGH: usize = 10;
/// A slower car tells nothing, in metres over [`TOGETHER`] rows.
const LEAST_M: f64 = 2.0;
/// How late a car may obey its steering, in seconds, and how finely that is told.
const LATEST_S: f64 = 0.3;
const STEP_S: f64 = 0.02;
/// How well its steering must explain a car's turning, as a correlation, for its gearing to be believed: those of the
/// real builds have 0.985 and more.
const EXPLAINED: f64 = 0.95;
/// No build is known to be geared outside of this.
const GEARED: std::ops::RangeInclusive<f64> = 0.7..=1.4;

/// The car of a recording, by where it was found in its pictures, held against its speed and its steering.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Car {
    /// Metres driven for each metre that its speed and time tell.
    pub way: f64,
    /// How far it turned for each radian that the front wheels' angle tells: all turning, to either side, added up.
    pub turning: f64,
    /// How much later than it was steered, in seconds.
    pub late_s: f64,
    /// How much of its turning that explains: the correlation of both.
    pub r: f64,
}

/// Rows from one to another a little later, between which the car is seen all the time.
struct Span {
    from_s: f64,
    to_s: f64,
    turned: f64,
}

impl Car {
    /// By the rows of a drive and where they were found.
    pub(super) fn of(drive: &LocatedDrive, rows: &[Row]) -> Option<Self> {
        let steered: Vec<(f64, f64)> = rows
            .iter()
            .scan(0.0, |sum, row| {
                *sum += row.steered_rad;
                Some((row.at_s, *sum))
            })
            .collect();
        let (mut spans, mut found_m, mut told_m) = (vec![], 0.0, 0.0);
        for from in (0..rows.len().saturating_sub(TOGETHER)).step_by(TOGETHER) {
            let to = from + TOGETHER;
            let told: f64 = rows[from + 1..=to].iter().map(|row| row.motion.way_m).sum();
            let broken = rows[from + 1..=to].iter().any(|row| row.broken.is_some());
            let seen = drive.places[from..=to].iter().all(Option::is_some);
            let (Some(was), Some(is)) = (drive.places[from], drive.places[to]) else { continue };
            if broken || !seen || told < LEAST_M {
                continue;
            }
            let Some(turned) = drive.turned(from, to) else { continue };
            // On the inside of a bend, less is driven than along the road's middle.
            let along_m = around(is.pose.s_m - was.pose.s_m, drive.track.length());
            let bend = drive.track.at(was.pose.s_m + along_m / 2.0).curvature;
            let aside_m = is.pose.offset_m - was.pose.offset_m;
            found_m += (along_m * (1.0 - bend * (was.pose.offset_m + is.pose.offset_m) / 2.0)).hypot(aside_m);
            told_m += told;
            spans.push(Span { from_s: rows[from].at_s, to_s: rows[to].at_s, turned });
        }
        if spans.len() < ENOUGH {
            return None;
        }
        let late = (0..=(LATEST_S / STEP_S).round() as usize).map(|i| i as f64 * STEP_S);
        let told = late.map(|late_s| {
            let steered = |span: &Span| at(&steered, span.to_s - late_s) - at(&steered, span.from_s - late_s);
            let pairs: Vec<[f64; 2]> = spans.iter().map(|span| [steered(span), span.turned]).collect();
            let sum = |of: &dyn Fn(&[f64; 2]) -> f64| pairs.iter().map(of).sum::<f64>();
            let r = sum(&|[a, b]| a * b) / (sum(&|[a, _]| a * a) * sum(&|[_, b]| b * b)).sqrt();
            (r, late_s, sum(&|[_, b]| b.abs()) / sum(&|[a, _]| a.abs()))
        });
        let (r, late_s, turning) = told.filter(|(r, ..)| r.is_finite()).max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(Self { way: found_m / told_m, turning, late_s, r })
    }
}

/// How many times as far the car of a recording turns as the simulator's would for the same steering; 1 if its steering
/// explains too little of its turning to tell, or if that is more or less than any build is known to turn.
///
/// # Errors
/// What cannot be read of the run or the driving log.
pub fn gearing(path: &Path, drive: &LocatedDrive) -> Result<f64, RecordingError> {
    let rows = by_steering(path)?;
    let told = (rows.len() == drive.places.len()).then(|| Car::of(drive, &rows)).flatten();
    let car = told.filter(|car| car.r >= EXPLAINED && GEARED.contains(&car.turning));
    Ok(car.map_or(1.0, |car| car.turning))
}

/// What was turned until then.
fn at(steered: &[(f64, f64)], at_s: f64) -> f64 {
    lapwing_core::motion::between(steered, at_s, |(at_s, _)| *at_s, |i| steered[i].1)
}
