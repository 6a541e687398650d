//! The channels that networks take: weighted sums of red, green and blue, or bytes as OpenCV and Pillow compute them.

use serde::{Deserialize, Serialize};

/// The channels that a network takes. Those named after a library are its bytes, to the last one.
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
    /// `cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV)` since OpenCV 3.2: the above as bytes.
    #[serde(rename = "cv2-yuv")]
    Cv2Yuv,
    /// The same call up to OpenCV 3.1, which took red for blue and blue for red: today's `COLOR_BGR2YUV` of an RGB
    /// picture.
    #[serde(rename = "cv2-yuv-3.1")]
    Cv2YuvOf31,
    /// `cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)`.
    #[serde(rename = "cv2-grey")]
    Cv2Grey,
    /// `cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)`: hue 0 to 179, saturation, value.
    #[serde(rename = "cv2-hsv")]
    Cv2Hsv,
    /// The saturation of the above alone.
    #[serde(rename = "cv2-saturation")]
    Cv2Saturation,
    /// Pillow's `convert("YCbCr")`, JPEG's.
    PillowYcbcr,
    /// Pillow's `convert("L")`.
    PillowGrey,
}

impl ColourSpace {
    /// How many channels these are.
    pub fn channels(self) -> usize {
        match self {
            Self::Grey | Self::Cv2Grey | Self::Cv2Saturation | Self::PillowGrey => 1,
            _ => 3,
        }
    }

    /// Weights of red, green and blue, and a constant, for each channel; `None` for colours that are not such sums.
    pub(super) fn weights(self) -> Option<&'static [[f64; 4]]> {
        const Y: [f64; 3] = [0.299, 0.587, 0.114];
        const U: f64 = 0.492;
        const V: f64 = 0.877;
        match self {
            Self::Rgb => Some(&[[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
            Self::Bgr => Some(&[[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]),
            Self::Yuv => Some(
                &const {
                    [
                        [Y[0], Y[1], Y[2], 0.0],
                        [-U * Y[0], -U * Y[1], U * (1.0 - Y[2]), 128.0],
                        [V * (1.0 - Y[0]), -V * Y[1], -V * Y[2], 128.0],
                    ]
                },
            ),
            Self::Grey => Some(&const { [[Y[0], Y[1], Y[2], 0.0]] }),
            _ => None,
        }
    }

    /// The bytes of a pixel's channels, as many as there are; `None` for colours that are not made of bytes.
    pub(super) fn bytes(self) -> Option<fn([u8; 3]) -> [u8; 3]> {
        match self {
            Self::Rgb => Some(|rgb| rgb),
            Self::Bgr => Some(|[r, g, b]| [b, g, r]),
            Self::Yuv | Self::Grey => None,
            Self::Cv2Yuv => Some(cv2_yuv),
            Self::Cv2YuvOf31 => Some(|[r, g, b]| cv2_yuv([b, g, r])),
            Self::Cv2Grey => Some(|rgb| [cv2_grey(rgb), 0, 0]),
            Self::Cv2Hsv => Some(cv2_hsv),
            Self::Cv2Saturation => Some(|rgb| [cv2_hsv(rgb)[1], 0, 0]),
            Self::PillowYcbcr => Some(pillow_ycbcr),
            Self::PillowGrey => Some(|rgb| [pillow_grey(rgb), 0, 0]),
        }
    }
}

/// `x / 2^bits`, to the nearest.
fn descaled(x: i32, bits: u32) -> i32 {
    (x + (1 << (bits - 1))) >> bits
}

/// OpenCV's `RGB2YCrCb_i` for YUV, in 2^14ths.
fn cv2_yuv(rgb: [u8; 3]) -> [u8; 3] {
    let [r, g, b] = rgb.map(i32::from);
    let y = descaled(4899 * r + 9617 * g + 1868 * b, 14);
    let centred = |x: i32| descaled(x + (128 << 14), 14);
    [y, centred((b - y) * 8061), centred((r - y) * 14369)].map(|x| x.clamp(0, 255) as u8)
}

/// OpenCV's `RGB2Gray`, in 2^15ths.
fn cv2_grey(rgb: [u8; 3]) -> u8 {
    let [r, g, b] = rgb.map(i32::from);
    descaled(9798 * r + 19235 * g + 3735 * b, 15) as u8
}

/// OpenCV's `RGB2HSV_b`, whose divisions are looked up in 2^12ths.
fn cv2_hsv(rgb: [u8; 3]) -> [u8; 3] {
    const SHIFT: u32 = 12;
    let [r, g, b] = rgb.map(i32::from);
    let value = r.max(g).max(b);
    let span = value - r.min(g).min(b);
    let by =
        |full: i32, n: i32| if n == 0 { 0 } else { (f64::from(full << SHIFT) / f64::from(n)).round_ties_even() as i32 };
    let saturation = descaled(span * by(255, value), SHIFT);
    let hue = if value == r {
        g - b
    } else if value == g {
        b - r + 2 * span
    } else {
        r - g + 4 * span
    };
    let hue = descaled(hue * by(30, span), SHIFT);
    [if hue < 0 { hue + 180 } else { hue }, saturation, value].map(|x| x as u8)
}

/// Pillow's `rgb2ycbcr`, whose products are looked up in 64ths, each with a half added and cut off.
fn pillow_ycbcr(rgb: [u8; 3]) -> [u8; 3] {
    let product = |weight: f64, x: u8| (weight * 64.0 * f64::from(x) + 0.5) as i32;
    let sum = |weights: [f64; 3]| weights.iter().zip(rgb).map(|(weight, x)| product(*weight, x)).sum::<i32>() >> 6;
    let y = sum([0.299, 0.587, 0.114]);
    let blue = sum([-0.16874, -0.33126, 0.5]) + 128;
    let red = sum([0.5, -0.41869, -0.08131]) + 128;
    [y, blue, red].map(|x| x.clamp(0, 255) as u8)
}

/// Pillow's `L24`, in 2^16ths.
fn pillow_grey(rgb: [u8; 3]) -> u8 {
    let [r, g, b] = rgb.map(u32::from);
    ((19595 * r + 38470 * g + 7471 * b + 0x8000) >> 16) as u8
}
