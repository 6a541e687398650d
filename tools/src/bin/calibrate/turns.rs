//! How the car turned from row to row, from the pictures.

use anyhow::{Context, Result};
use lapwing_core::perception::{Frame, decode_jpeg};
use lapwing_sim::along::{Pyramid, Rotation, turn};

use super::recording::Logged;

/// The turns from each row to the next, if there is enough to see. Runs on as many threads as there are cores.
pub fn between(rows: &[Logged]) -> Result<Vec<Option<Rotation>>> {
    let pairs = rows.len() - 1;
    let share = pairs.div_ceil(std::thread::available_parallelism().map_or(1, usize::from));
    std::thread::scope(|scope| {
        let parts: Vec<_> = (0..pairs)
            .step_by(share)
            .map(|from| scope.spawn(move || some(&rows[from..=(from + share).min(pairs)])))
            .collect();
        let mut all = Vec::new();
        for part in parts {
            all.extend(part.join().map_err(|_| anyhow::anyhow!("a thread that looks at pictures died"))??);
        }
        Ok(all)
    })
}

fn some(rows: &[Logged]) -> Result<Vec<Option<Rotation>>> {
    let mut before = open(&rows[0])?;
    let mut turns = Vec::new();
    for pair in rows.windows(2) {
        let next = open(&pair[1])?;
        let rolled = (pair[0].speed + pair[1].speed) / 2.0 * (pair[1].time - pair[0].time);
        turns.push(turn(&before, &next, rolled));
        before = next;
    }
    Ok(turns)
}

fn open(row: &Logged) -> Result<Pyramid> {
    let place = || row.image.display().to_string();
    let mut frame = Frame::default();
    decode_jpeg(&std::fs::read(&row.image).with_context(place)?, &mut frame).with_context(place)?;
    let (width, height) = (frame.width(), frame.height());
    Pyramid::of(&frame).with_context(|| format!("{}: expected 320x160, got {width}x{height}", place()))
}
