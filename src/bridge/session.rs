//! One connection's drive: dialect, driver, run and account. No socket here:
//! the simulator's handler and socketioxide's both bring messages and take away
//! answers.

use std::{
    sync::Arc,
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use bytes::Bytes;
use serde_json::value::RawValue;

use super::{
    Bridge, Place, Signals,
    statistics::{Recorded, Statistics},
    throttled::{Throttled, held_back},
};
use crate::{
    drive,
    driver::{Driver, Happening, Trace},
    protocol::{Answer, Command, Dialect, Observation, Payload, Sight, TelemetryError},
    recording::{EventRecord, Item, ModelId, Recorder, RecorderOptions, RunHeader},
    units::Throttle,
};

/// An answer in less than this holds nobody up.
const QUICK: Duration = Duration::from_millis(5);

/// A connection's drive.
pub(super) struct Session {
    place: Place,
    peer: String,
    dialect: Option<Dialect>,
    drive: Option<Drive>,
    last: Command,
    /// Kicks before the drive began, for its account.
    early_kicks: u32,
    bad: Throttled,
    kicks: Throttled,
    told: Told,
}

/// What has been said once and need not be said again.
#[derive(Default)]
struct Told {
    loading: bool,
    unsupported: bool,
}

/// From the first telemetry on.
struct Drive {
    driver: Driver,
    recorder: Option<Recorder>,
    began: Instant,
    /// Time of the last answer.
    took: Duration,
    statistics: Statistics,
}

/// An answer on its way out, with what is to be recorded once it is.
pub(super) struct Turn {
    pub answer: Answer,
    pub dialect: Option<Dialect>,
    received: Instant,
    /// Absent where nothing drives: the model is loading, or the simulator is none that can be driven.
    driven: Option<(Observation, Trace)>,
}

impl Turn {
    /// Whether the simulator said that a human drives.
    pub fn is_human(&self) -> bool {
        self.answer == Answer::Manual
    }
}

impl Session {
    pub fn new(place: Place, peer: String) -> Self {
        Self {
            place,
            peer,
            dialect: None,
            drive: None,
            last: Command::default(),
            early_kicks: 0,
            bad: Throttled::default(),
            kicks: Throttled::default(),
            told: Told::default(),
        }
    }

    pub fn bridge(&self) -> &Arc<Bridge> {
        &self.place.bridge
    }

    pub fn signals(&self) -> &Arc<Signals> {
        &self.place.signals
    }

    pub fn is_timer_driven(&self) -> bool {
        self.dialect.is_some_and(Dialect::is_timer_driven)
    }

    /// Does work of a moment on the spot, and what may take longer (a large
    /// network, a new run's file) while other connections' tasks move on: making
    /// way for them costs 0.07 ms a frame.
    pub fn aside<T>(&mut self, work: impl FnOnce(&mut Self) -> T) -> T {
        if self.drive.as_ref().is_some_and(|drive| drive.took < QUICK) {
            work(self)
        } else {
            tokio::task::block_in_place(|| work(self))
        }
    }

    /// An event of a simulator. `message` is the text that `payload` lies in.
    /// `None` where the event asks for no answer.
    pub fn event(
        &mut self,
        received: Instant,
        message: &Bytes,
        name: &str,
        payload: Option<&RawValue>,
    ) -> Option<Turn> {
        if !matches!(name, "telemetry" | "car_telemetry") {
            // The recorder keeps the beginning of long ones.
            let (name, payload) = (name.to_owned(), payload.map_or("", RawValue::get).to_owned());
            self.note(received, EventRecord::Simulator { name, payload });
            return None;
        }
        let sight = match self.sight(message, name, payload) {
            Ok(sight) => sight,
            Err(TelemetryError::Unsupported(why)) => return Some(self.unsupported(received, why)),
            Err(error) => Sight::Unreadable(error),
        };
        Some(self.turn(received, sight))
    }

    /// Reads a telemetry; the first one that is an object tells the dialect, be its fields good or bad.
    fn sight(&mut self, message: &Bytes, name: &str, payload: Option<&RawValue>) -> Result<Sight, TelemetryError> {
        let Some(payload) = Payload::read(payload)? else { return Ok(Sight::HumanDrives) };
        if self.dialect.is_none() {
            let dialect = payload.dialect(name)?;
            tracing::info!("{}: this is a {dialect} simulator", self.peer);
            self.dialect = Some(dialect);
            // The header of a run that began with a human does not say it.
            self.note(Instant::now(), EventRecord::Note { text: format!("this is a {dialect} simulator") });
        }
        payload.telemetry(message, self.bridge().settings.bridge.speed_unit).map(Sight::Telemetry)
    }

    /// A message that is no event of a simulator: it may have been a telemetry, so it gets an answer.
    pub fn unreadable(&mut self, received: Instant, got: String, why: String) -> Turn {
        self.turn(received, Sight::Unreadable(TelemetryError::Json { got, why }))
    }

    /// The last command on the way out: steering as it was, no throttle, or the
    /// car would go on with the last one. `None` where the pilot does not drive.
    pub fn farewell(&self) -> Option<(Answer, Option<Dialect>)> {
        let drives = self.drive.as_ref().is_some_and(|drive| !drive.driver.human_drives());
        drives.then(|| (self.coast(), self.dialect))
    }

    fn coast(&self) -> Answer {
        Answer::Steer(Command { throttle: Throttle::ZERO, ..self.last })
    }

    /// A command that nobody asked for, to get the simulator's loop going.
    pub fn kick(&mut self, now: Instant) -> (Answer, Option<Dialect>) {
        if let Some(held) = self.kicks.due(now) {
            let more = held_back(held);
            tracing::info!("{}: no telemetry; a command is sent unasked to get the simulator going{more}", self.peer);
        }
        self.note(now, EventRecord::Kick);
        match &mut self.drive {
            Some(drive) => drive.statistics.kicked(1),
            None => self.early_kicks += 1,
        }
        // Before its first telemetry nobody knows which `steer` a simulator takes; every one takes `manual`.
        let answer =
            if self.dialect.is_none() && self.early_kicks.is_multiple_of(2) { Answer::Manual } else { self.coast() };
        (answer, self.dialect)
    }

    /// Records a turn whose answer has gone out.
    pub fn answered(&mut self, turn: Turn, now: Instant) {
        let latency = now.saturating_duration_since(turn.received);
        self.record(turn, now, Some(latency));
    }

    /// Records a turn that is left unanswered.
    pub fn swallowed(&mut self, turn: Turn, now: Instant) {
        self.record(turn, now, None);
    }

    fn record(&mut self, turn: Turn, now: Instant, latency: Option<Duration>) {
        let Some(((observation, trace), drive)) = turn.driven.zip(self.drive.as_mut()) else { return };
        let at = observation.at;
        let telemetry = match observation.sight {
            Sight::Telemetry(telemetry) => Some(telemetry),
            Sight::HumanDrives | Sight::Unreadable(_) => None,
        };
        drive.statistics.count(at, telemetry.as_ref().map(|t| t.speed), &trace, latency);
        for happening in &trace.happenings {
            tell(&self.peer, happening, &self.bad, now);
        }
        if let Some(recorder) = &drive.recorder {
            drive::record(recorder, at, telemetry, turn.answer, trace, latency);
        }
    }

    /// Ends the run: the file is closed, the account given.
    pub fn finish(mut self, why: &str) {
        self.note(Instant::now(), EventRecord::RunEnded { why: why.to_owned() });
        let Some(Drive { recorder, statistics, .. }) = self.drive.take() else {
            // Dialling without a word is what thousands of redials look like.
            if let Some(held) = self.bridge().wordless.due(Instant::now()) {
                tracing::info!("{}: {why}; it never sent a telemetry{}", self.peer, held_back(held));
            }
            return;
        };
        tracing::info!("{}: {why}", self.peer);
        let run = recorder.map(|recorder| {
            let report = recorder.finish();
            Recorded {
                path: report.path,
                frames: report.frames,
                not_recorded: report.frames_not_recorded + report.items_not_recorded,
                error: report.error.map(|e| e.to_string()),
            }
        });
        let summary = statistics.summary(self.peer.clone(), self.dialect, run);
        (self.bridge().on_summary)(&summary);
    }

    fn turn(&mut self, received: Instant, sight: Sight) -> Turn {
        let dialect = self.dialect;
        self.begin(received);
        let Some(drive) = &mut self.drive else {
            let answer = if sight == Sight::HumanDrives { Answer::Manual } else { Answer::Steer(Command::default()) };
            return Turn { answer, dialect, received, driven: None };
        };
        let at = received.saturating_duration_since(drive.began);
        // While the human still drives the wish is kept until they let go.
        let arm = &self.place.signals.arm;
        if arm.load(Ordering::Relaxed) && !drive.driver.human_drives() {
            arm.store(false, Ordering::Relaxed);
            if drive.driver.arm() {
                tracing::info!("{}: the pilot is armed", self.peer);
                if let Some(recorder) = &drive.recorder {
                    recorder.record(at, Item::Event(EventRecord::PilotArmed));
                }
            }
        }
        let observation = Observation { at, sight };
        let (answer, trace) = drive.driver.drive(&observation);
        drive.took = trace.total;
        if let Answer::Steer(command) = answer {
            self.last = command;
        }
        Turn { answer, dialect, received, driven: Some((observation, trace)) }
    }

    /// Begins the run with the first telemetry after the model is there.
    fn begin(&mut self, now: Instant) {
        if self.drive.is_some() {
            return;
        }
        let bridge = self.place.bridge.clone();
        let Some(model) = bridge.model.get() else {
            if !std::mem::replace(&mut self.told.loading, true) {
                tracing::info!("{}: the model is still loading; the car stands until it is there", self.peer);
            }
            return;
        };
        let settings = &bridge.settings;
        let header = || RunHeader {
            name_hint: None,
            dialect: self.dialect,
            model: Some(ModelId { name: model.name().to_owned(), sha256: model.sha256().to_owned() }),
            seed: None,
            config: serde_json::to_value(settings).expect("settings are plain data"),
            lapwing: env!("CARGO_PKG_VERSION").to_owned(),
            started: jiff::Timestamp::now(),
        };
        let recorder = settings.recording.enabled.then(|| {
            let options = RecorderOptions { queue: settings.recording.queue };
            Recorder::create(&settings.recording.dir, header(), options)
                .inspect_err(|error| tracing::error!("{}: this drive is not recorded: {error}", self.peer))
                .ok()
        });
        let mut statistics = Statistics::new();
        statistics.kicked(self.early_kicks);
        self.drive = Some(Drive {
            driver: Driver::new(model.pilot(), &settings.control, Instant::now),
            recorder: recorder.flatten(),
            began: now,
            took: Duration::MAX,
            statistics,
        });
        for _ in 0..std::mem::take(&mut self.early_kicks) {
            self.note(now, EventRecord::Kick);
        }
    }

    fn unsupported(&mut self, received: Instant, why: &'static str) -> Turn {
        if !std::mem::replace(&mut self.told.unsupported, true) {
            tracing::error!("{}: {why}", self.peer);
        }
        // Leaves the car to the player, in every dialect, and keeps the simulator's loop going.
        Turn { answer: Answer::Manual, dialect: None, received, driven: None }
    }

    fn note(&mut self, now: Instant, event: EventRecord) {
        if let Some(Drive { recorder: Some(recorder), began, .. }) = &self.drive {
            recorder.record(now.saturating_duration_since(*began), Item::Event(event));
        }
    }
}

fn tell(peer: &str, happening: &Happening, bad: &Throttled, now: Instant) {
    match happening {
        Happening::TakeoverBegan => tracing::info!("{peer}: a human drives"),
        Happening::TakeoverEnded { after, pilot_off: false } => {
            tracing::info!("{peer}: the pilot drives again after {:.1} s", after.as_secs_f64());
        }
        Happening::TakeoverEnded { after, pilot_off: true } => tracing::warn!(
            "{peer}: the human let go after {:.1} s; the pilot is off until it is armed: press Enter here, or POST /arm",
            after.as_secs_f64()
        ),
        Happening::BadFrame { why, in_a_row } => {
            if let Some(held) = bad.due(now) {
                tracing::warn!("{peer}: bad frame ({in_a_row} in a row): {why}{}", held_back(held));
            }
        }
        Happening::BrakingToStandstill => tracing::error!("{peer}: too many bad frames in a row: stopping the car"),
    }
}
