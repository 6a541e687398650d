//! The corpus of the fuzzers, replayed without one: whatever was once found stays mended, on every machine.

use std::{
    collections::BTreeMap,
    fs,
    panic::catch_unwind,
    path::{Path, PathBuf},
    time::Instant,
};

use base64::{Engine, engine::general_purpose::STANDARD};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use lapwing_core::{
    protocol::number::Culture,
    protocol::{Truth, encode_superset, encode_telemetry},
};
use serde_json::json;

use crate::recording;

#[path = "../fuzz/targets.rs"]
mod targets;

use targets::TARGETS;

fn corpus(target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target)
}

/// No single input may keep a reader longer than this, on a busy machine and unoptimised.
const LONGEST_S: f64 = 10.0;

#[test]
fn every_reader_keeps_its_word_for_all_of_the_corpus() {
    for (name, target) in TARGETS {
        let mut files: Vec<_> = fs::read_dir(corpus(name)).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.sort();
        assert!(files.len() >= 4, "{name}: {} files are no corpus", files.len());
        for file in files {
            let data = fs::read(&file).unwrap();
            let began = Instant::now();
            assert!(catch_unwind(|| target(&data)).is_ok(), "{name} fails for {}", file.display());
            let took = began.elapsed().as_secs_f64();
            assert!(took < LONGEST_S, "{name} takes {took:.1} s for {}", file.display());
        }
    }
}

#[test]
fn every_fuzzer_has_its_function_and_its_file() {
    let manifest = fs::read_to_string(corpus("../Cargo.toml")).unwrap();
    for (name, _) in TARGETS {
        assert!(manifest.contains(&format!("[[bin]]\nname = \"{name}\"\n")), "{name}");
        let file = fs::read_to_string(corpus("../fuzz_targets").join(format!("{name}.rs"))).unwrap();
        assert!(file.contains(&format!("targets::{name}(data)")), "{name}: {file}");
    }
    assert_eq!(manifest.matches("[[bin]]").count(), TARGETS.len());
}

#[test]
#[ignore = "writes what the fuzzers begin with into fuzz/corpus: once a reader has something new to read"]
fn seeds_are_written() {
    for (target, seeds) in seeds() {
        let folder = corpus(target);
        fs::create_dir_all(&folder).unwrap();
        for (i, seed) in seeds.into_iter().enumerate() {
            fs::write(folder.join(format!("seed-{i:02}")), seed).unwrap();
        }
    }
}

/// Inputs that each reader accepts, or nearly does.
fn seeds() -> [(&'static str, Vec<Vec<u8>>); 11] {
    let payloads = payloads();
    let bytes = |texts: &[&str]| texts.iter().map(|text| text.as_bytes().to_vec()).collect::<Vec<_>>();
    let mut packets = bytes(&[
        "2",
        "2probe",
        "3",
        "41",
        "40",
        "1",
        "6",
        r#"0{"sid":"x","pingInterval":25000}"#,
        r#"42["telemetry",null]"#,
        r#"42["telemetry",{}]"#,
        r#"42/sim,17["x",1,2]"#,
        r#"42["te\u006cemetry"]"#,
        r#"42["steer",{"steering_angle":"-1234e-4","throttle":"3000e-4"}]"#,
        r#"42["action",{"steering_angle":"1,5e-1","throttle":"1.000,25"}]"#,
    ]);
    packets.extend(payloads.iter().map(|payload| format!(r#"42["telemetry",{payload}]"#).into_bytes()));
    packets.push(format!(r#"42["car_telemetry",{}]"#, payloads[0]).into_bytes());
    let numbers = Culture::ALL
        .iter()
        .flat_map(|c| [0.0, -0.25, 25.0, -1234.5, 1_234_567.891].map(|value| c.n4(value).into_bytes()))
        .chain(bytes(&["1.5e-5", "-2E3", " 1 ", "NaN", "unendlich", "\u{2212}1\u{a0}234,5000", "4.540283E-05"]))
        .chain([30.25_f64, -1e-7, 1e300, f64::NAN].map(|value| value.to_le_bytes().to_vec()));
    let line = "center_2018_07_16_17_11_43_382.jpg,left_2018_07_16_17_11_43_382.jpg,\
                right_2018_07_16_17_11_43_382.jpg";
    let driving_logs = [
        format!("{line},-0.05,0.5,0,7.495027E-05\n{line},0,1,0,30.18\n"),
        format!("{line}, -0,0858, 0,1286, 0, 12,1822\n"),
        format!("{line},-0,0858,0,1286,0,12,1822\n"),
        "center,steering,throttle,brake,speed,note\nIMG/a.jpg,0.1,0.2,0,3,x\n\"C:\\Doe, Jane\\b.png\",0,0,1,0,y\n"
            .into(),
        "\u{feff}/a/b, c/x.jpg,,,1,1,0,3e1\r\n\r\n/a/y.JPEG,,,-1,0,1,0".into(),
        "center_2020_12_31_23_59_59_950.jpg,,,0,0,0,1\ncenter_2021_01_01_00_00_00_020.jpg,,,0,0,0,1\nx.jpg,,,0,0,0,1\n"
            .into(),
    ];
    let scenarios = ["ccrs", "ccrm", "ccrb", "cpna", "child"].map(|name| source(&format!("scenario/{name}.toml")));
    [
        ("packets", packets),
        ("numbers", numbers.collect()),
        ("telemetry", payloads.into_iter().map(String::into_bytes).collect()),
        ("jpeg", pictures()),
        ("runs", recording::rewritings()),
        ("driving_logs", driving_logs.map(String::into_bytes).into()),
        ("checkpoints", checkpoints()),
        ("tracks", tracks()),
        ("scenarios", scenarios.into()),
        ("settings", settings()),
        ("controls", bytes(&CONTROLS)),
    ]
}

fn source(path: &str) -> Vec<u8> {
    fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/sim/src").join(path)).unwrap()
}

/// What a page asks for.
const CONTROLS: [&str; 9] = [
    r#"{"control":"set-speed","mph":12.5}"#,
    r#"{"control":"set-speed","mph":1e309}"#,
    r#"{"control":"speed-law","law":"quadratic"}"#,
    r#"{"control":"pilot","index":1}"#,
    r#"{"control":"pilot","index":18446744073709551615}"#,
    r#"{"control":"take-over"}"#,
    r#"{"control":"world","track":"random:7","weather":{"rain":0.5},"scenario":"ccrs"}"#,
    r#"{"control":"world","track":"../../etc/passwd","scenario":""}"#,
    r#"{"control":"record","on":true}"#,
];

/// Telemetry of every build and culture.
fn payloads() -> Vec<String> {
    let telemetry: lapwing_core::protocol::Telemetry =
        serde_json::from_value(json!({"steering_deg": -1.25, "throttle": 0.3, "speed_mph": 30.1903})).unwrap();
    let truth: Truth = serde_json::from_value(json!({
        "lap": 2, "waypoint": 17, "crashed": true, "out_of_bounds": 3, "crashes": 1, "distance_m": 2345.6789,
        "cte_m": -0.7598, "brake": 0.25, "sim_time_s": 83.066667, "heading_error_deg": -3.125,
    }))
    .unwrap();
    let rich = lapwing_core::protocol::Telemetry { truth, ..telemetry.clone() };
    let written = Culture::ALL
        .iter()
        .flat_map(|c| [encode_telemetry(&telemetry, "/9j/4AAQ", *c), encode_superset(&rich, "/9j/4AAQ", *c)]);
    let inside = |text: String| text[r#"42["telemetry","#.len()..text.len() - 1].to_owned();
    let common = r#""steering_angle":"0.0000","throttle":"0.0000","speed":"1.0000","image":"x""#;
    let forks = [
        r#""cte":"-0.7598""#,
        r#""pos_x":"1.0","pos_y":"2.0","pos_z":"-3.0","hit":"none","cte":"","track":"lake","lapNumber":"1""#,
        r#""timestamp":"12","lap":1,"sector":2,"next_cte":0.5,"tot_obes":true"#,
        r#""ttc":"1.2346","sim_time_us":"2500000","lapNumber":0,"x":{"y":[1]}"#,
    ];
    let stripped = [r#"{"ptsx":[1,2],"ptsy":[3,4],"speed":1.5}"#, r#"{"speed":"1.5"}"#, "null", "{ }", "[]"];
    written
        .map(inside)
        .chain(forks.map(|fork| format!("{{{common},{fork}}}")))
        .chain(stripped.map(str::to_owned))
        .collect()
}

/// A drawn 48 x 32 picture in each of the ways to pack it, and as base64.
fn pictures() -> Vec<Vec<u8>> {
    let rgb: Vec<u8> = (0..48 * 32 * 3_u32).map(|i| (i / 3 % 48 * 5 + i / 144 * 3 * (i % 3)) as u8).collect();
    let grey = &rgb[..48 * 32];
    let encoded = |pixels: &[u8], colour, set: &dyn Fn(&mut Encoder<&mut Vec<u8>>)| {
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes, 60);
        set(&mut encoder);
        encoder.encode(pixels, 48, 32, colour).unwrap();
        bytes
    };
    let plain = encoded(&rgb, ColorType::Rgb, &|_| {});
    vec![
        encoded(&rgb, ColorType::Rgb, &|e| e.set_progressive(true)),
        encoded(&rgb, ColorType::Rgb, &|e| e.set_progressive_scans(20)),
        encoded(&rgb, ColorType::Rgb, &|e| e.set_sampling_factor(SamplingFactor::F_2_2)),
        encoded(&rgb, ColorType::Rgb, &|e| e.set_restart_interval(2)),
        encoded(&rgb, ColorType::Rgb, &|e| e.set_optimized_huffman_tables(true)),
        encoded(grey, ColorType::Luma, &|_| {}),
        encoded(grey, ColorType::Luma, &|e| e.set_progressive(true)),
        STANDARD.encode(&plain).into_bytes(),
        plain,
    ]
}

/// The headers of all architectures with the tensors that are small, and one that lies.
fn checkpoints() -> Vec<Vec<u8>> {
    let model = include_bytes!("../models/pilotnet.safetensors");
    let length = u64::from_le_bytes(*model.first_chunk().unwrap()) as usize;
    let header: BTreeMap<String, serde_json::Value> = serde_json::from_slice(&model[8..8 + length]).unwrap();
    let file = |change: &dyn Fn(&mut serde_json::Value), tensors: bool| {
        let (mut small, mut data) = (BTreeMap::new(), Vec::new());
        for (name, value) in &header {
            let mut value = value.clone();
            if name == "__metadata__" {
                change(&mut value);
            } else {
                let at = |i: usize| value["data_offsets"][i].as_u64().unwrap() as usize;
                let bytes = &model[8 + length..][at(0)..at(1)];
                if !tensors || bytes.len() > 400 {
                    continue;
                }
                value["data_offsets"] = json!([data.len(), data.len() + bytes.len()]);
                data.extend(bytes);
            }
            small.insert(name, value);
        }
        let mut header = serde_json::to_vec(&small).unwrap();
        header.resize(header.len().next_multiple_of(8), b' ');
        [&(header.len() as u64).to_le_bytes()[..], &header, &data].concat()
    };
    let mut files: Vec<_> = lapwing_learn::nn::Architecture::ALL
        .iter()
        .map(|a| file(&|metadata| metadata["architecture"] = json!(a.name()), false))
        .collect();
    files.push(file(&|_| {}, true));
    files.push(file(&|metadata| metadata["outputs"] = json!("[\"steering\",\"speed\"]"), false));
    files.push(u64::MAX.to_le_bytes().into());
    files
}

/// The lake, and rings of a few control points.
fn tracks() -> Vec<Vec<u8>> {
    let ring = |points: u32, radius: f64, rest: &str| {
        let points: Vec<String> = (0..points)
            .map(|i| f64::from(i) * std::f64::consts::TAU / f64::from(points))
            .map(|a| format!("[{:.1}, 0.0, {:.1}]", radius * a.cos(), radius * a.sin()))
            .collect();
        format!(
            "name = \"ring\"\ntheme = \"jungle\"\nwidth_m = 7.0\nscenery_seed = 3\n\
             start = {{ x = 20.0, y = 0.0, z = 0.0, yaw_deg = 0.0 }}\ncontrol_points = [{}]\n{rest}",
            points.join(", ")
        )
        .into_bytes()
    };
    let stretch = "[[stretch]]\nfrom_m = 50.0\nto_m = 5.0\nside = \"both\"\nedge = \"kerb\"\n";
    vec![ring(8, 20.0, stretch), ring(12, 30.0, "driving_line_m = -1.5\n"), ring(8, 1.0, ""), source("track/lake.toml")]
}

fn settings() -> Vec<Vec<u8>> {
    let all = toml::to_string(&lapwing_core::config::Settings::default()).unwrap();
    [
        all.as_str(),
        "[control]\nspeed_mph = 12\nkp = 0.2\nspeed_law = \"quadratic\"\ntakeover = \"latch\"\n",
        "[bridge]\nport = 0\nbind = \"::1\"\nspeed_unit = \"m/s\"\ngreet = ['[\"a\"]', '[\"b\",{\"c\":1}]']\n",
        "[thresholds]\nmin_completion = 95\nmax_collisions = 0\nmax_cte = 2.5\n",
        "CONTROL__SPEED_MPH=12\nRECORDING__DIR=2026\nBRIDGE__KICK_AFTER_S = 2.5\n",
        "PERCEPTION__MAX_PIXELS=51200\nMODEL__PATH=a.pt\nSIMULATOR__TRACK=random:3\n",
    ]
    .map(|text| text.as_bytes().to_vec())
    .into()
}
