//! Results that cannot be given, and what is known before the work: the program itself, verb by verb.

use std::{
    fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    sync::{
        LazyLock,
        atomic::{AtomicU32, Ordering},
    },
    time::{Duration, Instant},
};

use lapwing_core::units::Steering;

const RUN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/lake.mcap");

/// What the verbs need to work with, made once: a small track, a data set, a model, a suite and its results.
struct Desk {
    folder: tempfile::TempDir,
    made: AtomicU32,
}

static DESK: LazyLock<Desk> = LazyLock::new(Desk::new);

impl Desk {
    fn new() -> Self {
        let desk = Self { folder: tempfile::tempdir().unwrap(), made: AtomicU32::new(0) };
        fs::write(desk.path("ring.toml"), super::support::ring("ring")).unwrap();
        let suite = format!(
            "tracks = [{:?}]\nlongest_s = 1.0\n[[pilot]]\nname = \"expert\"\nexpert = true\n",
            desk.text("ring.toml")
        );
        fs::write(desk.path("suite.toml"), suite).unwrap();
        desk.data();
        for arguments in [
            "train --data {desk}/data --out {desk}/training --epochs 1 --batch 8 --samples-per-epoch 8 \
             --validation-samples 4",
            "suite {desk}/suite.toml --out {desk}/part",
        ] {
            let output = desk.command(arguments).output().unwrap();
            assert!(output.status.success(), "{arguments}: {}", String::from_utf8_lossy(&output.stderr));
        }
        desk
    }

    /// A drive of 60 rows that sways.
    fn data(&self) {
        use lapwing_core::recording::udacity::{DrivingLogWriter, NewRow};
        let jpeg = super::support::jpeg(90);
        let began = "2020-01-01T12:00:00".parse().unwrap();
        let mut log = DrivingLogWriter::create(self.path("data"), began).unwrap();
        for i in 0..60u32 {
            log.row(&NewRow {
                at: Duration::from_millis(u64::from(i) * 100),
                center: &jpeg,
                left: None,
                right: None,
                steering: Steering::saturating((f64::from(i) / 5.0).sin() / 2.0),
                throttle: Default::default(),
                brake: 0.0,
                speed: lapwing_core::units::Mph::constant(9.0),
            })
            .unwrap();
        }
        log.finish().unwrap();
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).into_os_string().into_string().unwrap()
    }

    /// The program with these arguments; `{desk}` is this folder, and `{new}` a name in it that nothing has.
    fn command(&self, arguments: &str) -> Command {
        let new = self.text(&format!("new{}", self.made.fetch_add(1, Ordering::Relaxed)));
        let arguments = arguments.replace("{desk}", self.folder.path().to_str().unwrap()).replace("{new}", &new);
        let arguments = arguments.replace("{run}", RUN);
        let mut command = Command::new(env!("CARGO_BIN_EXE_lapwing"));
        command.args(arguments.split_whitespace()).current_dir(self.folder.path());
        command
    }

    /// Its exit status and what it said, on stdout and on stderr.
    fn ran(&self, arguments: &str) -> (i32, String, String) {
        said(self.command(arguments).output().unwrap())
    }

    /// All names below it.
    fn names(&self, folder: &str) -> Vec<PathBuf> {
        fn below(folder: &Path, names: &mut Vec<PathBuf>) {
            for entry in fs::read_dir(folder).into_iter().flatten() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    below(&path, names);
                }
                names.push(path);
            }
        }
        let mut names = vec![];
        below(&self.path(folder), &mut names);
        names.sort();
        names
    }
}

fn said(output: Output) -> (i32, String, String) {
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code().unwrap_or(-1), text(output.stdout), text(output.stderr))
}

/// Each verb as it prints a result, `serve` but for which there is a test of its own.
const VERBS: [&str; 19] = [
    "drive --track {desk}/ring.toml --pilot expert --max-time 1 --no-recording",
    "drive --track {desk}/ring.toml --pilot expert --max-time 1 --no-recording --json",
    "simulate --track {desk}/ring.toml --max-time 1",
    "simulate --track {desk}/ring.toml --max-time 1 --json",
    "record --track {desk}/ring.toml --hz 1 --max-time 2 --out {new}",
    "train --data {desk}/data --out {new} --epochs 1 --batch 8 --samples-per-epoch 8 --validation-samples 4",
    "evaluate {desk}/training/model.safetensors --data {desk}/data --before 8",
    "evaluate {desk}/training/model.safetensors --data {desk}/data --before 8 --json",
    "replay {desk}/data",
    "replay {desk}/data --closed-loop --json",
    "locate {desk}/data",
    "score {run}",
    "score --explain",
    "suite {desk}/suite.toml --out {desk}/part",
    "merge {desk}/part --out {new} --json",
    "dataset inspect {desk}/data",
    "dataset convert {desk}/data {new}.mcap",
    "dataset split {desk}/data --out-train {new}/a --out-validation {new}/b --json",
    "dataset preview {desk}/data --out {new}.png",
];

#[cfg(target_os = "linux")]
#[test]
fn a_result_that_cannot_be_printed_is_1_for_every_verb() {
    let full = || fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    for arguments in VERBS.into_iter().chain(["doctor", "doctor --json"]) {
        let output = DESK.command(arguments).stdout(full()).output().unwrap();
        let (code, _, err) = said(output);
        assert_eq!(code, 1, "{arguments}: {err}");
        let told = "error: the result could not be printed: No space left on device (os error 28)";
        assert_eq!(err.matches(told).count(), 1, "{arguments}: {err}");
    }
    assert_eq!(DESK.command("--help").stdout(full()).status().unwrap().code(), Some(1));
}

#[test]
fn a_result_whose_reader_is_gone_is_1() {
    for arguments in ["score --explain", "dataset inspect {desk}/data --json"] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader); // as `| head -0` is, soon
        let (code, _, err) = said(DESK.command(arguments).stdout(writer).output().unwrap());
        assert_eq!(code, 1, "{arguments}: {err}");
        assert!(err.contains("the result could not be printed: Broken pipe"), "{arguments}: {err}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_file_that_cannot_be_written_is_1_and_the_printed_result_is_not_lost_with_it() {
    for ending in ["svg", "png", "xml", "golden", "mp4"] {
        std::os::unix::fs::symlink("/dev/full", DESK.path(&format!("full.{ending}"))).unwrap();
    }
    for (arguments, printed) in [
        ("score {run} --junit {desk}/full.xml", "completion"),
        ("score {run} --html {desk}/full.xml", "completion"),
        ("suite {desk}/suite.toml --out {desk}/part --html {desk}/full.xml", "expert"),
        ("merge {desk}/part --out {new} --html {desk}/full.xml", "expert"),
        (
            "drive --track {desk}/ring.toml --pilot expert --max-time 1 --no-recording --map {desk}/full.svg",
            "completion",
        ),
        ("simulate --track {desk}/ring.toml --max-time 1 --video {desk}/full.mp4", ""),
        ("replay {desk}/data --write-golden {desk}/full.golden", "steering error"),
        ("evaluate {desk}/training/model.safetensors --data {desk}/data --before 8 --plot {desk}/full.svg", "MAE"),
        ("dataset inspect {desk}/data --sheet {desk}/full.png", "data set"),
        ("dataset inspect {desk}/data --plot {desk}/full.svg", "data set"),
        ("dataset preview {desk}/data --out {desk}/full.png", ""),
    ] {
        let (code, out, err) = DESK.ran(arguments);
        assert_eq!(code, 1, "{arguments}: {out}{err}");
        assert!(out.contains(printed), "{arguments}: {out}");
        assert_eq!(err.matches("os error 28").count(), 1, "{arguments}: {err}");
    }
}

/// A program that is ended with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Running {
    #[cfg(unix)]
    fn signal(&self, name: &str) {
        let sent = Command::new("kill").args([&format!("-{name}"), &self.0.id().to_string()]).status().unwrap();
        assert!(sent.success());
    }

    fn ended(&mut self) -> Option<i32> {
        let until = Instant::now() + Duration::from_secs(60);
        while Instant::now() < until {
            if let Some(status) = self.0.try_wait().unwrap() {
                return status.code();
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        None
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_bridge_whose_stdout_is_full_drives_on_and_ends_with_1() {
    let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut serve = DESK.command("serve --port 0 --json --recordings {new}");
    let mut serve = Running(serve.stdout(full).stderr(Stdio::piped()).stdin(Stdio::null()).spawn().unwrap());
    let mut lines = BufReader::new(serve.0.stderr.take().unwrap()).lines().map(Result::unwrap);
    let first = lines.next().unwrap();
    let address = first.split(" on ").nth(1).unwrap().split(". ").next().unwrap().to_owned();
    let rest = std::thread::spawn(move || lines.collect::<Vec<_>>());
    for _ in 0..2 {
        // The second drive comes after the first could not be told of.
        let simulate = format!("simulate --connect {address} --track {{desk}}/ring.toml --max-time 2");
        let (code, out, err) = DESK.ran(&simulate);
        assert_eq!(code, 0, "{out}{err}");
    }
    serve.signal("TERM");
    let (ended, said) = (serve.ended(), rest.join().unwrap().join("\n"));
    assert_eq!(ended, Some(1), "{said}");
    assert_eq!(said.matches("error: the result could not be printed").count(), 2, "{said}");
}

#[test]
fn what_cannot_be_finished_is_not_begun_and_leaves_nothing() {
    let room = DESK.path("room");
    fs::create_dir(&room).unwrap();
    fs::write(room.join("file"), "").unwrap();
    fs::create_dir(room.join("driven")).unwrap();
    fs::write(room.join("driven/driving_log.csv"), "").unwrap();
    for name in ["drive.mcap", "named.run"] {
        fs::copy(RUN, room.join(name)).unwrap();
    }
    std::os::unix::fs::symlink("drive.mcap", room.join("link.xml")).unwrap();
    let recipe = |name: &str, top: &str, rest: &str| {
        let ring = DESK.text("ring.toml");
        let text = format!("{top}\n[[record]]\nout = \"never\"\ntrack = {ring:?}\nlaps = 50\n{rest}\n");
        fs::write(room.join(name), text).unwrap();
    };
    let data = "[[data]]\npath = \"./never\"\n";
    recipe("missing.toml", "", "[[data]]\npath = \"nowhere\"");
    recipe("network.toml", "network = \"pilotnett\"", data);
    recipe("weights.toml", "", data);
    recipe("track.toml", "", &format!("{data}[[record]]\nout = \"never2\"\ntrack = \"lakke\""));
    recipe(
        "weather.toml",
        "",
        &format!("{data}[[record]]\nout = \"never2\"\ntrack = \"lake\"\nconditions = \"rian=1\""),
    );
    recipe("place.toml", "", &format!("{data}[[record]]\nout = \"file/x\"\ntrack = \"lake\""));
    let before = DESK.names("room");
    for (arguments, code, words) in [
        ("drive --pilot expert --video x.avi", 2, "expected a film that ends in .mp4, .gif, .png or .jpg"),
        ("drive --pilot expert --map x.jpg", 2, "expected the name of a picture that ends in .svg or .png"),
        ("drive --pilot expert --map no/x.svg", 1, "no/x.svg: cannot be written: there is no folder no"),
        ("drive --pilot expert --video no/x.mp4", 1, "cannot create the film"),
        ("drive --pilot expert --video file/x", 1, "cannot create pictures in the folder"),
        ("drive --pilot expert --recordings file/x", 1, "cannot make the folder"),
        ("simulate --video x.avi", 2, "got .avi"),
        ("simulate --map x.jpg", 2, "ends in .svg or .png"),
        ("record --out file/x", 1, "cannot create the folder"),
        ("record --out {desk}/data", 1, "nothing is overwritten"),
        ("replay {desk}/data --write-golden no/x", 1, "no/x: cannot be written"),
        ("replay {desk}/data --closed-loop --recordings runs --film x.avi", 2, "got .avi"),
        ("replay {desk}/data --closed-loop --recordings file/x", 1, "file/x: cannot be written"),
        ("replay {desk}/data --closed-loop --limit lane", 2, "expected road, or a number of metres above 0"),
        ("replay {desk}/data --closed-loop --protocol rally-estonia --limit 3", 2, "expected 1 or 2 with"),
        ("score {run} --junit no/x.xml", 1, "no/x.xml: cannot be written"),
        ("score {run} --html {desk}", 1, "cannot be written: is a directory"),
        ("score {run} --html drive.mcap", 1, "drive.mcap: cannot be written: it is a recording, which would be lost"),
        ("score {run} --junit link.xml", 1, "link.xml: cannot be written: it is a recording"),
        ("score named.run --html ./named.run", 1, "named.run: cannot be written: it is also an input"),
        ("score named.run drive.mcap --markdown=named.run", 1, "named.run: cannot be written: it is also an input"),
        ("locate driven --csv driven/driving_log.csv", 1, "driving_log.csv: cannot be written: it is"),
        ("replay {run} --write-golden drive.mcap", 1, "drive.mcap: cannot be written: it is a recording"),
        ("suite {desk}/suite.toml --out s --html {desk}/suite.toml", 1, "cannot be written: it is also an input"),
        (
            "merge {desk}/part --out m --html {desk}/part/plan.json",
            1,
            "plan.json: cannot be written: it is also an input",
        ),
        ("score {run} --html {desk}/training/model.safetensors", 1, "cannot be written: it is a network"),
        ("replay {run} --write-golden weights.toml", 1, "weights.toml: cannot be written: it is a TOML file"),
        ("score {run} --against no.json --html x.html", 1, "no.json: cannot be read"),
        ("suite {desk}/suite.toml --out s --html no/x.html", 1, "no/x.html: cannot be written"),
        ("suite {desk}/suite.toml --out file/s", 1, "file/s: cannot be written"),
        ("merge {desk}/part nowhere --out m", 1, "nowhere: expected the folder of a suite"),
        ("merge {desk}/part --out m --html no/x.html", 1, "no/x.html: cannot be written"),
        ("train --recipe missing.toml --out t", 1, "nowhere: expected a run (.mcap), or a folder"),
        ("train --recipe network.toml --out t", 1, "\"pilotnett\"; did you mean \"pilotnet\"?"),
        ("train --recipe weights.toml --pretrained no.safetensors --out t", 1, "no.safetensors cannot be read"),
        ("train --recipe track.toml --out t", 2, "did you mean \"lake\"?"),
        ("train --recipe weather.toml --out t", 2, "did you mean \"rain\"?"),
        ("train --recipe place.toml --out t", 1, "file/x: cannot be written"),
        ("train --recipe weights.toml --out file/t", 1, "file/t: cannot be written"),
        ("evaluate {desk}/training/model.safetensors --data {desk}/data --plot x.jpg", 2, ".svg or .png"),
        ("evaluate {desk}/training/model.safetensors --data {desk}/data no --plot x.svg", 1, "no: expected a run"),
        ("dataset inspect {desk}/data no --plot x.svg", 1, "no: expected a run (.mcap), or a folder"),
        ("dataset inspect {desk}/data --sheet x.jpg", 2, "ends in .svg or .png"),
        ("dataset preview {desk}/data --out no/x.png", 1, "no/x.png: cannot be written"),
        ("dataset split {desk}/data --out-train a --out-validation file/b", 1, "cannot create"),
        ("dataset convert {desk}/data file/x.mcap", 1, "cannot look at file/x.mcap"),
    ] {
        let (got, out, err) = said(DESK.command(arguments).current_dir(&room).output().unwrap());
        assert_eq!((got, out.as_str()), (code, ""), "{arguments}: {err}");
        assert!(err.contains(words), "{arguments}: {err}");
        assert_eq!(DESK.names("room"), before, "{arguments}");
    }
    for name in ["drive.mcap", "named.run"] {
        assert_eq!(fs::read(room.join(name)).unwrap(), fs::read(RUN).unwrap(), "{name} is as before");
    }
}

#[test]
fn a_run_that_follows_the_flag_for_a_summary_is_scored_and_kept() {
    fs::copy(RUN, DESK.path("kept.mcap")).unwrap();
    let (code, out, err) = DESK.ran("score --markdown {desk}/kept.mcap");
    assert!(code == 0 && out.starts_with("## Lapwing\n\n**Scored.**\n"), "{out}{err}");
    let (code, out, err) = DESK.ran("score --markdown {desk}/kept.mcap --min-completion 1");
    assert!(code == 0 && out.contains("\n**Passed.**\n"), "{out}{err}");
    assert_eq!(fs::read(DESK.path("kept.mcap")).unwrap(), fs::read(RUN).unwrap());
}

#[test]
fn what_does_not_exist_is_wrong_usage_everywhere_and_what_was_meant_is_named() {
    let suite = |name: &str, text: &str| {
        fs::write(DESK.path(name), format!("{text}\n[[pilot]]\nname = \"expert\"\nexpert = true\n")).unwrap();
    };
    suite("track-suite.toml", "tracks = [\"lkae\"]");
    suite("weather-suite.toml", "tracks = [\"lake\"]\nconditions = [\"randm\"]");
    suite("large-suite.toml", "tracks = [\"lake\"]\nseeds = 1000000000000");
    fs::write(DESK.path("settings.toml"), "[simulator]\ntrack = \"mountan\"\n").unwrap();
    fs::write(DESK.path("taken.toml"), super::support::ring("lake")).unwrap();
    fs::write(DESK.path("broken.toml"), "rain = \"much\"\n").unwrap();
    for (arguments, words) in [
        ("drive --track lkae", "did you mean \"lake\"?"),
        ("simulate --track jungel", "did you mean \"jungle\"?"),
        ("record --track moon --out {new}", "unknown track: expected lake, jungle, mountain"),
        ("score {run} --track lakke", "did you mean \"lake\"?"),
        ("--config {desk}/settings.toml drive", "did you mean \"mountain\"?"),
        ("suite {desk}/track-suite.toml --out {new}", "did you mean \"lake\"?"),
        ("drive --scenario ccrx", "did you mean \"ccr"),
        ("simulate --scenario kid", "unknown scenario: expected ccrs, ccrm, ccrb, cpna, cpfa, cpla, child"),
        ("drive --scenario {desk}/broken.toml", "unknown field `rain`"),
        ("drive --scenario {desk}/no.toml", "no.toml: cannot be read: No such file"),
        ("drive --conditions rian=1", "did you mean \"rain\"?"),
        ("drive --track {desk}/taken.toml", "track lake: name: expected one other than lake, jungle, mountain, random"),
        ("drive --conditions night=1,night=0", "conditions: expected night once, got it twice: night=1,night=0"),
        ("record --conditions rain=2 --out {new}", "conditions: rain: expected 0 to 1, got 2"),
        ("simulate --conditions {desk}/broken.toml", "broken.toml: conditions: "),
        ("simulate --conditions {desk}/no.toml", "no.toml: cannot be read: No such file"),
        ("suite {desk}/weather-suite.toml --out {new}", "did you mean \"random\"?"),
        ("suite {desk}/large-suite.toml --out {new}", "seeds: expected at most 100000, got 1000000000000"),
        ("suite {desk}/suite.toml --out {new} --jobs 0", "0 is not in 1..=1024"),
        ("suite {desk}/suite.toml --out {new} --jobs 99999", "99999 is not in 1..=1024"),
        ("suite {desk}/no.toml --out {new}", "no.toml: cannot be read: No such file"),
        ("simulate --connect http://localhost:4567", "expected HOST or HOST:PORT"),
        ("replay {run} --connect localhost:0", "expected HOST or HOST:PORT"),
    ] {
        let (code, out, err) = DESK.ran(arguments);
        assert_eq!((code, out.as_str()), (2, ""), "{arguments}: {err}");
        assert!(err.contains(words), "{arguments}: {err}");
        assert!(err.matches("os error").count() <= 1, "{arguments}: {err}");
    }
}

#[test]
fn a_bridge_that_is_not_there_is_one_error_and_no_scorecard() {
    for arguments in ["simulate --connect localhost", "replay {run} --connect 127.0.0.1:1"] {
        // Somebody may have a bridge at the default port of this machine: one of the loopback's others has none.
        let arguments = arguments.replace("localhost", "127.44.55.66");
        let (code, out, err) = DESK.ran(&arguments);
        assert_eq!((code, out.as_str()), (1, ""), "{arguments}: {err}");
        assert_eq!(err.lines().count(), 1, "{arguments}: {err}");
        assert!(err.starts_with("error: cannot connect to 127."), "{arguments}: {err}");
        assert_eq!(err.contains("127.44.55.66:4567"), arguments.starts_with("simulate"), "{err}");
    }
}

#[cfg(unix)]
#[test]
fn ctrl_c_while_a_recipe_records_says_so_and_leaves_nothing() {
    let folder = DESK.path("recipe");
    fs::create_dir(&folder).unwrap();
    let ring = DESK.text("ring.toml");
    let recipe = format!("data = [{{ path = \"lap\" }}]\n[[record]]\nout = \"lap\"\ntrack = {ring:?}\nlaps = 10000\n");
    fs::write(folder.join("recipe.toml"), recipe).unwrap();
    let mut train = DESK.command("train --recipe recipe.toml --out training");
    let train = train.current_dir(&folder).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut train = Running(train);
    let until = Instant::now() + Duration::from_secs(60);
    let begun = || fs::metadata(folder.join("lap.partial/driving_log.csv")).is_ok_and(|log| log.len() > 0);
    while !begun() && Instant::now() < until {
        std::thread::sleep(Duration::from_millis(10));
    }
    train.signal("INT");
    assert_eq!(train.ended(), Some(1));
    let err = std::io::read_to_string(train.0.stderr.take().unwrap()).unwrap();
    assert!(err.contains("error: interrupted while lap was recorded: nothing of it is kept"), "{err}");
    assert_eq!(DESK.names("recipe"), [folder.join("recipe.toml")]);
}

#[test]
fn what_a_recipe_records_is_recorded_with_the_settings_that_are_given() {
    let folder = DESK.path("given");
    fs::create_dir(&folder).unwrap();
    let ring = DESK.text("ring.toml");
    let recipe = format!("data = [{{ path = \"lap\" }}]\n[[record]]\nout = \"lap\"\ntrack = {ring:?}\n");
    fs::write(folder.join("recipe.toml"), recipe).unwrap();
    fs::write(folder.join("given.toml"), "[simulator]\nhz = 5.0\n").unwrap();
    let arguments = "train --config given.toml --recipe recipe.toml --out training --network cps --epochs 1";
    let mut train = DESK.command(&format!("{arguments} --batch 8 --samples-per-epoch 8 --validation-samples 4"));
    let (_, _, err) = said(train.current_dir(&folder).output().unwrap());
    let log = fs::read_to_string(folder.join("lap/driving_log.csv")).unwrap_or_else(|_| panic!("{err}"));
    let rows = log.lines().count();
    assert!((50..100).contains(&rows), "14 s of 5 a second, got {rows}");
}

#[cfg(unix)]
#[test]
fn a_path_that_is_no_text_is_refused_and_never_changed() {
    use std::{ffi::OsStr, os::unix::ffi::OsStrExt};
    let odd = OsStr::from_bytes(b"odd\xff");
    let (code, out, err) = said(DESK.command("drive --recordings").arg(odd).output().unwrap());
    assert_eq!((code, out.as_str()), (2, ""), "{err}");
    assert!(err.contains(r#"expected UTF-8, got "odd\xFF""#), "{err}");
    let mut command = DESK.command("drive --pilot expert --max-time 1");
    let (code, _, err) = said(command.env("LAPWING_RECORDING__DIR", odd).output().unwrap());
    assert_eq!(code, 2, "{err}");
    assert!(err.contains("environment variable LAPWING_RECORDING__DIR: expected text in UTF-8"), "{err}");
    // Where one works in such a folder, what is relative to it is text; what would stand in a file is not.
    let folder = DESK.path("").join(odd);
    fs::create_dir(&folder).unwrap();
    let track = DESK.text("ring.toml");
    let ran = |arguments: &str| {
        said(DESK.command(arguments).arg("--track").arg(&track).current_dir(&folder).output().unwrap())
    };
    let (code, _, err) = ran("drive --pilot expert --max-time 1 --recordings runs");
    assert_eq!((code, fs::read_dir(folder.join("runs")).unwrap().count()), (0, 1), "{err}");
    let (code, _, err) = ran("record --max-time 1 --out data");
    assert!(code == 1 && err.contains("expected a folder with a path in UTF-8"), "{err}");
    assert!(!folder.join("data").exists());
    // And a run of such a name in a folder is named by no other.
    let run = fs::read_dir(folder.join("runs")).unwrap().next().unwrap().unwrap().path();
    fs::rename(&run, folder.join("runs").join(OsStr::from_bytes(b"\xff.mcap"))).unwrap();
    let (code, out, err) = said(DESK.command("score runs").current_dir(&folder).output().unwrap());
    assert_eq!((code, out.as_str()), (1, ""), "{err}");
    assert!(err.contains(r#"\xFF.mcap": expected a name in UTF-8: rename it"#), "{err}");
    fs::copy(folder.join("runs").join(OsStr::from_bytes(b"\xff.mcap")), &run).unwrap();
    let (code, out, err) = said(DESK.command("score runs").current_dir(&folder).output().unwrap());
    assert!(code == 1 && out.contains("distance") && err.contains("1 of 2 runs cannot be scored"), "{out}{err}");
}
