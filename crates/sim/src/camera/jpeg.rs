//! Pictures as the simulator sends them.

use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

use lapwing_core::perception::Frame;

/// A frame as a JPEG with colours at half the resolution, as Unity's `EncodeToJPG` makes it. Its `quality` is 75.
///
/// Empty for a frame without pixels, or with more than 65,535 a side, which JPEG cannot hold.
pub fn encode_jpeg(frame: &Frame, quality: u8) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(24 << 10);
    let mut encoder = Encoder::new(&mut bytes, quality.clamp(1, 100));
    encoder.set_sampling_factor(SamplingFactor::F_2_2);
    let (Ok(width), Ok(height)) = (u16::try_from(frame.width()), u16::try_from(frame.height())) else {
        return Vec::new();
    };
    match encoder.encode(frame.rgb(), width, height, ColorType::Rgb) {
        Ok(()) => bytes,
        Err(_) => Vec::new(),
    }
}
