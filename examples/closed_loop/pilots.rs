//! Pilots of different quality, the same ones on every machine.

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::Result;
use lapwing_core::pilot;
use lapwing_learn::models::{self, LoadedModel};

use super::handicap::{CONTROLS, Handicap, NONE};

/// What is tried of the built-in network, besides the negative controls.
const WEAKENED: [(&str, Handicap); 10] = [
    ("gain 0.5", Handicap { gain: 0.5, ..NONE }),
    ("gain 0.4", Handicap { gain: 0.4, ..NONE }),
    ("gain 0.3", Handicap { gain: 0.3, ..NONE }),
    ("gain 0.2", Handicap { gain: 0.2, ..NONE }),
    ("bias 0.12 left", Handicap { bias: -0.12, ..NONE }),
    ("bias 0.25 left", Handicap { bias: -0.25, ..NONE }),
    ("noise 0.1", Handicap { noise: 0.1, ..NONE }),
    ("noise 0.14", Handicap { noise: 0.14, ..NONE }),
    ("noise 0.18", Handicap { noise: 0.18, ..NONE }),
    ("straight on", Handicap { gain: 0.0, ..NONE }),
];

/// A model and what is wrong with it.
pub struct Pilot {
    /// What it is called.
    pub name: String,
    model: LoadedModel,
    handicap: Handicap,
}

impl Pilot {
    /// Ready for a drive.
    pub fn ready(&self) -> Box<dyn pilot::Pilot> {
        self.handicap.of(self.model.pilot())
    }
}

/// The shipped models, further ones, and the built-in one with each handicap.
pub fn all(further: &[PathBuf], quick: bool) -> Result<Vec<Pilot>> {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let mut pilots = Vec::new();
    let mut add = |name: String, model: LoadedModel, handicap| pilots.push(Pilot { name, model, handicap });
    if !quick {
        add("resnet50".into(), models::load(shipped.join("resnet50.safetensors"), Instant::now)?, NONE);
    }
    add("pilotnet".into(), models::built_in(Instant::now)?, NONE);
    add("cps".into(), models::load(shipped.join("cps.safetensors"), Instant::now)?, NONE);
    for path in further {
        let name = path.parent().and_then(Path::file_name).map_or_else(String::new, |n| n.to_string_lossy().into());
        add(name, models::load(path, Instant::now)?, NONE);
    }
    for (what, handicap) in WEAKENED.into_iter().chain(CONTROLS) {
        add(format!("pilotnet, {what}"), models::built_in(Instant::now)?, handicap);
    }
    Ok(pilots)
}
