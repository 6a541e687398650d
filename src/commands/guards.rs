//! Guards of the verbs that drive: who may brake in place of the pilot, and loading them.

use serde_json::{Value, json};

use crate::cli::GuardFlags;
use lapwing_core::{
    config::{BrakeSettings, ConfigError, GuardKind, Guarding, Layers},
    guard::{GuardModel, TimeToCollision},
};

/// Those, then the flags about the brake.
pub(super) fn layers(mut layers: Layers, flags: &GuardFlags) -> Result<Layers, ConfigError> {
    #[cfg(feature = "networks")]
    {
        if let Some(model) = &flags.brake_model {
            layers = layers.set_path("--brake-model", "brake.model", model)?;
            layers = layers.set("--brake-model", "brake.guard", GuardKind::Model)?;
        }
        if let Some(threshold) = flags.brake_threshold {
            layers = layers.set("--brake-threshold", "brake.threshold", threshold)?;
        }
    }
    match flags.brake_guard {
        Some(guard) => layers.set("--brake-guard", "brake.guard", guard),
        None => Ok(layers),
    }
}

/// Loads the guard that the settings name, if any.
pub(super) fn load(settings: &BrakeSettings) -> anyhow::Result<Option<Box<dyn GuardModel>>> {
    // Once all layers are known: a file may hold the threshold, and a flag the network.
    if let (Some(threshold), None, None | Some(GuardKind::Ttc)) = (settings.threshold, &settings.model, settings.guard)
    {
        let why =
            format!("expected a braking network as well (brake.model, --brake-model), got {threshold} without one");
        return Err(ConfigError::Value { layer: "brake.threshold".into(), why }.into());
    }
    let guard: Box<dyn GuardModel> = match settings.guarding() {
        Guarding::Nobody => return Ok(None),
        Guarding::TimeToCollision => Box::new(TimeToCollision::default()),
        #[cfg(feature = "networks")]
        Guarding::Network(path, threshold) => Box::new(lapwing_learn::braking::BrakingModel::load(path, threshold)?),
        #[cfg(not(feature = "networks"))]
        Guarding::Network(path, _) => {
            anyhow::bail!("{}: expected a program with networks, got one built without them", path.display())
        }
    };
    tracing::info!("guard: {}", guard.name());
    Ok(Some(guard))
}

/// What a run says about its guard.
pub(super) fn told(guard: Option<&dyn GuardModel>) -> Option<Value> {
    guard.map(|guard| json!({ "name": guard.name(), "sha256": guard.sha256() }))
}
