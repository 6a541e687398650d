//! The contents of a run: its header and its items.

use std::{collections::BTreeMap, path::Path};

use bytes::Bytes;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{FORMAT_VERSION, RecordingError};
use crate::{
    pilot::Model,
    protocol::{CameraImage, Dialect, Telemetry},
    turn::{CommandRecord, EventRecord},
};

/// How a run was made, as far as is known when it begins.
#[derive(Debug, Clone, PartialEq)]
pub struct RunHeader {
    /// What was recorded. If a run of an earlier version does not say, its settings do.
    pub kind: RunKind,
    /// What a person calls this run; part of the file's name.
    pub name_hint: Option<String>,
    /// The simulator's dialect.
    pub dialect: Option<Dialect>,
    /// What separates the decimals of the simulator's numbers, which tells its culture: a comma in German, a point in English.
    pub decimal_separator: Option<char>,
    /// Which checkpoint drives.
    pub model: Option<ModelId>,
    /// The seed of everything random in the run.
    pub seed: Option<u64>,
    /// The settings in force, resolved.
    pub config: serde_json::Value,
    /// Version of the program.
    pub lapwing: String,
    /// The wall clock when the run began; every item's time counts from here.
    pub started: jiff::Timestamp,
}

/// What a run is a recording of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RunKind {
    /// A simulator, driven: the project's own, or one that was connected.
    #[default]
    Driven,
    /// The path of a recording, driven along: there are no laps and no obstacles, and the road's width is unknown.
    RecordedPath,
    /// A driving log of the stock simulator's recorder, turned into a run: a human drove, and there were no answers.
    DrivingLog,
}

impl RunKind {
    /// The kind of a run of an earlier version, which shows only in its settings.
    fn by_config(config: &serde_json::Value) -> Self {
        if config.pointer("/world/closed_loop_on").is_some() {
            Self::RecordedPath
        } else if config.get("converted_from").is_some() {
            Self::DrivingLog
        } else {
            Self::Driven
        }
    }
}

/// Which checkpoint drives.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelId {
    /// Its name or file name.
    pub name: String,
    /// SHA-256 of its file, hexadecimal.
    pub sha256: String,
}

impl RunHeader {
    /// The header of a run that this version of Lapwing makes. All else is unknown yet.
    pub fn new(kind: RunKind, config: serde_json::Value, started: jiff::Timestamp) -> Self {
        let lapwing = env!("CARGO_PKG_VERSION").to_owned();
        Self {
            kind,
            name_hint: None,
            dialect: None,
            decimal_separator: None,
            model: None,
            seed: None,
            config,
            lapwing,
            started,
        }
    }
}

impl ModelId {
    /// The identity of a model.
    pub fn of(model: &dyn Model) -> Self {
        Self { name: model.name().to_owned(), sha256: model.sha256().to_owned() }
    }
}

/// One thing that is recorded.
#[derive(Debug, Clone, PartialEq)]
pub enum Item {
    /// What the simulator reported. Its picture is recorded separately, as a [`Frame`](Self::Frame).
    Telemetry(Telemetry),
    /// The JPEG bytes of the telemetry with the same time.
    Frame(Bytes),
    /// The answer to the simulator.
    Command(CommandRecord),
    /// What else happened.
    Event(EventRecord),
}

impl Item {
    /// The item without what is not recorded: no picture inside telemetry, no endless text.
    pub fn lean(mut self) -> Self {
        match &mut self {
            // The picture would keep the whole wire message in memory until it is written.
            Self::Telemetry(telemetry) => telemetry.image = CameraImage::default(),
            Self::Event(event) => event.shorten(),
            Self::Frame(_) | Self::Command(_) => {}
        }
        self
    }
}

/// Since 1970.
pub(super) fn nanoseconds(time: jiff::Timestamp) -> u64 {
    u64::try_from(time.as_nanosecond()).unwrap_or(0)
}

impl RunHeader {
    /// Nanoseconds since 1970, what log times count from.
    pub(super) fn started_ns(&self) -> u64 {
        nanoseconds(self.started)
    }

    /// As the text fields of `lapwing.run`.
    pub(super) fn to_metadata(&self) -> BTreeMap<String, String> {
        let mut fields = BTreeMap::from([
            ("format_version".into(), FORMAT_VERSION.to_string()),
            ("lapwing".into(), self.lapwing.clone()),
            ("started".into(), self.started.to_string()),
            ("config".into(), self.config.to_string()),
        ]);
        let mut optional = |name: &str, value: Option<String>| fields.extend(value.map(|v| (name.to_owned(), v)));
        optional("kind", word(self.kind));
        optional("name", self.name_hint.clone());
        optional("dialect", self.dialect.and_then(word));
        optional("decimal_separator", self.decimal_separator.map(String::from));
        optional("model_name", self.model.as_ref().map(|m| m.name.clone()));
        optional("model_sha256", self.model.as_ref().map(|m| m.sha256.clone()));
        optional("seed", self.seed.map(|s| s.to_string()));
        fields
    }

    /// From the text fields of `lapwing.run`; those it does not know are left alone.
    pub(super) fn from_metadata(path: &Path, mut fields: BTreeMap<String, String>) -> Result<Self, RecordingError> {
        let bad = |field, expected, got: Option<String>| RecordingError::Header {
            path: path.to_owned(),
            field,
            expected,
            got: got.unwrap_or_default().chars().take(80).collect(),
        };
        // The version first: a later format may mean something else by everything that follows.
        let version = fields.remove("format_version");
        let version: u32 = match version.as_deref().and_then(|v| v.parse().ok()) {
            Some(version) => version,
            None => return Err(bad("format_version", "a whole number", version)),
        };
        if version > FORMAT_VERSION {
            return Err(RecordingError::Newer { path: path.to_owned(), got: version });
        }
        let mut required = |field: &'static str| fields.remove(field).ok_or_else(|| bad(field, "a text", None));
        let (lapwing, started, config) = (required("lapwing")?, required("started")?, required("config")?);
        let quoted = |text: String| serde_json::Value::String(text);
        let config = serde_json::from_str(&config).map_err(|_| bad("config", "JSON", Some(config)))?;
        let kind = parsed(fields.remove("kind"), |t| from_value(quoted(t.into())))
            .map_err(|got| bad("kind", "a kind of run that this version of lapwing knows", Some(got)))?;
        Ok(Self {
            kind: kind.unwrap_or_else(|| RunKind::by_config(&config)),
            name_hint: fields.remove("name"),
            dialect: parsed(fields.remove("dialect"), |t| from_value(quoted(t.into())))
                .map_err(|got| bad("dialect", "a dialect that this version of lapwing knows", Some(got)))?,
            decimal_separator: parsed(fields.remove("decimal_separator"), |t| t.parse().ok())
                .map_err(|got| bad("decimal_separator", "one character", Some(got)))?,
            model: fields
                .remove("model_name")
                .map(|name| ModelId { name, sha256: fields.remove("model_sha256").unwrap_or_default() }),
            seed: parsed(fields.remove("seed"), |t| t.parse().ok())
                .map_err(|got| bad("seed", "a whole number", Some(got)))?,
            config,
            lapwing,
            started: started.parse().map_err(|_| bad("started", "a time (RFC 3339)", Some(started)))?,
        })
    }
}

/// The name that a value without fields has in JSON.
fn word(value: impl Serialize) -> Option<String> {
    Some(serde_json::to_value(value).ok()?.as_str()?.to_owned())
}

fn from_value<T: DeserializeOwned>(value: serde_json::Value) -> Option<T> {
    serde_json::from_value(value).ok()
}

/// Reads an optional field; text that cannot be read is returned as the error.
fn parsed<T>(text: Option<String>, read: impl Fn(&str) -> Option<T>) -> Result<Option<T>, String> {
    text.map(|text| read(&text).ok_or(text)).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> RunHeader {
        RunHeader {
            kind: RunKind::Driven,
            name_hint: Some("lake".into()),
            dialect: Some(Dialect::Term1),
            decimal_separator: Some('٫'),
            model: Some(ModelId { name: "pilotnet".into(), sha256: "00ff".into() }),
            seed: Some(u64::MAX),
            config: serde_json::json!({"speed_mph": 15}),
            lapwing: "0.1.0".into(),
            started: "2026-11-21T08:15:30.123456789Z".parse().unwrap(),
        }
    }

    #[test]
    fn a_header_comes_back_from_its_metadata() {
        let read = |header: &RunHeader| RunHeader::from_metadata(Path::new("a.mcap"), header.to_metadata()).unwrap();
        assert_eq!(read(&header()), header());
        let bare =
            RunHeader { name_hint: None, dialect: None, decimal_separator: None, model: None, seed: None, ..header() };
        assert_eq!(read(&bare), bare);
    }

    #[test]
    fn a_header_that_cannot_be_read_says_which_field() {
        let with = |field: &str, text: &str| {
            let mut fields = header().to_metadata();
            fields.insert(field.into(), text.into());
            RunHeader::from_metadata(Path::new("a.mcap"), fields).unwrap_err().to_string()
        };
        assert_eq!(
            with("format_version", "2"),
            "a.mcap: expected a run of format version 1 or older, got 2: update lapwing to read it"
        );
        assert_eq!(with("seed", "-1"), r#"a.mcap: seed in lapwing.run: expected a whole number, got "-1""#);
        assert_eq!(with("started", "now"), r#"a.mcap: started in lapwing.run: expected a time (RFC 3339), got "now""#);
        assert!(with("kind", "dream").contains("expected a kind of run that this version of lapwing knows"));
        assert!(with("decimal_separator", ", ").contains(r#"expected one character, got ", ""#));
        assert!(with("dialect", "klingon").contains("expected a dialect that this version of lapwing knows"));
        let missing = RunHeader::from_metadata(Path::new("a.mcap"), BTreeMap::new()).unwrap_err();
        assert_eq!(missing.to_string(), r#"a.mcap: format_version in lapwing.run: expected a whole number, got """#);
    }

    #[test]
    fn what_a_run_is_stands_in_its_header_and_in_earlier_runs_in_its_settings() {
        let read = |fields| RunHeader::from_metadata(Path::new("a.mcap"), fields).unwrap().kind;
        for kind in [RunKind::Driven, RunKind::RecordedPath, RunKind::DrivingLog] {
            assert_eq!(read(RunHeader { kind, ..header() }.to_metadata()), kind);
        }
        let earlier = |config: &str| {
            let mut fields = header().to_metadata();
            fields.remove("kind");
            fields.insert("config".into(), config.into());
            read(fields)
        };
        assert_eq!(earlier(r#"{"world":{"closed_loop_on":"data","limit_m":1.0}}"#), RunKind::RecordedPath);
        assert_eq!(earlier(r#"{"converted_from":"driving_log.csv"}"#), RunKind::DrivingLog);
        assert_eq!(earlier(r#"{"world":{"track":"lake (recorded)"}}"#), RunKind::Driven, "a name decides nothing");
        assert_eq!(earlier("null"), RunKind::Driven);
    }

    #[test]
    fn a_simulators_payload_is_cut_between_characters() {
        let event = EventRecord::Simulator { name: "x".into(), payload: "é".repeat(2001) };
        let Item::Event(EventRecord::Simulator { payload, .. }) = Item::Event(event).lean() else { panic!() };
        assert_eq!(payload, "é".repeat(2000));
    }
}
