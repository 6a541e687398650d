//! What makes a good pilot a bad one: defined handicaps, the same on every machine, of what it sees and of what it steers.

use lapwing_core::{
    perception::Frame,
    pilot::{Pilot, PilotError, Prediction, View},
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Seed of the noise.
const SEED: u64 = 20_161_121;
/// The noise forgets within this many frames: two thirds of a second.
const NOISE_FRAMES: f64 = 10.0;

/// What is wrong with the pictures that a pilot is shown. Each is a mistake that has been made with real networks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sight {
    /// Nothing.
    Clear,
    /// Blue for red, as OpenCV reads pictures.
    Bgr,
    /// Left for right, with the steering left as it is.
    Mirrored,
    /// Moved down by so many rows, or up: what a crop of other rows shows. The last row there is fills the rest.
    Moved(isize),
}

/// What is wrong with a pilot.
#[derive(Debug, Clone, Copy)]
pub struct Handicap {
    /// How it sees.
    pub sight: Sight,
    /// It steers this share of what it wants to.
    pub gain: f64,
    /// And adds this.
    pub bias: f64,
    /// It steers what it wanted so many frames ago.
    pub late: usize,
    /// Standard deviation of an Ornstein-Uhlenbeck process that is added, in normalised steering.
    pub noise: f64,
}

/// Nothing is wrong with it.
pub const NONE: Handicap = Handicap { sight: Sight::Clear, gain: 1.0, bias: 0.0, late: 0, noise: 0.0 };

/// Negative controls: mistakes in what a network is fed, and an answer that is 0.8 s late at the stock recorder's 15 Hz.
pub const CONTROLS: [(&str, Handicap); 5] = [
    ("BGR for RGB", Handicap { sight: Sight::Bgr, ..NONE }),
    ("mirrored", Handicap { sight: Sight::Mirrored, ..NONE }),
    ("cropped 30 rows too high", Handicap { sight: Sight::Moved(30), ..NONE }),
    ("cropped 20 rows too low", Handicap { sight: Sight::Moved(-20), ..NONE }),
    ("0.8 s late", Handicap { late: 12, ..NONE }),
];

impl Handicap {
    /// The same pilot with this handicap.
    pub fn of(self, pilot: Box<dyn Pilot>) -> Box<dyn Pilot> {
        let random = ChaCha8Rng::seed_from_u64(SEED);
        Box::new(Handicapped { pilot, handicap: self, seen: Frame::default(), wanted: vec![], random, noise: 0.0 })
    }
}

impl Sight {
    /// Paints what is seen of a picture.
    fn paint(self, picture: &Frame, seen: &mut Frame) {
        let (width, height) = (picture.width(), picture.height());
        seen.clone_from(picture);
        match self {
            Self::Clear => {}
            Self::Bgr => seen.rgb_mut().chunks_exact_mut(3).for_each(|pixel| pixel.swap(0, 2)),
            Self::Mirrored => {
                for row in seen.rgb_mut().chunks_exact_mut(3 * width) {
                    for x in 0..width / 2 {
                        let (left, right) = row.split_at_mut(3 * (width - 1 - x));
                        left[3 * x..3 * x + 3].swap_with_slice(&mut right[..3]);
                    }
                }
            }
            Self::Moved(down) => {
                for (y, row) in seen.rgb_mut().chunks_exact_mut(3 * width).enumerate() {
                    let from = y.saturating_add_signed(-down).min(height - 1);
                    row.copy_from_slice(&picture.rgb()[3 * width * from..3 * width * (from + 1)]);
                }
            }
        }
    }
}

/// A pilot with a handicap.
struct Handicapped {
    pilot: Box<dyn Pilot>,
    handicap: Handicap,
    seen: Frame,
    wanted: Vec<f64>,
    random: ChaCha8Rng,
    noise: f64,
}

impl Handicapped {
    /// From -1 to 1.
    fn uniform(&mut self) -> f64 {
        f64::from(self.random.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0
    }
}

impl Pilot for Handicapped {
    fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError> {
        let Handicap { sight, gain, bias, late, noise } = self.handicap;
        let prediction = if sight == Sight::Clear {
            self.pilot.steer(view)?
        } else {
            sight.paint(view.frame, &mut self.seen);
            self.pilot.steer(&View { frame: &self.seen, ..*view })?
        };
        self.wanted.push(prediction.steering);
        let then = self.wanted.len().saturating_sub(1 + late);
        let keep = (-1.0 / NOISE_FRAMES).exp();
        // The sum of three uniforms has a standard deviation of 1.
        let shock = self.uniform() + self.uniform() + self.uniform();
        self.noise = keep * self.noise + noise * (1.0 - keep * keep).sqrt() * shock;
        Ok(Prediction { steering: gain * self.wanted[then] + bias + self.noise, ..prediction })
    }

    fn reset(&mut self) {
        self.pilot.reset();
        (self.wanted, self.noise) = (vec![], 0.0);
        self.random = ChaCha8Rng::seed_from_u64(SEED);
    }
}
