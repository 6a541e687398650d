//! A replay compared with a stored one, for people and as JSON.

use std::fmt;

use serde::Serialize;

use super::{Answered, Difference, Golden, Machine};

/// Differing frames that are listed one by one.
const NAMED: usize = 10;

/// The result of comparing a replay with a stored one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GoldenComparison {
    /// The largest difference in steering and throttle that is forgiven.
    pub tolerance: f64,
    /// Frames that differ by more.
    pub differing_frames: usize,
    /// The first of them.
    pub first: Vec<Difference>,
    /// The recording that the stored replay was made from.
    pub source: String,
    /// Where the stored replay was written, if that is known.
    pub written_on: Option<Machine>,
    /// Where this one ran, if that is known.
    pub compared_on: Option<Machine>,
}

impl GoldenComparison {
    /// Compares answers that were given on this machine, if that is known.
    pub fn new(golden: &Golden, answers: &[Answered], tolerance: f64, here: Option<Machine>) -> Self {
        let differences = golden.compare(answers, tolerance);
        Self {
            tolerance,
            differing_frames: differences.len(),
            first: differences.into_iter().take(NAMED).collect(),
            source: golden.source().to_owned(),
            written_on: golden.written_on().cloned(),
            compared_on: here,
        }
    }
}

impl fmt::Display for GoldenComparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { tolerance, differing_frames, first, source, written_on, compared_on } = self;
        if *differing_frames == 0 {
            return write!(f, "  golden           every command agrees within {tolerance}");
        }
        write!(f, "  golden           {differing_frames} differ by more than {tolerance}:")?;
        for Difference { frame, what } in first {
            write!(f, "\n    frame {frame}: {what}")?;
        }
        if *differing_frames > first.len() {
            write!(f, "\n    and {} more", differing_frames - first.len())?;
        }
        let machine =
            |machine: &Option<Machine>| machine.as_ref().map_or_else(|| "not reported".into(), Machine::to_string);
        write!(
            f,
            "\n    made from        {source}\n    written on       {}\n    compared on      {}",
            machine(written_on),
            machine(compared_on)
        )?;
        if written_on != compared_on {
            f.write_str(
                "\n    the last bits of a network's answers differ between kinds of processor and versions of libtorch",
            )?;
        }
        Ok(())
    }
}
