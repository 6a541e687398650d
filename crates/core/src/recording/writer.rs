//! Writes items as MCAP, chunk by chunk, to any sink. No thread, no clock.

use std::{
    collections::BTreeMap,
    io::{self, Seek, Write},
    sync::Arc,
    time::Duration,
};

use mcap::{McapError, WriteOptions, records::MessageHeader};

use super::{
    Item, Messages, RunHeader,
    format::{Channel, RUN, SUMMARY},
    messages::EncodeError,
    scene::Roadway,
};

/// Writes one run.
///
/// Chunks are built in memory and reach the sink in one piece with [`flush`](Self::flush): what was flushed can be read
/// whatever happens later. They are not compressed, as JPEG does not compress.
pub(super) struct RunWriter<W: Write + Seek> {
    mcap: mcap::Writer<W>,
    messages: Messages,
    /// Channel id and next sequence number, by the order of [`Channel::ALL`].
    channels: [(u16, u32); Channel::ALL.len()],
    unflushed: usize,
}

impl<W: Write + Seek> RunWriter<W> {
    /// Writes the beginning of a run, on one of these roads if it tells its track. The channels wait in memory for the
    /// first chunk.
    pub(super) fn new(sink: W, header: &RunHeader, roads: Arc<[Roadway]>) -> io::Result<Self> {
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
        let mut channels = [(0, 0); Channel::ALL.len()];
        for (channel, (id, _)) in Channel::ALL.into_iter().zip(&mut channels) {
            let schema = channel.schema();
            let schema = mcap.add_schema(schema.name, schema.encoding, &schema.data).map_err(io_error)?;
            *id = mcap
                .add_channel(schema, channel.topic(), channel.message_encoding(), &BTreeMap::new())
                .map_err(io_error)?;
        }
        Ok(Self { mcap, messages: Messages::new(header.started, roads, ""), channels, unflushed: 0 })
    }

    /// Adds an item to the chunk in memory.
    pub(super) fn write(&mut self, at: Duration, item: &Item) -> io::Result<()> {
        let Self { mcap, messages, channels, unflushed } = self;
        messages.of(at, item, |message| {
            let (channel_id, sequence) = &mut channels[message.channel as usize];
            let (log_time, publish_time) = (message.time_ns, message.time_ns);
            let header = MessageHeader { channel_id: *channel_id, sequence: *sequence, log_time, publish_time };
            *sequence = sequence.wrapping_add(1);
            mcap.write_to_known_channel(&header, message.data).map_err(io_error)?;
            *unflushed += message.data.len();
            Ok(())
        })
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

impl From<EncodeError> for io::Error {
    fn from(error: EncodeError) -> Self {
        Self::other(error)
    }
}
