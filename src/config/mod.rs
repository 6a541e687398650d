//! Settings: defaults < your own `lapwing.toml` < the folder's < environment < flags, resolved once.
//!
//! Every layer is a TOML table of the same shape; unknown keys and impossible
//! values are refused with the layer that holds them. The resolved whole goes
//! into every run, so that a run says how it was driven.

mod simulator;

pub use simulator::{OnCrash, Rules, RulesError, Simulator};

use std::{
    fs, io,
    net::{IpAddr, Ipv4Addr},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::units::{Mph, SpeedUnit};

/// The settings file looked for in the working directory.
pub const FILE: &str = "lapwing.toml";

/// The environment's prefix: `LAPWING_CONTROL__SPEED_MPH=12` is `control.speed_mph`.
pub const PREFIX: &str = "LAPWING_";

/// All settings, resolved.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The server.
    pub bridge: Bridge,
    /// The network that drives.
    pub model: Model,
    /// The pictures that are taken.
    pub perception: Perception,
    /// Throttle and hand-over.
    pub control: Control,
    /// What is kept of a drive.
    pub recording: Recording,
    /// The headless simulator.
    pub simulator: Simulator,
    /// What a run must reach.
    pub thresholds: Thresholds,
}

/// `[bridge]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Bridge {
    /// Address to listen on. Default 127.0.0.1: this machine only.
    pub bind: IpAddr,
    /// Port to listen on. Default 4567, the only one that the simulator dials; 0 takes a free one.
    pub port: u16,
    /// What the simulator means by `speed`. Default `mph`; some `pos_x` forks send `m/s`.
    pub speed_unit: SpeedUnit,
    /// Silence after which a simulator is sent a command unasked, s. Default 1; more for one that draws slower.
    pub kick_after_s: f64,
    /// Events for each simulator as it connects, each `["name"]` or `["name",{…}]` in JSON. Default none.
    /// udacity-gym waits for `["start_episode",{"track_name":…,"weather_name":…,"daytime_name":…}]`;
    /// the stock build passes over events that it does not know.
    pub greet: Vec<String>,
}

/// `[model]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Model {
    /// A checkpoint (`.safetensors`) or TorchScript (`.pt` with a side `.toml`). Default: the PilotNet built in.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub path: Option<PathBuf>,
    /// Threads that libtorch may use for one forward pass; 0, the default, leaves the choice to the network.
    /// `drive` always takes one: another number rounds otherwise, and the same seed must give the same run everywhere.
    pub threads: u16,
    /// Whether files that others may have written (the folder's `lapwing.toml`, one of `--config`, a suite) may name a
    /// TorchScript model, whose code then runs. Default no; those files themselves may not say yes. It says nothing
    /// about a drive, and is not recorded.
    #[serde(skip_serializing)]
    pub allow_torchscript: bool,
}

/// `[perception]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Perception {
    /// Most pixels, width times height, of a picture, live, recorded or in a data set. Default 2304000: 1920x1200.
    pub max_pixels: u32,
}

/// `[control]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Control {
    /// Which law makes throttle. Default `pi`.
    pub speed_law: SpeedLaw,
    /// The PI controller's set speed and the quadratic law's limit, mph. Default 9, as `drive.py`.
    pub speed_mph: Mph,
    /// Proportional gain, throttle per mph. Default 0.1, as `drive.py`.
    pub kp: f64,
    /// Integral gain, throttle per mph and telemetry. Default 0.002, as `drive.py`.
    pub ki: f64,
    /// What happens when a human lets go. Default `resume`.
    pub takeover: Takeover,
}

/// Which law makes throttle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SpeedLaw {
    /// `drive.py`'s PI controller.
    #[default]
    Pi,
    /// Lu's `1 - steering² - (speed / limit)²`.
    Quadratic,
}

/// What happens when a human lets go.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Takeover {
    /// The pilot goes on.
    #[default]
    Resume,
    /// The pilot stays off until it is armed again.
    Latch,
}

/// `[recording]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Recording {
    /// Whether runs are recorded. Default yes.
    pub enabled: bool,
    /// Folder of the runs. Default `recordings`.
    pub dir: PathBuf,
    /// Items that may wait for the disk before frames are left out. Default 512, some 6 s of one simulator at 20 Hz.
    pub queue: usize,
}

/// `[thresholds]`: what a run must reach, or the exit status is 3. None is set by default.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Thresholds {
    /// Least completion, percent of the laps asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_completion: Option<f64>,
    /// Least autonomy, percent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_autonomy: Option<f64>,
    /// Least driving score (CARLA 2.1), 0 to 100.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_driving_score: Option<f64>,
    /// Most collisions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_collisions: Option<u32>,
    /// Most times off the road.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_off_road: Option<u32>,
    /// Largest |cte| allowed anywhere, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_cte: Option<f64>,
    /// Largest mean |cte|, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_mean_cte: Option<f64>,
}

impl Default for Bridge {
    fn default() -> Self {
        Self {
            bind: Ipv4Addr::LOCALHOST.into(),
            port: 4567,
            speed_unit: SpeedUnit::Mph,
            kick_after_s: 1.0,
            greet: vec![],
        }
    }
}

impl Default for Perception {
    fn default() -> Self {
        Self { max_pixels: 1920 * 1200 }
    }
}

impl Default for Control {
    fn default() -> Self {
        Self { speed_law: SpeedLaw::Pi, speed_mph: Mph::constant(9.0), kp: 0.1, ki: 0.002, takeover: Takeover::Resume }
    }
}

impl Default for Recording {
    fn default() -> Self {
        Self { enabled: true, dir: "recordings".into(), queue: 512 }
    }
}

/// Settings that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file is there and cannot be read, or was named and is not there.
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

/// Settings on their way to being resolved, layer upon layer.
#[derive(Debug, Clone, Default)]
pub struct Layers {
    merged: Table,
    /// See [`Layers::model_named_by_others`].
    model_named_by_others: Option<String>,
}

/// Whose word a layer is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Author {
    /// Who runs the program: flags, environment.
    User,
    /// The same, written down for all folders.
    UsersFile,
    /// Whoever wrote the file. It is read because it lies in the folder, or was handed over as a whole.
    Anybody,
}

impl Layers {
    /// Adds the user's own settings file, and is content without.
    ///
    /// # Errors
    /// As [`Layers::file`].
    pub fn own_file(self, path: &Path) -> Result<Self, ConfigError> {
        self.read(path, false, Author::UsersFile)
    }

    /// Adds a settings file, which anybody may have written. `None` looks for [`FILE`] in the working directory and is content without.
    ///
    /// # Errors
    /// [`ConfigError`] where the file cannot be read or holds something unknown.
    pub fn file(self, path: Option<&Path>) -> Result<Self, ConfigError> {
        self.read(path.unwrap_or(Path::new(FILE)), path.is_some(), Author::Anybody)
    }

    fn read(self, path: &Path, must_be_there: bool, author: Author) -> Result<Self, ConfigError> {
        let text = match fs::read_to_string(path) {
            Ok(text) => text,
            Err(e) if !must_be_there && e.kind() == io::ErrorKind::NotFound => return Ok(self),
            Err(source) => return Err(ConfigError::Read { path: path.into(), source }),
        };
        let table = text.parse::<Table>().map_err(|e| ConfigError::Syntax { path: path.into(), why: e.to_string() })?;
        self.layer(&path.display().to_string(), table, author)
    }

    /// Adds the variables that begin with [`PREFIX`] and a known section.
    ///
    /// # Errors
    /// [`ConfigError`] naming the variable.
    pub fn environment(mut self, variables: impl Iterator<Item = (String, String)>) -> Result<Self, ConfigError> {
        for (name, value) in variables {
            // Other variables with the prefix (LAPWING_LOG) name no section and are no settings.
            let Some(key) = name.strip_prefix(PREFIX).filter(|k| k.contains("__")) else { continue };
            let (layer, key) = (format!("environment variable {name}"), key.to_lowercase().replace("__", "."));
            // `2026` is a number, and may be meant for the name of a folder.
            self = self
                .clone()
                .set(&layer, &key, text(&value))
                .or_else(|e| self.set(&layer, &key, value.as_str()).map_err(|_| e))?;
        }
        Ok(self)
    }

    /// Sets one dotted key, as flags do.
    ///
    /// # Errors
    /// [`ConfigError`] naming `layer`.
    pub fn set(self, layer: &str, key: &str, value: impl Into<Value>) -> Result<Self, ConfigError> {
        let mut value = value.into();
        for part in key.rsplit('.') {
            value = Value::Table(Table::from_iter([(part.to_owned(), value)]));
        }
        let Value::Table(table) = value else { unreachable!("a key has at least one part") };
        self.layer(layer, table, Author::User)
    }

    /// The file that names the model, where that is no word of the user's own: one that anybody may have written, or
    /// the user's with a path that depends on the folder.
    pub fn model_named_by_others(&self) -> Option<&str> {
        self.model_named_by_others.as_deref()
    }

    /// The settings.
    ///
    /// # Errors
    /// [`ConfigError`] for values that do not go together.
    pub fn resolve(self) -> Result<Settings, ConfigError> {
        check("settings", &self.merged)
    }

    fn layer(mut self, name: &str, table: Table, author: Author) -> Result<Self, ConfigError> {
        let of_model = |key: &str| table.get("model").and_then(|model| model.get(key));
        if author == Author::Anybody && of_model("allow_torchscript").is_some() {
            let why = "model.allow_torchscript: expected in your own settings, the environment or as \
                       --allow-torchscript, got it in a file that others may have written";
            return Err(ConfigError::Value { layer: name.into(), why: why.into() });
        }
        if let Some(path) = of_model("path") {
            let anywhere = path.as_str().is_some_and(|path| Path::new(path).is_absolute());
            let own = author == Author::User || (author == Author::UsersFile && anywhere);
            self.model_named_by_others = (!own).then(|| name.to_owned());
        }
        merge(&mut self.merged, table);
        check(name, &self.merged)?; // the layers below passed: what is wrong now is this one's
        Ok(self)
    }
}

fn check(layer: &str, table: &Table) -> Result<Settings, ConfigError> {
    let error = |why: String| ConfigError::Value { layer: layer.into(), why };
    let settings: Settings =
        table.clone().try_into().map_err(|e: toml::de::Error| error(e.to_string().trim().into()))?;
    let Control { speed_mph, kp, ki, .. } = settings.control;
    if speed_mph <= Mph::ZERO {
        return Err(error(format!("control.speed_mph: expected a speed above 0 mph, got {speed_mph}")));
    }
    for (key, gain) in [("kp", kp), ("ki", ki)] {
        if !(0.0..=100.0).contains(&gain) {
            return Err(error(format!("control.{key}: expected a gain from 0 to 100, got {gain}")));
        }
    }
    if !(0.1..=3600.0).contains(&settings.bridge.kick_after_s) {
        let got = settings.bridge.kick_after_s;
        return Err(error(format!("bridge.kick_after_s: expected 0.1 to 3600 seconds, got {got}")));
    }
    for event in &settings.bridge.greet {
        // Anything else and the simulator's client dies of it.
        use serde_json::Value::{Array, Object, String};
        let is_event = serde_json::from_str(event).is_ok_and(|value| match value {
            Array(parts) => matches!(parts.as_slice(), [String(_)] | [String(_), Object(_)]),
            _ => false,
        });
        if !is_event {
            return Err(error(format!(r#"bridge.greet: expected ["name"] or ["name",{{…}}] in JSON, got {event:?}"#)));
        }
    }
    let pixels = settings.perception.max_pixels;
    if !(1..=4096 * 4096).contains(&pixels) {
        return Err(error(format!("perception.max_pixels: expected 1 to 16777216 (4096x4096), got {pixels}")));
    }
    if settings.model.threads > 1024 {
        return Err(error(format!("model.threads: expected at most 1024, got {}", settings.model.threads)));
    }
    let Thresholds { min_completion, min_autonomy, min_driving_score, max_cte, max_mean_cte, .. } = settings.thresholds;
    for (key, limit, most) in [
        ("min_completion", min_completion, 100.0),
        ("min_autonomy", min_autonomy, 100.0),
        ("min_driving_score", min_driving_score, 100.0),
        ("max_cte", max_cte, f64::MAX),
        ("max_mean_cte", max_mean_cte, f64::MAX),
    ] {
        if let Some(limit) = limit.filter(|limit| !(0.0..=most).contains(limit)) {
            let expected = if most > 100.0 { "0 or more".into() } else { format!("0 to {most}") };
            return Err(error(format!("thresholds.{key}: expected {expected}, got {limit}")));
        }
    }
    settings.simulator.rules.check().map_err(|why| error(format!("simulator.rules: {why}")))?;
    if !(1.0..=50.0).contains(&settings.simulator.hz) {
        return Err(error(format!("simulator.hz: expected 1 to 50 a second, got {}", settings.simulator.hz)));
    }
    if settings.recording.queue < 16 {
        return Err(error(format!("recording.queue: expected at least 16, got {}", settings.recording.queue)));
    }
    Ok(settings)
}

fn merge(below: &mut Table, above: Table) {
    for (key, value) in above {
        match (below.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => merge(below, above),
            (_, value) => drop(below.insert(key, value)),
        }
    }
}

/// A variable's text as the TOML value that it looks like, else as a string.
fn text(value: &str) -> Value {
    format!("v = {value}").parse::<Table>().ok().and_then(|mut t| t.remove("v")).unwrap_or_else(|| value.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn environment(pairs: &[(&str, &str)]) -> Result<Layers, ConfigError> {
        Layers::default().environment(pairs.iter().map(|(k, v)| ((*k).into(), (*v).into())))
    }

    fn file(text: &str) -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(FILE);
        fs::write(&path, text).unwrap();
        (dir, path)
    }

    #[test]
    fn each_layer_wins_over_the_one_below() {
        let (_dir, path) = file("[control]\nspeed_mph = 12\nkp = 0.2\n");
        let variables = [("LAPWING_CONTROL__SPEED_MPH".to_owned(), "15.5".to_owned())];
        let layers = Layers::default().file(Some(&path)).unwrap().environment(variables.into_iter()).unwrap();
        let settings = layers.clone().resolve().unwrap();
        assert_eq!((settings.control.speed_mph.get(), settings.control.kp, settings.control.ki), (15.5, 0.2, 0.002));
        let settings = layers.set("--speed", "control.speed_mph", 20.0).unwrap().resolve().unwrap();
        assert_eq!(settings.control.speed_mph.get(), 20.0);
    }

    #[test]
    fn a_file_names_a_model_by_its_own_word_until_the_user_names_one() {
        let (_dir, path) = file("[model]\npath = \"/somewhere/net.pt\"\n");
        let named_by = |layers: &Layers| layers.model_named_by_others().map(str::to_owned);
        let others = Layers::default().file(Some(&path)).unwrap();
        assert_eq!(named_by(&others), Some(path.display().to_string()));
        let (flag, key) = ("--model", "model.path");
        assert_eq!(named_by(&others.clone().set(flag, key, "net.pt").unwrap()), None);
        let variable = [("LAPWING_MODEL__PATH".to_owned(), "net.pt".to_owned())];
        assert_eq!(named_by(&others.environment(variable.into_iter()).unwrap()), None);
        let own = Layers::default().own_file(&path).unwrap();
        assert_eq!(named_by(&own), None);
        assert_eq!(own.resolve().unwrap().model.path.as_deref(), Some(Path::new("/somewhere/net.pt")));
        // What lies there differs from folder to folder.
        let (_dir, relative) = file("[model]\npath = \"net.pt\"\n");
        assert!(named_by(&Layers::default().own_file(&relative).unwrap()).is_some());
        // The folder's file has the last word, and it is not the user's.
        let both = Layers::default().own_file(&path).unwrap().file(Some(&relative)).unwrap();
        assert_eq!(named_by(&both), Some(relative.display().to_string()));
    }

    #[test]
    fn only_the_user_allows_code_to_run() {
        let (_dir, path) = file("[model]\nallow_torchscript = true\n");
        assert!(Layers::default().own_file(&path).unwrap().resolve().unwrap().model.allow_torchscript);
        let error = Layers::default().file(Some(&path)).unwrap_err().to_string();
        assert!(error.contains("model.allow_torchscript: expected in your own settings"), "{error}");
        assert!(
            !Layers::default()
                .own_file(Path::new("/nowhere/lapwing.toml"))
                .unwrap()
                .resolve()
                .unwrap()
                .model
                .allow_torchscript
        );
    }

    #[test]
    fn an_unknown_key_is_refused_with_the_layer_that_holds_it() {
        let (_dir, path) = file("[control]\nsped = 12\n");
        let error = Layers::default().file(Some(&path)).unwrap_err().to_string();
        assert!(error.contains("lapwing.toml") && error.contains("unknown field `sped`"), "{error}");
        let error = environment(&[("LAPWING_BRIDGE__PROT", "1")]).unwrap_err().to_string();
        assert!(error.contains("environment variable LAPWING_BRIDGE__PROT"), "{error}");
    }

    #[test]
    fn an_impossible_value_is_refused_with_expected_and_got() {
        let error = |key: &str, value: Value| Layers::default().set("--flag", key, value).unwrap_err().to_string();
        assert_eq!(
            error("control.speed_mph", 0.into()),
            "--flag: control.speed_mph: expected a speed above 0 mph, got 0 mph"
        );
        assert!(error("control.speed_mph", 5000.into()).contains("from -1000 to 1000 mph, got 5000"));
        assert!(error("control.kp", f64::NAN.into()).contains("from 0 to 100, got NaN"));
        assert!(error("bridge.port", 70000.into()).contains("70000"));
        let greeting = |text: &str| Value::Array(vec![text.into()]);
        assert!(error("bridge.greet", greeting(r#"["a",1]"#)).contains(r#"expected ["name"] or ["name",{…}] in JSON"#));
        assert!(error("control.takeover", "never".into()).contains("expected `resume` or `latch`"));
    }

    #[test]
    fn variables_without_a_section_are_not_ours_and_an_unknown_section_is_refused() {
        assert!(
            environment(&[("LAPWING_CONTRL__KP", "1")]).unwrap_err().to_string().contains("unknown field `contrl`")
        );
        let folder = environment(&[("LAPWING_RECORDING__DIR", "2026")]).unwrap().resolve().unwrap().recording.dir;
        assert_eq!(folder, Path::new("2026"));
        assert_eq!(
            environment(&[("LAPWING_SHARED", "x"), ("PATH", "y")]).unwrap().resolve().unwrap(),
            Settings::default()
        );
    }

    #[test]
    fn a_missing_file_is_fine_unless_it_was_named() {
        let error = Layers::default().file(Some(Path::new("/nowhere/lapwing.toml"))).unwrap_err();
        assert!(matches!(error, ConfigError::Read { .. }));
    }

    #[test]
    fn settings_survive_the_way_into_a_run_and_back() {
        let json = serde_json::to_value(Settings::default()).unwrap();
        assert_eq!(serde_json::from_value::<Settings>(json).unwrap(), Settings::default());
    }
}
