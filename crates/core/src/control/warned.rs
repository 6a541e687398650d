//! When a guard goes on braking for what is close.
//!
//! A network sees 20 frames: of a car that stands it cannot tell whether it braked hard before. The guard can, and holds it
//! there until the network no longer sees anything close ahead, as [`TimeToCollision`](crate::guard::TimeToCollision) does.

use super::{BrakeLimits, TO_FIRE};

/// Something is close ahead from this value on: a network learns 1 for what is 6 m ahead and 0 for what is 8 m, and a car that was
/// braked at 1.4 s from a collision comes to rest 5 to 7 m before it.
const BLOCKED: f64 = 0.25;

/// What a guard remembers of what its network said.
#[derive(Debug, Clone, Copy, Default)]
pub struct Warned {
    /// Answers in a row by which a brake is due.
    high: u32,
    /// Whether it warned of what is close.
    warned: bool,
}

impl Warned {
    /// The guard's value: how much a brake is `due`, and no less than the upper limit while what it warned of is close, which
    /// `blocked` says, from 0 to 1.
    pub fn value(&mut self, due: f64, blocked: f64, limits: BrakeLimits) -> f64 {
        let is_close = blocked >= BLOCKED;
        self.high = if due >= limits.fires { self.high + 1 } else { 0 };
        self.warned = self.high >= TO_FIRE || self.warned && is_close;
        if self.warned && is_close { due.max(limits.fires) } else { due }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_it_warned_of_is_braked_for_as_long_as_it_is_close_and_nothing_else_is() {
        let limits = BrakeLimits { fires: 0.6, releases: 0.3 };
        let mut warned = Warned::default();
        let mut values = |said: &[(f64, f64)]| {
            said.iter().map(|(due, blocked)| warned.value(*due, *blocked, limits)).collect::<Vec<_>>()
        };
        assert_eq!(values(&[(0.7, 0.9), (0.1, 0.9)]), [0.7, 0.1], "one answer alone is no warning");
        assert_eq!(values(&[(0.7, 0.1), (0.8, 0.6), (0.1, 0.7), (0.0, 0.3)]), [0.7, 0.8, 0.6, 0.6]);
        assert_eq!(
            values(&[(0.0, 0.2), (0.0, 0.9)]),
            [0.0, 0.0],
            "once the way was free, what comes is something else"
        );
    }
}
