//! Poses along a drive, by all its pictures and by how the car moved.

use glam::{DMat3, DVec3};

use super::{Fit, Overlay, Pose};
use crate::track::Track;
use lapwing_core::{
    car::REAR_AXLE_M,
    motion::{Motion, around},
    perception::Frame,
};

/// Where cars are that no picture shows: standard deviations of offset from the lane's middle, in metres, and of heading,
/// in radians; a metre of road tells as much of that as [`HABIT`] measurements. With 0.1, offsets on the mountain, whose
/// pictures tell little each, come out a quarter too small.
const BESIDE_M: f64 = 2.0;
const ASKEW_RAD: f64 = 0.3;
const HABIT: f64 = 0.03;
/// What a unit of agreement is worth as a log likelihood. Neighbouring pictures err alike, so each is worth little: on the
/// real lake, side cameras are then found about one standard deviation from where they sit.
const WORTH: f64 = 3.0;
/// The share of it that it is worth for the place along the road: pictures of the same stretch ahead err alike for longer.
/// With 0.2, the place lags behind in the hairpins of the jungle, and the heading with it, until the car is lost.
const PLACE: f64 = 0.6;
/// Pictures that agree no better than the first of these tell nothing, and no better than the second less: what they agree
/// with is not the road.
const UNSEEN: f64 = 0.12;
const SEEN: f64 = 0.25;
/// From so many places a drive is followed if less than [`FOUND`] of it is seen from those before.
const STARTS: usize = 2;
/// A drive of which this share is seen is found.
pub const FOUND: f64 = 0.8;
/// How far ahead the road should be straight where the search starts, in metres, and which curvature counts as straight, in
/// 1/m.
const AHEAD_M: u32 = 30;
const STRAIGHT: f64 = 0.005;
/// A car farther than this beside the road does not see it, in metres.
const FURTHEST_M: f64 = 2.0;
/// What is added to the standard deviations at a picture that tells nothing, or contradicts what is believed: the car may be
/// lost.
const LOST: DVec3 = DVec3::new(1.0, 0.2, 0.04);
/// Another picture tells as much as the first after this many metres; a car that stands learns nothing new.
const NEWS_M: f64 = 0.5;
const NEWS_STANDING: f64 = 0.02;
/// Standard deviations added per metre driven: metres along the road and across, and radians.
const DRIFT: DVec3 = DVec3::new(0.2, 0.006, 0.01);
/// The same between pictures of a car that does not move.
const REST: f64 = 1e-3;
/// A picture farther than this from what was expected, in squared standard deviations, counts for less than half.
const DOUBT: f64 = 12.0;
/// Standard deviations of the first pose, once all pictures were looked at: metres along the road and across, and
/// radians.
const FIRST: DVec3 = DVec3::new(20.0, 1.0, 0.2);
/// A place is known if among so many pictures to both sides the agreement is at least this, in the mean, if they are no
/// farther from what all of them say of how far from the middle the car will be so many metres ahead, which is what a
/// picture shows best, in metres, and if the place is this sure, in metres. Between known places no further apart than so
/// many pictures only the last counts: a mean of more pictures says nothing of fewer.
const WINDOW: usize = 10;
const AGREES: f64 = 0.18;
const APART_M: f64 = 0.35;
const SHOWN_M: f64 = 6.0;
const UNSURE_M: f64 = 0.3;
/// How far the search reaches: so many standard deviations, but at least and at most so far.
const SEARCHED: DVec3 = DVec3::new(2.0, 3.0, 3.0);
const LEAST: DVec3 = DVec3::new(2.5, 0.3, 0.06);
const MOST: DVec3 = DVec3::new(10.0, 3.0, 0.3);
/// A picture that agrees with what is expected by less than this share of what is usual is looked at all over the road, this
/// far to both sides of the lane. Each picture counts this much for what is usual.
const ODD: f64 = 0.85;
const ALL_OVER_M: f64 = 2.0;
const USUAL: f64 = 0.02;
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
    /// How far off the offset is, in metres, and the heading, in radians, for each metre that the place along the road is off: what a picture
    /// of a bend shows may be a car here, or one that is further on and more aside.
    pub per_metre: [f64; 2],
}

impl Deviation {
    /// The same, if the place along the road is not known better than this, in metres.
    pub fn with_place(self, deviation_m: f64) -> Self {
        let [offset, heading] = self.per_metre.map(|per_metre| per_metre * deviation_m);
        Self {
            s_m: self.s_m.hypot(deviation_m),
            offset_m: self.offset_m.hypot(offset),
            heading_rad: self.heading_rad.hypot(heading),
            ..self
        }
    }
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

/// Where the car is known to have been when a picture was taken, up to some metres along the road.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Known {
    /// Which picture.
    pub picture: usize,
    /// There, in the middle of its lane.
    pub pose: Pose,
    /// Standard deviation of the place along the road, in metres.
    pub deviation_m: f64,
}

/// The places that are known: among those around, pictures agree with the drawn road, and with where all of them say the
/// car was.
pub fn seen(located: &[Located]) -> Vec<Option<Located>> {
    let agrees = |i: usize| {
        let around = &located[i.saturating_sub(WINDOW)..(i + WINDOW + 1).min(located.len())];
        let mean = |of: &dyn Fn(&Located) -> f64| around.iter().map(of).sum::<f64>() / around.len() as f64;
        let agreement = mean(&|located| located.fit.agreement);
        let ahead = |pose: &Pose| pose.offset_m + SHOWN_M * pose.heading_rad.sin();
        let apart_m = mean(&|located| (ahead(&located.fit.pose) - ahead(&located.pose)).abs());
        agreement >= AGREES && apart_m <= APART_M
    };
    let agreeing: Vec<usize> = (0..located.len()).filter(|&i| agrees(i)).collect();
    let mut known = vec![false; located.len()];
    for &i in &agreeing {
        known[i] = true;
    }
    for pair in agreeing.windows(2).filter(|pair| pair[1] - pair[0] <= WINDOW) {
        known[pair[0]..pair[1]].fill(true);
    }
    let sure =
        |(located, known): (&Located, bool)| Some(*located).filter(|it| known && it.deviation.offset_m <= UNSURE_M);
    located.iter().zip(known).map(sure).collect()
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
        // The rear axle goes where the car heads; the car's origin, ahead of it, also swings out as the car turns.
        let (sin, cos) = (heading + turned / 2.0).sin_cos();
        let aside = motion.way_m * sin + REAR_AXLE_M * motion.turn_rad * cos;
        let mean = self.mean + DVec3::new(along, aside, turned);
        let bend_per_m = (track.at(s + 1.0).curvature - track.at(s - 1.0).curvature) / 2.0;
        let by_s = DVec3::new(1.0, 0.0, -bend_per_m * along);
        let by_offset = DVec3::new(bend * along, 1.0, -bend * bend * along);
        let by_heading = DVec3::new(0.0, motion.way_m * heading.cos(), 1.0);
        let jacobian = DMat3::from_cols(by_s, by_offset, by_heading);
        let unknown = DRIFT * motion.way_m.abs() + REST;
        let covariance = jacobian * self.covariance * jacobian.transpose() + DMat3::from_diagonal(unknown * unknown);
        (Self { mean, covariance }, jacobian)
    }

    /// How far a picture's answer is from what was expected, in squared standard deviations.
    fn surprise(&self, fit: &Fit) -> f64 {
        let (information, off) = (told(fit) * WORTH, fit.pose.vector() - self.mean);
        // (P + 1/I)^-1 without an inverse of I, which there may not be.
        off.dot((DMat3::IDENTITY + information * self.covariance).inverse() * information * off)
    }

    /// After a measurement of one of place, offset and heading, with its standard deviation.
    fn told(&self, axis: usize, value: f64, deviation: f64) -> Self {
        let of_all = self.covariance.col(axis);
        let gain = of_all / (of_all[axis] + deviation * deviation);
        let mean = self.mean + gain * (value - self.mean[axis]);
        let reduced = DMat3::from_cols(gain * of_all.x, gain * of_all.y, gain * of_all.z);
        Self { mean, covariance: self.covariance - reduced }
    }

    /// Less sure by this share of [`LOST`].
    fn doubted(self, share: f64) -> Self {
        let unknown = LOST * share;
        Self { covariance: self.covariance + DMat3::from_diagonal(unknown * unknown), ..self }
    }

    /// How far a picture's answer is believed, 0 to 1: the less, the farther it is from what was expected.
    fn believes(&self, fit: &Fit) -> f64 {
        1.0 / (1.0 + (self.surprise(fit) / DOUBT).powi(2))
    }

    /// After a picture.
    fn seen(&self, fit: &Fit, news: f64) -> Self {
        let information = told(fit) * (WORTH * news * self.believes(fit));
        let covariance = (self.covariance.inverse() + information).inverse();
        Self { mean: self.mean + covariance * (information * (fit.pose.vector() - self.mean)), covariance }
    }
}

/// What is known of a drive but for its pictures.
#[derive(Debug, Clone, Copy)]
struct Drive<'a> {
    track: &'a Track,
    motions: &'a [Motion],
    known: &'a [Known],
    /// The place that is known best.
    start: &'a Known,
}

impl<'a> Drive<'a> {
    /// From the places to start from, the best first.
    fn all(track: &'a Track, motions: &'a [Motion], known: &'a [Known]) -> Vec<Self> {
        // Where the road ahead is straight, an error along it does not matter.
        let unsure = |known: &Known| {
            let ahead = |m: u32| known.pose.s_m + f64::from(m) * known.pose.heading_rad.cos();
            let bends = (0..AHEAD_M).map(|m| track.at(ahead(m)).curvature.abs());
            known.deviation_m * bends.fold(STRAIGHT, f64::max)
        };
        let mut here: Vec<_> = known.iter().filter(|known| known.picture < motions.len()).collect();
        here.sort_by(|a, b| unsure(a).total_cmp(&unsure(b)));
        here.into_iter().map(|start| Self { track, motions, known, start }).collect()
    }

    fn begin(&self) -> Belief {
        Belief::of(self.start.pose, DVec3::new(self.start.deviation_m.max(LEAST.x), BESIDE_M, ASKEW_RAD))
    }

    /// On to a picture from the one before, if there is one; and how the new mean depends on the old one.
    fn on(&self, to: usize, belief: Belief) -> (Belief, DMat3) {
        belief.moved(self.track, self.motions[to])
    }

    /// Back to a picture from the one after it, if there is one.
    fn back(&self, to: usize, belief: Belief) -> Belief {
        self.motions.get(to + 1).map_or(belief, |motion| {
            belief.moved(self.track, Motion { way_m: -motion.way_m, turn_rad: -motion.turn_rad }).0
        })
    }

    /// How far a picture is believed by how well it agrees at best, 0 to 1; not at all where no road is.
    fn clearness(&self, fit: &Fit) -> f64 {
        let beside = fit.pose.offset_m.abs() > self.track.half_width() + FURTHEST_M;
        if beside { 0.0 } else { ((fit.agreement - UNSEEN) / (SEEN - UNSEEN)).clamp(0.0, 1.0) }
    }

    /// How far a clear picture contradicts what is believed, 0 to 1: one of them is wrong.
    fn contradicted(&self, belief: &Belief, fit: &Fit) -> f64 {
        self.clearness(fit) * (1.0 - belief.believes(fit))
    }

    /// How likely the car is lost while it is followed, 0 to 1: its picture tells nothing, or something else.
    fn lost(&self, belief: &Belief, fit: &Fit) -> f64 {
        (1.0 - self.clearness(fit)).max(self.contradicted(belief, fit))
    }

    /// What a picture shows; and what else is known there: cars keep to their lanes, and a place now and then.
    fn seen(&self, i: usize, belief: &Belief, fit: &Fit) -> Belief {
        let news = news(self.motions[i]);
        let (lane, habit) = (self.start.pose, (HABIT * news).sqrt());
        let belief = belief.seen(fit, news * self.clearness(fit)).told(1, lane.offset_m, BESIDE_M / habit).told(
            2,
            lane.heading_rad,
            ASKEW_RAD / habit,
        );
        let here = self.known.iter().filter(|known| known.picture == i);
        here.fold(belief, |belief, known| {
            let off = around(known.pose.s_m - belief.mean.x, self.track.length());
            belief.told(0, belief.mean.x + off, known.deviation_m)
        })
    }
}

/// How sharply a picture tells the pose.
fn told(fit: &Fit) -> DMat3 {
    let share = DMat3::from_diagonal(DVec3::new(PLACE.sqrt(), 1.0, 1.0));
    share * fit.sharpness * share
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
    /// Follows a drive to both sides of a picture whose place is known: the one from which most of the drive is seen, of a
    /// few. `motions` say how the car came to each picture from the one before; the first is not used. `picture` reads one
    /// into the frame it is given, and may be asked for one again; a frame of another size says nothing. If no place is
    /// known, nothing is located.
    ///
    /// # Errors
    /// What `picture` says.
    pub fn follow<E>(
        &mut self,
        known: &[Known],
        motions: &[Motion],
        mut picture: impl FnMut(usize, &mut Frame) -> Result<(), E>,
    ) -> Result<Vec<Located>, E> {
        let track = self.track.clone();
        let (mut tried, mut best, mut most): (Vec<usize>, _, _) = (vec![], vec![], None);
        for drive in Drive::all(&track, motions, known) {
            let far = motions.len() / (STARTS + 1);
            if tried.len() == STARTS || tried.iter().any(|before| before.abs_diff(drive.start.picture) < far) {
                continue;
            }
            tried.push(drive.start.picture);
            let located = self.follow_from(&drive, &mut picture)?;
            let share = seen(&located).iter().flatten().count() as f64 / motions.len() as f64;
            if most.is_none_or(|most| share > most) {
                (best, most) = (located, Some(share));
            }
            if share >= FOUND {
                break;
            }
        }
        Ok(best)
    }

    /// The same from one place.
    fn follow_from<E>(
        &mut self,
        drive: &Drive,
        picture: &mut impl FnMut(usize, &mut Frame) -> Result<(), E>,
    ) -> Result<Vec<Located>, E> {
        let motions = drive.motions;
        let (first, start) = (drive.start.picture, drive.start.pose);
        let (mut frame, mut fits) = (Frame::default(), vec![None; motions.len()]);
        let (mut belief, mut pitch_rad, mut usual) = (drive.begin(), start.pitch_rad, 0.0);
        let kept = |pitch_rad: f64, fit: &Fit| {
            PITCH_KEPT * pitch_rad + (1.0 - PITCH_KEPT) * fit.pose.pitch_rad.clamp(-PITCH_RAD, PITCH_RAD)
        };
        for (i, kept_fit) in fits.iter_mut().enumerate().skip(first) {
            if i > first {
                belief = drive.on(i, belief).0;
            }
            picture(i, &mut frame)?;
            let expected = Pose { pitch_rad, ..start.at(belief.mean) };
            let fit = self.look(&frame, expected, searched(&belief), start, &mut usual);
            let lost = drive.lost(&belief, &fit);
            belief = drive.seen(i, &belief, &fit).doubted(lost);
            pitch_rad = kept(pitch_rad, &fit);
            *kept_fit = Some(fit);
        }
        // Back again, at those before, and at what later pictures contradict: most of all the first ones, whose place was
        // a guess.
        for i in (0..fits.len()).rev() {
            belief = drive.back(i, belief);
            let before = fits[i];
            pitch_rad = before.map_or(pitch_rad, |fit| fit.pose.pitch_rad.clamp(-PITCH_RAD, PITCH_RAD));
            let mut best = before.filter(|fit| belief.surprise(fit) <= DOUBT);
            if best.is_none() {
                picture(i, &mut frame)?;
                let expected = Pose { pitch_rad, ..start.at(belief.mean) };
                let again = self.look(&frame, expected, searched(&belief), start, &mut usual);
                let worse = |before: &Fit| {
                    again.agreement <= before.agreement - NO_WORSE || belief.surprise(&again) >= belief.surprise(before)
                };
                pitch_rad = kept(pitch_rad, &again);
                best = before.filter(worse).or(Some(again));
            }
            if let Some(fit) = best {
                let lost = drive.lost(&belief, &fit);
                belief = drive.seen(i, &belief, &fit).doubted(lost);
            }
            fits[i] = best;
        }
        let fits: Vec<_> = fits.into_iter().flatten().collect();
        Ok(smoothed(drive, start.at(belief.mean), &fits))
    }

    /// Looks where the car is expected; and if that agrees worse than usual, all over the road.
    fn look(&mut self, frame: &Frame, expected: Pose, reach: DVec3, lane: Pose, usual: &mut f64) -> Fit {
        let mut fit = self.lay(frame, expected, reach);
        if fit.agreement < ODD * *usual {
            let middle = Pose { offset_m: lane.offset_m, heading_rad: lane.heading_rad, ..expected };
            let again = self.lay(frame, middle, DVec3::new(MOST.x, ALL_OVER_M, MOST.z));
            if again.agreement > fit.agreement + NO_WORSE {
                fit = again;
            }
        }
        *usual += (fit.agreement - *usual) * USUAL;
        fit
    }
}

/// Forwards through a drive from where it began, and back.
fn smoothed(drive: &Drive, began: Pose, fits: &[Fit]) -> Vec<Located> {
    let mut belief = Belief::of(began, FIRST);
    let mut forwards = Vec::with_capacity(fits.len());
    for (i, fit) in fits.iter().enumerate() {
        let (expected, jacobian) = if i > 0 { drive.on(i, belief) } else { (belief, DMat3::IDENTITY) };
        let filtered = drive.seen(i, &expected, fit);
        forwards.push((expected, jacobian, filtered));
        // Else a belief that has gone astray stays sure of itself, and no later picture is believed any more.
        belief = filtered.doubted(drive.contradicted(&expected, fit));
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
        let with_place = smoothed.covariance.x_axis / smoothed.covariance.x_axis.x.max(f64::MIN_POSITIVE);
        let deviation = Deviation { s_m, offset_m, heading_rad, per_metre: [with_place.y, with_place.z] };
        Located { pose: fit.pose.at(smoothed.mean), deviation, fit: *fit }
    });
    let mut located: Vec<_> = back.collect();
    located.reverse();
    located
}
