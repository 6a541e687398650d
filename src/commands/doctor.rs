//! `lapwing doctor`: which libtorch, which device, which model, and what is wrong.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    time::Instant,
};

use serde::Serialize;

use super::Ended;
use crate::cli;
use lapwing_core::{
    driver::Driver,
    files,
    protocol::{CameraImage, Observation, Sight, Telemetry, Truth},
    units::{Degrees, Mph, Throttle},
};
use lapwing_learn::nn::runtime;
use lapwing_live::bridge::Listener;

#[derive(Serialize)]
struct Findings {
    lapwing: &'static str,
    libtorch: runtime::Libtorch,
    model: Option<String>,
    driver_ms: Option<f64>,
    recordings: PathBuf,
    troubles: Vec<String>,
}

pub(super) fn run(arguments: cli::Doctor, config: Option<&Path>) -> anyhow::Result<Ended> {
    let settings = super::thinking_layers(config, &arguments.driving, &arguments.thinking)?.resolve()?;
    let mut troubles = Vec::new();
    let model = super::load_model(&settings)
        .map_err(|e| troubles.push(format!("the model cannot be used: {}", super::told(&e))))
        .ok();
    // After the model, which chooses the number of threads.
    let libtorch = runtime::libtorch();
    troubles.extend(libtorch.troubles());
    let driver_ms = model.as_ref().map(|model| {
        let mut driver = Driver::new(model.pilot(), &settings.control, Instant::now);
        time_of_an_answer(&mut driver)
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
    let findings = Findings {
        lapwing: env!("CARGO_PKG_VERSION"),
        libtorch,
        model: model.map(|m| m.name().to_owned()),
        driver_ms,
        recordings,
        troubles,
    };
    if arguments.json {
        super::print(&serde_json::to_string_pretty(&findings)?)?;
    } else {
        super::print(&told(&findings))?;
    }
    Ok(if findings.troubles.is_empty() { Ended::Passed } else { Ended::Failed })
}

fn told(findings: &Findings) -> String {
    let Findings { lapwing, libtorch, model, driver_ms, recordings, troubles } = findings;
    let mut text = format!("lapwing     {lapwing}\nlibtorch    {libtorch}\n");
    text += &format!("model       {}\n", model.as_deref().unwrap_or("none"));
    if let Some(ms) = driver_ms {
        text += &format!("driver      {ms:.2} ms from JPEG to command\n");
    }
    text += &format!("recordings  {}\n", recordings.display());
    match troubles.as_slice() {
        [] => text += "all is well",
        troubles => text += &troubles.iter().map(|t| format!("trouble     {t}")).collect::<Vec<_>>().join("\n"),
    }
    text
}

/// The median of some answers to a grey picture, ms.
fn time_of_an_answer(driver: &mut Driver) -> f64 {
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
