//! What `lapwing doctor` finds: the libtorch, the model and its speed, where runs are recorded, and what is wrong.

use std::{
    fmt, fs, io,
    net::SocketAddr,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use serde::Serialize;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};

use lapwing_core::{
    config::Settings,
    driver::Driver,
    files,
    protocol::{CameraImage, Dialect, Observation, Sight, Telemetry, Truth},
    recording::{Recording, RunHeader, recordings_in},
    units::{Degrees, Mph, Throttle},
};
use lapwing_learn::{models::LoadedModel, nn::runtime};
use lapwing_live::{
    bridge::{BindError, Listener, reached_here},
    page::GREETING,
    viewers,
};

/// What was found; as JSON, what `lapwing doctor --json` prints. Its [`Display`](fmt::Display) is for people.
#[derive(Debug, Clone, Serialize)]
pub struct Findings {
    /// The version of this program.
    pub lapwing: &'static str,
    /// The libtorch in use.
    pub libtorch: runtime::Libtorch,
    /// The model that drives, where one can be used.
    pub model: Option<String>,
    /// The median time from a JPEG to a command, in milliseconds, with that model, without the guard.
    pub driver_ms: Option<f64>,
    /// The guard that brakes in place of the pilot, where one is asked for and can be used.
    pub guard: Option<String>,
    /// Folder of the runs.
    pub recordings: PathBuf,
    /// What the disk has left for runs, in MB, where the system tells it.
    pub free_mb: Option<u64>,
    /// The last simulator that was driven, by the newest run.
    pub last_simulator: Option<LastSimulator>,
    /// Where `serve` would listen, if its port is free.
    pub free_address: Option<SocketAddr>,
    /// Where Lapwing serves already, if it holds the port.
    pub serving: Option<SocketAddr>,
    /// What is wrong, in words; empty if all is well.
    pub troubles: Vec<String>,
}

/// A simulator, as its run tells it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LastSimulator {
    /// The run.
    pub run: PathBuf,
    /// Which build it was.
    pub dialect: Dialect,
    /// What separates the decimals of its numbers, which tells the language of its system; absent in runs of older versions.
    pub decimal_separator: Option<char>,
    /// When the run began, RFC 3339.
    pub started: String,
}

/// A run takes some 13 MB a minute: below half an hour of them, the disk is nearly full.
const SCARCE_MB: u64 = 400;

/// How long a program at the port may take to greet, and in how many bytes.
const PATIENCE: Duration = Duration::from_secs(2);
const GREETING_BYTES: u64 = 4096;

/// Checks all that a drive with these settings needs. `model` is the one that they name, loaded, or why it cannot be; `guard` is
/// the name of the guard that they ask for, if any, or why it cannot be loaded.
///
/// # Errors
/// The system grants no runtime to try the port with.
pub fn examine(
    settings: &Settings,
    model: Result<LoadedModel, String>,
    guard: Result<Option<String>, String>,
) -> io::Result<Findings> {
    let mut troubles = Vec::new();
    let model = model.map_err(|why| troubles.push(format!("the model cannot be used: {why}"))).ok();
    let libtorch = runtime::libtorch();
    troubles.extend(libtorch.troubles());
    let unusable = |why| troubles.push(format!("the guard that brakes in place of the pilot cannot be used: {why}"));
    let guard = guard.map_err(unusable).ok().flatten();
    let driver_ms = model.as_ref().and_then(|model| {
        let mut driver = Driver::new(model.pilot(), &settings.control, Instant::now);
        let answered = median_answer_ms(&mut driver);
        answered.map_err(|why| troubles.push(format!("the model cannot steer by the simulator's pictures: {why}"))).ok()
    });
    let recordings = settings.recording.dir.clone();
    if let Err(error) = files::check_folder(&recordings) {
        let folder = recordings.display();
        troubles.push(format!("runs cannot be recorded in {folder}: {error}; choose another folder with --recordings"));
    }
    troubles.extend(scarce(&recordings));
    let free_mb = free_mb(&recordings);
    let address = SocketAddr::new(settings.bridge.bind, settings.bridge.port);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let bound = runtime.block_on(Listener::bind(address));
    // With port 0, the port that the system chose.
    let free_address = bound.as_ref().map(Listener::address).ok();
    let is_taken = matches!(bound, Err(BindError::Taken { .. }));
    let holder = if is_taken { runtime.block_on(lapwing_at(address)) } else { None };
    let serving = (holder == Some(LapwingPort::Bridge)).then_some(address);
    match (bound, holder) {
        (Ok(_), _) | (_, Some(LapwingPort::Bridge)) => {}
        (_, Some(LapwingPort::Viewers)) => troubles.push(format!(
            "on port {} Lapwing shows drives to Foxglove and Lichtblick (--foxglove): choose another port with --port",
            address.port()
        )),
        (Err(error), None) => troubles.push(error.to_string()),
    }
    let model = model.map(|model| model.name().to_owned());
    let last_simulator = last_simulator(&recordings);
    let lapwing = env!("CARGO_PKG_VERSION");
    Ok(Findings {
        lapwing,
        libtorch,
        model,
        driver_ms,
        guard,
        recordings,
        free_mb,
        last_simulator,
        free_address,
        serving,
        troubles,
    })
}

/// Which of Lapwing's ports is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LapwingPort {
    /// For simulators and the page.
    Bridge,
    /// For Foxglove and Lichtblick.
    Viewers,
}

/// Which of Lapwing's ports the one at this address is, by how it greets; `None` if another program is there.
async fn lapwing_at(address: SocketAddr) -> Option<LapwingPort> {
    let asked = async {
        let mut stream = TcpStream::connect(reached_here(address)).await?;
        stream.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").await?;
        let mut answer = vec![];
        stream.take(GREETING_BYTES).read_to_end(&mut answer).await?;
        io::Result::Ok(String::from_utf8_lossy(&answer).into_owned())
    };
    let answer = tokio::time::timeout(PATIENCE, asked).await.ok()?.ok()?;
    match answer.split_once("\r\n\r\n")?.1 {
        GREETING => Some(LapwingPort::Bridge),
        greeting if viewers::GREETINGS.contains(&greeting) => Some(LapwingPort::Viewers),
        _ => None,
    }
}

/// By the newest run in a folder that was not driven in the headless simulator.
fn last_simulator(folder: &Path) -> Option<LastSimulator> {
    let age = |path: &PathBuf| fs::metadata(path).and_then(|metadata| metadata.modified()).ok();
    let mut runs: Vec<_> = recordings_in(folder).ok()?.into_iter().filter(|path| path.extension().is_some()).collect();
    runs.sort_by_key(age);
    runs.into_iter().rev().find_map(|run| {
        let header = Recording::open(&run).ok()?.header().clone();
        let RunHeader { dialect, decimal_separator, started, config, .. } = header;
        // What a world in this process says of itself.
        if config.get("world").is_some() {
            return None;
        }
        Some(LastSimulator { dialect: dialect?, decimal_separator, started: started.to_string(), run })
    })
}

/// Says so if there is little room for runs in this folder.
pub(crate) fn scarce(recordings: &Path) -> Option<String> {
    let free = free_mb(recordings).filter(|free| *free < SCARCE_MB)?;
    Some(format!("{free} MB are free for {}, and a run takes some 13 MB a minute", recordings.display()))
}

/// What is free for a user in the nearest folder that is there.
#[cfg(unix)]
fn free_mb(folder: &Path) -> Option<u64> {
    use std::{ffi::CString, mem::MaybeUninit, os::unix::ffi::OsStrExt};
    let folder = std::path::absolute(folder).ok()?;
    let there = folder.ancestors().find(|folder| folder.is_dir())?;
    let path = CString::new(there.as_os_str().as_bytes()).ok()?;
    let mut found = MaybeUninit::<libc::statvfs>::uninit();
    // SAFETY: the path ends in a zero, and the system fills the structure if it answers 0.
    let found = unsafe { (libc::statvfs(path.as_ptr(), found.as_mut_ptr()) == 0).then(|| found.assume_init()) }?;
    #[allow(clippy::unnecessary_cast, reason = "the fields have other widths on other systems")]
    Some(found.f_bavail as u64 * found.f_frsize as u64 / 1_000_000)
}

#[cfg(not(unix))]
fn free_mb(_: &Path) -> Option<u64> {
    None
}

impl fmt::Display for Findings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { lapwing, libtorch, model, driver_ms, guard, recordings, .. } = self;
        let Self { free_mb, last_simulator, free_address, serving, troubles, .. } = self;
        writeln!(f, "lapwing     {lapwing}\nlibtorch    {libtorch}")?;
        writeln!(f, "model       {}", model.as_deref().unwrap_or("none"))?;
        if let Some(ms) = driver_ms {
            let without = if guard.is_some() { ", without the guard" } else { "" };
            writeln!(f, "driver      {ms:.2} ms from JPEG to command{without}")?;
        }
        if let Some(guard) = guard {
            writeln!(f, "guard       {guard}")?;
        }
        let room = free_mb.map_or_else(String::new, |mb| format!(", {:.1} GB free", mb as f64 / 1e3));
        writeln!(f, "recordings  {}{room}", recordings.display())?;
        if let Some(LastSimulator { run, dialect, decimal_separator, started }) = last_simulator {
            let dialect = serde_json::to_string(dialect).unwrap_or_default();
            writeln!(f, "simulator   {} was the last, {started} ({})", dialect.trim_matches('"'), run.display())?;
            if let Some(separator) = decimal_separator {
                let advice =
                    if *separator == '.' { "" } else { ": drive.py fails on them, Lapwing reads and answers them" };
                // From a wire or a file: it may be any character.
                writeln!(f, "            it writes numbers as 0{}0000{advice}", separator.escape_debug())?;
            }
        }
        if let Some(address) = serving {
            writeln!(f, "port        {address}: Lapwing is serving there")?;
        }
        if let Some(address) = free_address {
            writeln!(f, "port        {address}: free")?;
        }
        if troubles.is_empty() {
            return f.write_str("all is well");
        }
        f.write_str(&troubles.iter().map(|trouble| format!("trouble     {trouble}")).collect::<Vec<_>>().join("\n"))
    }
}

/// The median of some answers to a grey picture.
fn median_answer_ms(driver: &mut Driver) -> Result<f64, String> {
    let telemetry = Telemetry {
        steering: Degrees::ZERO,
        throttle: Throttle::ZERO,
        speed: Mph::ZERO,
        image: CameraImage::Jpeg(grey_jpeg().into()),
        truth: Truth::default(),
    };
    let observation = Observation { at: Default::default(), sight: Sight::Telemetry(telemetry) };
    let mut times = vec![];
    for _ in 0..20 {
        let trace = driver.drive(&observation).1;
        if let Some(why) = trace.bad_frame() {
            return Err(why.to_owned());
        }
        times.push(trace.total.as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    Ok(times[times.len() / 2])
}

fn grey_jpeg() -> Vec<u8> {
    let mut jpeg = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 75)
        .encode(&[128; 320 * 160 * 3], 320, 160, image::ExtendedColorType::Rgb8)
        .expect("a grey picture can be encoded into memory");
    jpeg
}

#[cfg(test)]
mod tests {
    use lapwing_core::{
        config::Layers,
        recording::{Recorder, RecorderOptions, RunKind},
    };

    use super::*;

    fn examined(model: Result<LoadedModel, String>) -> Findings {
        let settings = Layers::default().set("test", "bridge.port", 0).unwrap();
        let settings = settings.set("test", "recording.dir", env!("CARGO_MANIFEST_DIR")).unwrap().resolve().unwrap();
        examine(&settings, model, Ok(None)).unwrap()
    }

    #[test]
    fn a_healthy_installation_has_a_model_and_no_troubles() {
        let findings = examined(Ok(lapwing_learn::models::built_in(Instant::now).unwrap()));
        assert_eq!(findings.troubles, [""; 0]);
        assert!(findings.driver_ms.unwrap() > 0.0);
        let json = serde_json::to_string(&findings).unwrap();
        assert!(json.starts_with(r#"{"lapwing":""#), "{json}");
        assert!(json.contains(r#","model":"pilotnet (built in)","driver_ms":"#), "{json}");
        assert!(json.ends_with(r#","troubles":[]}"#), "{json}");
        assert!(findings.to_string().ends_with("\nall is well"), "{findings}");
    }

    #[test]
    fn the_last_simulators_locale_shows_in_how_it_writes_numbers() {
        let told = |separator| {
            let simulator = LastSimulator {
                run: "runs/a.mcap".into(),
                dialect: Dialect::Term1,
                decimal_separator: separator,
                started: "2026-11-25T12:00:00Z".into(),
            };
            Findings { last_simulator: Some(simulator), ..examined(Err("none".into())) }.to_string()
        };
        let german = told(Some(','));
        assert!(german.contains("\nsimulator   term1 was the last, 2026-11-25T12:00:00Z (runs/a.mcap)\n"), "{german}");
        assert!(german.contains("\n            it writes numbers as 0,0000: drive.py fails on them"), "{german}");
        assert!(told(Some('.')).contains("\n            it writes numbers as 0.0000\n"));
        assert!(told(Some('\u{1b}')).contains("\n            it writes numbers as 0\\u{1b}0000: "));
        assert!(!told(None).contains("numbers"));
    }

    #[test]
    fn a_run_of_the_headless_simulator_names_no_simulator() {
        let dir = tempfile::tempdir().unwrap();
        let headless = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/lake.mcap");
        fs::copy(headless, dir.path().join("a.mcap")).unwrap();
        assert_eq!(last_simulator(dir.path()), None);
        let config = serde_json::json!({ "settings": {} });
        let header = RunHeader::new(RunKind::Driven, config, jiff::Timestamp::now());
        let header = RunHeader { dialect: Some(Dialect::Term1), ..header };
        let run = Recorder::create(dir.path(), header, RecorderOptions::default()).unwrap().finish().path;
        fs::copy(headless, dir.path().join("b.mcap")).unwrap();
        assert_eq!(last_simulator(dir.path()).map(|simulator| simulator.run), Some(run));
    }

    #[test]
    fn a_model_that_cannot_be_used_is_a_trouble_and_the_rest_is_still_examined() {
        let findings = examined(Err("x.pt: no such file".into()));
        assert_eq!(findings.troubles, ["the model cannot be used: x.pt: no such file"]);
        assert_eq!((findings.model.as_deref(), findings.driver_ms), (None, None));
        let told = findings.to_string();
        assert!(told.contains("\nmodel       none\nrecordings  "), "{told}");
        assert!(told.ends_with("\ntrouble     the model cannot be used: x.pt: no such file"), "{told}");
    }
}
