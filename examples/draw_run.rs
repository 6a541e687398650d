//! Draws `recordings/plain-road.mcap`, the run that tests and `make drive`
//! replay: a plain road through two bends, seen from the stock simulator's camera,
//! steered as the road bends.
//!
//! ```sh
//! cargo run --release --example draw_run -- recordings plain-road
//! ```
//! Same bytes at each run: no clock, and noise from a hash of the place on the ground.

use std::{f64::consts::TAU, fs, path::Path, time::Duration};

use image::{ExtendedColorType, codecs::jpeg::JpegEncoder};
use lapwing::{
    protocol::{CameraImage, Dialect, Telemetry, Truth},
    recording::{By, CommandRecord, EventRecord, Item, Recorder, RecorderOptions, RunHeader},
    units::{Degrees, Mph, Throttle},
};

const WIDTH: usize = 320;
const HEIGHT: usize = 160;
const FRAMES: u32 = 225;
const HZ: f64 = 15.0;

/// The stock centre camera: vertical field of view 60 degrees, pitched 9.5 degrees down, 1.26 m above the road.
const FOCAL_PX: f64 = 138.56;
const PITCH_DEG: f64 = 9.5;
const CAMERA_HEIGHT_M: f64 = 1.26;

const WHEELBASE_M: f64 = 2.87;
const HALF_ROAD_M: f64 = 3.35;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(dir), Some(name)) = (arguments.next(), arguments.next()) else {
        return Err("usage: draw_run DIR NAME".into());
    };
    let header = RunHeader {
        name_hint: None,
        dialect: Some(Dialect::Term1),
        model: None,
        seed: Some(0),
        config: serde_json::json!({ "drawn_by": "examples/draw_run.rs" }),
        lapwing: env!("CARGO_PKG_VERSION").to_owned(),
        started: "2026-11-21T00:00:00Z".parse()?,
    };
    let recorder = Recorder::create(Path::new(&dir), header, RecorderOptions { queue: 8 * FRAMES as usize })?;
    let mut travelled = 0.0;
    for i in 0..FRAMES {
        let t = f64::from(i) / HZ;
        let speed = Mph::new(9.0 + 6.0 * (1.0 - (-t / 4.0).exp()))?;
        travelled += speed.metres_per_second().get() / HZ;
        let wheel = Degrees::new((WHEELBASE_M * curvature(travelled)).atan().to_degrees())?;
        let throttle = Throttle::new(0.2)?;
        let at = Duration::from_secs_f64(t);
        let image = CameraImage::default();
        recorder.record(
            at,
            Item::Telemetry(Telemetry { steering: wheel, throttle, speed, image, truth: Truth::default() }),
        );
        recorder.record(at, Item::Frame(encode(&draw(travelled))?.into()));
        recorder.record(
            at,
            Item::Command(CommandRecord {
                by: By::Human,
                steering: wheel.steering(),
                throttle,
                prediction: None,
                p: None,
                i: None,
                saturated: false,
                decode_ns: 0,
                preprocess_ns: 0,
                forward_ns: 0,
                driver_ns: 0,
                latency_ns: None,
            }),
        );
    }
    let end = Duration::from_secs_f64(f64::from(FRAMES) / HZ);
    recorder.record(end, Item::Event(EventRecord::RunEnded { why: "the drawn road ends".into() }));
    let report = recorder.finish();
    if let Some(error) = report.error {
        return Err(error.into());
    }
    let path = Path::new(&dir).join(name).with_extension("mcap");
    fs::rename(&report.path, &path)?;
    println!("{}: {} frames, {} bytes", path.display(), report.frames, report.bytes);
    Ok(())
}

/// The road's curvature, 1/m, positive to the right: straight, a left bend, a right one.
fn curvature(s: f64) -> f64 {
    -0.02 * (TAU * (s - 12.0).max(0.0) / 60.0).sin()
}

/// The picture from a car on the centre line after `s` metres: each pixel is followed to the ground.
fn draw(s: f64) -> Vec<u8> {
    let (sin, cos) = PITCH_DEG.to_radians().sin_cos();
    let mut rgb = Vec::with_capacity(WIDTH * HEIGHT * 3);
    for row in 0..HEIGHT {
        for column in 0..WIDTH {
            let right = (column as f64 + 0.5 - WIDTH as f64 / 2.0) / FOCAL_PX;
            let down = (row as f64 + 0.5 - HEIGHT as f64 / 2.0) / FOCAL_PX;
            // The ray (right, down, 1) turned by the camera's pitch.
            let (falls, forward) = (down * cos + sin, cos - down * sin);
            let colour = if row > 142 + (column.abs_diff(WIDTH / 2)).pow(2) / 1600 {
                [38.0, 42.0, 46.0] // the bonnet
            } else if falls <= 0.004 {
                let height = 1.0 - row as f64 / HEIGHT as f64;
                [150.0 - 40.0 * height, 185.0 - 20.0 * height, 215.0] // sky
            } else {
                let distance = CAMERA_HEIGHT_M / falls;
                ground(s, distance * right, distance * forward)
            };
            rgb.extend(colour.map(|c| c.clamp(0.0, 255.0) as u8));
        }
    }
    rgb
}

/// The colour of the ground `right` and `ahead` metres from the car.
fn ground(s: f64, right: f64, ahead: f64) -> [f64; 3] {
    // A circle's first term is enough for as far as the road can be told from the grass.
    let offset = right - 0.5 * curvature(s + 0.5 * ahead) * ahead * ahead;
    let grain = noise((s + ahead) * 4.0, offset * 4.0) * 14.0 / (1.0 + 0.05 * ahead);
    let edge = offset.abs() - HALF_ROAD_M;
    let colour = match edge {
        e if e.abs() < 0.15 => [205.0, 180.0, 70.0], // yellow line
        e if e < 0.0 => [112.0, 110.0, 108.0],       // asphalt
        e if e < 1.2 => [172.0, 158.0, 128.0],       // verge
        _ => [88.0, 118.0, 62.0],                    // grass
    };
    colour.map(|c| c + grain)
}

/// From -1 to 1 for a place, the same at each call.
fn noise(x: f64, y: f64) -> f64 {
    let mut hash = (x.floor() as i64 as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    hash ^= (y.floor() as i64 as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
    hash = (hash ^ (hash >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (hash >> 40) as f64 / f64::from(1u32 << 23) - 1.0
}

fn encode(rgb: &[u8]) -> Result<Vec<u8>, image::ImageError> {
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, 75).encode(rgb, WIDTH as u32, HEIGHT as u32, ExtendedColorType::Rgb8)?;
    Ok(jpeg)
}
