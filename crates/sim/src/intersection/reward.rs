//! Rewards: the benchmark's, and one that does not pay for standing still.
//!
//! `smarts` is `get_reward_adapter("single_frame")` of SMARTS' `benchmark/agents/common.py`, without its term for speeds
//! above 60 m/s, which no car here reaches. It pays 0.5 for each step alive. An agent that stands still for 1000 steps
//! earns 999 x 0.5 - 0.5 = 499, one that drives to its goal about 63. SMARTS' adapter for stacked frames takes 0.01 for
//! each metre to the goal in each step besides, which outweighs that wage; a paper's figures depend on which was used.

use serde::{Deserialize, Serialize};

use super::observation::{FRAME, HEADINGS, KMH, OTHERS};

/// A crash, or leaving the road.
const FAILURE: f32 = -50.0;
/// Reaching the goal.
const GOAL: f32 = 20.0;
/// For each metre nearer to the goal, and the same of `corrected`: enough to be felt where a car stands and nobody is in
/// its way. With 0.1 and -0.02 a step PPO learnt to stand still, as the way to the goal costs many crashes at first.
const NEARER: (f32, f32) = (0.1, 0.3);
/// `corrected`: for each step. An agent that idles to the end loses 30, less than by a crash.
const STEP: f32 = -0.03;

/// What is rewarded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reward {
    /// As the benchmark does.
    #[default]
    Smarts,
    /// The goal, the way there, crashes, and time.
    Corrected,
}

/// What a step led to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Event {
    /// Nothing special.
    None,
    /// The goal.
    Goal,
    /// A crash, or off the road.
    Failure,
    /// It was the last one.
    TimeUp,
}

impl Reward {
    /// The reward of a step between two frames in which so many metres were driven.
    pub(super) fn of(self, before: &[f32; FRAME], now: &[f32; FRAME], driven: f32, event: Event) -> f32 {
        let nearer = to_goal(before) - to_goal(now);
        let end = match event {
            Event::Goal => GOAL,
            Event::Failure => FAILURE,
            Event::None | Event::TimeUp => 0.0,
        };
        match self {
            Self::Corrected => NEARER.1 * nearer + end + STEP,
            Self::Smarts => {
                let alive = if event == Event::TimeUp { -0.5 } else { 0.5 };
                let closer = |number: usize| mean(now, number) - mean(before, number);
                let others = (now[3] / KMH).tanh() * (0.03 * closer(0) + 0.01 * closer(2));
                let centre = 0.01 * (before[2].abs() - now[2].abs());
                let error = |i: usize| -0.03 * now[i] - 0.01 * (now[i] - before[i]);
                let heading = (error(HEADINGS.start) + error(HEADINGS.start + 1)) / 2.0;
                NEARER.0 * nearer + end + alive + others + centre + heading + 0.05 * driven
            }
        }
    }
}

fn to_goal(frame: &[f32; FRAME]) -> f32 {
    (frame[0] * frame[0] + frame[1] * frame[1]).sqrt()
}

/// Mean of a number over the eight sectors.
fn mean(frame: &[f32; FRAME], number: usize) -> f32 {
    frame[OTHERS..].chunks_exact(5).map(|other| other[number]).sum::<f32>() / 8.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_term_of_the_benchmarks_reward_is_as_large_as_there() {
        let still = [0.0; FRAME];
        let with = |changes: &[(usize, f32)]| {
            let mut frame = still;
            changes.iter().for_each(|(i, value)| frame[*i] = *value);
            frame
        };
        for (name, before, now, driven, event, expected) in [
            ("standing", still, still, 0.0, Event::None, 0.5),
            ("the last step", still, still, 0.0, Event::TimeUp, -0.5),
            ("a crash", still, still, 0.0, Event::Failure, -49.5),
            ("the goal", still, still, 0.0, Event::Goal, 20.5),
            ("ten metres nearer", with(&[(0, 30.0)]), with(&[(0, 20.0)]), 10.0, Event::None, 0.5 + 1.0 + 0.5),
            ("a metre nearer to the middle", with(&[(2, -1.5)]), with(&[(2, 0.5)]), 0.0, Event::None, 0.51),
            ("an error of heading", still, with(&[(5, 0.2), (6, 0.4)]), 0.0, Event::None, 0.5 - 0.012),
            // At 10 m/s another car comes into sight at 40 m and 4 s.
            (
                "another car",
                with(&[(3, 36.0)]),
                with(&[(3, 36.0), (25, 40.0), (27, 4.0)]),
                0.0,
                Event::None,
                0.5 + 0.15 + 0.005,
            ),
        ] {
            let got = Reward::Smarts.of(&before, &now, driven, event);
            assert!((got - expected).abs() < 1e-5, "{name}: {got}, expected {expected}");
        }
    }
}
