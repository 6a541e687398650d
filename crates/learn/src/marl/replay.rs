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

/// A batch of joint transitions. Only agents that drove are in it, those of a transition in a row: few transitions have all.
///
/// What nobody of the others is there for is a row of zeros: the last of `seen`, `actions` and `next`.
#[derive(Debug, Default)]
pub struct Drawing {
    /// (B): which rows of the memory, to tell their errors.
    pub rows: Vec<usize>,
    /// (N): for each agent which of the batch's transitions it is of.
    pub of: Vec<usize>,
    /// (N + 1, numbers): what was seen.
    pub seen: Vec<f32>,
    /// (N + 1, ACTIONS): what was done.
    pub actions: Vec<f32>,
    /// For each other agent in turn (N): its row.
    pub others: [Vec<i64>; AGENTS - 1],
    /// (N)
    pub rewards: Vec<f32>,
    /// (N): importance weights, those of the transitions.
    pub weights: Vec<f32>,
    /// (M + 1, numbers): what is seen then by the agents for which the future counts: those that have not ended for good.
    pub next: Vec<f32>,
    /// For each other agent in turn (M): its row in `next`.
    pub next_others: [Vec<i64>; AGENTS - 1],
    /// (N): the agent's row in `next`.
    pub then: Vec<i64>,
}

impl Drawing {
    fn clear(&mut self) {
        let Self { rows, of, seen, actions, others, rewards, weights, next, next_others, then } = self;
        rows.clear();
        of.clear();
        [seen, actions, rewards, weights, next].into_iter().for_each(Vec::clear);
        others.iter_mut().chain(next_others).for_each(Vec::clear);
        then.clear();
    }
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
        let weights = priorities::weights(&drawn, self.count(), beta);
        into.clear();
        // Rows by agent; of those that are not there none, for which there is a last row once all are known.
        let (mut places, mut next_places) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let (mut agents, mut futures) = (0, 0);
        for (b, (Drawn { row, .. }, weight)) in drawn.iter().zip(weights).enumerate() {
            let (mut place, mut next_place) = ([None; AGENTS], [None; AGENTS]);
            for agent in 0..AGENTS {
                let at = row * AGENTS + agent;
                if !self.drove[at] {
                    continue;
                }
                place[agent] = Some(agents);
                agents += 1;
                into.of.push(b);
                self.see(*row, agent, 1, &mut into.seen);
                into.actions.extend_from_slice(&self.actions[at * ACTIONS..][..ACTIONS]);
                into.rewards.push(self.rewards[at]);
                into.weights.push(weight);
                if !self.terminated[at] {
                    next_place[agent] = Some(futures);
                    futures += 1;
                    self.see(*row, agent, 0, &mut into.next);
                }
            }
            into.rows.push(*row);
            places.push(place);
            next_places.push(next_place);
        }
        let numbers = self.frame * self.stack;
        into.seen.resize(into.seen.len() + numbers, 0.0);
        into.actions.resize(into.actions.len() + ACTIONS, 0.0);
        into.next.resize(into.next.len() + numbers, 0.0);
        for (place, next_place) in places.iter().zip(&next_places) {
            beside(place, agents, &mut into.others);
            beside(next_place, futures, &mut into.next_others);
            let there = (0..AGENTS).filter(|agent| place[*agent].is_some());
            into.then.extend(there.map(|agent| next_place[agent].unwrap_or(futures)));
        }
        self.drawn = drawn;
    }

    /// Tells the errors of a batch.
    pub fn update(&mut self, rows: &[usize], errors: &[f32]) {
        rows.iter().zip(errors).for_each(|(row, error)| self.priorities.update(*row, *error));
    }

    /// Adds what an agent saw so many moments before a row's.
    fn see(&self, row: usize, agent: usize, before: usize, out: &mut Vec<f32>) {
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

/// For each agent of a transition that is there, adds the rows of those that come after it in turn; `none` is that of nobody.
fn beside(places: &[Option<i64>; AGENTS], none: i64, others: &mut [Vec<i64>; AGENTS - 1]) {
    for agent in (0..AGENTS).filter(|agent| places[*agent].is_some()) {
        for (k, rows) in others.iter_mut().enumerate() {
            rows.push(places[(agent + k + 1) % AGENTS].unwrap_or(none));
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
            let (all, futures) = (drawing.of.len(), drawing.next.len() / numbers - 1);
            assert_eq!((drawing.rows.len(), drawing.weights.len(), drawing.then.len()), (500, all, all));
            assert!((500..=2000).contains(&all) && (400..=all).contains(&futures), "{all}, {futures}");
            assert!(drawing.seen[all * numbers..].iter().chain(&drawing.next[futures * numbers..]).all(|n| *n == 0.0));
            let mut next = 0;
            for i in 0..all {
                let row = drawing.rows[drawing.of[i]];
                // Which agent it is shows in what it saw.
                let moment = drawing.actions[i * ACTIONS] as usize;
                assert!(moment > 150);
                let (seen, flags) = (&history[moment - 1].0, &history[moment].2);
                let is_it = |seat: &usize| drawing.seen[i * numbers..][..numbers] == seen[seat * numbers..][..numbers];
                let first = row % columns * AGENTS;
                let seat = (first..first + AGENTS).find(is_it).unwrap();
                assert!(flags[0][seat]);
                assert_eq!(drawing.rewards[i], history[moment].1[seat]);
                for (k, others) in drawing.others.iter().enumerate() {
                    let other = first + (seat - first + k + 1) % AGENTS;
                    let expected =
                        if flags[0][other] { &seen[other * numbers..][..numbers] } else { &vec![0.0; numbers] };
                    assert_eq!(&drawing.seen[others[i] as usize * numbers..][..numbers], expected);
                }
                let goes_on = |seat: usize| flags[0][seat] && !flags[1][seat];
                let of_next = |row: i64| &drawing.next[row as usize * numbers..][..numbers];
                let then = |seat: usize| match goes_on(seat) {
                    true => history[moment].0[seat * numbers..][..numbers].to_vec(),
                    false => vec![0.0; numbers],
                };
                assert_eq!(of_next(drawing.then[i]), then(seat));
                if goes_on(seat) {
                    assert_eq!(drawing.then[i], next as i64);
                    for (k, others) in drawing.next_others.iter().enumerate() {
                        assert_eq!(of_next(others[next]), then(first + (seat - first + k + 1) % AGENTS));
                    }
                    next += 1;
                }
            }
            assert_eq!(next, futures);
        }
    }
}
