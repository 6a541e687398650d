//! Changes to a picture that change its label in a known way, or not at all.
//!
//! The five of Lu, "End to End Learning for Self-Driving Cars", with Lu's ranges as defaults, and one of our own, an older
//! picture warped to where the car is now. Each sample is changed anew each time it is drawn; Lu wrote 4.8 million changed
//! pictures to disk beforehand, drawn from the same distribution. All pictures of a sequence are changed in the same way.
//!
//! The picture is changed at the network's input size, a third of the work of changing the recorded one. Shifts are
//! given in recorded pixels and rounded to whole pixels of the network's input (1.6 recorded pixels for PilotNet, 2 for
//! a ResNet, 8 for `cps`); the label is corrected by the rounded shift.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{DatasetError, strip::Strip};

/// How likely each change is, and how large.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Augmentation {
    /// Probability of a mirrored picture with a negated label; default 0.5.
    pub flip: f64,
    /// Probability of a shifted picture; default 0.5. New pixels at the border repeat it.
    pub translate: f64,
    /// Farthest shift to either side, in pixels of the recorded picture; default 60.
    pub translate_x_px: u32,
    /// Farthest shift up or down; default 20.
    pub translate_y_px: u32,
    /// Steering added for each pixel that the picture moves to the right; default 0.003.
    pub steering_per_px: f64,
    /// Probability of a changed brightness; default 0.5.
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
    /// Height over width of the erased rectangle; default 0.5 to 2.5.
    pub erase_ratio: (f64, f64),
    /// The value that replaces it, 0 to 255; default 0.
    pub erase_value: u8,
    /// Probability of an older picture of the same camera in its place, warped to where the car is now, as networks see the road
    /// where commands take effect late ([`Ahead`](lapwing_sim::ahead::Ahead)), from 0 to 1; default 0. Needs
    /// [`Samples::place`](super::Samples::place). Where it is not known how the car moved, the picture stays.
    pub late: f64,
    /// How much older it is at most, from 0 to 1 second; default 0.2. All ages up to that are equally likely.
    pub late_s: f64,
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
            late: 0.0,
            late_s: 0.2,
        }
    }
}

/// Smallest share of the picture that is erased, as in Zhong et al., "Random Erasing Data Augmentation", 2017.
const ERASE_LEAST: f64 = 0.02;

impl Augmentation {
    /// The names of Lu's five, as `--augment` takes them.
    pub const NAMES: [&str; 5] = ["flip", "translate", "brightness", "shadow", "erase"];

    /// No change at all.
    pub fn none() -> Self {
        Self { flip: 0.0, translate: 0.0, brightness: 0.0, shadow: 0.0, erase: 0.0, late: 0.0, ..Self::default() }
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
    /// [`DatasetError::Setting`] for the first invalid one.
    pub fn check(&self) -> Result<(), DatasetError> {
        let wrong = |name, expected, got| Err(DatasetError::Setting { name, expected, got });
        for (name, p) in Self::NAMES
            .into_iter()
            .zip([self.flip, self.translate, self.brightness, self.shadow, self.erase])
            .chain([("late", self.late)])
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
        if !(0.0..=1.0).contains(&self.late_s) {
            return wrong("late_s", "0 to 1 second", self.late_s.to_string());
        }
        if !(-1.0..=1.0).contains(&self.steering_per_px) {
            return wrong("steering_per_px", "-1 to 1", self.steering_per_px.to_string());
        }
        Ok(())
    }

    /// Rolls the dice for one sample.
    pub fn draw(&self, random: &mut ChaCha8Rng) -> AugmentationDraw {
        // Each random number is drawn whether it is used or not, so that switching one change off leaves the others as
        // they were.
        let mut chance = |p: f64| random.random::<f64>() < p;
        let (flip, shift, bright, shadow, erase) = (
            chance(self.flip),
            chance(self.translate),
            chance(self.brightness),
            chance(self.shadow),
            chance(self.erase),
        );
        let mut within = |(least, most): (f64, f64)| least + (most - least) * random.random::<f64>();
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
        let (late, late_s) = (random.random::<f64>() < self.late, self.late_s * random.random::<f64>());
        AugmentationDraw {
            late_s: if late { late_s } else { 0.0 },
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
pub struct AugmentationDraw {
    /// How much older a picture is shown, in seconds, warped to where the car is now; 0: the row's own. The loader does that.
    pub late_s: f64,
    /// Mirrored, before all else.
    pub flip: bool,
    /// Recorded pixels to the right and down that the picture moves.
    pub shift: (i32, i32),
    /// Steering added for each recorded pixel to the right.
    pub steering_per_px: f64,
    /// Factor on every channel.
    pub brightness: f64,
    /// A shadow across the network's input, from its upper to its lower edge.
    pub shadow: Option<Shadow>,
    /// A rectangle erased from the network's input.
    pub erase: Option<Rectangle>,
}

/// A darkened area between two lines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shadow {
    /// Where the lines meet the upper edge, 0 (left) to 1.
    pub top: [f64; 2],
    /// Where they meet the lower edge.
    pub bottom: [f64; 2],
    /// Factor on every channel.
    pub factor: f64,
}

/// What is erased.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle {
    /// Share of the picture.
    pub area: f64,
    /// Height over width, as recorded.
    pub ratio: f64,
    /// Position within the remaining room, 0 to 1, across and down.
    pub at: (f64, f64),
    /// The value that replaces it.
    pub value: u8,
}

impl AugmentationDraw {
    /// None.
    pub fn none() -> Self {
        Self {
            late_s: 0.0,
            flip: false,
            shift: (0, 0),
            steering_per_px: 0.0,
            brightness: 1.0,
            shadow: None,
            erase: None,
        }
    }

    /// The label of the changed picture, one pixel of which is `scale` recorded pixels wide.
    pub(super) fn steering(&self, steering: f64, scale: f64) -> f64 {
        let steering = if self.flip { -steering } else { steering };
        steering + whole(self.shift.0, scale) as f64 * scale * self.steering_per_px
    }

    /// Makes the changed picture, row by row from the top: `row` receives its number, and red, green and blue from 0 to
    /// 255. A shift is rounded to whole pixels of the strip. `scratch` may be anything.
    pub(super) fn apply(&self, strip: &Strip, scratch: &mut [Vec<f32>; 3], mut row: impl FnMut(usize, [&[f32]; 3])) {
        let (width, height) = (strip.width(), strip.height());
        let (right, down) = (whole(self.shift.0, strip.scale().0), whole(self.shift.1, strip.scale().1));
        let (across, down_px) = strip.scale();
        // In recorded pixels: the network's need not be square.
        let erased =
            self.erase.map(|gone| Rectangle { ratio: gone.ratio * across / down_px, ..gone }.pixels(width, height));
        let light = self.brightness as f32;
        for y in 0..height {
            let shade =
                self.shadow.map(|shadow| (shadow.columns(y as f64 / height as f64, width), shadow.factor as f32));
            for (channel, out) in scratch.iter_mut().enumerate() {
                out.resize(width, 0.0);
                moved(strip.row(channel, y as i64 - down), right, self.flip, out);
                match shade {
                    Some(((from, to), factor)) => {
                        brighten(&mut out[..from], light);
                        brighten(&mut out[from..to], light * factor);
                        brighten(&mut out[to..], light);
                    }
                    None => brighten(out, light),
                }
                if let Some((left, right, top, bottom, value)) = erased
                    && (top..bottom).contains(&y)
                {
                    out[left..right].fill(f32::from(value));
                }
            }
            row(y, scratch.each_ref().map(|channel| &channel[..]));
        }
    }
}

/// Recorded pixels in whole pixels of another size.
fn whole(shift: i32, scale: f64) -> i64 {
    (f64::from(shift) / scale).round() as i64
}

/// A row moved to the right, perhaps mirrored before; the pixel at the border is repeated.
fn moved(row: &[u8], right: i64, flip: bool, out: &mut [f32]) {
    let width = row.len();
    let by = (right.unsigned_abs() as usize).min(width);
    let [first, last] = if flip { [row[width - 1], row[0]] } else { [row[0], row[width - 1]] };
    // The part that stays in the picture, and its new place.
    let (stays, gone, border) = if right >= 0 {
        let (gone, stays) = out.split_at_mut(by);
        (stays, gone, first)
    } else {
        let (stays, gone) = out.split_at_mut(width - by);
        (stays, gone, last)
    };
    gone.fill(f32::from(border));
    // Mirrored, the end that leaves the picture is the other one.
    let row = if (right >= 0) == flip { &row[by..] } else { &row[..width - by] };
    if flip {
        stays.iter_mut().zip(row.iter().rev()).for_each(|(to, from)| *to = f32::from(*from));
    } else {
        stays.iter_mut().zip(row).for_each(|(to, from)| *to = f32::from(*from));
    }
}

fn brighten(row: &mut [f32], factor: f32) {
    if factor != 1.0 {
        row.iter_mut().for_each(|x| *x = (*x * factor).min(255.0));
    }
}

impl Shadow {
    /// First column in the shade and the one after the last, at a height from 0 (top) to 1.
    fn columns(&self, down: f64, width: usize) -> (usize, usize) {
        let at = |i: usize| ((self.top[i] + (self.bottom[i] - self.top[i]) * down) * width as f64) as usize;
        let (a, b) = (at(0), at(1));
        (a.min(b), a.max(b))
    }
}

impl Rectangle {
    /// Left, right, top, bottom and value. A shape that is too tall becomes wider, one that is too wide is cut.
    fn pixels(&self, width: usize, height: usize) -> (usize, usize, usize, usize, u8) {
        let area = self.area * (width * height) as f64;
        let tall = ((area * self.ratio).sqrt().round() as usize).clamp(1, height);
        let wide = ((area / tall as f64).round() as usize).clamp(1, width);
        let left = ((width - wide) as f64 * self.at.0).round() as usize;
        let top = ((height - tall) as f64 * self.at.1).round() as usize;
        (left, left + wide, top, top + tall, self.value)
    }
}

#[cfg(test)]
mod tests;
