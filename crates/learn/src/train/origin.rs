//! The origin of a training: it is resumed with the same data and recipe, or not at all.

use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Recipe, Schedule, TrainError};

/// The origin, stored beside the weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Origin {
    /// The recipe as it was followed.
    pub recipe: Recipe,
    /// Samples of training and validation.
    pub samples: (usize, usize),
    /// Their [hash](crate::dataset::samples_hash); missing in files from before it was stored.
    #[serde(default)]
    pub hash: Option<String>,
}

/// Settings that may change in between: they decide when a training ends or how it is stored, and do not affect the
/// weights.
const FREE: [&str; 5] = ["patience", "cache_mib", "stored", "record", "closed_loop"];

impl Origin {
    /// Checks that this recipe would train the weights in the same way. A cosine schedule ends with the last epoch, so
    /// there even the number of epochs matters.
    pub fn check_recipe(&self, recipe: &Recipe, folder: &Path) -> Result<(), TrainError> {
        let comparable = |of: &Recipe| {
            let mut value = serde_json::to_value(of).map_err(|why| TrainError::Recipe(why.to_string()))?;
            if let Value::Object(keys) = &mut value {
                keys.retain(|key, _| !FREE.contains(&key.as_str()));
                if recipe.optimiser.schedule != Schedule::Cosine {
                    keys.remove("epochs");
                }
            }
            Ok::<_, TrainError>(value)
        };
        let mut differences = vec![];
        compare("", &comparable(&self.recipe)?, &comparable(recipe)?, &mut differences);
        if differences.is_empty() {
            return Ok(());
        }
        Err(TrainError::OtherRecipe { folder: folder.to_owned(), differences: differences.join("; ") })
    }

    /// Checks that the data did not change under the same names.
    pub fn check_samples(&self, samples: (usize, usize), hash: &str, folder: &Path) -> Result<(), TrainError> {
        let told = |(training, validation): (usize, usize)| format!("{training} and {validation} held out");
        let got = match &self.hash {
            _ if self.samples != samples => told(samples),
            Some(before) if before != hash => {
                "as many with other labels or weights, in another order, or as another version of Lapwing labels them"
                    .into()
            }
            _ => return Ok(()),
        };
        Err(TrainError::OtherData { folder: folder.to_owned(), expected: told(self.samples), got })
    }
}

/// Names every value that differs, by its path: `optimiser.learning_rate`, `data[0].path`.
fn compare(at: &str, expected: &Value, got: &Value, differences: &mut Vec<String>) {
    match (expected, got) {
        (Value::Object(a), Value::Object(b)) => {
            let mut keys: Vec<&String> = a.keys().chain(b.keys()).collect();
            keys.sort();
            keys.dedup();
            for key in keys {
                let at = if at.is_empty() { key.clone() } else { format!("{at}.{key}") };
                let of = |map: &serde_json::Map<String, Value>| map.get(key).cloned().unwrap_or_default();
                compare(&at, &of(a), &of(b), differences);
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            for (i, (a, b)) in a.iter().zip(b).enumerate() {
                compare(&format!("{at}[{i}]"), a, b, differences);
            }
        }
        _ if expected == got => {}
        _ => differences.push(format!("{at}: expected {}, got {}", told(expected), told(got))),
    }
}

fn told(value: &Value) -> String {
    if value.is_null() { "none".into() } else { value.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{dataset::Selection, train::OptimiserKind};

    fn origin() -> Origin {
        let data = vec![Selection::of("lake"), Selection::of("jungle")];
        let hash = Some("abc".into());
        Origin { recipe: Recipe { data, ..Recipe::default() }, samples: (400, 100), hash }
    }

    #[test]
    fn all_that_differs_is_named() {
        let mut other = origin().recipe;
        other.network = "cps".into();
        other.optimiser.kind = OptimiserKind::Sgd;
        other.data[1].path = "mountain".into();
        other.ema = Some(0.5);
        let error = origin().check_recipe(&other, Path::new("out")).unwrap_err().to_string();
        let differences = "data[1].path: expected \"jungle\", got \"mountain\"; ema: expected none, got 0.5; \
                           network: expected \"pilotnet\", got \"cps\"; optimiser.kind: expected \"adam\", got \"sgd\"";
        assert!(
            error.starts_with(&format!("out already holds a training with another recipe: {differences}:")),
            "{error}"
        );
        let refused = |samples, hash| origin().check_samples(samples, hash, Path::new("out")).unwrap_err().to_string();
        let error = refused((400, 90), "abd");
        assert!(error.contains("expected 400 and 100 held out, got 400 and 90 held out: undo"), "{error}");
        let error = refused((400, 100), "abd");
        assert!(error.contains("expected 400 and 100 held out, got as many with other labels or weights"), "{error}");
        origin().check_samples((400, 100), "abc", Path::new("out")).unwrap();
        Origin { hash: None, ..origin() }.check_samples((400, 100), "abd", Path::new("out")).unwrap();
    }

    #[test]
    fn what_does_not_bend_the_way_may_change() {
        let mut recipe = origin().recipe;
        (recipe.epochs, recipe.patience, recipe.cache_mib) = (90, Some(3), 0);
        origin().check_recipe(&recipe, Path::new("out")).unwrap();
        let mut cosine = origin();
        (cosine.recipe.optimiser.schedule, recipe.optimiser.schedule) = (Schedule::Cosine, Schedule::Cosine);
        let error = cosine.check_recipe(&recipe, Path::new("out")).unwrap_err().to_string();
        assert!(error.contains("epochs: expected 20, got 90"), "{error}");
    }
}
