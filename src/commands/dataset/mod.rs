//! `lapwing dataset`: recordings as data sets, one file per verb.

mod convert;
mod divide;
mod inspect;
mod preview;

use std::{
    io::{self, IsTerminal},
    time::Duration,
};

use indicatif::{ProgressBar, ProgressStyle};

use super::Ended;
use crate::cli::{Dataset, DatasetVerb};

pub(super) fn run(arguments: Dataset) -> anyhow::Result<Ended> {
    match arguments.verb {
        DatasetVerb::Inspect(arguments) => inspect::run(arguments),
        DatasetVerb::Convert(arguments) => convert::run(&arguments),
        DatasetVerb::Preview(arguments) => preview::run(&arguments),
        DatasetVerb::Split(arguments) => divide::run(&arguments),
    }
}

/// A bar that counts rows, for people.
struct RowBar(ProgressBar);

impl RowBar {
    fn new() -> Self {
        if !io::stderr().is_terminal() {
            return Self(ProgressBar::hidden());
        }
        let bar = ProgressBar::new_spinner();
        bar.enable_steady_tick(Duration::from_millis(200));
        bar.set_style(
            ProgressStyle::with_template("{wide_bar} {pos}/{len} rows, {per_sec}, {eta} left")
                .expect("the template is written here"),
        );
        Self(bar)
    }

    fn show(&self, done: u64, total: Option<u64>) {
        if let Some(total) = total {
            self.0.set_length(total);
        }
        self.0.set_position(done);
    }
}

impl Drop for RowBar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
