//! Reads a run item by item, with one chunk in memory at a time.

use std::{
    collections::HashMap,
    fmt,
    fs::File,
    io::{BufReader, Read, Seek},
    path::{Path, PathBuf},
    time::Duration,
};

use foxglove::messages::CompressedImage;
use mcap::{
    MAGIC, Summary,
    records::op,
    sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions},
};
use prost::Message;
use serde::de::DeserializeOwned;

use super::{
    Entries, Item, MOST_PICTURE, RecordingError, RunHeader,
    container::{BodyFields, Broken, Chunk, Container},
    format::{Channel, RUN},
};

/// Records of the summary longer than this are not ours: an index of a chunk takes about a hundred bytes.
const SUMMARY_RECORD: usize = 1 << 20;
/// Nor is a longer summary: a day's chunks take about 10 MB.
const SUMMARY: usize = 64 << 20;
/// The longest telemetry, command or event, as JSON: the recorder cuts texts longer than some thousand characters.
const MOST_JSON: usize = 1 << 20;

/// An item and the time since the run began.
type Yield = Result<(Duration, Item), RecordingError>;

/// Where and why a file is cut off or damaged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Truncation {
    /// The place of the first damage, in bytes from the beginning.
    pub at: u64,
    /// How many bytes could not be read, there and further on.
    pub unread: u64,
    /// What was expected there, and what came.
    pub why: String,
}

impl fmt::Display for Truncation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "cut off or damaged at byte {}: {}", self.at, self.why)?;
        if self.unread > 0 { write!(f, "; {} bytes are not read", self.unread) } else { Ok(()) }
    }
}

/// Reads a run: its header at once, its items as an iterator.
///
/// Files that other tools have rewritten (with compressed chunks, without chunks, with channels of their own) read as
/// well; channels that are not a run's are skipped. A file that is cut off reads up to the last whole chunk. A damaged
/// chunk is left out. [`truncated`](Self::truncated) tells of both, and if the number of messages differs from the
/// file's statistics.
///
/// The iterator yields [`RecordingError::Message`] for a message that does not parse, and continues after it. It yields
/// [`RecordingError::Io`] if the file cannot be read any further, and ends.
pub struct RunReader {
    path: PathBuf,
    header: RunHeader,
    container: Container<BufReader<File>>,
    /// By id; `None` for channels without items: those for viewers, and other tools' own.
    channels: HashMap<u16, Option<Channel>>,
    chunk: Option<Chunk>,
    /// How many bytes the chunks to come may unpack to.
    may_unpack: u64,
    /// How many chunks are left out so far.
    left_out: usize,
    /// Where the record being read begins.
    at: u64,
    /// Messages so far, and how many there are by the file's own statistics.
    messages: u64,
    counted: Option<u64>,
    truncation: Option<Truncation>,
    done: bool,
}

impl fmt::Debug for RunReader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RunReader").field("path", &self.path).field("at", &self.at).finish_non_exhaustive()
    }
}

impl RunReader {
    /// Opens a run and reads its header.
    ///
    /// # Errors
    /// [`RecordingError::Io`], [`RecordingError::NotARun`] for anything that is
    /// not MCAP, [`RecordingError::NoHeader`] for an MCAP file of another
    /// program, [`RecordingError::Newer`] and [`RecordingError::Header`] for a
    /// header that cannot be understood.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, RecordingError> {
        let path = path.as_ref();
        let io = |e| RecordingError::io("read", path)(e);
        let not_a_run = |got| Err(RecordingError::NotARun { path: path.to_owned(), got });
        let metadata = path.metadata().map_err(io)?;
        if metadata.is_dir() {
            return not_a_run("a folder; a run is one file in it, and a folder with driving_log.csv is a data set");
        }
        if !metadata.is_file() {
            return not_a_run("a device or a pipe"); // opening a pipe may take forever
        }
        let (mut file, len) = (BufReader::new(File::open(path).map_err(io)?), metadata.len());
        let mut start = Vec::new();
        file.by_ref().take(64).read_to_end(&mut start).map_err(io)?;
        if !start.starts_with(MAGIC) {
            return not_a_run(what_is(&start));
        }
        let mut container = Container::new(file, len).map_err(io)?;
        let header = find_header(path, &mut container)?;
        let container = Container::new(container.into_inner(), len).map_err(io)?;
        Ok(Self {
            path: path.to_owned(),
            header,
            may_unpack: container.may_unpack(),
            container,
            channels: HashMap::new(),
            chunk: None,
            left_out: 0,
            at: 0,
            messages: 0,
            counted: None,
            truncation: None,
            done: false,
        })
    }

    /// How the run was made.
    pub fn header(&self) -> &RunHeader {
        &self.header
    }

    /// The run's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How many telemetries there are, if the file ends in good order and says so.
    pub fn telemetries(&self) -> Option<u64> {
        let summary = self.summary()?;
        let channel = summary.channels.values().find(|c| c.topic == Channel::Telemetry.topic())?;
        summary.stats?.channel_message_counts.get(&channel.id).copied()
    }

    /// What stands after the data, if the file ends in good order.
    fn summary(&self) -> Option<Summary> {
        let mut file = File::open(&self.path).ok()?;
        let len = file.metadata().ok()?.len();
        let options = SummaryReaderOptions::default().with_file_size(len).with_record_length_limit(SUMMARY_RECORD);
        let (mut reader, mut left) = (SummaryReader::new_with_options(options), SUMMARY);
        while let Some(event) = reader.next_event() {
            match event.ok()? {
                SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to).ok()?),
                SummaryReadEvent::ReadRequest(n) => {
                    let read = file.read(reader.insert(n)).ok()?;
                    left = left.checked_sub(read)?;
                    reader.notify_read(read);
                }
            }
        }
        reader.finish()
    }

    /// How the file ends, once the iterator has ended: `None` if in good order.
    pub fn truncated(&self) -> Option<&Truncation> {
        self.truncation.as_ref()
    }

    /// How many damaged chunks are left out so far.
    pub(super) fn left_out(&self) -> usize {
        self.left_out
    }

    /// The items joined: each telemetry with its picture and its answer.
    pub fn entries(self) -> Entries {
        Entries::new(self)
    }

    /// The next record that may matter: from the open chunk, else from the file.
    fn step(&mut self) -> Result<Option<Yield>, Broken> {
        loop {
            let Self { chunk, container, channels, may_unpack, .. } = self;
            let in_chunk = chunk.is_some();
            let (opcode, body) = match chunk {
                Some(open) => match open.next() {
                    Some(record) => record,
                    None => {
                        self.chunk = None;
                        continue;
                    }
                },
                None => {
                    self.at = container.at();
                    let wanted = [op::CHUNK, op::CHANNEL, op::MESSAGE, op::STATISTICS];
                    match container.next(|opcode| wanted.contains(&opcode))? {
                        Some(record) => record,
                        None => return self.end(),
                    }
                }
            };
            match opcode {
                op::CHUNK if !in_chunk => match Chunk::new(body, may_unpack) {
                    Ok(chunk) => self.chunk = Some(chunk),
                    Err(Broken::Damaged(why)) => self.leave_out(why)?,
                    Err(error) => return Err(error),
                },
                op::CHANNEL => {
                    let (id, topic, encoding) = BodyFields(body)
                        .channel()
                        .ok_or_else(|| Broken::Damaged("expected a channel, got a piece of one".into()))?;
                    channels.insert(id, Channel::with_items(topic, encoding));
                }
                op::STATISTICS => self.counted = BodyFields(body).statistics(),
                op::MESSAGE => {
                    self.messages += 1;
                    let (id, log_time, data) = BodyFields(body)
                        .message()
                        .ok_or_else(|| Broken::Damaged("expected a message, got a piece of one".into()))?;
                    let at = Duration::from_nanos(log_time.saturating_sub(self.header.started_ns()));
                    let (topic, item) = match channels.get(&id) {
                        Some(None) => continue,
                        Some(Some(channel)) => (channel.topic().to_owned(), parse(*channel, data)),
                        None => (format!("channel {id}"), Err("expected a channel declared before, got none".into())),
                    };
                    return Ok(Some(item.map(|item| (at, item)).map_err(|why| RecordingError::Message {
                        path: self.path.clone(),
                        channel: topic,
                        at,
                        why,
                    })));
                }
                _ => {}
            }
        }
    }
}

impl RunReader {
    /// A chunk is damaged: what it declared stands once more at the file's end. If that is damaged, too, and no channel is
    /// known yet, nothing can be made of what follows.
    fn leave_out(&mut self, why: String) -> Result<(), Broken> {
        let summary = if self.truncation.is_none() { self.summary() } else { None };
        if summary.is_none() && self.channels.is_empty() {
            return Err(Broken::Damaged(why));
        }
        if let Some(summary) = summary {
            for channel in summary.channels.values() {
                let known = || Channel::with_items(&channel.topic, &channel.message_encoding);
                self.channels.entry(channel.id).or_insert_with(known);
            }
        }
        self.left_out += 1;
        self.damaged(why, self.container.at() - self.at);
        Ok(())
    }

    /// The first damage is told; how much could not be read is added up.
    fn damaged(&mut self, why: String, unread: u64) {
        let at = self.at;
        self.truncation.get_or_insert(Truncation { at, unread: 0, why }).unread += unread;
    }

    /// After the file's orderly end. Its statistics reveal damage that hides a whole chunk.
    fn end(&mut self) -> Result<Option<Yield>, Broken> {
        self.done = true;
        self.at = self.container.len();
        match self.counted {
            Some(counted) if counted != self.messages && self.truncation.is_none() => Err(Broken::Damaged(format!(
                "expected {counted} messages by the file's own count, got {}",
                self.messages
            ))),
            _ => Ok(None),
        }
    }
}

impl Iterator for RunReader {
    type Item = Yield;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        match self.step() {
            Ok(item) => item,
            Err(Broken::Damaged(why)) => {
                self.done = true;
                self.damaged(why, self.container.len().saturating_sub(self.at));
                None
            }
            Err(Broken::Io(e)) => {
                self.done = true;
                Some(Err(RecordingError::io("read", &self.path)(e)))
            }
        }
    }
}

/// The metadata record `lapwing.run`. It comes first in what the recorder
/// writes; tools that rewrite files may put it elsewhere.
fn find_header(path: &Path, container: &mut Container<BufReader<File>>) -> Result<RunHeader, RecordingError> {
    let none = |why: String| Err(RecordingError::NoHeader { path: path.to_owned(), why });
    loop {
        match container.next(|opcode| opcode == op::METADATA) {
            Ok(Some((op::METADATA, body))) => match BodyFields(body).metadata() {
                Some((RUN, fields)) => return RunHeader::from_metadata(path, fields),
                Some(_) => {}
                None => return none("a metadata record is damaged".into()),
            },
            Ok(Some(_)) => {}
            Ok(None) => return none("another program made this file".into()),
            Err(Broken::Damaged(why)) => {
                return none(format!("another program made this file, or it is cut off before: {why}"));
            }
            Err(Broken::Io(e)) => return Err(RecordingError::io("read", path)(e)),
        }
    }
}

/// What kind of file this is, if not MCAP, by its first bytes.
fn what_is(start: &[u8]) -> &'static str {
    let is_text = std::str::from_utf8(start).is_ok_and(|t| !t.contains('\0'));
    match start {
        [] => "an empty file: the disk was full, or whatever made it ended too early",
        _ if MAGIC.starts_with(start) => "its first bytes only: it is cut off",
        _ if start.iter().all(|b| *b == 0) => "zeros: the machine went down before the file was on disk",
        [b'{', ..] if is_text => "JSON, as in a golden file or a result",
        _ if is_text && start.contains(&b',') => "comma-separated text; a driving log is a data set, not a run",
        _ if is_text => "text",
        _ => "another kind of file",
    }
}

/// One message of a run.
fn parse(channel: Channel, data: &[u8]) -> Result<Item, String> {
    match channel {
        // Not among those that are read.
        Channel::Log | Channel::Transform | Channel::Scene => {
            Err("expected a channel with items, got one without".into())
        }
        Channel::Camera => {
            let image = CompressedImage::decode(data).map_err(|e| format!("expected a CompressedImage: {e}"))?;
            if image.format != "jpeg" {
                return Err(format!("expected a picture in the format jpeg, got {:.40?}", image.format));
            }
            if image.data.len() > MOST_PICTURE {
                return Err(format!("expected a picture of at most {MOST_PICTURE} bytes, got {}", image.data.len()));
            }
            Ok(Item::Frame(image.data))
        }
        Channel::Telemetry => json(data).map(Item::Telemetry),
        Channel::Command => json(data).map(Item::Command),
        Channel::Event => json(data).map(Item::Event),
    }
}

fn json<T: DeserializeOwned>(data: &[u8]) -> Result<T, String> {
    if data.len() > MOST_JSON {
        return Err(format!("expected at most {MOST_JSON} bytes of JSON, got {}", data.len()));
    }
    serde_json::from_slice(data).map_err(|e| {
        let got: String = String::from_utf8_lossy(&data[..data.len().min(240)]).chars().take(60).collect();
        format!("{:.300}, got {got:?}", e.to_string())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_may_be_as_long_in_a_run_as_in_a_file_whatever_comes_with_it() {
        let of = |bytes: usize| {
            let format = "jpeg".into();
            let image = CompressedImage { data: vec![0; bytes].into(), format, ..CompressedImage::default() };
            parse(Channel::Camera, &image.encode_to_vec())
        };
        assert!(matches!(of(MOST_PICTURE), Ok(Item::Frame(jpeg)) if jpeg.len() == MOST_PICTURE));
        let error = of(MOST_PICTURE + 1).unwrap_err();
        assert_eq!(error, "expected a picture of at most 16777216 bytes, got 16777217");
    }
}
