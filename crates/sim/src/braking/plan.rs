//! The episodes of a data set, from a seed.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{
    case::{Case, Kind, Layer, Part},
    human::{Attention, Temper},
    stage::Staging,
};
use crate::track::Track;
use lapwing_core::units::MPS_PER_MPH;

/// The speeds of the trial, which the data set lies around, in mph.
pub const SPEEDS_MPH: [f64; 5] = [10.0, 15.0, 20.0, 25.0, 30.0];
/// How far around them, and the fastest, which our car can hold.
const AROUND_MPH: f64 = 2.5;
const FASTEST_MPH: f64 = 29.5;
/// The driver's reaction time: mean, standard deviation, and where it is cut off, in seconds.
const REACTION_S: (f64, f64) = (1.0, 0.3);
const REACTION_WITHIN_S: (f64, f64) = (0.4, 1.6);
/// How long the car is kept standing after an emergency, in seconds.
const REST_S: (f64, f64) = (2.0, 5.0);
/// In this share of the hazards to learn from the brake does not answer for a while, in seconds: speeds that fall are then no
/// sign of danger, and what comes close is seen.
const FAILING: f64 = 0.3;
const FAILS_S: (f64, f64) = (0.6, 3.0);
/// Of so many episodes, the last is part of a lap.
const LAP_EVERY: usize = 5;
/// What comes once more for each time that it comes by itself, to learn from alone: the hazards that a network missed most often,
/// and what it braked for in vain.
const MORE: [Case; 7] = [Case::Cpfa, Case::Child, Case::Cbna, Case::Parked, Case::Bends, Case::Bystanders, Case::Waits];
/// The layers of laps, in turn.
const LAP_LAYERS: [Layer; 6] = [Layer::Plain, Layer::Rain, Layer::Plain, Layer::LowSun, Layer::Plain, Layer::Night];
/// Of ten episodes of a kind: seven to learn from, one to choose by, two to judge by.
const PARTS: [Part; 10] = [
    Part::Train,
    Part::HeldOut,
    Part::Train,
    Part::Train,
    Part::Train,
    Part::Validation,
    Part::Train,
    Part::HeldOut,
    Part::Train,
    Part::Train,
];

/// The roads of a part, but for laps. What is held out is played on roads of its own. There are many to learn from: of a few, a
/// network knows every post.
pub fn tracks(part: Part) -> &'static [&'static str] {
    match part {
        Part::Train => &[
            "lake",
            "jungle",
            "mountain",
            "random:1",
            "random:2",
            "random:3",
            "random:4",
            "random:5",
            "random:6",
            "random:13",
            "random:14",
            "random:15",
            "random:16",
            "random:17",
            "random:18",
            "random:19",
            "random:20",
            "random:21",
            "random:22",
            "random:23",
            "random:24",
            "random:25",
            "random:26",
            "random:27",
            "random:28",
            "random:29",
            "random:30",
            "random:31",
            "random:32",
        ],
        Part::Validation => &["random:7", "random:8"],
        Part::HeldOut => &["random:9", "random:10", "random:11", "random:12"],
    }
}

/// The roads of a lap of a part: the three tracks, of which each part has its own piece, as often as its other roads.
fn lap_track(part: Part, drawn: f64) -> &'static str {
    let others = tracks(part);
    let both = |i: f64, of: &[&'static str]| of[((i * of.len() as f64) as usize).min(of.len() - 1)];
    if drawn < 0.5 { both(2.0 * drawn, &Track::NAMES) } else { both(2.0 * drawn - 1.0, others) }
}

/// An episode: a drive of its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// Its name, and that of its file without the ending.
    pub name: String,
    /// For what it is recorded.
    pub part: Part,
    /// What happens.
    pub case: Case,
    /// In which layer.
    pub layer: Layer,
    /// On which road.
    pub track: String,
    /// How fast our car goes, mph.
    pub speed_mph: f64,
    /// From noticing to the foot, in seconds.
    pub reaction_s: f64,
    /// Everything else that is random.
    pub seed: u64,
}

impl Episode {
    /// What is to be staged for it.
    pub fn staging(&self) -> Staging {
        let Self { case, layer, part, speed_mph, seed, .. } = *self;
        Staging { case, layer, part, speed_mph, seed }
    }

    /// Its driver: away with the eyes where there is a hazard, or there would be no emergency.
    pub fn temper(&self) -> Temper {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed ^ 0x7e57);
        let share = rng.random::<f64>();
        let fails = rng.random::<f64>() < FAILING && self.part == Part::Train && self.case.kind() == Kind::Hazard;
        Temper {
            reaction_s: self.reaction_s,
            speed_mps: self.speed_mph * MPS_PER_MPH,
            attention: if self.case.kind() == Kind::Hazard { Attention::Away } else { Attention::Ahead },
            rest_s: REST_S.0 + (REST_S.1 - REST_S.0) * share,
            fails_s: if fails { FAILS_S.0 + (FAILS_S.1 - FAILS_S.0) * rng.random::<f64>() } else { 0.0 },
        }
    }

    /// The same with another draw: of speed, reaction and all else.
    pub fn redrawn(&self, times: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(times);
        let seed = rng.random::<u64>() >> 11; // a number that JSON carries exactly
        Self { seed, reaction_s: reaction_s(&mut rng), ..self.clone() }
    }
}

/// A case in a layer, and whether it is to learn from alone.
type Cell = (Case, Layer, bool);

/// Episodes without end: two hazards and two negatives in turn, then part of a lap; and every case in every layer before the
/// first comes again, so that any beginning is as balanced as can be.
pub fn episodes(seed: u64) -> impl Iterator<Item = Episode> {
    let cells = |kind| {
        let of = |more: bool| {
            let cases = Case::of(kind).filter(move |case| *case != Case::Lap && (!more || MORE.contains(case)));
            cases.flat_map(move |case| case.layers().map(move |layer| (case, layer, more)))
        };
        of(false).chain(of(true)).collect::<Vec<Cell>>()
    };
    let laps: Vec<Cell> = LAP_LAYERS.map(|layer| (Case::Lap, layer, false)).to_vec();
    let [hazards, negatives] = [Kind::Hazard, Kind::Negative].map(cells);
    (0_usize..).map(move |i| {
        let (group, within) = (i / LAP_EVERY, i % LAP_EVERY);
        let (cells, turn) = match within {
            within if within + 1 == LAP_EVERY => (&laps, group),
            within => (if within % 2 == 0 { &hazards } else { &negatives }, group * (LAP_EVERY / 2) + within / 2),
        };
        let count = cells.len();
        // A step that is prime to their numbers mixes cases and layers.
        let (round, cell) = (turn / count, turn * 7 % count);
        let (case, layer, to_learn_from) = cells[cell];
        let part = if to_learn_from { Part::Train } else { PARTS[(round + 3 * cell) % PARTS.len()] };
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(i as u64 + 1);
        let around = SPEEDS_MPH[(round + cell) % SPEEDS_MPH.len()] + AROUND_MPH * (2.0 * rng.random::<f64>() - 1.0);
        let (roads, road) = (tracks(part), rng.random::<f64>());
        let track = match case {
            Case::Lap => lap_track(part, road),
            _ => roads[((road * roads.len() as f64) as usize).min(roads.len() - 1)],
        };
        Episode {
            name: format!("{i:04}-{part}-{case}-{layer}"),
            part,
            case,
            layer,
            track: track.to_owned(),
            speed_mph: (around.clamp(SPEEDS_MPH[0], FASTEST_MPH) * 10.0).round() / 10.0,
            reaction_s: reaction_s(&mut rng),
            seed: rng.random::<u64>() >> 11,
        }
    })
}

/// A reaction time: normal (Box and Muller), drawn again until it is within its limits.
fn reaction_s(rng: &mut ChaCha8Rng) -> f64 {
    loop {
        let (u, v) = (rng.random::<f64>().max(f64::MIN_POSITIVE), rng.random::<f64>());
        let normal = (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos();
        let drawn = REACTION_S.0 + REACTION_S.1 * normal;
        if (REACTION_WITHIN_S.0..=REACTION_WITHIN_S.1).contains(&drawn) {
            return (drawn * 1000.0).round() / 1000.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn what_is_hardest_comes_more_often_to_learn_from_and_no_more_often_to_judge_by() {
        let all: Vec<Episode> = episodes(1).take(6000).collect();
        let count = |case: Case, part: Part| all.iter().filter(|e| e.case == case && e.part == part).count() as f64;
        let times = |part| count(Case::Cpfa, part) / count(Case::Cpna, part);
        assert!((2.2..2.7).contains(&times(Part::Train)), "{}", times(Part::Train)); // 0.7 + 1 of 0.7
        assert!((0.8..1.25).contains(&times(Part::HeldOut)), "{}", times(Part::HeldOut));
        let held_out = all.iter().filter(|e| e.part == Part::HeldOut).count();
        assert!((850..1000).contains(&held_out), "{held_out}");
    }

    #[test]
    fn in_three_of_ten_hazards_to_learn_from_the_brake_fails_and_in_no_other_episode() {
        let (mut hazards, mut failing) = (0, 0);
        for episode in episodes(1).take(6000) {
            let (fails_s, to_learn) = (episode.temper().fails_s, episode.part == Part::Train);
            if episode.case.kind() == Kind::Hazard && to_learn {
                hazards += 1;
                failing += i32::from(fails_s > 0.0);
                assert!(fails_s == 0.0 || (FAILS_S.0..=FAILS_S.1).contains(&fails_s), "{fails_s}");
            } else {
                assert_eq!(fails_s, 0.0, "{episode:?}");
            }
        }
        let share = f64::from(failing) / f64::from(hazards);
        assert!((0.27..0.33).contains(&share), "{share}");
    }

    #[test]
    fn reaction_times_are_about_a_second_and_never_beyond_their_limits() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let drawn: Vec<f64> = (0..4000).map(|_| reaction_s(&mut rng)).collect();
        let mean = drawn.iter().sum::<f64>() / 4000.0;
        let deviation = (drawn.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / 4000.0).sqrt();
        assert!((mean - 1.0).abs() < 0.02 && (0.22..0.3).contains(&deviation), "{mean} {deviation}");
        assert!(drawn.iter().all(|s| (0.4..=1.6).contains(s)));
    }

    #[test]
    fn every_case_in_every_layer_comes_before_the_first_comes_again_and_each_part_has_its_own_roads() {
        let first: Vec<Episode> = episodes(1).take(310).collect();
        // Two of five are hazards, and 60 of them are all in all layers and three more of each of three.
        let cells: BTreeSet<_> = first.iter().take(155).map(|episode| (episode.case, episode.layer)).collect();
        assert_eq!(cells.iter().filter(|(case, _)| case.kind() == Kind::Hazard).count(), 45);
        assert_eq!(cells.iter().filter(|(case, _)| case.kind() == Kind::Negative).count(), 45);
        let names: BTreeSet<_> = first.iter().map(|episode| &episode.name).collect();
        assert_eq!(names.len(), first.len());
        for episode in &first {
            let is_lap = episode.case == Case::Lap && Track::NAMES.contains(&&*episode.track);
            assert!(is_lap || tracks(episode.part).contains(&&*episode.track), "{episode:?}");
            assert!((10.0..=29.5).contains(&episode.speed_mph), "{episode:?}");
        }
        let elsewhere = |part| tracks(Part::Train).iter().all(|track| !tracks(part).contains(track));
        assert!(elsewhere(Part::Validation) && elsewhere(Part::HeldOut));
        assert_eq!(first.iter().filter(|episode| episode.case == Case::Lap).count(), 310 / LAP_EVERY);
        let again: Vec<Episode> = episodes(1).take(310).collect();
        assert_eq!(again, first);
        assert_ne!(episodes(2).next().map(|episode| episode.seed), Some(first[0].seed));
    }
}
