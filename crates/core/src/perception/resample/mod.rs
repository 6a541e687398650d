//! Resizing to the byte as OpenCV and Pillow do it, for networks that were trained behind them.
//!
//! [`pillow`] and [`cv2`] each read as the library's own source does, so that an answer of theirs can be followed. What is
//! fast, Pillow's bilinear filter but for a level now and then, is [`Preprocessor`](super::Preprocessor)'s own.

mod cv2;
mod pillow;

use super::ResizeFilter;

/// Pixels in memory: rows from the top, `channels` bytes a pixel, nothing between.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pixels<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) channels: usize,
}

impl Pixels<'_> {
    fn row(&self, y: usize) -> &[u8] {
        let length = self.width * self.channels;
        &self.bytes[y * length..][..length]
    }
}

/// Resizes to `width` x `height`; `out` holds as many pixels. Neither picture is empty.
pub(super) fn resample(source: Pixels<'_>, filter: ResizeFilter, [width, height]: [usize; 2], out: &mut [u8]) {
    use ResizeFilter as F;
    match filter {
        F::BilinearAntialiased | F::PillowBilinear => {
            pillow::convolved(source, &pillow::BILINEAR, [width, height], out)
        }
        F::PillowBox => pillow::convolved(source, &pillow::BOX, [width, height], out),
        F::PillowBicubic => pillow::convolved(source, &pillow::BICUBIC, [width, height], out),
        F::PillowLanczos => pillow::convolved(source, &pillow::LANCZOS, [width, height], out),
        F::PillowNearest => pillow::nearest(source, [width, height], out),
        F::Cv2Nearest => cv2::nearest(source, [width, height], out),
        F::Cv2Linear => cv2::linear(source, [width, height], out),
        F::Cv2Cubic => cv2::cubic(source, [width, height], out),
        F::Cv2Area => cv2::area(source, [width, height], out),
    }
}

/// Each pixel of the target is one of the source: that of column `columns[x]` and row `rows[y]`.
fn picked(source: Pixels<'_>, columns: &[usize], rows: &[usize], out: &mut [u8]) {
    let channels = source.channels;
    for (row, out) in rows.iter().zip(out.chunks_exact_mut(columns.len() * channels)) {
        let row = source.row(*row);
        for (column, out) in columns.iter().zip(out.chunks_exact_mut(channels)) {
            out.copy_from_slice(&row[column * channels..][..channels]);
        }
    }
}
