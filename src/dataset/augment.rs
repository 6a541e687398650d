//! Changes to a picture that change its label in a known way, or not at all.
//!
//! The five of Lu, "End to End Learning for Self-Driving Cars", with Lu's ranges as defaults. Each sample is changed
//! anew each time it is drawn; Lu wrote 4.8 million changed pictures to disk beforehand, which are draws from the same
//! distribution. All pictures of a sequence are changed alike.

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{DatasetError, samples::unit};
use crate::perception::{Crop, Frame};

/// How likely each change is, and how large.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Augmentation {
    /// Probability of a mirrored picture with a negated label; default 0.5.
    pub flip: f64,
    /// Probability of a shifted picture; default 0.5. What comes in at the border repeats the border.
    pub translate: f64,
    /// Farthest shift to either side, in pixels of the recorded picture; default 60.
    pub translate_x_px: u32,
    /// Farthest shift up or down; default 20.
    pub translate_y_px: u32,
    /// Steering added for each pixel that the picture moves to the right; default 0.003.
    pub steering_per_px: f64,
    /// Probability of another brightness; default 0.5.
    pub brightness: f64,
    /// Factors on every channel, least and largest; default 0.3 to 1.6.
    pub brightness_range: (f64, f64),
    /// Probability of a shadow across the picture; default 0.5.
    pub shadow: f64,
    /// Factors on every channel in the shadow; default 0.6 to 0.85.
    pub shadow_range: (f64, f64),
    /// Probability of an erased rectangle; default 0.5.
    pub erase: f64,
    /// Largest share of the picture that is erased; default 0.4.
    pub erase_area: f64,
    /// Height over width of what is erased; default 0.5 to 2.5.
    pub erase_ratio: (f64, f64),
    /// What stands there then, 0 to 255; default 0.
    pub erase_value: u8,
}

impl Default for Augmentation {
    fn default() -> Self {
        Self {
            flip: 0.5,
            translate: 0.5,
            translate_x_px: 60,
            translate_y_px: 20,
            steering_per_px: 0.003,
            brightness: 0.5,
            brightness_range: (0.3, 1.6),
            shadow: 0.5,
            shadow_range: (0.6, 0.85),
            erase: 0.5,
            erase_area: 0.4,
            erase_ratio: (0.5, 2.5),
            erase_value: 0,
        }
    }
}

/// Smallest share of the picture that is erased, as in Zhong et al., "Random Erasing Data Augmentation", 2017.
const ERASE_LEAST: f64 = 0.02;

impl Augmentation {
    /// Their names, as `--augment` takes them.
    pub const NAMES: [&str; 5] = ["flip", "translate", "brightness", "shadow", "erase"];

    /// No change at all.
    pub fn none() -> Self {
        Self { flip: 0.0, translate: 0.0, brightness: 0.0, shadow: 0.0, erase: 0.0, ..Self::default() }
    }

    /// How likely the change of that name is.
    pub fn probability(&mut self, name: &str) -> Option<&mut f64> {
        match name {
            "flip" => Some(&mut self.flip),
            "translate" => Some(&mut self.translate),
            "brightness" => Some(&mut self.brightness),
            "shadow" => Some(&mut self.shadow),
            "erase" => Some(&mut self.erase),
            _ => None,
        }
    }

    /// Checks every range.
    ///
    /// # Errors
    /// [`DatasetError::Setting`] for the first that cannot be.
    pub fn check(&self) -> Result<(), DatasetError> {
        let wrong = |name, expected, got| Err(DatasetError::Setting { name, expected, got });
        for (name, p) in
            Self::NAMES.into_iter().zip([self.flip, self.translate, self.brightness, self.shadow, self.erase])
        {
            if !(0.0..=1.0).contains(&p) {
                return wrong(name, "a probability from 0 to 1", p.to_string());
            }
        }
        for (name, (least, most)) in [
            ("brightness_range", self.brightness_range),
            ("shadow_range", self.shadow_range),
            ("erase_ratio", self.erase_ratio),
        ] {
            if !(least > 0.0 && least <= most && most <= 100.0) {
                return wrong(name, "two numbers above 0, the smaller first", format!("{least}, {most}"));
            }
        }
        if !(ERASE_LEAST..=1.0).contains(&self.erase_area) {
            return wrong("erase_area", "0.02 to 1", self.erase_area.to_string());
        }
        if !(-1.0..=1.0).contains(&self.steering_per_px) {
            return wrong("steering_per_px", "-1 to 1", self.steering_per_px.to_string());
        }
        Ok(())
    }

    /// Rolls the dice for one sample.
    pub fn draw(&self, random: &mut ChaCha8Rng) -> Change {
        // Each die is rolled whether it counts or not, so that switching one change off leaves the others as they were.
        let mut chance = |p: f64| unit(random) < p;
        let (flip, shift, bright, shadow, erase) = (
            chance(self.flip),
            chance(self.translate),
            chance(self.brightness),
            chance(self.shadow),
            chance(self.erase),
        );
        let mut within = |(least, most): (f64, f64)| least + (most - least) * unit(random);
        let symmetric = |reach: u32| (-f64::from(reach), f64::from(reach));
        let by = (
            within(symmetric(self.translate_x_px)).round() as i32,
            within(symmetric(self.translate_y_px)).round() as i32,
        );
        let factor = within(self.brightness_range);
        let dark = Shadow {
            top: [within((0.0, 1.0)), within((0.0, 1.0))],
            bottom: [within((0.0, 1.0)), within((0.0, 1.0))],
            factor: within(self.shadow_range),
        };
        let area = within((ERASE_LEAST, self.erase_area));
        // Uniform in the logarithm: as likely tall as wide.
        let ratio = within((self.erase_ratio.0.ln(), self.erase_ratio.1.ln())).exp();
        let gone = Rectangle { area, ratio, at: (within((0.0, 1.0)), within((0.0, 1.0))), value: self.erase_value };
        Change {
            flip,
            shift: if shift { by } else { (0, 0) },
            steering_per_px: self.steering_per_px,
            brightness: if bright { factor } else { 1.0 },
            shadow: shadow.then_some(dark),
            erase: erase.then_some(gone),
        }
    }
}

/// One draw.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// Mirrored, before all else.
    pub flip: bool,
    /// Pixels to the right and down that the picture moves.
    pub shift: (i32, i32),
    /// Steering added for each pixel to the right.
    pub steering_per_px: f64,
    /// Factor on every channel.
    pub brightness: f64,
    /// Across what the network sees, from its upper to its lower edge.
    pub shadow: Option<Shadow>,
    /// Out of what the network sees.
    pub erase: Option<Rectangle>,
}

/// Darkened between two lines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shadow {
    /// Where the lines meet the upper edge, 0 (left) to 1.
    pub top: [f64; 2],
    /// And the lower one.
    pub bottom: [f64; 2],
    /// On every channel.
    pub factor: f64,
}

/// What is erased.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle {
    /// Share of the picture.
    pub area: f64,
    /// Height over width.
    pub ratio: f64,
    /// Where in the room that is left, 0 to 1, across and down.
    pub at: (f64, f64),
    /// What stands there then.
    pub value: u8,
}

impl Change {
    /// None.
    pub fn none() -> Self {
        Self { flip: false, shift: (0, 0), steering_per_px: 0.0, brightness: 1.0, shadow: None, erase: None }
    }

    /// What is to be steered in the changed picture.
    pub fn steering(&self, steering: f64) -> f64 {
        let steering = if self.flip { -steering } else { steering };
        steering + f64::from(self.shift.0) * self.steering_per_px
    }

    /// Writes the changed rows of `crop` to `out`, which takes their size. Rows that the shift brings in from outside
    /// the crop are those of the picture.
    pub fn apply(&self, frame: &Frame, crop: Crop, out: &mut Frame) {
        let (width, height) = (frame.width(), frame.height());
        out.resize(width, crop.bottom - crop.top);
        if self.is_none() {
            out.rgb_mut().copy_from_slice(&frame.rgb()[crop.top * width * 3..crop.bottom * width * 3]);
            return;
        }
        let table =
            |factor: f64| -> [u8; 256] { std::array::from_fn(|i| (i as f64 * factor).round().min(255.0) as u8) };
        let light = table(self.brightness);
        let dark = self.shadow.map(|shadow| table(self.brightness * shadow.factor));
        let rows = crop.bottom - crop.top;
        let erased = self.erase.map(|gone| gone.pixels(width, rows));
        let (right, down) = self.shift;
        let clamp = |x: i64, end: usize| x.clamp(0, end as i64 - 1) as usize;
        for (y, line) in out.rgb_mut().chunks_exact_mut(width * 3).enumerate() {
            let from = clamp((y + crop.top) as i64 - i64::from(down), height);
            let source = &frame.rgb()[from * width * 3..(from + 1) * width * 3];
            let (shade_from, shade_to) = match &self.shadow {
                Some(shadow) => shadow.columns(y as f64 / rows as f64, width),
                None => (0, 0),
            };
            for (x, pixel) in line.chunks_exact_mut(3).enumerate() {
                let column = clamp(x as i64 - i64::from(right), width);
                let column = if self.flip { width - 1 - column } else { column };
                let table = match &dark {
                    Some(dark) if (shade_from..shade_to).contains(&x) => dark,
                    _ => &light,
                };
                for (to, from) in pixel.iter_mut().zip(&source[column * 3..column * 3 + 3]) {
                    *to = table[usize::from(*from)];
                }
            }
            if let Some((left, right, top, bottom, value)) = erased
                && (top..bottom).contains(&y)
            {
                line[left * 3..right * 3].fill(value);
            }
        }
    }

    fn is_none(&self) -> bool {
        let Self { flip, shift, steering_per_px: _, brightness, shadow, erase } = self;
        !flip && *shift == (0, 0) && *brightness == 1.0 && shadow.is_none() && erase.is_none()
    }
}

impl Shadow {
    /// First column in the shade and the one after the last, so far down (0 to 1).
    fn columns(&self, down: f64, width: usize) -> (usize, usize) {
        let at = |i: usize| ((self.top[i] + (self.bottom[i] - self.top[i]) * down) * width as f64) as usize;
        let (a, b) = (at(0), at(1));
        (a.min(b), a.max(b))
    }
}

impl Rectangle {
    /// Left, right, top, bottom and value. A shape that does not fit is cut to the picture.
    fn pixels(&self, width: usize, height: usize) -> (usize, usize, usize, usize, u8) {
        let area = self.area * (width * height) as f64;
        let tall = ((area * self.ratio).sqrt().round() as usize).clamp(1, height);
        let wide = ((area / tall as f64).round() as usize).clamp(1, width);
        let left = ((width - wide) as f64 * self.at.0).round() as usize;
        let top = ((height - tall) as f64 * self.at.1).round() as usize;
        (left, left + wide, top, top + tall, self.value)
    }
}
