//! From the bytes that a camera sent to the numbers that a network takes.
//!
//! [`decode_base64`] turns a telemetry's text into JPEG bytes, [`decode_jpeg`] turns those into a [`Frame`], and a
//! [`Preprocessor`] turns that into a network's input: crop, blur, resize, colour, scale, one plane per channel or pixel by
//! pixel. A [`Preprocess`] describes these steps and travels inside every checkpoint, so that no network is ever shown the
//! wrong crop or BGR for RGB. The steps of networks made elsewhere are, to the byte, those of OpenCV and Pillow
//! (`answers.json`, which `tests/interop/perception_answers.py` writes).
//!
//! Nothing here knows about networks or libtorch; the caller owns the buffers and reuses them for the next frame.

#[cfg(test)]
mod answers;
mod blur;
mod colour;
mod frame;
mod jpeg;
mod preprocess;
mod preprocessor;
mod resample;
mod scale;

pub use blur::Blur;
pub use colour::ColourSpace;
pub use frame::Frame;
pub use jpeg::{
    ImageError, MAX_BASE64_LEN, MAX_PIXELS, MAX_SIDE, check_jpeg, decode_base64, decode_jpeg, limit_pixels,
};
pub use preprocess::{Area, Crop, Preprocess, PreprocessError, Resize, ResizeFilter, TensorLayout};
pub use preprocessor::Preprocessor;
pub use scale::PixelScale;
