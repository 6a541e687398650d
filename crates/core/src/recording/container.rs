//! The records of an MCAP file from its beginning, as far as it is whole.
//!
//! The framing is read here and not by the crate `mcap`, because a run may be cut off or damaged anywhere: every length
//! is checked against the actual data before memory is allocated for it, and the place of the damage is known. Chunks
//! are unpacked here for the same reason: one that holds more than it says is damaged, and a small file cannot unpack
//! to a large one. Source: <https://mcap.dev/spec>.

use std::{
    collections::BTreeMap,
    io::{self, BufRead, Read, Seek, SeekFrom},
};

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use mcap::{MAGIC, records::op};

/// No record or chunk of a run comes near this. One that claims more is damaged.
const LIMIT: usize = 64 << 20;
/// How much all chunks of a file may unpack to: this many bytes plus [`RATIO`] times the file's length. Telemetry of a
/// standing car packs about 20 to 1; pictures do not pack at all.
const FREE: u64 = 64 << 20;
const RATIO: u64 = 64;
/// The checksum of chunks.
const CHECKSUM: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);
/// Opcode and length.
const FRAME: usize = 1 + 8;

/// Why a file cannot be read further: damage, in words, or an error of the system.
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
    /// Starts after the magic, which the caller has checked.
    pub(super) fn new(mut input: R, len: u64) -> io::Result<Self> {
        let at = MAGIC.len() as u64;
        input.seek(SeekFrom::Start(at))?;
        Ok(Self { input, len, at, ended: false, body: Vec::new() })
    }

    /// The opcode and body of the next record; the body of an unwanted one is skipped. `None` is the file's orderly
    /// end.
    pub(super) fn next(&mut self, wanted: impl Fn(u8) -> bool) -> Result<Option<(u8, &[u8])>, Broken> {
        if self.ended {
            return Ok(None);
        }
        let left = self.len.saturating_sub(self.at);
        if left < FRAME as u64 {
            return damaged(match left {
                0 => "expected a record, got the file's end: it is still being recorded, or the recording was killed"
                    .into(),
                left => format!("expected a record, got the file's end after {left} bytes"),
            });
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

    /// Gives the input back, to start again.
    pub(super) fn into_inner(self) -> R {
        self.input
    }

    /// Length of the file when it was opened.
    pub(super) fn len(&self) -> u64 {
        self.len
    }

    /// How many bytes its chunks may unpack to, all together.
    pub(super) fn may_unpack(&self) -> u64 {
        FREE.saturating_add(RATIO.saturating_mul(self.len))
    }
}

/// The records of one chunk, unpacked and checked.
pub(super) struct Chunk {
    records: Vec<u8>,
    /// Where the next record begins.
    at: usize,
}

impl Chunk {
    /// Takes the body of a chunk record, which must unpack to exactly as many bytes as it says, at most `may_unpack`. What
    /// it unpacks to is taken off that.
    pub(super) fn new(body: &[u8], may_unpack: &mut u64) -> Result<Self, Broken> {
        let mut fields = BodyFields(body);
        let mut header = || {
            fields.take(8 + 8)?; // times of the first and last message
            let (unpacked, checksum) = (fields.u64()?, fields.u32()?);
            let compression = fields.text()?;
            let packed = usize::try_from(fields.u64()?).ok()?;
            Some((unpacked, checksum, compression, fields.take(packed)?))
        };
        let Some((unpacked, checksum, compression, packed)) = header() else {
            return damaged("expected a chunk, got an incomplete header");
        };
        if unpacked > LIMIT as u64 {
            return damaged(format!("expected a chunk that unpacks to {LIMIT} bytes at most, got {unpacked}"));
        }
        if unpacked > *may_unpack {
            return damaged(format!(
                "expected chunks that unpack to {FREE} bytes and {RATIO} times the file's length at most, got more"
            ));
        }
        let records = match compression {
            "" => Ok(packed.to_owned()),
            "zstd" => unzstd(packed, unpacked),
            "lz4" => lz4::Decoder::new(packed).and_then(|decoder| read_most(decoder, unpacked)),
            other => {
                return damaged(format!(
                    "expected a chunk compressed with lz4 or zstd, or uncompressed, got {other:.20?}"
                ));
            }
        };
        // What came, not what it claims: that may be damaged.
        let came = records.as_ref().map_or(unpacked, |records| records.len() as u64);
        *may_unpack = may_unpack.saturating_sub(came);
        let records = match records {
            Ok(records) => records,
            Err(why) => return damaged(format!("expected a chunk compressed with {compression}, got: {why}")),
        };
        if records.len() as u64 != unpacked {
            let more = if records.len() as u64 > unpacked { " or more" } else { "" };
            return damaged(format!(
                "expected a chunk of {unpacked} bytes unpacked, as it says, got {}{more}",
                records.len()
            ));
        }
        // Zero means no checksum.
        if checksum != 0 && checksum != CHECKSUM.checksum(&records) {
            return damaged(format!(
                "expected a chunk with the checksum {checksum:08x}, got {:08x}",
                CHECKSUM.checksum(&records)
            ));
        }
        let mut rest = BodyFields(&records);
        while !rest.0.is_empty() {
            if rest.record().is_none_or(|(opcode, _)| opcode == 0) {
                return damaged("expected whole records in a chunk, got an incomplete one");
            }
        }
        Ok(Self { records, at: 0 })
    }

    /// The opcode and body of the next record, `None` after the last.
    pub(super) fn next(&mut self) -> Option<(u8, &[u8])> {
        let record = BodyFields(self.records.get(self.at..)?).record()?;
        self.at += FRAME + record.1.len();
        Some(record)
    }
}

fn unzstd(packed: &[u8], unpacked: u64) -> io::Result<Vec<u8>> {
    let mut decoder = zstd::stream::read::Decoder::with_buffer(packed)?;
    decoder.window_log_max(LIMIT.ilog2())?; // what it may keep in memory besides
    read_most(decoder, unpacked)
}

/// All that a decoder yields, but at most a byte more than there should be.
fn read_most(decoder: impl Read, unpacked: u64) -> io::Result<Vec<u8>> {
    let mut records = Vec::new();
    decoder.take(unpacked + 1).read_to_end(&mut records)?;
    Ok(records)
}

/// The fields of a record's body, front to back; `None` where they reach beyond it.
pub(super) struct BodyFields<'a>(pub(super) &'a [u8]);

impl<'a> BodyFields<'a> {
    fn take(&mut self, bytes: usize) -> Option<&'a [u8]> {
        let (head, tail) = self.0.split_at_checked(bytes)?;
        self.0 = tail;
        Some(head)
    }

    /// A record: its opcode and body.
    fn record(&mut self) -> Option<(u8, &'a [u8])> {
        let opcode = self.take(1)?[0];
        let length = usize::try_from(self.u64()?).ok()?;
        Some((opcode, self.take(length)?))
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
        let mut map = BodyFields(self.take(length)?);
        let mut fields = BTreeMap::new();
        while !map.0.is_empty() {
            fields.insert(map.text()?.to_owned(), map.text()?.to_owned());
        }
        Some((name, fields))
    }
}
