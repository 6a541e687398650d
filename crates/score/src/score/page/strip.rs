//! Pictures spread evenly over a run, however long it turns out to be and however large they are.

use bytes::Bytes;

/// Keeps every picture at first, then every second, every fourth and so on.
#[derive(Debug)]
pub struct Strip {
    most: usize,
    most_bytes: usize,
    bytes: usize,
    every: u64,
    came: u64,
    kept: Vec<(f64, Bytes)>,
}

impl Strip {
    /// A strip of at most so many pictures, which have at most so many bytes together; two are kept in any case. A run with
    /// more leaves at least half of what fits.
    pub fn within(pictures: usize, bytes: usize) -> Self {
        Self { most: pictures.max(2), most_bytes: bytes, bytes: 0, every: 1, came: 0, kept: vec![] }
    }

    /// Takes the next picture of the run, with its time in seconds.
    pub fn take(&mut self, t: f64, jpeg: &[u8]) {
        if self.came.is_multiple_of(self.every) {
            self.bytes += jpeg.len();
            // A copy: a slice of a file's chunk would keep the whole chunk.
            self.kept.push((t, Bytes::copy_from_slice(jpeg)));
            while self.kept.len() > self.most || (self.bytes > self.most_bytes && self.kept.len() > 2) {
                self.every *= 2;
                let mut stays = false;
                self.kept.retain(|_| {
                    stays = !stays;
                    stays
                });
                self.bytes = self.kept.iter().map(|(_, jpeg)| jpeg.len()).sum();
            }
        }
        self.came += 1;
    }

    /// The pictures that are kept, in order.
    pub fn finish(self) -> Vec<(f64, Bytes)> {
        self.kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Which pictures of a run are kept, and that they are as far apart from first to last.
    fn kept(mut strip: Strip, length: usize, jpeg: &[u8]) -> Vec<usize> {
        for i in 0..length {
            strip.take(i as f64, jpeg);
        }
        let kept: Vec<_> = strip.finish().iter().map(|(t, _)| *t as usize).collect();
        let apart = kept.get(1).map_or(1, |second| second - kept[0]);
        assert_eq!(kept, (0..length).step_by(apart).collect::<Vec<_>>(), "{length}");
        kept
    }

    #[test]
    fn the_pictures_of_a_run_of_any_length_are_as_far_apart_from_first_to_last() {
        for length in [1, 96, 97, 1000, 12_345] {
            let kept = kept(Strip::within(96, usize::MAX), length, &[]).len();
            assert!(kept <= 96 && kept >= length.min(48), "{length}: {kept}");
        }
    }

    #[test]
    fn of_large_pictures_fewer_are_kept() {
        let kept_of = |bytes| kept(Strip::within(96, 1000), 1000, &vec![0; bytes]).len();
        assert!((4..=10).contains(&kept_of(100)), "{}", kept_of(100));
        assert_eq!(kept_of(5000), 2);
    }
}
