//! OpenCV's `GaussianBlur` of bytes, with the deviation that it derives from the kernel's size (`sigmaX = 0`).

use serde::{Deserialize, Serialize};

use super::resample::Pixels;

/// A blur before the resize.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Blur {
    /// `cv2.GaussianBlur(image, (3, 3), 0)`
    #[serde(rename = "gaussian-3x3")]
    Gaussian3,
    /// `cv2.GaussianBlur(image, (5, 5), 0)`
    #[serde(rename = "gaussian-5x5")]
    Gaussian5,
    /// `cv2.GaussianBlur(image, (7, 7), 0)`
    #[serde(rename = "gaussian-7x7")]
    Gaussian7,
}

impl Blur {
    /// Weights of one side: the table that OpenCV has for these sizes, in shares of their sum.
    fn weights(self) -> &'static [u32] {
        match self {
            Self::Gaussian3 => &[1, 2, 1],
            Self::Gaussian5 => &[1, 4, 6, 4, 1],
            Self::Gaussian7 => &[2, 7, 14, 18, 14, 7, 2],
        }
    }

    /// Blurs into `out`, of as many bytes. The edge is a mirror that does not repeat its last pixel (`BORDER_REFLECT_101`).
    pub(super) fn apply(self, source: Pixels<'_>, out: &mut Vec<u8>) {
        let weights = self.weights();
        let sum: u32 = weights.iter().sum();
        let reach = weights.len() / 2;
        let Pixels { bytes, width, height, channels } = source;
        let length = width * channels;
        // Not rounded: 8 bits of a pixel and at most 6 of the weights.
        let mut across = vec![0u32; bytes.len()];
        for (row, across) in bytes.chunks_exact(length).zip(across.chunks_exact_mut(length)) {
            for (i, to) in across.iter_mut().enumerate() {
                let (x, channel) = (i / channels, i % channels);
                let tap = |(k, weight): (usize, &u32)| {
                    weight * u32::from(row[mirrored(x + k, reach, width) * channels + channel])
                };
                *to = weights.iter().enumerate().map(tap).sum();
            }
        }
        out.clear();
        for y in 0..height {
            let rows = weights.iter().enumerate().map(|(k, w)| (mirrored(y + k, reach, height) * length, *w));
            let rows: Vec<_> = rows.collect();
            out.extend((0..length).map(|x| {
                let total: u32 = rows.iter().map(|(row, weight)| weight * across[row + x]).sum();
                ((total + sum * sum / 2) / (sum * sum)) as u8
            }));
        }
    }
}

/// Place `at - reach` on a side of that many pixels, mirrored at its ends.
fn mirrored(at: usize, reach: usize, side: usize) -> usize {
    let (mut at, last) = (at as i64 - reach as i64, side as i64 - 1);
    if last == 0 {
        return 0;
    }
    while !(0..=last).contains(&at) {
        at = if at < 0 { -at } else { 2 * last - at };
    }
    at as usize
}
