//! Preprocessing as a function: it prepares a picture for a network.

use std::{
    collections::BTreeSet,
    sync::{Mutex, PoisonError},
};

use fast_image_resize::{
    FilterType, ResizeAlg, ResizeOptions, Resizer,
    images::{TypedImage, TypedImageRef},
    pixels::U8x3,
};

use super::{
    Area, Crop, Frame, Preprocess, PreprocessError, Resize, ResizeFilter, TensorLayout,
    resample::{Pixels, resample},
};

/// Pixels converted from bytes to numbers at a time.
const BLOCK: usize = 64;
/// Columns and rows of the pictures that the stock simulator sends.
const STOCK: (usize, usize) = (320, 160);

/// A [`Preprocess`] ready to run, with its scratch memory.
#[derive(Debug, Clone)]
pub struct Preprocessor {
    preprocess: Preprocess,
    /// For each channel the weights of the three bytes of a pixel and a constant: colour, where it is a sum, and scale in
    /// one step.
    weights: Vec<[f32; 4]>,
    resizer: Resizer,
    /// What is cropped, blurred and coloured before the resize, where any of that is asked for.
    before: Vec<u8>,
    /// The resized bytes.
    resized: Vec<u8>,
}

impl Preprocessor {
    /// Checks the preprocessing and allocates memory for it.
    ///
    /// # Errors
    /// As [`Preprocess::validate`].
    pub fn new(preprocess: Preprocess) -> Result<Self, PreprocessError> {
        preprocess.validate()?;
        // What is coloured by the byte is already there when it is scaled.
        const AS_IT_IS: [[f64; 4]; 3] = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        let colour = if preprocess.colour_first { None } else { preprocess.colour.weights() };
        let colour = colour.unwrap_or(&AS_IT_IS[..preprocess.colour.channels()]);
        let weights = colour.iter().enumerate().map(|(channel, weights)| {
            let (factor, summand) = preprocess.scale.affine(channel).expect("validate checked every channel");
            let [r, g, b, constant] = *weights;
            [r * factor, g * factor, b * factor, constant * factor + summand].map(|w| w as f32)
        });
        let Resize { width, height, .. } = preprocess.resize;
        Ok(Self {
            weights: weights.collect(),
            resizer: Resizer::new(),
            before: vec![],
            resized: vec![0; width * height * 3],
            preprocess,
        })
    }

    /// The preprocessing that it does.
    pub fn preprocess(&self) -> &Preprocess {
        &self.preprocess
    }

    /// Turns a frame into a network's input: `out` becomes the numbers of [`Preprocess::shape`], in the order of the layout.
    ///
    /// Once warm, no picture is allocated by the filter `bilinear-antialiased`; its resizer allocates a few kilobytes of
    /// weights for each.
    ///
    /// # Errors
    /// [`PreprocessError::CropOutside`], [`PreprocessError::CropBeside`] and [`PreprocessError::EmptyFrame`].
    pub fn apply(&mut self, frame: &Frame, out: &mut Vec<f32>) -> Result<(), PreprocessError> {
        self.resize(frame)?;
        self.finish();
        let [channels, height, width] = self.preprocess.shape();
        let plane = width * height;
        out.resize(channels * plane, 0.0);
        // In blocks that stay in the cache. Channels are separated first, so that the sums run over neighbours in
        // memory.
        let mut apart = [[0f32; BLOCK]; 3];
        let mut scaled = [0f32; BLOCK];
        for (block, pixels) in self.resized[..plane * 3].chunks(BLOCK * 3).enumerate() {
            for (i, pixel) in pixels.chunks_exact(3).enumerate() {
                for (channel, byte) in apart.iter_mut().zip(pixel) {
                    channel[i] = f32::from(*byte);
                }
            }
            let count = pixels.len() / 3;
            let apart = apart.each_ref().map(|c| &c[..]);
            for channel in 0..channels {
                match self.preprocess.layout {
                    TensorLayout::Nchw => {
                        self.channel(channel, apart, &mut out[channel * plane + block * BLOCK..][..count]);
                    }
                    TensorLayout::Nhwc => {
                        self.channel(channel, apart, &mut scaled[..count]);
                        let out = out[block * BLOCK * channels + channel..].iter_mut().step_by(channels);
                        out.zip(&scaled[..count]).for_each(|(out, x)| *out = *x);
                    }
                }
            }
        }
        Ok(())
    }

    /// The steps up to the resize: bytes, three a pixel, not yet scaled, and coloured only if that comes first.
    ///
    /// # Errors
    /// As [`Preprocessor::apply`].
    pub fn resize(&mut self, frame: &Frame) -> Result<&[u8], PreprocessError> {
        let (width, height) = (frame.width(), frame.height());
        let area = self.preprocess.area_of(width, height)?;
        if (width, height) != STOCK && self.preprocess.crop.is_some() {
            static TOLD: Mutex<BTreeSet<(usize, usize)>> = Mutex::new(BTreeSet::new());
            if TOLD.lock().unwrap_or_else(PoisonError::into_inner).insert((width, height)) {
                let Area { top, bottom, .. } = area;
                tracing::warn!(
                    "pictures are {width}x{height}, not {}x{} as in the stock simulator: of their rows a model is shown \
                     {top} to {}, and is useless unless it was trained on pictures of this size",
                    STOCK.0,
                    STOCK.1,
                    bottom - 1
                );
            }
        }
        // Rows are contiguous, so their crop is a slice, and pixels beyond it cannot bleed in.
        let rows = &frame.rgb()[area.top * width * 3..area.bottom * width * 3];
        let is_untouched = area.width() == width && self.preprocess.blur.is_none() && !self.preprocess.colour_first;
        if !is_untouched {
            self.prepare(rows, width, area);
        }
        let bytes = if is_untouched { rows } else { &self.before[..] };
        let Resize { width, height, filter } = self.preprocess.resize;
        if filter == ResizeFilter::BilinearAntialiased {
            // What is kept of an earlier picture may have left it shorter.
            self.resized.resize(width * height * 3, 0);
            let source = (bytes, [area.width(), area.height()]);
            antialiased(&mut self.resizer, source, (&mut self.resized, [width, height]), &options());
        } else {
            self.resized.resize(width * height * 3, 0);
            let source = Pixels { bytes, width: area.width(), height: area.height(), channels: 3 };
            resample(source, filter, [width, height], &mut self.resized);
        }
        Ok(&self.resized)
    }

    /// Crops columns of these rows, blurs and colours.
    fn prepare(&mut self, rows: &[u8], width: usize, area: Area) {
        self.before.clear();
        for row in rows.chunks_exact(width * 3) {
            self.before.extend_from_slice(&row[area.left * 3..area.right * 3]);
        }
        if let Some(blur) = self.preprocess.blur {
            let source = Pixels { bytes: &self.before, width: area.width(), height: area.height(), channels: 3 };
            let mut blurred = Vec::with_capacity(self.before.len());
            blur.apply(source, &mut blurred);
            self.before = blurred;
        }
        if self.preprocess.colour_first {
            recolour(&mut self.before, self.preprocess.colour.bytes());
        }
    }

    /// The steps between the resize and the scale, in place: what is kept comes to lie at the beginning.
    fn finish(&mut self) {
        let area = self.preprocess.kept();
        let Resize { width, .. } = self.preprocess.resize;
        if self.preprocess.crop_resized.is_some() {
            let length = area.width() * 3;
            for (to, row) in (area.top..area.bottom).enumerate() {
                let from = (row * width + area.left) * 3;
                self.resized.copy_within(from..from + length, to * length);
            }
        }
        if !self.preprocess.colour_first && self.preprocess.colour.weights().is_none() {
            recolour(&mut self.resized[..area.width() * area.height() * 3], self.preprocess.colour.bytes());
        }
    }

    /// `count` rows beside the crop at the same scale, as RGB bytes. The first begins at row `from` of the frame; all
    /// must lie within it. Only for what [`Preprocess::is_plain`].
    pub fn rows(&mut self, frame: &Frame, from: f64, count: usize) -> Vec<u8> {
        let crop = self.preprocess.crop.unwrap_or(Crop::rows(0, frame.height()));
        let Resize { width, height, .. } = self.preprocess.resize;
        let mut rows = vec![0; count * width * 3];
        if count > 0 {
            let high = count as f64 * (crop.bottom - crop.top) as f64 / height as f64;
            let from = from.clamp(0.0, (frame.height() as f64 - high).max(0.0));
            let options = options().crop(0.0, from, frame.width() as f64, high);
            let source = (frame.rgb(), [frame.width(), frame.height()]);
            antialiased(&mut self.resizer, source, (&mut rows, [width, count]), &options);
        }
        rows
    }

    /// Computes one channel of neighbouring pixels, 0 to 255 and not necessarily whole: colour and scale.
    pub fn channel(&self, channel: usize, [red, green, blue]: [&[f32]; 3], out: &mut [f32]) {
        let [r, g, b, constant] = self.weights[channel];
        for (((out, red), green), blue) in out.iter_mut().zip(red).zip(green).zip(blue) {
            *out = r * red + g * green + b * blue + constant;
        }
    }
}

/// Replaces the three bytes of each pixel.
fn recolour(bytes: &mut [u8], colour: Option<fn([u8; 3]) -> [u8; 3]>) {
    if let Some(colour) = colour {
        bytes.as_chunks_mut::<3>().0.iter_mut().for_each(|pixel| *pixel = colour(*pixel));
    }
}

/// Resizes RGB bytes of a given width and height. Typed, because `Resizer::resize` would compile the filter for a dozen other
/// kinds of pixels, which takes as long as the rest of the crate.
fn antialiased(
    resizer: &mut Resizer,
    (from, [width, height]): (&[u8], [usize; 2]),
    (to, [to_width, to_height]): (&mut [u8], [usize; 2]),
    options: &ResizeOptions,
) {
    let source = TypedImageRef::<U8x3>::from_buffer(width as u32, height as u32, from)
        .expect("a frame has three bytes for each pixel");
    let mut target = TypedImage::<U8x3>::from_buffer(to_width as u32, to_height as u32, to)
        .expect("the target has three bytes for each pixel");
    resizer.resize_typed(&source, &mut target, options).expect("what is cropped lies within the frame");
}

fn options() -> ResizeOptions {
    ResizeOptions::new().resize_alg(ResizeAlg::Convolution(FilterType::Bilinear))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::{ColourSpace, PixelScale};

    fn preprocess(
        crop: Option<Crop>,
        width: usize,
        height: usize,
        colour: ColourSpace,
        scale: PixelScale,
    ) -> Preprocess {
        let resize = Resize { height, width, filter: ResizeFilter::BilinearAntialiased };
        Preprocess::of(crop, resize, colour, scale)
    }

    fn apply(preprocess: Preprocess, frame: &Frame) -> Vec<f32> {
        let mut out = Vec::new();
        Preprocessor::new(preprocess).unwrap().apply(frame, &mut out).unwrap();
        out
    }

    /// Turns numbers back into bytes, for legible assertions.
    fn bytes(out: &[f32]) -> Vec<f32> {
        out.iter().map(|x| (x * 255.0 * 1000.0).round() / 1000.0).collect()
    }

    fn grey_row(row: &[u8]) -> Frame {
        Frame::new(row.len(), 1, row.iter().flat_map(|x| [*x; 3]).collect()).unwrap()
    }

    #[test]
    fn two_by_one_pixels_become_planes_of_red_green_and_blue() {
        let frame = Frame::new(2, 1, vec![10, 20, 30, 40, 50, 60]).unwrap();
        let planes = |colour| bytes(&apply(preprocess(None, 2, 1, colour, PixelScale::Unit), &frame));
        assert_eq!(planes(ColourSpace::Rgb), [10.0, 40.0, 20.0, 50.0, 30.0, 60.0]);
        assert_eq!(planes(ColourSpace::Bgr), [30.0, 60.0, 20.0, 50.0, 10.0, 40.0]);
        assert_eq!(planes(ColourSpace::Grey), [18.15, 48.15]);
    }

    #[test]
    fn pure_red_in_yuv_is_76_90_285_unrounded() {
        let frame = Frame::new(1, 1, vec![255, 0, 0]).unwrap();
        let yuv = apply(preprocess(None, 1, 1, ColourSpace::Yuv, PixelScale::Unit), &frame);
        assert_eq!(bytes(&yuv), [76.245, 90.487, 284.768]);
    }

    #[test]
    fn scales_reach_the_ends_of_their_ranges() {
        let frame = grey_row(&[0, 255]);
        let scaled = |scale| apply(preprocess(None, 2, 1, ColourSpace::Grey, scale), &frame);
        let close = |got: Vec<f32>, want: [f32; 2]| {
            assert!(got.iter().zip(want).all(|(g, w)| (g - w).abs() < 1e-6), "{got:?} {want:?}");
        };
        close(scaled(PixelScale::Signed), [-1.0, 1.0]);
        close(scaled(PixelScale::Unit), [0.0, 1.0]);
        close(scaled(PixelScale::Standardised { mean: vec![0.5], std: vec![0.25] }), [-2.0, 2.0]);
    }

    #[test]
    fn halving_weighs_pixels_by_a_triangle_of_twice_the_width() {
        // Centre 3, half-width 2: distances 1.5, 0.5, 0.5 weigh 1 : 3 : 3, and 255 * 3 / 7 is 109.3.
        let out = apply(preprocess(None, 2, 1, ColourSpace::Grey, PixelScale::Unit), &grey_row(&[0, 0, 0, 255]));
        assert_eq!(bytes(&out), [0.0, 109.0]);
    }

    #[test]
    fn nothing_beyond_the_crop_bleeds_in() {
        let mut frame = Frame::new(4, 8, vec![255; 4 * 8 * 3]).unwrap();
        frame.rgb_mut()[2 * 4 * 3..6 * 4 * 3].fill(100);
        let crop = Some(Crop::rows(2, 6));
        let out = apply(preprocess(crop, 3, 3, ColourSpace::Grey, PixelScale::Unit), &frame);
        assert_eq!(bytes(&out), [100.0; 9]);
    }

    #[test]
    fn memory_is_reused_from_frame_to_frame() {
        let mut preprocessor = Preprocessor::new(preprocess(None, 2, 1, ColourSpace::Rgb, PixelScale::Unit)).unwrap();
        let mut out = Vec::new();
        preprocessor.apply(&grey_row(&[1, 2, 3, 4]), &mut out).unwrap();
        let before = (out.as_ptr(), preprocessor.resized.as_ptr());
        preprocessor.apply(&grey_row(&[5, 6, 7]), &mut out).unwrap();
        assert_eq!(before, (out.as_ptr(), preprocessor.resized.as_ptr()));
    }

    #[test]
    fn a_frame_that_does_not_hold_the_crop_is_an_error() {
        let crop = Some(Crop::rows(60, 135));
        let mut preprocessor =
            Preprocessor::new(preprocess(crop, 200, 66, ColourSpace::Yuv, PixelScale::Signed)).unwrap();
        let frame = Frame::new(160, 120, vec![0; 160 * 120 * 3]).unwrap();
        assert_eq!(
            preprocessor.apply(&frame, &mut Vec::new()).unwrap_err().to_string(),
            "expected a frame of at least 135 rows for the crop to row 135, got 160x120"
        );
        assert_eq!(
            preprocessor.apply(&Frame::default(), &mut Vec::new()).unwrap_err().to_string(),
            "expected a frame with pixels in it, got 0x0"
        );
    }
}
