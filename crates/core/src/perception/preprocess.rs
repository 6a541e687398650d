//! Preprocessing as data: what happens to a picture before a network sees it.

use serde::{Deserialize, Serialize};

/// The preprocessing that a network was trained with: JSON in a checkpoint's
/// metadata, a table in the side file of a TorchScript model.
///
/// ```
/// # use lapwing_core::perception::Preprocess;
/// let preprocess: Preprocess = serde_json::from_str(
///     r#"{
///         "crop": {"top": 60, "bottom": 135},
///         "resize": {"height": 66, "width": 200, "filter": "bilinear-antialiased"},
///         "colour": "yuv",
///         "scale": "x/127.5-1",
///         "layout": "nchw"
///     }"#,
/// )?;
/// assert_eq!(preprocess.shape(), [3, 66, 200]);
/// # Ok::<(), serde_json::Error>(())
/// ```
/// The steps are taken in the order of the fields. An unknown key is an error: it would mean a step that is not taken.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Preprocess {
    /// Rows to keep; all of them if this is absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop: Option<Crop>,
    /// The size that the network takes.
    pub resize: Resize,
    /// The channels that the network takes, computed from the resized bytes.
    pub colour: ColourSpace,
    /// From 0..=255 to the range that the network takes.
    pub scale: PixelScale,
    /// Order of the numbers.
    pub layout: TensorLayout,
}

/// Rows of the frame from `top` to before `bottom`, all columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Crop {
    /// First row kept, counted from 0 at the top.
    pub top: usize,
    /// First row below that is not kept.
    pub bottom: usize,
}

impl Crop {
    /// The lowest row that a crop may end at: that of VGA. The stock simulator sends 160 rows, and no build is known to
    /// send more than VGA; a network for larger pictures was not trained on this car's.
    pub const MAX_BOTTOM: usize = 480;
}

/// A size in pixels, and how to resize to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Resize {
    /// Rows, 1 to [`Resize::MAX_SIDE`].
    pub height: usize,
    /// Pixels in a row, 1 to [`Resize::MAX_SIDE`].
    pub width: usize,
    /// How pixels are weighed.
    pub filter: ResizeFilter,
}

impl Resize {
    /// Most pixels per side, which limits how much memory a checkpoint can ask for.
    pub const MAX_SIDE: usize = 4096;
}

/// How a resize weighs pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ResizeFilter {
    /// A triangle as wide as the pixel that it makes, rounded to bytes: Pillow's `BILINEAR`, and PyTorch's with
    /// `antialias=True`. OpenCV's `INTER_LINEAR` is a different filter.
    BilinearAntialiased,
}

/// The channels that a network takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ColourSpace {
    /// Red, green, blue.
    Rgb,
    /// Blue, green, red, as OpenCV reads pictures.
    Bgr,
    /// BT.601: Y = .299 R + .587 G + .114 B, U = .492 (B - Y) + 128, V = .877 (R - Y) + 128, not rounded.
    Yuv,
    /// Y of the above alone.
    Grey,
}

impl ColourSpace {
    /// How many channels these are.
    pub fn channels(self) -> usize {
        if self == Self::Grey { 1 } else { 3 }
    }

    /// Weights of red, green and blue, and a constant, for each channel.
    pub(super) fn weights(self) -> &'static [[f64; 4]] {
        const Y: [f64; 3] = [0.299, 0.587, 0.114];
        const U: f64 = 0.492;
        const V: f64 = 0.877;
        match self {
            Self::Rgb => &[[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
            Self::Bgr => &[[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]],
            Self::Yuv => {
                &const {
                    [
                        [Y[0], Y[1], Y[2], 0.0],
                        [-U * Y[0], -U * Y[1], U * (1.0 - Y[2]), 128.0],
                        [V * (1.0 - Y[0]), -V * Y[1], -V * Y[2], 128.0],
                    ]
                }
            }
            Self::Grey => &const { [[Y[0], Y[1], Y[2], 0.0]] },
        }
    }
}

/// From 0..=255 to the range that a network takes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum PixelScale {
    /// -1 to 1.
    #[serde(rename = "x/127.5-1")]
    Signed,
    /// 0 to 1.
    #[serde(rename = "x/255")]
    Unit,
    /// `(x / 255 - mean) / std`, one number a channel; torchvision's ImageNet networks want
    /// mean .485, .456, .406 and std .229, .224, .225 in RGB.
    #[serde(rename = "standardised")]
    Standardised {
        /// Subtracted.
        mean: Vec<f64>,
        /// Divided by; positive.
        std: Vec<f64>,
    },
}

impl PixelScale {
    /// Factor and summand of a channel; `None` if the scale has no valid ones for it.
    pub(super) fn affine(&self, channel: usize) -> Option<(f64, f64)> {
        match self {
            Self::Signed => Some((1.0 / 127.5, -1.0)),
            Self::Unit => Some((1.0 / 255.0, 0.0)),
            Self::Standardised { mean, std } => {
                let (mean, std) = (*mean.get(channel)?, *std.get(channel)?);
                (mean.is_finite() && std.is_finite() && std > 0.0).then(|| (1.0 / (255.0 * std), -mean / std))
            }
        }
    }
}

/// Order of the numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TensorLayout {
    /// One plane a channel, rows from the top: PyTorch's.
    Nchw,
}

/// Preprocessing that is invalid, or does not fit this frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PreprocessError {
    /// A crop that keeps nothing.
    #[error("expected a crop whose top lies above its bottom, got rows {top} to {bottom}")]
    EmptyCrop {
        /// First row kept.
        top: usize,
        /// First row no longer kept.
        bottom: usize,
    },
    /// A crop that reaches beyond any simulator's picture.
    #[error("expected a crop within a picture's rows, 0 to {max}, got rows {top} to {bottom}", max = Crop::MAX_BOTTOM)]
    CropBeyond {
        /// First row kept.
        top: usize,
        /// First row no longer kept.
        bottom: usize,
    },
    /// A size of zero, or one that no network has.
    #[error("expected a resize to 1 to {max} pixels a side, got {width}x{height}", max = Resize::MAX_SIDE)]
    Size {
        /// Pixels in a row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The wrong count of means or deviations.
    #[error("expected a mean and a std for each of {channels} channels, got {means} and {stds}")]
    ScaleLength {
        /// How many the colour has.
        channels: usize,
        /// Means given.
        means: usize,
        /// Deviations given.
        stds: usize,
    },
    /// A mean or deviation that would not give finite numbers.
    #[error("expected finite means and positive finite stds, got {mean} and {std} for channel {channel}")]
    ScaleValue {
        /// Of which channel, from 0.
        channel: usize,
        /// Its mean.
        mean: f64,
        /// Its deviation.
        std: f64,
    },
    /// The frame does not have the rows to keep.
    #[error("expected a frame of at least {bottom} rows for the crop to row {bottom}, got {width}x{height}")]
    CropOutside {
        /// First row no longer kept.
        bottom: usize,
        /// Pixels in a row of the frame.
        width: usize,
        /// Rows of the frame.
        height: usize,
    },
    /// There is nothing in the frame.
    #[error("expected a frame with pixels in it, got {width}x{height}")]
    EmptyFrame {
        /// Pixels in a row of the frame.
        width: usize,
        /// Rows of the frame.
        height: usize,
    },
}

impl Preprocess {
    /// What comes out: channels, rows, pixels in a row.
    pub fn shape(&self) -> [usize; 3] {
        [self.colour.channels(), self.resize.height, self.resize.width]
    }

    /// Checks all that can be checked without a frame.
    ///
    /// # Errors
    /// [`PreprocessError`] naming the first invalid field.
    pub fn validate(&self) -> Result<(), PreprocessError> {
        if let Some(Crop { top, bottom }) = self.crop {
            if top >= bottom {
                return Err(PreprocessError::EmptyCrop { top, bottom });
            }
            if bottom > Crop::MAX_BOTTOM {
                return Err(PreprocessError::CropBeyond { top, bottom });
            }
        }
        let Resize { width, height, .. } = self.resize;
        let side = 1..=Resize::MAX_SIDE;
        if !side.contains(&width) || !side.contains(&height) {
            return Err(PreprocessError::Size { width, height });
        }
        if let PixelScale::Standardised { mean, std } = &self.scale {
            let channels = self.colour.channels();
            if (mean.len(), std.len()) != (channels, channels) {
                return Err(PreprocessError::ScaleLength { channels, means: mean.len(), stds: std.len() });
            }
            if let Some(channel) = (0..channels).find(|c| self.scale.affine(*c).is_none()) {
                let (mean, std) = (mean[channel], std[channel]);
                return Err(PreprocessError::ScaleValue { channel, mean, std });
            }
        }
        Ok(())
    }

    /// The rows to keep of a picture of this size.
    ///
    /// # Errors
    /// [`PreprocessError::EmptyFrame`], [`PreprocessError::CropOutside`].
    pub fn rows_of(&self, width: usize, height: usize) -> Result<Crop, PreprocessError> {
        if width == 0 || height == 0 {
            return Err(PreprocessError::EmptyFrame { width, height });
        }
        let crop = self.crop.unwrap_or(Crop { top: 0, bottom: height });
        if crop.bottom > height {
            return Err(PreprocessError::CropOutside { bottom: crop.bottom, width, height });
        }
        Ok(crop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PILOTNET: &str = r#"{"crop":{"top":60,"bottom":135},"resize":{"height":66,"width":200,"filter":"bilinear-antialiased"},"colour":"yuv","scale":"x/127.5-1","layout":"nchw"}"#;

    fn read(json: &str) -> Preprocess {
        serde_json::from_str(json).unwrap()
    }

    #[test]
    fn what_is_read_is_what_is_written() {
        assert_eq!(serde_json::to_string(&read(PILOTNET)).unwrap(), PILOTNET);
        let imagenet = PILOTNET
            .replace(r#""crop":{"top":60,"bottom":135},"#, "")
            .replace("yuv", "rgb")
            .replace(r#""x/127.5-1""#, r#"{"standardised":{"mean":[0.485,0.456,0.406],"std":[0.229,0.224,0.225]}}"#);
        assert_eq!(serde_json::to_string(&read(&imagenet)).unwrap(), imagenet);
        assert_eq!(read(&imagenet).validate(), Ok(()));
    }

    #[test]
    fn a_key_or_value_that_is_not_known_is_refused_by_name() {
        let error = |from, to| serde_json::from_str::<Preprocess>(&PILOTNET.replace(from, to)).unwrap_err().to_string();
        assert!(error(r#""layout""#, r#""blur":1,"layout""#).starts_with("unknown field `blur`, expected one of"));
        assert!(error(r#""top":60"#, r#""top":60,"left":1"#).starts_with("unknown field `left`"));
        assert!(error("yuv", "hsv").starts_with("unknown variant `hsv`, expected one of `rgb`, `bgr`, `yuv`, `grey`"));
        assert!(error("bilinear-antialiased", "nearest").starts_with("unknown variant `nearest`"));
        assert!(
            error(r#""x/127.5-1""#, r#"{"standardised":{"mean":[],"std":[],"var":[]}}"#)
                .starts_with("unknown field `var`")
        );
        assert!(error(r#","layout":"nchw""#, "").starts_with("missing field `layout`"));
    }

    #[test]
    fn what_cannot_be_is_named_with_expected_and_got() {
        let error = |from, to| read(&PILOTNET.replace(from, to)).validate().unwrap_err().to_string();
        assert_eq!(error("135", "60"), "expected a crop whose top lies above its bottom, got rows 60 to 60");
        assert_eq!(error("135", "1000"), "expected a crop within a picture's rows, 0 to 480, got rows 60 to 1000");
        assert_eq!(read(&PILOTNET.replace("135", "480")).validate(), Ok(()));
        assert_eq!(error("200", "0"), "expected a resize to 1 to 4096 pixels a side, got 0x66");
        assert_eq!(error("200", "4097"), "expected a resize to 1 to 4096 pixels a side, got 4097x66");
        assert_eq!(
            error(r#""x/127.5-1""#, r#"{"standardised":{"mean":[0.5],"std":[0.5,0.5,0.5]}}"#),
            "expected a mean and a std for each of 3 channels, got 1 and 3"
        );
        assert_eq!(
            error(r#""x/127.5-1""#, r#"{"standardised":{"mean":[0.5,0.5,0.5],"std":[0.5,0,0.5]}}"#),
            "expected finite means and positive finite stds, got 0.5 and 0 for channel 1"
        );
    }
}
