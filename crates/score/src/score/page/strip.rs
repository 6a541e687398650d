//! Pictures spread evenly over a run, however long it turns out to be.

use bytes::Bytes;

/// Pictures that are kept at most, an even number: of a lap, one every two to three seconds.
const MOST: usize = 96;

/// Keeps every picture at first, then every second, every fourth and so on.
#[derive(Debug)]
pub(super) struct Strip {
    every: u64,
    seen: u64,
    kept: Vec<(f64, Bytes)>,
}

impl Default for Strip {
    fn default() -> Self {
        Self { every: 1, seen: 0, kept: vec![] }
    }
}

impl Strip {
    /// Takes the next picture of the run, with its time in seconds.
    pub fn take(&mut self, t: f64, jpeg: &Bytes) {
        if self.seen.is_multiple_of(self.every) {
            if self.kept.len() == MOST {
                let mut stays = false;
                self.kept.retain(|_| {
                    stays = !stays;
                    stays
                });
                self.every *= 2;
            }
            self.kept.push((t, jpeg.clone()));
        }
        self.seen += 1;
    }

    /// The pictures that are kept, in order.
    pub fn finish(self) -> Vec<(f64, Bytes)> {
        self.kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pictures_of_a_run_of_any_length_are_as_far_apart_from_first_to_last() {
        for length in [1, MOST, MOST + 1, 1000, 12_345] {
            let mut strip = Strip::default();
            for i in 0..length {
                strip.take(i as f64, &Bytes::new());
            }
            let kept: Vec<_> = strip.finish().iter().map(|(t, _)| *t as usize).collect();
            let apart = kept.get(1).map_or(1, |second| second - kept[0]);
            assert!(kept.len() <= MOST && kept.len() >= length.min(MOST / 2), "{length}: {}", kept.len());
            assert_eq!(kept, (0..length).step_by(apart).collect::<Vec<_>>(), "{length}");
        }
    }
}
