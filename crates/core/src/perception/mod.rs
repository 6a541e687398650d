//! From the bytes that a camera sent to the numbers that a network takes.
//!
//! [`decode_base64`] makes JPEG bytes of a telemetry's text, [`decode_jpeg`] a
//! [`Frame`] of those, and a [`Preprocessor`] the numbers that go into a
//! network: crop, resize, colour, scale, one plane a channel. What it does is
//! written down in a [`Preprocess`], which travels inside every checkpoint, so
//! that no network is ever shown the wrong crop or BGR for RGB.
//!
//! Nothing here knows a network or names libtorch; buffers are the caller's and
//! are used again for the next frame.

mod frame;
mod jpeg;
mod preprocess;
mod preprocessor;

pub use frame::Frame;
pub use jpeg::{ImageError, MAX_BASE64_LEN, MAX_PIXELS, MAX_SIDE, decode_base64, decode_jpeg, limit_pixels};
pub use preprocess::{ColourSpace, Crop, PixelScale, Preprocess, PreprocessError, Resize, ResizeFilter, TensorLayout};
pub use preprocessor::Preprocessor;
