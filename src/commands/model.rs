//! Models of the commands: which may be loaded, and loading them.

#[cfg(feature = "bridge")]
use std::{error::Error, fs, io, path::PathBuf, sync::Arc};
use std::{num::NonZeroU16, path::Path, time::Instant};

#[cfg(any(feature = "bridge", feature = "simulator"))]
use anyhow::Context;

use super::{layers, own_settings};
use crate::cli::{Driving, Thinking, Trust};
#[cfg(feature = "bridge")]
use lapwing_core::config::Guarding;
use lapwing_core::config::{ConfigError, Layers, Settings};
#[cfg(feature = "bridge")]
use lapwing_core::{perception::Frame, units::Mph};
#[cfg(feature = "bridge")]
use lapwing_learn::explain::{Explainer, Method};
use lapwing_learn::{
    models::{self, LoadedModel},
    nn::runtime,
};
#[cfg(feature = "bridge")]
use lapwing_live::page::{Explaining, Explains, Layer, Looks};
#[cfg(feature = "simulator")]
use lapwing_sim::camera::{Camera, Lens};

/// Refuses a model whose code would run only because a file that anybody may have written names it. `has_flag` says
/// whether the verb has `--model`.
pub(super) fn refuse_strangers_code(
    file: &str,
    model: &Path,
    has_flag: bool,
    settings: &Settings,
) -> Result<(), ConfigError> {
    if !models::is_torchscript(model) || settings.model.allow_torchscript {
        return Ok(());
    }
    let own = own_settings().map_or_else(|| "your own settings".into(), |path| path.display().to_string());
    let model = model.display();
    let flag = if has_flag { format!("--model {model} or ") } else { String::new() };
    let why = format!(
        "model {model} is TorchScript, and loading it runs its code; this file alone may not choose it. If you trust \
         the model, pass {flag}--allow-torchscript, or set model.allow_torchscript = true in {own}"
    );
    Err(ConfigError::Value { layer: file.into(), why })
}

/// Those, and whether others may name TorchScript models.
pub(super) fn allowing(layers: Layers, trust: &Trust) -> Result<Layers, ConfigError> {
    match trust.allow_torchscript {
        true => layers.set("--allow-torchscript", "model.allow_torchscript", true),
        false => Ok(layers),
    }
}

/// Those, then the flags of the verbs whose model may use several threads.
pub(super) fn thinking_layers(
    config: Option<&Path>,
    driving: &Driving,
    thinking: &Thinking,
) -> Result<Layers, ConfigError> {
    let layers = layers(config, driving)?;
    match thinking.threads {
        Some(threads) => layers.set("--threads", "model.threads", threads),
        None => Ok(layers),
    }
}

/// Before the drive, refuses a model whose crop the cameras of our own worlds cannot fill.
#[cfg(feature = "simulator")]
pub(super) fn suits_our_cameras(model: &LoadedModel) -> anyhow::Result<()> {
    let Lens { width, height, .. } = Camera::CENTER.lens;
    model.preprocess().area_of(width, height).with_context(|| model.name().to_owned())?;
    Ok(())
}

/// Loads the model that the settings name, or the built-in one.
pub(super) fn load_model(settings: &Settings) -> anyhow::Result<LoadedModel> {
    let model = match &settings.model.path {
        Some(path) => models::load(path, Instant::now)?,
        None => models::built_in(Instant::now)?,
    };
    // Before any thread drives, as each adopts the number at its first operation.
    let chosen = NonZeroU16::new(settings.model.threads).map(NonZeroU16::get);
    if let Some(threads) = chosen.or(model.threads()) {
        runtime::set_threads(threads);
    }
    tracing::info!("model: {}", model.name());
    Ok(model)
}

/// Refuses files that are not there, before anybody is asked to wait for what they hold.
#[cfg(feature = "bridge")]
pub(super) fn are_there(settings: &Settings, more: &[PathBuf]) -> Result<(), models::ModelError> {
    let guard = match settings.brake.guarding() {
        Guarding::Network(path, _) => Some(path),
        Guarding::Nobody | Guarding::TimeToCollision => None,
    };
    let named = settings.model.path.as_deref().into_iter().chain(more.iter().map(PathBuf::as_path)).chain(guard);
    for path in named {
        fs::metadata(path).map_err(|source| models::ModelError::Read { path: path.to_owned(), source })?;
    }
    Ok(())
}

/// The model that drives first, then those that a person at the page may switch to: the built-in one, these files, and the
/// checkpoints that steer in these folders.
#[cfg(feature = "bridge")]
pub(super) fn load_models(settings: &Settings, more: &[PathBuf]) -> anyhow::Result<Vec<Arc<LoadedModel>>> {
    let mut all = vec![Arc::new(load_model(settings)?)];
    if settings.model.path.is_some() {
        all.push(Arc::new(models::built_in(Instant::now)?));
    }
    for path in more {
        if !path.is_dir() {
            all.push(Arc::new(models::load(path, Instant::now)?));
            continue;
        }
        for file in checkpoints_in(path)? {
            match models::load(&file, Instant::now) {
                Ok(model) if !all.iter().any(|known| known.sha256() == model.sha256()) => all.push(Arc::new(model)),
                Ok(_) => {} // the built-in one, most likely
                // A guard, or a network that finds the lane: such lie beside those that steer.
                Err(error) => say!("not on the page: {error}"),
            }
        }
    }
    Ok(all)
}

/// The checkpoints in a folder, by name. No TorchScript, which is code and is run only if somebody names it.
#[cfg(feature = "bridge")]
fn checkpoints_in(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let unread = || format!("{} cannot be read", folder.display());
    let entries = fs::read_dir(folder).with_context(unread)?;
    let mut files: Vec<_> = entries.map(|entry| Ok(entry?.path())).collect::<io::Result<_>>().with_context(unread)?;
    files.retain(|file| file.extension().is_some_and(|extension| extension == "safetensors"));
    files.sort();
    Ok(files)
}

/// How the page shows what a model looks at, or why it does not.
#[cfg(feature = "bridge")]
pub(super) fn explaining(model: &LoadedModel) -> Explaining {
    match Explainer::of(model) {
        Ok(explainer) => Explaining::by(OnThePage(explainer)),
        Err(error) => Explaining::not(error.to_string()),
    }
}

#[cfg(feature = "bridge")]
struct OnThePage(Explainer);

#[cfg(feature = "bridge")]
impl Explains for OnThePage {
    fn explain(&mut self, frame: &Frame, speed: Mph, looks: Looks) -> Result<Layer, Box<dyn Error + Send + Sync>> {
        let method = match looks {
            Looks::VisualBackProp => Method::VisualBackProp,
            Looks::IntegratedGradients => Method::IntegratedGradients,
        };
        let (width, height) = (frame.width(), frame.height());
        let rgba = self.0.explain(frame, speed, method)?.layer(width, height);
        Ok(Layer { width, height, rgba })
    }
}
