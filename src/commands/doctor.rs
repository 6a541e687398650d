//! `lapwing doctor`: which libtorch, which device, which model, and what is wrong.

use std::path::Path;

use super::{Ended, guards, outputs, serve};
use crate::{cli, doctor};

pub(super) fn run(arguments: cli::Doctor, config: Option<&Path>) -> anyhow::Result<Ended> {
    let layers = super::thinking_layers(config, &arguments.driving, &arguments.thinking)?;
    let layers = guards::layers(layers, &arguments.guard)?;
    let settings = serve::layers(layers, &arguments.server)?.resolve()?;
    // The model first: it chooses the number of threads.
    let model = super::load_model(&settings).map_err(|error| super::told(&error));
    let guard = match guards::load(&settings.brake) {
        Err(error) if outputs::is_usage(&error) => return Err(error),
        loaded => loaded.map(|guard| guard.map(|guard| guard.name().to_owned())).map_err(|error| super::told(&error)),
    };
    let findings = doctor::examine(&settings, model, guard)?;
    if arguments.json {
        super::print(&serde_json::to_string_pretty(&findings)?)?;
    } else {
        super::print(&findings.to_string())?;
    }
    Ok(if findings.troubles.is_empty() { Ended::Passed } else { Ended::Failed })
}
