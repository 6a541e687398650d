//! A pilot that knows the line: it follows points from the world instead of pictures.
//!
//! It steers for the line's bend a little way ahead (feed-forward), and corrects errors of offset and heading as pure
//! pursuit does: towards a point of the straightened line one reach ahead (Coulter 1992, "Implementation of the Pure
//! Pursuit Path Tracking Algorithm"). Pure pursuit alone cuts bends by as much as the line bends within its reach; with
//! the bend fed forward, only the error is pursued, and the reach can be long enough for calm steering.
//!
//! The rear axle moves where the car faces; the origin, 1.6 m ahead of it, moves further inward. So in a bend a car
//! that keeps its origin on the line faces outward of it by 1.6 m times the curvature, and all of its turning lags 1.6
//! m behind the line. The heading is compared with that, not with the line's own direction.

use super::{Pilot, PilotError, Prediction, View};
use crate::{
    car::REAR_AXLE_M,
    motion::steering_deg,
    units::{Degrees, MetresPerSecond, Mph, PathPoint, Steering},
};

/// The steepest approach to the line from afar: metres towards it for a metre along.
const STEEPEST: f64 = 0.5;

/// How the line is followed, and how fast.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PursuitGains {
    /// The shortest reach, in metres.
    pub reach_m: f64,
    /// How much further it reaches with speed, in seconds.
    pub reach_s: f64,
    /// How far ahead the line's bend is read, in seconds: the time that an answer takes to turn the car.
    pub preview_s: f64,
    /// The highest lateral acceleration in bends, in m/s².
    pub lateral_mps2: f64,
    /// How hard to brake before bends, in m/s².
    pub braking_mps2: f64,
}

impl Default for PursuitGains {
    /// Found by driving all tracks at 50 Hz and at 15 Hz with an answer a frame late, see `simulator::expert`'s tests.
    fn default() -> Self {
        Self { reach_m: 4.0, reach_s: 0.35, preview_s: 0.12, lateral_mps2: 4.0, braking_mps2: 3.0 }
    }
}

/// The output of [`PurePursuit`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pursuit {
    /// Normalised steering, positive to the right; beyond -1 and 1 where the line asks for more than the car can.
    pub steering: f64,
    /// The highest speed that suits the bends ahead, braking distance included.
    pub speed_limit: Mph,
}

/// Follows the points of a [`View`]'s path.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PurePursuit {
    gains: PursuitGains,
}

impl PurePursuit {
    /// A follower with these gains.
    pub fn new(gains: PursuitGains) -> Self {
        Self { gains }
    }

    /// The steering and the speed for a line whose points are about a metre apart, the first beside the car; `None` for
    /// fewer than two points.
    pub fn pursue(&self, path: &[PathPoint], speed: MetresPerSecond) -> Option<Pursuit> {
        let [first, second, ..] = path else { return None };
        let speed_mps = speed.get().abs();
        let gains = &self.gains;

        // The line's direction beside the car: that of the first chord, less half the bend along it.
        let (ahead, right) = (second.ahead_m - first.ahead_m, second.right_m - first.right_m);
        let chord = ahead.hypot(right).max(1e-3);
        let heading = right.atan2(ahead) - first.curvature_per_m * chord / 2.0;
        // Metres from the car to the line, positive where it lies to the right.
        let offset = first.right_m * heading.cos() - first.ahead_m * heading.sin();

        let reach = gains.reach_m + gains.reach_s * speed_mps;
        // From far off, the car approaches the line at an angle instead of crossing it at a right angle.
        let offset = offset.clamp(-STEEPEST * reach, STEEPEST * reach);
        let astray = heading - REAR_AXLE_M * self.bend_at(path, -REAR_AXLE_M);
        let towards = 2.0 * (offset + reach * astray) / (reach * reach);
        let curvature = self.bend_at(path, gains.preview_s * speed_mps - REAR_AXLE_M) + towards;
        let angle = Degrees::saturating(steering_deg(curvature));
        Some(Pursuit { steering: angle.get() / Steering::MAX.degrees().get(), speed_limit: self.speed_limit(path) })
    }

    /// The line's bend this many metres ahead; before its first point, that of the first point.
    fn bend_at(&self, path: &[PathPoint], metres: f64) -> f64 {
        let last = path.len() - 1;
        let i = (metres.max(0.0) as usize).min(last);
        let (a, b) = (path[i].curvature_per_m, path[(i + 1).min(last)].curvature_per_m);
        a + (b - a) * (metres - i as f64).clamp(-2.0, 1.0)
    }

    /// The speed that is slow enough here to be slow enough at each bend ahead.
    fn speed_limit(&self, path: &[PathPoint]) -> Mph {
        let mut square = f64::INFINITY; // (m/s)²
        let mut travelled = 0.0;
        for (i, point) in path.iter().enumerate() {
            if let Some(before) = i.checked_sub(1).map(|i| path[i]) {
                travelled += (point.ahead_m - before.ahead_m).hypot(point.right_m - before.right_m);
            }
            let there = self.gains.lateral_mps2 / point.curvature_per_m.abs().max(1e-6);
            square = square.min(there + 2.0 * self.gains.braking_mps2 * travelled);
        }
        MetresPerSecond::saturating(square.sqrt()).mph()
    }
}

impl Pilot for PurePursuit {
    fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError> {
        let pursuit = self.pursue(view.path, view.speed.metres_per_second()).ok_or(PilotError::NoPath)?;
        if !pursuit.steering.is_finite() {
            return Err(PilotError::NotFinite { output: "steering".into(), got: pursuit.steering });
        }
        Ok(Prediction { steering: pursuit.steering, speed_limit: Some(pursuit.speed_limit), ..Prediction::default() })
    }

    fn needs_picture(&self) -> bool {
        false
    }

    fn reset(&mut self) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::Frame;

    /// An arc that begins beside the car, `right_m` to its right, and bends by `curvature`.
    fn arc(right_m: f64, curvature: f64) -> Vec<PathPoint> {
        (0..=40)
            .map(|i| {
                let s = f64::from(i);
                let (ahead_m, right) = if curvature == 0.0 {
                    (s, 0.0)
                } else {
                    ((curvature * s).sin() / curvature, (1.0 - (curvature * s).cos()) / curvature)
                };
                PathPoint { ahead_m, right_m: right_m + right, curvature_per_m: curvature }
            })
            .collect()
    }

    fn pursue(path: &[PathPoint], mps: f64) -> Pursuit {
        PurePursuit::default().pursue(path, MetresPerSecond::new(mps).unwrap()).unwrap()
    }

    #[test]
    fn on_the_line_it_steers_as_the_line_bends() {
        for curvature in [-0.1f64, -0.01, 0.0, 0.02, 0.12] {
            let expected = (2.87 * curvature).atan().to_degrees() / 25.0;
            // The car faces outward as it does in a steady bend.
            let (sin, cos) = (REAR_AXLE_M * curvature).sin_cos();
            let turned = arc(0.0, curvature).into_iter().map(|p| PathPoint {
                ahead_m: p.ahead_m * cos - p.right_m * sin,
                right_m: p.ahead_m * sin + p.right_m * cos,
                ..p
            });
            let steering = pursue(&turned.collect::<Vec<_>>(), 10.0).steering;
            assert!((steering - expected).abs() < 2e-3, "{curvature}: {steering}, expected {expected}");
        }
    }

    #[test]
    fn a_line_to_the_right_is_steered_for_to_the_right_and_more_gently_when_fast() {
        let (slow, fast) = (pursue(&arc(1.0, 0.0), 2.0).steering, pursue(&arc(1.0, 0.0), 13.0).steering);
        assert!(slow > fast && fast > 0.02, "{slow} {fast}");
        assert_eq!(pursue(&arc(-1.0, 0.0), 2.0).steering, -slow);
    }

    #[test]
    fn a_bend_40_m_ahead_is_braked_for_in_time() {
        let mut path = arc(0.0, 0.0);
        assert_eq!(pursue(&path, 10.0).speed_limit, Mph::MAX, "no limit on a straight");
        path[40].curvature_per_m = -1.0 / 16.0;
        // 8 m/s in the bend: v² = 64 + 2 * 3 * 40 here.
        let limit = pursue(&path, 10.0).speed_limit.metres_per_second().get();
        assert!((limit - 304f64.sqrt()).abs() < 1e-9, "{limit}");
        assert!((pursue(&path[30..], 10.0).speed_limit.metres_per_second().get() - 124f64.sqrt()).abs() < 1e-9);
    }

    #[test]
    fn a_world_that_tells_no_path_is_told_so() {
        let error = PurePursuit::default().steer(&View::of(&Frame::default())).unwrap_err();
        assert!(error.to_string().contains("lapwing drive"), "{error}");
    }
}
