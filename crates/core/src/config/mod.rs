//! Settings: defaults < your own `lapwing.toml` < the folder's < environment < flags, resolved once.
//!
//! Every layer is a TOML table of the same shape. An unknown key or an impossible value is an error that names its
//! layer. The resolved settings are stored in every run, so that a run says how it was driven.

mod brake;
mod bridge;
mod layers;
mod simulator;
mod thresholds;

pub use brake::{BrakeSettings, GuardKind, Guarding};
pub use bridge::{BridgeSettings, FoxgloveSettings, Limits};
pub use layers::{Layers, Origin, Told};
pub use simulator::{OnCrash, Rules, RulesError, SimulatorSettings};
pub use thresholds::{Bound, LimitUnit, Threshold, Thresholds};

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use toml::Table;

use crate::{units::Mph, words};

/// The settings file looked for in the working directory.
pub const FILE: &str = "lapwing.toml";

/// The environment's prefix: `LAPWING_CONTROL__SPEED_MPH=12` is `control.speed_mph`.
pub const PREFIX: &str = "LAPWING_";

/// All settings, resolved.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The server.
    pub bridge: BridgeSettings,
    /// The port for viewers.
    pub foxglove: FoxgloveSettings,
    /// The network that drives.
    pub model: ModelSettings,
    /// Camera images.
    pub perception: PerceptionSettings,
    /// Throttle and hand-over.
    pub control: ControlSettings,
    /// Who may brake in place of the pilot.
    pub brake: BrakeSettings,
    /// What is recorded of a drive.
    pub recording: RecordingSettings,
    /// The headless simulator.
    pub simulator: SimulatorSettings,
    /// What a run must reach.
    pub thresholds: Thresholds,
}

/// `[model]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ModelSettings {
    /// A checkpoint (`.safetensors`), or TorchScript (`.pt`) or ONNX (`.onnx`) with a side `.toml`. Default: the PilotNet
    /// built in.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub path: Option<PathBuf>,
    /// Threads that libtorch may use for one forward pass; 0, the default, leaves the choice to the network. `drive`
    /// always uses one: other numbers round differently, and the same seed must give the same run everywhere.
    pub threads: u16,
    /// Whether files that others may have written (the folder's `lapwing.toml`, one of `--config`, a suite) may name a
    /// TorchScript model, whose code then runs. Default no; those files cannot set it themselves. It does not affect a
    /// drive and is not recorded.
    #[serde(skip_serializing)]
    pub allow_torchscript: bool,
    /// ONNX Runtime's shared library, for `.onnx`, where `ORT_DYLIB_PATH` names none. It is code, so only the user's own file
    /// may name it. It is not recorded.
    #[serde(skip_serializing)]
    pub onnxruntime: Option<PathBuf>,
}

/// `[perception]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PerceptionSettings {
    /// Largest picture, live, recorded or in a data set, in pixels (width times height). Default 2304000: 1920x1200.
    pub max_pixels: u32,
}

/// `[control]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControlSettings {
    /// The law that computes throttle. Default `pi`.
    pub speed_law: SpeedLaw,
    /// The PI controller's set speed and the quadratic law's limit, mph. Default 9, as `drive.py`.
    pub speed_mph: Mph,
    /// Proportional gain, throttle per mph. Default 0.1, as `drive.py`.
    pub kp: f64,
    /// Integral gain, throttle per mph and telemetry. Default 0.002, as `drive.py`.
    pub ki: f64,
    /// What happens when a human lets go. Default `resume`.
    pub takeover: Takeover,
    /// Whether a network is shown the road from where the car will be when its command takes effect, where that is late.
    /// Default yes.
    pub compensate_latency: bool,
}

/// The law that computes throttle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum SpeedLaw {
    /// `drive.py`'s PI controller.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    #[default]
    Pi,
    /// Lu's `1 - steering² - (speed / limit)²`.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    Quadratic,
}

impl SpeedLaw {
    /// Its name in settings, and in a run's events.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pi => "pi",
            Self::Quadratic => "quadratic",
        }
    }
}

/// What happens when a human lets go.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Takeover {
    /// The pilot drives again.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    #[default]
    Resume,
    /// The pilot stays off until it is armed again.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    Latch,
}

/// `[recording]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecordingSettings {
    /// Whether runs are recorded. Default yes.
    pub enabled: bool,
    /// Folder of the runs. Default `recordings`.
    pub dir: PathBuf,
    /// Items that may wait for the disk before frames are dropped. Default 512, about 6 s of one simulator at 20 Hz.
    pub queue: usize,
}

impl Default for PerceptionSettings {
    fn default() -> Self {
        Self { max_pixels: 1920 * 1200 }
    }
}

impl Default for ControlSettings {
    fn default() -> Self {
        Self {
            speed_law: SpeedLaw::Pi,
            speed_mph: Mph::constant(9.0),
            kp: 0.1,
            ki: 0.002,
            takeover: Takeover::Resume,
            compensate_latency: true,
        }
    }
}

impl Default for RecordingSettings {
    fn default() -> Self {
        Self { enabled: true, dir: "recordings".into(), queue: 512 }
    }
}

/// Settings that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read, or was named and does not exist.
    #[error("{path}: cannot be read: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file is not TOML.
    #[error("{path}: {why}")]
    Syntax {
        /// The file.
        path: PathBuf,
        /// What the TOML reader says, with line and column.
        why: String,
    },
    /// A key that does not exist, or a value of the wrong kind or range.
    #[error("{layer}: {why}")]
    Value {
        /// Which layer: the file, an environment variable, a flag.
        layer: String,
        /// What is wrong, with expected and got.
        why: String,
    },
}

/// Reads a file of settings, conditions, a scenario or a suite as text.
///
/// # Errors
/// [`ConfigError::Read`].
pub fn text_of(path: &Path) -> Result<String, ConfigError> {
    fs::read_to_string(path).map_err(|source| ConfigError::Read { path: path.to_owned(), source })
}

/// The settings of the layers so far. Each value is checked by itself, because a later layer may complete them.
fn check(layer: &str, table: &Table) -> Result<Settings, ConfigError> {
    let error = |why: String| ConfigError::Value { layer: layer.into(), why };
    let settings: Settings =
        table.clone().try_into().map_err(|e: toml::de::Error| error(words::suggesting(e.to_string().trim())))?;
    let ControlSettings { speed_mph, kp, ki, .. } = settings.control;
    if speed_mph <= Mph::ZERO {
        return Err(error(format!("control.speed_mph: expected a speed above 0 mph, got {speed_mph}")));
    }
    for (key, gain) in [("kp", kp), ("ki", ki)] {
        if !(0.0..=100.0).contains(&gain) {
            return Err(error(format!("control.{key}: expected a gain from 0 to 100, got {gain}")));
        }
    }
    settings.bridge.check().map_err(error)?;
    settings.foxglove.check().map_err(error)?;
    settings.brake.check().map_err(error)?;
    let pixels = settings.perception.max_pixels;
    if !(1..=4096 * 4096).contains(&pixels) {
        return Err(error(format!("perception.max_pixels: expected 1 to 16777216 (4096x4096), got {pixels}")));
    }
    if settings.model.threads > 1024 {
        return Err(error(format!("model.threads: expected at most 1024, got {}", settings.model.threads)));
    }
    settings.thresholds.check().map_err(error)?;
    settings.simulator.rules.check().map_err(|why| error(format!("simulator.rules: {why}")))?;
    if !(1.0..=50.0).contains(&settings.simulator.hz) {
        return Err(error(format!("simulator.hz: expected 1 to 50 a second, got {}", settings.simulator.hz)));
    }
    let RecordingSettings { dir, queue, .. } = &settings.recording;
    if !(16..=1_000_000).contains(queue) {
        return Err(error(format!("recording.queue: expected 16 to 1000000, got {queue}")));
    }
    for (key, path) in [
        ("recording.dir", Some(dir)),
        ("model.path", settings.model.path.as_ref()),
        ("brake.model", settings.brake.model.as_ref()),
    ] {
        if path.is_some_and(|path| path.as_os_str().is_empty()) {
            return Err(error(format!("{key}: expected a path, got none")));
        }
    }
    Ok(settings)
}

/// What is wrong with settings together: the keys, and why.
fn check_together(settings: &Settings) -> Result<(), (&'static [&'static str], String)> {
    settings.bridge.check_together()?;
    settings.brake.check_together()
}

#[cfg(test)]
mod tests {
    use toml::Value;

    use super::*;

    #[test]
    fn an_impossible_value_is_refused_with_expected_and_got() {
        let error = |key: &str, value: Value| {
            Layers::default().set("--flag", key, value).and_then(Layers::resolve).unwrap_err().to_string()
        };
        assert_eq!(
            error("control.speed_mph", 0.into()),
            "--flag: control.speed_mph: expected a speed above 0 mph, got 0 mph"
        );
        assert!(error("control.speed_mph", 5000.into()).contains("from -1000 to 1000 mph, got 5000"));
        assert!(error("control.kp", f64::NAN.into()).contains("from 0 to 100, got NaN"));
        assert!(error("bridge.port", 70000.into()).contains("70000"));
        let greeting = |text: &str| Value::Array(vec![text.into()]);
        assert!(error("bridge.greet", greeting(r#"["a",1]"#)).contains(r#"expected ["name"] or ["name",{…}] in JSON"#));
        assert!(error("bridge.kick_after_s", 0.4.into()).contains("expected 0.5 to 3600 seconds, got 0.4"));
        assert!(error("bridge.limits.connections", 0.into()).contains("expected 1 to 1024, got 0"));
        assert!(error("bridge.limits.in_flight_mib", 6.into()).contains("two of the largest messages (8 MiB), got 6"));
        let connections = error("bridge.limits.connections", 257.into());
        assert!(connections.starts_with("--flag: ") && connections.contains("at least 65 for 257 connections, got 64"));
        let list = |text: &str| Value::Array(vec![text.into()]);
        assert!(error("bridge.allow_origins", list("localhost:3000")).contains("expected scheme://host"));
        assert!(
            error("bridge.allow_origins", list("http://localhost:3000/")).contains("got \"http://localhost:3000/\"")
        );
        assert!(error("foxglove.allow_origins", list("localhost:8080")).contains("foxglove.allow_origins: expected"));
        assert!(error("bridge.allow_hosts", list("car:4567")).contains("without a port"));
        assert!(error("brake.threshold", 0.into()).contains("above 0, got 0"));
        assert!(error("brake.guard", "model".into()).contains("brake.model to be the network's file, got none"));
        assert!(
            error("recording.queue", 100_000_000_000_i64.into()).contains("expected 16 to 1000000, got 100000000000")
        );
        for key in ["recording.dir", "model.path", "brake.model"] {
            assert!(error(key, "".into()).contains(&format!("{key}: expected a path, got none")));
        }
        assert!(error("control.takeover", "never".into()).contains("expected `resume` or `latch`"));
    }

    #[test]
    fn settings_survive_the_way_into_a_run_and_back() {
        let json = serde_json::to_value(Settings::default()).unwrap();
        assert_eq!(serde_json::from_value::<Settings>(json).unwrap(), Settings::default());
    }
}
