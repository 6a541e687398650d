//! The driver's end of a page: what it shows, and what it is asked for.
//!
//! Nothing here waits for a page. What is shown is put where the newest replaces the one before, and those who look take
//! a reference to it. What is asked for lies in a box whose lock is only tried: if a page holds it just then, the next
//! frame finds it.

use std::{
    sync::{
        Arc, Mutex, PoisonError, TryLockError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use tokio::sync::watch;

use super::{
    Page,
    control::{Control, Refused, speed},
    course::Located,
    explained,
    minute::Minute,
    moment::{Facts, Happened, Moment, Phase, RunFileStatus, Status, dialect, hands},
};
use lapwing_core::{
    config::ControlSettings,
    driver::{Driver, Hands},
    pilot::Pilot,
    protocol::{Command, Dialect},
    turn::{EventRecord, Turn},
};
use lapwing_score::score::Scorer;

/// Events that a page which comes late is still shown.
const EVENTS: usize = 60;
/// Time between two looks at the score.
const SCORE: Duration = Duration::from_secs(1);
/// Time between two looks at the file of the run.
const FILE: Duration = Duration::from_secs(1);
/// A page that drives by hand and says nothing for this long has let go.
const LET_GO: Duration = Duration::from_millis(500);
/// How long a score is waited for that is not looked at all the time.
const SOON: Duration = Duration::from_millis(250);
/// Requests that may wait for the driver.
const WAITING: usize = 32;

/// A drive as pages know it.
#[derive(Debug)]
pub(super) struct Drive {
    pub id: u64,
    pub newest: watch::Sender<Arc<Moment>>,
    /// Its last minute, for pages that begin to watch.
    pub minute: Minute,
    /// For those who look alone: the driver's end never touches it.
    pub located: Mutex<Located>,
    /// What its pilot looked at last; likewise.
    pub explained: tokio::sync::Mutex<Option<explained::Last>>,
    asked: AtomicBool,
    /// Whether somebody who does not look all the time wants the score.
    wants_score: AtomicBool,
    inbox: Mutex<Inbox>,
}

#[derive(Default)]
struct Inbox {
    wishes: Vec<Wish>,
    /// The wheel, and when it was last turned; none once it was let go.
    by_hand: Option<(Command, Instant)>,
    /// The page that turned it.
    holder: u64,
}

impl std::fmt::Debug for Inbox {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} wishes", self.wishes.len())
    }
}

/// A request on its way to the driver.
enum Wish {
    Control(Control),
    /// Made where making it delays nobody.
    Pilot(usize, Box<dyn Pilot>),
}

impl Drive {
    pub fn now(&self) -> Arc<Moment> {
        self.newest.borrow().clone()
    }

    /// The score as it is now, or, where the next turn does not come soon, as it was when somebody last looked.
    pub async fn scorer(&self) -> Option<Arc<Scorer>> {
        let mut newest = self.newest.subscribe();
        let old = newest.borrow_and_update().scorer.clone();
        self.wants_score.store(true, Ordering::Release);
        let is_new = |now: &Arc<Moment>| now.scorer.as_ref().map(Arc::as_ptr) != old.as_ref().map(Arc::as_ptr);
        let now = tokio::time::timeout(SOON, newest.wait_for(is_new)).await;
        match now {
            Ok(Ok(now)) => now.scorer.clone(),
            // No turn in this time, or the drive is over.
            Ok(Err(_)) | Err(_) => old,
        }
    }

    /// Puts a request into the box. Pilots are made here.
    pub fn ask(&self, page: &Page, control: Control) -> Result<(), Refused> {
        let now = self.now();
        control.check(&now.status.can, &now.status.offered, page.pilots().len())?;
        if control == Control::Arm && now.status.phase == Phase::Ended {
            return Err(now.status.can.begins_another());
        }
        let wish = match control {
            Control::Pilot { index } => match page.pilots().get(index) {
                Some(choice) => Wish::Pilot(index, (choice.make)()),
                None => return Err(Refused::Cannot("no pilot is there yet: the model is loading".into())),
            },
            other => Wish::Control(other),
        };
        let mut inbox = self.inbox.lock().unwrap_or_else(PoisonError::into_inner);
        if inbox.wishes.len() >= WAITING {
            return Err(Refused::Busy(inbox.wishes.len()));
        }
        inbox.wishes.push(wish);
        self.asked.store(true, Ordering::Release);
        Ok(())
    }

    /// Does something while a page holds the box.
    #[cfg(test)]
    pub fn while_held(&self, work: impl FnOnce()) {
        let _held = self.inbox.lock().unwrap_or_else(PoisonError::into_inner);
        work();
    }

    /// The page of this number turns the wheel, or lets go of it. False, and nothing happens, while another page has it.
    pub fn by_hand(&self, page: u64, command: Option<Command>) -> bool {
        let mut inbox = self.inbox.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        let is_held = inbox.by_hand.is_some_and(|(_, at)| now.saturating_duration_since(at) < LET_GO);
        if is_held && inbox.holder != page {
            return false;
        }
        inbox.by_hand = command.map(|command| (command, now));
        inbox.holder = page;
        self.asked.store(true, Ordering::Release);
        true
    }
}

/// One drive's place on the page, held by whoever drives. It leaves the page when it is dropped.
pub struct Showing {
    page: Arc<Page>,
    drive: Arc<Drive>,
    now: Moment,
    status: Status,
    events: Vec<Happened>,
    happened: u64,
    turns: u64,
    /// When turns were shown within the last second or so, for the frame rate.
    rate: (Instant, u64, f64),
    scored: Instant,
    /// When it was last asked how its file is doing; never in this run if none.
    filed: Option<Instant>,
    /// What runs before this one lost.
    lost_before: u64,
    wishes: Vec<Wish>,
    by_hand: Option<(Command, Instant)>,
    settings: Option<ControlSettings>,
}

impl Showing {
    pub(super) fn new(page: Arc<Page>, id: u64, status: Status) -> Self {
        let now = Moment { status: Arc::new(status.clone()), ..Moment::default() };
        let newest = watch::Sender::new(Arc::new(now.clone()));
        let drive = Arc::new(Drive {
            id,
            newest,
            minute: Minute::default(),
            located: Mutex::default(),
            explained: tokio::sync::Mutex::default(),
            asked: AtomicBool::new(false),
            wants_score: AtomicBool::new(false),
            inbox: Mutex::default(),
        });
        let began = Instant::now();
        Self {
            page,
            drive,
            now,
            status,
            events: vec![],
            happened: 0,
            turns: 0,
            rate: (began, 0, 0.0),
            scored: began,
            filed: None,
            lost_before: 0,
            wishes: vec![],
            by_hand: None,
            settings: None,
        }
    }

    pub(super) fn drive(&self) -> &Arc<Drive> {
        &self.drive
    }

    /// A run begins, driven so by this pilot of the page's.
    pub fn run_begins(&mut self, which: Option<Dialect>, settings: &ControlSettings) {
        self.status.run += 1;
        self.status.phase = Phase::Driving;
        self.status.dialect = dialect(which);
        self.status.hands = "pilot";
        self.has_settings(settings);
        (self.now.turn, self.now.scorer) = (None, None);
        (self.filed, self.lost_before) = (None, self.now.counts.not_recorded);
        self.status.file = None;
        self.publish();
    }

    /// A person ended the run.
    pub fn run_ended(&mut self) {
        self.status.phase = Phase::Ended;
        self.status.file = None;
        self.publish();
    }

    /// Another course is driven.
    pub fn on_course(&mut self, track: &str, scenario: Option<&str>) {
        self.status.track = Some(track.to_owned());
        self.status.scenario = scenario.map(str::to_owned);
        self.publish();
    }

    /// What else the drive may be asked for.
    pub fn offers(&mut self, offered: super::Offered) {
        self.status.offered = offered;
        self.publish();
    }

    /// Whether time stands still.
    pub fn is_paused(&mut self, paused: bool) {
        self.status.paused = paused;
        self.publish();
    }

    /// How many rows of training data are kept, and whether more are added now.
    pub fn recorded(&mut self, rows: u64, adding: bool) {
        (self.status.recorded, self.status.recording) = (Some(rows), adding);
        // Shown with the next turn.
    }

    /// The pilot's place among the page's.
    pub fn pilot(&self) -> usize {
        self.status.pilot
    }

    /// How the drive is controlled since a page changed it; `None` if none has.
    pub fn settings(&self) -> Option<&ControlSettings> {
        self.settings.as_ref()
    }

    /// Shows a turn that is over: its answer is out. `by` is who drives.
    pub fn turn(&mut self, turn: &Turn, by: Hands, now: Instant) {
        self.turns += 1;
        let (since, before, hz) = &mut self.rate;
        let passed = now.saturating_duration_since(*since).as_secs_f64();
        if passed >= 1.0 {
            *hz = (self.turns - *before) as f64 / passed;
            (*since, *before) = (now, self.turns);
        }
        let hz = *hz;
        let facts = Facts::of(turn, self.turns, hz);
        self.drive.minute.keep(self.status.run, &facts, self.status.set_speed_mph);
        self.now.turn = Some(facts);
        if let Some(jpeg) = &turn.trace.jpeg {
            self.now.jpeg = Some(jpeg.clone());
        }
        self.now.counts.turn(turn);
        for event in &turn.trace.events {
            self.happens(turn.at(), event);
        }
        if let Some(track) = turn.telemetry().and_then(|telemetry| telemetry.truth.track.as_ref())
            && self.status.track.as_ref() != Some(track)
        {
            self.status.track = Some(track.clone());
        }
        self.status.hands = hands(by);
        self.publish();
    }

    /// Shows an event between turns.
    pub fn event(&mut self, at: Duration, event: &EventRecord) {
        self.now.counts.event(event);
        if let EventRecord::Course { track, scenario, .. } = event {
            self.on_course(track, scenario.as_deref());
        }
        self.happens(at, event);
    }

    /// Shows the score once a second while pages look, and whenever it is asked for: a copy takes a tenth of a millisecond.
    pub fn score(&mut self, scorer: &Scorer, now: Instant) {
        let is_due = now.saturating_duration_since(self.scored) >= SCORE || self.now.scorer.is_none();
        let looked_at = self.drive.newest.receiver_count() > 0;
        if (is_due && looked_at) || self.drive.wants_score.swap(false, Ordering::AcqRel) {
            self.scored = now;
            self.now.scorer = Some(Arc::new(scorer.clone()));
        }
    }

    /// Asks once a second how the file of the run is doing; shown with the next turn.
    pub fn is_written(&mut self, now: Instant, file: impl FnOnce() -> Option<RunFileStatus>) {
        if self.filed.is_none_or(|filed| now.saturating_duration_since(filed) >= FILE) {
            self.filed = Some(now);
            self.status.file = file();
            self.has_lost(self.status.file.as_ref().map_or(0, |file| file.not_recorded));
        }
    }

    /// The file of the run lacks so many frames and other items in all.
    pub fn has_lost(&mut self, items: u64) {
        self.now.counts.not_recorded = self.lost_before + items;
    }

    /// Keeps the score of a run that is over.
    pub fn keep_score(&mut self, scorer: &Scorer) {
        self.now.scorer = Some(Arc::new(scorer.clone()));
    }

    /// Changes the driver as the page asks; returns what changed, as events of the run. What is not the driver's to do
    /// waits for [`Showing::others`].
    pub fn direct(&mut self, driver: &mut Driver, now: Instant) -> Vec<EventRecord> {
        self.collect();
        let by_hand = self.by_hand.filter(|(_, at)| now.saturating_duration_since(*at) < LET_GO);
        driver.steer_by_hand(by_hand.map(|(command, _)| command));
        if self.wishes.is_empty() {
            return vec![];
        }
        let mut events = vec![];
        for wish in std::mem::take(&mut self.wishes) {
            events.extend(match wish {
                Wish::Control(Control::SetSpeed { mph }) => {
                    driver.set_speed(speed(mph)).then_some(EventRecord::SpeedSet { mph })
                }
                Wish::Control(Control::SpeedLaw { law }) => {
                    driver.set_speed_law(law).then(|| EventRecord::SpeedLawSet { law: law.name().to_owned() })
                }
                Wish::Control(Control::TakeOver) => {
                    driver.switch_off().then(|| EventRecord::PilotOff { why: "a person at the page took over".into() })
                }
                Wish::Control(Control::Arm) => driver.arm().then_some(EventRecord::PilotArmed),
                Wish::Control(Control::Stop) => driver.stop().then_some(EventRecord::EmergencyStop),
                Wish::Pilot(index, pilot) => {
                    driver.set_pilot(pilot);
                    self.status.pilot = index;
                    let choice = self.page.pilots().get(index);
                    choice.map(|choice| EventRecord::PilotSet {
                        name: choice.name.clone(),
                        sha256: choice.sha256.clone(),
                    })
                }
                Wish::Control(other) => {
                    self.wishes.push(Wish::Control(other));
                    None
                }
            });
        }
        self.has_settings(driver.settings());
        self.settings = Some(driver.settings().clone());
        events
    }

    /// What is asked for and is not the driver's to do: of the run, or of the world.
    pub fn others(&mut self) -> Vec<Control> {
        self.collect();
        let drivers = |control: &Control| {
            use Control as C;
            matches!(control, C::SetSpeed { .. } | C::SpeedLaw { .. } | C::TakeOver | C::Arm | C::Stop)
        };
        let mut others = vec![];
        for wish in std::mem::take(&mut self.wishes) {
            match wish {
                Wish::Control(control) if !drivers(&control) => others.push(control),
                kept => self.wishes.push(kept),
            }
        }
        others
    }

    /// Whether a person has the wheel at a page, as far as was last heard.
    pub fn is_by_hand(&self) -> bool {
        self.by_hand.is_some_and(|(_, at)| at.elapsed() < LET_GO)
    }

    /// Empties the box, if nobody holds it.
    fn collect(&mut self) {
        if !self.drive.asked.load(Ordering::Acquire) {
            return;
        }
        let mut inbox = match self.drive.inbox.try_lock() {
            Ok(inbox) => inbox,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return,
        };
        self.drive.asked.store(false, Ordering::Release);
        self.wishes.append(&mut inbox.wishes);
        self.by_hand = inbox.by_hand;
    }

    fn has_settings(&mut self, settings: &ControlSettings) {
        self.status.set_speed_mph = settings.speed_mph.get();
        self.status.speed_law = settings.speed_law;
    }

    fn happens(&mut self, at: Duration, event: &EventRecord) {
        let Some(words) = event.in_words() else { return };
        self.happened += 1;
        if self.events.len() >= EVENTS {
            self.events.remove(0);
        }
        let (n, run, t) = (self.happened, self.status.run, at.as_secs_f64());
        self.events.push(Happened { n, run, t, kind: event.kind(), words });
        self.now.events = self.events.clone().into();
    }

    /// Puts this moment where the last one was.
    fn publish(&mut self) {
        if *self.now.status != self.status {
            self.now.status = Arc::new(self.status.clone());
        }
        self.drive.newest.send_replace(Arc::new(self.now.clone()));
    }
}

impl Drop for Showing {
    fn drop(&mut self) {
        self.page.leaves(&self.drive, &self.now.counts);
    }
}
