//! Weather, light and camera faults.
//!
//! All of it is off by default and then costs nothing. Light and weather are drawn by [`crate::camera`], and so is what
//! the graphics settings of real builds change: grain, verge, warmth and shadows. Latency and dropped frames are left to
//! the world. Whatever varies from frame to frame depends only on the run's seed and the
//! simulated time.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use lapwing_core::words::{did_you_mean, suggesting};

/// Weather, light, and what is wrong with the camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Conditions {
    /// Degrees of the sun above the horizon, 3 to 90; the track's own if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sun_height_deg: Option<f64>,
    /// Where the sun stands, degrees clockwise from +z, -360 to 360; the track's own if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sun_azimuth_deg: Option<f64>,
    /// Factor on all colours, 0.05 to 4.
    pub brightness: f64,
    /// Haze, 0 to 1: at 1 the visibility is about 60 m.
    pub haze: f64,
    /// Rain, 0 to 1: streaks, a grey sky, a darker road.
    pub rain: f64,
    /// Night, 0 to 1: at 1 only the headlights light the road.
    pub night: f64,
    /// Noise of the camera: standard deviation in grey levels, 0 to 100.
    pub noise: f64,
    /// Blur of the lens: standard deviation in pixels, 0 to 10.
    pub blur: f64,
    /// Grain of the road's surface, 0 to 2: 0 is smooth, 1 smeared along the way as the stock build draws it at its low
    /// settings, 2 as crisp as at its highest.
    pub grain: f64,
    /// How much lines and verge stand out from the asphalt, 0 to 2: 0 not at all, 1 as in the stock build, 2 twice as much.
    pub verge: f64,
    /// Tint of road and bonnet, -2 to 2: 0 is the stock build's at its low settings, -1 the bluer one at its high
    /// settings, 1 as much warmer.
    pub warmth: f64,
    /// How dark shadows are on the road, 0 to 1: 0 is none, 1 leaves no sunlight; the track's own if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shadows: Option<f64>,
    /// Delay before a command takes effect, in milliseconds, 0 to 5000.
    pub latency_ms: f64,
    /// Share of the frames that are never sent, 0 to less than 1.
    pub dropped: f64,
}

impl Default for Conditions {
    fn default() -> Self {
        Self {
            sun_height_deg: None,
            sun_azimuth_deg: None,
            brightness: 1.0,
            haze: 0.0,
            rain: 0.0,
            night: 0.0,
            noise: 0.0,
            blur: 0.0,
            grain: 1.0,
            verge: 1.0,
            warmth: 0.0,
            shadows: None,
            latency_ms: 0.0,
            dropped: 0.0,
        }
    }
}

/// Why a text cannot be read as conditions.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConditionsError {
    /// A piece that is not `name=number`.
    #[error("conditions: expected fair, random, name=number pairs (such as rain=0.5) or a file ending in .toml, got {got:?}{}", did_you_mean(got, NAMES.into_iter().chain(["fair", "random"])))]
    Form {
        /// The piece.
        got: String,
    },
    /// Not the TOML of conditions.
    #[error("conditions: {}", suggesting(&.0.to_string()))]
    Toml(#[from] toml::de::Error),
    /// A name that no condition has.
    #[error("conditions: expected one of {}, got {got:?}{}", NAMES.join(", "), did_you_mean(got, NAMES))]
    Unknown {
        /// The name.
        got: String,
    },
    /// A name that is given more than once.
    #[error("conditions: expected {name} once, got it twice: {got}")]
    Twice {
        /// The name.
        name: &'static str,
        /// The text.
        got: String,
    },
    /// A value that is not a number, or is out of range.
    #[error("conditions: {name}: expected {min} to {max}, got {got}")]
    Range {
        /// Which condition.
        name: &'static str,
        /// Smallest value.
        min: f64,
        /// Largest value.
        max: f64,
        /// The value given.
        got: String,
    },
}

/// How many conditions there are.
const COUNT: usize = 14;

const NAMES: [&str; COUNT] = [
    "sun_height_deg",
    "sun_azimuth_deg",
    "brightness",
    "haze",
    "rain",
    "night",
    "noise",
    "blur",
    "grain",
    "verge",
    "warmth",
    "shadows",
    "latency_ms",
    "dropped",
];

const RANGES: [(f64, f64); COUNT] = [
    (3.0, 90.0),
    (-360.0, 360.0),
    (0.05, 4.0),
    (0.0, 1.0),
    (0.0, 1.0),
    (0.0, 1.0),
    (0.0, 100.0),
    (0.0, 10.0),
    (0.0, 2.0),
    (0.0, 2.0),
    (-2.0, 2.0),
    (0.0, 1.0),
    (0.0, 5000.0),
    (0.0, 0.99),
];

impl Conditions {
    /// Reads `rain=0.5,night=1`; an empty text is the default.
    ///
    /// # Errors
    /// [`ConditionsError`], naming what was expected.
    pub fn parse(text: &str) -> Result<Self, ConditionsError> {
        let mut conditions = Self::default();
        let mut is_set = [false; COUNT];
        for piece in text.split(',').map(str::trim).filter(|piece| !piece.is_empty()) {
            let (name, number) =
                piece.split_once('=').ok_or_else(|| ConditionsError::Form { got: piece.to_owned() })?;
            let i = NAMES
                .iter()
                .position(|known| *known == name.trim())
                .ok_or_else(|| ConditionsError::Unknown { got: name.trim().to_owned() })?;
            if std::mem::replace(&mut is_set[i], true) {
                return Err(ConditionsError::Twice { name: NAMES[i], got: text.to_owned() });
            }
            let value = number.trim().parse().map_err(|_| out_of_range(i, number.trim()))?;
            conditions.set(i, value);
        }
        conditions.check()?;
        Ok(conditions)
    }

    /// Reads the TOML of a file.
    ///
    /// # Errors
    /// [`ConditionsError`], with line and column if the TOML is wrong.
    pub fn from_file(text: &str) -> Result<Self, ConditionsError> {
        let conditions: Self = toml::from_str(text)?;
        conditions.check()?;
        Ok(conditions)
    }

    /// Checks every number, as after reading a file.
    ///
    /// # Errors
    /// [`ConditionsError::Range`] for the first that is out of its range.
    pub fn check(&self) -> Result<(), ConditionsError> {
        for (i, value) in self.values().into_iter().enumerate() {
            let (min, max) = RANGES[i];
            if value.is_some_and(|value| !(min..=max).contains(&value)) {
                return Err(out_of_range(i, &format!("{:?}", value.unwrap_or_default())));
            }
        }
        Ok(())
    }

    /// Conditions to vary training data with: mild more often than harsh, different for each seed. Latency and dropped
    /// frames stay off, as they do not affect the picture.
    pub fn random(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut unit = || rng.random::<f64>();
        let mut conditions = Self {
            sun_height_deg: Some(12.0 + 60.0 * unit()),
            sun_azimuth_deg: Some(360.0 * unit()),
            brightness: 0.7 + 0.6 * unit(),
            noise: 4.0 * unit().powi(2),
            ..Self::default()
        };
        // Each of the others is on in only some of the runs.
        let mut sometimes = |share: f64, most: f64| {
            let (on, strength) = (unit() < share, unit());
            if on { most * strength } else { 0.0 }
        };
        conditions.haze = sometimes(0.35, 0.6);
        conditions.rain = sometimes(0.25, 0.9);
        conditions.night = sometimes(0.15, 0.9);
        conditions.blur = sometimes(0.25, 1.2);
        // The looks of several graphics settings, and what lies between and beyond them.
        let mut looks = |share: f64, (least, most): (f64, f64)| {
            let (on, part) = (unit() < share, unit());
            on.then_some(least + (most - least) * part)
        };
        conditions.grain = looks(0.6, (0.0, 2.0)).unwrap_or(1.0);
        conditions.verge = looks(0.5, (0.35, 1.8)).unwrap_or(1.0);
        conditions.warmth = looks(0.5, (-1.8, 1.2)).unwrap_or(0.0);
        conditions.shadows = looks(0.6, (0.0, 1.0));
        conditions
    }

    /// Every condition by name, with its smallest and largest value, and the one that fair weather has; the track's own
    /// sun has none.
    pub fn ranges() -> [(&'static str, f64, f64, Option<f64>); COUNT] {
        let fair = Self::default().values();
        std::array::from_fn(|i| (NAMES[i], RANGES[i].0, RANGES[i].1, fair[i]))
    }

    /// Whether a run's seed changes anything under these conditions: only rain, noise and dropped frames are random.
    pub fn left_to_chance(&self) -> bool {
        self.rain > 0.0 || self.noise > 0.0 || self.dropped > 0.0
    }

    fn values(&self) -> [Option<f64>; COUNT] {
        [
            self.sun_height_deg,
            self.sun_azimuth_deg,
            Some(self.brightness),
            Some(self.haze),
            Some(self.rain),
            Some(self.night),
            Some(self.noise),
            Some(self.blur),
            Some(self.grain),
            Some(self.verge),
            Some(self.warmth),
            self.shadows,
            Some(self.latency_ms),
            Some(self.dropped),
        ]
    }

    fn set(&mut self, i: usize, value: f64) {
        match i {
            0 => self.sun_height_deg = Some(value),
            1 => self.sun_azimuth_deg = Some(value),
            2 => self.brightness = value,
            3 => self.haze = value,
            4 => self.rain = value,
            5 => self.night = value,
            6 => self.noise = value,
            7 => self.blur = value,
            8 => self.grain = value,
            9 => self.verge = value,
            10 => self.warmth = value,
            11 => self.shadows = Some(value),
            12 => self.latency_ms = value,
            _ => self.dropped = value,
        }
    }
}

fn out_of_range(i: usize, got: &str) -> ConditionsError {
    ConditionsError::Range { name: NAMES[i], min: RANGES[i].0, max: RANGES[i].1, got: got.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_of_names_and_numbers_is_read() {
        let read = Conditions::parse(" rain=0.5, night=1,sun_height_deg=12.5 ").unwrap();
        let expected = Conditions { rain: 0.5, night: 1.0, sun_height_deg: Some(12.5), ..Conditions::default() };
        assert_eq!(read, expected);
        assert_eq!(Conditions::parse("").unwrap(), Conditions::default());
    }

    #[test]
    fn what_is_wrong_is_said() {
        for (text, message) in [
            (
                "rain",
                "conditions: expected fair, random, name=number pairs (such as rain=0.5) or a file ending in .toml, got \"rain\"",
            ),
            ("rain=2", "conditions: rain: expected 0 to 1, got 2.0"),
            ("grain=2.5", "conditions: grain: expected 0 to 2, got 2.5"),
            ("verge=-0.1", "conditions: verge: expected 0 to 2, got -0.1"),
            ("warmth=-3", "conditions: warmth: expected -2 to 2, got -3.0"),
            ("shadows=1.1", "conditions: shadows: expected 0 to 1, got 1.1"),
            ("haze=NaN", "conditions: haze: expected 0 to 1, got NaN"),
            ("dropped=much", "conditions: dropped: expected 0 to 0.99, got much"),
        ] {
            assert_eq!(Conditions::parse(text).unwrap_err().to_string(), message);
        }
        let unknown = Conditions::parse("snow=1").unwrap_err().to_string();
        assert!(unknown.contains("sun_azimuth_deg") && unknown.ends_with("got \"snow\""), "{unknown}");
    }

    #[test]
    fn every_random_condition_is_a_valid_one_and_the_same_for_the_same_seed() {
        for seed in 0..200 {
            Conditions::random(seed).check().unwrap();
            assert_eq!(Conditions::random(seed), Conditions::random(seed));
            assert_ne!(Conditions::random(seed), Conditions::random(seed + 1));
        }
    }

    #[test]
    fn every_name_sets_the_value_that_is_checked_under_it() {
        for (i, (name, min, max, _)) in Conditions::ranges().into_iter().enumerate() {
            for value in [min, max] {
                let read = Conditions::parse(&format!("{name}={value}")).unwrap();
                assert_eq!(read.values()[i], Some(value), "{name}");
                let others = |conditions: &Conditions| {
                    let mut values = conditions.values();
                    values[i] = None;
                    values
                };
                assert_eq!(others(&read), others(&Conditions::default()), "{name} changes nothing else");
            }
        }
    }

    #[test]
    fn random_looks_reach_beyond_the_real_settings_each_in_some_of_the_runs() {
        let all: Vec<Conditions> = (0..400).map(Conditions::random).collect();
        let share = |of: &dyn Fn(&Conditions) -> bool| all.iter().filter(|c| of(c)).count() as f64 / all.len() as f64;
        // As in the recordings of high graphics settings, and beyond; as in the others; smoother or warmer than any.
        type Look<'a> = (&'a str, &'a dyn Fn(&Conditions) -> bool);
        let looks: [Look<'_>; 11] = [
            ("stock grain", &|c| c.grain == 1.0),
            ("crisp", &|c| c.grain > 1.6),
            ("smooth", &|c| c.grain < 0.4),
            ("stock verge", &|c| c.verge == 1.0),
            ("faint", &|c| c.verge < 0.7),
            ("strong", &|c| c.verge > 1.4),
            ("stock tint", &|c| c.warmth == 0.0),
            ("bluer", &|c| c.warmth < -1.0),
            ("warmer", &|c| c.warmth > 0.4),
            ("the track's own shadows", &|c| c.shadows.is_none()),
            ("faint shadows", &|c| c.shadows.is_some_and(|dark| dark < 0.5)),
        ];
        for (look, of) in looks {
            assert!((0.08..0.6).contains(&share(of)), "{look}: {}", share(of));
        }
        assert!(share(&|c| c.shadows.is_some_and(|dark| dark > 0.5)) > 0.2);
        let plain = share(&|c| (c.grain, c.verge, c.warmth, c.shadows) == (1.0, 1.0, 0.0, None));
        assert!(plain > 0.01, "some runs look as the stock build: {plain}");
    }

    #[test]
    fn a_file_may_leave_out_what_is_off() {
        assert_eq!(
            toml::from_str::<Conditions>("rain = 0.25").unwrap(),
            Conditions { rain: 0.25, ..Default::default() }
        );
        assert!(toml::from_str::<Conditions>("snow = 1").is_err());
        let conditions = Conditions::random(3);
        assert_eq!(toml::from_str::<Conditions>(&toml::to_string(&conditions).unwrap()).unwrap(), conditions);
    }
}
