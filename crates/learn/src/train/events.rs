//! Training curves as TensorBoard reads them: one event file per run of training, appended to and never rewritten.
//!
//! An event is a protobuf message of `tensorflow/core/util/event.proto` (the fields here carry the numbers published
//! there), framed as a TFRecord (`tensorflow/core/lib/io/record_writer.h`): length as u64, its checksum, the message,
//! its checksum, all little-endian. A checksum is a CRC-32C, rotated and shifted so that a checksum of data that
//! holds checksums stays a good one.

use std::{
    fs::{self, File},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

use crc::{CRC_32_ISCSI, Crc, Table};
use prost::Message;

/// CRC-32C goes by the name of iSCSI, which made it common.
static CRC: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISCSI);

/// The content of a file's first event.
const VERSION: &str = "brain.Event:2";

/// A moment of training.
#[derive(Clone, PartialEq, prost::Message)]
struct TfEvent {
    /// Seconds since 1970.
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    // One of the next three is present: `oneof what`.
    #[prost(string, optional, tag = "3")]
    file_version: Option<String>,
    #[prost(message, optional, tag = "5")]
    summary: Option<TfSummary>,
    #[prost(message, optional, tag = "7")]
    session_log: Option<TfSessionLog>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct TfSummary {
    #[prost(message, repeated, tag = "1")]
    value: Vec<TfValue>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct TfValue {
    #[prost(string, tag = "1")]
    tag: String,
    /// `optional`, so that a 0 is written: it is one of a `oneof`.
    #[prost(float, optional, tag = "2")]
    simple_value: Option<f32>,
}

#[derive(Clone, Copy, PartialEq, prost::Message)]
struct TfSessionLog {
    /// `SessionStatus`.
    #[prost(int32, tag = "1")]
    status: i32,
}

/// `SessionLog.START`.
const START: i32 = 1;

/// Writes an event file.
///
/// Events wait in memory until [`flush`](Self::flush), or until it is dropped. A file that a crash cuts off can be read
/// up to there.
#[derive(Debug)]
pub struct Events {
    path: PathBuf,
    file: BufWriter<File>,
}

impl Events {
    /// Begins a file in a folder, which is created if it does not exist. `now` is the wall clock in seconds since 1970;
    /// it names the file: `events.out.tfevents.<seconds>.lapwing`, followed by a number if one of that second exists
    /// already. TensorBoard shows all files of a folder as one run.
    ///
    /// `from` is the lowest step of the points to come. TensorBoard drops what the folder's earlier files hold from
    /// there on: a training that was killed has written more than it saved, and writes it again when it is resumed.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn create(dir: &Path, now: f64, from: i64) -> io::Result<Self> {
        fs::create_dir_all(dir)?;
        let name = format!("events.out.tfevents.{:010}.lapwing", now.max(0.0) as u64);
        let mut number = 0;
        let (path, file) = loop {
            let count = if number == 0 { String::new() } else { format!(".{number}") };
            let path = dir.join(format!("{name}{count}"));
            match File::create_new(&path) {
                Ok(file) => break (path, file),
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists && number < 10_000 => number += 1,
                Err(e) => return Err(e),
            }
        };
        let mut events = Self { path, file: BufWriter::new(file) };
        events.write(&TfEvent { wall_time: now, file_version: Some(VERSION.into()), ..TfEvent::default() })?;
        // In each file, the first too: TensorBoard takes a folder's first START for its beginning, and drops nothing.
        let session_log = Some(TfSessionLog { status: START });
        events.write(&TfEvent { wall_time: now, step: from, session_log, ..TfEvent::default() })?;
        events.flush()?;
        Ok(events)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Adds a point to a curve. `tag` names the curve (`loss/train`; the part before a slash groups curves), `step` is
    /// the point's position along it, `wall` is the wall clock in seconds since 1970.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn scalar(&mut self, tag: &str, step: i64, wall: f64, value: f32) -> io::Result<()> {
        let value = TfValue { tag: tag.into(), simple_value: Some(value) };
        let summary = Some(TfSummary { value: vec![value] });
        self.write(&TfEvent { wall_time: wall, step, summary, ..TfEvent::default() })
    }

    /// Hands what waits in memory to the system, so that TensorBoard sees it.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }

    fn write(&mut self, event: &TfEvent) -> io::Result<()> {
        self.file.write_all(&record(&event.encode_to_vec()))
    }
}

/// A message in its frame.
fn record(message: &[u8]) -> Vec<u8> {
    let length = (message.len() as u64).to_le_bytes();
    [&length[..], &masked_crc(&length).to_le_bytes(), message, &masked_crc(message).to_le_bytes()].concat()
}

/// `tensorflow/core/lib/hash/crc32c.h`, `Mask`.
fn masked_crc(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// The events of a file, each with its checksums checked.
    fn read(mut bytes: &[u8]) -> Vec<TfEvent> {
        let mut events = Vec::new();
        while !bytes.is_empty() {
            let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
            let crc = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
            assert_eq!(crc(8), masked_crc(&bytes[..8]));
            let message = &bytes[12..12 + length];
            assert_eq!(crc(12 + length), masked_crc(message));
            events.push(TfEvent::decode(message).unwrap());
            bytes = &bytes[16 + length..];
        }
        events
    }

    /// The steps of a curve of a folder as TensorBoard shows them (`plugin_event_accumulator.py`,
    /// `_CheckForRestartAndMaybePurge`): files go by name; each START but the first drops what came before it, from its
    /// step on.
    pub(crate) fn steps_shown(dir: &Path, tag: &str) -> Vec<i64> {
        let mut files: Vec<_> = fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.retain(|path| path.to_string_lossy().contains("events.out.tfevents."));
        files.sort();
        let (mut steps, mut has_begun) = (Vec::<i64>::new(), false);
        for event in files.iter().flat_map(|path| read(&fs::read(path).unwrap())) {
            if event.session_log == Some(TfSessionLog { status: START }) {
                steps.retain(|step| !has_begun || *step < event.step);
                has_begun = true;
            }
            if event.summary.iter().flat_map(|summary| &summary.value).any(|value| value.tag == tag) {
                steps.push(event.step);
            }
        }
        steps
    }

    #[test]
    fn the_checksum_is_crc_32c_masked_as_tensorflow_does() {
        // The check value from the catalogue, and its mask calculated by hand.
        assert_eq!(CRC.checksum(b"123456789"), 0xe306_9283);
        assert_eq!(masked_crc(b"123456789"), 0xc78a_b0e5);
    }

    #[test]
    fn a_file_begins_with_the_bytes_that_tensorflow_writes() {
        let dir = tempfile::tempdir().unwrap();
        let events = Events::create(dir.path(), 1_700_000_000.5, 1).unwrap();
        let bytes = fs::read(events.path()).unwrap();
        // Length 24 and its checksum open every event file there is; then wall_time, and file_version.
        assert_eq!(bytes[..12], [0x18, 0, 0, 0, 0, 0, 0, 0, 0xa3, 0x7f, 0x4b, 0x22]);
        assert_eq!(bytes[12], 0x09);
        assert_eq!(bytes[13..21], 1_700_000_000.5f64.to_le_bytes());
        assert_eq!(bytes[21..36], *b"\x1a\x0dbrain.Event:2");
        // wall_time; step 1; session_log { status START }
        assert_eq!(bytes[40..48], 15u64.to_le_bytes());
        assert_eq!(bytes[52..67], [&bytes[12..21], b"\x10\x01\x3a\x02\x08\x01"].concat());
        assert_eq!(bytes.len(), 71);
        assert_eq!(events.path().file_name().unwrap(), "events.out.tfevents.1700000000.lapwing");
    }

    #[test]
    fn a_scalar_is_the_message_of_the_published_schema() {
        let dir = tempfile::tempdir().unwrap();
        let mut events = Events::create(dir.path(), 0.0, 0).unwrap();
        let begin = fs::read(events.path()).unwrap().len();
        events.scalar("a", 3, 0.5, 1.0).unwrap();
        events.flush().unwrap();
        let bytes = fs::read(events.path()).unwrap();
        // wall_time 0.5; step 3; summary { value { tag "a", simple_value 1.0 } }
        let message = b"\x09\0\0\0\0\0\0\xe0\x3f\x10\x03\x2a\x0a\x0a\x08\x0a\x01a\x15\0\0\x80\x3f";
        assert_eq!(bytes[begin + 12..bytes.len() - 4], message[..]);
    }

    #[test]
    fn what_is_written_is_read_back_with_its_zeros() {
        let dir = tempfile::tempdir().unwrap();
        let mut events = Events::create(&dir.path().join("runs/first"), 12.0, -1).unwrap();
        let written = [("loss/train", 0, 0.0), ("loss/train", 1, 0.25), ("loss/validation", -1, f32::NAN)];
        for (tag, step, value) in written {
            events.scalar(tag, step, 13.0, value).unwrap();
        }
        let path = events.path().to_owned();
        drop(events);
        let read = read(&fs::read(path).unwrap());
        assert_eq!(read[0].file_version.as_deref(), Some(VERSION));
        assert_eq!((read[1].step, read[1].session_log), (-1, Some(TfSessionLog { status: START })));
        for (event, (tag, step, value)) in read[2..].iter().zip(written) {
            let [got] = &event.summary.as_ref().unwrap().value[..] else { panic!() };
            assert_eq!((got.tag.as_str(), event.step, event.wall_time), (tag, step, 13.0));
            assert_eq!(got.simple_value.unwrap().to_bits(), value.to_bits());
        }
        assert_eq!(read.len(), 5);
    }

    #[test]
    fn a_second_file_of_the_same_second_leaves_the_first_alone() {
        let dir = tempfile::tempdir().unwrap();
        let first = Events::create(dir.path(), 5.0, 0).unwrap().path().to_owned();
        let before = fs::read(&first).unwrap();
        let second = Events::create(dir.path(), 5.9, 0).unwrap().path().to_owned();
        assert_ne!(first, second);
        assert_eq!(fs::read(first).unwrap(), before);
    }

    #[test]
    fn a_later_file_takes_back_what_earlier_ones_hold_from_its_first_step_on() {
        let dir = tempfile::tempdir().unwrap();
        for (from, steps) in [(0, [1, 2, 3]), (3, [3, 4, 5]), (5, [5, 6, 7])] {
            let mut events = Events::create(dir.path(), 5.0, from).unwrap();
            for step in steps {
                events.scalar("loss", step, 5.0, 0.5).unwrap();
            }
        }
        assert_eq!(steps_shown(dir.path(), "loss"), [1, 2, 3, 4, 5, 6, 7]);
    }
}
