//! `lapwing dataset convert`: a run of a folder, or a folder of a run.

use super::{Ended, Rows};
use crate::{
    cli,
    commands::print,
    dataset::{self, Converted},
};

pub(super) fn run(arguments: &cli::DatasetConvert) -> anyhow::Result<Ended> {
    let cli::DatasetConvert { source, target, json } = arguments;
    let bar = Rows::new();
    let converted = dataset::convert(source, target, &mut |done, total| bar.show(done, total))?;
    drop(bar);
    if *json {
        print(&serde_json::to_string_pretty(&converted)?)?;
        return Ok(Ended::Passed);
    }
    let Converted { rows, without_picture, side_pictures, truncated } = converted;
    print(&format!("{rows} rows, in {}", target.display()))?;
    if without_picture > 0 {
        say!("{without_picture} telemetries are left out: their picture was not recorded");
    }
    if side_pictures > 0 {
        say!("{side_pictures} pictures of the side cameras are left out: a run has the centre camera only");
    }
    if let Some(truncated) = truncated {
        say!("{} is {truncated}", source.display());
    }
    Ok(Ended::Passed)
}
