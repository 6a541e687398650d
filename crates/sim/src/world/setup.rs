//! What a run depends on, and why it ended.

use std::{fmt, sync::Arc};

use crate::{
    camera::Scenery,
    conditions::Conditions,
    scenario::Scenario,
    track::{Place, Track},
    vehicle::Car,
};
use lapwing_core::{
    config::{OnCrash, Rules},
    perception::Frame,
    recording::RecorderOptions,
    units::Mph,
};

/// How long a car may stand without steady throttle where there is nobody who could have stopped it, in seconds: a
/// pilot may wait for something that is farther away than [`Rules::waiting_m`].
const IDLE_S: f64 = 20.0;

/// A human who takes the wheel once: the expert, behind the wheel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Human {
    /// When, in seconds of the run.
    pub from_s: f64,
    /// For how long, in seconds.
    pub for_s: f64,
    /// How fast.
    pub speed: Mph,
}

/// Everything that a run depends on except the answers.
#[derive(Debug, Clone)]
pub struct Setup {
    /// The road.
    pub track: Arc<Track>,
    /// What stands along it. Built once for any number of runs: [`Scenery::new`].
    pub scenery: Arc<Scenery>,
    /// Other traffic.
    pub scenario: Option<Scenario>,
    /// Light, weather and camera faults.
    pub conditions: Conditions,
    /// The seed of everything random.
    pub seed: u64,
    /// Telemetries a second of the run.
    pub hz: f64,
    /// Laps after which it ends.
    pub laps: Option<u32>,
    /// Time after which it ends, in seconds of the run.
    pub longest_s: Option<f64>,
    /// How long the car may stand with nothing in its way, whatever the throttle, before it counts as stuck after all,
    /// in seconds and never less than [`Rules::stuck_s`]; `None`: for as long as it is told to stand. Default 20.
    pub idle_s: Option<f64>,
    /// What happens after a crash.
    pub on_crash: OnCrash,
    /// What counts as a crash, and so on.
    pub rules: Rules,
    /// A human who takes the wheel.
    pub human: Option<Human>,
    /// Whether to report only what the stock build reports.
    pub stock: bool,
}

impl Setup {
    /// How a drive in this world is recorded, with so many items waiting for the disk: viewers are shown its road.
    pub fn recorder(&self, queue: usize) -> RecorderOptions {
        RecorderOptions { queue, roads: [self.track.roadway()].into() }
    }

    /// One lap in fair weather, without other traffic.
    pub fn new(track: Arc<Track>, scenery: Arc<Scenery>) -> Self {
        Self {
            track,
            scenery,
            scenario: None,
            conditions: Conditions::default(),
            seed: 0,
            hz: 15.0,
            laps: Some(1),
            longest_s: None,
            idle_s: Some(IDLE_S),
            on_crash: OnCrash::Stop,
            rules: Rules::default(),
            human: None,
            stock: false,
        }
    }
}

/// Takes pictures for a car in place of the renderer, where it can.
pub trait Eyes: fmt::Debug + Send {
    /// Paints what the centre camera of a car shows there; `false` if it has nothing to show.
    fn see(&mut self, car: &Car, place: &Place, frame: &mut Frame) -> bool;
}

/// Why a run ended.
#[derive(Debug, Clone, PartialEq)]
pub enum Ending {
    /// All laps are driven.
    LapsDone,
    /// The time limit is reached.
    TimeOver,
    /// The car hit something.
    Collision(String),
    /// The car went too far off the road to come back.
    Lost,
    /// The car is stuck: it has throttle and does not move.
    Stuck,
    /// The car stood for this many seconds without steady throttle.
    Idle(f64),
    /// The user pressed Ctrl-C.
    Interrupted,
}

impl fmt::Display for Ending {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::LapsDone => write!(f, "all laps driven"),
            Self::TimeOver => write!(f, "time limit reached"),
            Self::Collision(with) => write!(f, "collision with {with}"),
            Self::Lost => write!(f, "far off the road"),
            Self::Stuck => write!(f, "stuck"),
            Self::Idle(stood_s) => write!(f, "stationary for {stood_s:.0} s without steady throttle"),
            Self::Interrupted => write!(f, "interrupted"),
        }
    }
}
