//! Who drives: the pilot, the human, or, after a human in `latch` mode, nobody
//! until the pilot is armed again (Krasheninnikov, Algorithm 4).

use std::time::Duration;

/// What changed hands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HandoverChange {
    /// The human took over.
    TakeoverBegan,
    /// The human let go after this long.
    TakeoverEnded(Duration),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Hands {
    Pilot,
    Human { since: Duration },
    Off,
}

/// The hand-over between human and pilot.
#[derive(Debug, Clone)]
pub struct Handover {
    latch: bool,
    hands: Hands,
}

impl Handover {
    /// The pilot drives. With `latch` it stays off after a human until [`Handover::arm`].
    pub fn new(latch: bool) -> Self {
        Self { latch, hands: Hands::Pilot }
    }

    /// The simulator says that a human drives.
    pub fn human_drives(&mut self, at: Duration) -> Option<HandoverChange> {
        if let Hands::Human { .. } = self.hands {
            return None;
        }
        self.hands = Hands::Human { since: at };
        Some(HandoverChange::TakeoverBegan)
    }

    /// The simulator asks for a command, so no human drives.
    pub fn command_asked(&mut self, at: Duration) -> Option<HandoverChange> {
        let Hands::Human { since } = self.hands else { return None };
        self.hands = if self.latch { Hands::Off } else { Hands::Pilot };
        Some(HandoverChange::TakeoverEnded(at.saturating_sub(since)))
    }

    /// Switches the pilot off until it is armed; returns whether it drove. A human who drives keeps the wheel.
    pub fn switch_off(&mut self) -> bool {
        let drove = self.hands == Hands::Pilot;
        if drove {
            self.hands = Hands::Off;
        }
        drove
    }

    /// Lets the pilot drive again; returns whether it was off.
    pub fn arm(&mut self) -> bool {
        let was_off = self.hands == Hands::Off;
        if was_off {
            self.hands = Hands::Pilot;
        }
        was_off
    }

    /// The pilot drives, as at the start: another run begins.
    pub fn reset(&mut self) {
        self.hands = Hands::Pilot;
    }

    /// Whether a human's takeover has switched the pilot off until it is armed.
    pub fn is_off(&self) -> bool {
        self.hands == Hands::Off
    }

    /// Whether a human drives, as far as last reported.
    pub fn is_human(&self) -> bool {
        matches!(self.hands, Hands::Human { .. })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn s(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    #[test]
    fn a_takeover_is_one_change_at_each_end_with_its_duration() {
        let mut handover = Handover::new(false);
        assert_eq!(handover.command_asked(s(1)), None);
        assert_eq!(handover.human_drives(s(2)), Some(HandoverChange::TakeoverBegan));
        assert_eq!(handover.human_drives(s(3)), None);
        assert!(handover.is_human());
        assert_eq!(handover.command_asked(s(7)), Some(HandoverChange::TakeoverEnded(s(5))));
        assert!(!handover.is_off() && !handover.is_human());
    }

    #[test]
    fn latched_the_pilot_stays_off_until_armed() {
        let mut handover = Handover::new(true);
        assert!(!handover.arm());
        handover.human_drives(s(1));
        assert!(!handover.arm(), "the human still drives");
        handover.command_asked(s(2));
        assert!(handover.is_off());
        assert!(handover.arm());
        assert!(!handover.is_off());
    }

    #[test]
    fn a_pilot_is_switched_off_only_while_it_drives() {
        let mut handover = Handover::new(false);
        assert!(handover.switch_off() && handover.is_off());
        assert!(!handover.switch_off(), "it is off already");
        assert!(handover.arm());
        handover.human_drives(s(1));
        assert!(!handover.switch_off() && handover.is_human(), "the human has the wheel");
    }
}
