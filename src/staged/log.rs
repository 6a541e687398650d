//! Training data of what a person drives at the page: the stock simulator's training mode.

use std::time::Duration;

use lapwing_core::{
    recording::{
        RecordingError,
        udacity::{DrivingLogWriter, NewRow},
    },
    turn::{By, Turn},
    units::{MPS_PER_MPH, Mph},
};
use lapwing_sim::{record::Shots, world::Simulation};

/// Why a row could not be written.
pub type HandLogError = RecordingError;

/// A driving log of the moments in which a person has the wheel.
pub struct HandLog {
    log: DrivingLogWriter,
    on: bool,
    /// Whether the moment before was written, too.
    goes_on: bool,
    /// Time of the worlds before this one, and the last turn's in this one.
    before: Duration,
    at: Duration,
    shots: Shots,
}

impl HandLog {
    /// A log that adds what is driven from now on.
    pub fn new(log: DrivingLogWriter) -> Self {
        Self { log, on: true, goes_on: false, before: Duration::ZERO, at: Duration::ZERO, shots: Shots::default() }
    }

    /// Whether it adds what is driven.
    pub fn adds(&self) -> bool {
        self.on
    }

    /// Switches it.
    pub fn is_on(&mut self, on: bool) {
        self.on = on;
    }

    /// Rows so far.
    pub fn rows(&self) -> u64 {
        self.log.rows()
    }

    /// What comes next does not continue from what was written.
    pub fn cut(&mut self) {
        self.goes_on = false;
    }

    /// Ends the log; returns its rows.
    ///
    /// # Errors
    /// [`HandLogError`].
    pub fn finish(self) -> Result<u64, HandLogError> {
        self.log.finish()
    }

    /// Writes a turn, if a person drives it: the pictures of three cameras, and what they hold the wheel and the pedals
    /// at.
    pub(super) fn turn(&mut self, world: &Simulation, turn: &Turn) -> Result<(), HandLogError> {
        // Each world begins at 0.
        let before = std::mem::replace(&mut self.at, turn.at());
        self.before += if turn.at() < before { before } else { Duration::ZERO };
        let by_hand = turn.command().filter(|command| command.by == By::Human && self.on);
        let (Some(command), Some(telemetry)) = (by_hand, turn.telemetry()) else {
            self.goes_on = false;
            return Ok(());
        };
        if !std::mem::replace(&mut self.goes_on, true) {
            self.log.cut();
        }
        let (center, [left, right]) = (self.shots.center(world, telemetry), self.shots.sides(world));
        let throttle = command.throttle.get();
        self.log.row(&NewRow {
            at: self.before + self.at,
            center: &center,
            left: Some(&left),
            right: Some(&right),
            steering: command.steering,
            throttle: command.throttle,
            brake: (-throttle).max(0.0),
            speed: Mph::saturating(world.car().speed.abs() / MPS_PER_MPH),
        })
    }
}
