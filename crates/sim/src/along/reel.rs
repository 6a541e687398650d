//! The rows of a recording around the one that is abreast of the car, with their pictures: they are read in order.

use std::collections::VecDeque;

use super::{
    ClosedLoopError,
    recorded::{MomentPictures, RecordedDrive},
};

/// So many rows ahead and behind are kept.
pub(super) const ROWS: usize = 24;

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

    /// Why no picture that is loaded can be used, if that is so.
    pub(super) fn unusable(&mut self) -> Option<ClosedLoopError> {
        let rows = &mut self.rows;
        let is_blank = rows.iter().all(|(_, pictures)| pictures.unusable.is_some());
        rows.front_mut().filter(|_| is_blank).and_then(|(_, pictures)| pictures.unusable.take())
    }

    /// All rows that are loaded.
    pub(super) fn around(&self) -> impl Iterator<Item = (usize, &MomentPictures)> {
        self.rows.iter().map(|(row, pictures)| (*row, pictures))
    }
}
