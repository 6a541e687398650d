//! Preprocessing as data: what happens to a picture before a network sees it.

mod error;

use serde::{Deserialize, Serialize};

pub use self::error::PreprocessError;
use super::{Blur, ColourSpace, PixelScale};

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
    /// What to keep; everything if this is absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop: Option<Crop>,
    /// A blur of what is kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blur: Option<Blur>,
    /// Whether the colour is computed here, before the resize, and not after it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub colour_first: bool,
    /// The size that the network takes, but for a crop after it.
    pub resize: Resize,
    /// What to keep of the resized picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop_resized: Option<Crop>,
    /// The channels that the network takes, computed from the resized bytes.
    pub colour: ColourSpace,
    /// From 0..=255 to the range that the network takes.
    pub scale: PixelScale,
    /// Order of the numbers.
    pub layout: TensorLayout,
}

/// Rows of a picture from `top` to before `bottom`, and columns from `left` to before `right`: all if these are absent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Crop {
    /// First row kept, counted from 0 at the top.
    pub top: usize,
    /// First row below that is not kept.
    pub bottom: usize,
    /// First column kept, counted from 0 at the left.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left: Option<usize>,
    /// First column to the right that is not kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub right: Option<usize>,
}

impl Crop {
    /// The lowest row that a crop may end at: that of VGA. The stock simulator sends 160 rows, and no build is known to
    /// send more than VGA; a network for larger pictures was not trained on this car's.
    pub const MAX_BOTTOM: usize = 480;
    /// The last column, likewise.
    pub const MAX_RIGHT: usize = 640;

    /// These rows, all columns.
    pub fn rows(top: usize, bottom: usize) -> Self {
        Self { top, bottom, left: None, right: None }
    }

    /// Rows and columns that it keeps of a picture of this size.
    fn area_of(&self, width: usize, height: usize) -> Result<Area, PreprocessError> {
        let (left, right) = (self.left.unwrap_or(0), self.right.unwrap_or(width));
        if self.bottom > height {
            return Err(PreprocessError::CropOutside { bottom: self.bottom, width, height });
        }
        if right > width || left >= right {
            return Err(PreprocessError::CropBeside { left, right, width, height });
        }
        Ok(Area { top: self.top, bottom: self.bottom, left, right })
    }

    fn validate(&self) -> Result<(), PreprocessError> {
        let Self { top, bottom, left, right } = *self;
        if top >= bottom {
            return Err(PreprocessError::EmptyCrop { top, bottom });
        }
        if bottom > Self::MAX_BOTTOM {
            return Err(PreprocessError::CropBeyond { top, bottom });
        }
        let (left, right) = (left.unwrap_or(0), right.unwrap_or(Self::MAX_RIGHT));
        if left >= right || right > Self::MAX_RIGHT {
            return Err(PreprocessError::Columns { left, right });
        }
        Ok(())
    }
}

/// A part of a picture: rows from `top` to before `bottom`, columns from `left` to before `right`; not empty.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Area {
    /// First row.
    pub top: usize,
    /// First row below.
    pub bottom: usize,
    /// First column.
    pub left: usize,
    /// First column to the right.
    pub right: usize,
}

impl Area {
    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.right - self.left
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.bottom - self.top
    }
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
    /// `antialias=True`, fast, and seldom a level off. OpenCV's `INTER_LINEAR` is a different filter.
    BilinearAntialiased,
    /// Pillow's `NEAREST`, to the byte, as are those that follow.
    PillowNearest,
    /// Pillow's `BOX`.
    PillowBox,
    /// Pillow's `BILINEAR`; what `scipy.misc.imresize` used, too.
    PillowBilinear,
    /// Pillow's `BICUBIC`.
    PillowBicubic,
    /// Pillow's `LANCZOS`, once `ANTIALIAS`.
    PillowLanczos,
    /// OpenCV's `INTER_NEAREST`.
    #[serde(rename = "cv2-nearest")]
    Cv2Nearest,
    /// OpenCV's `INTER_LINEAR`, which `cv2.resize` uses if none is named.
    #[serde(rename = "cv2-linear")]
    Cv2Linear,
    /// OpenCV's `INTER_CUBIC`.
    #[serde(rename = "cv2-cubic")]
    Cv2Cubic,
    /// OpenCV's `INTER_AREA`.
    #[serde(rename = "cv2-area")]
    Cv2Area,
}

/// Order of the numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TensorLayout {
    /// One plane a channel, rows from the top: PyTorch's.
    Nchw,
    /// Pixel by pixel, rows from the top: TensorFlow's and Keras'.
    Nhwc,
}

impl Preprocess {
    /// Crop of rows, resize, colour, scale, channel by channel: the steps of Lapwing's own networks.
    pub fn of(crop: Option<Crop>, resize: Resize, colour: ColourSpace, scale: PixelScale) -> Self {
        let (blur, colour_first, crop_resized, layout) = (None, false, None, TensorLayout::Nchw);
        Self { crop, blur, colour_first, resize, crop_resized, colour, scale, layout }
    }

    /// What comes out: channels, rows, pixels in a row; in whatever order the layout puts them.
    pub fn shape(&self) -> [usize; 3] {
        let Area { top, bottom, left, right } = self.kept();
        [self.colour.channels(), bottom.saturating_sub(top), right.saturating_sub(left)]
    }

    /// What goes into the network, with a batch of one in front: in the order of the layout.
    pub fn tensor_shape(&self) -> [usize; 4] {
        let [channels, height, width] = self.shape();
        match self.layout {
            TensorLayout::Nchw => [1, channels, height, width],
            TensorLayout::Nhwc => [1, height, width, channels],
        }
    }

    /// Whether each number is a weighted sum of a few pixels: only the steps of [`Preprocess::of`]. Such pictures can be
    /// changed in between, as training does, and explained.
    pub fn is_plain(&self) -> bool {
        let rows_only = self.crop.is_none_or(|crop| crop.left.is_none() && crop.right.is_none());
        let other = Self::of(self.crop, self.resize, self.colour, self.scale.clone());
        *self == other
            && rows_only
            && self.resize.filter == ResizeFilter::BilinearAntialiased
            && self.colour.weights().is_some()
    }

    /// The part of the resized picture that is kept; nothing where the crop is invalid.
    pub(super) fn kept(&self) -> Area {
        let Resize { width, height, .. } = self.resize;
        let crop = self.crop_resized.unwrap_or(Crop::rows(0, height));
        Area { top: crop.top, bottom: crop.bottom, left: crop.left.unwrap_or(0), right: crop.right.unwrap_or(width) }
    }

    /// Checks all that can be checked without a frame.
    ///
    /// # Errors
    /// [`PreprocessError`] naming the first invalid field.
    pub fn validate(&self) -> Result<(), PreprocessError> {
        if let Some(crop) = self.crop {
            crop.validate()?;
        }
        let Resize { width, height, .. } = self.resize;
        let side = 1..=Resize::MAX_SIDE;
        if !side.contains(&width) || !side.contains(&height) {
            return Err(PreprocessError::Size { width, height });
        }
        if let Some(got) = self.crop_resized
            && (got.area_of(width, height).is_err() || got.top >= got.bottom)
        {
            return Err(PreprocessError::CropResized { width, height, got });
        }
        if self.colour_first && self.colour.bytes().is_none() {
            return Err(PreprocessError::ColourFirst(self.colour));
        }
        if let PixelScale::Shifted { mean, range } = self.scale
            && self.scale.affine(0).is_none()
        {
            return Err(PreprocessError::Shift { mean, range });
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

    /// What to keep of a picture of this size.
    ///
    /// # Errors
    /// [`PreprocessError::EmptyFrame`], [`PreprocessError::CropOutside`], [`PreprocessError::CropBeside`].
    pub fn area_of(&self, width: usize, height: usize) -> Result<Area, PreprocessError> {
        if width == 0 || height == 0 {
            return Err(PreprocessError::EmptyFrame { width, height });
        }
        self.crop.unwrap_or(Crop::rows(0, height)).area_of(width, height)
    }

    /// The stock simulator's size, 320 x 160, or more where the crop asks for it: width and height.
    pub fn picture_size(&self) -> [usize; 2] {
        let asked = self.crop.map_or((0, 0), |crop| (crop.right.unwrap_or(0), crop.bottom));
        [asked.0.max(320), asked.1.max(160)]
    }
}

#[cfg(test)]
mod tests;
