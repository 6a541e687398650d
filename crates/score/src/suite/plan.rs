//! The plan of a suite, stored beside its results, so that a merge of parts knows what is missing.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use super::{Cell, Done};

/// The schema of a plan's file.
pub(super) const SCHEMA: &str = "lapwing.plan/1";

/// All cells of a suite, those of other parts included, in the order in which they are driven.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    pub(super) schema: String,
    cells: Vec<PlannedCell>,
}

/// One of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct PlannedCell {
    /// [`Cell::id`].
    id: String,
    /// Its name for people.
    drive: String,
}

impl Plan {
    /// The plan of these cells.
    pub fn new(cells: &[Cell]) -> Self {
        let planned = |cell: &Cell| PlannedCell { id: cell.id(), drive: cell.to_string() };
        Self { schema: SCHEMA.into(), cells: cells.iter().map(planned).collect() }
    }

    /// Adds what another plan has in addition.
    pub fn add(&mut self, other: Self) {
        let known: BTreeSet<_> = self.cells.iter().map(|cell| cell.id.clone()).collect();
        self.cells.extend(other.cells.into_iter().filter(|cell| !known.contains(&cell.id)));
    }

    /// How many cells there are.
    pub fn count(&self) -> usize {
        self.cells.len()
    }

    /// Whether it has a cell of this id.
    pub fn has(&self, id: &str) -> bool {
        self.cells.iter().any(|cell| cell.id == id)
    }

    /// The cells without a result, by their names for people.
    pub fn missing(&self, done: &[Done]) -> Vec<&str> {
        let there: BTreeSet<_> = done.iter().map(|done| done.cell.id()).collect();
        self.cells.iter().filter(|cell| !there.contains(&cell.id)).map(|cell| cell.drive.as_str()).collect()
    }
}
