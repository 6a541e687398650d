//! Errors of preprocessing.

use super::{Crop, Resize};
use crate::perception::ColourSpace;

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
    /// Columns that keep nothing, or reach beyond any simulator's picture.
    #[error("expected a crop of columns within 0 to {max}, left before right, got {left} to {right}", max = Crop::MAX_RIGHT)]
    Columns {
        /// First column kept.
        left: usize,
        /// First column no longer kept.
        right: usize,
    },
    /// A crop after the resize that reaches beyond its size.
    #[error("expected a crop_resized within {width}x{height}, got {got:?}")]
    CropResized {
        /// Pixels in a row of the resized picture.
        width: usize,
        /// Its rows.
        height: usize,
        /// The crop.
        got: Crop,
    },
    /// A colour that cannot be computed before a resize.
    #[error("expected a colour of whole bytes for colour_first (cv2-yuv, cv2-grey, …), got {0:?}")]
    ColourFirst(ColourSpace),
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
    /// A mean or range that would not give finite numbers.
    #[error("expected a finite mean and a positive finite range, got {mean} and {range}")]
    Shift {
        /// Subtracted.
        mean: f64,
        /// Divided by.
        range: f64,
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
    /// The frame does not have the columns to keep.
    #[error("expected a frame with columns {left} to {right} for the crop, got {width}x{height}")]
    CropBeside {
        /// First column kept.
        left: usize,
        /// First column no longer kept.
        right: usize,
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
