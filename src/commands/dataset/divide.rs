//! `lapwing dataset split`: a log to train on and one to validate on.

use super::Ended;
use crate::{cli, commands::print};
use lapwing_core::words::count;
use lapwing_learn::dataset::{self, Blocks, Divided};

pub(super) fn run(arguments: &cli::DatasetSplit) -> anyhow::Result<Ended> {
    let blocks = Blocks { size: arguments.block, every: arguments.every };
    let divided = dataset::divide(&arguments.source, blocks, &arguments.out_train, &arguments.out_validation)?;
    if arguments.json {
        print(&serde_json::to_string_pretty(&divided)?)?;
    } else {
        let Divided { train, train_rows, validation, validation_rows } = divided;
        print(&format!(
            "{} for training, in {}\n{} for validation, in {}",
            count(train_rows, "row"),
            train.display(),
            count(validation_rows, "row"),
            validation.display()
        ))?;
    }
    Ok(Ended::Passed)
}
