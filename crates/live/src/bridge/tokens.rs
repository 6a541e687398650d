//! Surplus tokens, and how they are removed.
//!
//! If each answer lets one telemetry through, a simulator owes one telemetry at a time. A second one before the first
//! is answered proves that there is a surplus token, whatever caused it: kicks of a paused game, kicks that a simulator
//! reads only after it has lost that connection and redialled, or another bridge before this one. Then the earlier
//! telemetry goes unanswered, which removes its token; the latest one is always answered, so that the last token stays.
//!
//! An answer that goes out at once leaves no time for a second telemetry. So it is held back for a moment if in doubt:
//! after kicks, and if a telemetry equals the one before it, as all tokens of one game frame show the same picture.

use std::{
    hash::{DefaultHasher, Hasher},
    time::{Duration, Instant},
};

/// How long an answer is held back after a kick, and after a surplus token: some game frames.
const SETTLE: Duration = Duration::from_millis(250);

/// The same telemetry again within this time is of the same game frame, or of a stationary car. Its answer is held back
/// for as long, so that the frame can end.
const FRAME: Duration = Duration::from_millis(50);

/// How soon another such telemetry is doubted after one that was not surplus; twice as long after each …
const DOUBT_AGAIN: Duration = Duration::from_secs(10);
/// … up to this.
const DOUBT_SELDOM: Duration = Duration::from_secs(600);

/// This many surplus telemetries in a row, kicks aside, are not tokens: they are sent without waiting for answers.
const MOST: u32 = 64;

/// The parts of a telemetry that are compared, in bytes from its beginning (the numbers) and its end (the picture's).
const COMPARED: (usize, usize) = (256, 1024);

/// The tokens of one connection.
pub(super) struct Tokens {
    /// Whether there may be a surplus one.
    doubt: bool,
    /// The last telemetry, as a hash, and when it came.
    last: Option<(u64, Instant)>,
    /// From when on a telemetry equal to the last one is doubted.
    look_at: Instant,
    look_after: Duration,
    /// Telemetries left unanswered since the last one that was answered.
    taken_out: u32,
    kicks: u32,
    unasked: bool,
}

impl Tokens {
    pub fn new(now: Instant) -> Self {
        Self { doubt: false, last: None, look_at: now, look_after: DOUBT_AGAIN, taken_out: 0, kicks: 0, unasked: false }
    }

    /// A kick was sent, or an earlier connection's may not have been read.
    pub fn kicked(&mut self) {
        self.kicks += 1;
        self.doubt = true;
    }

    /// Whether telemetry comes without waiting for answers, so that it says nothing about tokens.
    pub fn are_unasked(&self) -> bool {
        self.unasked
    }

    /// A telemetry came: returns how long its answer waits in case another one comes. `picture` says whether it has a
    /// picture: a human's have none, and are all the same.
    pub fn telemetry(&mut self, now: Instant, message: &[u8], picture: bool) -> Duration {
        let mut hasher = DefaultHasher::new();
        hasher.write_usize(message.len());
        hasher.write(&message[..message.len().min(COMPARED.0)]);
        hasher.write(&message[message.len().saturating_sub(COMPARED.1)..]);
        let hash = hasher.finish();
        let last = self.last.replace((hash, now));
        let again = last.is_some_and(|(last, at)| last == hash && now.saturating_duration_since(at) <= FRAME);
        match () {
            () if self.unasked => Duration::ZERO,
            () if self.doubt => SETTLE,
            () if again && picture && now >= self.look_at => {
                self.look_at = now + self.look_after;
                self.look_after = (self.look_after * 2).min(DOUBT_SELDOM);
                FRAME
            }
            () => Duration::ZERO,
        }
    }

    /// Another telemetry came before the last one's answer went out.
    pub fn one_too_many(&mut self) {
        self.doubt = true;
        self.look_after = DOUBT_AGAIN;
        self.taken_out += 1;
        self.unasked = self.taken_out > MOST.saturating_add(self.kicks);
    }

    /// An answer goes out, as nothing came before it. Returns how many tokens were removed before.
    pub fn settled(&mut self) -> u32 {
        self.doubt = false;
        std::mem::take(&mut self.taken_out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn an_answer_goes_out_at_once_unless_there_is_doubt() {
        let start = Instant::now();
        let mut tokens = Tokens::new(start);
        assert_eq!(tokens.telemetry(start, b"a", true), Duration::ZERO);
        assert_eq!(tokens.telemetry(start + MS, b"b", true), Duration::ZERO, "another frame");
        assert_eq!(tokens.telemetry(start + 60 * MS, b"b", true), Duration::ZERO, "long after: a car that stands");
        tokens.kicked();
        assert_eq!(tokens.telemetry(start + 70 * MS, b"c", true), SETTLE);
        assert_eq!(tokens.settled(), 0);
        assert_eq!(tokens.telemetry(start + 71 * MS, b"d", true), Duration::ZERO);
    }

    #[test]
    fn the_same_frame_again_is_doubted_and_a_car_that_stands_ever_more_seldom() {
        let start = Instant::now();
        let mut tokens = Tokens::new(start);
        let doubted: Vec<u32> = (0..100_000)
            .filter(|i| {
                let wait = tokens.telemetry(start + 16 * i * MS, b"a", true);
                tokens.settled();
                !wait.is_zero()
            })
            .collect();
        assert_eq!(doubted.iter().map(|i| i * 16 / 1000).collect::<Vec<_>>(), [0, 10, 30, 70, 150, 310, 630, 1230]);
        assert_eq!(tokens.telemetry(start, b"null", false), Duration::ZERO);
        assert_eq!(tokens.telemetry(start, b"null", false), Duration::ZERO, "a human's are all the same");
    }

    #[test]
    fn tokens_too_many_are_counted_and_a_stream_without_end_is_none() {
        let start = Instant::now();
        let mut tokens = Tokens::new(start);
        for _ in 0..8 {
            tokens.one_too_many();
            assert_eq!(tokens.telemetry(start, b"a", true), SETTLE);
        }
        assert_eq!((tokens.settled(), tokens.are_unasked()), (8, false));
        (0..=MOST).for_each(|_| tokens.one_too_many());
        assert!(tokens.are_unasked());
        assert_eq!(tokens.telemetry(start, b"a", true), Duration::ZERO);
    }
}
