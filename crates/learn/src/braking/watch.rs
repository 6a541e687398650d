//! When a guard goes on braking for what is close.
//!
//! A network sees 20 frames: of a car that stands it cannot tell whether it braked hard before. The guard can, and holds it
//! there until the network no longer sees anything close ahead, as
//! [`TimeToCollision`](lapwing_core::guard::TimeToCollision) does.

use crate::nn::braking::Said;
use lapwing_core::control::{BrakeLimits, TO_FIRE};

/// Something is close ahead from this value on: a network learns 1 for what is 6 m ahead and 0 for what is 8 m, and a car that was
/// braked at 1.4 s from a collision comes to rest 5 to 7 m before it.
const BLOCKED: f64 = 0.25;

/// What a guard remembers of what the network said.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Watch {
    /// Answers in a row by which a brake is due.
    high: u32,
    /// Whether it warned of what is close.
    warned: bool,
}

impl Watch {
    /// The guard's value: how much a brake is due, and no less than the upper limit while what it warned of is close.
    pub(super) fn value(&mut self, said: Said, limits: BrakeLimits) -> f64 {
        let is_close = said.blocked >= BLOCKED;
        self.high = if said.due >= limits.fires { self.high + 1 } else { 0 };
        self.warned = self.high >= TO_FIRE || self.warned && is_close;
        if self.warned && is_close { said.due.max(limits.fires) } else { said.due }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_it_warned_of_is_braked_for_as_long_as_it_is_close_and_nothing_else_is() {
        let limits = BrakeLimits { fires: 0.6, releases: 0.3 };
        let mut watch = Watch::default();
        let mut values = |said: &[(f64, f64)]| {
            said.iter()
                .map(|(due, blocked)| watch.value(Said { due: *due, blocked: *blocked }, limits))
                .collect::<Vec<_>>()
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
