//! Which of the known roads it is.

use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use lapwing_core::motion::Motion;

use super::{Filter, Milestone, Road, Whereabouts, filter::NEW_AFTER_M};

/// Motions are collected over this many metres.
pub const STEP_M: f64 = 2.0;
/// A road that explains a drive worse than another by this much, as a log likelihood, is dropped.
const HOPELESS: f64 = 60.0;

/// A road that a drive may have been on.
#[derive(Debug, Clone, PartialEq)]
pub struct Match {
    /// The road.
    pub road: Arc<Road>,
    /// How well it explains the drive, as a log likelihood: comparable between roads.
    pub evidence: f64,
    /// Whether it explains the drive at all.
    pub explains: bool,
    /// Where on it the car is.
    pub place: Whereabouts,
    /// Metres along the road that it has come at least, by two standard deviations when its place was known best.
    pub sure_m: f64,
    /// Where it was on the way there, about every 20 m if that was known.
    pub trail: Vec<Milestone>,
    /// Metres driven while this road was tried: less than all where it was given up.
    pub tried_m: f64,
}

impl Match {
    /// How well the road explains the drive, as a log likelihood for each 10 m; below [`EXPLAINED`](super::EXPLAINED) it does
    /// not.
    pub fn fit(&self) -> f64 {
        self.evidence / (self.tried_m / NEW_AFTER_M).max(1.0)
    }
}

/// Follows a car on all known roads at once.
#[derive(Debug, Clone, Default)]
pub struct Matcher {
    filters: Vec<Filter>,
    gathered: Motion,
}

impl Matcher {
    /// A car at the roads' starts or, as likely, anywhere on them.
    pub fn new(roads: impl IntoIterator<Item = Arc<Road>>, seed: u64) -> Self {
        let filter = |(i, road)| {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            random.set_stream(i as u64);
            Filter::new(road, random)
        };
        Self { filters: roads.into_iter().enumerate().map(filter).collect(), gathered: Motion::default() }
    }

    /// A car that stands at the start of this road.
    pub fn at_start(road: Arc<Road>, seed: u64) -> Self {
        let filter = Filter::at_start(road, ChaCha8Rng::seed_from_u64(seed));
        Self { filters: vec![filter], gathered: Motion::default() }
    }

    /// The car moved.
    pub fn step(&mut self, motion: Motion) {
        self.gathered.way_m += motion.way_m;
        self.gathered.turn_rad += motion.turn_rad;
        if self.gathered.way_m >= STEP_M {
            self.flush();
        }
    }

    /// The car moved unseen: this far along the road, up to a standard deviation.
    pub fn skip(&mut self, way_m: f64, deviation_m: f64) {
        self.flush();
        self.filters.iter_mut().for_each(|filter| filter.skip(way_m, deviation_m));
    }

    fn flush(&mut self) {
        let motion = std::mem::take(&mut self.gathered);
        let best = self.filters.iter().map(Filter::evidence).fold(f64::NEG_INFINITY, f64::max);
        self.filters
            .iter_mut()
            .filter(|filter| filter.evidence() > best - HOPELESS)
            .for_each(|filter| filter.step(motion));
    }

    /// On each road, in the order in which they were given, where the car may be: see `Filter::places`.
    pub(super) fn places(&mut self) -> Vec<Vec<f64>> {
        self.flush();
        self.filters.iter().map(Filter::places).collect()
    }

    /// All roads, the one that explains the drive so far best first.
    pub fn matches(&mut self) -> Vec<Match> {
        self.flush();
        let mut matches: Vec<Match> = self.filters.iter().map(Filter::found).collect();
        matches.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        matches
    }
}
