//! One connection's drive: dialect, driver, run and account. No socket here: the simulator's handler and socketioxide's
//! both bring messages and take answers.

use std::{
    io::{self, IsTerminal},
    sync::Arc,
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use bytes::Bytes;
use serde_json::{json, value::RawValue};

use super::{Bridge, Presence, Signals, account::Account, throttled::Throttled, waiting::Waiting};
use crate::page::{Abilities, Control, Showing};
use lapwing_core::{
    drive::{self, Elsewhere, Observer},
    driver::Driver,
    protocol::{Answer, Command, Dialect, Observation, Payload, Sight, TelemetryError, Undrivable},
    recording::{ModelId, RunHeader, RunKind},
    turn::{By, EventRecord, Turn},
    units::Throttle,
    words::count,
};

/// An answer that takes less than this delays nobody.
const QUICK: Duration = Duration::from_millis(5);

/// A connection's drive.
pub(super) struct Session {
    place: Presence,
    peer: String,
    dialect: Option<Dialect>,
    decimal_separator: Option<char>,
    /// The state before there is a drive.
    waiting: Waiting,
    drive: Option<Underway>,
    /// Its place on the page, once it is known what it is.
    showing: Option<Showing>,
    /// A person at the page has ended the run; none begins before they begin one.
    ended: bool,
    last: Command,
    /// Kicks before the drive began, for its account.
    early_kicks: u32,
    bad: Throttled,
    kicks: Throttled,
    told: SaidOnce,
}

/// What was logged once and need not be logged again.
#[derive(Default)]
struct SaidOnce {
    /// That it has connected.
    connected: bool,
    /// That a telemetry came, of any kind.
    heard: bool,
    loading: bool,
    /// That the simulator cannot be driven.
    undrivable: bool,
    /// That the car is being stopped because of bad frames.
    stopping: bool,
}

/// A drive: from the first telemetry that identifies the simulator, once the model is loaded.
struct Underway {
    driver: Driver,
    began: Instant,
    /// Time of the last answer.
    took: Duration,
    account: Account,
}

impl Underway {
    /// No observer here can stop a drive: problems with a run are reported at its end.
    fn show(&mut self, turn: &Turn, now: Instant, showing: &mut Option<Showing>) {
        if let Err(error) = self.account.turn(&Elsewhere, turn) {
            tracing::error!("a turn could not be shown: {error}");
        }
        if let Some(showing) = showing {
            showing.score(self.account.scorer(), now);
            showing.is_written(now, || self.account.file());
            showing.turn(turn, self.driver.hands(), now);
        }
    }
}

/// An answer on its way out, with what to record once it is sent.
pub(super) struct Reply {
    pub answer: Answer,
    pub dialect: Option<Dialect>,
    received: Instant,
    /// Absent if nothing drives: the car waits, or the simulator cannot be driven.
    turn: Option<Turn>,
}

impl Reply {
    /// Whether the simulator said that a human drives.
    pub fn is_human(&self) -> bool {
        self.answer == Answer::Manual
    }
}

impl Session {
    pub fn new(place: Presence, peer: String) -> Self {
        // Other clients were introduced when they connected.
        let told = SaidOnce { connected: !place.simulator, ..SaidOnce::default() };
        Self {
            place,
            peer,
            dialect: None,
            decimal_separator: None,
            waiting: Waiting::new(Instant::now()),
            drive: None,
            showing: None,
            ended: false,
            last: Command::default(),
            early_kicks: 0,
            bad: Throttled::default(),
            kicks: Throttled::default(),
            told,
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

    /// Does quick work on the spot, and lets other connections' tasks move on during work that may take longer (a large
    /// network, a new run's file): making way for them costs 0.07 ms per frame.
    pub fn aside<T>(&mut self, work: impl FnOnce(&mut Self) -> T) -> T {
        if self.drive.as_ref().is_some_and(|drive| drive.took < QUICK) {
            work(self)
        } else {
            tokio::task::block_in_place(|| work(self))
        }
    }

    /// Handles an event of a simulator. `message` is the text that contains `payload`. `None` if the event needs no
    /// answer.
    pub fn event(
        &mut self,
        received: Instant,
        message: &Bytes,
        name: &str,
        payload: Option<&RawValue>,
    ) -> Option<Reply> {
        if !matches!(name, "telemetry" | "car_telemetry") {
            // The recorder keeps only the beginning of long ones.
            let (name, payload) = (name.to_owned(), payload.map_or("", RawValue::get).to_owned());
            self.note(received, EventRecord::Simulator { name, payload });
            return None;
        }
        self.told.heard = true;
        let sight = match self.sight(message, name, payload) {
            Ok(sight) => sight,
            Err(TelemetryError::Undrivable(why)) => {
                self.refuse(why);
                Sight::HumanDrives
            }
            Err(error) => Sight::Unreadable(error),
        };
        Some(self.reply(received, sight))
    }

    /// Reads a telemetry; the first one that is an object reveals the dialect, whether its fields are valid or not.
    fn sight(&mut self, message: &Bytes, name: &str, payload: Option<&RawValue>) -> Result<Sight, TelemetryError> {
        let Some(payload) = Payload::read(payload)? else { return Ok(Sight::HumanDrives) };
        if self.dialect.is_none() {
            let dialect = payload.dialect(name)?;
            self.dialect = Some(dialect);
            self.decimal_separator = payload.decimal_separator();
            self.introduce(&format!("a {dialect} simulator"));
            self.place.plays(dialect);
            let title = format!("{dialect}, {}", self.peer);
            self.showing = Some(self.bridge().page.show(&title, Abilities::of_a_connection()));
        }
        payload.telemetry(message, self.bridge().settings.bridge.speed_unit).map(Sight::Telemetry)
    }

    /// Handles a message that is not a simulator's event: it may have been a telemetry, so it gets an answer.
    pub fn unreadable(&mut self, received: Instant, got: String, why: String) -> Reply {
        self.reply(received, Sight::Unreadable(TelemetryError::Json { got, why }))
    }

    /// The last command before leaving: same steering, no throttle; otherwise the car would keep the last throttle,
    /// even when a human who drives now lets go later. `None` if no known simulator was heard.
    pub fn farewell(&self) -> Option<(Answer, Option<Dialect>)> {
        (self.told.heard && !self.is_refused()).then(|| (self.coast(), self.dialect))
    }

    /// Whether the simulator was refused and has not shown since then that it can be driven after all.
    fn is_refused(&self) -> bool {
        self.told.undrivable && self.dialect.is_none()
    }

    /// Logs who this is. Not on connecting: simulators without a bridge redial thousands of times a second, and lines
    /// about those must not crowd out lines about one that plays.
    fn introduce(&mut self, who: &str) {
        if std::mem::replace(&mut self.told.connected, true) {
            tracing::info!("{}: this is {who}", self.peer);
        } else if let Some(more) = self.bridge().newcomers.due(Instant::now()) {
            tracing::info!("{}: {who} has connected{more}", self.peer);
        }
    }

    fn coast(&self) -> Answer {
        Answer::Steer(Command { throttle: Throttle::ZERO, ..self.last })
    }

    /// An unrequested command, to get the simulator's loop going.
    pub fn kick(&mut self, now: Instant) -> (Answer, Option<Dialect>) {
        if let Some(more) = self.kicks.due(now) {
            if !self.told.connected {
                self.introduce("a simulator");
            }
            tracing::info!(
                "{}: no telemetry; sending an unrequested command to get the simulator going{more}",
                self.peer
            );
        }
        self.note(now, EventRecord::Kick);
        self.early_kicks += u32::from(self.drive.is_none());
        // Before its first telemetry it is unknown which `steer` a simulator takes; all take `manual`.
        let answer =
            if self.dialect.is_none() && self.early_kicks.is_multiple_of(2) { Answer::Manual } else { self.coast() };
        (answer, self.dialect)
    }

    /// Records a turn whose answer has gone out.
    pub fn answered(&mut self, reply: Reply, now: Instant) {
        let latency = now.saturating_duration_since(reply.received);
        self.show(reply, now, Some(latency));
    }

    /// Records a turn that is left unanswered.
    pub fn swallowed(&mut self, reply: Reply, now: Instant) {
        self.show(reply, now, None);
    }

    /// Logs that surplus tokens were removed.
    pub fn took_out(&self, tokens: u32) {
        tracing::info!(
            "{}: {} {} left unanswered; the simulator now sends one per answer again",
            self.peer,
            count(tokens, "surplus telemetry"),
            if tokens == 1 { "was" } else { "were" },
        );
    }

    /// Logs that its telemetries are not tokens.
    pub fn sends_unasked(&self) {
        tracing::warn!("{}: telemetry comes faster than it is answered, and without waiting for answers", self.peer);
    }

    /// Completes a turn and shows it to the observers.
    fn show(&mut self, reply: Reply, now: Instant, latency: Option<Duration>) {
        let Some((turn, drive)) = reply.turn.zip(self.drive.as_mut()) else { return };
        let turn = Turn { latency, ..turn };
        tell(&self.peer, &turn.trace.events, &self.bad, now);
        if turn.trace.events.contains(&EventRecord::BrakingToStandstill) {
            self.told.stopping = true;
        } else if turn.trace.by == By::Pilot && std::mem::take(&mut self.told.stopping) {
            tracing::info!("{}: frames are good again: the pilot drives", self.peer);
        }
        drive.show(&turn, now, &mut self.showing);
    }

    /// Ends the run: closes the file and reports the summary.
    pub fn finish(mut self, why: &str) {
        self.note(Instant::now(), EventRecord::RunEnded { why: why.to_owned() });
        if self.drive.is_none() {
            let what = match () {
                () if self.is_refused() => "it could not be driven",
                () if self.ended => "its run had been ended",
                () if self.dialect.is_some() => "the model was still loading",
                () if self.told.heard => "no telemetry showed which simulator it was",
                () => "it never sent a telemetry",
            };
            // Thousands of redials look like this: connections without a message.
            if let Some(more) = self.bridge().wordless.due(Instant::now()) {
                tracing::info!("{}: {why}; {what}{more}", self.peer);
            }
            return;
        }
        tracing::info!("{}: {why}", self.peer);
        self.close();
    }

    fn reply(&mut self, received: Instant, sight: Sight) -> Reply {
        let dialect = self.dialect;
        if self.is_refused() {
            // Its `null` does not mean a human, and nothing is recorded. This answer leaves the car to the player in
            // every build and keeps the simulator's loop going.
            return Reply { answer: Answer::Manual, dialect, received, turn: None };
        }
        self.heed(received);
        self.begin(received);
        let Some(drive) = &mut self.drive else {
            return Reply { answer: self.wait(received, &sight), dialect, received, turn: None };
        };
        let at = received.saturating_duration_since(drive.began);
        // While the human still drives, the request is kept until they let go.
        let arm = &self.place.signals.arm;
        if arm.load(Ordering::Relaxed) && !drive.driver.human_drives() {
            arm.store(false, Ordering::Relaxed);
            if drive.driver.arm() {
                tracing::info!("{}: the pilot is armed", self.peer);
                drive.account.event(at, &EventRecord::PilotArmed);
                self.showing.iter_mut().for_each(|showing| showing.event(at, &EventRecord::PilotArmed));
            }
        }
        if let Some(showing) = &mut self.showing {
            for event in showing.direct(&mut drive.driver, received) {
                let what = event.in_words().unwrap_or_else(|| event.kind());
                tracing::info!("{}: by the page: {what}", self.peer);
                drive.account.event(at, &event);
                showing.event(at, &event);
            }
        }
        let turn = drive::turn(&mut drive.driver, Observation { at, sight });
        drive.took = turn.trace.total;
        if let Answer::Steer(command) = turn.answer {
            self.last = command;
        }
        Reply { answer: turn.answer, dialect, received, turn: Some(turn) }
    }

    /// The answer while nothing drives.
    fn wait(&mut self, received: Instant, sight: &Sight) -> Answer {
        let is_loading = self.dialect.is_some() && !self.ended;
        if is_loading && !std::mem::replace(&mut self.told.loading, true) {
            tracing::info!("{}: the model is still loading; the car is braked until it is ready", self.peer);
        }
        match sight {
            Sight::Unreadable(why) => {
                if let Some(more) = self.bad.due(received) {
                    tracing::warn!("{}: bad frame before the drive: {why}{more}", self.peer);
                }
            }
            Sight::HumanDrives if !self.told.connected => {
                self.introduce("a simulator");
                tracing::info!(
                    "{}: its telemetry is empty: a human drives, or the simulator has to be started first",
                    self.peer
                );
            }
            Sight::HumanDrives | Sight::Telemetry(_) => {}
        }
        let answer = self.waiting.answer(received, sight);
        if let Answer::Steer(command) = answer {
            self.last = command;
        }
        answer
    }

    /// Ends or begins a run as a person at the page asks.
    fn heed(&mut self, now: Instant) {
        let others = self.showing.as_mut().map(Showing::others).unwrap_or_default();
        for control in others {
            match control {
                Control::StartRun => self.ended = false,
                Control::EndRun if self.drive.is_some() => {
                    let why = "a person at the page ended it";
                    self.note(now, EventRecord::RunEnded { why: why.to_owned() });
                    tracing::info!("{}: {why}", self.peer);
                    if let (Some(showing), Some(drive)) = (&mut self.showing, &self.drive) {
                        showing.keep_score(drive.account.scorer());
                    }
                    // Closing a file may take its time.
                    tokio::task::block_in_place(|| self.close());
                    (self.ended, self.waiting) = (true, Waiting::new(now));
                    self.showing.iter_mut().for_each(Showing::run_ended);
                }
                // The page refuses what a connection cannot do.
                _ => {}
            }
        }
    }

    /// Closes the run, if there is one, and reports its summary; returns whether there was one.
    fn close(&mut self) -> bool {
        let Some(Underway { account, .. }) = self.drive.take() else { return false };
        let summary = account.finish(self.peer.clone());
        if let (Some(showing), Some(run)) = (&mut self.showing, &summary.run) {
            showing.has_lost(run.not_recorded);
        }
        (self.bridge().on_summary)(&summary);
        true
    }

    /// Begins the run once the simulator is known and the model is loaded.
    fn begin(&mut self, now: Instant) {
        if self.drive.is_some() || self.dialect.is_none() || self.ended {
            return;
        }
        let bridge = self.place.bridge.clone();
        let Some(models) = bridge.models.get() else { return };
        let chosen = self.showing.as_ref().map_or(0, Showing::pilot);
        let Some(model) = models.get(chosen).or(models.first()) else { return };
        // A human who drove until now belongs to the run.
        let human_since = self.waiting.human_since();
        let began = human_since.unwrap_or(now);
        let settings = &bridge.settings;
        let started = jiff::Timestamp::now();
        let started = started.checked_sub(began.elapsed()).unwrap_or(started);
        let guard = bridge.guard.get();
        let mut settings = settings.clone();
        if let Some(control) = self.showing.as_ref().and_then(Showing::settings) {
            settings.control = control.clone();
        }
        let settings = &settings;
        let mut config = serde_json::to_value(settings).expect("settings are plain data");
        if let (Some(guard), Some(config)) = (guard, config.as_object_mut()) {
            config.insert("guard".into(), json!({ "name": guard.name(), "sha256": guard.sha256() }));
        }
        let header = RunHeader {
            dialect: self.dialect,
            decimal_separator: self.decimal_separator,
            model: Some(ModelId::of(model.as_ref())),
            ..RunHeader::new(RunKind::Driven, config, started)
        };
        let mut drive = Underway {
            driver: Driver::new(model.pilot(), &settings.control, Instant::now)
                .guarded(guard.map(|guard| guard.guard())),
            began,
            took: Duration::MAX,
            account: Account::new(&self.peer, header, &settings.recording, &bridge),
        };
        if let Some(showing) = &mut self.showing {
            showing.run_begins(self.dialect, &settings.control);
        }
        if human_since.is_some() {
            let observation = Observation { at: Duration::ZERO, sight: Sight::HumanDrives };
            let turn = drive::turn(&mut drive.driver, observation);
            drive.show(&turn, now, &mut self.showing);
        }
        self.drive = Some(drive);
        for _ in 0..std::mem::take(&mut self.early_kicks) {
            self.note(now, EventRecord::Kick);
        }
    }

    fn refuse(&mut self, why: Undrivable) {
        self.told.connected = true;
        if !std::mem::replace(&mut self.told.undrivable, true) {
            tracing::error!("{}: {why}", self.peer);
        }
    }

    fn note(&mut self, now: Instant, event: EventRecord) {
        if let Some(Underway { account, began, .. }) = &mut self.drive {
            let at = now.saturating_duration_since(*began);
            account.event(at, &event);
            if let Some(showing) = &mut self.showing {
                showing.event(at, &event);
            }
        }
    }
}

fn tell(peer: &str, events: &[EventRecord], bad: &Throttled, now: Instant) {
    let is_off = events.iter().any(|event| matches!(event, EventRecord::PilotOff { .. }));
    for event in events {
        match event {
            EventRecord::TakeoverBegan => tracing::info!("{peer}: a human drives"),
            EventRecord::TakeoverEnded { duration_s } if is_off => {
                let enter = if io::stdin().is_terminal() { "press Enter here, or " } else { "" };
                tracing::warn!(
                    "{peer}: the human let go after {duration_s:.1} s; the pilot is off until it is armed: {enter}POST /arm"
                );
            }
            EventRecord::TakeoverEnded { duration_s } => {
                tracing::info!("{peer}: the pilot drives again after {duration_s:.1} s");
            }
            EventRecord::BadFrame { why, count_in_row } => {
                if let Some(more) = bad.due(now) {
                    tracing::warn!("{peer}: bad frame ({count_in_row} in a row): {why}{more}");
                }
            }
            EventRecord::BrakingToStandstill => {
                tracing::error!("{peer}: too many bad frames in a row: stopping the car");
            }
            EventRecord::GuardBrakes { guard, value, fires, speed_mph } => {
                let why = EventRecord::guard_words(guard, *value, *fires);
                tracing::warn!("{peer}: emergency brake at {speed_mph:.1} mph ({why})");
            }
            EventRecord::GuardReleases { after_s, .. } => {
                tracing::info!("{peer}: the emergency brake lets go after {after_s:.1} s");
            }
            // Logged with the takeover's end.
            EventRecord::PilotOff { .. } => {}
            other => tracing::debug!("{peer}: {other:?}"),
        }
    }
}
