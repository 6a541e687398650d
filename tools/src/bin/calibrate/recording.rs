//! A recorded drive: the rows of `driving_log.csv`, their times, and where the car hit something.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, ensure};
use lapwing_core::{motion, units::MPS_PER_MPH};

/// A change of speed faster than this, in metres per second squared, is no tyre's doing: locked wheels give 8, a
/// steep hill 4. Taken as a contact: a wall, or the body that strikes the foot of a ramp. It is inferred, not seen.
const CONTACT: f64 = 12.0;
/// Standing this long at full throttle, in seconds, the car stands against something.
const PRESSING_S: f64 = 0.7;

/// One sample of the stock recorder.
#[derive(Debug, Clone)]
pub struct Row {
    /// The centre camera's picture.
    pub image: PathBuf,
    /// Seconds since the first row.
    pub time: f64,
    /// Normalised steering.
    pub steering: f64,
    /// Throttle less brake.
    pub throttle: f64,
    /// Metres a second, negative in reverse.
    pub speed: f64,
    /// Whether the car hits something between this row and the next.
    pub contact: bool,
}

/// Reads a recording's rows.
pub fn read(folder: &Path) -> Result<Vec<Row>> {
    let path = folder.join("driving_log.csv");
    let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut rows = Vec::new();
    let mut first = None;
    for (line, row) in text.lines().enumerate().filter(|(_, row)| !row.trim().is_empty()) {
        let cells: Vec<&str> = row.split(',').map(str::trim).collect();
        ensure!(cells.len() == 7, "{} line {}: expected 7 columns, got {}", path.display(), line + 1, cells.len());
        let number = |i: usize| cells[i].parse::<f64>().with_context(|| format!("line {}: {:?}", line + 1, cells[i]));
        let name = cells[0].rsplit(['/', '\\']).next().unwrap_or_default();
        let taken = taken_at(name).with_context(|| format!("line {}: no time in {name:?}", line + 1))?;
        let first = *first.get_or_insert(taken);
        rows.push(Row {
            image: folder.join("IMG").join(name),
            time: taken.duration_since(first).as_secs_f64(),
            steering: number(3)?,
            throttle: number(4)? - number(5)?,
            speed: number(6)? * MPS_PER_MPH,
            contact: false,
        });
    }
    ensure!(rows.len() > 1, "{}: expected at least two rows, got {}", path.display(), rows.len());
    give_signs(&mut rows);
    mark_contacts(&mut rows);
    Ok(rows)
}

/// `center_2018_07_16_17_11_43_382.jpg`
fn taken_at(name: &str) -> Option<jiff::civil::DateTime> {
    let mut parts = name.strip_suffix(".jpg")?.split('_').skip(1).map(str::parse::<i16>);
    let mut next = || parts.next()?.ok();
    let (year, mut small) = (next()?, || i8::try_from(next()?).ok());
    let (month, day, hour, minute, second) = (small()?, small()?, small()?, small()?, small()?);
    let milliseconds = i32::from(next()?);
    jiff::civil::DateTime::new(year, month, day, hour, minute, second, milliseconds * 1_000_000).ok()
}

/// The recorder's speed has no sign. It changes where the car all but stands and its throttle asks for it.
fn give_signs(rows: &mut [Row]) {
    let mut sign = 1.0;
    for row in rows {
        if row.speed < 0.7 * MPS_PER_MPH && row.throttle != 0.0 {
            sign = row.throttle.signum();
        }
        row.speed *= sign;
    }
}

fn mark_contacts(rows: &mut [Row]) {
    for i in 1..rows.len() {
        let lost = (rows[i - 1].speed.abs() - rows[i].speed.abs()).abs() / (rows[i].time - rows[i - 1].time);
        rows[i - 1].contact = lost > CONTACT;
    }
    let stands = |row: &Row| row.speed.abs() < MPS_PER_MPH && row.throttle.abs() > 0.9;
    let mut since = 0;
    for i in 0..rows.len() {
        if !stands(&rows[i]) {
            since = i + 1;
        } else if rows[i].time - rows[since].time > PRESSING_S {
            rows[since..=i].iter_mut().for_each(|row| row.contact = true);
        }
    }
}

/// A column between the rows, linearly.
pub fn at(rows: &[Row], time: f64, column: impl Fn(&Row) -> f64) -> f64 {
    motion::between(rows, time, |row| row.time, |i| column(&rows[i]))
}
