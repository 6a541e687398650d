use image::codecs::jpeg::JpegEncoder;

use super::*;

/// A drawn 64 x 32 picture with some edges in it, as RGB.
fn picture() -> Vec<u8> {
    (0..64 * 32)
        .flat_map(|i: u32| {
            let (x, y) = (i % 64, i / 64);
            [(x * 4) as u8, (y * 8) as u8, if (x / 8 + y / 8) % 2 == 0 { 200 } else { 20 }]
        })
        .collect()
}

fn jpeg() -> Vec<u8> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 90).encode(&picture(), 64, 32, ColorType::Rgb8.into()).unwrap();
    bytes
}

fn decode(bytes: &[u8]) -> Result<Frame, ImageError> {
    let mut frame = Frame::default();
    decode_jpeg(bytes, &mut frame).map(|()| frame)
}

/// Numerical Recipes' generator: tests need the same bytes every time, not good randomness.
fn random(state: &mut u32) -> usize {
    *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    (*state >> 8) as usize
}

#[test]
fn base64_is_decoded_with_and_without_padding() {
    assert_eq!(decode_base64(b"/9j/4A==").unwrap(), &[0xff, 0xd8, 0xff, 0xe0][..]);
    assert_eq!(decode_base64(b"/9j/4A").unwrap(), &[0xff, 0xd8, 0xff, 0xe0][..]);
    assert_eq!(decode_base64(b"").unwrap(), &[][..]);
}

#[test]
fn what_is_not_base64_or_too_long_is_an_error() {
    assert_eq!(decode_base64(b"/9j/4A_-").unwrap_err().to_string(), "expected base64, got byte 0x5f at offset 6");
    assert_eq!(
        decode_base64(b"/9j/4").unwrap_err().to_string(),
        "expected base64, got 5 symbols, which end inside a byte"
    );
    assert_eq!(
        decode_base64(&vec![b'A'; 50_000_000]).unwrap_err().to_string(),
        "expected an image of at most 16777216 bytes of base64, got 50000000"
    );
}

#[test]
fn a_jpeg_becomes_a_frame_close_to_what_was_encoded() {
    let frame = decode(&jpeg()).unwrap();
    assert_eq!((frame.width(), frame.height(), frame.rgb().len()), (64, 32, 64 * 32 * 3));
    let off: u64 = frame.rgb().iter().zip(picture()).map(|(a, b)| u64::from(a.abs_diff(b))).sum();
    assert!(off / (64 * 32 * 3) < 5, "mean difference {off} / 6144");
}

#[test]
fn the_frames_memory_is_reused() {
    let mut frame = Frame::default();
    decode_jpeg(&jpeg(), &mut frame).unwrap();
    let before = frame.rgb().as_ptr();
    decode_jpeg(&jpeg(), &mut frame).unwrap();
    assert_eq!(before, frame.rgb().as_ptr());
}

#[test]
fn a_grey_jpeg_becomes_rgb_with_equal_channels() {
    let grey: Vec<u8> = (0..64 * 32).map(|i| (i % 64 * 4) as u8).collect();
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 95).encode(&grey, 64, 32, ColorType::L8.into()).unwrap();
    let frame = decode(&bytes).unwrap();
    assert_eq!(frame.rgb().len(), 64 * 32 * 3);
    for (pixel, grey) in frame.rgb().chunks_exact(3).zip(grey) {
        assert!(pixel.iter().all(|c| *c == pixel[0] && c.abs_diff(grey) < 8), "{pixel:?} {grey}");
    }
}

#[test]
fn an_empty_image_and_a_png_are_no_jpegs() {
    assert_eq!(decode(b"").unwrap_err(), ImageError::Empty);
    assert_eq!(
        decode(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR").unwrap_err().to_string(),
        "expected a JPEG (ff d8 ff), got bytes that begin with 89 50 4e 47, as a PNG does"
    );
    assert!(matches!(decode(b"not an image").unwrap_err(), ImageError::NotJpeg(_)));
}

#[test]
fn every_truncation_is_an_error() {
    let whole = jpeg();
    for length in 1..whole.len() {
        assert!(decode(&whole[..length]).is_err(), "{length} of {} bytes", whole.len());
    }
    assert_eq!(decode(&whole[..whole.len() - 2]).unwrap_err(), ImageError::Truncated(whole.len() - 2));
}

#[test]
fn a_thumbnails_end_marker_does_not_make_a_cut_jpeg_whole() {
    let mut bytes = jpeg();
    bytes.splice(2..2, [0xff, 0xe1, 0x00, 0x06, 0xff, 0xd8, 0xff, 0xd9]);
    assert!(decode(&bytes).is_ok());
    for length in 1..bytes.len() {
        assert!(decode(&bytes[..length]).is_err(), "{length}");
    }
}

#[test]
fn padding_behind_the_end_marker_is_allowed() {
    let expected = decode(&jpeg()).unwrap();
    for padding in [&[0; 7][..], b"\n", &[0xff; 3]] {
        assert_eq!(decode(&[&jpeg(), padding].concat()).unwrap(), expected);
    }
}

#[test]
fn a_header_that_claims_30000_x_30000_is_refused() {
    let mut bytes = jpeg();
    let sof = bytes.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    // Marker, length (2), precision (1), then height and width.
    for at in [sof + 5, sof + 7] {
        bytes[at..at + 2].copy_from_slice(&30_000u16.to_be_bytes());
    }
    assert_eq!(decode(&bytes).unwrap_err().to_string(), "expected a JPEG of 1 to 4096 pixels a side, got 30000x30000");
    bytes[sof + 5..sof + 7].fill(0);
    assert_eq!(decode(&bytes).unwrap_err(), ImageError::Size { width: 30_000, height: 0 });
}

/// The header of a picture of that size on the pixels of a small one.
fn claims(width: u16, height: u16) -> Vec<u8> {
    let mut bytes = jpeg();
    let sof = bytes.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    bytes[sof + 5..sof + 7].copy_from_slice(&height.to_be_bytes());
    bytes[sof + 7..sof + 9].copy_from_slice(&width.to_be_bytes());
    bytes
}

#[test]
fn a_picture_of_more_pixels_than_a_camera_has_is_refused_before_it_is_decoded() {
    let mut frame = Frame::default();
    assert_eq!(
        decode_jpeg(&claims(1920, 1201), &mut frame).unwrap_err().to_string(),
        "expected a JPEG of at most 2304000 pixels, got 1920x1201: perception.max_pixels allows more"
    );
    assert!(frame.rgb().is_empty(), "nothing was allocated for it");
    let size = |width, height, most| check_markers(&claims(width, height), most);
    assert_eq!(size(1920, 1200, MAX_PIXELS), Ok(Some((1920, 1200))));
    assert_eq!(size(1200, 1920, MAX_PIXELS), Ok(Some((1200, 1920))), "the area counts");
    assert_eq!(size(3840, 2160, 3840 * 2160), Ok(Some((3840, 2160))), "settings allow more");
    assert_eq!(size(65, 32, 64 * 32), Err(ImageError::Pixels { most: 64 * 32, width: 65, height: 32 }));
}

#[test]
fn colours_with_more_samples_than_the_brightness_are_refused_before_the_decoder_fails() {
    let sampled = |factors: [u8; 3]| {
        let mut bytes = jpeg();
        let sof = bytes.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
        for (i, factor) in factors.into_iter().enumerate() {
            bytes[sof + 11 + 3 * i] = factor;
        }
        check_markers(&bytes, MAX_PIXELS).map_err(|e| e.to_string())
    };
    for known in [[0x11, 0x11, 0x11], [0x21, 0x11, 0x11], [0x22, 0x11, 0x11], [0x41, 0x11, 0x11], [0x22, 0x12, 0x12]] {
        assert_eq!(sampled(known), Ok(Some((64, 32))), "{known:?}");
    }
    let expected = "expected a JPEG whose chroma is sampled no more finely than its luma, got 2x2, 1x1, 4x1";
    assert_eq!(sampled([0x22, 0x11, 0x41]).unwrap_err(), expected);
    assert!(sampled([0x11, 0x21, 0x21]).is_err() && sampled([0x31, 0x21, 0x11]).is_err());
}

#[test]
fn a_progressive_picture_reads_with_the_scans_of_an_encoder_and_not_with_hundreds() {
    let mut bytes = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, 75);
    encoder.set_progressive(true);
    encoder.encode(&picture(), 64, 32, jpeg_encoder::ColorType::Rgb).unwrap();
    decode(&bytes).unwrap();
    // Repeats the last scan: each costs a few bytes here, and the decoder a pass over all pixels.
    let scan = bytes.windows(2).rposition(|w| w == [0xff, 0xda]).unwrap();
    let end = bytes.len() - 2;
    let again = bytes[scan..end].repeat(300);
    bytes.splice(end..end, again);
    assert_eq!(decode(&bytes).unwrap_err().to_string(), "expected a JPEG of at most 32 scans, got more");
}

#[test]
fn the_dearest_picture_within_the_limits_takes_a_fraction_of_a_second() {
    let pixels: Vec<u8> = picture().repeat(1920 * 1200 / (64 * 32));
    let mut bytes = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, 90);
    encoder.set_progressive(true);
    encoder.encode(&pixels, 1920, 1200, jpeg_encoder::ColorType::Rgb).unwrap();
    let scans = bytes.windows(2).filter(|w| *w == [0xff, 0xda]).count();
    let scan = bytes.windows(2).rposition(|w| w == [0xff, 0xda]).unwrap();
    let end = bytes.len() - 2;
    let again = bytes[scan..end].repeat(MAX_SCANS - scans);
    bytes.splice(end..end, again);
    let began = std::time::Instant::now();
    decode(&bytes).unwrap();
    let took = began.elapsed();
    assert!(took.as_secs_f64() < 2.0, "{scans} scans made {MAX_SCANS} take {took:?}");
}

#[test]
fn flipped_bytes_never_panic_and_leave_a_frame_that_is_one() {
    let whole = jpeg();
    let (mut seed, mut frame) = (1, Frame::default());
    for _ in 0..4000 {
        let mut bytes = whole.clone();
        for _ in 0..1 + random(&mut seed) % 4 {
            let at = random(&mut seed) % bytes.len();
            bytes[at] = random(&mut seed) as u8;
        }
        let _ = decode_jpeg(&bytes, &mut frame);
        assert_eq!(frame.rgb().len(), frame.width() * frame.height() * 3);
    }
}
