//! A pilot that always answers the same.

use super::{Pilot, PilotError, Prediction, View};
use crate::units::Steering;

/// Gives the same steering for every frame: for tests, and the baseline that any network must beat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConstantPilot {
    steering: Steering,
}

impl ConstantPilot {
    /// Always this steering.
    pub fn new(steering: Steering) -> Self {
        Self { steering }
    }
}

impl Pilot for ConstantPilot {
    fn steer(&mut self, _: &View<'_>) -> Result<Prediction, PilotError> {
        Ok(Prediction { steering: self.steering.get(), ..Prediction::default() })
    }

    fn reset(&mut self) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::Frame;

    #[test]
    fn it_says_the_same_whatever_it_sees() {
        let mut pilot = ConstantPilot::new(Steering::new(-0.25).unwrap());
        for frame in [Frame::default(), Frame::new(1, 1, vec![255; 3]).unwrap()] {
            assert_eq!(pilot.steer(&View::of(&frame)).unwrap().steering, -0.25);
        }
    }
}
