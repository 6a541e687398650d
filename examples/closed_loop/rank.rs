//! What judges say of pilots, and how well one ranks them as another does.

use lapwing_core::stats::{Agreement, bootstrap, ranks};
use lapwing_score::score::{Figure, Scorecard};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Seed of the samples that an interval is made of, and how many they are.
const SEED: u64 = 20_180_912;
const SAMPLES: usize = 2000;

/// What one pilot came to along one recording, and on its road.
pub struct Driven {
    /// Which pilot.
    pub pilot: String,
    /// Along the recording, closed loop.
    pub replay: Scorecard,
    /// In the simulator.
    pub road: Scorecard,
    /// Along the recording, open loop: its steering and the recorded one.
    pub steering: Agreement,
}

/// The same pilots along one recording.
pub struct Compared {
    /// Which recording.
    pub name: String,
    /// A pilot each, in the same order for all recordings.
    pub drives: Vec<Driven>,
}

/// What pilots are ranked by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measure {
    /// The number of interventions; the 95th percentile of the offset where that is the same.
    Interventions,
    /// Bojarski's autonomy, which has many ties at 0 % and at 100 %.
    Autonomy,
    /// The 95th percentile of the offset.
    P95,
    /// The mean squared error of the steering, open loop.
    Mse,
    /// Its mean absolute error.
    Mae,
    /// Pearson's correlation; 0 for a pilot whose steering does not vary.
    R,
}

impl Measure {
    /// Measures of a drive, which both judges have.
    pub const DRIVE: [Self; 3] = [Self::Interventions, Self::Autonomy, Self::P95];
    /// Measures of single answers.
    pub const OPEN: [Self; 3] = [Self::Mse, Self::Mae, Self::R];

    /// What it is called.
    pub fn name(self) -> &'static str {
        match self {
            Self::Interventions => "interventions, then 95th percentile",
            Self::Autonomy => "autonomy",
            Self::P95 => "95th percentile of the offset",
            Self::Mse => "open loop, MSE",
            Self::Mae => "open loop, MAE",
            Self::R => "open loop, r",
        }
    }

    /// The ranks of these drives, the best first, by how they went along the recording or on the road.
    pub fn ranks(self, drives: &[&Driven], on_road: bool) -> Vec<f64> {
        let badness = |driven: &&Driven| {
            let card = if on_road { &driven.road } else { &driven.replay };
            let value = |figure| card.value(figure).unwrap_or(f64::NAN);
            match self {
                Self::Interventions => [value(Figure::Interventions), value(Figure::P95Cte)],
                Self::Autonomy => [-value(Figure::Autonomy), 0.0],
                Self::P95 => [value(Figure::P95Cte), 0.0],
                Self::Mse => [driven.steering.mse, 0.0],
                Self::Mae => [driven.steering.mae, 0.0],
                Self::R => [-driven.steering.r.unwrap_or(0.0), 0.0],
            }
        };
        let badness: Vec<[f64; 2]> = drives.iter().map(badness).collect();
        ranks(&badness, |a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])))
    }
}

/// How well a measure along recordings ranks pilots as another does on their roads: Spearman's rank correlation. Pilots
/// are ranked among those along the same recording, so that no credit is given for telling an easy road from a hard one.
pub fn correlation(all: &[Compared], along: Measure, on_road: Measure) -> Option<f64> {
    let pilots: Vec<usize> = (0..all.first()?.drives.len()).collect();
    of_pilots(all, &pilots, along, on_road)
}

/// The same with its interval at 95 %: the bootstrap's over pilots, each with its drives along all recordings.
pub fn with_interval(all: &[Compared], along: Measure, on_road: Measure) -> Option<(f64, [f64; 2])> {
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    let draw = |below: usize| (random.next_u64() % below as u64) as usize;
    let pilots = all.first()?.drives.len();
    let interval = bootstrap(pilots, SAMPLES, draw, |sample| of_pilots(all, sample, along, on_road))?;
    Some((correlation(all, along, on_road)?, interval))
}

fn of_pilots(all: &[Compared], pilots: &[usize], along: Measure, on_road: Measure) -> Option<f64> {
    let pairs: Vec<(f64, f64)> = all
        .iter()
        .flat_map(|compared| {
            let drives: Vec<&Driven> = pilots.iter().map(|&pilot| &compared.drives[pilot]).collect();
            along.ranks(&drives, false).into_iter().zip(on_road.ranks(&drives, true))
        })
        .collect();
    Agreement::of(pairs.iter().copied())?.r
}
