//! A world that is driven over the wire, in the words of every build, and its own judgement.

use std::{
    fmt::Write,
    net::SocketAddr,
    path::Path,
    sync::Arc,
    time::{Duration, Instant},
};

use base64::{Engine, engine::general_purpose::STANDARD};
use lapwing::known::known_road;
use lapwing_core::{
    control::{Handover, HandoverChange},
    drive::Eventful,
    protocol::number::Culture,
    protocol::{Answer, CameraImage, Command, Observation, Sight, Telemetry, World, encode_superset, encode_telemetry},
    turn::EventRecord,
    units::{Mph, Steering, Throttle},
};
use lapwing_live::bridge::Summary;
use lapwing_score::{
    odometry::Road,
    score::{Scorecard, Scorer},
};
use lapwing_sim::{
    camera::Scenery,
    track::Track,
    world::{Human, Setup, Simulation},
};
use tokio::task::block_in_place;

use crate::support::Wire;

/// How fast it goes round.
pub const LAP_MPH: Mph = Mph::constant(22.0);
/// Telemetries per second.
const HZ: f64 = 6.0;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Speaks {
    Stock,
    Term2Pid,
    SelfOracle,
    /// As the builds of that family do: no time but whole seconds.
    WholeSeconds,
    Positioned,
    Gym,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum How {
    Finished,
    Crashed,
    TakenOver,
    TakenToTheEnd,
    HumanFirst,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Case {
    pub speaks: Speaks,
    pub how: How,
    pub realtime: bool,
}

pub struct Played {
    pub case: Case,
    /// What the bridge calls it.
    pub peer: String,
    /// The world's own judgement.
    pub truth: Scorecard,
    /// By how much a message was sent too late at most: the bridge goes by when they come.
    pub late: Duration,
    pub summary: Option<Summary>,
}

/// A lap of 180 m with blocks along a part of it; as a world's track, and as a road that is known.
pub fn loop_road(dir: &Path) -> ((Arc<Track>, Arc<Scenery>), Arc<Road>) {
    let mut points = String::new();
    for i in 0..24 {
        let t = f64::from(i) / 24.0 * std::f64::consts::TAU;
        let (x, z) = (34.0 * t.cos() + 4.0 * (2.0 * t).cos(), 24.0 * t.sin());
        write!(points, "[{x:.2}, 0.0, {z:.2}], ").unwrap();
    }
    let text = format!(
        "name = \"loop\"\ntheme = \"lake\"\nwidth_m = 7.0\nscenery_seed = 3\n\
         start = {{ x = 37.8, y = 0.0, z = 0.0, yaw_deg = 0.0 }}\ncontrol_points = [{points}]\n\
         [[stretch]]\nfrom_m = 60.0\nto_m = 150.0\nside = \"both\"\nedge = \"blocks\"\n"
    );
    let path = dir.join("loop.toml");
    std::fs::write(&path, text).unwrap();
    let path = path.to_str().unwrap();
    let track = Track::open(path).unwrap();
    let scenery = Arc::new(Scenery::new(&track));
    let [road, _] = known_road(track.clone()).unwrap().map(Arc::new);
    ((Arc::new(track), scenery), road)
}

/// Drives a case over the wire. The expert drives, whatever the bridge says, so that the world's judgement does not hang on
/// the bridge's pilot.
pub async fn play(address: SocketAddr, (track, scenery): (Arc<Track>, Arc<Scenery>), case: Case) -> Played {
    let human = |from_s: f64, for_s: f64| Some(Human { from_s, for_s, speed: LAP_MPH });
    let setup = Setup {
        hz: HZ,
        longest_s: Some(60.0),
        human: match case.how {
            How::Finished | How::Crashed => None,
            How::TakenOver => human(5.0, 3.0),
            How::TakenToTheEnd => human(12.0, 100.0),
            How::HumanFirst => human(0.0, 4.0),
        },
        ..Setup::new(track, scenery)
    };
    let mut world = Simulation::new(setup).unwrap();
    let mut wire = Wire::simulator(address).await;
    let peer = wire.socket.get_ref().local_addr().unwrap().to_string();
    let (mut scorer, mut handover) = (Scorer::default(), Handover::new(false));
    let (began, mut late) = (Instant::now(), Duration::ZERO);
    loop {
        let seen = block_in_place(|| world.observe().unwrap());
        world.take_events().iter().for_each(|(at, event)| scorer.event(*at, event));
        let Some(Observation { at, sight }) = seen else { break };
        if case.realtime {
            tokio::time::sleep_until((began + at).into()).await;
            late = late.max(began.elapsed().saturating_sub(at));
        }
        let change = match &sight {
            Sight::HumanDrives => handover.human_drives(at),
            _ => handover.command_asked(at),
        };
        if let Some(change) = change {
            let event = match change {
                HandoverChange::TakeoverBegan => EventRecord::TakeoverBegan,
                HandoverChange::TakeoverEnded(after) => EventRecord::TakeoverEnded { duration_s: after.as_secs_f64() },
            };
            scorer.event(at, &event);
        }
        let text = match &sight {
            Sight::Telemetry(telemetry) => {
                scorer.telemetry(at, telemetry);
                said(case.speaks, telemetry)
            }
            _ => r#"42["telemetry",null]"#.to_owned(),
        };
        let answer = wire.ask(&text).await;
        assert_eq!(answer.contains("manual"), sight == Sight::HumanDrives, "{case:?}: {answer}");
        let mut command = world.expert(LAP_MPH);
        if case.how == How::Crashed && at > Duration::from_secs(8) {
            command = Command { steering: Steering::MAX, throttle: Throttle::constant(0.3) };
        }
        world.apply(Answer::Steer(command));
    }
    // As the simulator quits.
    wire.send("41").await;
    wire.send("1").await;
    let _ = wire.ends_within(Duration::from_secs(5)).await;
    Played { case, peer, truth: scorer.finish(), late, summary: None }
}

/// A telemetry in the words of a build.
fn said(speaks: Speaks, telemetry: &Telemetry) -> String {
    let CameraImage::Jpeg(jpeg) = &telemetry.image else { panic!("no text in process") };
    let (image, english) = (STANDARD.encode(jpeg), Culture::ALL[0]);
    let truth = &telemetry.truth;
    let stock = encode_telemetry(telemetry, &image, english);
    let with = |more: String| stock.replacen(r#""image""#, &format!(r#"{more},"image""#), 1);
    let cte = truth.cte.unwrap().get();
    let [x, y, z] = truth.position.unwrap().map(f64::from);
    match speaks {
        Speaks::Stock => stock,
        Speaks::Term2Pid => with(format!(r#""cte":"{cte:.4}""#)),
        Speaks::SelfOracle => encode_superset(telemetry, &image, english),
        Speaks::WholeSeconds => {
            let text = encode_superset(telemetry, &image, english);
            let at = text.find(r#""sim_time_us""#).unwrap();
            let end = at + text[at..].find(',').unwrap() + 1;
            text[..at].to_owned() + &text[end..]
        }
        Speaks::Positioned => {
            let hit = if truth.crashed == Some(true) { "block" } else { "none" };
            with(format!(
                r#""pos_x":"{x:.4}","pos_y":"{y:.4}","pos_z":"{z:.4}","hit":"{hit}","cte":"{cte:.4}","track":"loop""#
            ))
        }
        Speaks::Gym => with(format!(
            r#""timestamp":"1","cte":"{cte:.4}","next_cte":"{cte:.4}","lap":"{}","sector":"1","pos_x":"{x:.4}","pos_y":"{y:.4}","pos_z":"{z:.4}""#,
            truth.lap.unwrap()
        ))
        .replacen("telemetry", "car_telemetry", 1),
    }
}
