//! Where a page's commands run: a folder with what the page takes for granted, and the commands made short.

use std::{
    fs,
    io::{BufRead, BufReader, Read},
    path::Path,
    process::{Child, Command, Stdio},
    sync::LazyLock,
};

use tempfile::TempDir;

use super::{
    page::{Invocation, Page},
    root,
};

/// Pages that begin in a clean clone: they make what they need.
const FROM_NOTHING: [&str; 2] = ["README.md", "docs/tutorial/first-drive.md"];

/// How verbs are made short: flags that are added, or whose value is replaced. Commands whose output is shown are not.
const SHORTER: [(&str, &[(&str, &str)]); 6] = [
    ("drive", &[("--max-time", "1")]),
    ("simulate", &[("--max-time", "1")]),
    ("record", &[("--max-time", "8")]),
    ("brake record", &[("--hours", "0.005")]),
    ("brake trial", &[("--cases", "ccrs,parked"), ("--speeds", "20"), ("--seeds", "1"), ("--laps", "0")]),
    ("train", &[("--epochs", "1"), ("--batch", "8"), ("--samples-per-epoch", "8"), ("--validation-samples", "4")]),
];

/// A network that brakes has seen enough after 20 frames: a drive with one is longer.
const WITH_A_GUARD: [(&str, &str); 1] = [("--max-time", "4")];

/// Set in suites that a page shows.
const SHORTER_SUITE: [(&str, &str); 4] =
    [("tracks", "[\"lake\"]"), ("speeds_mph", "[20]"), ("seeds", "1"), ("longest_s", "1.0")];

/// The port that pages name for a bridge; another one is used here.
const BRIDGE: &str = "127.0.0.1:4567";

/// A folder for the commands of a page.
pub struct Room {
    folder: TempDir,
}

/// What a command did.
pub struct Outcome {
    pub status: i32,
    pub out: String,
    pub err: String,
}

/// What pages take for granted, made once: a data set and a model.
static MADE: LazyLock<Room> = LazyLock::new(|| {
    let room = Room::clean();
    for words in ["lapwing record --out data/lake", "lapwing train --data data/lake --out runs/mine"] {
        let words = words.split(' ').map(str::to_owned).collect();
        let outcome = room.run(&Invocation { line: 0, words, into: None, shown: None });
        assert_eq!(outcome.status, 0, "{}", outcome.err);
    }
    room
});

impl Room {
    /// With the repository's models and recordings.
    fn clean() -> Self {
        let room = Self { folder: tempfile::tempdir().unwrap() };
        for folder in ["models", "recordings"] {
            copy(&root().join(folder), &room.folder.path().join(folder));
        }
        room
    }

    /// For the commands of this page. A block of TOML that begins with the comment `# NAME.toml` is that file.
    pub fn of(page: &Page) -> Self {
        let room = Self::clean();
        if !FROM_NOTHING.contains(&page.name.as_str()) && page.invocations().iter().any(|i| i.words[0] == "lapwing") {
            for folder in ["data", "runs"] {
                copy(&MADE.folder.path().join(folder), &room.folder.path().join(folder));
            }
        }
        for block in page.blocks().into_iter().filter(|block| block.language == "toml") {
            if let Some(name) = block.lines[0].strip_prefix("# ").filter(|name| name.ends_with(".toml")) {
                let mut table: toml::Table = block.lines.join("\n").parse().unwrap();
                if name == "suite.toml" {
                    let shorter = SHORTER_SUITE.map(|(key, value)| format!("{key} = {value}\n")).concat();
                    table.extend(shorter.parse::<toml::Table>().unwrap());
                }
                fs::write(room.folder.path().join(name), table.to_string()).unwrap();
            }
        }
        room
    }

    /// Runs a command of `lapwing`, shortened unless its output is shown.
    pub fn run(&self, invocation: &Invocation) -> Outcome {
        let mut words = invocation.words[1..].to_owned();
        let verb = if words[0] == "brake" { words[..2].join(" ") } else { words[0].clone() };
        let is_long = invocation.shown.is_none() && !words.iter().any(|word| word == "--stances");
        let shorter = SHORTER.iter().find(|(known, _)| *known == verb && is_long);
        let has_guard = verb == "drive" && words.iter().any(|word| word == "--brake-model");
        let flags = shorter.map_or(&[][..], |(_, flags)| if has_guard { &WITH_A_GUARD } else { flags });
        for (flag, value) in flags {
            match words.iter().position(|word| word == flag) {
                Some(at) => words[at + 1] = (*value).to_owned(),
                None => words.extend([*flag, *value].map(str::to_owned)),
            }
        }
        if verb == "serve" {
            words.extend(["--port", "0"].map(str::to_owned));
            return Bridge::start(self, &words).stop();
        }
        let bridge = words
            .iter()
            .any(|word| word == BRIDGE)
            .then(|| Bridge::start(self, &["serve", "--port", "0"].map(str::to_owned)));
        if let Some(bridge) = &bridge {
            words.iter_mut().filter(|word| *word == BRIDGE).for_each(|word| word.clone_from(&bridge.address));
        }
        let output = self.command(&words).output().unwrap();
        if let Some(bridge) = bridge {
            assert_eq!(bridge.stop().status, 0);
        }
        if let Some(into) = &invocation.into {
            fs::write(self.folder.path().join(into), &output.stdout).unwrap();
        }
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        let (out, err) = (text(output.stdout), text(output.stderr));
        // A recording that ends before its laps are driven, as it does here, is kept, and fails.
        let cut_short = verb == "record" && out.contains("(time limit reached)");
        let status = output.status.code().unwrap();
        Outcome { status: if cut_short && status == 1 { 0 } else { status }, out, err }
    }

    fn command(&self, words: &[String]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lapwing"));
        command
            .args(words)
            .current_dir(self.folder.path())
            .env("XDG_CONFIG_HOME", self.folder.path())
            .env_remove("LAPWING_LOG");
        command.stdin(Stdio::null());
        command
    }
}

/// A `lapwing serve` that waits for simulators.
struct Bridge {
    child: Child,
    said: BufReader<std::process::ChildStderr>,
    address: String,
}

impl Bridge {
    fn start(room: &Room, words: &[String]) -> Self {
        let mut child = room.command(words).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut said = BufReader::new(child.stderr.take().unwrap());
        let mut line = String::new();
        said.read_line(&mut line).unwrap();
        let (_, rest) = line.split_once(" simulator on ").unwrap_or_else(|| panic!("no address: {line}"));
        let address = rest.split(". ").next().unwrap().to_owned();
        Self { child, said, address }
    }

    /// Ctrl-C, once the model is there.
    fn stop(mut self) -> Outcome {
        let mut err = String::new();
        while !err.contains("model:") && self.said.read_line(&mut err).unwrap() > 0 {}
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-s", "INT", &pid]).status().unwrap().success());
        self.said.read_to_string(&mut err).unwrap();
        let output = self.child.wait_with_output().unwrap();
        Outcome { status: output.status.code().unwrap(), out: String::from_utf8(output.stdout).unwrap(), err }
    }
}

/// A folder with all that is in it; large files are linked.
fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for path in fs::read_dir(from).unwrap().map(|entry| entry.unwrap().path()) {
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &target);
        } else if fs::hard_link(&path, &target).is_err() {
            fs::copy(&path, &target).unwrap();
        }
    }
}
