//! The headless simulator in the hands of whoever sits at the page: in real time, with a pause, one step, another world,
//! and their own hands on the wheel.
//!
//! ```text
//! page ─▶ Console ─▶ Staged ─▶ drive::run ─▶ Console ─▶ page
//!                      └─ Simulation         └─▶ HandLog: driving_log.csv
//! ```
//! One [`Console`] outlives any number of worlds: [`Staged`] is one run of one of them.

mod log;

use std::{
    cell::RefCell,
    convert::Infallible,
    rc::Rc,
    thread::sleep,
    time::{Duration, Instant},
};

pub use log::{HandLog, HandLogError};

use crate::real_time::RealTime;
use lapwing_core::{
    config::ControlSettings,
    drive::{Eventful, Observer, ObserverError},
    driver::{Driver, Hands},
    protocol::{Answer, Dialect, Observation, World},
    recording::{Recorder, RunKind},
    turn::{EventRecord, Turn},
};
use lapwing_live::page::{Control, Offered, RunFileStatus, Showing, WeatherRange, WorldChoice};
use lapwing_score::score::Scorer;
use lapwing_sim::{
    conditions::Conditions,
    scenario::Scenario,
    spec::WorldSpec,
    track::Track,
    world::{Ending, Simulation},
};

/// Time between two looks at what a paused world is asked for.
const PAUSED: Duration = Duration::from_millis(10);

/// What a person at the page may make of the simulator.
pub fn offered() -> Offered {
    let weather = Conditions::ranges().map(|(name, min, max, fair)| {
        let fair = fair.unwrap_or((min + max) / 2.0);
        WeatherRange { name: name.to_owned(), min, max, fair }
    });
    Offered {
        tracks: Track::NAMES.map(str::to_owned).into(),
        scenarios: Scenario::NAMES.map(str::to_owned).into(),
        weather: weather.into(),
    }
}

/// The world that a person has chosen, where the present one is `spec`.
pub fn chosen(spec: &WorldSpec, choice: &WorldChoice) -> WorldSpec {
    let mut next = spec.clone();
    if let Some(track) = &choice.track {
        next.track = Some(track.clone());
    }
    if let Some(scenario) = &choice.scenario {
        next.scenario = Some(scenario.clone()).filter(|name| !name.is_empty());
    }
    if let Some(weather) = &choice.weather {
        let list: Vec<_> = weather.iter().map(|(name, value)| format!("{name}={value}")).collect();
        next.conditions = Some(list.join(",")).filter(|list| !list.is_empty());
    }
    next
}

/// The page's end of all worlds, one after the other.
pub struct Console {
    showing: Showing,
    paused: bool,
    /// Telemetries that a paused world may still show.
    steps: u32,
    /// What comes after this run.
    next: Option<WorldChoice>,
    real_time: RealTime,
    hands: Hands,
    log: Option<HandLog>,
    interrupted: Box<dyn Fn() -> bool>,
}

impl Console {
    /// A console of a drive that is shown. `interrupted` says whether the program should end; what is driven by hand goes
    /// into the log, if there is one.
    pub fn new(showing: Showing, log: Option<HandLog>, interrupted: impl Fn() -> bool + 'static) -> Rc<RefCell<Self>> {
        let interrupted = Box::new(interrupted);
        let hands = Hands::Pilot;
        let mut console = Self {
            showing,
            paused: false,
            steps: 0,
            next: None,
            real_time: RealTime::default(),
            hands,
            log,
            interrupted,
        };
        console.tell_log();
        Rc::new(RefCell::new(console))
    }

    /// The pilot that drives, by its place among the page's.
    pub fn pilot(&self) -> usize {
        self.showing.pilot()
    }

    /// How the driver is set up, if a person has changed it.
    pub fn settings(&self) -> Option<&ControlSettings> {
        self.showing.settings()
    }

    /// What is offered at the page.
    pub fn offers(&mut self, offered: Offered) {
        self.showing.offers(offered);
    }

    /// The file of the run that is over lacks so many frames and other items.
    pub fn has_lost(&mut self, items: u64) {
        self.showing.has_lost(items);
    }

    /// A run begins.
    pub fn run_begins(&mut self, dialect: Dialect, settings: &ControlSettings) {
        self.showing.run_begins(Some(dialect), settings);
        self.next = None;
        self.real_time.restart();
    }

    /// Whether a person asked for another world, or for this one anew.
    pub fn is_asked_on(&self) -> bool {
        self.next.is_some()
    }

    /// The run is over: waits for what comes next; `None` if the program should end.
    pub fn wait_for_next(&mut self) -> Option<WorldChoice> {
        self.showing.run_ended();
        if let Some(log) = &mut self.log {
            log.cut();
        }
        loop {
            if (self.interrupted)() {
                return None;
            }
            self.heed();
            if let Some(next) = self.next.take() {
                return Some(next);
            }
            sleep(PAUSED);
        }
    }

    /// Ends the log of what was driven by hand; returns it, if there is one.
    pub fn take_log(&mut self) -> Option<HandLog> {
        self.log.take()
    }

    fn heed(&mut self) {
        for control in self.showing.others() {
            match control {
                Control::Pause => self.pause(true),
                Control::Resume => self.pause(false),
                Control::Step => {
                    self.steps += 1;
                    self.pause(true);
                }
                Control::Reset => self.next = Some(WorldChoice::default()),
                Control::World(choice) => self.next = Some(choice),
                Control::Record { on } => {
                    if let Some(log) = &mut self.log {
                        log.is_on(on);
                    }
                    self.tell_log();
                }
                // The page refuses what this drive cannot do, and the rest is the driver's.
                _ => {}
            }
        }
    }

    fn pause(&mut self, paused: bool) {
        self.paused = paused;
        self.showing.is_paused(paused);
        self.real_time.restart();
    }

    fn tell_log(&mut self) {
        if let Some(log) = &self.log {
            self.showing.recorded(log.rows(), log.adds());
        }
    }

    /// Waits for the end of a pause or for a step; false if this world has no more telemetry.
    fn goes_on(&mut self) -> bool {
        loop {
            self.heed();
            if self.next.is_some() || (self.interrupted)() {
                return false;
            }
            if !self.paused {
                return true;
            }
            if self.steps > 0 {
                self.steps -= 1;
                return true;
            }
            sleep(PAUSED);
        }
    }
}

/// A world with a person at its console.
pub struct Staged {
    simulation: Simulation,
    console: Rc<RefCell<Console>>,
}

impl Staged {
    /// A world in the hands of this console.
    pub fn new(simulation: Simulation, console: Rc<RefCell<Console>>) -> Self {
        Self { simulation, console }
    }

    /// The world.
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }
}

impl World for Staged {
    type Error = Infallible;

    fn observe(&mut self) -> Result<Option<Observation>, Infallible> {
        let console = &mut *self.console.borrow_mut();
        if self.simulation.ending().is_none() && !console.goes_on() {
            self.simulation.end(Ending::Interrupted);
        }
        let Ok(seen) = self.simulation.observe();
        if let Some(Observation { at, .. }) = &seen {
            console.real_time.wait(*at);
        }
        Ok(seen)
    }

    fn apply(&mut self, answer: Answer) {
        self.simulation.apply(answer);
    }
}

impl Eventful for Staged {
    fn take_events(&mut self) -> Vec<(Duration, EventRecord)> {
        self.simulation.take_events()
    }

    fn kind(&self) -> RunKind {
        self.simulation.kind()
    }

    fn is_recorded(&self) -> bool {
        self.simulation.is_recorded()
    }

    fn direct(&mut self, _: Duration, driver: &mut Driver) -> Vec<EventRecord> {
        let console = &mut *self.console.borrow_mut();
        let changed = console.showing.direct(driver, Instant::now());
        console.hands = driver.hands();
        changed
    }

    fn interrupt(&mut self) {
        self.simulation.interrupt();
    }
}

/// Shows the drive, with its score, and logs what is driven by hand.
pub struct Screen<'a> {
    scorer: Scorer,
    console: Rc<RefCell<Console>>,
    recorder: Option<&'a Recorder>,
}

impl<'a> Screen<'a> {
    /// A screen of this console on which nothing was shown yet. It shows how the recorder is doing, if there is one.
    pub fn new(console: Rc<RefCell<Console>>, recorder: Option<&'a Recorder>) -> Self {
        Self { scorer: Scorer::live(&[]), console, recorder }
    }
}

impl Observer<Staged> for Screen<'_> {
    fn turn(&mut self, world: &Staged, turn: &Turn) -> Result<(), ObserverError> {
        self.scorer.turn(world, turn)?;
        let console = &mut *self.console.borrow_mut();
        if let Some(log) = &mut console.log {
            log.turn(&world.simulation, turn)?;
        }
        console.tell_log();
        let now = Instant::now();
        console.showing.score(&self.scorer, now);
        console.showing.is_written(now, || self.recorder.map(RunFileStatus::from));
        console.showing.turn(turn, console.hands, now);
        Ok(())
    }

    fn event(&mut self, at: Duration, event: &EventRecord) {
        self.scorer.event(at, event);
        self.console.borrow_mut().showing.event(at, event);
    }

    fn untold(&mut self, at: Duration, event: &EventRecord) {
        Observer::<Staged>::event(self, at, event);
    }

    fn end(&mut self) {
        self.console.borrow_mut().showing.keep_score(&self.scorer);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_choice_changes_what_it_names_and_leaves_the_rest() {
        let spec = WorldSpec { track: Some("jungle".into()), scenario: Some("ccrs".into()), ..WorldSpec::default() };
        assert_eq!(chosen(&spec, &WorldChoice::default()), spec);
        let weather = [("rain".to_owned(), 0.5), ("night".to_owned(), 1.0)].into();
        let choice = WorldChoice { track: Some("lake".into()), scenario: Some(String::new()), weather: Some(weather) };
        let next = chosen(&spec, &choice);
        assert_eq!((next.track.as_deref(), next.scenario), (Some("lake"), None));
        let conditions = Conditions::parse(&next.conditions.unwrap()).unwrap();
        assert_eq!((conditions.rain, conditions.night), (0.5, 1.0));
    }

    #[test]
    fn all_that_is_offered_exists() {
        let offered = offered();
        for range in &offered.weather {
            for value in [range.min, range.fair] {
                Conditions::parse(&format!("{}={value}", range.name)).unwrap();
            }
        }
        assert!(offered.scenarios.iter().all(|name| Scenario::named(name).is_ok()));
    }
}
