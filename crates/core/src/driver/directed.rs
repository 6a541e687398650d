//! What a person may change while the driver drives: set speed, speed law, pilot, who has the wheel, and the end of it
//! all. Each takes effect at the next observation.

use std::time::Duration;

use super::{Driver, known_speed};
use crate::{
    config::{ControlSettings, SpeedLaw},
    control::{Pi, PiGains, Quadratic, SpeedController, Standstill},
    pilot::Pilot,
    protocol::{Command, Sight},
    units::Mph,
};

/// Who drives, as far as the driver knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hands {
    /// The pilot.
    Pilot,
    /// A person, at the simulator or by [`Driver::steer_by_hand`].
    Human,
    /// Nobody: the pilot waits to be armed.
    Off,
    /// The brake: [`Driver::stop`].
    Stopped,
}

/// What has been changed.
#[derive(Debug)]
pub(super) struct Directed {
    settings: ControlSettings,
    /// What a person commands in place of the pilot.
    pub by_hand: Option<Command>,
    stop: Option<Standstill>,
}

impl Directed {
    pub fn by(settings: ControlSettings) -> Self {
        Self { settings, by_hand: None, stop: None }
    }

    /// Set speed and law stay; the wheel is given back.
    pub fn reset(&mut self) {
        (self.by_hand, self.stop) = (None, None);
    }
}

/// The controller that the settings name, at rest.
pub(super) fn controller(settings: &ControlSettings) -> SpeedController {
    let ControlSettings { speed_law, speed_mph, kp, ki, .. } = *settings;
    match speed_law {
        SpeedLaw::Pi => SpeedController::Pi(Pi::new(PiGains { kp, ki }, speed_mph)),
        SpeedLaw::Quadratic => SpeedController::Quadratic(Quadratic::new(speed_mph)),
    }
}

impl Driver {
    /// How it drives now: the settings that it was made with, and what has been changed since.
    pub fn settings(&self) -> &ControlSettings {
        &self.directed.settings
    }

    /// Holds another speed, above 0 mph; returns whether that is a change.
    pub fn set_speed(&mut self, speed: Mph) -> bool {
        let changes = self.directed.settings.speed_mph != speed;
        self.directed.settings.speed_mph = speed;
        self.speed.set_speed(speed);
        changes
    }

    /// Computes the throttle by another law, which begins at rest; returns whether that is a change.
    pub fn set_speed_law(&mut self, law: SpeedLaw) -> bool {
        let changes = self.directed.settings.speed_law != law;
        if changes {
            self.directed.settings.speed_law = law;
            self.speed = controller(&self.directed.settings);
        }
        changes
    }

    /// Lets another pilot steer.
    pub fn set_pilot(&mut self, pilot: Box<dyn Pilot>) {
        self.pilot = pilot;
    }

    /// Switches the pilot off: the car rolls out, until the pilot is armed. Returns whether it drove.
    pub fn switch_off(&mut self) -> bool {
        self.handover.switch_off()
    }

    /// Brakes to a standstill, whoever steers, until the pilot is armed; returns whether that is new.
    pub fn stop(&mut self) -> bool {
        let is_new = self.directed.stop.is_none();
        self.directed.stop.get_or_insert_default();
        is_new
    }

    /// Arms a pilot that was switched off, by a human's takeover or otherwise, or stopped; returns whether it was.
    pub fn arm(&mut self) -> bool {
        let was_stopped = self.directed.stop.take().is_some();
        if was_stopped {
            // What was summed up while the brake was on belongs to no drive.
            self.speed.reset();
        }
        self.handover.arm() || was_stopped
    }

    /// A person drives with this command in place of the pilot; `None` gives the wheel back, as a human at the simulator
    /// does by letting go.
    pub fn steer_by_hand(&mut self, command: Option<Command>) {
        self.directed.by_hand = command;
    }

    /// Who drives.
    pub fn hands(&self) -> Hands {
        match () {
            () if self.directed.stop.is_some() => Hands::Stopped,
            () if self.handover.is_human() => Hands::Human,
            () if self.handover.is_off() => Hands::Off,
            () => Hands::Pilot,
        }
    }

    /// The command with the brake of a stop, if there is one: it has the last word.
    pub(super) fn stopped(&mut self, at: Duration, sight: &Sight, command: Command) -> Command {
        let speed = known_speed(sight, self.speed_told);
        match &mut self.directed.stop {
            Some(standstill) => Command { throttle: standstill.update(at, speed), ..command },
            None => command,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use crate::{
        pilot::ConstantPilot,
        protocol::{Answer, CameraImage, Observation, Telemetry, Truth},
        turn::{By, EventRecord, Trace},
        units::{Degrees, Steering, Throttle},
    };

    const JPEG: &[u8] = include_bytes!("../../../sim/src/starts/lake.jpg");

    fn driver(steering: f64) -> Driver {
        Driver::new(pilot(steering), &ControlSettings::default(), Instant::now)
    }

    fn pilot(steering: f64) -> Box<dyn Pilot> {
        Box::new(ConstantPilot::new(Steering::new(steering).unwrap()))
    }

    fn at_mph(driver: &mut Driver, second: u64, mph: f64) -> (Command, Trace) {
        let telemetry = Telemetry {
            steering: Degrees::ZERO,
            throttle: Throttle::ZERO,
            speed: Mph::new(mph).unwrap(),
            image: CameraImage::Jpeg(JPEG.into()),
            truth: Truth::default(),
        };
        let at = Duration::from_secs(second);
        match driver.drive(&Observation { at, sight: Sight::Telemetry(telemetry) }) {
            (Answer::Steer(command), trace) => (command, trace),
            (other, _) => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_set_speed_a_law_and_a_pilot_act_at_the_next_frame() {
        let mut driver = driver(0.1);
        assert!(at_mph(&mut driver, 0, 9.0).0.throttle.get().abs() < 0.01);
        assert!(driver.set_speed(Mph::constant(12.0)) && !driver.set_speed(Mph::constant(12.0)));
        assert!((at_mph(&mut driver, 1, 9.0).0.throttle.get() - 0.306).abs() < 1e-9);
        assert!(driver.set_speed_law(SpeedLaw::Quadratic) && !driver.set_speed_law(SpeedLaw::Quadratic));
        assert!((at_mph(&mut driver, 2, 6.0).0.throttle.get() - (1.0 - 0.01 - 0.25)).abs() < 1e-9);
        driver.set_pilot(pilot(-0.5));
        assert_eq!(at_mph(&mut driver, 3, 6.0).0.steering.get(), -0.5);
        assert_eq!(driver.settings().speed_law, SpeedLaw::Quadratic);
    }

    #[test]
    fn a_stop_brakes_whoever_steers_until_the_pilot_is_armed() {
        let mut driver = driver(0.1);
        assert!(driver.stop() && !driver.stop());
        assert_eq!(driver.hands(), Hands::Stopped);
        let (command, _) = at_mph(&mut driver, 0, 20.0);
        assert_eq!((command.steering.get(), command.throttle), (0.1, Throttle::MIN));
        driver.steer_by_hand(Some(Command { steering: Steering::MAX, throttle: Throttle::MAX }));
        assert_eq!(at_mph(&mut driver, 1, 15.0).0, Command { steering: Steering::MAX, throttle: Throttle::MIN });
        assert_eq!(at_mph(&mut driver, 2, 0.0).0.throttle, Throttle::ZERO);
        assert!(driver.arm() && !driver.arm());
        assert_eq!(at_mph(&mut driver, 3, 0.0).0.throttle, Throttle::MAX);
    }

    #[test]
    fn a_person_has_the_wheel_for_as_long_as_there_are_commands_and_it_is_a_takeover() {
        let mut driver = driver(0.1);
        at_mph(&mut driver, 0, 9.0);
        let by_hand = Command { steering: Steering::new(-0.25).unwrap(), throttle: Throttle::new(0.5).unwrap() };
        driver.steer_by_hand(Some(by_hand));
        let (command, trace) = at_mph(&mut driver, 1, 9.0);
        assert_eq!((command, trace.by, trace.events), (by_hand, By::Human, vec![EventRecord::TakeoverBegan]));
        assert_eq!(at_mph(&mut driver, 2, 9.0).1.events, []);
        driver.steer_by_hand(None);
        let (command, trace) = at_mph(&mut driver, 4, 9.0);
        assert_eq!((command.steering.get(), trace.by), (0.1, By::Pilot));
        assert_eq!(trace.events, [EventRecord::TakeoverEnded { duration_s: 3.0 }]);
    }

    #[test]
    fn a_pilot_that_is_switched_off_lets_the_car_roll_out_until_it_is_armed() {
        let mut driver = driver(0.1);
        assert!(driver.switch_off() && !driver.switch_off());
        let (command, trace) = at_mph(&mut driver, 0, 9.0);
        assert_eq!((command, trace.by, driver.hands()), (Command::default(), By::Off, Hands::Off));
        assert!(driver.arm());
        assert_eq!(at_mph(&mut driver, 1, 9.0).1.by, By::Pilot);
    }
}
