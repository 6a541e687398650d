//! Whether a simulator still plays: when to kick it, when to take it for a ghost.
//!
//! A game of tokens: each answer lets one telemetry through, so silence after an
//! answer means that the simulator missed its start, is paused, or has left the
//! scene with the socket open. A kick is an answer that nobody asked for: it
//! starts a loop that has not started or has lost its token. Where the loop was
//! only paused a kick becomes a token too many; as many telemetries as there
//! were kicks may then be swallowed, see [`Liveness::surplus`].

use std::time::{Duration, Instant};

/// The longest wait between two kicks, in waits for the first.
const LONGEST_WAIT: u32 = 8;

/// With neither a ping nor a telemetry for so long nobody is there.
const GHOST: Duration = Duration::from_secs(60);

/// What is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Due {
    /// Send a command that nobody asked for.
    Kick,
    /// Drop the connection: nothing came for 60 s.
    Ghost,
    /// Drop the connection: the simulator has dialled anew.
    Superseded,
}

/// The times that decide.
#[derive(Debug)]
pub(super) struct Liveness {
    /// Silence after which a simulator is kicked, or a superseded one dropped.
    silence: Duration,
    /// When the last telemetry was answered, or the connect.
    active: Instant,
    /// Last ping or telemetry, or the connect.
    alive: Instant,
    /// The last telemetry said that a human drives.
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

    /// A newer connection of the same machine came.
    pub fn newer(&mut self, now: Instant) {
        self.newer = Some(now);
    }

    /// How many telemetries may be in flight beyond the one that belongs there.
    pub fn surplus(&self) -> u32 {
        self.kicks
    }

    /// What is due next, and when.
    pub fn next(&self) -> (Instant, Due) {
        let ghost = (self.alive + GHOST, Due::Ghost);
        // A newer connection counts only if it came while this one was silent.
        let superseded =
            self.newer.filter(|n| *n > self.active).map(|n| (n.max(self.active + self.silence), Due::Superseded));
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
        assert_eq!(liveness.surplus(), 5);
        liveness.telemetry(start + s(24), false, false);
        assert_eq!((liveness.next(), liveness.surplus()), ((start + s(25), Due::Kick), 0));
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

    #[test]
    fn a_newer_connection_drops_one_that_is_silent_and_spares_one_that_plays() {
        let start = Instant::now();
        let mut liveness = Liveness::new(start, s(1));
        liveness.telemetry(start + s(10), false, false);
        liveness.newer(start + s(10) + Duration::from_millis(20));
        assert_eq!(liveness.next(), (start + s(11), Due::Superseded));
        liveness.telemetry(start + s(10) + Duration::from_millis(60), false, false);
        assert_eq!(liveness.next().1, Due::Kick);
        liveness.newer(start + s(30));
        assert_eq!(liveness.next(), (start + s(11) + Duration::from_millis(60), Due::Kick), "the kick was due before");
        liveness.kicked(start + s(12));
        liveness.kicked(start + s(14));
        liveness.kicked(start + s(18));
        liveness.kicked(start + s(26));
        assert_eq!(liveness.next(), (start + s(30), Due::Superseded));
    }
}
