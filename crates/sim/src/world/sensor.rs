//! The pictures that the camera loses.

use bytes::Bytes;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::conditions::Conditions;

/// Drops frames.
pub(super) struct Sensor {
    last: Option<Bytes>,
    random: ChaCha8Rng,
}

impl Sensor {
    /// A sensor for the run with this seed.
    pub(super) fn new(seed: u64) -> Self {
        Self { last: None, random: ChaCha8Rng::seed_from_u64(seed ^ 0x5e15_0d0f_5e15_0d0f) }
    }

    /// The picture that arrives now, given the one taken now: the last one again, where that is dropped.
    pub(super) fn see(&mut self, taken: Bytes, conditions: &Conditions) -> Bytes {
        if conditions.dropped <= 0.0 {
            return taken;
        }
        let chance = f64::from(self.random.next_u32()) / f64::from(u32::MAX);
        let kept = self.last.take().filter(|_| chance < conditions.dropped);
        self.last.insert(kept.unwrap_or(taken)).clone()
    }
}
