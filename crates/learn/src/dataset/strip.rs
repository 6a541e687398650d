//! A picture prepared for augmentation: at the size of the network's input, with the rows above and below that shifts
//! bring in.

use lapwing_core::perception::{Crop, Frame, Preprocess, PreprocessError, Preprocessor};

/// Which strip to cut out of pictures.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct StripCut {
    pub preprocess: Preprocess,
    /// Recorded pixels that a shift up or down may need beyond the crop.
    pub reach_px: u32,
}

/// Planes of red, green and blue: the crop exactly as the network's preprocessing resizes it, and the rows next to it
/// at the same scale.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Strip {
    width: usize,
    /// Rows above the crop, in it, and below it.
    rows: [usize; 3],
    /// Recorded pixels per pixel of the strip, across and down.
    scale: (f64, f64),
    planes: Vec<u8>,
    /// The cut that made it: the picture's crop and reach.
    by: (Option<Crop>, u32),
}

impl Strip {
    /// Cuts a strip out of a picture. `preprocessor` is that of the cut.
    pub fn cut(cut: &StripCut, preprocessor: &mut Preprocessor, frame: &Frame) -> Result<Self, PreprocessError> {
        let Preprocess { crop, resize, .. } = &cut.preprocess;
        let crop = crop.unwrap_or(Crop::rows(0, frame.height()));
        let inside = preprocessor.resize(frame)?.to_vec();
        let scale =
            (frame.width() as f64 / resize.width as f64, (crop.bottom - crop.top) as f64 / resize.height as f64);
        // As many rows as the reach asks for, limited to those that the picture has.
        let rows = |room: usize| {
            let reach = (f64::from(cut.reach_px) / scale.1).ceil();
            reach.min((room as f64 / scale.1).floor()) as usize
        };
        let (above, below) = (rows(crop.top), rows(frame.height() - crop.bottom));
        let mut strip = Self::empty(resize.width, [above, resize.height, below], scale);
        strip.by = (cut.preprocess.crop, cut.reach_px);
        strip.paint(0, &preprocessor.rows(frame, crop.top as f64 - above as f64 * scale.1, above));
        strip.paint(above, &inside);
        strip.paint(above + resize.height, &preprocessor.rows(frame, crop.bottom as f64, below));
        Ok(strip)
    }

    /// All of a picture, as recorded.
    pub fn whole(frame: &Frame) -> Self {
        let mut strip = Self::empty(frame.width(), [0, frame.height(), 0], (1.0, 1.0));
        strip.paint(0, frame.rgb());
        strip
    }

    fn empty(width: usize, rows: [usize; 3], scale: (f64, f64)) -> Self {
        Self { width, rows, scale, planes: vec![0; rows.iter().sum::<usize>() * width * 3], by: (None, 0) }
    }

    /// Paints RGB pixels from this row on.
    fn paint(&mut self, row: usize, rgb: &[u8]) {
        let plane = self.planes.len() / 3;
        for (channel, plane) in self.planes.chunks_exact_mut(plane.max(1)).enumerate() {
            let to = plane[row * self.width..].iter_mut();
            to.zip(rgb.iter().skip(channel).step_by(3)).for_each(|(to, from)| *to = *from);
        }
    }

    /// Whether it would be cut the same way.
    pub fn is_of(&self, cut: &StripCut) -> bool {
        let size = (cut.preprocess.resize.width, cut.preprocess.resize.height);
        self.by == (cut.preprocess.crop, cut.reach_px) && (self.width, self.rows[1]) == size
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows that the network sees.
    pub fn height(&self) -> usize {
        self.rows[1]
    }

    /// Recorded pixels per pixel of the strip, across and down.
    pub fn scale(&self) -> (f64, f64) {
        self.scale
    }

    /// Memory that it uses, in bytes.
    pub fn bytes(&self) -> usize {
        self.planes.len()
    }

    /// One channel's row, counted from the first that the network sees; beyond the last, the last is repeated.
    pub fn row(&self, channel: usize, row: i64) -> &[u8] {
        let all: usize = self.rows.iter().sum();
        let row = (row + self.rows[0] as i64).clamp(0, all as i64 - 1) as usize;
        &self.planes[(channel * all + row) * self.width..][..self.width]
    }
}
