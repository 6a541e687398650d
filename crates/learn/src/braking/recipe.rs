//! How a braking network is trained, as a file.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::BrakingTrainError;
use crate::{
    nn::{Precision, braking::BrakingArchitecture},
    train::Schedule,
};

/// How a braking network is trained: a TOML file, all of whose keys have defaults but `network`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BrakingRecipe {
    /// Which network.
    pub network: BrakingArchitecture,
    /// Weights to begin from: a file of the same network, its path from the current folder. It is asked about every window before
    /// it learns, so that `rivals` chooses the windows that it predicts worst from the start. Random weights by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pretrained: Option<PathBuf>,
    /// Passes at most.
    #[serde(default = "defaults::epochs")]
    pub epochs: usize,
    /// Windows drawn for each. The live network's are longer and have 23 answers each.
    #[serde(default = "defaults::windows")]
    pub windows_per_epoch: usize,
    /// Windows in a step.
    #[serde(default = "defaults::batch")]
    pub batch: usize,
    /// Adam's, at the beginning.
    #[serde(default = "defaults::learning_rate")]
    pub learning_rate: f64,
    /// How it changes: not at all, by half a cosine to zero at the last step, or where the validation loss no longer falls.
    #[serde(default = "defaults::schedule")]
    pub schedule: Schedule,
    /// Numbers of the live network's convolutions while they learn: `f32` (default), or `bf16` for less than half the time on
    /// processors that know them.
    #[serde(default = "defaults::precision")]
    pub precision: Precision,
    /// The network that is kept has the running mean of the weights, of which a step leaves this share: as steady as after a
    /// learning rate that falls, at any time. 0 by default: the weights themselves.
    #[serde(default)]
    pub average: f64,
    /// Adam's (AdamW).
    #[serde(default)]
    pub weight_decay: f64,
    /// Of `schedule = "plateau"`: epochs without a lower validation loss after which the learning rate falls …
    #[serde(default = "defaults::patience")]
    pub patience: usize,
    /// … to this share of itself.
    #[serde(default = "defaults::falls_to")]
    pub falls_to: f64,
    /// Share of the drawn windows that end with a standing car. In the loss standing and moving windows weigh the same in
    /// all, whatever their share. Not used with `emergencies`.
    #[serde(default = "defaults::standing")]
    pub standing: f64,
    /// Share of the drawn windows in which a brake is due, in place of `standing`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emergencies: Option<f64>,
    /// Of so many windows that are drawn, the one is taken that the network knew least when it saw it last. 1 by default.
    #[serde(default = "defaults::rivals")]
    pub rivals: usize,
    /// How much earlier than the paper's a label begins, as a share of the driver's reaction time: 0 is the paper's, 1 the
    /// moment at which the driver noticed.
    #[serde(default)]
    pub lead: f64,
    /// Whether a label lasts until the pedal is let go or the car stands, and not only the paper's 10 frames.
    #[serde(default)]
    pub hold: bool,
    /// From the driver's noticing on, by `lead`, a label rises with the inverse of the time to collision: from 0 at the first of
    /// these times, in seconds, to 1 at the second. Without it, it is 1 from there on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub near_s: Option<[f64; 2]>,
    /// How much what a live network is to say besides counts: whether something is close ahead, and what each frame shows, which
    /// it is told while it learns. 0 by default.
    #[serde(default)]
    pub besides: f64,
    /// How much a frame at which a brake is due weighs in the loss, beside one at which none is.
    #[serde(default = "defaults::due_weight")]
    pub due_weight: f64,
    /// Share of the windows in which half, four fifths or all of the speeds are unknown.
    #[serde(default)]
    pub speed_dropout: f64,
    /// Share of the windows with mirrored pictures.
    #[serde(default)]
    pub flip: f64,
    /// Share of the windows with darker or lighter pictures.
    #[serde(default)]
    pub shade: f64,
    /// Pictures are moved by up to so many pixels, as the network sees them, to each side and half as many up and down.
    #[serde(default)]
    pub shift_px: i64,
    /// Random seed.
    #[serde(default)]
    pub seed: u64,
    /// Episodes of each part that are read at most, spread over all. Default all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub episodes: Option<usize>,
    /// Windows by which the validation loss is measured at most.
    #[serde(default = "defaults::validation_windows")]
    pub validation_windows: usize,
    /// Validation episodes that are read at most, spread over all: the threshold is chosen by every frame of them, which takes the
    /// paper's network longer than its training. Default all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub validation_episodes: Option<usize>,
}

mod defaults {
    use crate::{nn::Precision, train::Schedule};

    pub fn schedule() -> Schedule {
        Schedule::Plateau
    }
    pub fn precision() -> Precision {
        Precision::F32
    }
    pub fn rivals() -> usize {
        1
    }
    pub fn epochs() -> usize {
        20
    }
    pub fn windows() -> usize {
        4000
    }
    pub fn batch() -> usize {
        16
    }
    pub fn learning_rate() -> f64 {
        1e-3
    }
    pub fn patience() -> usize {
        2
    }
    pub fn falls_to() -> f64 {
        0.3
    }
    pub fn standing() -> f64 {
        0.5
    }
    pub fn due_weight() -> f64 {
        1.0
    }
    pub fn validation_windows() -> usize {
        1000
    }
}

impl BrakingRecipe {
    /// Reads a recipe.
    ///
    /// # Errors
    /// [`BrakingTrainError::Recipe`], [`BrakingTrainError::Setting`].
    pub fn read(text: &str) -> Result<Self, BrakingTrainError> {
        let recipe: Self = toml::from_str(text).map_err(|e| BrakingTrainError::Recipe(e.to_string()))?;
        recipe.check()?;
        Ok(recipe)
    }

    /// Checks that all values are possible.
    ///
    /// # Errors
    /// [`BrakingTrainError::Setting`].
    pub fn check(&self) -> Result<(), BrakingTrainError> {
        let wrong = |name, expected, got: String| Err(BrakingTrainError::Setting { name, expected, got });
        for (name, value) in [
            ("epochs", self.epochs),
            ("windows_per_epoch", self.windows_per_epoch),
            ("batch", self.batch),
            ("patience", self.patience),
            ("rivals", self.rivals),
            ("episodes", self.episodes.unwrap_or(1)),
            ("validation_windows", self.validation_windows),
            ("validation_episodes", self.validation_episodes.unwrap_or(1)),
        ] {
            if value == 0 {
                return wrong(name, "at least 1", value.to_string());
            }
        }
        for (name, value) in [
            ("lead", self.lead),
            ("speed_dropout", self.speed_dropout),
            ("flip", self.flip),
            ("shade", self.shade),
            ("weight_decay", self.weight_decay),
            ("average", self.average),
        ] {
            if !(0.0..=1.0).contains(&value) {
                return wrong(name, "a share from 0 to 1", value.to_string());
            }
        }
        if !(0..=40).contains(&self.shift_px) {
            return wrong("shift_px", "0 to 40 pixels", self.shift_px.to_string());
        }
        if let Some([far, near]) = self.near_s
            && !(0.0 < near && near < far && far <= 10.0)
        {
            return wrong("near_s", "two times up to 10 s, the longer one first", format!("{far}, {near}"));
        }
        if !(0.0..=100.0).contains(&self.besides) {
            return wrong("besides", "a number from 0 to 100", self.besides.to_string());
        }
        let emergencies = self.emergencies.unwrap_or(0.5);
        for (name, value) in [("standing", self.standing), ("falls_to", self.falls_to), ("emergencies", emergencies)] {
            if !(value > 0.0 && value < 1.0) {
                return wrong(name, "a share above 0 and below 1", value.to_string());
            }
        }
        for (name, value) in [("learning_rate", self.learning_rate), ("due_weight", self.due_weight)] {
            if !(value > 0.0 && value <= 1000.0) {
                return wrong(name, "a number above 0, up to 1000", value.to_string());
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recipe_needs_only_its_network_and_refuses_what_cannot_be() {
        let recipe = BrakingRecipe::read("network = \"brake-stacked\"").unwrap();
        assert_eq!((recipe.learning_rate, recipe.standing, recipe.lead, recipe.hold), (1e-3, 0.5, 0.0, false));
        assert_eq!(recipe.schedule, Schedule::Plateau, "as the paper has it");
        let error =
            |line: &str| BrakingRecipe::read(&format!("network = \"brake-live\"\n{line}")).unwrap_err().to_string();
        assert_eq!(error("lead = 1.5"), "lead: expected a share from 0 to 1, got 1.5");
        assert_eq!(error("batch = 0"), "batch: expected at least 1, got 0");
        assert_eq!(
            error("near_s = [1.0, 2.0]"),
            "near_s: expected two times up to 10 s, the longer one first, got 1, 2"
        );
        assert!(error("leed = 1").contains("unknown field `leed`"));
    }
}
