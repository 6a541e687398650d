//! The recipe: one TOML file with everything that decides how a network is trained. The checkpoint keeps it.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::{ClosedLoop, TrainError};
use crate::{
    dataset::{Augmentation, Balance, Blocks, Selection},
    nn::{Precision, resnet::STAGES},
};
use lapwing_core::perception::Resize;

/// A complete training. The defaults are Lu's: L2 loss, Adam 1e-3, batch 64, 20 epochs, all five augmentations.
///
/// ```
/// let recipe = lapwing_learn::train::Recipe::parse(r#"
///     network = "pilotnet"
///     epochs = 8
///     [[data]]
///     path = "data/lake"
///     side_offset = 0.15
/// "#)?;
/// assert_eq!((recipe.batch, recipe.data[0].weight), (64, 1.0));
/// # Ok::<(), lapwing_learn::train::TrainError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Recipe {
    /// Architecture, by name; default `pilotnet`.
    pub network: String,
    /// Rows and columns of the input, for networks that take any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub input: Option<(usize, usize)>,
    /// Rows of a 320x160 picture that the network sees, from the first to before the second; default those of its authors
    /// ([`Architecture::default_preprocess`](crate::nn::Architecture::default_preprocess)).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub crop: Option<(usize, usize)>,
    /// Whether the network gets the speed as an input.
    pub speed_input: bool,
    /// Initial weights: those of a backbone, under torchvision's names, or a checkpoint of this crate (`.safetensors`);
    /// [`load_pretrained`](crate::nn::load_pretrained) says what is used of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pretrained: Option<PathBuf>,
    /// Whether the backbone stays as in `pretrained`, including running statistics, and only the layers after it learn;
    /// default false.
    pub freeze_backbone: bool,
    /// The same for part of the backbone: its first convolution and so many of its four stages, from the first; default 0,
    /// none of it. With 3, a step of a ResNet50 takes about half as long.
    pub freeze_stages: usize,
    /// Passes over the data; default 20.
    pub epochs: usize,
    /// Samples in a step; default 64. The last step of an epoch has the rest; but if a ResNet's batch norm would have
    /// only a single sample, that sample is left out of the epoch.
    pub batch: usize,
    /// Samples in a pass; default all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples_per_epoch: Option<usize>,
    /// Held-out samples to measure after each pass, at equal distances; default all of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub validation_samples: Option<usize>,
    /// Seed of everything random; default 0.
    pub seed: u64,
    /// Numbers of the forward and backward pass. bf16 takes about half the time if the processor supports it (AVX512
    /// BF16, AMX), and many times as long if it does not. Weights are updated in f32 in either case.
    pub precision: Precision,
    /// Pictures laid out channel by channel (false) or pixel by pixel (true, the default: faster in most networks).
    pub channels_last: bool,
    /// Which checkpoint to keep: the one with the least validation error, or the last.
    pub keep: Keep,
    /// Passes without a better validation error after which training ends; default never.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patience: Option<usize>,
    /// Decay of a running average over the weights, above 0 and below 1, such as 0.999; the average is then what is
    /// measured and saved. Default none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ema: Option<f64>,
    /// How weights are stored.
    pub stored: Precision,
    /// Memory for decoded pictures, in MiB; default 1024.
    pub cache_mib: usize,
    /// Blocks of rows that are held out for validation. Default 50 rows of each 250. If there is `validation`, none
    /// are, and all of `data` is used for training.
    pub blocks: Blocks,
    /// How weights are updated.
    pub optimiser: Optimiser,
    /// Compensation for the many rows in which nobody steers.
    pub balance: Balance,
    /// How pictures are changed.
    pub augment: Augmentation,
    /// Data to train on.
    pub data: Vec<Selection>,
    /// Data to validate on, all of it; default the blocks held out of `data`.
    pub validation: Vec<Selection>,
    /// Simulated data that is recorded first if its folder does not exist.
    pub record: Vec<SimulatedData>,
    /// Rounds in which the network drives and learns from what it saw, after the training; default none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub closed_loop: Option<ClosedLoop>,
}

impl Default for Recipe {
    fn default() -> Self {
        Self {
            network: "pilotnet".into(),
            input: None,
            crop: None,
            speed_input: false,
            pretrained: None,
            freeze_backbone: false,
            freeze_stages: 0,
            epochs: 20,
            batch: 64,
            samples_per_epoch: None,
            validation_samples: None,
            seed: 0,
            precision: Precision::F32,
            channels_last: true,
            keep: Keep::Best,
            patience: None,
            ema: None,
            stored: Precision::F32,
            cache_mib: 1024,
            blocks: Blocks::default(),
            optimiser: Optimiser::default(),
            balance: Balance::default(),
            augment: Augmentation::default(),
            data: vec![],
            validation: vec![],
            record: vec![],
            closed_loop: None,
        }
    }
}

/// Which checkpoint stays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Keep {
    /// That of the least validation error.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    Best,
    /// The last.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    Last,
}

/// How weights are updated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Optimiser {
    /// Adam or SGD with momentum.
    pub kind: OptimiserKind,
    /// Step width at the beginning; default 1e-3.
    pub learning_rate: f64,
    /// How it changes.
    pub schedule: Schedule,
    /// L2 penalty: added to the gradient, times the weight, in SGD; taken off the weight itself in Adam (AdamW).
    /// Default 0.
    pub weight_decay: f64,
    /// SGD's momentum; default 0.9.
    pub momentum: f64,
    /// Largest norm of the gradient of all weights; default none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clip: Option<f64>,
}

impl Default for Optimiser {
    fn default() -> Self {
        Self {
            kind: OptimiserKind::Adam,
            learning_rate: 1e-3,
            schedule: Schedule::Constant,
            weight_decay: 0.0,
            momentum: 0.9,
            clip: None,
        }
    }
}

/// Kinds of optimiser.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum OptimiserKind {
    /// Kingma and Ba, 2014, with 0.9, 0.999 and 1e-8; its weight decay is Loshchilov and Hutter's, 2017.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    Adam,
    /// Stochastic gradient descent with momentum, as PyTorch's.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    Sgd,
}

/// How the learning rate changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Schedule {
    /// Not at all.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    Constant,
    /// Half a cosine to zero at the last step.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    Cosine,
    /// A tenth after each three passes without a better validation error.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    Plateau,
}

impl Schedule {
    /// What the learning rate is multiplied with when a share of the training is done; `on_plateau` is how far it has fallen
    /// for want of better validation errors.
    pub(crate) fn factor(self, done: f64, on_plateau: f64) -> f64 {
        match self {
            Self::Constant => 1.0,
            Self::Cosine => (1.0 + (std::f64::consts::PI * done).cos()) / 2.0,
            Self::Plateau => on_plateau,
        }
    }
}

/// Simulated data, as `lapwing record` makes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedData {
    /// Folder; if it exists, nothing is recorded.
    pub out: PathBuf,
    /// Track, as for `--track`.
    pub track: String,
    /// Laps to drive; default 1.
    #[serde(default = "one_lap")]
    pub laps: u32,
    /// mph; default 20.
    #[serde(default = "twenty")]
    pub speed: f64,
    /// Seed; default 0.
    #[serde(default)]
    pub seed: u64,
    /// With disturbed starts and steering noise; default true.
    #[serde(default = "yes")]
    pub recovery: bool,
    /// As for `--conditions`; default none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub conditions: Option<String>,
    /// Instead of a drive, this many pictures of a car that stands anywhere on the road, anyhow: as `--stances`. Default: a
    /// drive.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stances: Option<u64>,
}

fn one_lap() -> u32 {
    1
}

fn twenty() -> f64 {
    20.0
}

fn yes() -> bool {
    true
}

impl Recipe {
    /// Reads TOML.
    ///
    /// # Errors
    /// [`TrainError::Recipe`] with line and column.
    pub fn parse(text: &str) -> Result<Self, TrainError> {
        toml::from_str(text).map_err(|why| TrainError::Recipe(why.to_string()))
    }

    /// How many stages of a ResNet's backbone stay as in `pretrained`: all of them with `freeze_backbone`.
    pub(super) fn frozen_stages(&self) -> usize {
        if self.freeze_backbone { STAGES } else { self.freeze_stages }
    }

    /// Checks what can be checked without data.
    ///
    /// # Errors
    /// [`TrainError::Setting`], [`TrainError::Dataset`].
    pub fn check(&self) -> Result<(), TrainError> {
        let wrong = |name, expected, got: String| Err(TrainError::Setting { name, expected, got });
        if self.data.is_empty() {
            return wrong("data", "at least one data set", "none".into());
        }
        let whole = [
            ("epochs", self.epochs, 1..=100_000, "1 to 100000"),
            ("batch", self.batch, 1..=65_536, "1 to 65536"),
            ("samples_per_epoch", self.samples_per_epoch.unwrap_or(1), 1..=100_000_000, "1 to 100000000"),
            ("validation_samples", self.validation_samples.unwrap_or(2), 2..=usize::MAX, "at least 2"),
            ("patience", self.patience.unwrap_or(1), 1..=usize::MAX, "at least 1"),
            ("cache_mib", self.cache_mib, 0..=1 << 20, "0 to 1048576"),
            ("augment.translate_x_px", self.augment.translate_x_px as usize, 0..=320, "0 to 320, a picture's width"),
            ("augment.translate_y_px", self.augment.translate_y_px as usize, 0..=160, "0 to 160, a picture's height"),
        ];
        for (name, number, range, expected) in whole {
            if !range.contains(&number) {
                return wrong(name, expected, number.to_string());
            }
        }
        let sides = 1..=Resize::MAX_SIDE;
        if let Some((rows, columns)) = self.input.filter(|(h, w)| !sides.contains(h) || !sides.contains(w)) {
            return wrong("input", "1 to 4096 rows and columns", format!("{rows}x{columns}"));
        }
        if let Some((top, bottom)) = self.crop.filter(|(top, bottom)| top >= bottom || *bottom > 160) {
            return wrong("crop", "two rows of 0 to 160, the first one above the second", format!("{top}, {bottom}"));
        }
        // What TOML can hold.
        let practice = self.closed_loop.iter().flat_map(|closed_loop| &closed_loop.drive).map(|drive| drive.seed);
        let seeds = self.record.iter().map(|record| record.seed).chain(practice).chain([self.seed]);
        if let Some(seed) = seeds.into_iter().find(|seed| i64::try_from(*seed).is_err()) {
            return wrong("seed", "0 to 9223372036854775807", seed.to_string());
        }
        if let Some(share) = self.ema.filter(|share| !(*share > 0.0 && *share < 1.0)) {
            return wrong("ema", "above 0, below 1", share.to_string());
        }
        if self.freeze_stages > STAGES {
            return wrong("freeze_stages", "0 to 4", self.freeze_stages.to_string());
        }
        if self.frozen_stages() > 0 && self.pretrained.is_none() {
            let name = if self.freeze_backbone { "freeze_backbone" } else { "freeze_stages" };
            return wrong(name, "pretrained weights that stay", "none".into());
        }
        for record in &self.record {
            if record.stances == Some(0) {
                return wrong("record.stances", "at least 1", "0".into());
            }
            if record.laps == 0 {
                return wrong("record.laps", "at least 1", "0".into());
            }
            if !(record.speed > 0.0 && record.speed <= 200.0) {
                return wrong("record.speed", "a number of mph above 0, at most 200", record.speed.to_string());
            }
        }
        let o = &self.optimiser;
        if !(o.learning_rate > 0.0 && o.learning_rate <= 100.0) {
            return wrong("learning_rate", "a number above 0, at most 100", o.learning_rate.to_string());
        }
        if !(0.0..=1.0).contains(&o.weight_decay) {
            return wrong("weight_decay", "0 to 1", o.weight_decay.to_string());
        }
        if !(0.0..1.0).contains(&o.momentum) {
            return wrong("momentum", "0 to below 1", o.momentum.to_string());
        }
        if let Some(clip) = o.clip.filter(|clip| !(clip.is_finite() && *clip > 0.0)) {
            return wrong("clip", "a number above 0", clip.to_string());
        }
        self.data.iter().chain(&self.validation).try_for_each(Selection::check)?;
        self.closed_loop.as_ref().map_or(Ok(()), ClosedLoop::check)?;
        if self.validation.is_empty() {
            self.blocks.check(["blocks.size", "blocks.every"])?;
        }
        self.balance.check()?;
        Ok(self.augment.check()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_lus() {
        let recipe = Recipe::parse("[[data]]\npath = \"x\"").unwrap();
        recipe.check().unwrap();
        assert_eq!((recipe.epochs, recipe.batch, recipe.optimiser.learning_rate), (20, 64, 1e-3));
        assert_eq!((recipe.data[0].side_offset, recipe.augment.translate_x_px), (0.25, 60));
    }

    #[test]
    fn a_recipe_reads_back_as_it_was_written() {
        let mut recipe = Recipe::parse("ema = 0.99\n[[data]]\npath = \"x\"\nrows = [0, 2000]").unwrap();
        recipe.record.push(SimulatedData {
            out: "y".into(),
            track: "lake".into(),
            laps: 2,
            speed: 30.0,
            seed: 1,
            recovery: true,
            conditions: None,
            stances: None,
        });
        assert_eq!(Recipe::parse(&toml::to_string(&recipe).unwrap()).unwrap(), recipe);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let error = |text: &str| match Recipe::parse(text) {
            Ok(recipe) => recipe.check().unwrap_err().to_string(),
            Err(error) => error.to_string(),
        };
        assert_eq!(error(""), "data: expected at least one data set, got none");
        assert!(error("epoch = 3").contains("unknown field `epoch`"));
        let data = "[[data]]\npath = \"x\"\n";
        assert!(error(&format!("{data}[optimiser]\nlearning_rate = -1")).starts_with("learning_rate: expected"));
        assert!(error(&format!("batch = 0\n{data}")).starts_with("batch: expected 1 to 65536, got 0"));
        assert!(error(&format!("{data}[augment]\nflip = 2")).starts_with("flip: expected a probability"));
        for (text, expected) in [
            ("epochs = 9223372036854775807", "epochs: expected 1 to 100000, got 9223372036854775807"),
            ("samples_per_epoch = 900000000000", "samples_per_epoch: expected 1 to 100000000, got 900000000000"),
            ("cache_mib = 17592186044416", "cache_mib: expected 0 to 1048576, got 17592186044416"),
            ("input = [0, 64]", "input: expected 1 to 4096 rows and columns, got 0x64"),
            ("crop = [96, 96]", "crop: expected two rows of 0 to 160, the first one above the second, got 96, 96"),
            ("patience = 0", "patience: expected at least 1, got 0"),
            ("validation_samples = 1", "validation_samples: expected at least 2, got 1"),
            ("ema = 0.0", "ema: expected above 0, below 1, got 0"),
            ("ema = nan", "ema: expected above 0, below 1, got NaN"),
            ("freeze_backbone = true", "freeze_backbone: expected pretrained weights that stay, got none"),
            ("freeze_stages = 3", "freeze_stages: expected pretrained weights that stay, got none"),
            ("freeze_stages = 5", "freeze_stages: expected 0 to 4, got 5"),
            (
                "[augment]\ntranslate_x_px = 4000000000",
                "augment.translate_x_px: expected 0 to 320, a picture's width, got 4000000000",
            ),
            ("[optimiser]\nclip = nan", "clip: expected a number above 0, got NaN"),
            ("[[record]]\nout = \"y\"\ntrack = \"lake\"\nlaps = 0", "record.laps: expected at least 1, got 0"),
            (
                "[[record]]\nout = \"y\"\ntrack = \"lake\"\nspeed = nan",
                "record.speed: expected a number of mph above 0, at most 200, got NaN",
            ),
        ] {
            assert_eq!(error(&format!("data = [{{ path = \"x\" }}]\n{text}")), expected);
        }
        let seed = Recipe { seed: u64::MAX, data: vec![Selection::of("x")], ..Recipe::default() };
        assert!(seed.check().unwrap_err().to_string().starts_with("seed: expected 0 to 9223372036854775807, got"));
    }
}
