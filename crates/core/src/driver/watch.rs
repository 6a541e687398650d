//! A driver's guard: its guard's values, the brake that they press, and what is told of both.

use std::time::Duration;

use crate::{
    control::{BrakeChange, EmergencyBrake, KnownSpeed, Release},
    guard::{Guard, Watched},
    perception::Frame,
    protocol::{Telemetry, Truth},
    turn::{EventRecord, Trace},
    units::{Clock, Metres, Mph, Throttle},
};

/// A simulator's time that has not changed for this long stands still.
const STANDS: Duration = Duration::from_millis(2500);

/// A guard and its brake.
pub(super) struct Watch {
    guard: Box<dyn Guard>,
    brake: EmergencyBrake,
    simulator: SimulatorClock,
    /// Whether the run was told that the guard cannot watch; once is enough.
    told_blind: bool,
}

impl Watch {
    pub(super) fn new(guard: Box<dyn Guard>) -> Self {
        let brake = EmergencyBrake::new(guard.limits());
        Self { guard, brake, simulator: SimulatorClock::default(), told_blind: false }
    }

    pub(super) fn needs_picture(&self) -> bool {
        self.guard.needs_picture()
    }

    /// Shows the guard this moment.
    pub(super) fn look(&mut self, at: Duration, frame: &Frame, telemetry: &Telemetry, clock: Clock, trace: &mut Trace) {
        let began = clock();
        let Telemetry { speed, truth, .. } = telemetry;
        let Truth { time_to_collision_s, gap, sim_time_s, .. } = *truth;
        // The simulator shows another scene, of which the guard has seen nothing yet.
        if self.simulator.begins_anew(sim_time_s) {
            self.guard.reset();
        }
        let now = self.simulator.telemetry(at, sim_time_s);
        let watched = Watched { at: now, frame, speed: *speed, time_to_collision_s, gap_m: gap.map(Metres::get) };
        trace.brake_due = self.guard.watch(&watched).unwrap_or_else(|why| {
            if !std::mem::replace(&mut self.told_blind, true) {
                let text = format!("the guard ({}) cannot watch: {why}", self.guard.name());
                tracing::warn!("{text}");
                trace.events.push(EventRecord::Note { text });
            }
            None
        });
        trace.guard = Some(clock() - began);
        let change = self.brake.update(now, *speed, trace.brake_due);
        self.tell(change, Some(*speed), trace);
    }

    /// The throttle in place of the pilot's, if it brakes.
    pub(super) fn throttle(&mut self, at: Duration, speed: KnownSpeed) -> Option<Throttle> {
        self.brake.throttle(self.simulator.at(at), speed)
    }

    /// Lets go and forgets: others drive.
    pub(super) fn rest(&mut self, at: Duration, speed: Option<Mph>, why: Release, trace: &mut Trace) {
        let change = self.brake.release(self.simulator.at(at), why);
        self.tell(change, speed, trace);
        self.guard.reset();
    }

    /// Back to rest, between runs.
    pub(super) fn reset(&mut self) {
        self.guard.reset();
        self.brake = EmergencyBrake::new(self.guard.limits());
        self.simulator = SimulatorClock::default();
        self.told_blind = false;
    }

    fn tell(&self, change: Option<BrakeChange>, speed: Option<Mph>, trace: &mut Trace) {
        trace.events.extend(change.map(|change| match change {
            BrakeChange::Began { value } => EventRecord::GuardBrakes {
                guard: self.guard.name().to_owned(),
                value,
                fires: self.guard.limits().fires,
                speed_mph: speed.map_or(0.0, Mph::get),
            },
            BrakeChange::Ended(why, after) => {
                EventRecord::GuardReleases { after_s: after.as_secs_f64(), why, speed_mph: speed.map(Mph::get) }
            }
        }));
    }
}

/// The time by which a guard watches and brakes. A simulator in lock step runs as fast as it is answered: its own clock tells
/// how far apart two of its frames are, not the time at which they came. Time does not leap where one clock takes over from the
/// other, and it never goes back.
#[derive(Default)]
struct SimulatorClock {
    /// Whether the simulator told a time between two whole seconds. A clock in whole seconds is too coarse to watch by.
    is_fine: bool,
    /// The time that the simulator told last, in seconds, and when it first told that.
    told: Option<(f64, Duration)>,
    /// When the telemetry that told it came, by the bridge's clock, and the time that was given for it.
    last: Option<(Duration, Duration)>,
    /// The latest time that was given; none that is given after it is earlier.
    latest: Duration,
}

impl SimulatorClock {
    /// The time of a telemetry that came `at` this time and tells this one of the simulator's, in seconds. If the simulator tells
    /// none or only whole seconds, begins anew or stands still, time goes on as the bridge's clock does.
    fn telemetry(&mut self, at: Duration, told_s: Option<f64>) -> Duration {
        let Some(told_s) = told_s.filter(Truth::is_time) else { return self.at(at) };
        self.is_fine |= told_s.fract() != 0.0;
        let since = self.told.filter(|(before_s, _)| *before_s == told_s).map_or(at, |(_, since)| since);
        let runs = self.is_fine && at.saturating_sub(since) <= STANDS;
        let step = |(before_s, _)| Duration::try_from_secs_f64(told_s - before_s).ok().filter(|_| runs);
        let stepped = self.last.zip(self.told.and_then(step)).map(|((_, last), step)| last + step);
        let now = match stepped {
            Some(stepped) => stepped.max(self.latest),
            None => self.at(at),
        };
        self.latest = now;
        (self.told, self.last) = (Some((told_s, since)), Some((at, now)));
        now
    }

    /// The time of anything else that comes `at` this time.
    fn at(&mut self, at: Duration) -> Duration {
        let now = self.last.map_or(at, |(came, last)| last + at.saturating_sub(came));
        self.latest = self.latest.max(now);
        self.latest
    }

    /// Whether a telemetry that tells this time begins a drive anew.
    fn begins_anew(&self, told_s: Option<f64>) -> bool {
        told_s.filter(Truth::is_time).zip(self.told).is_some_and(|(told_s, (before_s, _))| told_s < before_s)
    }
}

#[cfg(test)]
mod tests {
    use std::{
        sync::{Arc, Mutex},
        time::Instant,
    };

    use image::codecs::jpeg::JpegEncoder;

    use super::*;
    use crate::{
        config::ControlSettings,
        control::BrakeLimits,
        driver::Driver,
        guard::{GuardError, TimeToCollision},
        perception::Frame,
        pilot::{Pilot, PilotError, Prediction, View},
        protocol::{Answer, CameraImage, Observation, Sight},
    };

    /// Straight on, and blind.
    struct Straight;

    impl Pilot for Straight {
        fn steer(&mut self, _: &View<'_>) -> Result<Prediction, PilotError> {
            Ok(Prediction { steering: 0.25, ..Prediction::default() })
        }

        fn needs_picture(&self) -> bool {
            false
        }

        fn reset(&mut self) {}
    }

    fn seen(i: u32, mph: f64, time_to_collision_s: Option<f64>) -> Observation {
        let truth = Truth { time_to_collision_s, ..Truth::default() };
        let told = Telemetry {
            steering: crate::units::Degrees::ZERO,
            throttle: Throttle::ZERO,
            speed: Mph::new(mph).unwrap(),
            image: Default::default(),
            truth,
        };
        Observation { at: Duration::from_secs(1) * i / 15, sight: Sight::Telemetry(told) }
    }

    fn driver(guard: Option<Box<dyn Guard>>) -> Driver {
        Driver::new(Box::new(Straight), &ControlSettings::default(), Instant::now).guarded(guard)
    }

    /// Steering and throttle.
    fn asked(answer: Answer) -> (f64, f64) {
        let Answer::Steer(command) = answer else { panic!("{answer:?}") };
        (command.steering.get(), command.throttle.get())
    }

    #[test]
    fn the_guard_brakes_on_the_second_warning_and_leaves_the_steering_to_the_pilot() {
        let mut driver = driver(Some(Box::new(TimeToCollision::default())));
        let (mut throttles, mut events) = (vec![], vec![]);
        for i in 0..60 {
            // It closes in, is braked for, and is gone.
            let (mph, until_s) = if i < 5 { (8.0, 2.0) } else { (8.0 - 0.2 * f64::from(i - 5).min(30.0), 1.0) };
            let (answer, trace) = driver.drive(&seen(i, mph, Some(if i < 20 { until_s } else { 60.0 })));
            assert_eq!(asked(answer).0, 0.25);
            assert!(trace.brake_due.is_some() && trace.guard.is_some());
            throttles.push(asked(answer).1);
            events.extend(trace.events);
        }
        assert!(throttles[5] > 0.0 && throttles[6] == -1.0 && throttles[19] == -1.0, "{throttles:?}");
        assert!(throttles[30] > 0.0, "{throttles:?}");
        let [EventRecord::GuardBrakes { guard, value, .. }, EventRecord::GuardReleases { why, .. }] = &events[..]
        else {
            panic!("{events:?}")
        };
        assert_eq!((guard.as_str(), *value, *why), ("time to collision", 1.0, Release::Calm));
    }

    #[test]
    fn a_guard_that_cannot_watch_says_so_once_and_the_pilot_drives() {
        let mut driver = driver(Some(Box::new(TimeToCollision::default())));
        let told: Vec<_> = (0..10).flat_map(|i| driver.drive(&seen(i, 8.0, None)).1.events).collect();
        let [EventRecord::Note { text }] = &told[..] else { panic!("{told:?}") };
        assert!(text.starts_with("the guard (time to collision) cannot watch: expected telemetry"), "{text}");
        assert!(asked(driver.drive(&seen(11, 8.0, None)).0).1 > 0.0);
    }

    #[test]
    fn a_human_has_the_brake_and_without_a_guard_nothing_is_told_of_one() {
        let mut guarded = driver(Some(Box::new(TimeToCollision::default())));
        for i in 0..3 {
            guarded.drive(&seen(i, 20.0, Some(1.0)));
        }
        let (answer, trace) = guarded.drive(&Observation { at: Duration::from_secs(1), sight: Sight::HumanDrives });
        assert_eq!(answer, Answer::Manual);
        let released = |e: &EventRecord| matches!(e, EventRecord::GuardReleases { why: Release::HandedOver, .. });
        assert!(trace.events.iter().any(released), "{:?}", trace.events);
        let (_, trace) = driver(None).drive(&seen(0, 20.0, Some(1.0)));
        assert_eq!((trace.brake_due, trace.guard), (None, None));
    }

    /// The pixels that were looked at: where in memory they lie, and how many there are.
    type Looked = Arc<Mutex<Vec<(usize, usize)>>>;

    fn look(looked: &Looked, frame: &Frame) {
        looked.lock().unwrap().push((frame.rgb().as_ptr().addr(), frame.rgb().len()));
    }

    struct Looking(Looked);

    impl Pilot for Looking {
        fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError> {
            look(&self.0, view.frame);
            Ok(Prediction::default())
        }

        fn reset(&mut self) {}
    }

    impl Guard for Looking {
        fn name(&self) -> &str {
            "looking"
        }

        fn limits(&self) -> BrakeLimits {
            BrakeLimits { fires: 0.5, releases: 0.25 }
        }

        fn watch(&mut self, now: &Watched<'_>) -> Result<Option<f64>, GuardError> {
            look(&self.0, now.frame);
            Ok(Some(0.0))
        }

        fn reset(&mut self) {}
    }

    #[test]
    fn pilot_and_guard_look_at_the_same_decoded_frame() {
        let mut jpeg = vec![];
        JpegEncoder::new(&mut jpeg).encode(&[90; 64 * 32 * 3], 64, 32, image::ExtendedColorType::Rgb8).unwrap();
        let [pilots, guards] = [Looked::default(), Looked::default()];
        let driver = Driver::new(Box::new(Looking(pilots.clone())), &ControlSettings::default(), Instant::now);
        let mut driver = driver.guarded(Some(Box::new(Looking(guards.clone()))));
        for i in 0..2 {
            let mut seen = seen(i, 8.0, None);
            let Sight::Telemetry(telemetry) = &mut seen.sight else { panic!("no telemetry") };
            telemetry.image = CameraImage::Jpeg(jpeg.clone().into());
            driver.drive(&seen);
        }
        let pilots = pilots.lock().unwrap().clone();
        assert_eq!(pilots.iter().map(|(_, bytes)| *bytes).collect::<Vec<_>>(), [64 * 32 * 3; 2]);
        assert_eq!(pilots, *guards.lock().unwrap());
    }

    /// Warns of everything, until it forgets.
    struct Afraid(u32);

    impl Guard for Afraid {
        fn name(&self) -> &str {
            "afraid"
        }

        fn limits(&self) -> BrakeLimits {
            BrakeLimits { fires: 0.5, releases: 0.25 }
        }

        fn watch(&mut self, _: &Watched<'_>) -> Result<Option<f64>, GuardError> {
            self.0 += 1;
            Ok(Some(1.0))
        }

        fn needs_picture(&self) -> bool {
            false
        }

        fn reset(&mut self) {
            self.0 = 0;
        }
    }

    /// When a guard watches, in ms: telemetries come one a millisecond and tell these times of the simulator's, in ms.
    fn watched_at(told_ms: impl IntoIterator<Item = Option<u32>>) -> Vec<u128> {
        let mut clock = SimulatorClock::default();
        let time = |(i, told_ms): (u64, Option<u32>)| {
            clock.telemetry(Duration::from_millis(i), told_ms.map(|ms| f64::from(ms) / 1e3)).as_millis()
        };
        (0..).zip(told_ms).map(time).collect()
    }

    #[test]
    fn a_guard_watches_by_the_simulators_time_however_fast_its_frames_come() {
        assert_eq!(watched_at([0, 60, 120, 1000, 1060].map(Some)), [0, 60, 120, 1000, 1060]);
        assert_eq!(watched_at([7060, 7120, 0, 60].map(Some)), [0, 60, 61, 121], "it begins anew");
        assert_eq!(watched_at([None; 3]), [0, 1, 2]);
        assert_eq!(watched_at([Some(7060), None, Some(7120)]), [0, 1, 60], "one tells none");
        assert_eq!(watched_at([Some(7060), None, None, Some(7061)]), [0, 1, 2, 2], "it never goes back");
        // Builds of the SelfOracle family.
        assert_eq!(watched_at([83_000, 83_000, 84_000].map(Some)), [0, 1, 2], "whole seconds");
        assert_eq!(watched_at([83_000, 84_000, 84_500].map(Some)), [0, 1, 501], "no leap to the simulator's clock");
        let stuck = watched_at((0..3000).map(|i| Some(12_345 + 60 * i.min(1))));
        assert_eq!((stuck[1], stuck[2501], stuck[2502], stuck[2999]), (60, 60, 61, 558), "it stands still");
    }

    /// Tells its time of the run as its value.
    struct Timed;

    impl Guard for Timed {
        fn name(&self) -> &str {
            "timed"
        }

        fn limits(&self) -> BrakeLimits {
            BrakeLimits { fires: 1e9, releases: 1e9 }
        }

        fn watch(&mut self, now: &Watched<'_>) -> Result<Option<f64>, GuardError> {
            Ok(Some(now.at.as_secs_f64()))
        }

        fn needs_picture(&self) -> bool {
            false
        }

        fn reset(&mut self) {}
    }

    #[test]
    fn the_time_that_a_guard_is_told_is_the_simulators() {
        let mut driver = driver(Some(Box::new(Timed)));
        let mut due = |i: u32, sim_time_s: Option<f64>| {
            let mut seen = seen(i, 8.0, None);
            let Sight::Telemetry(telemetry) = &mut seen.sight else { panic!("no telemetry") };
            telemetry.truth.sim_time_s = sim_time_s;
            driver.drive(&seen).1.brake_due
        };
        assert_eq!(due(15, Some(40.5)), Some(1.0));
        assert_eq!(due(16, Some(42.5)), Some(3.0), "two seconds later, by its clock");
        assert_eq!(due(31, None), Some(4.0), "one second later, by the bridge's");
    }

    #[test]
    fn a_brake_lets_go_by_the_simulators_time() {
        let mut driver = driver(Some(Box::new(TimeToCollision::default())));
        // Fifteen telemetries come in a second of the bridge's clock, and six in a second of the simulator's.
        let mut ended = (0..40).filter_map(|i| {
            let mut seen = seen(i, 8.0, Some(if i < 3 { 1.0 } else { 60.0 }));
            let Sight::Telemetry(telemetry) = &mut seen.sight else { panic!("no telemetry") };
            telemetry.truth.sim_time_s = Some(40.1 + f64::from(i) / 6.0);
            driver.drive(&seen).1.events.into_iter().find_map(|event| match event {
                EventRecord::GuardReleases { after_s, .. } => Some((i, after_s)),
                _ => None,
            })
        });
        let (i, after_s) = ended.next().unwrap();
        assert!(i == 7 && (after_s - 1.0).abs() < 1e-6, "{i}: {after_s} s");
    }

    #[test]
    fn the_brake_holds_through_a_telemetry_that_cannot_be_read_and_never_reverses() {
        let mut driver = driver(Some(Box::new(Afraid(0))));
        driver.drive(&seen(0, 20.0, None));
        assert_eq!(asked(driver.drive(&seen(1, 19.0, None)).0).1, -1.0);
        let why = crate::protocol::TelemetryError::Missing("speed");
        let unreadable = Observation { at: Duration::from_millis(133), sight: Sight::Unreadable(why) };
        assert_eq!(asked(driver.drive(&unreadable).0).1, -1.0);
        assert_eq!(asked(driver.drive(&seen(3, 3.0, None)).0).1, -1.0);
        assert_eq!(asked(driver.drive(&seen(4, 3.5, None)).0).1, 0.0, "its speed rises: it reverses");
    }
}
