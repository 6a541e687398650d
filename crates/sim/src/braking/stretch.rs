//! Where on a road a case is played.

use super::sight::Sight;
use crate::{
    conditions::Conditions,
    obstacles::FRONT_M,
    scenario::{Draw, Scenario, Script},
    scene::{Actor, ActorKind},
    track::{Edge, Side, Track},
    vehicle::Car,
};
use lapwing_core::units::MPS_PER_KMH;

/// Places are considered this far apart, in metres.
const STEP_M: f64 = 5.0;
/// The way that is looked at, in metres: that of 7 s at 30 mph, and a little more.
const WAY_M: f64 = 110.0;
/// This share of the places are straight enough, and this share bent enough.
const STRAIGHTEST: f64 = 0.2;
const BENT: f64 = 0.4;
/// Who stands farther beside the road than this beyond its edge needs ground there, in metres.
const VERGE_M: f64 = 0.4;
/// Times before a car leaves the lane at which it must hide what is ahead of it, in seconds.
const HIDDEN_BEFORE_S: [f64; 3] = [1.0, 0.5, 0.0];
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
    /// on and a car in the lane hides the target, if it has one. If no place has both, one with ground; if none has that, one of
    /// the straightest.
    pub fn straight(&self, track: &Track, scenario: &Scenario, starts: Option<[f64; 2]>, chosen: f64) -> f64 {
        let (reach, places) = (Reach::of(track, scenario), self.between(starts));
        let suits: Vec<f64> = places.iter().copied().filter(|s| reach.suits(track, *s)).collect();
        let hides: Vec<f64> = match Hiding::of(scenario) {
            Some(hiding) => suits.iter().copied().filter(|s| hiding.hides(track, *s)).collect(),
            None => vec![],
        };
        let from = [&hides, &suits].into_iter().find(|from| !from.is_empty()).unwrap_or(&places);
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

/// A car ahead in the lane that hides the scenario's first actor until it leaves the lane: in a bend the camera sees past it.
struct Hiding {
    /// For each of the moments that count, metres along the road from our car's start to our car, to what is hidden, and to what
    /// hides it.
    along_m: [[f64; 3]; HIDDEN_BEFORE_S.len()],
    /// What is hidden, and how far beside our line, in metres.
    target: (ActorKind, f64),
    hider: ActorKind,
}

impl Hiding {
    fn of(scenario: &Scenario) -> Option<Self> {
        let ahead_m = |kind: ActorKind, gap_m: &Draw| FRONT_M + gap_m.value() + kind.size().z / 2.0;
        let mps = |kmh: &Draw| kmh.value() * MPS_PER_KMH;
        let ours_mps = mps(&scenario.ego.speed_kmh);
        let (target, others) = scenario.actors.split_first()?;
        let (kind, offset_m, from_m, target_mps) = match target {
            Script::Parked { kind, ahead_m, offset_m, .. } => (*kind, offset_m, ahead_m.value(), 0.0),
            Script::Cruise { kind, ahead_m, offset_m, speed_kmh, oncoming: false } => {
                (*kind, offset_m, ahead_m.value(), mps(speed_kmh))
            }
            Script::Lead { kind, gap_m, offset_m, speed_kmh: None, .. } => {
                (*kind, offset_m, ahead_m(*kind, gap_m), ours_mps)
            }
            _ => return None,
        };
        others.iter().find_map(|other| match other {
            Script::TurnOff { kind: hider, gap_m, onset_s, .. } => {
                let at = |before_s: f64| {
                    let t = (onset_s.value() - before_s).max(0.0);
                    [ours_mps * t, from_m + target_mps * t, ours_mps * t + ahead_m(*hider, gap_m)]
                };
                Some(Self { along_m: HIDDEN_BEFORE_S.map(at), target: (kind, offset_m.value()), hider: *hider })
            }
            _ => None,
        })
    }

    /// Whether it does if our car begins here.
    fn hides(&self, track: &Track, s: f64) -> bool {
        let put = |kind, along_m: f64, offset_m: f64| {
            let station = track.at(s + along_m);
            let position = station.position + station.right() * (track.file().driving_line_m + offset_m);
            Actor { kind, position, yaw: station.yaw, speed: 0.0, look: 0 }
        };
        let (day, (target, offset_m)) = (Conditions::default(), self.target);
        self.along_m.into_iter().all(|[ours, theirs, between]| {
            let Actor { position, yaw, .. } = put(ActorKind::Car, ours, 0.0);
            let car = Car { position, yaw, ..Car::default() };
            let actors = [put(target, theirs, offset_m), put(self.hider, between, 0.0)];
            let sees = |actors| Sight::from(&car, actors, &day).sees(0);
            sees(&actors[..1]) && !sees(&actors)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::braking::{Case, Layer, Part, Place, Staging, tracks};

    #[test]
    fn on_the_held_out_roads_a_car_in_the_lane_hides_the_target_but_for_a_few_fast_drives() {
        let (mut drives, mut past) = (0, vec![]);
        for name in tracks(Part::HeldOut) {
            let place = Place::open(name).unwrap();
            for case in [Case::Ccrs, Case::Ccrm, Case::Ccrb, Case::Cpla, Case::Cbla] {
                for (speed_mph, seed) in
                    [10.0, 20.0, 29.5].into_iter().flat_map(|mph| (0..4).map(move |seed| (mph, seed)))
                {
                    let staging = Staging { case, layer: Layer::Hidden, part: Part::HeldOut, speed_mph, seed };
                    let scenario = staging.setup(&place).unwrap().scenario.unwrap();
                    let s = scenario.ego.s_m.as_ref().unwrap().value();
                    drives += 1;
                    if !Hiding::of(&scenario).unwrap().hides(place.track(), s) {
                        past.push(staging);
                    }
                }
            }
        }
        assert!(drives == 240 && past.len() <= 2 && past.iter().all(|drive| drive.speed_mph > 20.0), "{past:?}");
    }

    #[test]
    fn in_a_bend_the_camera_sees_past_a_car_in_the_lane() {
        let place = Place::open("random:9").unwrap();
        let staging = Staging { case: Case::Ccrs, layer: Layer::Hidden, part: Part::HeldOut, speed_mph: 20.0, seed: 0 };
        let hiding = Hiding::of(&staging.setup(&place).unwrap().scenario.unwrap()).unwrap();
        let places = Stretches::of(place.track());
        assert!(!hiding.hides(place.track(), places.bent(None, 0.99)));
    }
}
