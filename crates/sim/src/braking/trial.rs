//! The closed loop: every hazard and every harmless case, without and with a guard.
//!
//! The pilot holds the lane and the speed and brakes for nothing, so what is avoided is the guard's doing. Where nothing is
//! hit unless the driver sleeps, an attentive [`Human`] has the pedals, and a guard that brakes is wrong: the car obeys it
//! all the same.
//!
//! What is physically avoidable is tried out: a foot that presses the brake all the way down at the first telemetry
//! at which something [is seen](Sight) and on a collision course.

use std::{
    collections::BTreeSet,
    convert::Infallible,
    sync::atomic::{AtomicUsize, Ordering},
    time::{Duration, Instant},
};

use rayon::prelude::*;

use super::{
    case::{Case, Kind, Layer, Part},
    human::{Attention, Human, Temper},
    plan::{SPEEDS_MPH, tracks},
    play::Blind,
    record::Places,
    sight::Sight,
    stage::Staging,
};
use crate::{
    collision_course::time_to_collision,
    scenario::ScenarioError,
    track::{Track, TrackError},
    world::Simulation,
};
use lapwing_core::{
    config::ControlSettings,
    control::{HELD_S, KnownSpeed, Standstill},
    drive::{self, Eventful, Observer, ObserverError, TurnError},
    driver::Driver,
    guard::GuardModel,
    motion::Deceleration,
    pilot::PurePursuit,
    protocol::{Answer, Command, Observation, World},
    turn::{EventRecord, Turn},
    units::{MPS_PER_MPH, Mph},
};

/// Laps are driven at this speed, in mph.
const LAP_MPH: f64 = 20.0;
/// A drive in which nothing is to be braked for is over once the car has stood for so long, in seconds. A hazard is over as soon
/// as it stands, as in Euro NCAP's tests: the stock car has no brake that holds it on a slope, and a pilot that brakes for
/// nothing would drive on into what it stands before.
const STOOD_S: f64 = 3.0;
/// A lap goes on when a guard that holds the car lets go, which it does in any case after [`HELD_S`].
const HELD_IN_A_LAP_S: f64 = HELD_S + STOOD_S;
/// Slower than this the car stands, in m/s.
const STANDING: f64 = 0.4;
/// A throttle of this or less is the guard's, and 0 or less of a car that stands: no pilot's speed controller asks for the one near
/// its speed, or for the other so far below it.
const GUARDS: f64 = -0.99;

/// What is tried.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialOptions {
    /// Which cases, of both kinds.
    pub cases: Vec<Case>,
    /// The layers that the seeds take turns in; a case that has none of them is [left out](Self::left_out).
    pub layers: Vec<Layer>,
    /// Speeds of our car, mph.
    pub speeds_mph: Vec<f64>,
    /// Drives of each case at each speed.
    pub seeds: u64,
    /// Laps of each of the three tracks, without traffic.
    pub laps: u32,
    /// The part of the data whose roads, looks and weather are used.
    pub part: Part,
}

impl Default for TrialOptions {
    fn default() -> Self {
        Self {
            cases: Case::ALL.into_iter().filter(|case| *case != Case::Lap).collect(),
            layers: Layer::ALL.to_vec(),
            speeds_mph: SPEEDS_MPH.to_vec(),
            seeds: 20,
            laps: 10,
            part: Part::HeldOut,
        }
    }
}

impl TrialOptions {
    /// The layers in which a case is played.
    fn layers_of(&self, case: Case) -> Vec<Layer> {
        let own: Vec<Layer> = case.layers().collect();
        self.layers.iter().copied().filter(|layer| own.contains(layer)).collect()
    }

    /// The cases that are not played, as they have none of the layers.
    pub fn left_out(&self) -> Vec<Case> {
        self.cases.iter().copied().filter(|case| self.layers_of(*case).is_empty()).collect()
    }
}

/// One drive of the trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// The case; [`Case::Lap`] for laps.
    pub case: Case,
    /// Its layer.
    pub layer: Layer,
    /// On which road.
    pub track: String,
    /// How fast our car goes, mph.
    pub speed_mph: f64,
    /// Everything random.
    pub seed: u64,
    /// Laps, where they are driven.
    pub laps: Option<u32>,
    /// The part of the data whose looks and weather are used.
    pub part: Part,
}

/// Who brakes.
#[derive(Clone, Copy)]
pub enum Braker<'a> {
    /// Nobody.
    Nobody,
    /// A foot that needs no time, from the moment something can be seen on a collision course.
    Perfect,
    /// A guard.
    Guard(&'a dyn GuardModel),
}

/// What a drive came to.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Outcome {
    /// Telemetries.
    pub frames: u64,
    /// How fast the two met, mph, if something was hit.
    pub impact_mph: Option<f64>,
    /// How much slower the car was than it was to go, at the impact, or at its slowest, mph.
    pub reduction_mph: f64,
    /// How often the guard braked.
    pub activations: u32,
    /// For how long in all, in seconds.
    pub braked_s: f64,
    /// The hardest deceleration while it did, in g, over at least 0.2 s.
    pub hardest_g: f64,
    /// The shortest way to anything ahead, in metres.
    pub least_gap_m: f64,
}

/// A drive, without and with a guard.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// The drive.
    pub trial: Trial,
    /// With nobody who brakes for hazards.
    pub without: Outcome,
    /// With a perfect foot; of hazards only.
    pub perfect: Option<Outcome>,
    /// With the guard, if there is one.
    pub with: Option<Outcome>,
}

/// A trial that cannot be driven.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// A road.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// A scenario that cannot be played on its road.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// What watches a drive cannot go on.
    #[error(transparent)]
    Observer(ObserverError),
}

/// All drives of a trial. At each speed, a seed of a case has the same road, look and weather.
pub fn trials(options: &TrialOptions) -> Vec<Trial> {
    let part = options.part;
    let roads = tracks(part);
    let mut all = vec![];
    for case in &options.cases {
        let layers = options.layers_of(*case);
        if layers.is_empty() {
            continue;
        }
        for speed_mph in &options.speeds_mph {
            all.extend((0..options.seeds).map(|seed| Trial {
                case: *case,
                layer: layers[seed as usize % layers.len()],
                track: roads[(seed as usize / layers.len() + seed as usize) % roads.len()].to_owned(),
                speed_mph: *speed_mph,
                seed: (*case as u64) << 32 | seed,
                laps: None,
                part,
            }));
        }
    }
    all.extend(Track::NAMES.iter().filter(|_| options.laps > 0).map(|track| Trial {
        case: Case::Lap,
        layer: Layer::Plain,
        track: (*track).to_owned(),
        speed_mph: LAP_MPH,
        seed: 0,
        laps: Some(options.laps),
        part,
    }));
    all
}

/// Drives all of them. `watch` is told how many are done and of how many, and says whether to go on; what is done is returned.
///
/// # Errors
/// [`TrialError`].
pub fn try_all(
    trials: &[Trial],
    guard: Option<&dyn GuardModel>,
    places: &mut Places,
    watch: impl Fn(usize, usize) -> bool + Sync,
) -> Result<Vec<Tried>, TrialError> {
    places.open(trials.iter().map(|trial| &*trial.track).collect::<BTreeSet<_>>())?;
    let (places, done) = (&*places, AtomicUsize::new(0));
    let all = trials.par_iter().map(|trial| {
        if !watch(done.load(Ordering::Relaxed), trials.len()) {
            return Ok(None);
        }
        let drive = |braker| trial.drive(places, braker, &mut |_| Ok(()));
        let tried = Tried {
            trial: trial.clone(),
            without: drive(Braker::Nobody)?,
            perfect: (trial.case.kind() == Kind::Hazard).then(|| drive(Braker::Perfect)).transpose()?,
            with: guard.map(|guard| drive(Braker::Guard(guard))).transpose()?,
        };
        done.fetch_add(1, Ordering::Relaxed);
        Ok(Some(tried))
    });
    Ok(all.collect::<Result<Vec<_>, TrialError>>()?.into_iter().flatten().collect())
}

impl Trial {
    /// Drives it, and shows the world at each telemetry.
    ///
    /// # Errors
    /// [`TrialError`].
    pub fn drive(
        &self,
        places: &Places,
        braker: Braker<'_>,
        show: &mut dyn FnMut(&Simulation) -> Result<(), ObserverError>,
    ) -> Result<Outcome, TrialError> {
        let Self { case, layer, part, speed_mph, seed, .. } = *self;
        let mut setup = Staging { case, layer, part, speed_mph, seed }.setup(places.get(&self.track)?)?;
        if let Some(laps) = self.laps {
            (setup.laps, setup.longest_s) = (Some(laps), None);
            setup.rules.stuck_s = HELD_IN_A_LAP_S;
            setup.scenario.iter_mut().for_each(|scenario| scenario.duration_s = 3600.0);
        }
        let guard = match braker {
            Braker::Guard(model) => Some(model.guard()),
            Braker::Nobody | Braker::Perfect => None,
        };
        let blind = guard.as_ref().is_none_or(|guard| !guard.needs_picture());
        let world = Simulation::new(setup)?;
        let world = if blind { world.seen_by(Blind) } else { world };
        let foot = match (braker, case.kind()) {
            (Braker::Perfect, _) => Foot::Perfect(None),
            (_, Kind::Negative) => Foot::Human(Box::new(Human::new(Temper {
                reaction_s: 1.0,
                speed_mps: speed_mph * MPS_PER_MPH,
                attention: Attention::Ahead,
                rest_s: 0.0,
                fails_s: 0.0,
            }))),
            (_, Kind::Hazard) => Foot::Pilot,
        };
        let settings = ControlSettings { speed_mph: Mph::saturating(speed_mph), ..ControlSettings::default() };
        let mut driver = Driver::new(Box::new(PurePursuit::default()), &settings, Instant::now).guarded(guard);
        let longest_stand_s = match (case.kind(), self.laps) {
            (Kind::Hazard, _) => 0.0,
            (Kind::Negative, None) => STOOD_S,
            (Kind::Negative, Some(_)) => HELD_IN_A_LAP_S,
        };
        let mut watched = Watched::new(speed_mph, longest_stand_s, show);
        let mut driven = Driven { world, foot };
        drive::run(&mut driven, &mut driver, &mut [&mut watched]).map_err(|error| match error {
            TurnError::World(never) => match never {},
            TurnError::Observer(error) => TrialError::Observer(error),
        })?;
        Ok(watched.outcome)
    }
}

/// A world whose pedals are not all the driver's.
struct Driven {
    world: Simulation,
    foot: Foot,
}

/// Who has the pedals, where no guard brakes.
enum Foot {
    /// The pilot.
    Pilot,
    /// A human.
    Human(Box<Human>),
    /// Nobody before something is seen on a collision course; then the brake.
    Perfect(Option<Standstill>),
}

impl World for Driven {
    type Error = Infallible;

    fn observe(&mut self) -> Result<Option<Observation>, Infallible> {
        self.world.observe()
    }

    fn apply(&mut self, answer: Answer) {
        let Self { world, foot } = self;
        let answer = match (answer, foot) {
            (Answer::Steer(command), Foot::Human(human)) => {
                let own = human.drive(world, world.setup().hz.recip());
                let stands = world.car().speed.abs() <= STANDING;
                let is_guards = command.throttle.get() <= if stands { 0.0 } else { GUARDS };
                let throttle = if is_guards { command.throttle } else { own.throttle };
                Answer::Steer(Command { throttle, ..command })
            }
            (Answer::Steer(command), Foot::Perfect(pressed)) => {
                if pressed.is_none() && is_seen_coming(world) {
                    *pressed = Some(Standstill::default());
                }
                let (at, speed) =
                    (Duration::from_secs_f64(world.time_s()), KnownSpeed::Now(world.car().telemetry_speed()));
                let throttle = pressed.as_mut().map_or(command.throttle, |brake| brake.update(at, speed));
                Answer::Steer(Command { throttle, ..command })
            }
            (answer, _) => answer,
        };
        world.apply(answer);
    }
}

impl Eventful for Driven {
    fn take_events(&mut self) -> Vec<(Duration, EventRecord)> {
        self.world.take_events()
    }

    fn interrupt(&mut self) {
        self.world.interrupt();
    }
}

/// Whether anything on a collision course can be seen.
fn is_seen_coming(world: &Simulation) -> bool {
    time_to_collision(&world.setup().track, world.car(), world.place(), &Sight::of(world).seen()).is_finite()
}

/// Watches a drive.
struct Watched<'a> {
    outcome: Outcome,
    speed_mph: f64,
    before_mph: f64,
    /// While the guard brakes.
    braking: Deceleration,
    brakes: bool,
    /// The last telemetry at which the car moved, in seconds.
    moved_s: f64,
    stood: bool,
    longest_stand_s: f64,
    show: &'a mut dyn FnMut(&Simulation) -> Result<(), ObserverError>,
}

impl<'a> Watched<'a> {
    fn new(
        speed_mph: f64,
        longest_stand_s: f64,
        show: &'a mut dyn FnMut(&Simulation) -> Result<(), ObserverError>,
    ) -> Self {
        let outcome = Outcome { least_gap_m: f64::INFINITY, ..Outcome::default() };
        let braking = Deceleration::default();
        Self {
            outcome,
            speed_mph,
            before_mph: speed_mph,
            braking,
            brakes: false,
            moved_s: 0.0,
            stood: false,
            longest_stand_s,
            show,
        }
    }
}

impl Observer<Driven> for Watched<'_> {
    fn turn(&mut self, driven: &Driven, turn: &Turn) -> Result<(), ObserverError> {
        (self.show)(&driven.world)?;
        let Some(telemetry) = turn.telemetry() else { return Ok(()) };
        let (dt_s, mph, outcome) = (driven.world.setup().hz.recip(), telemetry.speed.get(), &mut self.outcome);
        let now_s = turn.at().as_secs_f64();
        outcome.frames += 1;
        if let Some(gap) = telemetry.truth.gap {
            outcome.least_gap_m = outcome.least_gap_m.min(gap.get());
        }
        if outcome.impact_mph.is_none() {
            outcome.reduction_mph = outcome.reduction_mph.max(self.speed_mph - mph);
            // The command in force during the last interval is the one that braked.
            let brakes = telemetry.truth.brake.is_some_and(|brake| brake >= -GUARDS);
            if brakes {
                if !self.brakes {
                    self.braking.restart(Some((now_s - dt_s, self.before_mph * MPS_PER_MPH)));
                }
                outcome.braked_s += dt_s;
                self.braking.measure(now_s, mph * MPS_PER_MPH);
                outcome.hardest_g = self.braking.hardest_g();
            }
            self.brakes = brakes;
        }
        for event in &turn.trace.events {
            outcome.activations += u32::from(matches!(event, EventRecord::GuardBrakes { .. }));
        }
        self.before_mph = mph;
        if driven.world.car().speed.abs() > STANDING {
            self.moved_s = now_s;
        }
        self.stood = now_s - self.moved_s > self.longest_stand_s;
        Ok(())
    }

    fn event(&mut self, _: Duration, event: &EventRecord) {
        if let EventRecord::Collision { speed_mph, own_mph, .. } = event
            && self.outcome.impact_mph.is_none()
        {
            self.outcome.impact_mph = Some(*speed_mph);
            self.outcome.reduction_mph = (self.speed_mph - own_mph.unwrap_or(self.before_mph)).max(0.0);
        }
    }

    fn has_seen_enough(&self) -> bool {
        self.stood || self.outcome.impact_mph.is_some()
    }
}
