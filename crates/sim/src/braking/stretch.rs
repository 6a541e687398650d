//! Where on a road a case is played.

use crate::{
    scenario::{Scenario, Script},
    track::{Edge, Side, Track},
};

/// Places are considered this far apart, in metres.
const STEP_M: f64 = 5.0;
/// The way that is looked at, in metres: that of 7 s at 30 mph, and a little more.
const WAY_M: f64 = 110.0;
/// This share of the places are straight enough, and this share bent enough.
const STRAIGHTEST: f64 = 0.2;
const BENT: f64 = 0.4;
/// Who stands farther beside the road than this beyond its edge needs ground there, in metres.
const VERGE_M: f64 = 0.4;
/// What nobody stands behind.
const WALLS: [Edge; 4] = [Edge::Bridge, Edge::Blocks, Edge::Rock, Edge::Water];

/// The places of a road, the straightest first.
#[derive(Debug)]
pub struct Stretches {
    /// Metres along the road at which our car begins.
    places: Vec<f64>,
}

impl Stretches {
    /// Of a road.
    pub fn of(track: &Track) -> Self {
        let bend = |s: f64| {
            (0..(WAY_M / 2.0) as usize).map(|i| track.at(s + 2.0 * i as f64).curvature.abs()).fold(0.0, f64::max)
        };
        let mut places: Vec<(f64, f64)> = (0..(track.length() / STEP_M) as usize)
            .map(|i| {
                let s = i as f64 * STEP_M;
                (bend(s), s)
            })
            .collect();
        places.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self { places: places.into_iter().map(|(_, s)| s).collect() }
    }

    /// One of the straightest places between two, by a number from 0 to 1, where everything in the scenario has ground to stand
    /// on; where there is none, one of the straightest.
    pub fn straight(&self, track: &Track, scenario: &Scenario, starts: Option<[f64; 2]>, chosen: f64) -> f64 {
        let (reach, places) = (Reach::of(track, scenario), self.between(starts));
        let suits: Vec<f64> = places.iter().copied().filter(|s| reach.suits(track, *s)).collect();
        let from = if suits.is_empty() { &places } else { &suits };
        let count = ((places.len() as f64 * STRAIGHTEST) as usize).clamp(1, from.len());
        pick(&from[..count], chosen)
    }

    /// One of the places with the sharpest bends between two.
    pub fn bent(&self, starts: Option<[f64; 2]>, chosen: f64) -> f64 {
        let places = self.between(starts);
        let first = (places.len() as f64 * (1.0 - BENT)) as usize;
        pick(&places[first..], chosen)
    }

    /// Those between two, of which there is always one; all by default.
    fn between(&self, starts: Option<[f64; 2]>) -> Vec<f64> {
        let Some([from, to]) = starts else { return self.places.clone() };
        let own: Vec<f64> = self.places.iter().copied().filter(|s| (from..=to).contains(s)).collect();
        if own.is_empty() { vec![from] } else { own }
    }
}

fn pick(places: &[f64], chosen: f64) -> f64 {
    places.get((chosen * places.len() as f64) as usize).copied().unwrap_or(0.0)
}

/// How far to each side a scenario reaches beyond the road, and how far ahead.
struct Reach {
    left: bool,
    right: bool,
    ahead_m: f64,
}

impl Reach {
    fn of(track: &Track, scenario: &Scenario) -> Self {
        let mut reach = Self { left: false, right: false, ahead_m: WAY_M };
        let (line, edge) = (track.file().driving_line_m, track.half_width() + VERGE_M);
        let mut at = |offset_m: f64, half_m: f64| {
            reach.right |= line + offset_m + half_m > edge;
            reach.left |= line + offset_m - half_m < -edge;
        };
        for script in &scenario.actors {
            match script {
                Script::Parked { kind, offset_m, .. }
                | Script::Lead { kind, offset_m, .. }
                | Script::Cruise { kind, offset_m, .. } => at(offset_m.value(), kind.size().x / 2.0),
                Script::TurnOff { kind, to_m, .. } => at(to_m.value(), kind.size().x / 2.0),
                Script::Cross { from_m, to_m, .. } => [from_m, to_m].iter().for_each(|m| at(m.value(), 0.2)),
            }
        }
        reach
    }

    /// Whether nothing of it would stand in a wall or in water.
    fn suits(&self, track: &Track, s: f64) -> bool {
        let has = |side, at: f64| WALLS.iter().any(|edge| track.file().has(*edge, side, at.rem_euclid(track.length())));
        let steps = (self.ahead_m / STEP_M) as usize;
        (0..=steps)
            .map(|i| s + i as f64 * STEP_M)
            .all(|at| !(self.left && has(Side::Left, at) || self.right && has(Side::Right, at)))
    }
}
