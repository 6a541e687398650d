use super::{
    super::{Answer, Command, Packet, encode_superset, encode_telemetry, number::Culture},
    *,
};
use crate::units::{Degrees, Metres};

fn decode_in(unit: SpeedUnit, text: &str) -> Result<Option<(Dialect, Telemetry)>, TelemetryError> {
    let message = Bytes::copy_from_slice(text.as_bytes());
    let text = std::str::from_utf8(&message).unwrap();
    let Ok(Packet::Event(event)) = Packet::parse(text) else { panic!("not an event: {text}") };
    let Some(payload) = Payload::read(event.payload)? else { return Ok(None) };
    Ok(Some((payload.dialect(&event.name)?, payload.telemetry(&message, unit)?)))
}

fn decode(text: &str) -> Result<Option<(Dialect, Telemetry)>, TelemetryError> {
    decode_in(SpeedUnit::Mph, text)
}

fn known(text: &str) -> (Dialect, Telemetry) {
    decode(text).unwrap().unwrap()
}

const STOCK: &str =
    r#"42["telemetry",{"steering_angle":"-1.2500","throttle":"0.3000","speed":"30.1903","image":"/9j/4AAQ"}]"#;

#[test]
fn the_stock_builds_telemetry_is_read() {
    let (dialect, telemetry) = known(STOCK);
    assert_eq!(dialect, Dialect::Term1);
    assert_eq!(telemetry.steering.get(), -1.25);
    assert_eq!(telemetry.throttle.get(), 0.3);
    assert_eq!(telemetry.speed.get(), 30.1903);
    assert_eq!(telemetry.image, CameraImage::Base64(Bytes::from_static(b"/9j/4AAQ")));
    assert!(telemetry.truth.is_empty());
}

#[test]
fn the_image_is_a_slice_of_the_message() {
    let message = Bytes::from_static(STOCK.as_bytes());
    let Ok(Packet::Event(event)) = Packet::parse(STOCK) else { panic!() };
    let telemetry = Payload::read(event.payload).unwrap().unwrap().telemetry(&message, SpeedUnit::Mph).unwrap();
    let CameraImage::Base64(image) = telemetry.image else { panic!() };
    assert!(message.as_ptr_range().contains(&image.as_ptr()));
}

#[test]
fn what_we_write_as_the_stock_build_is_its_literal_text() {
    let (_, telemetry) = known(STOCK);
    assert_eq!(encode_telemetry(&telemetry, "/9j/4AAQ", Culture::ALL[0]), STOCK);
    let german = encode_telemetry(&telemetry, "/9j/4AAQ", Culture::named("de-DE").unwrap());
    assert_eq!(known(&german).1, telemetry);
}

fn with_truth() -> Telemetry {
    Telemetry {
        truth: Truth {
            lap: Some(2),
            waypoint: Some(17),
            crashed: Some(true),
            out_of_bounds: Some(3),
            crashes: Some(1),
            distance: Some(Metres::constant(2_345.678_9)),
            cte: Some(Metres::constant(-0.759_8)),
            brake: Some(0.25),
            sim_time_s: Some(83.066_667),
            heading_error: Some(Degrees::constant(-3.125)),
            ..Truth::default()
        },
        ..known(STOCK).1
    }
}

#[test]
fn what_we_write_as_a_selforacle_build_is_its_literal_text() {
    let expected = concat!(
        r#"42["telemetry",{"steering_angle":"-1.2500","throttle":"0.3000","speed":"30.1903","#,
        r#""lapNumber":"2","currentWayPoint":"17","crash":"1","tot_obes":"3","tot_crashes":"1","#,
        r#""distance":"2345.6789","cte":"-0.7598","brake":"0.2500","sim_time":"83","ang_diff":"-3.1250","#,
        r#""sim_time_us":"83066667","image":"/9j/4AAQ"}]"#
    );
    assert_eq!(encode_superset(&with_truth(), "/9j/4AAQ", Culture::ALL[0]), expected);
}

#[test]
fn in_traffic_the_time_to_collision_stands_before_our_own_clock() {
    let truth = Truth { lap: Some(0), time_to_collision_s: Some(1.234_56), sim_time_s: Some(2.5), ..Truth::default() };
    let expected = concat!(
        r#"42["telemetry",{"steering_angle":"-1.2500","throttle":"0.3000","speed":"30.1903","#,
        r#""lapNumber":"0","sim_time":"2","ttc":"1.2346","sim_time_us":"2500000","image":"/9j/4AAQ"}]"#
    );
    assert_eq!(encode_superset(&Telemetry { truth, ..known(STOCK).1 }, "/9j/4AAQ", Culture::ALL[0]), expected);
}

#[test]
fn ground_truth_comes_through_the_wire_in_every_culture() {
    let calm = Telemetry {
        truth: Truth { crashed: Some(false), brake: Some(0.0), sim_time_s: Some(0.0), ..with_truth().truth },
        ..with_truth()
    };
    let little = Telemetry { truth: Truth { lap: Some(1), ..Truth::default() }, ..with_truth() };
    let clear = Truth { time_to_collision_s: Some(Truth::CLEAR_S), ..with_truth().truth };
    let clear = Telemetry { truth: clear, ..with_truth() };
    for culture in Culture::ALL {
        for telemetry in [with_truth(), calm.clone(), little.clone(), clear.clone()] {
            let text = encode_superset(&telemetry, "/9j/4AAQ", culture);
            assert_eq!(known(&text), (Dialect::SelfOracle, telemetry), "{}: {text}", culture.name);
        }
    }
}

#[test]
fn without_a_lap_number_the_stock_text_is_written() {
    let stock = known(STOCK).1;
    assert_eq!(encode_superset(&stock, "/9j/4AAQ", Culture::ALL[0]), STOCK);
    let telemetry = Telemetry { truth: Truth { lap: None, ..with_truth().truth }, ..stock };
    assert_eq!(encode_superset(&telemetry, "/9j/4AAQ", Culture::ALL[0]), STOCK);
}

#[test]
fn the_answer_to_our_ground_truth_has_all_that_the_family_requires() {
    let (dialect, _) = known(&encode_superset(&with_truth(), "", Culture::ALL[0]));
    let (event, json) = Answer::Steer(Command::default()).event(Some(dialect));
    let answer: serde_json::Map<String, serde_json::Value> = serde_json::from_str(&json).unwrap();
    assert_eq!(event, "steer");
    for key in ["steering_angle", "throttle", "confidence", "loss", "max_laps"] {
        let text = answer[key].as_str().unwrap_or_else(|| panic!("{key} is no text in {json}"));
        assert!(Culture::ALL.iter().all(|c| c.float_parse(text).is_ok()), "{key}: {text}");
    }
    assert!(Command::parse_as_simulator(Some(&RawValue::from_string(json).unwrap()), Culture::ALL[1]).is_ok());
}

#[test]
fn null_an_empty_object_and_no_payload_are_a_human_driving() {
    for text in [r#"42["telemetry",null]"#, r#"42["telemetry",{}]"#, r#"42["telemetry",{ }]"#, r#"42["telemetry"]"#] {
        assert_eq!(decode(text), Ok(None), "{text}");
    }
}

#[test]
fn forks_are_told_apart_by_their_first_telemetry() {
    let with = |extra: &str| {
        known(&format!(
            r#"42["telemetry",{{"steering_angle":"0.0000","throttle":"0.0000","speed":"1.0000","image":"x",{extra}}}]"#
        ))
    };
    let (dialect, telemetry) = with(r#""cte":"-0.7598""#);
    assert_eq!((dialect, telemetry.truth.cte.unwrap().get()), (Dialect::Term2Pid, -0.7598));

    let (dialect, telemetry) = with(
        r#""lapNumber":"2","currentWayPoint":"17","crash":"1","tot_obes":"3","tot_crashes":"4","cte":"1,2500","distance":"5.5","sim_time":"60.2","ang_diff":"-3.1""#,
    );
    assert_eq!(dialect, Dialect::SelfOracle);
    let truth = telemetry.truth;
    assert_eq!((truth.lap, truth.waypoint, truth.crashed), (Some(2), Some(17), Some(true)));
    assert_eq!((truth.out_of_bounds, truth.crashes, truth.sim_time_s), (Some(3), Some(4), Some(60.2)));
    assert_eq!(truth.cte.unwrap().get(), 1.25);

    let (dialect, telemetry) =
        with(r#""pos_x":"1.0","pos_y":"2.0","pos_z":"-3.0","hit":"none","cte":"","track":"lake","lapNumber":"1""#);
    assert_eq!(dialect, Dialect::Positioned);
    assert_eq!(telemetry.truth.position.unwrap().map(Metres::get), [1.0, 2.0, -3.0]);
    assert_eq!((telemetry.truth.cte, telemetry.truth.hit), (None, None));

    let gym = STOCK.replace("telemetry", "car_telemetry").replace("}]", r#","timestamp":"12","lap":1,"sector":2}]"#);
    let (dialect, telemetry) = known(&gym);
    assert_eq!(dialect, Dialect::UdacityGym);
    assert_eq!((telemetry.truth.lap, telemetry.truth.sector), (Some(1), Some(2)));
}

#[test]
fn simulators_without_a_camera_are_refused_by_name() {
    for (fields, name) in [
        (r#""sensor_measurement":"L\t3.1e-01\t5.8e-01\t1477010443000000""#, "the term 2 Kalman filter simulator (EKF"),
        (r#""lidar_measurement":"L\t1","radar_measurement":"R\t1","hunter_x":"-10.0000""#, "Run Away Robot"),
        (r#""sense_x":"6.2785","sense_y":"1.9598","sense_theta":"0.0044""#, "Kidnapped Vehicle"),
        (r#""ptsx":[1,2],"ptsy":[3,4],"steering_angle":0.1,"speed":1.5"#, "the term 2 MPC simulator"),
        (r#""x":1.5,"s":2,"d":6,"speed":1.5,"previous_path_x":[],"sensor_fusion":[[0,1]]"#, "term 3 Path Planning"),
        (r#""x":1.5,"y":2,"z":0,"yaw":1,"velocity":0,"dbw_enable":false"#, "term 3 System Integration"),
        (r#""speed":"1.5""#, "no simulator that Lapwing knows"),
    ] {
        let error = decode(&format!(r#"42["telemetry",{{{fields}}}]"#)).unwrap_err();
        assert!(matches!(error, TelemetryError::Undrivable(_)) && error.to_string().contains(name), "{error}");
    }
}

#[test]
fn a_bad_field_is_named_with_what_it_holds() {
    let bad = |from: &str, to: &str| decode(&STOCK.replace(from, to)).unwrap_err().to_string();
    assert_eq!(bad(r#""speed":"30.1903","#, ""), "expected the field speed, got none");
    assert_eq!(bad("30.1903", "NaN"), r#"speed: expected a number, got "NaN""#);
    assert_eq!(bad("30.1903", "1e30"), "speed: expected a speed from -1000 to 1000 mph, got 1e30");
    assert_eq!(bad(r#""0.3000""#, "[]"), "throttle: expected a number or text, got another kind of JSON");
    assert_eq!(bad(r#""/9j/4AAQ""#, "7"), "image: expected a number or text, got another kind of JSON");
}

#[test]
fn truth_that_cannot_be_is_none_on_the_wire_and_an_error_in_a_run() {
    let text = STOCK.replace("}]", r#","brake":"1.5","sim_time":"84e67","ttc":"-1.0","lapNumber":"1"}]"#);
    let (_, telemetry) = known(&text);
    assert_eq!(telemetry.truth, Truth { lap: Some(1), ..Truth::default() });
    for (json, words) in [
        (r#"{"brake":1.5}"#, "expected a brake from 0 to 1, got 1.5"),
        (r#"{"sim_time_s":1e68}"#, "expected a time from 0 to 1e9 seconds, got 1"),
        (r#"{"time_to_collision_s":-1}"#, "expected a time from 0 to 1e9 seconds, got -1"),
    ] {
        let error = serde_json::from_str::<Truth>(json).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn an_error_repeats_the_beginning_of_a_long_payload_only() {
    let text = format!(r#"42["telemetry","{}"]"#, "x".repeat(1 << 20));
    assert!(decode(&text).unwrap_err().to_string().len() < 400);
}

#[test]
fn escapes_numbers_and_unknown_fields_are_taken_in_stride() {
    let text = STOCK.replace("/9j/", r"\/9j\/").replace(r#""30.1903""#, "30.25").replace("}]", r#","x":{"y":[1]}}]"#);
    let (_, telemetry) = known(&text);
    assert_eq!(telemetry.speed.get(), 30.25);
    assert_eq!(telemetry.image, CameraImage::Base64(Bytes::from_static(b"/9j/4AAQ")));
}

#[test]
fn speed_in_metres_per_second_is_converted() {
    let (_, telemetry) = decode_in(SpeedUnit::MetresPerSecond, STOCK).unwrap().unwrap();
    assert!((telemetry.speed.get() - 30.1903 / 0.447_04).abs() < 1e-9);
}

#[test]
fn a_first_telemetry_tells_its_dialect_even_where_a_field_is_bad() {
    let text = STOCK.replace("30.1903", "NaN").replace("}]", r#","cte":"0.5"}]"#);
    let Ok(Packet::Event(event)) = Packet::parse(&text) else { panic!() };
    let payload = Payload::read(event.payload).unwrap().unwrap();
    assert_eq!(payload.dialect("telemetry"), Ok(Dialect::Term2Pid));
    assert!(payload.telemetry(&Bytes::from(text.clone()), SpeedUnit::Mph).is_err());
}

#[test]
fn mangled_telemetry_is_read_or_refused_and_never_panics() {
    let mut seed = 1u32;
    let mut random = |below: usize| {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 8) as usize % below
    };
    const BITS: [&str; 12] = ["\"", "{", "}", "[", "]", "\\", "null", "-", "1e9", ",", "\u{a0}", "\\ud800"];
    let mut refused = 0;
    for _ in 0..20_000 {
        let mut text = STOCK.to_owned();
        for _ in 0..=random(4) {
            let at = (2..=2 + random(text.len())).rev().find(|at| text.is_char_boundary(*at)).unwrap_or(2);
            if random(3) == 0 {
                text.truncate(at);
            } else {
                text.insert_str(at, BITS[random(BITS.len())]);
            }
        }
        refused += u32::from(match Packet::parse(&text) {
            Ok(Packet::Event(_)) => decode(&text).is_err_and(|e| !e.to_string().is_empty()),
            other => other.is_err(),
        });
    }
    assert!(refused > 10_000, "{refused}");
}
