//! Base64 to JPEG bytes, JPEG bytes to a [`Frame`]. Both come from outside: broken data give an error that says how,
//! never a picture.

use std::{
    io::Cursor,
    panic::{self, AssertUnwindSafe},
    sync::atomic::{AtomicUsize, Ordering},
};

use base64::{
    DecodeError, Engine, alphabet,
    engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig},
};
use bytes::Bytes;
use image::{ColorType, ImageDecoder, codecs::jpeg::JpegDecoder};

use super::Frame;

/// Longest base64 text that is decoded, in bytes. The stock simulator sends about 16 KiB.
pub const MAX_BASE64_LEN: usize = 16 << 20;

/// Most pixels per side of a JPEG, whatever the settings say. The stock simulator sends 320 x 160.
pub const MAX_SIDE: usize = 4096;

/// Most pixels that a JPEG may have unless [`limit_pixels`] says otherwise: 1920 x 1200, more than any simulator's
/// camera has. Larger ones take so long to decode that other frames are late.
pub const MAX_PIXELS: usize = 1920 * 1200;

/// Most scans of a JPEG: each has only a few bytes but costs a pass over the whole picture. Progressive encoders write
/// about ten.
const MAX_SCANS: usize = 32;

static PIXELS: AtomicUsize = AtomicUsize::new(MAX_PIXELS);

/// Sets how many pixels a JPEG may have, for the whole process: `perception.max_pixels` of the settings.
pub fn limit_pixels(most: usize) {
    PIXELS.store(most, Ordering::Relaxed);
}

/// Why there is no picture.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// Text beyond [`MAX_BASE64_LEN`].
    #[error("expected an image of at most {MAX_BASE64_LEN} bytes of base64, got {0}")]
    TooLong(usize),
    /// Text that is not base64 in the standard alphabet, with the place.
    #[error("expected base64, got {0}")]
    Base64(String),
    /// No bytes at all.
    #[error("expected a JPEG, got an empty image")]
    Empty,
    /// Bytes of something else, with the first few.
    #[error("expected a JPEG (ff d8 ff), got bytes that begin with {0}")]
    NotJpeg(String),
    /// The end-of-image marker never comes.
    #[error("expected a whole JPEG, got {0} bytes without an end-of-image marker: it is cut off")]
    Truncated(usize),
    /// More pixels than the settings allow.
    #[error("expected a JPEG of at most {most} pixels, got {width}x{height}: perception.max_pixels allows more")]
    Pixels {
        /// The limit.
        most: usize,
        /// Pixels in a row, as the header claims.
        width: usize,
        /// Rows, as the header claims.
        height: usize,
    },
    /// Colours sampled more finely than the brightness, or not in whole multiples: no encoder does this, and the
    /// decoder fails.
    #[error("expected a JPEG whose chroma is sampled no more finely than its luma, got {0}")]
    Sampling(String),
    /// More scans than any encoder writes.
    #[error("expected a JPEG of at most {MAX_SCANS} scans, got more")]
    Scans,
    /// A side of zero, or beyond [`MAX_SIDE`].
    #[error("expected a JPEG of 1 to {MAX_SIDE} pixels a side, got {width}x{height}")]
    Size {
        /// Pixels in a row, as the header claims.
        width: usize,
        /// Rows, as the header claims.
        height: usize,
    },
    /// Complete, but not readable by the decoder; its message.
    #[error("this JPEG cannot be decoded: {0}")]
    Broken(String),
}

/// Standard alphabet; senders differ in whether they pad, and in what they leave in the last bits.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// Decodes a base64 text. Padding may be left out.
///
/// # Errors
/// [`ImageError::TooLong`] before anything is allocated, [`ImageError::Base64`].
pub fn decode_base64(text: &[u8]) -> Result<Bytes, ImageError> {
    if text.len() > MAX_BASE64_LEN {
        return Err(ImageError::TooLong(text.len()));
    }
    BASE64.decode(text).map(Bytes::from).map_err(|e| {
        ImageError::Base64(match e {
            DecodeError::InvalidByte(at, byte) => format!("byte {byte:#04x} at offset {at}"),
            DecodeError::InvalidLength(length) => format!("{length} symbols, which end inside a byte"),
            other => other.to_string(),
        })
    })
}

/// Whether these are the bytes of a whole JPEG, without decoding it: its columns and rows. What is inside may still be
/// broken.
///
/// # Errors
/// As [`decode_jpeg`], but for those that only decoding finds.
pub fn check_jpeg(bytes: &[u8]) -> Result<(usize, usize), ImageError> {
    check_markers(bytes, PIXELS.load(Ordering::Relaxed))?
        .ok_or_else(|| ImageError::Broken("it has no start of frame".into()))
}

/// Decodes a JPEG into `frame`, whose memory is reused. A grey picture becomes
/// an RGB one of equal channels.
///
/// Bytes after the end-of-image marker are treated as padding and ignored. A picture without that marker is refused:
/// the decoder would silently fill the missing part with grey, and a car would be driven by it.
///
/// # Errors
/// [`ImageError`]; sizes are checked before a pixel is allocated. The content of `frame` is then unspecified.
pub fn decode_jpeg(bytes: &[u8], frame: &mut Frame) -> Result<(), ImageError> {
    check_markers(bytes, PIXELS.load(Ordering::Relaxed))?;
    // The decoder is third-party code, and a panic in it must not stop the car's driver.
    panic::catch_unwind(AssertUnwindSafe(|| decode(bytes, frame)))
        .unwrap_or_else(|_| Err(ImageError::Broken("the decoder gave up".into())))
}

fn decode(bytes: &[u8], frame: &mut Frame) -> Result<(), ImageError> {
    let broken = |e: image::ImageError| ImageError::Broken(e.to_string());
    let decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(broken)?;
    let (width, height) = decoder.dimensions();
    let (width, height) = check_size(width as usize, height as usize, PIXELS.load(Ordering::Relaxed))?;
    frame.resize(width, height);
    match decoder.color_type() {
        ColorType::Rgb8 => decoder.read_image(frame.rgb_mut()).map_err(broken),
        ColorType::L8 => {
            let rgb = frame.rgb_mut();
            decoder.read_image(&mut rgb[..width * height]).map_err(broken)?;
            // From the end, as each triple then lies beyond the grey bytes still to be read.
            for i in (0..width * height).rev() {
                let grey = rgb[i];
                rgb[3 * i..][..3].fill(grey);
            }
            Ok(())
        }
        other => Err(ImageError::Broken(format!("expected grey or RGB pixels, got {other:?}"))),
    }
}

fn check_size(width: usize, height: usize, most: usize) -> Result<(usize, usize), ImageError> {
    let side = 1..=MAX_SIDE;
    if !side.contains(&width) || !side.contains(&height) {
        Err(ImageError::Size { width, height })
    } else if width * height > most {
        Err(ImageError::Pixels { most, width, height })
    } else {
        Ok((width, height))
    }
}

/// Three bytes a component: its name, its samples across and down in half a byte each, its table.
fn check_sampling(components: &[u8]) -> Result<(), ImageError> {
    let factors: Vec<(u8, u8)> = components.chunks_exact(3).map(|c| (c[1] >> 4, c[1] & 15)).collect();
    let Some(&(across, down)) = factors.first() else { return Ok(()) };
    // The decoder refuses 0, as it does any other invalid header.
    let is_even = |&(a, d): &(u8, u8)| a == 0 || d == 0 || across % a == 0 && down % d == 0;
    if factors.iter().all(is_even) {
        return Ok(());
    }
    let told: Vec<String> = factors.iter().map(|(across, down)| format!("{across}x{down}")).collect();
    Err(ImageError::Sampling(told.join(", ")))
}

/// Walks the markers from the first to the end-of-image, without decoding: sizes and scans are known before a pixel is.
///
/// Segments are skipped by their lengths, so that an end marker in a thumbnail or by chance does not count; inside a
/// scan every FF that is neither stuffed (00) nor a restart (D0-D7) is a marker. ITU-T T.81, annex B. Returns the size, if
/// a start of frame tells it.
fn check_markers(bytes: &[u8], most: usize) -> Result<Option<(usize, usize)>, ImageError> {
    const SOI: u8 = 0xd8;
    const EOI: u8 = 0xd9;
    const SOS: u8 = 0xda;
    const TEM: u8 = 0x01;
    if bytes.is_empty() {
        return Err(ImageError::Empty);
    }
    if !bytes.starts_with(&[0xff, SOI]) || !matches!(bytes.get(2), None | Some(0xff)) {
        let head: Vec<String> = bytes.iter().take(4).map(|b| format!("{b:02x}")).collect();
        let kind = if bytes.starts_with(b"\x89PNG") { ", as a PNG does" } else { "" };
        return Err(ImageError::NotJpeg(head.join(" ") + kind));
    }
    let (mut scans, mut size) = (0, None);
    let mut rest = &bytes[2..];
    // Where there is no marker the decoder skips to the next one, and so does this: one loop for scans and garbage.
    while let Some(at) = rest.windows(2).position(|w| w[0] == 0xff && !matches!(w[1], 0x00 | 0xff | TEM | 0xd0..=SOI)) {
        let marker = rest[at + 1];
        rest = &rest[at + 2..];
        if marker == EOI {
            return Ok(size);
        }
        scans += usize::from(marker == SOS);
        if scans > MAX_SCANS {
            return Err(ImageError::Scans);
        }
        let Some(length) = rest.first_chunk().map(|b| usize::from(u16::from_be_bytes(*b))) else { break };
        // A start of frame, but not DHT (C4), JPG (C8) or DAC (CC), which share its numbers.
        if matches!(marker, 0xc0..=0xcf) && !matches!(marker, 0xc4 | 0xc8 | 0xcc) {
            let &[_, _, _, h1, h0, w1, w0, components, ref factors @ ..] = rest else { break };
            let [width, height] = [[w1, w0], [h1, h0]].map(|side| u16::from_be_bytes(side).into());
            size = Some(check_size(width, height, most)?);
            check_sampling(factors.get(..3 * usize::from(components)).unwrap_or_default())?;
        }
        let Some(next) = rest.get(length.max(2)..) else { break };
        rest = next;
    }
    Err(ImageError::Truncated(bytes.len()))
}

#[cfg(test)]
mod tests;
