//! The pictures of a recording, stretch by stretch, in the order in which they are recorded.

use std::{collections::VecDeque, ops::Range, path::Path, sync::Arc};

use super::Stretch;
use lapwing_core::{
    perception::Frame,
    recording::{CameraPosition, Picture, Recording, RecordingError},
};
use lapwing_sim::{along::read_stock, camera::Scenery, track::Track};

/// A track, and what stands beside it.
pub(super) type Scene = (Arc<Track>, Arc<Scenery>);

/// A stretch, and what its camera took.
pub(super) struct Job {
    pub stretch: Stretch,
    pub scene: Scene,
    /// Those of the rows that are looked at.
    pub pictures: Vec<Option<Picture>>,
}

/// Reads a recording once for all stretches, of which the next may look at rows of the one before.
pub(super) struct Pictures {
    again: Recording,
    camera: CameraPosition,
    stretches: VecDeque<(Stretch, Scene)>,
    /// The pictures of the rows from `first` on, as far as they are read.
    read: VecDeque<Option<Picture>>,
    first: usize,
}

impl Pictures {
    /// Stretches must be in the order in which they are recorded.
    pub(super) fn open(
        path: &Path,
        camera: CameraPosition,
        stretches: impl IntoIterator<Item = (Stretch, Scene)>,
    ) -> Result<Self, RecordingError> {
        let stretches = stretches.into_iter().collect();
        Ok(Self { again: Recording::open(path)?, camera, stretches, read: VecDeque::new(), first: 0 })
    }

    /// Those of some rows, none of them before those that were read last.
    pub(super) fn read(&mut self, rows: &Range<usize>) -> Result<Vec<Option<Picture>>, RecordingError> {
        while self.first < rows.start && self.read.pop_front().is_some() {
            self.first += 1;
        }
        while self.first + self.read.len() < rows.end {
            let Some(mut moment) = self.again.next().transpose()? else { break };
            if moment.is_seen() {
                self.read.push_back(moment.pictures[self.camera as usize].take());
            }
            if self.first < rows.start && self.read.pop_front().is_some() {
                self.first += 1;
            }
        }
        // If the recording has become shorter since, the rest of its pictures cannot be read.
        let picture = |i: usize| self.read.get(i).cloned().flatten();
        Ok((0..rows.len()).map(picture).collect())
    }
}

impl Iterator for Pictures {
    type Item = Result<Job, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        let (stretch, scene) = self.stretches.pop_front()?;
        Some(self.read(&stretch.shown).map(|pictures| Job { stretch, scene, pictures }))
    }
}

/// Reads a picture, or says why it cannot be looked at.
pub(super) fn decoded(picture: Option<&Picture>, frame: &mut Frame) -> Result<(), String> {
    read_stock(picture.ok_or("the recording names no picture of this camera")?, frame)
}
