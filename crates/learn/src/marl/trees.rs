//! What [`priorities`](super::priorities) are kept in: a sum tree, and a heap in which rows can be found.

/// The heap is sorted after as many changes as it has rows, times this.
const SORT_EVERY: f32 = 1.0;

/// A binary tree in which each node holds the sum of its two children; priorities are the leaves.
#[derive(Debug, Clone)]
pub struct SumTree {
    /// The root is at 1, the children of i at 2i and 2i + 1, the leaves in the second half. Sums are f64: a million small
    /// changes to f32 would add up to nonsense.
    nodes: Vec<f64>,
}

impl SumTree {
    /// With so many leaves, all 0.
    pub fn new(leaves: usize) -> Self {
        Self { nodes: vec![0.0; 2 * leaves.max(1).next_power_of_two()] }
    }

    fn leaves(&self) -> usize {
        self.nodes.len() / 2
    }

    /// The sum of all leaves.
    pub fn total(&self) -> f64 {
        self.nodes[1]
    }

    /// A leaf.
    pub fn get(&self, leaf: usize) -> f32 {
        self.nodes[self.leaves() + leaf] as f32
    }

    /// Changes a leaf.
    pub fn set(&mut self, leaf: usize, value: f32) {
        let mut node = self.leaves() + leaf;
        self.nodes[node] = f64::from(value);
        while node > 1 {
            node /= 2;
            self.nodes[node] = self.nodes[2 * node] + self.nodes[2 * node + 1];
        }
    }

    /// The leaf in which a prefix of the sum ends: one that is not 0.
    pub fn find(&self, prefix: f64) -> usize {
        let (mut node, mut left) = (1, prefix);
        while node < self.leaves() {
            node *= 2;
            // Rounding must not lead into an empty half.
            if left >= self.nodes[node] && self.nodes[node + 1] > 0.0 {
                left -= self.nodes[node];
                node += 1;
            }
        }
        node - self.leaves()
    }
}

/// A binary heap with the largest error first, in which rows can be found.
#[derive(Debug)]
pub struct Heap {
    pub(super) rows: Vec<u32>,
    at: Vec<u32>,
    errors: Vec<f32>,
    /// Since it was sorted.
    changes: usize,
}

impl Heap {
    pub(super) fn new(rows: usize) -> Self {
        Self { rows: Vec::new(), at: vec![u32::MAX; rows], errors: vec![0.0; rows], changes: 0 }
    }

    pub(super) fn contains(&self, row: usize) -> bool {
        self.at[row] != u32::MAX
    }

    pub(super) fn set(&mut self, row: usize, error: f32) {
        if !self.contains(row) {
            self.at[row] = self.rows.len() as u32;
            self.rows.push(row as u32);
        }
        self.errors[row] = error;
        let at = self.up(self.at[row] as usize);
        self.down(at);
        self.changes += 1;
        if self.changes as f32 > SORT_EVERY * self.rows.len() as f32 {
            self.sort();
        }
    }

    pub(super) fn remove(&mut self, row: usize) {
        let at = std::mem::replace(&mut self.at[row], u32::MAX) as usize;
        if at == u32::MAX as usize {
            return;
        }
        self.rows.swap_remove(at);
        if let Some(moved) = self.rows.get(at) {
            self.at[*moved as usize] = at as u32;
            let at = self.up(at);
            self.down(at);
        }
    }

    /// A sorted array is a heap.
    pub(super) fn sort(&mut self) {
        self.changes = 0;
        let errors = &self.errors;
        self.rows.sort_unstable_by(|a, b| errors[*b as usize].total_cmp(&errors[*a as usize]).then(a.cmp(b)));
        for (at, row) in self.rows.iter().enumerate() {
            self.at[*row as usize] = at as u32;
        }
    }

    fn error(&self, at: usize) -> f32 {
        self.errors[self.rows[at] as usize]
    }

    fn swap(&mut self, a: usize, b: usize) {
        self.rows.swap(a, b);
        (self.at[self.rows[a] as usize], self.at[self.rows[b] as usize]) = (a as u32, b as u32);
    }

    fn up(&mut self, mut at: usize) -> usize {
        while at > 0 && self.error(at) > self.error((at - 1) / 2) {
            self.swap(at, (at - 1) / 2);
            at = (at - 1) / 2;
        }
        at
    }

    fn down(&mut self, mut at: usize) {
        loop {
            let children = [2 * at + 1, 2 * at + 2].into_iter().filter(|child| *child < self.rows.len());
            let Some(child) = children.max_by(|a, b| self.error(*a).total_cmp(&self.error(*b))) else { return };
            if self.error(child) <= self.error(at) {
                return;
            }
            self.swap(at, child);
            at = child;
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn the_sum_tree_holds_its_sum_through_a_million_changes_and_finds_each_leaf() {
        let mut tree = SumTree::new(1000);
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut values = vec![0.0_f32; 1000];
        for _ in 0..1_000_000 {
            let (leaf, value) = (random.random_range(0..1000), random.random_range(0.0..3.0));
            values[leaf] = value;
            tree.set(leaf, value);
        }
        let sum: f64 = values.iter().map(|value| f64::from(*value)).sum();
        assert!((tree.total() - sum).abs() < 1e-6, "{} {sum}", tree.total());
        let mut before = 0.0;
        for (leaf, value) in values.iter().enumerate().filter(|(_, value)| **value > 0.0) {
            assert_eq!(tree.find(before + f64::from(*value) / 2.0), leaf);
            before += f64::from(*value);
        }
        tree.set(999, 0.0);
        assert!(tree.find(tree.total() + 1.0) < 999, "never a leaf that is 0");
    }

    #[test]
    fn the_heap_is_one_whatever_is_changed_and_removed() {
        let mut heap = Heap::new(100);
        let mut random = ChaCha8Rng::seed_from_u64(3);
        for _ in 0..10_000 {
            let row = random.random_range(0..100);
            if random.random_bool(0.3) {
                heap.remove(row);
            } else {
                heap.set(row, random.random_range(0.0..1.0));
            }
            for at in 1..heap.rows.len() {
                assert!(heap.error((at - 1) / 2) >= heap.error(at));
                assert_eq!(heap.at[heap.rows[at] as usize] as usize, at);
            }
        }
    }
}
