//! A camera's picture.

/// One RGB picture, 320 x 160 from the stock simulator.
///
/// Rows run from the top, pixels from the left, channels red, green, blue, one
/// byte each and nothing between them. [`Frame::default`] is an empty picture
/// whose buffer [`decode_jpeg`](super::decode_jpeg) fills and reuses.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Frame {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Frame {
    /// A picture of the given pixels: `rgb` holds `height` rows of `width` triples.
    ///
    /// `None` if the length of `rgb` is not `width * height * 3`.
    pub fn new(width: usize, height: usize, rgb: Vec<u8>) -> Option<Self> {
        (width.checked_mul(height)?.checked_mul(3)? == rgb.len()).then_some(Self { width, height, rgb })
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, `width * height * 3` bytes.
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// All pixels, to paint on.
    pub fn rgb_mut(&mut self) -> &mut [u8] {
        &mut self.rgb
    }

    /// Red, green and blue at column `x` and row `y`, or `None` beyond the picture.
    pub fn pixel(&self, x: usize, y: usize) -> Option<[u8; 3]> {
        let at = (x < self.width && y < self.height).then_some((y * self.width + x) * 3)?;
        self.rgb[at..].first_chunk().copied()
    }

    /// Changes the size and keeps the memory. What the picture then shows is unspecified: the caller must paint all of
    /// it.
    pub fn resize(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width, height);
        self.rgb.resize(width * height * 3, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_has_three_bytes_for_each_pixel_or_is_none() {
        assert!(Frame::new(2, 2, vec![0; 12]).is_some());
        assert_eq!(Frame::new(2, 2, vec![0; 11]), None);
        assert_eq!(Frame::new(usize::MAX, 2, vec![]), None);
    }

    #[test]
    fn pixels_are_found_by_column_and_row() {
        let frame = Frame::new(2, 2, (0..12).collect()).unwrap();
        assert_eq!(frame.pixel(1, 0), Some([3, 4, 5]));
        assert_eq!(frame.pixel(0, 1), Some([6, 7, 8]));
        assert_eq!(frame.pixel(2, 0), None);
    }
}
