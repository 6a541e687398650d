use std::{convert::Infallible, time::Instant};

use super::*;
use crate::{
    config::{ControlSettings, Takeover},
    pilot::ConstantPilot,
    protocol::{Answer, Sight, TelemetryError},
    turn::By,
    units::Steering,
};

/// Shows some moments a second apart, a human in the first, and reports scripted events before each.
struct Scripted {
    moments: u64,
    shown: u64,
    says: Vec<(u64, EventRecord)>,
    is_recorded: bool,
    answers: Vec<Answer>,
}

fn scripted(moments: u64, says: Vec<(u64, EventRecord)>) -> Scripted {
    Scripted { moments, shown: 0, says, is_recorded: true, answers: vec![] }
}

impl World for Scripted {
    type Error = Infallible;

    fn observe(&mut self) -> Result<Option<Observation>, Infallible> {
        let at = Duration::from_secs(self.shown);
        let sight = match self.shown {
            0 => Sight::HumanDrives,
            _ => Sight::Telemetry(serde_json::from_str(r#"{"steering_deg":0,"throttle":0,"speed_mph":1}"#).unwrap()),
        };
        Ok((self.shown < self.moments).then_some(Observation { at, sight }))
    }

    fn apply(&mut self, answer: Answer) {
        self.answers.push(answer);
        self.shown += 1;
    }
}

impl Eventful for Scripted {
    fn take_events(&mut self) -> Vec<(Duration, EventRecord)> {
        let due = self.says.extract_if(.., |(moment, _)| *moment <= self.shown);
        due.map(|(moment, event)| (Duration::from_secs(moment), event)).collect()
    }

    fn is_recorded(&self) -> bool {
        self.is_recorded
    }

    fn interrupt(&mut self) {
        self.moments = 0;
    }
}

/// Notes all that it is shown, and fails from a given turn on.
#[derive(Default)]
struct Notes {
    lines: Vec<String>,
    fails_at: Option<u64>,
}

impl Observer<Scripted> for Notes {
    fn ready(&mut self, at: Duration) {
        self.lines.push(format!("ready {}", at.as_secs()));
    }

    fn turn(&mut self, world: &Scripted, turn: &Turn) -> Result<(), ObserverError> {
        assert_eq!(world.shown, turn.at().as_secs(), "the world stands as it was seen");
        assert_eq!(turn.latency, Some(turn.trace.total));
        self.lines.push(format!("turn {} by {:?}", turn.at().as_secs(), turn.trace.by));
        if self.fails_at == Some(world.shown) { Err("the film is full".into()) } else { Ok(()) }
    }

    fn event(&mut self, at: Duration, event: &EventRecord) {
        self.lines.push(format!("{event:?} at {}", at.as_secs()));
    }

    fn untold(&mut self, at: Duration, event: &EventRecord) {
        self.lines.push(format!("untold {event:?} at {}", at.as_secs()));
    }

    fn end(&mut self) {
        self.lines.push("end".into());
    }
}

/// Off after a human drove, until it is armed; these worlds have no pictures.
fn driver() -> Driver {
    let control = ControlSettings { takeover: Takeover::Latch, ..ControlSettings::default() };
    Driver::new(Box::new(ConstantPilot::new(Steering::ZERO)), &control, Instant::now)
}

#[test]
fn observers_are_shown_everything_in_the_order_in_which_it_happened() {
    let mut notes = Notes::default();
    let mut world = scripted(3, vec![(1, EventRecord::Stuck), (2, EventRecord::PilotArmed), (3, EventRecord::Moving)]);
    run(&mut world, &mut driver(), &mut [&mut notes, &mut None::<Notes>]).unwrap();
    let by = |turn: u64, by: By| [format!("ready {turn}"), format!("turn {turn} by {by:?}")];
    let mut expected = by(0, By::Human).to_vec();
    expected.push("Stuck at 1".into());
    expected.extend(by(1, By::Off));
    expected.push("PilotArmed at 2".into());
    // The world armed the pilot, so it is asked again, and the empty picture is a bad frame.
    expected.extend(by(2, By::Safe));
    expected.extend(["Moving at 3".into(), "end".into()]);
    assert_eq!(notes.lines, expected);
    assert_eq!((world.answers.len(), world.answers[0]), (3, Answer::Manual));
}

#[test]
fn what_a_run_does_not_hold_is_told_apart() {
    let mut notes = Notes::default();
    let mut world = Scripted { is_recorded: false, ..scripted(0, vec![(0, EventRecord::Stuck)]) };
    run(&mut world, &mut driver(), &mut [&mut notes]).unwrap();
    assert_eq!(notes.lines, ["untold Stuck at 0", "end"]);
}

#[test]
fn an_observer_that_has_seen_enough_ends_the_drive_and_one_that_fails_breaks_it_off() {
    let mut notes = Notes::default();
    let mut world = scripted(9, vec![]);
    run(&mut world, &mut driver(), &mut [&mut notes, &mut StopWhen(|| true)]).unwrap();
    assert_eq!((notes.lines.len(), world.answers.len()), (3, 1), "one turn, its answer and the end: {:?}", notes.lines);

    let mut notes = Notes { fails_at: Some(1), ..Notes::default() };
    let error = run(&mut scripted(9, vec![]), &mut driver(), &mut [&mut notes]).unwrap_err();
    assert!(matches!(error, TurnError::Observer(_)) && error.to_string() == "the film is full", "{error:?}");
    assert_eq!(notes.lines.last().unwrap(), "end");
}

#[test]
fn an_answer_that_never_went_out_is_no_command_of_the_run() {
    let sight = Sight::Unreadable(TelemetryError::Missing("speed"));
    let mut turn = turn(&mut driver(), Observation { at: Duration::ZERO, sight });
    assert_eq!((turn.command(), turn.trace.by), (None, By::Safe));
    turn.latency = Some(Duration::from_millis(3));
    assert_eq!(turn.command().unwrap().latency_ns, Some(3_000_000));
}
