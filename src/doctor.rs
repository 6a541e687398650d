//! What `lapwing doctor` finds: the libtorch, the model and its speed, where runs are recorded, and what is wrong.

use std::{fmt, io, net::SocketAddr, path::PathBuf, time::Instant};

use serde::Serialize;

use lapwing_core::{
    config::Settings,
    driver::Driver,
    files,
    protocol::{CameraImage, Observation, Sight, Telemetry, Truth},
    units::{Degrees, Mph, Throttle},
};
use lapwing_learn::{models::LoadedModel, nn::runtime};
use lapwing_live::bridge::Listener;

/// What was found; as JSON, what `lapwing doctor --json` prints. Its [`Display`](fmt::Display) is for people.
#[derive(Debug, Clone, Serialize)]
pub struct Findings {
    /// The version of this program.
    pub lapwing: &'static str,
    /// The libtorch in use.
    pub libtorch: runtime::Libtorch,
    /// The model that drives, where one can be used.
    pub model: Option<String>,
    /// The median time from a JPEG to a command, in milliseconds, with that model.
    pub driver_ms: Option<f64>,
    /// Folder of the runs.
    pub recordings: PathBuf,
    /// What is wrong, in words; empty if all is well.
    pub troubles: Vec<String>,
}

/// Checks all that a drive with these settings needs. `model` is the one that they name, loaded, or why it cannot be.
///
/// # Errors
/// The system grants no runtime to try the port with.
pub fn examine(settings: &Settings, model: Result<LoadedModel, String>) -> io::Result<Findings> {
    let mut troubles = Vec::new();
    let model = model.map_err(|why| troubles.push(format!("the model cannot be used: {why}"))).ok();
    let libtorch = runtime::libtorch();
    troubles.extend(libtorch.troubles());
    let driver_ms = model.as_ref().map(|model| {
        let mut driver = Driver::new(model.pilot(), &settings.control, Instant::now);
        median_answer_ms(&mut driver)
    });
    let recordings = settings.recording.dir.clone();
    if let Err(error) = files::check_folder(&recordings) {
        troubles.push(format!("runs cannot be recorded in {}: {error}", recordings.display()));
    }
    let address = SocketAddr::new(settings.bridge.bind, settings.bridge.port);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    if let Err(error) = runtime.block_on(Listener::bind(address)) {
        troubles.push(error.to_string());
    }
    let model = model.map(|model| model.name().to_owned());
    Ok(Findings { lapwing: env!("CARGO_PKG_VERSION"), libtorch, model, driver_ms, recordings, troubles })
}

impl fmt::Display for Findings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Findings { lapwing, libtorch, model, driver_ms, recordings, troubles } = self;
        writeln!(f, "lapwing     {lapwing}\nlibtorch    {libtorch}")?;
        writeln!(f, "model       {}", model.as_deref().unwrap_or("none"))?;
        if let Some(ms) = driver_ms {
            writeln!(f, "driver      {ms:.2} ms from JPEG to command")?;
        }
        writeln!(f, "recordings  {}", recordings.display())?;
        if troubles.is_empty() {
            return f.write_str("all is well");
        }
        f.write_str(&troubles.iter().map(|trouble| format!("trouble     {trouble}")).collect::<Vec<_>>().join("\n"))
    }
}

/// The median of some answers to a grey picture.
fn median_answer_ms(driver: &mut Driver) -> f64 {
    let telemetry = Telemetry {
        steering: Degrees::ZERO,
        throttle: Throttle::ZERO,
        speed: Mph::ZERO,
        image: CameraImage::Jpeg(grey_jpeg().into()),
        truth: Truth::default(),
    };
    let observation = Observation { at: Default::default(), sight: Sight::Telemetry(telemetry) };
    let mut times: Vec<f64> = (0..20).map(|_| driver.drive(&observation).1.total.as_secs_f64() * 1e3).collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
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
    use lapwing_core::config::Layers;

    use super::*;

    fn examined(model: Result<LoadedModel, String>) -> Findings {
        let settings = Layers::default().set("test", "bridge.port", 0).unwrap();
        let settings = settings.set("test", "recording.dir", env!("CARGO_MANIFEST_DIR")).unwrap().resolve().unwrap();
        examine(&settings, model).unwrap()
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
    fn a_model_that_cannot_be_used_is_a_trouble_and_the_rest_is_still_examined() {
        let findings = examined(Err("x.pt: no such file".into()));
        assert_eq!(findings.troubles, ["the model cannot be used: x.pt: no such file"]);
        assert_eq!((findings.model.as_deref(), findings.driver_ms), (None, None));
        let told = findings.to_string();
        assert!(told.contains("\nmodel       none\nrecordings  "), "{told}");
        assert!(told.ends_with("\ntrouble     the model cannot be used: x.pt: no such file"), "{told}");
    }
}
