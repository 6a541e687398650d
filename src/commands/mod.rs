//! One file per verb. Results go to stdout, diagnostics to stderr.

#[macro_use]
mod terminal;

mod brake;
#[cfg(all(feature = "networks", feature = "simulator"))]
mod closed_loop;
#[cfg(feature = "networks")]
mod dataset;
#[cfg(feature = "bridge")]
mod doctor;
#[cfg(feature = "simulator")]
mod drive;
#[cfg(feature = "networks")]
mod evaluate;
#[cfg(feature = "networks")]
mod explain;
#[cfg(all(feature = "bridge", feature = "simulator"))]
mod foxglove;
#[cfg(any(feature = "simulator", feature = "bridge"))]
mod guards;
#[cfg(feature = "simulator")]
mod locate;
#[cfg(feature = "simulator")]
mod marl;
#[cfg(feature = "networks")]
mod model;
#[cfg(feature = "networks")]
mod model_files;
mod outputs;
#[cfg(all(feature = "bridge", feature = "simulator"))]
mod paged;
mod program;
#[cfg(feature = "simulator")]
mod record;
#[cfg(feature = "simulator")]
mod recorded_world;
#[cfg(feature = "networks")]
mod replay;
#[cfg(feature = "simulator")]
mod score;
#[cfg(feature = "bridge")]
mod serve;
#[cfg(all(feature = "bridge", feature = "simulator"))]
mod server;
#[cfg(feature = "simulator")]
mod simulate;
#[cfg(all(feature = "networks", feature = "simulator"))]
mod suite;
mod thresholds;
#[cfg(all(feature = "networks", feature = "simulator"))]
mod train;
#[cfg(feature = "simulator")]
mod world;

use std::{
    fs,
    io::{self, IsTerminal},
    net::{IpAddr, SocketAddr},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use tracing_subscriber::{EnvFilter, filter::LevelFilter};

#[cfg(all(feature = "networks", feature = "simulator"))]
use model::suits_our_cameras;
#[cfg(feature = "networks")]
use model::{allowing, load_model, refuse_strangers_code, thinking_layers};
#[cfg(feature = "bridge")]
use model::{explaining, load_models};
use outputs::print;
#[cfg(feature = "networks")]
use outputs::sorted_json;
pub use terminal::exit_at_once;

use crate::cli::{Cli, Driving, Verb};
use lapwing_core::{
    config::{self, ConfigError, Layers},
    drive::{Observer, ObserverError},
    perception,
    recording::{Recorder, RecordingReport},
    turn::Turn,
    words::{count, suggesting},
};

/// How a verb ended, as shown by the exit status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ended {
    Passed,
    Failed,
    /// Finished, but below a threshold that the user set.
    Missed,
}

/// Runs the verb, and returns the exit status: 0 passed, 1 failed, 2 wrong usage, 3 finished below a threshold.
pub fn run(cli: Cli) -> u8 {
    terminal::outlive_full_files();
    let log = match log_filter(std::env::var("LAPWING_LOG").ok().as_deref()) {
        Ok(log) => log,
        Err(why) => {
            say!("error: LAPWING_LOG: {why}");
            return 2;
        }
    };
    tracing_subscriber::fmt()
        .with_env_filter(log)
        .with_writer(|| terminal::Log)
        .with_ansi(io::stderr().is_terminal() && !is_plain())
        .with_target(false)
        .init();
    let config = cli.config.as_deref();
    let ended = match cli.verb {
        #[cfg(feature = "simulator")]
        Verb::Drive(arguments) => drive::run(arguments, config),
        #[cfg(feature = "simulator")]
        Verb::Simulate(arguments) => simulate::run(arguments, config),
        #[cfg(feature = "simulator")]
        Verb::Record(arguments) => record::run(&arguments, config),
        #[cfg(all(feature = "networks", feature = "simulator"))]
        Verb::Train(arguments) => limit_pictures(config).and_then(|()| train::run(arguments, config)),
        #[cfg(feature = "networks")]
        Verb::Evaluate(arguments) => limit_pictures(config).and_then(|()| evaluate::run(arguments)),
        #[cfg(feature = "networks")]
        Verb::Explain(arguments) => limit_pictures(config).and_then(|()| explain::run(&arguments)),
        #[cfg(feature = "bridge")]
        Verb::Serve(arguments) => serve::run(arguments, config),
        #[cfg(all(feature = "networks", feature = "simulator"))]
        Verb::Replay(arguments) if arguments.closed_loop => closed_loop::run(&arguments, config),
        #[cfg(feature = "networks")]
        Verb::Replay(arguments) => replay::run(arguments, config),
        #[cfg(feature = "simulator")]
        Verb::Locate(arguments) => limit_pictures(config).and_then(|()| locate::run(&arguments)),
        #[cfg(feature = "simulator")]
        Verb::Score(arguments) => score::run(&arguments, config),
        Verb::Brake(arguments) => brake::run(&arguments, config),
        #[cfg(feature = "simulator")]
        Verb::Marl(arguments) => marl::run(&arguments),
        #[cfg(all(feature = "networks", feature = "simulator"))]
        Verb::Suite(arguments) => suite::run(&arguments, config),
        #[cfg(all(feature = "networks", feature = "simulator"))]
        Verb::Merge(arguments) => suite::merge(&arguments),
        #[cfg(feature = "networks")]
        Verb::Dataset(arguments) => limit_pictures(config).and_then(|()| dataset::run(arguments)),
        #[cfg(feature = "bridge")]
        Verb::Doctor(arguments) => doctor::run(arguments, config),
        #[cfg(feature = "networks")]
        Verb::Model(arguments) => limit_pictures(config).and_then(|()| model_files::run(&arguments)),
        Verb::Config(arguments) => program::config(&arguments, config),
        Verb::Completions(arguments) => program::completions(&arguments),
        Verb::Man(arguments) => program::man(&arguments),
    };
    match ended {
        Ok(Ended::Passed) => 0,
        Ok(Ended::Failed) => 1,
        Ok(Ended::Missed) => 3,
        Err(error) => {
            say!("error: {}", told(&error));
            if outputs::is_usage(&error) { 2 } else { 1 }
        }
    }
}

/// Which messages are logged: `LAPWING_LOG`, in the words of `tracing`.
fn log_filter(told: Option<&str>) -> Result<EnvFilter, String> {
    let Some(told) = told.filter(|told| !told.trim().is_empty()) else {
        return Ok(EnvFilter::new("lapwing=info,warn"));
    };
    let is_part = |word: &str| {
        word.contains(['=', '[']) || word.contains("::") || word == "lapwing" || word.starts_with("lapwing_")
    };
    // A single word that is no level would be taken for the name of a part, and switch off all others.
    let is_known = |word: &str| word.parse::<LevelFilter>().is_ok() || is_part(word);
    match told.split(',').map(str::trim).find(|word| !word.is_empty() && !is_known(word)) {
        Some(word) => Err(format!("expected off, error, warn, info, debug, trace or PART=LEVEL, got {word:?}")),
        None => EnvFilter::try_new(told).map_err(|why| format!("{told:?}: {why}")),
    }
}

/// Whether colours are not wanted: <https://no-color.org>. Clap and progress bars ask for themselves.
fn is_plain() -> bool {
    std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty())
}

/// An error with its causes, except those that its own message contains, all in the words of [`suggesting`].
fn told(error: &anyhow::Error) -> String {
    let said = |cause: &(dyn std::error::Error + 'static)| suggesting(&cause.to_string());
    let add = |told: String, cause: String| if told.contains(&cause) { told } else { format!("{told}: {cause}") };
    error.chain().skip(1).map(said).fold(suggesting(&error.to_string()), add)
}

/// Ctrl-C, SIGTERM or a terminal that was closed, for a loop that must end in an orderly way.
#[derive(Clone)]
struct Interrupted(Arc<AtomicBool>);

impl Interrupted {
    /// Whether the loop should end.
    fn is_pressed(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl<W: ?Sized> Observer<W> for Interrupted {
    fn turn(&mut self, _: &W, _: &Turn) -> Result<(), ObserverError> {
        Ok(())
    }

    fn has_seen_enough(&self) -> bool {
        self.is_pressed()
    }
}

/// Listens for them from now on; a second Ctrl-C ends the program at once. Verbs call it before they make anything that
/// has to be closed.
fn interrupted() -> Interrupted {
    let pressed = Interrupted(Arc::default());
    let listen = || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let asked = {
            let _inside = runtime.enter();
            terminal::Asked::listen()?
        };
        io::Result::Ok((runtime, asked))
    };
    let told = pressed.clone();
    match listen() {
        Ok((runtime, mut asked)) => drop(std::thread::spawn(move || {
            runtime.block_on(async {
                asked.first().await;
                told.0.store(true, Ordering::Relaxed);
                asked.again().await;
            });
        })),
        Err(error) => tracing::warn!("Ctrl-C will stop this immediately, without a result: {error}"),
    }
    pressed
}

/// The user's own settings, for all folders: `lapwing/lapwing.toml` in the place that the XDG base directories define.
fn own_settings() -> Option<PathBuf> {
    let named = std::env::var_os("XDG_CONFIG_HOME").map(PathBuf::from).filter(|path| path.is_absolute());
    let folder = named.or_else(|| Some(std::env::home_dir()?.join(".config")))?;
    Some(folder.join("lapwing").join(config::FILE))
}

/// Applies the limit on the size of pictures, for verbs that have no other settings.
fn limit_pictures(config: Option<&Path>) -> anyhow::Result<()> {
    undriven_layers(config).map(drop).map_err(Into::into)
}

/// Settings files and environment. The limit on the size of pictures applies to the whole process from here on.
fn undriven_layers(config: Option<&Path>) -> Result<Layers, ConfigError> {
    let own = own_settings();
    let mut layers = own.as_deref().map_or_else(|| Ok(Layers::default()), |path| Layers::default().own_file(path))?;
    // The user's own file still counts as the user's if it is named explicitly or is in the folder.
    let named = config.unwrap_or(Path::new(config::FILE));
    if !own.is_some_and(|own| is_same_file(&own, named)) {
        layers = layers.file(config)?;
    }
    let layers = layers.environment(std::env::vars_os())?;
    let settings = layers.so_far()?;
    perception::limit_pixels(settings.perception.max_pixels as usize);
    #[cfg(feature = "onnx")]
    if let Some(library) = &settings.model.onnxruntime {
        lapwing_learn::models::onnx::use_library(library);
    }
    Ok(layers)
}

/// Whether both exist and are the same file.
fn is_same_file(one: &Path, other: &Path) -> bool {
    fs::canonicalize(one).is_ok_and(|one| fs::canonicalize(other).is_ok_and(|other| one == other))
}

/// Settings with which runs are recorded, in this folder.
fn recorded_in(layers: Layers, dir: &Path) -> Result<Layers, ConfigError> {
    layers.set_path("--recordings", "recording.dir", dir)?.set("--recordings", "recording.enabled", true)
}

/// Those, then the flags that all driving verbs share.
fn layers(config: Option<&Path>, driving: &Driving) -> Result<Layers, ConfigError> {
    let mut layers = undriven_layers(config)?;
    #[cfg(feature = "networks")]
    if let Some(path) = &driving.model {
        layers = layers.set_path("--model", "model.path", path)?;
    }
    if let Some(speed) = driving.speed {
        layers = layers.set("--speed", "control.speed_mph", speed)?;
    }
    if let Some(law) = driving.speed_law {
        layers = layers.set("--speed-law", "control.speed_law", law)?;
    }
    if let Some(takeover) = driving.takeover {
        layers = layers.set("--takeover", "control.takeover", takeover)?;
    }
    #[cfg(feature = "networks")]
    {
        layers = allowing(layers, &driving.trust)?;
        let settings = layers.so_far()?;
        if let (Some(file), Some(model)) = (layers.model_named_by_others(), &settings.model.path) {
            refuse_strangers_code(file, model, true, &settings)?;
        }
    }
    Ok(layers)
}

/// Turns `HOST` or `HOST:PORT` into the latter, by default with the simulator's port.
fn bridge_address(text: &str) -> Result<String, ConfigError> {
    let port = config::BridgeSettings::default().port;
    let bare = text.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(text);
    if let Ok(ip) = bare.parse::<IpAddr>() {
        return Ok(SocketAddr::new(ip, port).to_string());
    }
    // A number alone is a port that lacks its host, and would be taken for an address.
    let is_host = |host: &str| !host.contains(['/', ':', ' ']) && host.contains(|c: char| !c.is_ascii_digit());
    match text.rsplit_once(':') {
        None if is_host(text) => Ok(format!("{text}:{port}")),
        Some((host, port))
            if port.parse().is_ok_and(|port: u16| port > 0)
                && (is_host(host) || text.parse::<SocketAddr>().is_ok()) =>
        {
            Ok(text.to_owned())
        }
        _ => Err(ConfigError::Value {
            layer: "--connect".into(),
            why: format!("expected HOST or HOST:PORT, such as localhost or 192.168.0.7:{port}, got {text:?}"),
        }),
    }
}

/// Reports answers that a real simulator would not have taken.
fn tell_ignored(lost: u64) {
    if lost > 0 {
        say!("the simulator would have ignored {} from the bridge", count(lost, "answer"));
    }
}

/// Ends the recording of a drive, however it ended. The file of a run in which nothing happened is removed.
fn close(recorder: Recorder) -> Option<RecordingReport> {
    let report = recorder.finish();
    if report.telemetries > 0 || report.lost() > 0 || report.error.is_some() {
        return Some(report);
    }
    if let Err(error) = fs::remove_file(&report.path) {
        tracing::warn!("{}: an empty run is left here: {error}", report.path.display());
    }
    None
}

/// Fails if a run is not whole.
fn whole(report: Option<RecordingReport>) -> anyhow::Result<()> {
    let Some(report) = report else { return Ok(()) };
    let lost = report.lost();
    if let Some(error) = report.error {
        return Err(error.into());
    }
    anyhow::ensure!(lost == 0, "{}: {} could not be recorded", report.path.display(), count(lost, "item"));
    Ok(())
}

#[cfg(test)]
mod tests {
    use lapwing_score::suite::Suite;

    use super::{log_filter, told};

    #[test]
    fn a_wrong_value_in_a_file_is_told_once_and_without_names_of_types() {
        for (text, expected) in [
            ("laps = 1.5", "expected a whole number of at least 0"),
            ("lap = 1", "; did you mean \"laps\"?"),
            ("conditions = [3]", "expected "),
        ] {
            let wrong = Suite::parse(text).map(drop).unwrap_err();
            let said = told(&anyhow::Error::new(wrong).context("suite.toml"));
            assert!(said.starts_with("suite.toml: suite: TOML parse error at line 1"), "{said}");
            assert_eq!((said.matches("TOML parse error").count(), said.matches(expected).count()), (1, 1), "{said}");
            assert!(!said.contains("u32") && !said.contains("struct"), "{said}");
        }
    }

    #[test]
    fn a_word_that_is_no_level_is_refused_and_not_taken_for_a_part() {
        for known in [
            None,
            Some(""),
            Some("warn"),
            Some("ERROR"),
            Some("off"),
            Some("lapwing=debug,warn"),
            Some("lapwing_core=trace"),
        ] {
            assert!(log_filter(known).is_ok(), "{known:?}");
        }
        for wrong in ["warning", "loud", "lapwing:debug", "lapwing=loud", "lapwing=[[", "info,verbose"] {
            assert!(log_filter(Some(wrong)).is_err(), "{wrong}");
        }
        assert_eq!(
            log_filter(Some("warning")).unwrap_err(),
            "expected off, error, warn, info, debug, trace or PART=LEVEL, got \"warning\""
        );
    }
}
