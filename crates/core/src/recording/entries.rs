//! Moments: items joined into the steps of a drive.

use std::{collections::VecDeque, time::Duration};

use bytes::Bytes;

use super::{CommandRecord, EventRecord, Item, RecordingError, RunReader, Truncation};
use crate::protocol::{CameraImage, Telemetry};

/// A telemetry with its picture, and what it was answered.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Time since the run began.
    pub at: Duration,
    /// The simulator's message. The picture is empty if [`frame_recorded`](Self::frame_recorded) is false.
    pub telemetry: Telemetry,
    /// Whether the picture is in the run.
    pub frame_recorded: bool,
    /// The answer, where one was recorded.
    pub command: Option<CommandRecord>,
}

/// What a run reports, one after the other.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "nearly every entry is a step")]
pub enum Entry {
    /// A telemetry and its answer.
    Step(Step),
    /// Something else happened.
    Event {
        /// Time since the run began.
        at: Duration,
        /// What happened.
        event: EventRecord,
    },
}

/// How many events wait for the answer to the telemetry before them. A person who drives gets no answers for a long
/// time, and memory must stay bounded.
const WAITING: usize = 64;

/// Joins a run's items: a telemetry, the frame with the same time, and the
/// first command before the next telemetry make a [`Step`]. Events stay where
/// they are between the steps. Where damaged chunks are left out, an
/// [`EventRecord::Break`] says for how long.
#[derive(Debug)]
pub struct Entries {
    run: RunReader,
    /// Damaged chunks before the last item, and when that was.
    left_out: usize,
    last: Duration,
    /// The step that may yet get its frame or command, then events after it.
    open: Option<Step>,
    /// A frame that came before its telemetry: tools that sort may swap items of equal times.
    early: Option<(Duration, Bytes)>,
    events: VecDeque<Entry>,
    ready: VecDeque<Entry>,
    without_frame: u64,
    unanswered: u64,
}

impl Entries {
    pub(super) fn new(run: RunReader) -> Self {
        let (events, ready) = Default::default();
        Self {
            run,
            left_out: 0,
            last: Duration::ZERO,
            open: None,
            early: None,
            events,
            ready,
            without_frame: 0,
            unanswered: 0,
        }
    }

    /// The run that is read.
    pub fn run(&self) -> &RunReader {
        &self.run
    }

    /// The same, for a caller that takes its items unjoined.
    pub(super) fn run_mut(&mut self) -> &mut RunReader {
        &mut self.run
    }

    /// How the file ended, once the iterator has ended: `None` if in good order.
    pub fn truncated(&self) -> Option<&Truncation> {
        self.run.truncated()
    }

    /// Steps so far whose picture was not recorded.
    pub fn without_frame(&self) -> u64 {
        self.without_frame
    }

    /// Steps so far without a recorded answer: a person drove, or the file ends there.
    pub fn unanswered(&self) -> u64 {
        self.unanswered
    }

    fn take(&mut self, at: Duration, item: Item) {
        if std::mem::replace(&mut self.left_out, self.run.left_out()) != self.run.left_out() {
            self.close(); // what it was answered may be lost
            let seconds = at.as_secs_f64() - self.last.as_secs_f64();
            self.ready.push_back(Entry::Event { at, event: EventRecord::Break { seconds: Some(seconds) } });
        }
        self.last = at;
        match item {
            Item::Telemetry(telemetry) => {
                self.close();
                let mut step = Step { at, telemetry, frame_recorded: false, command: None };
                if let Some((_, jpeg)) = self.early.take().filter(|(early, _)| *early == at) {
                    step.show(jpeg);
                }
                self.open = Some(step);
            }
            Item::Frame(jpeg) => match &mut self.open {
                Some(step) if step.at == at && !step.frame_recorded => step.show(jpeg),
                _ => self.early = Some((at, jpeg)),
            },
            Item::Command(command) => {
                if let Some(step) = &mut self.open {
                    step.command.get_or_insert(command);
                }
            }
            Item::Event(event) => {
                self.events.push_back(Entry::Event { at, event });
                let answered = self.open.as_ref().is_none_or(|step| step.command.is_some());
                if answered || self.events.len() >= WAITING {
                    self.close();
                }
            }
        }
    }

    /// Nothing more belongs to the open step.
    fn close(&mut self) {
        if let Some(step) = self.open.take() {
            self.without_frame += u64::from(!step.frame_recorded);
            self.unanswered += u64::from(step.command.is_none());
            self.ready.push_back(Entry::Step(step));
        }
        self.ready.append(&mut self.events);
    }
}

impl Step {
    fn show(&mut self, jpeg: Bytes) {
        self.telemetry.image = CameraImage::Jpeg(jpeg);
        self.frame_recorded = true;
    }
}

impl Iterator for Entries {
    type Item = Result<Entry, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(moment) = self.ready.pop_front() {
                return Some(Ok(moment));
            }
            match self.run.next() {
                Some(Ok((at, item))) => self.take(at, item),
                Some(Err(error)) => return Some(Err(error)),
                None => {
                    self.close();
                    return self.ready.pop_front().map(Ok);
                }
            }
        }
    }
}
