//! The pictures taken around a place: what one moment's cameras do not show from beside their car, those of another may.

use std::collections::VecDeque;

use super::{
    ClosedLoopError,
    recorded::{MomentPictures, RecordedDrive},
    warp::Beside,
};

/// A picture that was taken farther ahead or behind than this completes no other: over such a distance the road is not the
/// plane that the warp takes it for, in metres.
pub(super) const REACH_M: f64 = 12.0;
/// Of pictures nearer to one another than this along the road one is enough, in metres.
const APART_M: f64 = 2.0;
/// So many rows ahead and behind are kept.
pub(super) const ROWS: usize = 24;

/// Which of these moments complete the picture of one that is abreast of the car, the nearest first.
pub(super) fn completing<T>(moments: impl Iterator<Item = (T, Beside)>) -> Vec<(T, Beside)> {
    let mut moments: Vec<(T, Beside)> = moments.filter(|(_, at)| at.ahead_m.abs() <= REACH_M).collect();
    moments.sort_by(|(_, a), (_, b)| a.ahead_m.abs().total_cmp(&b.ahead_m.abs()));
    let mut taken = vec![0.0];
    moments.retain(|(_, at)| {
        let is_apart = taken.iter().all(|ahead_m: &f64| (ahead_m - at.ahead_m).abs() >= APART_M);
        if is_apart {
            taken.push(at.ahead_m);
        }
        is_apart
    });
    moments
}

/// The pictures of the row that is shown and of those around it.
#[derive(Default)]
pub(super) struct Reel {
    /// In order.
    rows: VecDeque<(usize, MomentPictures)>,
    /// The row that is read next.
    next: usize,
    /// Why it cannot be read: the drive goes on up to there.
    failed: Option<ClosedLoopError>,
}

impl Reel {
    /// Loads the rows around this one; rows must be asked for in order.
    ///
    /// # Errors
    /// Those of reading this row.
    pub(super) fn wind(&mut self, drive: &mut RecordedDrive, row: usize) -> Result<(), ClosedLoopError> {
        let last = (row + ROWS).min(drive.rows.len().saturating_sub(1));
        while self.failed.is_none() && self.next <= last {
            match drive.show(self.next) {
                Ok(pictures) => {
                    self.rows.push_back((self.next, pictures));
                    self.next += 1;
                }
                Err(error) => self.failed = Some(error),
            }
        }
        self.rows.retain(|(at, _)| at + ROWS >= row);
        match self.at(row) {
            Some(_) => Ok(()),
            None => Err(self.failed.take().unwrap_or_else(|| drive.changed())),
        }
    }

    /// The pictures of a row that is loaded.
    pub(super) fn at(&self, row: usize) -> Option<&MomentPictures> {
        self.around().find_map(|(at, pictures)| (at == row).then_some(pictures))
    }

    /// All rows that are loaded.
    pub(super) fn around(&self) -> impl Iterator<Item = (usize, &MomentPictures)> {
        self.rows.iter().map(|(row, pictures)| (*row, pictures))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_pictures_close_together_one_is_enough_and_none_is_taken_from_afar() {
        let ahead = [0.5, -1.0, 2.5, -2.2, 3.0, -5.0, 11.0, 12.5, -30.0];
        let moments = ahead.into_iter().map(|ahead_m| (ahead_m, Beside { ahead_m, ..Beside::default() }));
        let taken: Vec<f64> = completing(moments).into_iter().map(|(ahead_m, _)| ahead_m).collect();
        assert_eq!(taken, [-2.2, 2.5, -5.0, 11.0]);
    }
}
