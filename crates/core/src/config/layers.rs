//! Resolves settings: files, environment and flags override one another in layers, and each value keeps its origin.

use std::{
    collections::BTreeMap,
    ffi::{OsStr, OsString},
    fs, io,
    path::Path,
};

use serde::Serialize;
use toml::{Table, Value};

use super::{ConfigError, FILE, PREFIX, Settings, check, check_together};

/// Settings on their way to being resolved, layer upon layer.
#[derive(Debug, Clone, Default)]
pub struct Layers {
    merged: Table,
    /// For each dotted key that a layer sets, the topmost one.
    origins: BTreeMap<String, String>,
    /// See [`Layers::model_named_by_others`].
    model_named_by_others: Option<String>,
}

/// A setting, as `lapwing config` tells it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Told {
    /// Dotted.
    #[serde(skip)]
    pub key: String,
    /// As it counts.
    pub value: Value,
    /// Where that comes from.
    pub origin: Origin,
}

/// Where a setting comes from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Origin {
    /// Nobody set it.
    Default,
    /// A file, an environment variable or a flag, by its name.
    #[serde(untagged)]
    Layer(String),
}

/// Who wrote a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Author {
    /// The user: flags, environment.
    User,
    /// The user, in the file that applies to all folders.
    UsersFile,
    /// Anybody: the file is read because it is in the folder, or because it was named.
    Anybody,
}

impl Layers {
    /// Adds the user's own settings file, if there is one.
    ///
    /// # Errors
    /// As [`Layers::file`].
    pub fn own_file(self, path: &Path) -> Result<Self, ConfigError> {
        self.read(path, false, Author::UsersFile)
    }

    /// Adds a settings file, which anybody may have written. `None` looks for [`FILE`] in the working directory, where
    /// it may be missing.
    ///
    /// # Errors
    /// [`ConfigError`] if the file cannot be read or holds something unknown.
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
    pub fn environment(mut self, variables: impl Iterator<Item = (OsString, OsString)>) -> Result<Self, ConfigError> {
        for (name, value) in variables {
            // Other variables with the prefix (LAPWING_LOG) name no section and are no settings.
            let Some(name) = name.to_str() else { continue };
            let Some(key) = name.strip_prefix(PREFIX) else { continue };
            if !key.contains("__") {
                self.one_underscore(name, key, &value)?;
                continue;
            }
            let (layer, key) = (format!("environment variable {name}"), key.to_lowercase().replace("__", "."));
            self = self.set_text(&layer, &key, unicode(&layer, &value)?)?;
        }
        Ok(self)
    }

    /// Refuses a variable that would be a setting if each part of its key ended in two underscores.
    fn one_underscore(&self, name: &str, key: &str, value: &OsStr) -> Result<(), ConfigError> {
        let key = key.to_lowercase();
        let Some(value) = value.to_str() else { return Ok(()) };
        let dotted = |at: &[usize]| {
            let part = |(i, c): (usize, char)| if at.contains(&i) { '.' } else { c };
            key.char_indices().map(part).collect::<String>()
        };
        let between: Vec<usize> = key.match_indices('_').map(|(i, _)| i).collect();
        let one = between.iter().map(|i| dotted(&[*i]));
        let two = between.iter().flat_map(|i| between.iter().filter(move |j| *j > i).map(|j| dotted(&[*i, *j])));
        let is_setting = |key: &String| self.clone().set_text("", key, value).is_ok();
        let Some(meant) = one.chain(two).find(is_setting) else { return Ok(()) };
        let meant = format!("{PREFIX}{}", meant.replace('.', "__").to_uppercase());
        let why = format!("expected two underscores between the parts of a key, as in {meant}");
        Err(ConfigError::Value { layer: format!("environment variable {name}"), why })
    }

    /// Sets one dotted key to what a variable's text looks like. `2026` is a number, and may be meant for the name of a folder.
    fn set_text(self, layer: &str, key: &str, value: &str) -> Result<Self, ConfigError> {
        self.clone().set(layer, key, text(value)).or_else(|e| self.set(layer, key, value).map_err(|_| e))
    }

    /// Sets one dotted key, as flags do.
    ///
    /// # Errors
    /// [`ConfigError`] naming `layer`.
    pub fn set(self, layer: &str, key: &str, value: impl Serialize) -> Result<Self, ConfigError> {
        let wrong = |why: toml::ser::Error| ConfigError::Value { layer: layer.into(), why: why.to_string() };
        let mut value = Value::try_from(value).map_err(wrong)?;
        for part in key.rsplit('.') {
            value = Value::Table(Table::from_iter([(part.to_owned(), value)]));
        }
        let Value::Table(table) = value else { unreachable!("a key has at least one part") };
        self.layer(layer, table, Author::User)
    }

    /// The file that names the model, unless the user chose it: a file that anybody may have written, or the user's own
    /// with a path that depends on the folder.
    pub fn model_named_by_others(&self) -> Option<&str> {
        self.model_named_by_others.as_deref()
    }

    /// Sets one dotted key to a path. Settings are text and are stored in runs, so a path that is not Unicode is
    /// refused, not changed.
    ///
    /// # Errors
    /// [`ConfigError`] naming `layer`.
    pub fn set_path(self, layer: &str, key: &str, path: &Path) -> Result<Self, ConfigError> {
        let path = unicode(layer, path.as_os_str())?;
        self.set(layer, key, path)
    }

    /// The settings.
    ///
    /// # Errors
    /// [`ConfigError`] for values that cannot be combined.
    pub fn resolve(self) -> Result<Settings, ConfigError> {
        let settings = self.so_far()?;
        check_together(&settings).map_err(|(keys, why)| {
            let origin = keys.iter().find_map(|key| self.origins.get(*key));
            ConfigError::Value { layer: origin.map_or_else(|| "settings".into(), String::clone), why }
        })?;
        Ok(settings)
    }

    /// The settings of the layers so far, which others may still complete.
    ///
    /// # Errors
    /// [`ConfigError`]; cannot fail for layers that were added by these methods.
    pub fn so_far(&self) -> Result<Settings, ConfigError> {
        check("settings", &self.merged)
    }

    /// All settings that have a value, in the order of their sections, with where each comes from.
    ///
    /// # Errors
    /// As [`Layers::resolve`].
    pub fn told(&self) -> Result<Vec<Told>, ConfigError> {
        let settings = self.clone().resolve()?;
        let wrong = |why: toml::ser::Error| ConfigError::Value { layer: "settings".into(), why: why.to_string() };
        let mut all = Table::try_from(settings).map_err(wrong)?;
        // What is not recorded is not serialised, but may be set.
        merge(&mut all, self.merged.clone());
        let mut told = vec![];
        each_leaf("", &all, &mut |key, value| {
            let origin = self.origins.get(&key).map_or(Origin::Default, |layer| Origin::Layer(layer.clone()));
            told.push(Told { key, value: value.clone(), origin });
        });
        Ok(told)
    }

    fn layer(mut self, name: &str, table: Table, author: Author) -> Result<Self, ConfigError> {
        let of_model = |key: &str| table.get("model").and_then(|model| model.get(key));
        if author == Author::Anybody && of_model("allow_torchscript").is_some() {
            let why = "model.allow_torchscript may only be set in your own settings, the environment or with \
                       --allow-torchscript";
            return Err(ConfigError::Value { layer: name.into(), why: why.into() });
        }
        if author == Author::Anybody && of_model("onnxruntime").is_some() {
            let why = "model.onnxruntime names code, and may only be set in your own settings or the environment";
            return Err(ConfigError::Value { layer: name.into(), why: why.into() });
        }
        if let Some(path) = of_model("path") {
            let anywhere = path.as_str().is_some_and(|path| Path::new(path).is_absolute());
            let own = author == Author::User || (author == Author::UsersFile && anywhere);
            self.model_named_by_others = (!own).then(|| name.to_owned());
        }
        each_leaf("", &table, &mut |key, _| drop(self.origins.insert(key, name.to_owned())));
        merge(&mut self.merged, table);
        check(name, &self.merged)?; // the layers below passed, so the fault is in this one
        Ok(self)
    }
}

fn unicode<'a>(layer: &str, text: &'a OsStr) -> Result<&'a str, ConfigError> {
    let why = || format!("expected text in UTF-8, got {text:?}");
    text.to_str().ok_or_else(|| ConfigError::Value { layer: layer.into(), why: why() })
}

/// Values that are not tables, with their dotted keys; plain ones before tables, as TOML has them.
fn each_leaf(above: &str, table: &Table, see: &mut impl FnMut(String, &Value)) {
    let dotted = |key: &str| if above.is_empty() { key.to_owned() } else { format!("{above}.{key}") };
    for (key, value) in table.iter().filter(|(_, value)| !value.is_table()) {
        see(dotted(key), value);
    }
    for (key, value) in table {
        if let Value::Table(inner) = value {
            each_leaf(&dotted(key), inner, see);
        }
    }
}

fn merge(below: &mut Table, above: Table) {
    for (key, value) in above {
        match (below.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => merge(below, above),
            (_, value) => drop(below.insert(key, value)),
        }
    }
}

/// A variable's text as the TOML value that it looks like, or as a string.
fn text(value: &str) -> Value {
    format!("v = {value}").parse::<Table>().ok().and_then(|mut t| t.remove("v")).unwrap_or_else(|| value.into())
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

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
    fn a_file_names_a_model_by_its_own_word_until_the_user_names_one() {
        let (_dir, path) = file("[model]\npath = \"/somewhere/net.pt\"\n");
        let named_by = |layers: &Layers| layers.model_named_by_others().map(str::to_owned);
        let others = Layers::default().file(Some(&path)).unwrap();
        assert_eq!(named_by(&others), Some(path.display().to_string()));
        let (flag, key) = ("--model", "model.path");
        assert_eq!(named_by(&others.clone().set(flag, key, "net.pt").unwrap()), None);
        let variable = [("LAPWING_MODEL__PATH".into(), "net.pt".into())];
        assert_eq!(named_by(&others.environment(variable.into_iter()).unwrap()), None);
        let own = Layers::default().own_file(&path).unwrap();
        assert_eq!(named_by(&own), None);
        assert_eq!(own.resolve().unwrap().model.path.as_deref(), Some(Path::new("/somewhere/net.pt")));
        // What this path leads to depends on the folder.
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
        assert!(error.contains("model.allow_torchscript may only be set in your own settings"), "{error}");
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
    fn each_setting_tells_where_it_comes_from() {
        let (_dir, path) = file("[control]\nspeed_mph = 12\nkp = 0.2\n[model]\nonnxruntime = \"/lib/ort.so\"\n");
        let error = Layers::default().file(Some(&path)).unwrap_err().to_string();
        assert!(error.contains("model.onnxruntime names code, and may only be set in your own settings"), "{error}");
        let layers = Layers::default().own_file(&path).unwrap().set("--speed", "control.speed_mph", 20.0).unwrap();
        let told = layers.told().unwrap();
        let get = |key: &str| {
            let found = told.iter().find(|told| told.key == key).unwrap();
            (found.value.to_string(), found.origin.clone())
        };
        let by_file = Origin::Layer(path.display().to_string());
        assert_eq!(get("control.speed_mph"), ("20.0".into(), Origin::Layer("--speed".into())));
        assert_eq!(get("control.kp"), ("0.2".into(), by_file.clone()));
        assert_eq!(get("control.ki"), ("0.002".into(), Origin::Default));
        assert_eq!(get("model.onnxruntime"), ("\"/lib/ort.so\"".into(), by_file));
        assert_eq!(serde_json::to_string(&Origin::Default).unwrap(), "\"default\"");
        assert_eq!(serde_json::to_string(&Origin::Layer("--speed".into())).unwrap(), "\"--speed\"");
    }

    #[test]
    fn each_layer_wins_over_the_one_below() {
        let (_dir, path) = file("[control]\nspeed_mph = 12\nkp = 0.2\n");
        let variables = [("LAPWING_CONTROL__SPEED_MPH".into(), "15.5".into())];
        let layers = Layers::default().file(Some(&path)).unwrap().environment(variables.into_iter()).unwrap();
        let settings = layers.clone().resolve().unwrap();
        assert_eq!((settings.control.speed_mph.get(), settings.control.kp, settings.control.ki), (15.5, 0.2, 0.002));
        let settings = layers.set("--speed", "control.speed_mph", 20.0).unwrap().resolve().unwrap();
        assert_eq!(settings.control.speed_mph.get(), 20.0);
    }

    #[test]
    fn values_that_only_together_are_valid_may_come_from_several_layers_in_any_order() {
        let (message, room) =
            (("LAPWING_BRIDGE__LIMITS__MESSAGE_MIB", "40"), ("LAPWING_BRIDGE__LIMITS__IN_FLIGHT_MIB", "128"));
        for both in [[message, room], [room, message]] {
            assert_eq!(environment(&both).unwrap().resolve().unwrap().bridge.limits.message_mib, 40);
        }
        let guard = ("LAPWING_BRAKE__GUARD", "model");
        let error = environment(&[message]).unwrap().resolve().unwrap_err().to_string();
        assert!(error.starts_with("environment variable LAPWING_BRIDGE__LIMITS__MESSAGE_MIB: bridge"), "{error}");
        let layers = environment(&[guard]).unwrap();
        assert!(layers.clone().set("--brake-model", "brake.model", "net.safetensors").unwrap().resolve().is_ok());
        let error = layers.resolve().unwrap_err().to_string();
        let expected =
            "environment variable LAPWING_BRAKE__GUARD: brake.guard: expected brake.model to be the network's file";
        assert!(error.starts_with(expected), "{error}");
    }

    #[test]
    fn a_variable_with_one_underscore_after_its_section_is_refused_with_the_right_name() {
        for (wrong, right) in [
            ("LAPWING_CONTROL_SPEED_MPH", "LAPWING_CONTROL__SPEED_MPH"),
            ("LAPWING_BRIDGE_LIMITS_MESSAGE_MIB", "LAPWING_BRIDGE__LIMITS__MESSAGE_MIB"),
        ] {
            let error = environment(&[(wrong, "12")]).unwrap_err().to_string();
            assert!(error.ends_with(&format!("as in {right}")), "{error}");
        }
        assert!(environment(&[("LAPWING_MODEL_CACHE", "12")]).is_ok(), "no setting of ours");
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

    #[cfg(unix)]
    #[test]
    fn a_path_that_is_no_text_is_refused_and_not_changed() {
        use std::os::unix::ffi::OsStrExt;
        let name = OsStr::from_bytes(b"runs\xff");
        let error = Layers::default().set_path("--recordings", "recording.dir", Path::new(name)).unwrap_err();
        assert_eq!(error.to_string(), r#"--recordings: expected text in UTF-8, got "runs\xFF""#);
        let variable = ("LAPWING_RECORDING__DIR".into(), name.to_owned());
        let error = Layers::default().environment([variable].into_iter()).unwrap_err().to_string();
        assert!(error.starts_with("environment variable LAPWING_RECORDING__DIR: expected text in UTF-8"), "{error}");
        let others = [("PATH".into(), name.to_owned()), (name.to_owned(), "1".into())];
        assert_eq!(Layers::default().environment(others.into_iter()).unwrap().resolve().unwrap(), Settings::default());
    }

    #[test]
    fn a_misspelt_setting_is_known_for_what_was_meant() {
        let error = |key: &str| Layers::default().set("--flag", key, 1).unwrap_err().to_string();
        assert!(error("thresholds.max_colisions").ends_with("; did you mean \"max_collisions\"?"));
        assert!(!error("thresholds.x").contains("did you mean"));
    }

    #[test]
    fn a_missing_file_is_fine_unless_it_was_named() {
        let error = Layers::default().file(Some(Path::new("/nowhere/lapwing.toml"))).unwrap_err();
        assert!(matches!(error, ConfigError::Read { .. }));
    }
}
