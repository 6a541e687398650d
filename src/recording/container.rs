//! The records of an MCAP file from its beginning, as far as the file is whole.
//!
//! The framing is read here and not by the crate `mcap`, because a run may be
//! cut off or damaged anywhere: every length is checked against what is really
//! there before memory is taken for it, and the place where the good part ends
//! is known. Chunks are unpacked and checked by the crate.
//! Source: <https://mcap.dev/spec>.

use std::{
    collections::BTreeMap,
    io::{self, BufRead, Seek, SeekFrom},
};

use mcap::{
    MAGIC,
    records::op,
    sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions},
};

/// No record or chunk of a run comes near this. What claims more is damaged.
const LIMIT: usize = 64 << 20;
/// Opcode and length.
const FRAME: usize = 1 + 8;

/// Why a file cannot be read further: in words, or the system says no.
#[derive(Debug)]
pub(super) enum Broken {
    Damaged(String),
    Io(io::Error),
}

impl From<io::Error> for Broken {
    fn from(e: io::Error) -> Self {
        Self::Io(e)
    }
}

fn damaged<T>(why: impl Into<String>) -> Result<T, Broken> {
    Err(Broken::Damaged(why.into()))
}

/// Top-level records, one after the other.
pub(super) struct Container<R> {
    input: R,
    /// Length of the file.
    len: u64,
    /// Where the next record begins; everything before is whole.
    at: u64,
    ended: bool,
    body: Vec<u8>,
}

impl<R: BufRead + Seek> Container<R> {
    /// Starts behind the magic, which the caller has checked.
    pub(super) fn new(mut input: R, len: u64) -> io::Result<Self> {
        let at = MAGIC.len() as u64;
        input.seek(SeekFrom::Start(at))?;
        Ok(Self { input, len, at, ended: false, body: Vec::new() })
    }

    /// The opcode and body of the next record; the body of an unwanted one is passed over.
    /// `None` is the file's orderly end.
    pub(super) fn next(&mut self, wanted: impl Fn(u8) -> bool) -> Result<Option<(u8, &[u8])>, Broken> {
        if self.ended {
            return Ok(None);
        }
        let left = self.len.saturating_sub(self.at);
        if left < FRAME as u64 {
            return damaged(format!("expected a record, got the file's end after {left} bytes"));
        }
        let mut frame = [0; FRAME];
        self.input.read_exact(&mut frame)?;
        let opcode = frame[0];
        let length = u64::from_le_bytes(frame[1..].try_into().expect("eight bytes"));
        let left = left - FRAME as u64;
        if opcode == 0 {
            return damaged("expected a record, got a zero byte");
        }
        if length > left {
            return damaged(format!("expected a record of {length} bytes, got {left} of them"));
        }
        if !wanted(opcode) && opcode != op::FOOTER {
            self.input.seek_relative(i64::try_from(length).map_err(io::Error::other)?)?;
            self.body.clear();
        } else if length > LIMIT as u64 {
            return damaged(format!("expected a record of {LIMIT} bytes at most, got {length}"));
        } else {
            self.body.resize(length as usize, 0);
            self.input.read_exact(&mut self.body)?;
        }
        if opcode == op::FOOTER {
            self.end(left - length)?;
        }
        self.at += FRAME as u64 + length;
        Ok(Some((opcode, &self.body)))
    }

    /// After the footer comes the magic again, and nothing else.
    fn end(&mut self, left: u64) -> Result<(), Broken> {
        let mut magic = [0; MAGIC.len()];
        if left < MAGIC.len() as u64 {
            return damaged("expected the end mark, got the file's end");
        }
        self.input.read_exact(&mut magic)?;
        if magic != MAGIC {
            return damaged("expected the end mark, got other bytes");
        }
        if left > MAGIC.len() as u64 {
            return damaged(format!("expected the file's end, got {} more bytes", left - MAGIC.len() as u64));
        }
        self.ended = true;
        Ok(())
    }

    /// Where the good part ends so far.
    pub(super) fn at(&self) -> u64 {
        self.at
    }

    /// Gives the input back, to start anew.
    pub(super) fn into_inner(self) -> R {
        self.input
    }

    /// Length of the file when it was opened.
    pub(super) fn len(&self) -> u64 {
        self.len
    }
}

/// The records of one chunk, unpacked and checked.
pub(super) struct Chunk {
    reader: LinearReader,
    /// Bytes of records still to come.
    left: u64,
}

impl Chunk {
    /// Takes the body of a chunk record.
    pub(super) fn new(body: &[u8]) -> Result<Self, Broken> {
        let left = check_framing(body)?;
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(LIMIT);
        let mut reader = LinearReader::new_with_options(options);
        let buffer = reader.insert(FRAME + body.len());
        buffer[0] = op::CHUNK;
        buffer[1..FRAME].copy_from_slice(&(body.len() as u64).to_le_bytes());
        buffer[FRAME..].copy_from_slice(body);
        reader.notify_read(FRAME + body.len());
        Ok(Self { reader, left })
    }

    /// The opcode and body of the next record, `None` after the last.
    pub(super) fn next(&mut self) -> Result<Option<(u8, &[u8])>, Broken> {
        match self.reader.next_event() {
            Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                self.left = self.left.saturating_sub((FRAME + data.len()) as u64);
                Ok(Some((opcode, data)))
            }
            // All of the chunk is in the reader already: when it asks for more, that was all.
            Some(Ok(LinearReadEvent::ReadRequest(_))) | None if self.left == 0 => Ok(None),
            Some(Ok(LinearReadEvent::ReadRequest(_))) | None => {
                damaged(format!("expected {} more bytes of records in a chunk, got none", self.left))
            }
            Some(Err(e)) => damaged(format!("expected a whole chunk, got: {e}")),
        }
    }
}

/// The length of a chunk's records, unpacked. Refuses an uncompressed chunk
/// that is not made of whole records: the crate sees that by the checksum only,
/// which a chunk need not have.
fn check_framing(body: &[u8]) -> Result<u64, Broken> {
    let mut header = Fields(body);
    let mut chunk = || {
        header.take(8 + 8)?; // times of the first and last message
        let unpacked = header.u64()?;
        header.take(4)?; // checksum
        let compression = header.text()?;
        let packed = usize::try_from(header.u64()?).ok()?;
        Some((unpacked, compression, header.take(packed)?))
    };
    let Some((unpacked, compression, records)) = chunk() else {
        return damaged("expected a chunk, got its header in pieces");
    };
    if !compression.is_empty() {
        return Ok(unpacked);
    }
    let mut records = Fields(records);
    while !records.0.is_empty() {
        let whole = records.take(1).and_then(|_| records.u64()).and_then(|length| records.take(length as usize));
        if whole.is_none() {
            return damaged("expected a chunk of whole records, got a piece of one");
        }
    }
    Ok(unpacked)
}

/// The fields of a record's body, front to back; `None` where they reach beyond it.
pub(super) struct Fields<'a>(pub(super) &'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, bytes: usize) -> Option<&'a [u8]> {
        let (head, tail) = self.0.split_at_checked(bytes)?;
        self.0 = tail;
        Some(head)
    }

    fn u16(&mut self) -> Option<u16> {
        Some(u16::from_le_bytes(self.take(2)?.try_into().ok()?))
    }

    fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.take(4)?.try_into().ok()?))
    }

    fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(self.take(8)?.try_into().ok()?))
    }

    fn text(&mut self) -> Option<&'a str> {
        let length = self.u32()? as usize;
        std::str::from_utf8(self.take(length)?).ok()
    }

    /// A channel: its id, topic and message encoding.
    pub(super) fn channel(mut self) -> Option<(u16, &'a str, &'a str)> {
        let id = self.u16()?;
        self.u16()?; // schema
        Some((id, self.text()?, self.text()?))
    }

    /// A message: its channel's id, log time in ns and data.
    pub(super) fn message(mut self) -> Option<(u16, u64, &'a [u8])> {
        let channel = self.u16()?;
        self.u32()?; // sequence
        let log_time = self.u64()?;
        self.u64()?; // publish time
        Some((channel, log_time, self.0))
    }

    /// Statistics: the number of messages.
    pub(super) fn statistics(mut self) -> Option<u64> {
        self.u64()
    }

    /// A metadata record: its name and what it holds.
    pub(super) fn metadata(mut self) -> Option<(&'a str, BTreeMap<String, String>)> {
        let name = self.text()?;
        let length = self.u32()? as usize;
        let mut map = Fields(self.take(length)?);
        let mut fields = BTreeMap::new();
        while !map.0.is_empty() {
            fields.insert(map.text()?.to_owned(), map.text()?.to_owned());
        }
        Some((name, fields))
    }
}
