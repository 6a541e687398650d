//! Writes items as MCAP, chunk by chunk, to any sink. No thread, no clock.

use std::{
    collections::BTreeMap,
    io::{self, Seek, Write},
    time::Duration,
};

use mcap::{McapError, WriteOptions, records::MessageHeader};
use prost::Message;

use super::{
    Item, RunHeader,
    format::{Channel, CompressedImage, RUN, SUMMARY},
};

/// The coordinate frame of the picture, for viewers that place it.
const FRAME_ID: &str = "camera_center";

/// Writes one run.
///
/// Chunks are built in memory and reach the sink in one piece with [`flush`](Self::flush): what was flushed can be read
/// whatever happens later. They are not compressed, as JPEG does not compress.
pub(super) struct RunWriter<W: Write + Seek> {
    mcap: mcap::Writer<W>,
    started_ns: u64,
    /// Channel id and next sequence number, by the order of [`Channel::ALL`].
    channels: [(u16, u32); 4],
    message: Vec<u8>,
    unflushed: usize,
}

impl<W: Write + Seek> RunWriter<W> {
    /// Writes the beginning of a run. The channels wait in memory for the first chunk.
    pub(super) fn new(sink: W, header: &RunHeader) -> io::Result<Self> {
        let mut mcap = WriteOptions::new()
            .compression(None)
            .library(format!("lapwing {}", header.lapwing))
            // Chunks end where `flush` says so, and with seeking disabled are buffered up to there.
            .chunk_size(None)
            .disable_seeking(true)
            .create(sink)
            .map_err(io_error)?;
        mcap.write_metadata(&mcap::records::Metadata { name: RUN.into(), metadata: header.to_metadata() })
            .map_err(io_error)?;
        let mut channels = [(0, 0); 4];
        for (channel, (id, _)) in Channel::ALL.into_iter().zip(&mut channels) {
            let (name, encoding, data) = channel.schema();
            let schema = mcap.add_schema(name, encoding, &data).map_err(io_error)?;
            *id = mcap
                .add_channel(schema, channel.topic(), channel.message_encoding(), &BTreeMap::new())
                .map_err(io_error)?;
        }
        Ok(Self { mcap, started_ns: header.started_ns(), channels, message: Vec::new(), unflushed: 0 })
    }

    /// Adds an item to the chunk in memory.
    pub(super) fn write(&mut self, at: Duration, item: &Item) -> io::Result<()> {
        let time = self.started_ns.saturating_add(u64::try_from(at.as_nanos()).unwrap_or(u64::MAX));
        let message = &mut self.message;
        message.clear();
        let channel = match item {
            Item::Frame(jpeg) => {
                let image = CompressedImage {
                    timestamp: Some(prost_types::Timestamp {
                        seconds: i64::try_from(time / 1_000_000_000).unwrap_or(i64::MAX),
                        nanos: (time % 1_000_000_000) as i32,
                    }),
                    frame_id: FRAME_ID.into(),
                    data: jpeg.clone(),
                    format: "jpeg".into(),
                };
                image.encode(message).map_err(io::Error::other)?;
                Channel::Camera
            }
            Item::Telemetry(telemetry) => {
                serde_json::to_writer(message, telemetry)?;
                Channel::Telemetry
            }
            Item::Command(command) => {
                serde_json::to_writer(message, command)?;
                Channel::Command
            }
            Item::Event(event) => {
                serde_json::to_writer(message, event)?;
                Channel::Event
            }
        };
        let (channel_id, sequence) = &mut self.channels[channel as usize];
        let header = MessageHeader { channel_id: *channel_id, sequence: *sequence, log_time: time, publish_time: time };
        *sequence = sequence.wrapping_add(1);
        self.mcap.write_to_known_channel(&header, &self.message).map_err(io_error)?;
        self.unflushed += self.message.len();
        Ok(())
    }

    /// Bytes of messages in the chunk in memory.
    pub(super) fn unflushed(&self) -> usize {
        self.unflushed
    }

    /// Ends the chunk and hands it to the sink.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.unflushed = 0;
        self.mcap.flush().map_err(io_error)
    }

    /// Ends the file, with what was counted and with indexes; returns the sink.
    pub(super) fn finish(mut self, summary: BTreeMap<String, String>) -> io::Result<W> {
        self.mcap
            .write_metadata(&mcap::records::Metadata { name: SUMMARY.into(), metadata: summary })
            .map_err(io_error)?;
        self.mcap.finish().map_err(io_error)?;
        Ok(self.mcap.into_inner())
    }
}

/// The system's error, if that is the cause: the container's own message leaves it out.
fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(e) => e,
        other => io::Error::other(other),
    }
}
