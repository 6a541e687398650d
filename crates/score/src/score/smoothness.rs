//! Smoothness of a drive, from steering and speed.

use lapwing_core::motion;
use lapwing_core::recording::LONGEST_GAP;

/// Telemetries farther apart than this say nothing about the time between them, in seconds.
pub(super) const GAP_S: f64 = LONGEST_GAP.as_secs_f64();
/// Least turning back that counts as a reversal, in degrees of the front wheels.
const REVERSAL_DEG: f64 = 1.0;
/// Parabolas are fitted to telemetries within this many seconds. nuPlan smooths over 0.8 to 1.5 s with a Savitzky-Golay
/// filter, which is the same for even steps.
const WINDOW_S: f64 = 0.5;
/// Assumed relative error of a bicycle's yaw rate, for the uncertainty of comfort: tyres slip.
const YAW_RATE_OFF: f64 = 0.1;

/// The values of a telemetry.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tick {
    pub at_s: f64,
    pub speed_mps: f64,
    pub steering_deg: f64,
    /// Whether it continues from the one before: no gap, no reset between them.
    pub goes_on: bool,
}

/// The resulting figures.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Smoothness {
    pub rms_jerk: Option<f64>,
    /// Share within nuPlan's bounds, and its uncertainty.
    pub comfort: Option<(f64, f64)>,
}

impl Smoothness {
    pub(super) fn of(samples: &[Tick]) -> Self {
        let stretches: Vec<_> = samples.chunk_by(|_, next| next.goes_on).collect();
        let motions = |factor: f64| stretches.iter().flat_map(move |stretch| motions(stretch, factor));
        let n = motions(1.0).count();
        let mean = |sum: f64| (n > 0).then(|| sum / n as f64);
        let comfort = |factor: f64| mean(motions(factor).filter(MotionAt::is_comfortable).count() as f64);
        Self {
            rms_jerk: mean(motions(1.0).map(|motion| motion.jerk.powi(2)).sum()).map(f64::sqrt),
            comfort: comfort(1.0)
                .zip(comfort(1.0 - YAW_RATE_OFF).zip(comfort(1.0 + YAW_RATE_OFF)))
                .map(|(share, (less, more))| (share, (less - more).abs() / 2.0)),
        }
    }
}

/// How the wheel was turned, from telemetry to telemetry.
#[derive(Debug, Clone, Default)]
pub(super) struct Wheel {
    /// Where this stretch began, in seconds, and its last sample.
    stretch: Option<(f64, Tick)>,
    /// Seconds of the stretches before.
    seconds: f64,
    /// Sum of squared changes over their time.
    squares: f64,
    /// The farthest it was turned since it turned back last, to either side; and which way it turns, 0 until it has turned far
    /// enough.
    least_deg: f64,
    most_deg: f64,
    direction: f64,
    reversals: u32,
}

impl Wheel {
    pub(super) fn sample(&mut self, now: Tick) {
        let Some((began_s, before)) = self.stretch.filter(|_| now.goes_on) else {
            self.seconds = self.seconds();
            self.stretch = Some((now.at_s, now));
            (self.least_deg, self.most_deg, self.direction) = (now.steering_deg, now.steering_deg, 0.0);
            return;
        };
        self.stretch = Some((began_s, now));
        self.squares += (now.steering_deg - before.steering_deg).powi(2) / (now.at_s - before.at_s);
        let deg = now.steering_deg;
        (self.least_deg, self.most_deg) = (self.least_deg.min(deg), self.most_deg.max(deg));
        let direction = if self.direction <= 0.0 && deg - self.least_deg >= REVERSAL_DEG {
            1.0
        } else if self.direction >= 0.0 && self.most_deg - deg >= REVERSAL_DEG {
            -1.0
        } else {
            return;
        };
        self.reversals += u32::from(self.direction != 0.0);
        (self.least_deg, self.most_deg, self.direction) = (deg, deg, direction);
    }

    /// Seconds reported without a gap.
    fn seconds(&self) -> f64 {
        self.seconds + self.stretch.map_or(0.0, |(began_s, last)| last.at_s - began_s)
    }

    pub(super) fn rate_deg_s(&self) -> Option<f64> {
        let seconds = self.seconds();
        (seconds > 0.0).then(|| (self.squares / seconds).sqrt())
    }

    pub(super) fn reversals_per_min(&self) -> Option<f64> {
        let seconds = self.seconds();
        (seconds > 0.0).then(|| f64::from(self.reversals) / (seconds / 60.0))
    }
}

/// How the car moved at a telemetry, in metres, seconds and radians.
#[derive(Debug, Clone, Copy)]
struct MotionAt {
    along: f64,
    across: f64,
    jerk: f64,
    /// Change of the acceleration's magnitude.
    jerk_in_all: f64,
    yaw_rate: f64,
    yaw_acceleration: f64,
}

impl MotionAt {
    /// Within the bounds of nuPlan's `ego_is_comfortable`, which were derived from human drives.
    fn is_comfortable(&self) -> bool {
        (-4.05..=2.40).contains(&self.along)
            && self.across.abs() <= 4.89
            && self.jerk.abs() <= 4.13
            && self.jerk_in_all.abs() <= 8.37
            && self.yaw_rate.abs() <= 0.95
            && self.yaw_acceleration.abs() <= 1.93
    }
}

/// The motions of a stretch, except at its ends; yaw rates times `factor`.
fn motions(stretch: &[Tick], factor: f64) -> Vec<MotionAt> {
    let series = |of: fn(&Tick) -> f64| stretch.iter().map(|sample| (sample.at_s, of(sample))).collect::<Vec<_>>();
    let speeds = parabolas(&series(|sample| sample.speed_mps));
    let yaw_rates = parabolas(&series(|sample| motion::yaw_rate(sample.speed_mps, sample.steering_deg)));
    let mut motions = Vec::new();
    let mut magnitudes = Vec::new();
    for (sample, (speed, yaw_rate)) in stretch.iter().zip(speeds.into_iter().zip(yaw_rates)) {
        let (Some([speed, along, bend]), Some([yaw_rate, yaw_acceleration, _])) = (speed, yaw_rate) else { continue };
        let across = speed * yaw_rate * factor;
        magnitudes.push((sample.at_s, along.hypot(across)));
        motions.push(MotionAt {
            along,
            across,
            jerk: 2.0 * bend,
            jerk_in_all: 0.0,
            yaw_rate: yaw_rate * factor,
            yaw_acceleration: yaw_acceleration * factor,
        });
    }
    for (motion, magnitude) in motions.iter_mut().zip(parabolas(&magnitudes)) {
        motion.jerk_in_all = magnitude.map_or(motion.jerk, |[_, change, _]| change);
    }
    motions
}

/// For each time of a series, c0, c1 and c2 of the parabola c0 + c1 t + c2 t² fitted to the values around it, t counted
/// from there; none if there are too few.
fn parabolas(series: &[(f64, f64)]) -> Vec<Option<[f64; 3]>> {
    let mut from = 0;
    let mut to = 0;
    let one = |&(at, _): &(f64, f64)| {
        while series[from].0 < at - WINDOW_S {
            from += 1;
        }
        while to < series.len() && series[to].0 <= at + WINDOW_S {
            to += 1;
        }
        parabola(series[from..to].iter().map(|(t, y)| (t - at, *y)))
    };
    series.iter().map(one).collect()
}

/// By least squares; none if the times do not determine a parabola, or lie on one side of 0.
fn parabola(points: impl Iterator<Item = (f64, f64)>) -> Option<[f64; 3]> {
    let (mut s, mut m) = ([0.0; 5], [0.0; 3]);
    let (mut first, mut last) = (f64::INFINITY, f64::NEG_INFINITY);
    for (t, y) in points {
        let mut power = 1.0;
        for k in 0..5 {
            s[k] += power;
            if k < 3 {
                m[k] += power * y;
            }
            power *= t;
        }
        (first, last) = (first.min(t), last.max(t));
    }
    let sided = first > -WINDOW_S / 2.0 || last < WINDOW_S / 2.0;
    let determinant = |[a, b, c]: [[f64; 3]; 3]| {
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    let normal = [[s[0], s[1], s[2]], [s[1], s[2], s[3]], [s[2], s[3], s[4]]];
    let whole = determinant(normal);
    // A parabola through three points fits any noise.
    if s[0] < 4.0 || sided || whole < 1e-9 {
        return None;
    }
    // Cramer's rule.
    let mut c = [0.0; 3];
    for (k, c) in c.iter_mut().enumerate() {
        let mut replaced = normal;
        for (row, m) in replaced.iter_mut().zip(m) {
            row[k] = m;
        }
        *c = determinant(replaced) / whole;
    }
    Some(c)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A drive reported 20 times a second.
    fn drive(seconds: f64, of: impl Fn(f64) -> (f64, f64)) -> Vec<Tick> {
        (0..=(seconds * 20.0) as u32)
            .map(|i| {
                let at_s = f64::from(i) / 20.0;
                let (speed_mps, steering_deg) = of(at_s);
                Tick { at_s, speed_mps, steering_deg, goes_on: i > 0 }
            })
            .collect()
    }

    #[test]
    fn a_speed_that_grows_as_the_square_of_time_has_the_jerk_of_its_second_derivative() {
        let smooth = Smoothness::of(&drive(10.0, |t| (0.5 * 0.3 * t * t, 0.0)));
        assert!((smooth.rms_jerk.unwrap() - 0.3).abs() < 1e-9, "{smooth:?}");
        // Acceleration passes 2.40 m/s2 at 8 s; a quarter of a second at each end is not measured.
        let comfort = smooth.comfort.unwrap();
        assert!((comfort.0 - 7.75 / 9.5).abs() < 0.02 && comfort.1 == 0.0, "{smooth:?}");
    }

    #[test]
    fn a_tight_bend_driven_fast_is_not_comfortable() {
        // 15 m/s with 8 degrees: 2.87 m / tan 8° = 20.4 m, 11 m/s2.
        let smooth = Smoothness::of(&drive(5.0, |_| (15.0, 8.0)));
        assert_eq!(smooth.comfort, Some((0.0, 0.0)));
        assert!(smooth.rms_jerk.unwrap() < 1e-9);
        // 4.90 m/s2 is just too much, so the result depends on the accuracy of the bicycle model.
        let (share, off) = Smoothness::of(&drive(5.0, |_| (10.0, 8.0))).comfort.unwrap();
        assert_eq!((share, off), (0.0, 0.5));
    }

    fn wheel(samples: &[Tick]) -> Wheel {
        let mut wheel = Wheel::default();
        samples.iter().for_each(|sample| wheel.sample(*sample));
        wheel
    }

    #[test]
    fn a_wheel_that_swings_by_a_degree_turns_back_twice_a_swing() {
        let swing =
            |degrees: f64| wheel(&drive(60.0, |t| (5.0, degrees / 2.0 * (t * std::f64::consts::TAU / 2.0).cos())));
        // 30 swings in the minute; the first turn is not a reversal.
        assert_eq!(swing(1.5).reversals_per_min(), Some(59.0));
        assert_eq!(swing(0.9).reversals_per_min(), Some(0.0));
        // Wherever in a swing the drive begins: here none goes a degree away from the start.
        let from_the_middle = wheel(&drive(60.0, |t| (5.0, 0.75 * (t * std::f64::consts::TAU / 2.0).sin())));
        assert_eq!(from_the_middle.reversals_per_min(), Some(58.0));
    }

    #[test]
    fn what_is_too_short_is_not_measured() {
        let nothing = Smoothness::of(&[]);
        assert_eq!(nothing, Smoothness::default());
        let short = Smoothness::of(&drive(0.4, |_| (5.0, 0.0)));
        assert_eq!((short.rms_jerk, short.comfort), (None, None));
    }

    #[test]
    fn nothing_is_measured_across_a_gap() {
        let mut samples = drive(4.0, |t| (if t < 2.0 { 0.0 } else { 20.0 }, if t < 2.0 { 0.0 } else { 20.0 }));
        samples[40].goes_on = false;
        let smooth = Smoothness::of(&samples);
        assert_eq!(wheel(&samples).rate_deg_s(), Some(0.0));
        assert!(smooth.rms_jerk.unwrap() < 1e-9, "{smooth:?}");
    }
}
