//! Sets the stage of a case: where on which road, how fast, with what in it, and in which weather.
//!
//! A case is a [`Scenario`] by name, whose target is moved so that our car, if nobody brakes, reaches it after
//! [`LEAD_S`]; what is drawn from the seed besides is in [`vary`].

use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{
    case::{Case, Kind, Layer, Part},
    stretch::Stretches,
};
use crate::{
    camera::Scenery,
    conditions::Conditions,
    obstacles::FRONT_M,
    scenario::{Draw, Ego, Scenario, ScenarioError, Script},
    scene::{ActorKind, Looks},
    track::{Track, TrackError},
    vehicle::BODY,
    world::Setup,
};
use lapwing_core::units::{MPS_PER_KMH, MPS_PER_MPH};

/// The target is reached after so many seconds, least and most.
const LEAD_S: (f64, f64) = (5.5, 7.0);
/// A drive goes on for so long after that, in seconds.
const AFTER_S: f64 = 7.5;
/// A gentle stop takes longer.
const GENTLE_AFTER_S: f64 = 11.0;
/// A stretch of an ordinary lap, in seconds.
const LAP_S: f64 = 30.0;
/// Something that moves ahead goes at this share of our speed at most, so that we come up to it.
const SLOWER: f64 = 0.5;
/// The gap to a lead car that brakes hard, in seconds: 12 m and 40 m at 50 km/h, as in CCRb; and to one that stops gently or
/// turns off.
const CCRB_HEADWAYS_S: [f64; 2] = [0.86, 2.88];
const GENTLE_HEADWAY_S: (f64, f64) = (2.0, 2.8);
/// The car that hides a target in the lane: its gap in seconds and, at least, in metres; how fast it changes lane, in m/s; its
/// offset then; and how long before it would hit the target itself it begins to, in seconds.
const HIDING_GAP_S: f64 = 0.9;
const HIDING_GAP_M: f64 = 6.0;
const ASIDE_MPS: f64 = 2.6;
const ASIDE_M: f64 = -3.0;
const ASIDE_BEFORE_S: f64 = 1.9;
/// Cars parked in front of someone who crosses: their offset to either side, and the room to whom they hide, in metres.
const BESIDE_M: f64 = 3.1;
const HIDING_M: f64 = 0.8;
/// Where nobody is hit: by whom the crossers are played; how long before our car they have left its way, in seconds; how long
/// before it those who wait would be in its middle, if they went on; and where these wait, in metres beside our car's line.
const CROSSERS: [Case; 4] = [Case::Cpna, Case::Cpfa, Case::Child, Case::Cbna];
const CLEAR_S: (f64, f64) = (1.0, 3.0);
const EARLY_S: (f64, f64) = (1.0, 3.0);
const WAITS_M: (f64, f64) = (2.0, 3.2);
/// The share of our car's width up to which a scenario may have somebody meet it.
const SOONEST: f64 = 6.0;
/// Low suns, height and azimuth: a few, as each lights the whole country anew. A held-out one is lower than some learnt ones, and
/// comes from where none of them does.
const LEARNT_SUNS_DEG: [[f64; 2]; 6] =
    [[4.0, 65.0], [7.0, 110.0], [10.0, 155.0], [4.0, 245.0], [7.0, 290.0], [10.0, 335.0]];
const HELD_OUT_SUNS_DEG: [[f64; 2]; 2] = [[5.0, 200.0], [5.0, 20.0]];

/// A road with all that depends on it alone.
#[derive(Debug)]
pub struct Place {
    track: Arc<Track>,
    scenery: Arc<Scenery>,
    stretches: Stretches,
    /// Whether all parts are played on it, each on its own piece.
    shared: bool,
}

impl Place {
    /// A road by name, as [`Track::open`] takes it; takes about a second.
    ///
    /// # Errors
    /// [`TrackError`].
    pub fn open(name: &str) -> Result<Self, TrackError> {
        let track = Track::open(name)?;
        let scenery = Arc::new(Scenery::new(&track));
        let shared = Track::NAMES.contains(&name);
        Ok(Self { stretches: Stretches::of(&track), track: Arc::new(track), scenery, shared })
    }

    /// The piece of it on which a part is played, from and to in metres along the road; all of a road that no other part has.
    pub fn piece(&self, part: Part) -> Option<[f64; 2]> {
        self.shared.then(|| part.piece().map(|share| share * self.track.length()))
    }

    /// The road.
    pub fn track(&self) -> &Track {
        &self.track
    }
}

/// What is to be staged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Staging {
    /// The case.
    pub case: Case,
    /// Its layer.
    pub layer: Layer,
    /// For what: decides looks and weather.
    pub part: Part,
    /// How fast our car goes, mph.
    pub speed_mph: f64,
    /// Everything random.
    pub seed: u64,
}

impl Staging {
    /// The world of it, on a road.
    ///
    /// # Errors
    /// [`ScenarioError`] if the scenario cannot be played there.
    pub fn setup(&self, place: &Place) -> Result<Setup, ScenarioError> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let speed = self.speed_mph * MPS_PER_MPH;
        let mut scenario = match self.case {
            // In a bend, who stands beside the road stands straight ahead: what is judged are cars alone.
            Case::Bends if self.part == Part::Train && rng.random() => Scenario::named(Case::Bystanders.name())?,
            Case::Bends => Scenario::named(Case::Parked.name())?,
            Case::Lap | Case::Shadows => nothing(),
            Case::Crosses | Case::Waits => Scenario::named(CROSSERS[rng.random_range(0..CROSSERS.len())].name())?,
            case => Scenario::named(case.name())?,
        };
        scenario.name = self.case.name().to_owned();
        scenario.looks = if self.part == Part::HeldOut { Looks::HeldOut } else { Looks::Learnt };
        scenario = scenario.settle(self.seed);
        scenario.ego = Ego { speed_kmh: Draw::Exactly(speed / MPS_PER_KMH), ..Ego::default() };
        let lead_s = vary(&mut scenario, self.case, self.layer, speed, &mut rng);
        scenario.duration_s = match self.case {
            Case::Lap | Case::Shadows => LAP_S,
            Case::GentleStop => lead_s + GENTLE_AFTER_S,
            _ => lead_s + AFTER_S,
        };
        let (piece, chosen) = (place.piece(self.part), rng.random::<f64>());
        if let (Case::Lap | Case::Shadows, Some([from, to])) = (self.case, piece) {
            scenario.duration_s = scenario.duration_s.min((to - from) / speed);
        }
        // Where it may begin, so that it ends in the piece as well.
        let starts = piece.map(|[from, to]| [from, (to - speed * scenario.duration_s).max(from)]);
        let s = match self.case {
            Case::Lap | Case::Shadows => {
                let [from, to] = starts.unwrap_or([0.0, place.track.length()]);
                from + chosen * (to - from)
            }
            Case::Bends => place.stretches.bent(starts, chosen),
            _ => place.stretches.straight(&place.track, &scenario, starts, chosen),
        };
        scenario.ego.s_m = Some(Draw::Exactly(s.min(place.track.length() - 0.1)));
        let longest_s = Some(scenario.duration_s);
        Ok(Setup {
            scenario: Some(scenario),
            conditions: self.conditions(&mut rng),
            seed: self.seed,
            laps: None,
            longest_s,
            // Once the car has braked to a standstill, there is nothing more to see, unless something is close ahead.
            idle_s: Some(0.0),
            ..Setup::new(place.track.clone(), place.scenery.clone())
        })
    }

    /// Light and weather of the layer. What is held out has other strengths and other suns: in rain, low sun and night between
    /// those that are learnt.
    fn conditions(&self, rng: &mut ChaCha8Rng) -> Conditions {
        let held_out = self.part == Part::HeldOut;
        let mut between = |(least, most): (f64, f64)| least + (most - least) * rng.random::<f64>();
        let brightness = between((0.85, 1.15));
        let plain = Conditions { brightness, noise: between((0.0, 2.0)), ..Conditions::default() };
        match self.layer {
            Layer::Plain | Layer::Hidden if held_out => {
                Conditions { brightness: between((0.7, 0.8)), haze: between((0.15, 0.3)), ..plain }
            }
            Layer::Plain | Layer::Hidden => Conditions { haze: between((0.0, 0.1)), ..plain },
            Layer::Rain => {
                let rain = if held_out { between((0.75, 0.95)) } else { or_full(between((0.2, 0.8)), 0.7) };
                Conditions { rain, haze: between((0.0, 0.3)), ..plain }
            }
            Layer::LowSun => {
                let suns = if held_out { &HELD_OUT_SUNS_DEG[..] } else { &LEARNT_SUNS_DEG };
                let [height, azimuth] = suns[between((0.0, suns.len() as f64)) as usize];
                Conditions { sun_height_deg: Some(height), sun_azimuth_deg: Some(azimuth), ..plain }
            }
            Layer::Night => {
                let night = if held_out { between((0.85, 0.95)) } else { or_full(between((0.6, 0.95)), 0.85) };
                Conditions { night, brightness: 1.0, ..plain }
            }
        }
    }
}

/// A strength, or 1 where it is beyond `most`: what lies between is held out.
fn or_full(strength: f64, most: f64) -> f64 {
    if strength > most { 1.0 } else { strength }
}

/// A road of one's own.
fn nothing() -> Scenario {
    Scenario {
        name: String::new(),
        description: "Nothing else is on the road".into(),
        track: None,
        ego: Ego::default(),
        seed: 0,
        duration_s: LAP_S,
        looks: Looks::Plain,
        actors: vec![],
    }
}

/// Fits a scenario to our speed, in m/s, and varies it; returns after how many seconds the target is reached.
///
/// The first actor is the target. What crosses has its speed within 15%, and meets a place from a fifth to four fifths of our
/// width; what stands ahead or moves along is up to half a metre aside of where the protocol has it. All others keep their
/// distance from the target.
fn vary(scenario: &mut Scenario, case: Case, layer: Layer, speed: f64, rng: &mut ChaCha8Rng) -> f64 {
    let mut between = |(least, most): (f64, f64)| least + (most - least) * rng.random::<f64>();
    let mut lead_s = between(LEAD_S);
    let hidden = layer == Layer::Hidden;
    let (factor, share, aside) = (between((0.85, 1.15)), between((0.2, 0.8)), between((-0.5, 0.5)));
    let headway_s = between(GENTLE_HEADWAY_S);
    let ccrb_headway_s = CCRB_HEADWAYS_S[usize::from(between((0.0, 1.0)) < 0.5)];
    let (clear_s, early_s, waits_m) = match case {
        Case::Crosses => (between(CLEAR_S), 0.0, 0.0),
        Case::Waits => (0.0, between(EARLY_S), between(WAITS_M)),
        _ => (0.0, 0.0, 0.0),
    };
    lead_s += clear_s + early_s;
    let (hiding_gap_m, car_m) = ((HIDING_GAP_S * speed).max(HIDING_GAP_M), ActorKind::Car.size().z);
    let Some((target, others)) = scenario.actors.split_first_mut() else { return lead_s };
    let mut hiding = vec![];
    let mut moved = None;
    match target {
        Script::Parked { kind, ahead_m, offset_m, .. } => {
            if case.kind() == Kind::Hazard {
                nudge(offset_m, aside);
                hiding.extend(hidden.then(|| leaves(hiding_gap_m, speed, speed, &mut lead_s)));
            }
            moved = Some(put(ahead_m, FRONT_M + kind.size().z / 2.0 + speed * lead_s));
        }
        Script::Cruise { kind, ahead_m, offset_m, speed_kmh, oncoming } => {
            let mut own = speed_kmh.value() * MPS_PER_KMH * factor;
            if *oncoming {
                own = -own;
            } else {
                own = own.min(SLOWER * speed);
                nudge(offset_m, aside);
                hiding.extend(hidden.then(|| leaves(hiding_gap_m, speed, speed - own, &mut lead_s)));
            }
            *speed_kmh = Draw::Exactly(own.abs() / MPS_PER_KMH);
            moved = Some(put(ahead_m, FRONT_M + kind.size().z / 2.0 + (speed - own) * lead_s));
        }
        Script::Lead { gap_m, onset_s, .. } => {
            let headway_s = if case == Case::Ccrb { ccrb_headway_s } else { headway_s };
            let mut gap = (headway_s * speed).max(HIDING_GAP_M);
            if case == Case::Ccrb {
                lead_s -= 2.0; // it is reached a while after it brakes
                *onset_s = Draw::Exactly(lead_s);
                if hidden {
                    gap = hiding_gap_m + car_m + (0.8 * speed).max(4.0);
                    hiding.push(aside_at(hiding_gap_m, speed, lead_s - 0.6));
                }
            }
            *gap_m = Draw::Exactly(gap);
        }
        Script::TurnOff { gap_m, final_kmh, .. } => {
            *gap_m = Draw::Exactly((headway_s * speed).max(HIDING_GAP_M));
            *final_kmh = Draw::Exactly(final_kmh.value().min(0.6 * speed / MPS_PER_KMH));
        }
        Script::Cross { ahead_m, from_m, to_m, speed_kmh, share: meets, .. } => {
            let own_kmh = speed_kmh.value() * factor;
            *speed_kmh = Draw::Exactly(own_kmh);
            let sooner = |seconds: f64| own_kmh * MPS_PER_KMH * seconds / BODY.x;
            *meets = Some(Draw::Exactly(match case {
                Case::Crosses => (1.0 + sooner(clear_s)).min(SOONEST),
                Case::Waits => (0.5 + sooner(early_s)).min(SOONEST),
                _ => share,
            }));
            if case == Case::Waits {
                *to_m = Draw::Exactly(waits_m.copysign(from_m.value()));
            }
            let line_m = FRONT_M + speed * lead_s;
            moved = Some(put(ahead_m, line_m));
            if hidden && case == Case::Child {
                // It has its parked cars: they stand nearer.
                for other in others.iter_mut() {
                    if let Script::Parked { ahead_m, offset_m, .. } = other {
                        nudge(ahead_m, 0.7);
                        nudge(offset_m, -0.3);
                    }
                }
            } else if hidden {
                let side = from_m.value().signum();
                let front_m = line_m - HIDING_M - car_m / 2.0 - 0.3;
                hiding.extend([front_m, front_m - car_m - 1.0].map(|ahead_m| parked(ahead_m, side * BESIDE_M)));
            }
        }
    }
    if let Some(moved) = moved {
        for other in others {
            if let Script::Parked { ahead_m, .. } | Script::Cruise { ahead_m, .. } | Script::Cross { ahead_m, .. } =
                other
            {
                nudge(ahead_m, moved);
            }
        }
    }
    scenario.actors.extend(hiding);
    lead_s
}

/// A car between ours and a target in the lane, which we come up to at `closing` m/s: it leaves the lane in time. The target is
/// moved so far away that there is time to.
fn leaves(gap_m: f64, speed: f64, closing: f64, lead_s: &mut f64) -> Script {
    let own_s = (gap_m + ActorKind::Car.size().z) / closing;
    *lead_s = lead_s.max(own_s + ASIDE_BEFORE_S + 0.5);
    aside_at(gap_m, speed, *lead_s - own_s - ASIDE_BEFORE_S)
}

/// A car ahead at our speed that changes lane at a time.
fn aside_at(gap_m: f64, speed: f64, onset_s: f64) -> Script {
    let exactly = Draw::Exactly;
    Script::TurnOff {
        kind: ActorKind::Car,
        gap_m: exactly(gap_m),
        onset_s: exactly(onset_s.max(0.0)),
        deceleration: exactly(0.1),
        final_kmh: exactly(speed / MPS_PER_KMH),
        angle_deg: exactly((ASIDE_MPS / speed).min(0.6).asin().to_degrees()),
        to_m: exactly(ASIDE_M),
    }
}

fn parked(ahead_m: f64, offset_m: f64) -> Script {
    let exactly = Draw::Exactly;
    Script::Parked {
        kind: ActorKind::Car,
        ahead_m: exactly(ahead_m),
        offset_m: exactly(offset_m),
        yaw_deg: exactly(0.0),
    }
}

/// Moves a number by `by`.
fn nudge(draw: &mut Draw, by: f64) {
    *draw = Draw::Exactly(draw.value() + by);
}

/// Sets a number; returns by how much it changed.
fn put(draw: &mut Draw, value: f64) -> f64 {
    let before = draw.value();
    *draw = Draw::Exactly(value);
    value - before
}
