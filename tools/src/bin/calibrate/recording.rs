//! A recorded drive: the rows of `driving_log.csv`, their times, and where the car hit something.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use lapwing_core::{
    motion,
    recording::{Picture, Recording},
    units::MPS_PER_MPH,
};

/// A change of speed faster than this, in metres per second squared, cannot come from the tyres: locked wheels give 8,
/// a steep hill 4. It counts as a contact with a wall, or of the body with the foot of a ramp. Contacts are inferred,
/// not seen.
const CONTACT: f64 = 12.0;
/// A car that stands this long at full throttle, in seconds, is pressing against something.
const PRESSING_S: f64 = 0.7;

/// One sample of the stock recorder.
#[derive(Debug, Clone)]
pub struct Logged {
    /// The centre camera's picture.
    pub image: PathBuf,
    /// Seconds since the first row.
    pub time: f64,
    /// Normalised steering.
    pub steering: f64,
    /// Throttle minus brake.
    pub throttle: f64,
    /// Metres a second, negative in reverse.
    pub speed: f64,
    /// Whether the car hits something between this row and the next.
    pub contact: bool,
}

/// Reads a recording's rows: a driving log in one piece whose pictures' names hold their times.
pub fn read(path: &Path) -> Result<Vec<Logged>> {
    let mut rows = Vec::new();
    for moment in Recording::open(path)? {
        let moment = moment?;
        let place = || format!("{}, row {}", path.display(), moment.row);
        ensure!(moment.broken.is_none(), "{}: expected one drive, got {:?}", place(), moment.broken);
        ensure!(moment.taken_at.is_some(), "{}: expected a time in the picture's name, got none", place());
        let Some(Picture::File(image)) = &moment.pictures[0] else {
            bail!("{}: expected the file of a picture, got none", place());
        };
        let Some(command) = moment.decided() else { bail!("{}: expected a driver, got none", place()) };
        rows.push(Logged {
            image: image.clone(),
            time: moment.at.as_secs_f64(),
            steering: command.steering.get(),
            throttle: command.throttle.get(),
            speed: moment.telemetry.speed.get() * MPS_PER_MPH,
            contact: false,
        });
    }
    ensure!(rows.len() > 1, "{}: expected at least two rows, got {}", path.display(), rows.len());
    give_signs(&mut rows);
    mark_contacts(&mut rows);
    Ok(rows)
}

/// The recorder's speed has no sign. It changes where the car almost stands and its throttle asks for it.
fn give_signs(rows: &mut [Logged]) {
    let mut sign = 1.0;
    for row in rows {
        if row.speed < 0.7 * MPS_PER_MPH && row.throttle != 0.0 {
            sign = row.throttle.signum();
        }
        row.speed *= sign;
    }
}

fn mark_contacts(rows: &mut [Logged]) {
    for i in 1..rows.len() {
        let lost = (rows[i - 1].speed.abs() - rows[i].speed.abs()).abs() / (rows[i].time - rows[i - 1].time);
        rows[i - 1].contact = lost > CONTACT;
    }
    let stands = |row: &Logged| row.speed.abs() < MPS_PER_MPH && row.throttle.abs() > 0.9;
    let mut since = 0;
    for i in 0..rows.len() {
        if !stands(&rows[i]) {
            since = i + 1;
        } else if rows[i].time - rows[since].time > PRESSING_S {
            rows[since..=i].iter_mut().for_each(|row| row.contact = true);
        }
    }
}

/// A column, interpolated linearly between the rows.
pub fn at(rows: &[Logged], time: f64, column: impl Fn(&Logged) -> f64) -> f64 {
    motion::between(rows, time, |row| row.time, |i| column(&rows[i]))
}
