//! `[brake]`: who may brake in place of the pilot.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

/// `[brake]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BrakeSettings {
    /// Who watches. Default: the network, if there is one, otherwise nobody.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guard: Option<GuardKind>,
    /// A braking network (`.safetensors`), as `lapwing brake train` writes it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<PathBuf>,
    /// The network's value from which on it brakes. Default: the one in its file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threshold: Option<f64>,
}

/// Who may brake in place of the pilot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum GuardKind {
    /// Nobody.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    None,
    /// Who is told the time to collision.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    Ttc,
    /// The network.
    #[cfg_attr(feature = "clap", value(skip))]
    Model,
}

/// What the settings come to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Guarding<'a> {
    /// Nobody watches.
    Nobody,
    /// Who is told the time to collision.
    TimeToCollision,
    /// This network, with this threshold instead of its own.
    Network(&'a Path, Option<f64>),
}

impl BrakeSettings {
    /// Who watches.
    pub fn guarding(&self) -> Guarding<'_> {
        match (self.guard, &self.model) {
            (Some(GuardKind::Ttc), _) => Guarding::TimeToCollision,
            (None | Some(GuardKind::Model), Some(model)) => Guarding::Network(model, self.threshold),
            (None | Some(GuardKind::None | GuardKind::Model), _) => Guarding::Nobody,
        }
    }

    /// What is wrong with them together, once all layers are there: the keys, and why.
    pub(super) fn check_together(&self) -> Result<(), (&'static [&'static str], String)> {
        if self.guard == Some(GuardKind::Model) && self.model.is_none() {
            return Err((
                &["brake.guard"],
                "brake.guard: expected brake.model to be the network's file, got none".into(),
            ));
        }
        Ok(())
    }

    /// What is wrong with one of them.
    pub(super) fn check(&self) -> Result<(), String> {
        match self.threshold {
            Some(threshold) if !(threshold > 0.0 && threshold.is_finite()) => {
                Err(format!("brake.threshold: expected a value above 0, got {threshold}"))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_network_watches_if_there_is_one_unless_another_guard_or_nobody_is_asked_for() {
        let settings = |guard, model: Option<&str>| BrakeSettings {
            guard,
            model: model.map(PathBuf::from),
            ..BrakeSettings::default()
        };
        let network = Guarding::Network(Path::new("net.safetensors"), None);
        for (guard, model, expected) in [
            (None, None, Guarding::Nobody),
            (None, Some("net.safetensors"), network),
            (Some(GuardKind::Model), Some("net.safetensors"), network),
            (Some(GuardKind::Ttc), Some("net.safetensors"), Guarding::TimeToCollision),
            (Some(GuardKind::None), Some("net.safetensors"), Guarding::Nobody),
        ] {
            assert_eq!(settings(guard, model).guarding(), expected);
        }
    }
}
