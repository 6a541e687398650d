//! Liveness of a simulator: when to kick it, and when its connection counts as dead.
//!
//! A game of tokens (see `tokens`): each answer lets one telemetry through, so silence after an answer means that the
//! simulator missed the start, is paused, or has left the scene with the socket open. A kick is an answer that nobody
//! asked for: it starts a loop that has not begun or has lost its token.
//!
//! Pings tell a pause from a scene that was left: the client's thread keeps pinging while the game is paused, and ends
//! with the scene. So a connection that pings is kept, whoever else connects from its address: one that is kept too
//! long costs an open file; one that is dropped in error costs a drive.

use std::time::{Duration, Instant};

/// The longest wait between two kicks, as a multiple of the wait for the first.
const LONGEST_WAIT: u32 = 8;

/// With neither a ping nor a telemetry for this long, nobody is there.
const GHOST: Duration = Duration::from_secs(60);

/// The same if a newer connection from the same address plays the same simulator: a ping, due about 25 s after each
/// pong, has not come.
const PING_MISSED: Duration = Duration::from_secs(30);

/// What is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Due {
    /// Send a command that nobody asked for.
    Kick,
    /// Drop the connection: nothing came for 60 s.
    Ghost,
    /// Drop the connection: nothing came for 30 s, and a newer one plays.
    Superseded,
}

/// The times that decide what is due.
#[derive(Debug)]
pub(super) struct Liveness {
    /// Silence after which a simulator is kicked.
    silence: Duration,
    /// When the last telemetry was answered, or the connect.
    active: Instant,
    /// Last ping or telemetry, or the connect.
    alive: Instant,
    /// Whether the last telemetry said that a human drives.
    human: bool,
    timer_driven: bool,
    /// Kicks since the last telemetry.
    kicks: u32,
    kicked: Instant,
    newer: Option<Instant>,
}

impl Liveness {
    pub fn new(now: Instant, silence: Duration) -> Self {
        Self { silence, active: now, alive: now, human: false, timer_driven: false, kicks: 0, kicked: now, newer: None }
    }

    /// A ping came.
    pub fn ping(&mut self, now: Instant) {
        self.alive = now;
    }

    /// A telemetry was answered.
    pub fn telemetry(&mut self, now: Instant, human: bool, timer_driven: bool) {
        (self.active, self.alive, self.human, self.timer_driven, self.kicks) = (now, now, human, timer_driven, 0);
    }

    /// A kick was sent.
    pub fn kicked(&mut self, now: Instant) {
        self.kicks += 1;
        self.kicked = now;
    }

    /// A newer connection from the same address plays the same simulator.
    pub fn newer(&mut self, now: Instant) {
        self.newer = Some(now);
    }

    /// Whether kicks were sent and no telemetry has come since: the simulator may not have read them.
    pub fn has_kicks_open(&self) -> bool {
        self.kicks > 0
    }

    /// What is due next, and when.
    pub fn next(&self) -> (Instant, Due) {
        let ghost = (self.alive + GHOST, Due::Ghost);
        // A newer connection says nothing about one that has played since.
        let newer = self.newer.filter(|newer| *newer > self.active);
        let superseded = newer.map(|newer| (newer.max(self.alive + PING_MISSED), Due::Superseded));
        let wait = self.silence * 2u32.saturating_pow(self.kicks).min(LONGEST_WAIT);
        let kick = (!self.human && !self.timer_driven).then_some((self.active.max(self.kicked) + wait, Due::Kick));
        [superseded, kick].into_iter().flatten().fold(ghost, |a, b| if b.0 < a.0 { b } else { a })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn s(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    #[test]
    fn a_simulator_that_says_nothing_is_kicked_ever_more_seldom() {
        let start = Instant::now();
        let mut liveness = Liveness::new(start, s(1));
        let mut kicks = vec![];
        for _ in 0..5 {
            let (when, due) = liveness.next();
            assert_eq!(due, Due::Kick);
            kicks.push((when - start).as_secs());
            liveness.kicked(when);
        }
        assert_eq!(kicks, [1, 3, 7, 15, 23]);
        assert!(liveness.has_kicks_open());
        liveness.telemetry(start + s(24), false, false);
        assert_eq!((liveness.next(), liveness.has_kicks_open()), ((start + s(25), Due::Kick), false));
    }

    #[test]
    fn nobody_is_kicked_while_a_human_drives_or_a_timer_sends() {
        let start = Instant::now();
        let mut liveness = Liveness::new(start, s(1));
        liveness.telemetry(start, true, false);
        assert_eq!(liveness.next(), (start + s(60), Due::Ghost));
        liveness.telemetry(start, false, true);
        assert_eq!(liveness.next(), (start + s(60), Due::Ghost));
    }

    #[test]
    fn a_ghost_that_pings_is_kept_and_one_that_does_not_is_dropped_after_60_s() {
        let start = Instant::now();
        let mut liveness = Liveness::new(start, s(1));
        liveness.telemetry(start, true, false);
        liveness.ping(start + s(50));
        assert_eq!(liveness.next(), (start + s(110), Due::Ghost));
    }

    /// What is due for a connection whose last telemetry came at 10 s (a human's, so that there are no kicks), after
    /// these pings, where a newer one began to play at `newer`.
    fn end(pings: &[u64], newer: u64) -> (u64, Due) {
        let start = Instant::now();
        let mut liveness = Liveness::new(start, s(1));
        liveness.telemetry(start + s(10), true, false);
        liveness.newer(start + s(newer));
        pings.iter().for_each(|ping| liveness.ping(start + s(*ping)));
        let (when, due) = liveness.next();
        ((when - start).as_secs(), due)
    }

    #[test]
    fn a_newer_connection_drops_one_whose_pings_stay_away_and_spares_one_that_is_paused() {
        assert_eq!(end(&[], 12), (40, Due::Superseded), "the scene was left");
        assert_eq!(end(&[], 55), (55, Due::Superseded));
        assert_eq!(end(&[25, 50, 75, 100], 12), (130, Due::Superseded), "paused, and pings");
        assert_eq!(end(&[], 9), (70, Due::Ghost), "it has played since");
    }
}
