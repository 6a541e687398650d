//! A particle filter on one road.

use std::sync::Arc;

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::{Match, Road};
use lapwing_core::motion::Motion;

/// Numbers of particles at the road's start, where most drives begin, and all along it.
const FROM_START: usize = 300;
const FROM_ANYWHERE: usize = 6000;
/// Number of particles if the start is known for certain: enough not to lose drivers who weave at full lock.
const FROM_KNOWN_START: usize = 3000;
/// Fewest particles otherwise, once the car is located, and how many for each 2 m of road where it may be.
const FEWEST: usize = 800;
const FOR_A_BIN: usize = 30;
const BIN_M: f64 = 2.0;
/// How much a new search for the car counts against a road, as a log likelihood.
const SOUGHT: f64 = 10.0;
/// Most of the time, drivers keep their heading within this many radians of the road's, and their place within this
/// many metres of its middle.
const HEADING_RAD: f64 = 0.14;
const OFFSET_M: f64 = 2.0;
/// The same for a driver who weaves; the share of particles that assume such a driver; and the share of redrawn
/// particles that redraw this assumption. While the road is still unknown none do, as weaving would explain any bend.
const WEAVING_RAD: f64 = 0.4;
const WEAVING: f64 = 0.2;
const CHANGES: f64 = 0.02;
/// Another observation within this many metres adds nothing new.
pub(super) const NEW_AFTER_M: f64 = 10.0;
/// No observation counts against a place by more than this, in squared standard deviations: cars do leave roads.
const AGAINST: f64 = 12.0;
/// Over this many metres a road must explain a drive by more than half of that, or the search for the car starts again.
const LOST_AFTER_M: f64 = 40.0;
/// How far a car that began at a known start and got lost is from where it seems to be, as a standard deviation.
const LOST_WITHIN_M: f64 = 20.0;
/// The least average log likelihood of an observation on the right road: real drives reach -0.6 on the lake and -1.9 in
/// the jungle; drives around unknown roads -2.6 at best.
pub const EXPLAINED: f64 = -2.3;
/// Metres between two checks of where the car is and how far it has certainly come.
const SURE_EVERY_M: f64 = 20.0;
/// Places are told apart by this, in metres; and the share of what is believed that may be left out.
const PLACE_M: f64 = 10.0;
const UNLIKELY: f64 = 1e-3;
/// Standard deviation, in metres, above which the car's place counts as unknown.
pub(super) const VAGUE_M: f64 = 15.0;
/// What is unknown about the car, as standard deviations: the scale of a reported metre, the gain of a reported radian
/// (tyres slip), and the drift over a metre.
const SCALE: f64 = 0.01;
const GAIN: f64 = 0.08;
const DRIFT_RAD: f64 = 0.006;
const SLIP_M: f64 = 0.03;

/// One guess.
#[derive(Debug, Clone, Copy)]
struct Particle {
    /// Metres along the road, 0 to its length.
    s: f64,
    /// Metres along it since the drive began, over all laps.
    progress_m: f64,
    /// Metres to the right of its middle.
    offset: f64,
    /// Heading relative to the road's, in radians clockwise, and its usual size, as a standard deviation.
    error: f64,
    keeps_rad: f64,
    scale: f64,
    gain: f64,
    log_weight: f64,
}

impl Particle {
    /// A guess at a place; `spread` is 1 for a car anywhere across the road, less for one that stands straight.
    fn new(s: f64, spread: f64, random: &mut ChaCha8Rng) -> Self {
        Self {
            s,
            progress_m: 0.0,
            offset: spread * OFFSET_M * gauss(random),
            error: spread * HEADING_RAD * gauss(random),
            keeps_rad: HEADING_RAD,
            scale: 1.0 + SCALE * gauss(random),
            gain: 1.0 + GAIN * gauss(random),
            log_weight: 0.0,
        }
    }
}

/// Guesses all along the road.
fn anywhere(road: &Road, random: &mut ChaCha8Rng) -> Vec<Particle> {
    let step = road.length_m / FROM_ANYWHERE as f64;
    (0..FROM_ANYWHERE).map(|i| Particle::new(step * i as f64, 1.0, random)).collect()
}

/// Guesses that the car stands at the road's start.
fn from_start(count: usize, road: &Road, random: &mut ChaCha8Rng) -> Vec<Particle> {
    (0..count).map(|_| Particle::new(road.start_m + gauss(random), 0.3, random)).collect()
}

/// Where the car is, by all guesses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Whereabouts {
    /// Metres along the road, 0 to its length.
    pub s_m: f64,
    /// Standard deviation of that, in metres; if the guesses are spread all over the road, that of any place on it.
    pub deviation_m: f64,
    /// Metres along the road since the drive began, over all laps.
    pub progress_m: f64,
}

/// Where the car was after a distance driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Milestone {
    /// Metres driven.
    pub way_m: f64,
    /// Metres along the road, 0 to its length.
    pub s_m: f64,
    /// Metres along the road since the drive began, over all laps.
    pub progress_m: f64,
    /// Standard deviation of both, in metres.
    pub deviation_m: f64,
}

/// Follows a car along one road.
#[derive(Debug, Clone)]
pub struct Filter {
    road: Arc<Road>,
    particles: Vec<Particle>,
    random: ChaCha8Rng,
    /// Log of how well the road explains the drive, relative to a drive that is always in its middle.
    evidence: f64,
    /// The same per recent observation, as an average over [`LOST_AFTER_M`].
    of_late: f64,
    /// Metres driven.
    way_m: f64,
    /// Metres along the road that the car has certainly come, and the metres driven when that was last checked.
    sure_m: f64,
    asked_m: f64,
    /// Where it seemed to be when the last new search started, and the metres driven until then.
    sought: Option<(Whereabouts, f64)>,
    /// Where it was, at each check at which that was known.
    trail: Vec<Milestone>,
    /// Whether its start is known for certain.
    is_anchored: bool,
}

impl Filter {
    /// A car that is known to stand at the road's start.
    pub fn at_start(road: Arc<Road>, mut random: ChaCha8Rng) -> Self {
        let mut particles = from_start(FROM_KNOWN_START, &road, &mut random);
        particles.iter_mut().for_each(|particle| particle.keeps_rad = keeps(&mut random));
        Self::begin(road, particles, random, true)
    }

    /// A car at the road's start or, as likely, anywhere on it.
    pub fn new(road: Arc<Road>, mut random: ChaCha8Rng) -> Self {
        let mut particles = anywhere(&road, &mut random);
        let count = FROM_START + FROM_ANYWHERE;
        let of_half = |n: usize| (count as f64 / 2.0 / n as f64).ln();
        particles.iter_mut().for_each(|particle| particle.log_weight = of_half(FROM_ANYWHERE));
        let at_start = from_start(FROM_START, &road, &mut random).into_iter();
        particles.extend(at_start.map(|particle| Particle { log_weight: of_half(FROM_START), ..particle }));
        Self::begin(road, particles, random, false)
    }

    fn begin(road: Arc<Road>, particles: Vec<Particle>, random: ChaCha8Rng, is_anchored: bool) -> Self {
        let (evidence, of_late, way_m, sure_m, asked_m) = (0.0, 0.0, 0.0, 0.0, 0.0);
        let (sought, trail) = (None, vec![]);
        let mut filter =
            Self { road, particles, random, evidence, of_late, way_m, sure_m, asked_m, sought, trail, is_anchored };
        filter.trail = filter.milestone(filter.place()).into_iter().collect();
        filter
    }

    /// The car moved.
    pub fn step(&mut self, motion: Motion) {
        if motion.way_m <= 0.0 {
            return; // a car that stands learns nothing
        }
        self.way_m += motion.way_m;
        let Self { road, particles, random, .. } = self;
        let (drift, slip) = (DRIFT_RAD * motion.way_m.sqrt(), SLIP_M * motion.way_m.sqrt());
        let news = motion.way_m / NEW_AFTER_M;
        for particle in particles.iter_mut() {
            let way = motion.way_m * particle.scale;
            let heading = road.heading(particle.s);
            // In a bend, the car's path is longer or shorter than the road's middle; gain and scale absorb that.
            let (slips, drifts) = two_gauss(random);
            let turn = motion.turn_rad * particle.gain;
            // The heading halfway through the step.
            let (sin, cos) = (particle.error + turn / 2.0).sin_cos();
            let along = way * cos + slip * slips;
            particle.offset += way * sin;
            let ahead = particle.s + along;
            particle.error += turn - (road.heading(ahead) - heading) + drift * drifts;
            particle.s = if (0.0..road.length_m).contains(&ahead) { ahead } else { ahead.rem_euclid(road.length_m) };
            particle.progress_m += along;
            let off = (particle.error / particle.keeps_rad).powi(2) + (particle.offset / OFFSET_M).powi(2);
            let spread = (particle.keeps_rad / HEADING_RAD).ln();
            particle.log_weight -= (0.5 * off.min(AGAINST) + spread) * news;
        }
        let explained = self.settle();
        let share = (motion.way_m / LOST_AFTER_M).min(1.0);
        self.of_late += share * (explained / news - self.of_late);
        if self.of_late < -0.5 * AGAINST / 2.0 {
            self.seek();
        } else if self.way_m - self.asked_m >= SURE_EVERY_M {
            self.asked_m = self.way_m;
            let place = self.settled();
            self.sure_m = self.sure_m.max(place.progress_m - 2.0 * place.deviation_m);
            self.trail.extend(self.milestone(place));
        }
    }

    /// The car moved unseen: this far along the road, up to a standard deviation.
    pub fn skip(&mut self, way_m: f64, deviation_m: f64) {
        self.way_m += way_m;
        let Self { road, particles, random, .. } = self;
        for particle in particles {
            let (along, across) = two_gauss(random);
            let along = (way_m + deviation_m * along).max(0.0);
            particle.s = (particle.s + along).rem_euclid(road.length_m);
            particle.progress_m += along;
            // Assume that it stayed on the road.
            particle.offset = OFFSET_M * across;
            particle.error = HEADING_RAD * gauss(random);
        }
    }

    /// Keeps half of the guesses and spreads the others over the road, or around where they were if the start is known.
    fn seek(&mut self) {
        let place = self.place();
        self.sought = Some((place, self.way_m));
        let keep = FROM_ANYWHERE.min(self.particles.len());
        let (step, from) = (self.particles.len() as f64 / keep as f64, uniform(&mut self.random));
        let kept = (0..keep).map(|i| self.particles[((i as f64 + from) * step) as usize % self.particles.len()]);
        let kept: Vec<_> = kept.collect();
        // Wherever it is, the distance along the road stays the same.
        let progress_m = place.progress_m;
        let random = &mut self.random;
        let spread: Vec<_> = if self.is_anchored {
            let near = |_| {
                let off = LOST_WITHIN_M * gauss(random);
                let s = (place.s_m + off).rem_euclid(self.road.length_m);
                let keeps_rad = keeps(random);
                Particle { progress_m: progress_m + off, keeps_rad, ..Particle::new(s, 1.0, random) }
            };
            (0..keep).map(near).collect()
        } else {
            anywhere(&self.road, random).into_iter().map(|p| Particle { progress_m, ..p }).collect()
        };
        let half = |count: usize| ((kept.len() + spread.len()) as f64 / 2.0 / count as f64).ln();
        let (stay, leave) = (half(kept.len()), half(spread.len()));
        let stayed = kept.iter().map(|p| Particle { log_weight: p.log_weight + stay, ..*p });
        let particles = stayed.chain(spread.iter().map(|p| Particle { log_weight: leave, ..*p })).collect();
        self.particles = particles;
        self.evidence -= SOUGHT;
        self.of_late = 0.0;
        self.settle();
    }

    /// Scales the weights to a mean of one, and resamples if few particles carry most of the weight. Returns the log of
    /// the former mean.
    fn settle(&mut self) -> f64 {
        let n = self.particles.len() as f64;
        let most = self.particles.iter().fold(f64::NEG_INFINITY, |most, p| most.max(p.log_weight));
        let weights: Vec<f64> = self.particles.iter().map(|p| (p.log_weight - most).exp()).collect();
        let sum: f64 = weights.iter().sum();
        let mean = most + (sum / n).ln();
        self.evidence += mean;
        for particle in &mut self.particles {
            particle.log_weight -= mean;
        }
        let effective = sum * sum / weights.iter().map(|w| w * w).sum::<f64>();
        if effective < n / 2.0 {
            self.redraw(&weights, sum);
        }
        mean
    }

    /// Systematic resampling.
    fn redraw(&mut self, weights: &[f64], sum: f64) {
        // As many as it takes to cover all places where the car may be (a simplification of Fox, KLD-sampling, 2001).
        let mut bins: Vec<i64> =
            self.particles.iter().zip(weights).filter(|(_, w)| **w > 1e-3).map(|(p, _)| (p.s / BIN_M) as i64).collect();
        bins.sort_unstable();
        bins.dedup();
        let weaving = self.particles.iter().zip(weights).filter(|(p, _)| p.keeps_rad > HEADING_RAD);
        let weaving = weaving.map(|(_, w)| w).sum::<f64>() / sum;
        let fewest = FEWEST + ((3.0 * weaving).min(1.0) * (FROM_KNOWN_START - FEWEST) as f64) as usize;
        let n = (FOR_A_BIN * bins.len()).clamp(fewest, FROM_START + FROM_ANYWHERE);
        let step = sum / n as f64;
        let mut until = step * uniform(&mut self.random);
        let mut reached = 0.0;
        let mut drawn: Vec<Particle> = Vec::with_capacity(n);
        for (particle, weight) in self.particles.iter().zip(weights) {
            reached += weight;
            while until < reached && drawn.len() < n {
                // The unknowns of the car are varied a little, or all particles would soon share one guess.
                let scale = particle.scale + 0.3 * SCALE * gauss(&mut self.random);
                let gain = particle.gain + 0.3 * GAIN * gauss(&mut self.random);
                let mut keeps_rad = particle.keeps_rad;
                if self.is_anchored && uniform(&mut self.random) < CHANGES {
                    keeps_rad = keeps(&mut self.random);
                }
                drawn.push(Particle { log_weight: 0.0, scale, gain, keeps_rad, ..*particle });
                until += step;
            }
        }
        // Rounding may leave the last place empty.
        while let (true, Some(last)) = (drawn.len() < n, drawn.last().copied()) {
            drawn.push(last);
        }
        self.particles = drawn;
    }

    /// Where the car is, as far as that is proven: if a new search has just started, it may have left the road there
    /// just as well as have driven on.
    fn settled(&self) -> Whereabouts {
        let Some((before, on)) = self.sought.map(|(place, way_m)| (place, self.way_m - way_m)) else {
            return self.place();
        };
        if on >= LOST_AFTER_M {
            return self.place();
        }
        let s_m = (before.s_m + on / 2.0).rem_euclid(self.road.length_m);
        let deviation_m = before.deviation_m.max(LOST_WITHIN_M);
        Whereabouts { s_m, deviation_m, progress_m: before.progress_m + on / 2.0 }
    }

    /// Where the car is.
    pub fn place(&self) -> Whereabouts {
        let weighted = |of: &dyn Fn(&Particle) -> f64| -> f64 {
            self.particles.iter().map(|p| p.log_weight.exp() * of(p)).sum::<f64>()
        };
        let sum = weighted(&|_| 1.0);
        // Places lie on a circle, so this is a circular mean.
        let angle = |p: &Particle| std::f64::consts::TAU * p.s / self.road.length_m;
        let (x, y) = (weighted(&|p| angle(p).cos()) / sum, weighted(&|p| angle(p).sin()) / sum);
        let metres = self.road.length_m / std::f64::consts::TAU;
        let s_m = (y.atan2(x) * metres).rem_euclid(self.road.length_m);
        let deviation_m = (-2.0 * x.hypot(y).clamp(1e-6, 1.0).ln()).sqrt() * metres;
        Whereabouts { s_m, deviation_m, progress_m: weighted(&|p| p.progress_m) / sum }
    }

    /// Where the car may be, in metres along the road, the likeliest place first: the mean in each [`PLACE_M`] of the road, of as many
    /// as are needed to hold all but [`UNLIKELY`] of what is believed.
    pub(super) fn places(&self) -> Vec<f64> {
        // Of each the weight, and the weighted sum of the places.
        let mut bins = vec![(0.0, 0.0); (self.road.length_m / PLACE_M).ceil().max(1.0) as usize];
        for particle in &self.particles {
            let (weight, last) = (particle.log_weight.exp(), bins.len() - 1);
            let (sum, s_m) = &mut bins[((particle.s / PLACE_M) as usize).min(last)];
            (*sum, *s_m) = (*sum + weight, *s_m + weight * particle.s);
        }
        bins.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut left: f64 = bins.iter().map(|(weight, _)| weight).sum();
        let enough = UNLIKELY * left;
        let needed = bins.into_iter().take_while(|(weight, _)| {
            let is_needed = left > enough && *weight > 0.0;
            left -= weight;
            is_needed
        });
        needed.map(|(weight, s_m)| s_m / weight).collect()
    }

    /// The place as one of the trail, if it is known well enough.
    fn milestone(&self, place: Whereabouts) -> Option<Milestone> {
        let Whereabouts { s_m, deviation_m, progress_m } = place;
        (deviation_m < VAGUE_M).then_some(Milestone { way_m: self.way_m, s_m, progress_m, deviation_m })
    }

    /// How well the road explains the drive so far, as a log likelihood: comparable between roads.
    pub fn evidence(&self) -> f64 {
        self.evidence
    }

    /// What is known by now.
    pub fn found(&self) -> Match {
        let explains = self.is_anchored || self.evidence > EXPLAINED * (self.way_m / NEW_AFTER_M).max(1.0);
        let (road, place) = (self.road.clone(), self.settled());
        let trail = self.trail.iter().copied().chain(self.milestone(place)).collect();
        Match { road, evidence: self.evidence, explains, place, sure_m: self.sure_m, trail, tried_m: self.way_m }
    }
}

/// How far a driver's heading deviates.
fn keeps(random: &mut ChaCha8Rng) -> f64 {
    if uniform(random) < WEAVING { WEAVING_RAD } else { HEADING_RAD }
}

/// 0 to 1.
fn uniform(random: &mut ChaCha8Rng) -> f64 {
    f64::from(random.next_u32()) / (f64::from(u32::MAX) + 1.0)
}

/// Normal.
fn gauss(random: &mut ChaCha8Rng) -> f64 {
    two_gauss(random).0
}

/// Two nearly normal numbers: sums of four uniform ones each, which reach 3.5 standard deviations. A step needs
/// thousands of them, and does not need the tails.
fn two_gauss(random: &mut ChaCha8Rng) -> (f64, f64) {
    const DEVIATION: f64 = 147.8; // of the sum of four bytes
    let normal = |bytes: [u8; 4]| (f64::from(bytes.map(u16::from).iter().sum::<u16>()) - 510.0) / DEVIATION;
    let bits = random.next_u64();
    (normal((bits as u32).to_le_bytes()), normal(((bits >> 32) as u32).to_le_bytes()))
}
