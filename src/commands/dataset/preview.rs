//! `lapwing dataset preview`: what augmentation does to pictures and labels.

use std::fs;

use anyhow::Context;

use super::Ended;
use crate::{
    cli,
    commands::{outputs, print},
};
use lapwing_learn::{
    dataset::{self, Augmentation, Source},
    train::Recipe,
};

pub(super) fn run(arguments: &cli::DatasetPreview) -> anyhow::Result<Ended> {
    outputs::check_drawing(&arguments.out)?;
    let augmentation = match &arguments.recipe {
        None => Augmentation::default(),
        Some(path) => {
            let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
            Recipe::parse(&text).with_context(|| path.display().to_string())?.augment
        }
    };
    augmentation.check()?;
    dataset::preview(&Source::open(&arguments.source)?, &augmentation, arguments.seed)?.write(&arguments.out)?;
    print(&format!("{}", arguments.out.display()))?;
    Ok(Ended::Passed)
}
