//! What a tyre gives sideways.

/// Slip at which a tyre grips most, in radians: `extremumSlip` of Unity's default sideways curve. With it and
/// [`STIFFNESS`] the yaw rate follows the steering as in the frames; 0.1 and 0.3 follow it worse (`calibrate`).
const BEST_SLIP: f64 = 0.2;
/// Slip from which on a tyre just slides: its `asymptoteSlip`.
const SLIDING_SLIP: f64 = 0.5;
/// Share of the best grip that a sliding tyre has: its `asymptoteValue`. Locked wheels slide too: the lake recording
/// brakes with 16.6 mph/s around 25 mph.
pub(super) const SLIDING: f64 = 0.75;
/// Slope of the curve at no slip, in units of best grip over best slip.
const STIFFNESS: f64 = 2.0;
/// Slip is an angle that is ill defined at low speed; below this speed, in metres per second, it is computed for this
/// speed.
const SLOWEST: f64 = 1.0;

/// A lateral force and how it falls with lateral speed.
pub(super) struct Force {
    /// Newtons to the right.
    pub(super) newton: f64,
    /// Newtons a metre per second, not negative.
    pub(super) stiffness: f64,
}

/// The force of a tyre that can give `grip` newtons, and moves forward and sideways at these speeds in its own frame.
pub(super) fn force(grip: f64, forward: f64, sideways: f64) -> Force {
    let forward = forward.abs().max(SLOWEST);
    let slip = (sideways / forward).atan();
    let (share, slope) = curve(slip.abs());
    Force {
        newton: -(grip * share).copysign(slip),
        stiffness: grip * slope.max(0.0) * forward / (forward * forward + sideways * sideways),
    }
}

/// Share of the best grip at a slip, and its slope: two cubics, as Unity draws its curve.
fn curve(slip: f64) -> (f64, f64) {
    if slip < BEST_SLIP {
        let x = slip / BEST_SLIP;
        let (square, cube) = (3.0 - 2.0 * STIFFNESS, STIFFNESS - 2.0);
        (x * (STIFFNESS + x * (square + x * cube)), (STIFFNESS + x * (2.0 * square + 3.0 * x * cube)) / BEST_SLIP)
    } else {
        let x = ((slip - BEST_SLIP) / (SLIDING_SLIP - BEST_SLIP)).min(1.0);
        (1.0 - (1.0 - SLIDING) * x * x * (3.0 - 2.0 * x), 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tyre_grips_most_at_the_best_slip_and_slides_beyond() {
        assert_eq!(curve(0.0).0, 0.0);
        assert!((curve(BEST_SLIP).0 - 1.0).abs() < 1e-12);
        assert!((curve(1.2).0 - SLIDING).abs() < 1e-12);
        for i in 1..200 {
            let slip = f64::from(i) * 0.005;
            let (share, slope) = curve(slip);
            assert!(share > 0.0 && share <= 1.0);
            let by_difference = (curve(slip + 1e-6).0 - curve(slip - 1e-6).0) / 2e-6;
            if slip < BEST_SLIP - 1e-3 {
                assert!((slope - by_difference).abs() < 1e-3, "slope at {slip}: {slope}, {by_difference}");
            }
        }
    }

    #[test]
    fn the_force_opposes_the_slip_and_vanishes_without_it() {
        assert_eq!(force(5000.0, 10.0, 0.0).newton, 0.0);
        assert!(force(5000.0, 10.0, 1.0).newton < 0.0);
        assert!(force(5000.0, -10.0, -1.0).newton > 0.0);
        assert!(force(5000.0, 0.0, 0.3).newton < 0.0);
    }
}
