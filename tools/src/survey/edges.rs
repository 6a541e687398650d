//! Finds the road's edges in a row of a picture.
//!
//! The same detector is used for real and for rendered pictures, so that its bias cancels out when the two are
//! compared. JPEG stores colour at half the resolution, so colour shows that there is a line, and brightness shows
//! where.

use lapwing_core::perception::Frame;
use lapwing_sim::track::Theme;

/// Columns at which the left and the right edge were found in a row.
pub type Edges = [Option<f64>; 2];

/// Tells a road from its sides.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Detector {
    theme: Theme,
}

/// Anything warmer than the road by this, out of 255, is not road. Asphalt stays within 5 of its own mean.
const WARMER: f64 = 11.0;
/// Anything brighter or darker than the road by this much, out of 255, over [`BANK_COLUMNS`] and not red, is the bank
/// beside it: the line before it was missed. Lines and their strip are narrower, kerbs are red.
const BANK: std::ops::Range<f64> = -30.0..40.0;
const BANK_COLUMNS: usize = 7;
/// Bridge walls are darker than this part of the paving's brightness.
const WALL: f64 = 0.35;
/// Red over blue of the bridge's paving; asphalt has 12 to 20, paving 32 to 42.
const PAVED: f64 = 26.0;

impl Detector {
    /// A detector for pictures of that landscape.
    pub const fn new(theme: Theme) -> Self {
        Self { theme }
    }

    /// Whether the ground just ahead is the bridge's paving.
    pub fn paved(self, frame: &Frame) -> bool {
        let [r, _, b] = mean(frame, 110..210, 108..124);
        self.theme == Theme::Lake && r - b > PAVED
    }

    /// The edges in each of `rows`: the middle of the inner yellow line, of the right white one, the
    /// beginning of dirt, leaves or of a bridge's wall.
    pub fn find(self, frame: &Frame, rows: &[usize]) -> Vec<Edges> {
        let paved = self.paved(frame);
        rows.iter()
            .map(|&row| {
                let row = Scanline::read(frame, row);
                match self.theme {
                    Theme::Lake | Theme::Mountain if paved => [row.wall(-1), row.wall(1)],
                    Theme::Lake | Theme::Mountain => [row.line(-1), row.line(1)],
                    Theme::Jungle => [None, row.white_before_green()],
                }
            })
            .collect()
    }
}

/// Mean colour of a rectangle.
fn mean(frame: &Frame, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> [f64; 3] {
    let mut sum = [0.0; 3];
    let mut count = 0.0_f64;
    for pixel in rows.flat_map(|y| columns.clone().filter_map(move |x| frame.pixel(x, y))) {
        count += 1.0;
        for (sum, value) in sum.iter_mut().zip(pixel) {
            *sum += f64::from(value);
        }
    }
    sum.map(|s| s / count.max(1.0))
}

/// One row, as wide as the picture.
struct Scanline {
    /// How yellow, red or brown: the warm channels over blue.
    warmth: Vec<f64>,
    /// Brightness, a little smoothed along and across.
    light: Vec<f64>,
    /// Red over green.
    red: Vec<f64>,
    /// Green over blue.
    green: Vec<f64>,
}

impl Scanline {
    fn read(frame: &Frame, y: usize) -> Self {
        let gain = 125.0 / light(mean(frame, 110..210, 100..130)).max(20.0);
        let gain = if gain > 1.4 { gain } else { 1.0 }; // dark pictures only
        let at = |x: usize, y: usize| frame.pixel(x, y).unwrap_or_default().map(|v| (f64::from(v) * gain).min(255.0));
        let here: Vec<[f64; 3]> = (0..frame.width()).map(|x| at(x, y)).collect();
        let across = (0..frame.width())
            .map(|x| (light(at(x, y.saturating_sub(1))) + 2.0 * light(here[x]) + light(at(x, y + 1))) / 4.0)
            .collect::<Vec<_>>();
        let warmth = here.iter().map(|[r, g, b]| f64::max((r + g) / 2.0 - b, r - b)).collect::<Vec<_>>();
        let red = here.iter().map(|[r, g, _]| r - g).collect();
        let green = here.iter().map(|[_, g, b]| g - b).collect();
        Self { warmth: smooth(&warmth), light: smooth(&across), red, green }
    }

    /// Warmth and light from the picture's middle outward, over the road's own.
    fn outward(&self, side: i32) -> (Vec<f64>, Vec<f64>, f64) {
        let middle = self.warmth.len() / 2;
        let around = middle.saturating_sub(40)..(middle + 40).min(self.warmth.len());
        let (warm, bright) = (median(&self.warmth[around.clone()]), median(&self.light[around]));
        let columns: Vec<usize> =
            if side < 0 { (0..=middle).rev().collect() } else { (middle..self.warmth.len()).collect() };
        let warmth = columns.iter().map(|&x| self.warmth[x] - warm).collect();
        (warmth, columns.iter().map(|&x| self.light[x] - bright).collect(), bright)
    }

    fn column(&self, side: i32, steps: f64) -> f64 {
        (self.warmth.len() / 2) as f64 + f64::from(side) * steps + 0.5
    }

    /// Columns outward to the bank, which is not road.
    fn bank(&self, side: i32, light: &[f64]) -> usize {
        let middle = (self.red.len() / 2) as isize;
        let red = |i: usize| self.red.get((middle + side as isize * i as isize) as usize).copied().unwrap_or(0.0);
        let bank: Vec<bool> = light.iter().enumerate().map(|(i, l)| !BANK.contains(l) && red(i) < 12.0).collect();
        bank.windows(BANK_COLUMNS).position(|w| w.iter().all(|&b| b)).unwrap_or(light.len())
    }

    /// The middle of the first warm line before the bank; if none stands out, the place where the ground reaches half
    /// its final warmth.
    fn line(&self, side: i32) -> Option<f64> {
        let (warmth, light, _) = self.outward(side);
        let bank = self.bank(side, &light);
        let onset = warmth.windows(3).position(|w| w.iter().all(|&w| w > WARMER))?;
        let signal: Vec<f64> = warmth.iter().zip(&light).map(|(w, l)| w + 0.7 * l).collect();
        let top = (onset.max(1)..(onset + 26).min(signal.len() - 1)).find(|&i| {
            let falls_to = signal[i..(i + 9).min(signal.len())].iter().fold(f64::INFINITY, |a, &b| a.min(b));
            signal[i] >= signal[i - 1] && signal[i] > signal[i + 1] && signal[i] > 20.0 && signal[i] - falls_to > 12.0
        });
        if let Some(i) = top {
            let (before, after) = (signal[i - 1], signal[i + 1]);
            let bend = before - 2.0 * signal[i] + after;
            let within = if bend < 0.0 { 0.5 * (before - after) / bend } else { 0.0 };
            return (i <= bank + 2).then(|| self.column(side, i as f64 + within));
        }
        let ahead = &warmth[onset..(onset + 14).min(warmth.len())];
        let half = (ahead.iter().fold(0.0, |a: f64, &b| a.max(b)) / 2.0).max(WARMER);
        let crossing = onset + ahead.iter().position(|&w| w >= half)?;
        (crossing > 0 && crossing <= bank + 2).then(|| self.column(side, crossing as f64 - 0.5))
    }

    /// Where the wall of a bridge begins.
    fn wall(&self, side: i32) -> Option<f64> {
        let (_, light, road) = self.outward(side);
        let dark = light.windows(3).position(|w| w.iter().all(|&l| l + road < WALL * road))?;
        Some(self.column(side, dark as f64))
    }

    /// The middle of the first white ridge right of the picture's middle that has grass behind it.
    fn white_before_green(&self) -> Option<f64> {
        let n = self.light.len();
        let ridge = |x: usize| self.light[x] - self.light[x - 7].max(self.light[x + 7]);
        let greener = |x: usize| {
            let mean = |r: std::ops::Range<usize>| self.green[r.clone()].iter().sum::<f64>() / r.len().max(1) as f64;
            mean((x + 8).min(n - 1)..(x + 22).min(n)) > mean(x - 22..x - 8) + 12.0
        };
        (n / 2 + 5..n.checked_sub(8)?)
            .find(|&x| ridge(x) > 12.0 && ridge(x) >= ridge(x - 1) && ridge(x) >= ridge(x + 1).min(255.0) && greener(x))
            .map(|x| x as f64 + 0.5)
    }
}

fn light([r, g, b]: [f64; 3]) -> f64 {
    (r + g + b) / 3.0
}

/// Means of three neighbours.
fn smooth(values: &[f64]) -> Vec<f64> {
    let n = values.len();
    (0..n).map(|i| (values[i.saturating_sub(1)] + values[i] + values[(i + 1).min(n - 1)]) / 3.0).collect()
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ASPHALT: [u8; 3] = [131, 131, 116];

    fn painted(colour: impl Fn(usize) -> [u8; 3]) -> Frame {
        let rgb = (0..160).flat_map(|_| (0..320).flat_map(&colour).collect::<Vec<_>>()).collect();
        Frame::new(320, 160, rgb).unwrap()
    }

    fn close(found: Edges, expected: [f64; 2]) {
        for (found, expected) in found.into_iter().zip(expected) {
            let found = found.expect("an edge");
            assert!((found - expected).abs() <= 1.0, "found {found}, expected {expected}");
        }
    }

    #[test]
    fn yellow_lines_are_found_in_their_middle() {
        let frame = painted(|x| match x {
            60..=63 | 250..=253 => [195, 185, 100],
            50..60 | 254..264 => [85, 75, 55],
            _ => ASPHALT,
        });
        close(Detector::new(Theme::Lake).find(&frame, &[100])[0], [62.0, 252.0]);
    }

    #[test]
    fn dirt_and_kerbs_are_found_where_they_begin() {
        let frame = painted(|x| match x {
            0..40 => [240, 197, 175],
            230.. => [214, 179, 128],
            _ => ASPHALT,
        });
        close(Detector::new(Theme::Lake).find(&frame, &[100])[0], [40.0, 230.0]);
    }

    #[test]
    fn walls_are_found_on_paving_only() {
        let frame = painted(|x| if (30..280).contains(&x) { [199, 182, 158] } else { [4, 12, 15] });
        assert!(Detector::new(Theme::Lake).paved(&frame));
        close(Detector::new(Theme::Lake).find(&frame, &[100])[0], [29.0, 281.0]);
        assert!(!Detector::new(Theme::Lake).paved(&painted(|_| ASPHALT)));
    }

    #[test]
    fn a_road_without_edges_has_none() {
        assert_eq!(Detector::new(Theme::Lake).find(&painted(|_| ASPHALT), &[90]), [[None, None]]);
    }

    #[test]
    fn the_jungles_white_line_is_the_one_before_the_grass() {
        let frame = painted(|x| match x {
            170..=173 | 240..=243 => [220, 220, 215],
            244.. => [90, 110, 50],
            _ => [127, 128, 126],
        });
        let [left, right] = Detector::new(Theme::Jungle).find(&frame, &[100])[0];
        assert!(left.is_none() && (right.unwrap() - 242.0).abs() <= 2.0, "{right:?}");
    }
}
