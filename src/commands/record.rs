//! `lapwing record`: the expert drives, and the stock recorder's files are written.

use std::{path::Path, time::Instant};

use super::{Ended, Interrupted, world};
use crate::cli;
use lapwing_core::{
    drive::Eventful, driver::Driver, pilot::PurePursuit, recording::udacity::DrivingLogWriter, units::Mph, words::count,
};
use lapwing_sim::{
    record::{self, RecordOptions, RecordReport, StanceOptions},
    world::{Ending, Simulation},
};

/// How many are driven if nobody says.
const LAPS: u32 = 1;

pub(super) fn run(arguments: &cli::Record, config: Option<&Path>) -> anyhow::Result<Ended> {
    #[cfg(feature = "bridge")]
    if let Some(port) = arguments.page.page {
        let layers = world::layers(super::undriven_layers(config)?, &arguments.world)?;
        let settings = super::paged::layers(layers, &arguments.page)?.resolve()?;
        return super::paged::record(arguments, settings, port, super::interrupted());
    }
    if let Some(wanted) = arguments.stances {
        let (made, track) = stances(arguments, wanted, config, &super::interrupted())?;
        super::print(&format!("{} of {track}, in {}", count(made, "stance"), arguments.out.display()))?;
        return Ok(if made == wanted { Ended::Passed } else { Ended::Failed });
    }
    let (RecordReport { rows, laps, ending, .. }, track) = record(arguments, config, &super::interrupted())?;
    // Whoever sets a limit alone gets what was asked for.
    let by_time = arguments.laps.is_none() && arguments.world.max_time.is_some() && ending == Ending::TimeOver;
    let wanted = arguments.laps.unwrap_or(LAPS);
    let ended = if by_time || laps >= wanted { Ended::Passed } else { Ended::Failed };
    let laps = format!("{laps} of {}", count(wanted, "lap"));
    super::print(&format!("{}, {laps} of {track} ({ending}), in {}", count(rows, "row"), arguments.out.display()))?;
    Ok(ended)
}

/// Records stances until there are as many as wanted, or Ctrl-C is pressed; returns how many there are, and the track.
pub(super) fn stances(
    arguments: &cli::Record,
    count: u64,
    config: Option<&Path>,
    interrupted: &Interrupted,
) -> anyhow::Result<(u64, String)> {
    let settings = world::layers(super::undriven_layers(config)?, &arguments.world)?.resolve()?;
    let setup = world::spec(&arguments.world, None).setup(&settings.simulator)?;
    let log = DrivingLogWriter::create(&arguments.out, jiff::Zoned::now().datetime())?;
    let every_weather = arguments.world.conditions.as_deref() == Some("random");
    let options = StanceOptions { count, every_weather };
    let made = record::stances(&setup, log, options, || !interrupted.is_pressed())?;
    Ok((made, setup.track.file().name.clone()))
}

/// Drives and records until all laps are driven, or the drive ends; also returns the track.
pub(super) fn record(
    arguments: &cli::Record,
    config: Option<&Path>,
    interrupted: &Interrupted,
) -> anyhow::Result<(RecordReport, String)> {
    let settings = world::layers(super::undriven_layers(config)?, &arguments.world)?.resolve()?;
    let setup = world::spec(&arguments.world, Some(arguments.laps.unwrap_or(LAPS))).setup(&settings.simulator)?;
    let mut simulation = Simulation::new(setup)?;
    // Last, so that an earlier failure leaves no log.
    let log = DrivingLogWriter::create(&arguments.out, jiff::Zoned::now().datetime())?;
    let options = RecordOptions { recovery: arguments.recovery, ..RecordOptions::at(Mph::saturating(arguments.speed)) };
    let bar = world::ProgressLine::new();
    // The expert in the simulation drives: this driver's answers do not count.
    let mut driver = Driver::new(Box::new(PurePursuit::default()), &settings.control, Instant::now);
    let report = record::record(&mut simulation, &mut driver, log, options, |simulation| {
        bar.show(simulation);
        if interrupted.is_pressed() {
            simulation.interrupt();
        }
    })?;
    bar.clear();
    Ok((report, simulation.setup().track.file().name.clone()))
}
