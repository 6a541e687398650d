//! A replay kept to compare later ones with, frame by frame: JSON lines, so that
//! a change shows in a diff.

use std::{
    fmt, fs,
    io::{self, BufRead},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use super::{Answered, Response};
use crate::{files, words::count};

const FORMAT: &str = "lapwing-golden/2";

/// Without `written_on`, and with bad frames as if a pilot had answered them.
const OLDER_FORMAT: &str = "lapwing-golden/1";

/// What the last bits of a network's answer depend on besides the network: libtorch chooses its kernels by the
/// processor.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    /// The processor, and how wide it computes.
    pub cpu: String,
    /// Version of libtorch.
    pub libtorch: String,
}

impl fmt::Display for Machine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, libtorch {}", self.cpu, self.libtorch)
    }
}

/// The first line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct GoldenHeader {
    format: String,
    source: String,
    driver: String,
    frames: u64,
    /// Absent if a bridge answered, which does not say what it runs on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    written_on: Option<Machine>,
}

/// The further lines. Steering and throttle are absent if a human drove, or if no network saw the frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    frame: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    steering: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    throttle: Option<f64>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    bad: bool,
}

impl Line {
    fn of(answered: &Answered) -> Self {
        let (command, bad) = match &answered.response {
            Response::Steer(command) | Response::Off(command) => (Some(command), false),
            Response::Human => (None, false),
            Response::Bad { .. } => (None, true),
        };
        let (steering, throttle) = (command.map(|c| c.steering.get()), command.map(|c| c.throttle.get()));
        Self { frame: answered.frame, steering, throttle, bad }
    }
}

/// A stored replay.
#[derive(Debug, Clone, PartialEq)]
pub struct Golden {
    header: GoldenHeader,
    lines: Vec<Line>,
}

/// A golden file that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum GoldenError {
    /// The file cannot be read or written.
    #[error("golden file {path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// Another number of frames than its header says.
    #[error("{}: expected {expected} frames, as its first line says, got {got}: it was cut off or edited", path.display())]
    Frames {
        /// The file.
        path: PathBuf,
        /// Frames by the header.
        expected: u64,
        /// Lines of frames.
        got: usize,
    },
    /// A line is not what it should be.
    #[error("{path}, line {line}: expected {expected}, got {got:?}: {why}")]
    Line {
        /// The file.
        path: PathBuf,
        /// Line number from 1.
        line: usize,
        /// What belongs there.
        expected: &'static str,
        /// The beginning of the line.
        got: String,
        /// What the reader says.
        why: String,
    },
}

/// Where a replay differs from the stored one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// Frame, from 0.
    pub frame: u64,
    /// In words: expected and got.
    pub what: String,
}

impl Golden {
    /// Made from a replay's answers, given on this machine, if that is known.
    pub fn new(source: &str, driver: &str, answers: &[Answered], written_on: Option<Machine>) -> Self {
        Self {
            header: GoldenHeader {
                format: FORMAT.into(),
                source: source.into(),
                driver: driver.into(),
                frames: answers.len() as u64,
                written_on,
            },
            lines: answers.iter().map(Line::of).collect(),
        }
    }

    /// Writes the file whole, or leaves an older one untouched.
    ///
    /// # Errors
    /// [`GoldenError::Io`]
    pub fn write(&self, path: &Path) -> Result<(), GoldenError> {
        let error = |source| GoldenError::Io { path: path.into(), source };
        let mut text = Vec::new();
        serde_json::to_writer(&mut text, &self.header).expect("a header is plain data");
        for line in &self.lines {
            text.push(b'\n');
            serde_json::to_writer(&mut text, line).expect("a line is plain data");
        }
        text.push(b'\n');
        files::write(path, &text).map_err(error)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`GoldenError`] with the line that is wrong.
    pub fn read(path: &Path) -> Result<Self, GoldenError> {
        let io = |source| GoldenError::Io { path: path.into(), source };
        let mut lines = io::BufReader::new(fs::File::open(path).map_err(io)?).lines().enumerate();
        let parse_error = |line: usize, expected, got: &str, why: String| GoldenError::Line {
            path: path.into(),
            line: line + 1,
            expected,
            got: got.chars().take(60).collect(),
            why,
        };
        let first = lines.next().map(|(_, line)| line.map_err(io)).transpose()?.unwrap_or_default();
        // An editor may have put a byte order mark before it.
        let header: GoldenHeader = serde_json::from_str(first.trim_start_matches('\u{feff}'))
            .map_err(|e| parse_error(0, "a golden file's header", &first, e.to_string()))?;
        if ![FORMAT, OLDER_FORMAT].contains(&header.format.as_str()) {
            return Err(parse_error(0, FORMAT, &header.format, "written by another version".into()));
        }
        let lines = lines.map(|(i, line)| {
            let line = line.map_err(io)?;
            serde_json::from_str(&line).map_err(|e| parse_error(i, "a frame", &line, e.to_string()))
        });
        let lines: Vec<Line> = lines.collect::<Result<_, _>>()?;
        if lines.len() as u64 != header.frames {
            return Err(GoldenError::Frames { path: path.into(), expected: header.frames, got: lines.len() });
        }
        Ok(Self { header, lines })
    }

    /// The recording that it was made from.
    pub fn source(&self) -> &str {
        &self.header.source
    }

    /// The machine that it was written on, if that is known.
    pub fn written_on(&self) -> Option<&Machine> {
        self.header.written_on.as_ref()
    }

    /// Where `answers` differ from this replay by more than `tolerance` in steering or throttle, or where a frame is
    /// bad in only one of the two.
    pub fn compare(&self, answers: &[Answered], tolerance: f64) -> Vec<Difference> {
        let mut differences: Vec<Difference> = self
            .lines
            .iter()
            .zip(answers)
            .filter_map(|(expected, answered)| {
                let got = Line::of(answered);
                let apart = |a: Option<f64>, b: Option<f64>| match (a, b) {
                    (Some(a), Some(b)) => (a - b).abs() > tolerance,
                    (a, b) => a.is_some() != b.is_some(),
                };
                let differs = expected.bad != got.bad
                    || apart(expected.steering, got.steering)
                    || apart(expected.throttle, got.throttle);
                differs.then(|| {
                    let why = match &answered.response {
                        Response::Bad { why } => format!(": {why}"),
                        _ => String::new(),
                    };
                    let what = format!("expected {}, got {}{why}", said(expected), said(&got));
                    Difference { frame: got.frame, what }
                })
            })
            .collect();
        if answers.len() != self.lines.len() {
            // First: the file may be another recording's.
            let (frames, source) = (count(self.lines.len(), "frame"), &self.header.source);
            let both = answers.len().min(self.lines.len());
            let got = answers.get(both).map(|answered| answered.frame);
            let first = got.or_else(|| self.lines.get(both).map(|line| line.frame)).unwrap_or_default();
            differences.insert(
                0,
                Difference { frame: first, what: format!("expected {frames}, as in {source}, got {}", answers.len()) },
            );
        }
        differences
    }
}

fn said(line: &Line) -> String {
    match (line.steering, line.throttle) {
        (Some(steering), Some(throttle)) => format!("steering {steering:.5} throttle {throttle:.5}"),
        _ if line.bad => "a bad frame, which no network saw".into(),
        _ => "a human".into(),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::{
        protocol::Command,
        units::{Steering, Throttle},
    };

    fn answers(steerings: &[Option<f64>]) -> Vec<Answered> {
        let response = |s: &Option<f64>| match s {
            Some(s) => Response::Steer(Command { steering: Steering::new(*s).unwrap(), throttle: Throttle::ZERO }),
            None => Response::Human,
        };
        let answered = |(i, s)| Answered { frame: i as u64, at: Duration::ZERO, recorded: None, response: response(s) };
        steerings.iter().enumerate().map(answered).collect()
    }

    fn machine() -> Option<Machine> {
        Some(Machine { cpu: "AMD EPYC (x86_64, AVX-512)".into(), libtorch: "2.13.0".into() })
    }

    fn with_a_bad_frame() -> Vec<Answered> {
        let mut answers = answers(&[Some(0.125), Some(0.0)]);
        answers[1].response = Response::Bad { why: "image: expected a JPEG".into() };
        answers
    }

    #[test]
    fn a_golden_file_is_read_back_as_it_was_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("run.golden");
        for (answers, on) in [(answers(&[Some(0.125), None]), None), (with_a_bad_frame(), machine())] {
            let golden = Golden::new("run", "model", &answers, on.clone());
            golden.write(&path).unwrap();
            assert_eq!(Golden::read(&path).unwrap(), golden);
            assert_eq!(golden.written_on(), on.as_ref());
        }
        let text = fs::read_to_string(&path).unwrap();
        let on = r#""written_on":{"cpu":"AMD EPYC (x86_64, AVX-512)","libtorch":"2.13.0"}}"#;
        assert!(text.lines().next().unwrap().ends_with(on), "{text}");
        assert_eq!(text.lines().nth(2), Some(r#"{"frame":1,"bad":true}"#));
        let golden = Golden::read(&path).unwrap();
        fs::write(&path, format!("\u{feff}{text}")).unwrap();
        assert_eq!(Golden::read(&path).unwrap(), golden);
    }

    #[test]
    fn a_file_from_before_machines_were_told_is_still_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("run.golden");
        let header = r#"{"format":"lapwing-golden/1","source":"run","driver":"model","frames":1}"#;
        fs::write(&path, format!("{header}\n{{\"frame\":0,\"steering\":0.1,\"throttle\":0.0}}\n")).unwrap();
        let golden = Golden::read(&path).unwrap();
        assert_eq!((golden.written_on(), golden.compare(&answers(&[Some(0.1)]), 1e-6)), (None, vec![]));
    }

    #[test]
    fn a_frame_that_is_bad_on_one_side_alone_differs_whatever_was_sent_instead() {
        let of = |answers: &[Answered]| Golden::new("run", "model", answers, machine());
        let (bad, good) = (with_a_bad_frame(), answers(&[Some(0.125), Some(0.0)]));
        assert_eq!(of(&bad).compare(&bad, 1e-3), []);
        let got_bad = of(&good).compare(&bad, 1e-3);
        let expected = "expected steering 0.00000 throttle 0.00000, got a bad frame, which no network saw: image: \
                        expected a JPEG";
        assert_eq!((got_bad.len(), got_bad[0].frame, got_bad[0].what.as_str()), (1, 1, expected));
        let got_good = of(&bad).compare(&good, 1e-3);
        assert!(got_good[0].what.starts_with("expected a bad frame, which no network saw, got steering"));
        let human = of(&bad).compare(&answers(&[Some(0.125), None]), 1e-3);
        assert!(human[0].what.ends_with("got a human"), "{human:?}");
    }

    #[test]
    fn frames_within_the_tolerance_agree_and_others_are_named() {
        let golden = Golden::new("run", "model", &answers(&[Some(0.1), Some(0.2), None]), None);
        assert_eq!(golden.compare(&answers(&[Some(0.1005), Some(0.1995), None]), 1e-3), []);
        let differences = golden.compare(&answers(&[Some(0.1), Some(0.3), Some(0.0)]), 1e-3);
        assert_eq!(differences.iter().map(|d| d.frame).collect::<Vec<_>>(), [1, 2]);
        assert_eq!(
            differences[0].what,
            "expected steering 0.20000 throttle 0.00000, got steering 0.30000 throttle 0.00000"
        );
        assert_eq!(golden.compare(&answers(&[Some(0.1)]), 1e-3)[0].what, "expected 3 frames, as in run, got 1");
    }

    #[test]
    fn a_cut_off_or_foreign_file_is_an_error_with_its_line() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("run.golden");
        Golden::new("run", "model", &answers(&[Some(0.1), Some(0.2)]), None).write(&path).unwrap();
        let whole = fs::read_to_string(&path).unwrap();
        fs::write(&path, &whole[..whole.len() - 5]).unwrap();
        assert!(Golden::read(&path).unwrap_err().to_string().contains("line 3: expected a frame"));
        fs::write(&path, whole.lines().next().unwrap()).unwrap();
        assert!(Golden::read(&path).unwrap_err().to_string().contains("cut off"));
        fs::write(&path, "hello\n").unwrap();
        assert!(Golden::read(&path).unwrap_err().to_string().contains("line 1: expected a golden file's header"));
    }
}
