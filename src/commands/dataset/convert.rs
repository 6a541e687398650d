//! `lapwing dataset convert`: a folder to a run, or a run to a folder.

use std::ops::ControlFlow;

use super::{Ended, RowBar};
use crate::{
    cli,
    commands::{interrupted, print},
};
use lapwing_core::words::count;
use lapwing_learn::dataset::{self, Converted};

pub(super) fn run(arguments: &cli::DatasetConvert) -> anyhow::Result<Ended> {
    let cli::DatasetConvert { source, target, json } = arguments;
    let bar = RowBar::new();
    let interrupted = interrupted();
    let converted = dataset::convert(source, target, &mut |done, total| {
        bar.show(done, total);
        if interrupted.is_pressed() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    drop(bar);
    if *json {
        print(&serde_json::to_string_pretty(&converted)?)?;
        return Ok(Ended::Passed);
    }
    let Converted { rows, without_picture, unusable, side_pictures, seams, truncated } = converted;
    print(&format!("{}, in {}", count(rows, "row"), target.display()))?;
    if let Some(why) = unusable {
        say!("without a picture: {}; the first, because: {why}", count(without_picture, "row"));
    } else if without_picture > 0 {
        say!("left out: {} whose picture was not recorded", count(without_picture, "telemetry"));
    }
    if side_pictures > 0 {
        say!(
            "left out: {} of the side cameras, because a run has only the centre camera",
            count(side_pictures, "picture")
        );
    }
    if seams > 0 {
        say!(
            "the folder has {} in time, as between two drives, where a human took over or the car was put back",
            count(seams, "gap")
        );
    }
    if let Some(truncated) = truncated {
        say!("{} is {truncated}", source.display());
    }
    Ok(Ended::Passed)
}
