//! A memory of joint transitions: what all four agents saw, did and earned at the same time.
//!
//! Frames are stored once and stacked when they are drawn. With the benchmark's observation a million joint transitions take
//! 1.1 GB; each with two stacks of three frames for each agent would take 6.3 GB.
//!
//! A row is a moment of one intersection. Its transition leads from the moment before to it, so the first moment of an
//! episode has none. Rows of all intersections are written together; the oldest are overwritten.

use rand_chacha::ChaCha8Rng;

use super::priorities::{self, Drawn, Priorities, Replay};
use lapwing_sim::intersection::{ACTIONS, AGENTS, FRAME, OBSERVATION, Sight};

/// Joint transitions.
#[derive(Debug)]
pub struct Memory {
    /// Numbers of a frame.
    frame: usize,
    /// Frames in an observation.
    stack: usize,
    /// Intersections.
    columns: usize,
    /// Moments for which there is room.
    moments: usize,
    /// The next moment to write; how many have been written.
    written: usize,
    priorities: Priorities,
    /// (moments, columns, AGENTS, frame)
    frames: Vec<f32>,
    /// (moments, columns, AGENTS, ACTIONS): what was done to come here, relaxed one-hot.
    actions: Vec<f32>,
    /// (moments, columns, AGENTS)
    rewards: Vec<f32>,
    drove: Vec<bool>,
    terminated: Vec<bool>,
    /// (moments, columns): steps since the episode's begin.
    ages: Vec<u32>,
    drawn: Vec<Drawn>,
}

/// What a step of all intersections gave, as in [`Buffers`](lapwing_sim::intersection::Buffers).
#[derive(Debug, Clone, Copy)]
pub struct Moment<'a> {
    /// What is seen after it.
    pub observations: &'a [f32],
    /// Relaxed one-hot actions.
    pub actions: &'a [f32],
    /// One each.
    pub rewards: &'a [f32],
    /// Who drove.
    pub drove: &'a [bool],
    /// Who ended for good.
    pub terminated: &'a [bool],
}

/// A batch of joint transitions, agents in turn. Who did not drive has zeros.
#[derive(Debug, Default)]
pub struct Drawing {
    /// Which rows, to tell their errors.
    pub rows: Vec<usize>,
    /// (B, AGENTS, numbers): what was seen.
    pub seen: Vec<f32>,
    /// (B, AGENTS, numbers): what is seen then.
    pub next: Vec<f32>,
    /// (B, AGENTS, ACTIONS)
    pub actions: Vec<f32>,
    /// (B, AGENTS)
    pub rewards: Vec<f32>,
    /// (B, AGENTS): 1 if it drove.
    pub drove: Vec<f32>,
    /// (B, AGENTS): 1 if the future counts: it drove and has not ended for good.
    pub goes_on: Vec<f32>,
    /// (B): importance weights.
    pub weights: Vec<f32>,
}

impl Memory {
    /// For so many joint transitions from intersections side by side.
    pub fn new(sight: Sight, columns: usize, rows: usize, replay: Replay, alpha: f32) -> Self {
        let (frame, stack) = match sight {
            Sight::Sectors => (FRAME, OBSERVATION / FRAME),
            Sight::Routes => (sight.numbers(), 1),
        };
        let moments = (rows / columns).max(stack + 2);
        let rows = moments * columns;
        let agents = rows * AGENTS;
        // Memory that is zeroed is given by the system when it is written to: a memory that is not full takes less.
        Self {
            frame,
            stack,
            columns,
            moments,
            written: 0,
            priorities: Priorities::new(replay, rows, alpha),
            frames: vec![0.0; agents * frame],
            actions: vec![0.0; agents * ACTIONS],
            rewards: vec![0.0; agents],
            drove: vec![false; agents],
            terminated: vec![false; agents],
            ages: vec![0; rows],
            drawn: Vec::new(),
        }
    }

    /// Transitions that can be drawn.
    pub fn count(&self) -> usize {
        self.priorities.count()
    }

    /// Remembers a moment. One in which nobody of an intersection drove is the first of an episode there.
    pub fn push(&mut self, moment: Moment<'_>) {
        let (at, before) = (self.written % self.moments, (self.written + self.moments - 1) % self.moments);
        let (agents, numbers) = (self.columns * AGENTS, self.frame * self.stack);
        let to = at * agents;
        for (i, seen) in moment.observations.chunks_exact(numbers).enumerate() {
            self.frames[(to + i) * self.frame..][..self.frame].copy_from_slice(&seen[numbers - self.frame..]);
        }
        self.actions[to * ACTIONS..(to + agents) * ACTIONS].copy_from_slice(moment.actions);
        self.rewards[to..to + agents].copy_from_slice(moment.rewards);
        self.drove[to..to + agents].copy_from_slice(moment.drove);
        self.terminated[to..to + agents].copy_from_slice(moment.terminated);
        for column in 0..self.columns {
            let row = at * self.columns + column;
            let is_first = self.written == 0 || !moment.drove[column * AGENTS..][..AGENTS].contains(&true);
            self.ages[row] = if is_first { 0 } else { self.ages[before * self.columns + column] + 1 };
            if is_first {
                self.priorities.remove(row);
            } else {
                self.priorities.add(row);
            }
            // The oldest ones lose frames that belong to what was seen before them.
            if self.written >= self.moments {
                (1..=self.stack).for_each(|k| self.priorities.remove((at + k) % self.moments * self.columns + column));
            }
        }
        self.written += 1;
    }

    /// Draws a batch.
    pub fn draw(&mut self, count: usize, beta: f64, random: &mut ChaCha8Rng, into: &mut Drawing) {
        let mut drawn = std::mem::take(&mut self.drawn);
        self.priorities.draw(count, random, &mut drawn);
        into.rows.clear();
        into.rows.extend(drawn.iter().map(|drawn| drawn.row));
        into.weights = priorities::weights(&drawn, self.count(), beta);
        for numbers in [&mut into.seen, &mut into.next, &mut into.actions, &mut into.rewards] {
            numbers.clear();
        }
        into.drove.clear();
        into.goes_on.clear();
        for Drawn { row, .. } in &drawn {
            for agent in 0..AGENTS {
                let at = row * AGENTS + agent;
                let (drove, goes_on) = (self.drove[at], self.drove[at] && !self.terminated[at]);
                self.see(*row, agent, 1, drove, &mut into.seen);
                self.see(*row, agent, 0, goes_on, &mut into.next);
                let weight = f32::from(u8::from(drove));
                into.actions.extend(self.actions[at * ACTIONS..][..ACTIONS].iter().map(|action| action * weight));
                into.rewards.push(self.rewards[at] * weight);
                into.drove.push(weight);
                into.goes_on.push(f32::from(u8::from(goes_on)));
            }
        }
        self.drawn = drawn;
    }

    /// Tells the errors of a batch.
    pub fn update(&mut self, rows: &[usize], errors: &[f32]) {
        rows.iter().zip(errors).for_each(|(row, error)| self.priorities.update(*row, *error));
    }

    /// Adds what an agent saw so many moments before a row's; zeros if it is not there.
    fn see(&self, row: usize, agent: usize, before: usize, is_there: bool, out: &mut Vec<f32>) {
        if !is_there {
            out.resize(out.len() + self.frame * self.stack, 0.0);
            return;
        }
        let (moment, column) = (row / self.columns, row % self.columns);
        for k in (0..self.stack).rev() {
            // The first frame of an episode fills the stack.
            let back = (before + k).min(self.ages[row] as usize);
            let moment = (moment + self.moments - back) % self.moments;
            let at = (moment * self.columns + column) * AGENTS + agent;
            out.extend_from_slice(&self.frames[at * self.frame..][..self.frame]);
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use lapwing_sim::intersection::{Batch, Buffers, Settings};

    #[test]
    fn stacks_that_are_drawn_are_those_that_were_seen_also_when_the_memory_is_full() {
        for sight in [Sight::Sectors, Sight::Routes] {
            let (columns, settings) = (2, Settings { sight, cars: 4, ..Settings::default() });
            let mut batch = Batch::new(settings, columns, 1);
            let (agents, numbers) = (batch.agents(), sight.numbers());
            let mut memory = Memory::new(sight, columns, 200, Replay::Uniform, 0.6);
            let mut observations = vec![0.0; agents * numbers];
            let (mut rewards, mut flags) = (vec![0.0; agents], [(); 3].map(|()| vec![false; agents]));
            batch.observe(&mut observations);
            let mut actions = vec![0.0; agents * ACTIONS];
            // All that was ever seen, by moment.
            let mut history = Vec::new();
            for step in 0..250 {
                let [drove, terminated, truncated] = &mut flags;
                if step > 0 {
                    let buffers = Buffers {
                        observations: &mut observations,
                        rewards: &mut rewards,
                        drove,
                        terminated,
                        truncated,
                    };
                    batch.step(&vec![0; agents], buffers);
                }
                // The moment is written into the actions, to find it again.
                actions.fill(step as f32);
                let (observations, actions) = (&observations[..], &actions[..]);
                memory.push(Moment { observations, actions, rewards: &rewards, drove, terminated });
                history.push((observations.to_vec(), rewards.clone(), flags.clone()));
            }
            let mut drawing = Drawing::default();
            memory.draw(500, 1.0, &mut ChaCha8Rng::seed_from_u64(1), &mut drawing);
            assert_eq!((drawing.rows.len(), drawing.weights.len()), (500, 500));
            for (b, row) in drawing.rows.iter().enumerate() {
                for agent in 0..AGENTS {
                    let at = b * AGENTS + agent;
                    if drawing.drove[at] == 0.0 {
                        continue;
                    }
                    let (moment, seat) = (drawing.actions[at * ACTIONS] as usize, row % columns * AGENTS + agent);
                    assert!(moment > 150 && history[moment].2[0][seat]);
                    let seen = &history[moment - 1].0[seat * numbers..][..numbers];
                    assert_eq!(&drawing.seen[at * numbers..][..numbers], seen);
                    assert_eq!(drawing.rewards[at], history[moment].1[seat]);
                    let goes_on = !history[moment].2[1][seat];
                    assert_eq!(drawing.goes_on[at], f32::from(u8::from(goes_on)));
                    if goes_on {
                        let next = &history[moment].0[seat * numbers..][..numbers];
                        assert_eq!(&drawing.next[at * numbers..][..numbers], next);
                    }
                }
            }
        }
    }
}
