//! Figures that a driving log cannot give if the names of its pictures hold no time.

use crate::{score::Figure, score::card::Figures};

/// Why: what follows from an assumed time is off by as much as the true time differs from it.
pub(in crate::score) const UNTIMED_LOG: &str = "the pictures' names hold no time";

/// Removes the figures that depend on how fast time passed, whatever else is told of them. Speeds stay: rows come about evenly.
pub(super) fn untell(figures: &mut Figures) {
    use Figure as F;
    for figure in [F::DistanceM, F::TimeS, F::Completion, F::Laps, F::Collisions] {
        figures.told(figure, None, UNTIMED_LOG);
    }
    for figure in [
        F::CollisionsPerKm,
        F::Stuck,
        F::Interventions,
        F::InterventionsPerKm,
        F::Autonomy,
        F::AutonomyMeasured,
        F::HumanS,
        F::SurvivalS,
        F::SurvivalM,
        F::SteeringRate,
        F::SteeringReversals,
        F::RmsJerk,
        F::Comfort,
        F::FramesPerS,
    ] {
        // Others have their own reasons.
        if figures.get(figure).value().is_some() {
            figures.told(figure, None, UNTIMED_LOG);
        }
    }
}
