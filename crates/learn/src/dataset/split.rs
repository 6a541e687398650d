//! Training and validation, by blocks in time.

use serde::{Deserialize, Serialize};

use super::DatasetError;

/// Neighbours in time look alike: a split by single rows would show the training set's pictures again in validation.
/// So whole blocks of rows are held out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Blocks {
    /// Rows in a block, default 50.
    pub size: usize,
    /// One block in this many, the first, is held out; default 5.
    pub every: usize,
}

impl Default for Blocks {
    fn default() -> Self {
        Self { size: 50, every: 5 }
    }
}

impl Blocks {
    /// Checks that there are blocks of both kinds; `names` are the settings' names of size and distance.
    pub(crate) fn check(self, names: [&'static str; 2]) -> Result<(), DatasetError> {
        let [size, every] = names;
        for (name, number, least, expected) in
            [(size, self.size, 1, "at least 1 row"), (every, self.every, 2, "at least 2 blocks")]
        {
            if number < least {
                return Err(DatasetError::Setting { name, expected, got: number.to_string() });
            }
        }
        Ok(())
    }

    /// Whether a row, counted from 0, is held out: `(row / size) % every == 0`.
    pub fn is_validation(&self, row: usize) -> bool {
        (row / self.size.max(1)).is_multiple_of(self.every.max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_fifty_of_each_two_hundred_and_fifty_rows_are_held_out() {
        let held_out = |row| Blocks::default().is_validation(row);
        assert!((0..50).chain(250..300).all(held_out));
        assert!(!(50..250).any(held_out));
    }
}
