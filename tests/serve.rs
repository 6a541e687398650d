//! `serve` and the other verbs as programs: however they are ended, cars are let go of and runs are closed.

use std::{
    io::{BufRead, BufReader, Read},
    net::SocketAddr,
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};

use lapwing_core::recording::{Item, RunReader};
use tempfile::{TempDir, tempdir};

use crate::support::{Wire, steer, telemetry};

/// A verb that runs in a shell's `script`, where `"$0" "$@"` stands for the program and its arguments.
pub struct Verb {
    child: Child,
    dir: TempDir,
}

impl Verb {
    fn start(script: &str, arguments: &[&str]) -> Self {
        let dir = tempdir().unwrap();
        let mut command = Command::new("sh");
        // Whoever runs the tests may ignore it (nohup), and what is ignored is inherited.
        // SAFETY: signal() may be called between fork and exec.
        #[cfg(unix)]
        unsafe {
            std::os::unix::process::CommandExt::pre_exec(&mut command, || {
                libc::signal(libc::SIGHUP, libc::SIG_DFL);
                Ok(())
            });
        }
        let child = command
            .args(["-c", script, env!("CARGO_BIN_EXE_lapwing")])
            .args(arguments)
            .current_dir(dir.path())
            .env_remove("LAPWING_LOG")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Self { child, dir }
    }

    pub fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-s", name, &pid]).status().unwrap().success());
    }

    /// Waits until it has begun to listen for signals.
    fn catches_signals(&self) {
        if cfg!(target_os = "linux") {
            let status = format!("/proc/{}/status", self.child.id());
            until("it catches SIGHUP, SIGINT and SIGTERM", || {
                let status = std::fs::read_to_string(&status).unwrap();
                let (_, caught) = status.split_once("SigCgt:")?;
                let caught = u64::from_str_radix(caught.split_whitespace().next()?, 16).unwrap();
                (caught & 0x4003 == 0x4003).then_some(())
            });
        } else {
            std::thread::sleep(Duration::from_secs(2));
        }
    }

    pub fn ends(&mut self) -> ExitStatus {
        until("the program ends", || self.child.try_wait().unwrap())
    }

    /// What it has said on stdout and stderr, once it has ended.
    fn said(&mut self) -> (String, String) {
        let (mut out, mut err) = (String::new(), String::new());
        self.child.stdout.take().map(|mut pipe| pipe.read_to_string(&mut out));
        self.child.stderr.take().map(|mut pipe| pipe.read_to_string(&mut err));
        (out, err)
    }

    /// The only run, and how many frames it holds, where it is whole.
    fn run(&self) -> (PathBuf, Option<usize>) {
        let files: Vec<_> =
            std::fs::read_dir(self.dir.path().join("runs")).unwrap().map(|file| file.unwrap().path()).collect();
        let [run] = files.as_slice() else { panic!("{files:?}") };
        (run.clone(), whole(run))
    }
}

impl Drop for Verb {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// How many frames a run holds; `None` where it is cut off.
fn whole(run: &Path) -> Option<usize> {
    let mut reader = RunReader::open(run).unwrap();
    let frames = reader.by_ref().filter(|item| matches!(item.as_ref().unwrap().1, Item::Frame(_))).count();
    reader.truncated().is_none().then_some(frames)
}

fn until<T>(what: &str, mut found: impl FnMut() -> Option<T>) -> T {
    let end = Instant::now() + Duration::from_secs(60);
    loop {
        if let Some(it) = found() {
            return it;
        }
        assert!(Instant::now() < end, "waited in vain until {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

pub const PLAIN: &str = r#"exec "$0" "$@""#;

/// A bridge with its model loaded that records below its folder, its address, and what it says on.
fn serve(script: &str) -> (Verb, SocketAddr, BufReader<Box<dyn Read>>) {
    serve_with(script, &[])
}

/// The same with more flags.
pub fn serve_with(script: &str, flags: &[&str]) -> (Verb, SocketAddr, BufReader<Box<dyn Read>>) {
    let mut verb = Verb::start(script, &[&["serve", "--port", "0", "--recordings", "runs"], flags].concat());
    let merged = script.contains("2>&1");
    let pipe: Box<dyn Read> =
        if merged { Box::new(verb.child.stdout.take().unwrap()) } else { Box::new(verb.child.stderr.take().unwrap()) };
    let mut said = BufReader::new(pipe);
    let (mut address, mut line) = (None, String::new());
    while !line.contains("model:") {
        line.clear();
        assert!(said.read_line(&mut line).unwrap() > 0, "the bridge ends");
        let told = line.split_once("simulator on ").and_then(|(_, rest)| rest.split_once(". "));
        address = address.or(told.map(|(address, _)| address.parse().unwrap()));
    }
    (verb, address.unwrap(), said)
}

/// Drives a moment, ends the bridge so, and wants the last command to have no throttle.
async fn driven_until(verb: &mut Verb, address: SocketAddr, end: impl AsyncFnOnce(&mut Verb)) -> ExitStatus {
    let mut simulator = Wire::simulator(address).await;
    // The model is named a moment before it drives; until then the car is braked, and nothing is recorded.
    let mut command = steer(&simulator.ask(&telemetry("4.0000")).await);
    for _ in 0..100 {
        if command.1 > 0.0 {
            break;
        }
        command = steer(&simulator.ask(&telemetry("4.0000")).await);
    }
    for _ in 1..5 {
        assert!(command.1 > 0.0, "it drives: {command:?}");
        command = steer(&simulator.ask(&telemetry("4.0000")).await);
    }
    end(verb).await;
    assert_eq!(steer(&simulator.text().await), (command.0, 0.0), "the farewell");
    verb.ends()
}

#[test]
fn a_folder_of_models_is_offered_without_those_that_do_not_steer_and_without_code() {
    let folder = tempdir().unwrap();
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let names =
        ["cps.safetensors", "intersection-ppo.safetensors", "lane.safetensors", "pilotnet.safetensors", "README.md"];
    for name in names {
        std::fs::copy(models.join(name), folder.path().join(name)).unwrap();
    }
    std::fs::write(folder.path().join("code.pt"), "never read").unwrap();
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port().to_string();
    let also = folder.path().to_str().unwrap();
    let mut verb = Verb::start(PLAIN, &["serve", "--port", &port, "--no-recording", "--json", "--also-model", also]);
    let state = || {
        let mut stream = std::net::TcpStream::connect(format!("127.0.0.1:{port}")).ok()?;
        let request = "GET /api/state HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
        std::io::Write::write_all(&mut stream, request.as_bytes()).ok()?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).ok()?;
        let state: serde_json::Value = serde_json::from_str(answer.split_once("\r\n\r\n")?.1).ok()?;
        Some(state["pilots"].clone()).filter(|pilots| !pilots.as_array().unwrap().is_empty())
    };
    let pilots = until("the models are loaded", state);
    let told: Vec<_> = pilots
        .as_array()
        .unwrap()
        .iter()
        .map(|pilot| (pilot["name"].as_str().unwrap().split(' ').next().unwrap(), pilot["unexplained"].is_null()))
        .collect();
    assert_eq!(told, [("pilotnet", true), ("cps", true)], "the built-in one once");
    verb.signal("INT");
    assert_eq!(verb.ends().code(), Some(0));
    let (_, said) = verb.said();
    assert!(
        said.contains("not on the page: ") && said.contains("lane.safetensors") && !said.contains("code.pt"),
        "{said}"
    );
    assert!(said.contains("got a policy for agents at an intersection") && !said.contains("model rename"), "{said}");
}

#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_sigterm_and_a_closed_terminal_end_it_in_order() {
    for signal in ["INT", "TERM", "HUP"] {
        let (mut verb, address, _said) = serve(PLAIN);
        let status = driven_until(&mut verb, address, async |verb| verb.signal(signal)).await;
        let (out, _) = verb.said();
        assert_eq!(status.code(), Some(0), "{signal}");
        assert!(out.contains("drive of 127.0.0.1"), "{signal}: {out}");
        assert_eq!(verb.run().1, Some(5), "{signal}: the run is whole");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_with_the_reader_of_its_output_gone_ends_it_in_order() {
    // As in `lapwing serve 2>&1 | tee log`, where Ctrl-C ends `tee`, too.
    let (mut verb, address, said) = serve(&format!("{PLAIN} 2>&1"));
    let status = driven_until(&mut verb, address, async |verb| {
        drop(said);
        verb.signal("INT");
    })
    .await;
    assert!(matches!(status.code(), Some(0 | 1)), "{status}: neither a panic nor a signal");
    assert_eq!(verb.run().1, Some(5));
}

#[tokio::test(flavor = "multi_thread")]
async fn log_lines_that_nobody_takes_do_not_end_a_drive() {
    let (mut verb, address, said) = serve(PLAIN);
    drop(said);
    let mut simulator = Wire::simulator(address).await;
    for _ in 0..3 {
        simulator.ask("no packet at all").await; // a line each
        steer(&simulator.ask(&telemetry("4.0000")).await);
    }
    let status = driven_until(&mut verb, address, async |verb| verb.signal("TERM")).await;
    assert_eq!(status.code(), Some(0));
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn full_disks_behind_stdout_and_stderr_do_not_end_a_drive() {
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port().to_string();
    let script = format!("{PLAIN} >/dev/full 2>/dev/full");
    let mut verb = Verb::start(&script, &["serve", "--port", &port, "--recordings", "runs"]);
    let address = format!("127.0.0.1:{port}").parse().unwrap();
    until("it listens", || std::net::TcpStream::connect(address).ok());
    let mut simulator = Wire::simulator(address).await;
    while steer(&simulator.ask(&telemetry("4.0000")).await).1 <= 0.0 {} // the model is loading
    let status = driven_until(&mut verb, address, async |verb| verb.signal("INT")).await;
    assert!(matches!(status.code(), Some(0 | 1)), "{status}: neither a panic nor a signal");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_limit_on_file_sizes_costs_the_recording_and_not_the_drive() {
    let (mut verb, address, mut said) = serve(&format!("ulimit -f 32; {PLAIN}"));
    let mut simulator = Wire::simulator(address).await;
    let mut line = String::new();
    for _ in 0..60 {
        steer(&simulator.ask(&telemetry("4.0000")).await);
        tokio::time::sleep(Duration::from_millis(25)).await; // the recorder writes twice a second
    }
    while !line.contains("cannot write the run") {
        line.clear();
        assert!(said.read_line(&mut line).unwrap() > 0, "the bridge ends");
    }
    drop(simulator);
    let status = driven_until(&mut verb, address, async |verb| verb.signal("TERM")).await;
    assert_eq!(status.code(), Some(1), "{status}: a run is not whole");
    let (out, _) = verb.said();
    assert!(out.contains("recording error"), "{out}");
    for run in std::fs::read_dir(verb.dir.path().join("runs")).unwrap() {
        RunReader::open(run.unwrap().path()).unwrap(); // what was written can be read
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_terminal_whose_closing_is_ignored_does_not_end_it() {
    let (mut verb, address, _said) = serve(&format!("trap '' HUP; {PLAIN}")); // as nohup does
    verb.signal("HUP");
    tokio::time::sleep(Duration::from_millis(200)).await;
    let status = driven_until(&mut verb, address, async |verb| verb.signal("TERM")).await;
    assert_eq!(status.code(), Some(0));
}

#[test]
fn verbs_that_drive_by_themselves_end_in_order_too() {
    for (signal, arguments) in [
        ("TERM", &["drive", "--pilot", "expert", "--laps", "500", "--recordings", "runs"][..]),
        ("HUP", &["simulate", "--laps", "500", "--max-collisions", "9"]),
        ("TERM", &["record", "--laps", "500", "--out", "data"]),
    ] {
        let mut verb = Verb::start(PLAIN, arguments);
        verb.catches_signals();
        if arguments[0] == "drive" {
            let runs = verb.dir.path().join("runs");
            let bytes = || std::fs::read_dir(&runs).ok()?.next()?.ok()?.metadata().ok();
            until("something is recorded", || bytes().filter(|run| run.len() > 300_000));
        }
        verb.signal(signal);
        let status = verb.ends();
        let (out, err) = verb.said();
        assert!(status.code().is_some() && out.contains("interrupted"), "{arguments:?}: {status}: {out}{err}");
        if arguments.contains(&"--max-collisions") {
            let told = "interrupted: the thresholds were met, but only on the part that was driven";
            assert!(status.code() == Some(1) && err.contains(told), "{status}: {err}");
        }
        if arguments[0] == "drive" {
            assert!(verb.run().1.is_some_and(|frames| frames > 10), "{out}");
        }
    }
}

/// libtorch crashes if its statics are destroyed under a thread that is at work with a network.
#[test]
fn whatever_networks_do_just_then_the_program_ends_without_a_crash() {
    let models = concat!(env!("CARGO_MANIFEST_DIR"), "/models");
    let network = concat!(env!("CARGO_MANIFEST_DIR"), "/models/resnet50.safetensors");
    let mut ended = vec![];
    for tenths in 1..=6 {
        for (arguments, presses) in [
            (&["serve", "--port", "0", "--no-recording", "--also-model", models][..], 1),
            (&["drive", "--no-recording", "--laps", "500", "--model", network], 2),
        ] {
            let mut verb = Verb::start(PLAIN, arguments);
            verb.catches_signals();
            // The first still loads networks, and the network of the second drives.
            std::thread::sleep(Duration::from_millis(100 * tenths));
            for _ in 0..presses {
                verb.signal("INT");
                std::thread::sleep(Duration::from_millis(3));
            }
            let status = verb.ends();
            ended.push((arguments[0], status, status.code().is_some()));
        }
    }
    assert!(ended.iter().all(|(.., without_a_crash)| *without_a_crash), "{ended:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_simulator_has_its_line_and_a_storm_of_dials_hides_none() {
    let (mut verb, address, mut said) = serve(PLAIN);
    for _ in 0..100 {
        drop(Wire::simulator(address).await);
    }
    let mut simulators = vec![];
    for _ in 0..8 {
        let mut simulator = Wire::simulator(address).await;
        steer(&simulator.ask(&telemetry("4.0000")).await);
        simulators.push(simulator);
    }
    let names: Vec<_> = simulators.iter().map(|wire| wire.socket.get_ref().local_addr().unwrap().to_string()).collect();
    verb.signal("TERM");
    verb.ends();
    let mut log = String::new();
    said.read_to_string(&mut log).unwrap();
    for name in names {
        let line = format!("{name}: a term 1 (stock) simulator has connected");
        assert_eq!(log.matches(&line).count(), 1, "{log}");
    }
    assert!(log.matches("never sent a telemetry").count() <= 2, "{log}");
}

#[test]
fn a_port_that_others_can_reach_is_told_to_be_open_to_any_simulator() {
    for (bind, expected, local) in
        [("0.0.0.0", 1, "127.0.0.1"), ("127.0.0.1", 0, "127.0.0.1"), ("127.0.0.2", 0, "127.0.0.2")]
    {
        let mut verb = Verb::start(PLAIN, &["serve", "--bind", bind, "--port", "0", "--no-recording"]);
        verb.catches_signals();
        verb.signal("TERM");
        assert!(verb.ends().success());
        let (_, said) = verb.said();
        let warnings = said.lines().filter(|line| line.contains("cannot send a token"));
        assert_eq!(warnings.count(), expected, "{bind}: {said}");
        assert_eq!(said.contains("?token="), expected == 1, "{bind}: {said}");
        assert!(said.contains(&format!("ssh -N -L 4567:{local}:")), "a tunnel ends where it listens: {bind}: {said}");
        let advised = said.contains("with lapwing serve --bind 0.0.0.0 here,");
        assert_eq!(advised, expected == 0, "nobody is told to do what they did: {bind}: {said}");
    }
}

#[test]
fn a_taken_port_is_told_with_the_flag_that_chose_it_and_leaves_no_run() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let drive = ["drive", "--pilot", "expert"];
    for (verb, flag) in [
        (&drive[..], "--foxglove"),
        (&drive, "--page"),
        (&["record", "--out", "data"], "--page"),
        (&["serve", "--port", "0"], "--foxglove"),
        (&["serve"], "--port"),
    ] {
        let dir = tempdir().unwrap();
        let program = Command::new(env!("CARGO_BIN_EXE_lapwing"))
            .args(verb)
            .args([flag, &port])
            .current_dir(dir.path())
            .stdin(Stdio::null())
            .output()
            .unwrap();
        let said = String::from_utf8(program.stderr).unwrap();
        assert_eq!(program.status.code(), Some(1), "{said}");
        let advice = format!("choose another port with {flag}");
        assert!(said.contains(&format!("port {port} is taken")) && said.contains(&advice), "{said}");
        let holder = format!("by process {} (", std::process::id());
        assert!(said.contains(&holder) || !cfg!(target_os = "linux"), "{said}");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}

#[test]
fn the_doctor_takes_the_flags_of_serve_and_knows_a_lapwing_that_serves() {
    let (verb, address, _said) = serve(PLAIN);
    let port = address.port().to_string();
    let doctor = Command::new(env!("CARGO_BIN_EXE_lapwing"))
        .args(["doctor", "--json", "--bind", "127.0.0.1", "--port", &port, "--recordings", "runs"])
        .current_dir(verb.dir.path())
        .output()
        .unwrap();
    let found: serde_json::Value = serde_json::from_slice(&doctor.stdout).unwrap();
    assert_eq!(found["serving"], address.to_string(), "{found}");
    assert_eq!((&found["troubles"], doctor.status.code()), (&serde_json::json!([]), Some(0)), "{found}");
    assert!(found["recordings"].as_str().unwrap().ends_with("runs"), "{found}");
}

#[test]
fn the_doctor_knows_the_port_where_a_lapwing_that_serves_shows_drives_to_foxglove() {
    for bind in ["127.0.0.1", "0.0.0.0"] {
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port().to_string();
        let (verb, _, _said) = serve_with(PLAIN, &["--bind", bind, "--foxglove", &port]);
        let doctor = Command::new(env!("CARGO_BIN_EXE_lapwing"))
            .args(["doctor", "--json", "--bind", bind, "--port", &port, "--recordings", "runs"])
            .current_dir(verb.dir.path())
            .output()
            .unwrap();
        let found: serde_json::Value = serde_json::from_slice(&doctor.stdout).unwrap();
        let holder = "Lapwing shows drives to Foxglove and Lichtblick (--foxglove)";
        let expected = format!("on port {port} {holder}: choose another port with --port");
        assert_eq!(found["troubles"], serde_json::json!([expected]), "{bind}: {found}");
        assert_eq!(doctor.status.code(), Some(1), "{bind}: {found}");
    }
}

#[test]
fn the_page_of_a_world_listens_where_it_is_told_and_wants_a_token_there() {
    for (verb, code) in [(&["drive", "--pilot", "expert", "--no-recording"][..], 0), (&["record", "--out", "data"], 1)]
    {
        let page = ["--page", "0", "--bind", "0.0.0.0", "--max-time", "1"];
        let mut program = Verb::start(PLAIN, &[verb, &page[..]].concat());
        let ended = program.ends();
        let (_, said) = program.said();
        assert_eq!(ended.code(), Some(code), "nobody drove by hand, so nothing is recorded: {said}");
        assert!(said.contains("Page: http://ADDRESS-OF-THIS-MACHINE:") && said.contains("/?token="), "{said}");
        let mut alone = Verb::start(PLAIN, &[verb, &page[2..4]].concat());
        assert_eq!(alone.ends().code(), Some(2), "{}", alone.said().1);
    }
}
