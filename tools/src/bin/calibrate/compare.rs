//! Compares the car with a drive: its speed rolled out from every row, its yaw rate between the rows.

use lapwing_core::{
    car::FULL_STEERING_DEG,
    motion,
    protocol::Command,
    units::{MPS_PER_MPH, Steering, Throttle},
};
use lapwing_sim::{
    along::Rotation,
    vehicle::{Car, Ground, STEP_S},
};
use serde::Serialize;

use super::recording::{Logged, at};

/// How far ahead speeds are compared, in seconds.
pub const HORIZONS_S: [f64; 3] = [1.0, 2.0, 5.0];
/// Below this speed, in metres per second, a yaw rate is not compared.
const MOVING: f64 = 1.0;

/// Speeds after one of [`HORIZONS_S`], model minus recording.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Speeds {
    /// Seconds ahead.
    pub horizon_s: f64,
    /// States the model was rolled out from.
    pub rows: usize,
    /// Root mean square, in mph.
    pub rmse_mph: f64,
    /// Mean, in mph.
    pub bias_mph: f64,
}

/// Yaw rates between rows.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct YawRates {
    /// Pairs of rows compared.
    pub pairs: usize,
    /// Pairs left out because the car hardly moves, because it hits something, because there is too little to see.
    pub left_out: [usize; 3],
    /// Correlation of model and pictures.
    pub correlation: f64,
    /// Slope of the model's yaw rate over the pictures': the factor that brings the pictures' nearest to the model's.
    pub slope: f64,
    /// The reverse: one over the factor that brings the model's nearest to the pictures'.
    pub inverse_slope: f64,
    /// Root mean square of the difference, in degrees per second.
    pub rmse_deg_s: f64,
}

fn command(rows: &[Logged], time: f64) -> Command {
    Command {
        steering: Steering::saturating(at(rows, time, |row| row.steering)),
        throttle: Throttle::saturating(at(rows, time, |row| row.throttle)),
    }
}

/// Rolls the car out from each row; `grades` has a value per row. Rows whose roll-out spans a contact are left out
/// unless `all` is set.
pub fn speeds(rows: &[Logged], grades: &[f64], all: bool) -> Vec<Speeds> {
    let end = rows[rows.len() - 1].time;
    let longest = HORIZONS_S[HORIZONS_S.len() - 1];
    let mut errors = vec![Vec::new(); HORIZONS_S.len()];
    for (i, row) in rows.iter().enumerate() {
        let spans_contact = rows[i..].iter().take_while(|later| later.time < row.time + longest).any(|row| row.contact);
        if row.time + longest > end || (spans_contact && !all) {
            continue;
        }
        let yaw_rate = motion::yaw_rate(row.speed, row.steering * FULL_STEERING_DEG);
        let mut car = Car { speed: row.speed, yaw_rate, ..Car::default() };
        let mut steps = 0_u32;
        for (horizon, errors) in HORIZONS_S.iter().zip(&mut errors) {
            while f64::from(steps) * STEP_S < horizon - 1e-9 {
                let time = row.time + f64::from(steps) * STEP_S;
                let grade = along(rows, grades, time);
                car.step(command(rows, time), Ground { grade, ..Ground::default() });
                steps += 1;
            }
            let recorded = at(rows, row.time + horizon, |row| row.speed.abs()) / MPS_PER_MPH;
            errors.push(car.telemetry_speed().get() - recorded);
        }
    }
    HORIZONS_S
        .iter()
        .zip(errors)
        .map(|(&horizon_s, errors)| {
            let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / errors.len().max(1) as f64;
            let rmse_mph = mean(&mut errors.iter().map(|e| e * e)).sqrt();
            Speeds { horizon_s, rows: errors.len(), rmse_mph, bias_mph: mean(&mut errors.iter().copied()) }
        })
        .collect()
}

fn along(rows: &[Logged], values: &[f64], time: f64) -> f64 {
    motion::between(rows, time, |row| row.time, |i| values[i])
}

/// Drives the car with the recorded steering at the recorded speed and compares how far it turns between rows.
pub fn yaw(rows: &[Logged], turns: &[Option<Rotation>]) -> YawRates {
    let mut car = Car::default();
    let mut headings = vec![0.0];
    while headings.len() as f64 * STEP_S <= rows[rows.len() - 1].time + STEP_S {
        let time = (headings.len() - 1) as f64 * STEP_S;
        car.speed = at(rows, time, |row| row.speed);
        car.step(command(rows, time), Ground::default());
        headings.push(car.yaw);
    }
    let heading = |time: f64| {
        let i = ((time / STEP_S) as usize).min(headings.len() - 2);
        headings[i] + (time / STEP_S - i as f64) * (headings[i + 1] - headings[i])
    };
    let (mut model, mut seen, mut left_out) = (Vec::new(), Vec::new(), [0; 3]);
    for (pair, turn) in rows.windows(2).zip(turns) {
        let passed = pair[1].time - pair[0].time;
        match turn {
            _ if pair[0].speed.abs() < MOVING => left_out[0] += 1,
            _ if pair[0].contact => left_out[1] += 1,
            None => left_out[2] += 1,
            Some(turn) => {
                model.push((heading(pair[1].time) - heading(pair[0].time)) / passed);
                seen.push(turn.yaw / passed);
            }
        }
    }
    let n = model.len().max(1) as f64;
    let (mean_model, mean_seen) = (model.iter().sum::<f64>() / n, seen.iter().sum::<f64>() / n);
    let sum = |f: &dyn Fn(f64, f64) -> f64| {
        model.iter().zip(&seen).map(|(&m, &s)| f(m - mean_model, s - mean_seen)).sum::<f64>()
    };
    let (mm, ms, ss) = (sum(&|m, _| m * m), sum(&|m, s| m * s), sum(&|_, s| s * s));
    let square = model.iter().zip(&seen).map(|(m, s)| (m - s) * (m - s)).sum::<f64>() / n;
    YawRates {
        pairs: model.len(),
        left_out,
        correlation: ms / (mm * ss).sqrt(),
        slope: ms / ss,
        inverse_slope: ms / mm,
        rmse_deg_s: square.sqrt().to_degrees(),
    }
}
