//! Forks are answered in their own words.

use std::time::Duration;

use tempfile::tempdir;

use crate::support::{Running, Wire, settings, settings_with_kicks, telemetry};

async fn first_answer(telemetry: &str) -> String {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    simulator.ask(telemetry).await
}

fn with(extra: &str) -> String {
    telemetry("0.0000").replace("}]", &format!(",{extra}}}]"))
}

#[tokio::test(flavor = "multi_thread")]
async fn term_2_pid_gets_numbers() {
    let answer = first_answer(&with(r#""cte":"0.5""#)).await;
    assert!(answer.starts_with(r#"42["steer",{"steering_angle":"#) && !answer.contains(r#":""#), "{answer}");
    assert!(answer.ends_with(r#","throttle":9180e-4}]"#), "{answer}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bad_first_telemetry_is_answered_in_its_own_dialect_all_the_same() {
    let bad = with(r#""cte":"0.5""#).replace(r#""speed":"0.0000""#, r#""speed":"NaN""#);
    assert_eq!(first_answer(&bad).await, r#"42["steer",{"steering_angle":0e-4,"throttle":0e-4}]"#);
}

#[tokio::test(flavor = "multi_thread")]
async fn self_oracle_gets_what_it_requires() {
    let answer =
        first_answer(&with(r#""lapNumber":"1","currentWayPoint":"0","crash":"0","tot_obes":"0","tot_crashes":"0""#))
            .await;
    assert!(
        answer.ends_with(r#""throttle":"9180e-4","confidence":"10000e-4","loss":"0e-4","max_laps":"1000000"}]"#),
        "{answer}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn udacity_gym_gets_an_action() {
    let answer = first_answer(&with(r#""timestamp":"1","lap":"1""#).replace("telemetry", "car_telemetry")).await;
    assert!(answer.starts_with(r#"42["action",{"steering_angle":""#), "{answer}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulator_that_cannot_be_driven_keeps_its_loop_and_has_no_run() {
    let empty = r#"42["telemetry",null]"#;
    for telemetries in [
        // MPC, whose human holds W later.
        [r#"42["telemetry",{"ptsx":[1.0],"ptsy":[2.0],"psi":0.1,"speed":5.0}]"#, empty, empty],
        // EKF waits to be started, and is started.
        [empty, r#"42["telemetry",{"sensor_measurement":"L\t3.1e-01\t5.8e-01\t1477010443000000"}]"#, empty],
        // Path Planning.
        [r#"42["telemetry",{"x":909.48,"speed":0,"previous_path_x":[],"sensor_fusion":[]}]"#, empty, "garbage"],
    ] {
        let dir = tempdir().unwrap();
        let running = Running::start(settings(dir.path())).await;
        let mut simulator = Wire::simulator(running.address).await;
        for telemetry in telemetries {
            assert_eq!(simulator.ask(telemetry).await, r#"42["manual",{}]"#, "{telemetry}");
        }
        assert!(running.stop().await.is_empty(), "no drive, no takeover: {telemetries:?}");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "no run: {telemetries:?}");
        assert_eq!(simulator.text_within(Duration::from_millis(300)).await, None, "nor a command of the wrong kind");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulator_that_was_refused_is_driven_once_it_shows_pictures() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    simulator.ask(r#"42["telemetry",{"speed":"5.0000"}]"#).await;
    assert!(simulator.ask(&telemetry("0.0000")).await.starts_with(r#"42["steer""#));
    assert_eq!(running.stop().await[0].telemetries, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulator_that_waits_to_be_started_is_greeted_as_the_settings_say() {
    let dir = tempdir().unwrap();
    let mut settings = settings(dir.path());
    let start = r#"["start_episode",{"track_name":"lake","weather_name":"sunny","daytime_name":"day"}]"#;
    settings.bridge.greet = vec![r#"["end_episode"]"#.into(), start.into()];
    let running = Running::start(settings).await;
    let mut simulator = Wire::simulator(running.address).await;
    assert_eq!(simulator.text().await, r#"42["end_episode"]"#);
    assert_eq!(simulator.text().await, format!("42{start}"));
}

#[tokio::test(flavor = "multi_thread")]
async fn events_of_a_fork_are_recorded_and_not_answered() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    simulator.ask(&telemetry("0.0000").replace("telemetry", "car_telemetry")).await;
    simulator.send(r#"42["episode_event",{"name":"collision"}]"#).await;
    assert_eq!(simulator.text_within(Duration::from_millis(300)).await, None);
    let path = running.stop().await.remove(0).run.unwrap().path;
    let bytes = std::fs::read(path).unwrap();
    let text = String::from_utf8_lossy(&bytes);
    assert!(text.contains("episode_event") && text.contains("collision"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fork_with_a_timer_is_never_kicked() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings_with_kicks(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    simulator.ask(&with(r#""pos_x":"1.0","pos_y":"0","pos_z":"2","hit":"none""#)).await;
    assert_eq!(simulator.text_within(Duration::from_millis(1500)).await, None);
}
