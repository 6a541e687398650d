//! Poses along a drive, by all its pictures and by how the car moved.

use glam::{DMat3, DVec3};

use super::{Fit, Overlay, Pose};
use crate::track::Track;
use lapwing_core::{motion::Motion, perception::Frame};

/// What a unit of agreement is worth as a log likelihood. Neighbouring pictures err alike, so each is worth little: on the
/// real lake, side cameras are then found about one standard deviation from where they sit (median 0.84, 95 % within 2.1).
const WORTH: f64 = 3.0;
/// Another picture tells as much as the first after this many metres; a car that stands learns nothing new.
const NEWS_M: f64 = 0.5;
const NEWS_STANDING: f64 = 0.02;
/// Standard deviations added per metre driven: metres along the road and across, and radians.
const DRIFT: DVec3 = DVec3::new(0.03, 0.006, 0.01);
/// The same between pictures of a car that does not move.
const REST: f64 = 1e-3;
/// A picture farther than this from what was expected, in squared standard deviations, counts for less than half.
const DOUBT: f64 = 12.0;
/// Standard deviations of the first pose: metres along the road and across, and radians.
const FIRST: DVec3 = DVec3::new(3.0, 1.0, 0.2);
/// How far the search reaches: so many standard deviations, but at least and at most so far.
const SEARCHED: DVec3 = DVec3::new(2.0, 3.0, 3.0);
const LEAST: DVec3 = DVec3::new(1.0, 0.3, 0.06);
const MOST: DVec3 = DVec3::new(5.0, 3.0, 0.3);
/// The fit that the other pictures expect replaces the first one if it does not agree worse by more than this.
const NO_WORSE: f64 = 0.03;
/// The body pitches slowly (the share kept from one picture to the next) and within this, in radians.
const PITCH_KEPT: f64 = 0.7;
const PITCH_RAD: f64 = 0.03;

/// How sure a pose is, as standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation {
    /// Metres along the road; too small where it is straight, as a fit then stays near what was expected.
    pub s_m: f64,
    /// Metres across it.
    pub offset_m: f64,
    /// Radians.
    pub heading_rad: f64,
}

/// Where the car was in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Located {
    /// By all pictures and the motion between them.
    pub pose: Pose,
    /// How sure that is.
    pub deviation: Deviation,
    /// By this picture alone.
    pub fit: Fit,
}

/// What is believed of place, offset and heading: a normal distribution.
#[derive(Debug, Clone, Copy)]
struct Belief {
    mean: DVec3,
    covariance: DMat3,
}

impl Belief {
    fn of(pose: Pose, deviations: DVec3) -> Self {
        Self { mean: pose.vector(), covariance: DMat3::from_diagonal(deviations * deviations) }
    }

    fn deviations(&self) -> DVec3 {
        let covariance = self.covariance;
        DVec3::new(covariance.x_axis.x, covariance.y_axis.y, covariance.z_axis.z).max(DVec3::ZERO).map(f64::sqrt)
    }

    /// After the car moved; and how the new mean depends on the old one.
    fn moved(&self, track: &Track, motion: Motion) -> (Self, DMat3) {
        let (s, offset, heading) = self.mean.into();
        let bend = track.at(s).curvature;
        // Nearer the centre of a bend, a metre of road is less.
        let along = motion.way_m * heading.cos() / (1.0 - bend * offset).max(0.3);
        let turned = motion.turn_rad - track.at(s + along / 2.0).curvature * along;
        let aside = motion.way_m * (heading + turned / 2.0).sin();
        let mean = self.mean + DVec3::new(along, aside, turned);
        let bend_per_m = (track.at(s + 1.0).curvature - track.at(s - 1.0).curvature) / 2.0;
        let by_s = DVec3::new(1.0, 0.0, -bend_per_m * along);
        let by_offset = DVec3::new(bend * along, 1.0, -bend * bend * along);
        let by_heading = DVec3::new(0.0, motion.way_m, 1.0);
        let jacobian = DMat3::from_cols(by_s, by_offset, by_heading);
        let unknown = DRIFT * motion.way_m.abs() + REST;
        let covariance = jacobian * self.covariance * jacobian.transpose() + DMat3::from_diagonal(unknown * unknown);
        (Self { mean, covariance }, jacobian)
    }

    /// How far a picture's answer is from what was expected, in squared standard deviations.
    fn surprise(&self, fit: &Fit) -> f64 {
        let (information, off) = (fit.sharpness * WORTH, fit.pose.vector() - self.mean);
        // (P + 1/I)^-1 without an inverse of I, which there may not be.
        off.dot((DMat3::IDENTITY + information * self.covariance).inverse() * information * off)
    }

    /// After a picture.
    fn seen(&self, fit: &Fit, news: f64) -> Self {
        let believed = 1.0 / (1.0 + (self.surprise(fit) / DOUBT).powi(2));
        let information = fit.sharpness * (WORTH * news * believed);
        let covariance = (self.covariance.inverse() + information).inverse();
        Self { mean: self.mean + covariance * (information * (fit.pose.vector() - self.mean)), covariance }
    }
}

/// How much a picture tells that the one before did not.
fn news(motion: Motion) -> f64 {
    (motion.way_m / NEWS_M).clamp(NEWS_STANDING, 1.0)
}

/// How far around what is believed to search.
fn searched(belief: &Belief) -> DVec3 {
    (belief.deviations() * SEARCHED).clamp(LEAST, MOST)
}

impl Overlay {
    /// Follows a drive from about `start` on. `motions` say how the car came to each picture from the one before; the
    /// first is not used. `picture` reads one into the frame it is given, and may be asked for one again.
    ///
    /// # Errors
    /// What `picture` says.
    pub fn follow<E>(
        &mut self,
        start: Pose,
        motions: &[Motion],
        mut picture: impl FnMut(usize, &mut Frame) -> Result<(), E>,
    ) -> Result<Vec<Located>, E> {
        let (mut frame, mut fits) = (Frame::default(), Vec::with_capacity(motions.len()));
        let (mut belief, mut pitch_rad) = (Belief::of(start, FIRST), start.pitch_rad);
        for (i, &motion) in motions.iter().enumerate() {
            if i > 0 {
                belief = belief.moved(&self.track, motion).0;
            }
            picture(i, &mut frame)?;
            let fit = self.lay(&frame, Pose { pitch_rad, ..start.at(belief.mean) }, searched(&belief));
            belief = belief.seen(&fit, news(motion));
            pitch_rad = PITCH_KEPT * pitch_rad + (1.0 - PITCH_KEPT) * fit.pose.pitch_rad.clamp(-PITCH_RAD, PITCH_RAD);
            fits.push(fit);
        }
        // Back again, at what later pictures contradict: most of all the first ones, whose place was a guess.
        for i in (0..fits.len()).rev() {
            if let Some(motion) = motions.get(i + 1) {
                belief = belief.moved(&self.track, Motion { way_m: -motion.way_m, turn_rad: -motion.turn_rad }).0;
            }
            if belief.surprise(&fits[i]) > DOUBT {
                picture(i, &mut frame)?;
                let pitch_rad = fits[i].pose.pitch_rad.clamp(-PITCH_RAD, PITCH_RAD);
                let again = self.lay(&frame, Pose { pitch_rad, ..start.at(belief.mean) }, searched(&belief));
                if again.agreement > fits[i].agreement - NO_WORSE && belief.surprise(&again) < belief.surprise(&fits[i])
                {
                    fits[i] = again;
                }
            }
            belief = belief.seen(&fits[i], news(motions[i]));
        }
        Ok(self.smoothed(start.at(belief.mean), motions, &fits))
    }

    /// Forwards through a drive, and back.
    fn smoothed(&self, start: Pose, motions: &[Motion], fits: &[Fit]) -> Vec<Located> {
        let mut belief = Belief::of(start, FIRST);
        let mut forwards = Vec::with_capacity(fits.len());
        for (i, (fit, &motion)) in fits.iter().zip(motions).enumerate() {
            let (expected, jacobian) =
                if i > 0 { belief.moved(&self.track, motion) } else { (belief, DMat3::IDENTITY) };
            belief = expected.seen(fit, news(motion));
            forwards.push((expected, jacobian, belief));
        }
        let mut later: Option<(Belief, Belief, DMat3)> = None;
        let back = forwards.iter().zip(fits).rev().map(|(&(expected, jacobian, belief), fit)| {
            let mut smoothed = belief;
            if let Some((next, expected, jacobian)) = later {
                let gain = belief.covariance * jacobian.transpose() * expected.covariance.inverse();
                smoothed.mean += gain * (next.mean - expected.mean);
                smoothed.covariance += gain * (next.covariance - expected.covariance) * gain.transpose();
            }
            later = Some((smoothed, expected, jacobian));
            let [s_m, offset_m, heading_rad] = smoothed.deviations().to_array();
            let deviation = Deviation { s_m, offset_m, heading_rad };
            Located { pose: fit.pose.at(smoothed.mean), deviation, fit: *fit }
        });
        let mut located: Vec<_> = back.collect();
        located.reverse();
        located
    }
}
