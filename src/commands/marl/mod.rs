//! `lapwing marl`: many agents at an intersection, one function per verb.

mod drivers;
#[cfg(feature = "networks")]
mod study;
#[cfg(feature = "networks")]
mod this_call;
#[cfg(feature = "networks")]
mod train;
mod watch;

use super::{Ended, print};
use crate::cli::{Marl, MarlEvaluate, MarlVerb};
use drivers::Drivers;
use lapwing_sim::intersection::evaluation::{self, HELD_OUT};

/// Episodes that are driven side by side.
const AT_ONCE: usize = 64;

pub(super) fn run(arguments: &Marl) -> anyhow::Result<Ended> {
    match &arguments.verb {
        #[cfg(feature = "networks")]
        MarlVerb::Train(arguments) => train::run(arguments),
        #[cfg(feature = "networks")]
        MarlVerb::Study(arguments) => study::run(arguments),
        MarlVerb::Watch(arguments) => watch::run(arguments),
        MarlVerb::Evaluate(arguments) => evaluate(arguments),
    }
}

/// `lapwing marl evaluate`.
fn evaluate(arguments: &MarlEvaluate) -> anyhow::Result<Ended> {
    let mut drivers = Drivers::new(&arguments.drivers)?;
    let settings = drivers.settings(arguments.intersection);
    let first = HELD_OUT * (1 + u64::from(arguments.seed));
    let seeds = first..first + arguments.episodes;
    let act = |environments: &[_], actions: &mut [_]| drivers.act(environments, actions);
    let found = evaluation::evaluate(settings, seeds, AT_ONCE, act)?;
    let told = match arguments.json {
        true => serde_json::to_string_pretty(&found)?,
        false => found.in_words(settings.reward).to_string(),
    };
    print(&told)?;
    Ok(Ended::Passed)
}
