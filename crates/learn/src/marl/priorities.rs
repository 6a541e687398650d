//! Which rows of a replay memory are drawn how often (Schaul et al. 2016, Prioritized Experience Replay).
//!
//! - [`Uniform`](Priorities::Uniform): all the same.
//! - [`Proportional`](Priorities::Proportional): by `(|error| + epsilon)^alpha`, in a sum tree (section 3.3, B.2.1).
//! - [`Rank`](Priorities::Rank): by `1 / rank^alpha`, where a binary heap stands for the sorted order, as in B.2.1; it is
//!   sorted now and then.
//!
//! Batches are stratified: one row is drawn from each of as many equal shares of the probability as rows are asked for.
//! A row may be drawn twice. A row that is new has the largest priority seen so far, so that it is drawn soon.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::trees::{Heap, SumTree};

/// What is added to an error, so that no row is lost for good.
const EPSILON: f32 = 1e-3;

/// How rows are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Replay {
    /// All as often.
    #[default]
    Uniform,
    /// In proportion to their errors.
    Proportional,
    /// By the rank of their errors.
    Rank,
}

/// The rows of a memory that may be drawn.
#[derive(Debug)]
pub enum Priorities {
    /// All as often.
    Uniform(Members),
    /// In proportion to their errors.
    Proportional {
        /// Of the priorities.
        tree: SumTree,
        /// How much errors matter.
        alpha: f32,
        /// The largest priority so far.
        largest: f32,
        /// Rows that may be drawn.
        count: usize,
    },
    /// By the rank of their errors.
    Rank {
        /// Of the errors.
        heap: Heap,
        /// How much ranks matter.
        alpha: f32,
        /// The largest error so far.
        largest: f32,
    },
}

/// A row that was drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drawn {
    /// Which.
    pub row: usize,
    /// How likely it was, of 1.
    pub probability: f64,
}

impl Priorities {
    /// For a memory of so many rows, none of which may be drawn yet.
    pub fn new(replay: Replay, rows: usize, alpha: f32) -> Self {
        match replay {
            Replay::Uniform => Self::Uniform(Members::new(rows)),
            Replay::Proportional => Self::Proportional { tree: SumTree::new(rows), alpha, largest: 1.0, count: 0 },
            Replay::Rank => Self::Rank { heap: Heap::new(rows), alpha, largest: 1.0 },
        }
    }

    /// How many rows may be drawn.
    pub fn count(&self) -> usize {
        match self {
            Self::Uniform(members) => members.rows.len(),
            Self::Proportional { count, .. } => *count,
            Self::Rank { heap, .. } => heap.rows.len(),
        }
    }

    /// Lets a row be drawn, with the largest priority.
    pub fn add(&mut self, row: usize) {
        match self {
            Self::Uniform(members) => members.add(row),
            Self::Proportional { tree, largest, count, .. } => {
                *count += usize::from(tree.get(row) == 0.0);
                tree.set(row, *largest);
            }
            Self::Rank { heap, largest, .. } => heap.set(row, *largest),
        }
    }

    /// Lets it be drawn no more.
    pub fn remove(&mut self, row: usize) {
        match self {
            Self::Uniform(members) => members.remove(row),
            Self::Proportional { tree, count, .. } => {
                *count -= usize::from(tree.get(row) > 0.0);
                tree.set(row, 0.0);
            }
            Self::Rank { heap, .. } => heap.remove(row),
        }
    }

    /// Tells the error that was found for a row. One that has been removed since stays so.
    pub fn update(&mut self, row: usize, error: f32) {
        let error = if error.is_finite() { error.abs() } else { return };
        match self {
            Self::Uniform(_) => {}
            Self::Proportional { tree, alpha, largest, .. } => {
                if tree.get(row) > 0.0 {
                    let priority = (error + EPSILON).powf(*alpha);
                    *largest = largest.max(priority);
                    tree.set(row, priority);
                }
            }
            Self::Rank { heap, largest, .. } => {
                if heap.contains(row) {
                    *largest = largest.max(error);
                    heap.set(row, error);
                }
            }
        }
    }

    /// Draws rows, if there are any.
    pub fn draw(&mut self, count: usize, random: &mut ChaCha8Rng, drawn: &mut Vec<Drawn>) {
        drawn.clear();
        let rows = self.count();
        if rows == 0 {
            return;
        }
        for i in 0..count {
            let share = (i as f64 + random.random_range(0.0..1.0_f64)) / count as f64;
            drawn.push(match self {
                Self::Uniform(members) => {
                    let row = members.rows[random.random_range(0..rows)] as usize;
                    Drawn { row, probability: 1.0 / rows as f64 }
                }
                Self::Proportional { tree, .. } => {
                    let row = tree.find(share * tree.total());
                    Drawn { row, probability: f64::from(tree.get(row)) / tree.total() }
                }
                Self::Rank { heap, alpha, .. } => {
                    let (rank, probability) = ranked(share, rows, f64::from(*alpha));
                    Drawn { row: heap.rows[rank] as usize, probability }
                }
            });
        }
    }
}

/// The rank, from 0, at which a share of the probability lies, and how likely that rank is. The probability of rank r, from
/// 1, is the integral of `x^-alpha` from r to r + 1: as good as `r^-alpha`, and its sum can be inverted.
fn ranked(share: f64, rows: usize, alpha: f64) -> (usize, f64) {
    // With an alpha of 1 the integral is a logarithm; a power this small is as good.
    let power = (1.0 - alpha).max(1e-6);
    let until = |x: f64| (x.powf(power) - 1.0) / power;
    let back = |y: f64| (y * power + 1.0).powf(1.0 / power);
    let total = until(rows as f64 + 1.0);
    let rank = (back(share * total) as usize).clamp(1, rows);
    (rank - 1, (until(rank as f64 + 1.0) - until(rank as f64)) / total)
}

/// A set of rows of which each can be drawn as easily.
#[derive(Debug)]
pub struct Members {
    rows: Vec<u32>,
    /// Where each is; `u32::MAX` if it is not there.
    at: Vec<u32>,
}

impl Members {
    fn new(rows: usize) -> Self {
        Self { rows: Vec::new(), at: vec![u32::MAX; rows] }
    }

    fn add(&mut self, row: usize) {
        if self.at[row] == u32::MAX {
            self.at[row] = self.rows.len() as u32;
            self.rows.push(row as u32);
        }
    }

    fn remove(&mut self, row: usize) {
        let at = std::mem::replace(&mut self.at[row], u32::MAX) as usize;
        if at != u32::MAX as usize {
            self.rows.swap_remove(at);
            if let Some(moved) = self.rows.get(at) {
                self.at[*moved as usize] = at as u32;
            }
        }
    }
}

/// Importance weights `(N P)^-beta`, divided by the largest of the batch, so that they only ever make steps smaller.
pub fn weights(drawn: &[Drawn], rows: usize, beta: f64) -> Vec<f32> {
    let each: Vec<f64> = drawn.iter().map(|drawn| (rows as f64 * drawn.probability).powf(-beta)).collect();
    let largest = each.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    each.into_iter().map(|weight| (weight / largest) as f32).collect()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    /// How often each of four rows is drawn, of 1, and what is said of it.
    fn frequencies(priorities: &mut Priorities) -> ([f64; 4], [f64; 4]) {
        let (mut random, mut drawn) = (ChaCha8Rng::seed_from_u64(1), Vec::new());
        let (mut counts, mut said) = ([0.0; 4], [0.0; 4]);
        for _ in 0..1000 {
            priorities.draw(32, &mut random, &mut drawn);
            for Drawn { row, probability } in &drawn {
                counts[*row] += 1.0 / 32_000.0;
                said[*row] = *probability;
            }
        }
        (counts, said)
    }

    fn filled(replay: Replay, alpha: f32, errors: [f32; 4]) -> Priorities {
        let mut priorities = Priorities::new(replay, 4, alpha);
        for (row, error) in errors.into_iter().enumerate() {
            priorities.add(row);
            priorities.update(row, error);
        }
        // Otherwise the order is that of the heap, which is near it.
        if let Priorities::Rank { heap, .. } = &mut priorities {
            heap.sort();
        }
        priorities
    }

    #[test]
    fn rows_are_drawn_as_often_as_their_errors_ask_for_and_as_is_said_of_them() {
        let errors = [0.5, 4.0, 1.0, 2.0];
        let power = |error: f32| f64::from((error + EPSILON).powf(0.6));
        let sum: f64 = errors.iter().map(|error| power(*error)).sum();
        let proportional = errors.map(|error| power(error) / sum);
        let total = 5_f64.powf(0.4) - 1.0;
        let rank = [4.0, 1.0, 3.0, 2.0].map(|rank: f64| ((rank + 1.0).powf(0.4) - rank.powf(0.4)) / total);
        for (replay, expected) in
            [(Replay::Uniform, [0.25; 4]), (Replay::Proportional, proportional), (Replay::Rank, rank)]
        {
            let (counts, said) = frequencies(&mut filled(replay, 0.6, errors));
            for row in 0..4 {
                assert!((counts[row] - expected[row]).abs() < 0.01, "{replay:?}: {counts:?}, expected {expected:?}");
                assert!((said[row] - expected[row]).abs() < 1e-5, "{replay:?}: {said:?}, expected {expected:?}");
            }
        }
    }

    #[test]
    fn a_row_that_was_removed_is_drawn_no_more_and_one_that_is_new_comes_first() {
        for replay in [Replay::Uniform, Replay::Proportional, Replay::Rank] {
            let mut priorities = filled(replay, 0.6, [9.0, 1.0, 1.0, 1.0]);
            priorities.remove(1);
            priorities.update(1, 100.0);
            priorities.remove(1);
            let (counts, _) = frequencies(&mut priorities);
            assert!(counts[1] == 0.0 && priorities.count() == 3, "{replay:?}: {counts:?}");
            priorities.add(1);
            let (counts, _) = frequencies(&mut priorities);
            assert!(counts[1] > 0.2 && priorities.count() == 4, "{replay:?}: {counts:?}");
        }
    }

    #[test]
    fn importance_weights_undo_the_bias_with_a_beta_of_one() {
        let drawn = [0.1, 0.4].map(|probability| Drawn { row: 0, probability });
        assert_eq!(weights(&drawn, 10, 1.0), [1.0, 0.25]);
        assert_eq!(weights(&drawn, 10, 0.5), [1.0, 0.5]);
        assert_eq!(weights(&drawn, 10, 0.0), [1.0, 1.0]);
    }
}
