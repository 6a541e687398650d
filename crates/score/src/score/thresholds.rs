//! What a run must reach.

use super::{Figure, Scorecard};
use lapwing_core::config::Thresholds;

/// A threshold held against a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Check {
    /// The setting, such as `min_completion`.
    pub name: &'static str,
    /// Whether the run reaches it. What the run does not tell does not.
    pub passed: bool,
    /// What was expected and what came, in words.
    pub words: String,
}

/// Every threshold that is set, held against a run; of what is damaged nobody knows whether it reaches them.
pub fn checks(thresholds: &Thresholds, card: &Scorecard) -> Vec<Check> {
    let share = |percent: Option<f64>| percent.map(|percent| percent / 100.0);
    let count = |count: Option<u32>| count.map(f64::from);
    let Thresholds {
        min_completion,
        min_autonomy,
        min_driving_score,
        max_collisions,
        max_off_road,
        max_cte,
        max_mean_cte,
    } = *thresholds;
    let least = [
        ("min_completion", Figure::Completion, share(min_completion)),
        ("min_autonomy", Figure::Autonomy, share(min_autonomy)),
        ("min_driving_score", Figure::DrivingScore, min_driving_score),
    ];
    let most = [
        ("max_collisions", Figure::Collisions, count(max_collisions)),
        ("max_off_road", Figure::OffRoads, count(max_off_road)),
        ("max_cte", Figure::MaxCte, max_cte),
        ("max_mean_cte", Figure::MeanCte, max_mean_cte),
    ];
    let check =
        |bound: &str, (name, figure, limit): (&'static str, Figure, Option<f64>), holds: fn(f64, f64) -> bool| {
            let limit = limit?;
            let expected = figure.unit().show(limit);
            let words = format!("{}: expected {bound} {expected}, got {}", figure.label(), card.words(figure));
            Some(Check { name, passed: card.value(figure).is_some_and(|value| holds(value, limit)), words })
        };
    let least = least.into_iter().map(|threshold| check("at least", threshold, |value, limit| value >= limit));
    let most = most.into_iter().map(|threshold| check("at most", threshold, |value, limit| value <= limit));
    let mut checks: Vec<Check> = least.chain(most).flatten().collect();
    if card.damaged && !checks.is_empty() {
        let words = "the run's file: expected a whole one, got one that is damaged: what is lost may have been worse";
        checks.push(Check { name: "whole", passed: false, words: words.into() });
    }
    checks
}

/// Each threshold that a run misses, in words.
pub fn missed(thresholds: &Thresholds, card: &Scorecard) -> Vec<String> {
    checks(thresholds, card).into_iter().filter(|check| !check.passed).map(|check| check.words).collect()
}
