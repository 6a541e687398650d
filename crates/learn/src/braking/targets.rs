//! What a braking network should say at each frame of a drive.
//!
//! The paper's label begins as late as the driver's foot. Towards it, from the moment at which the driver noticed the danger,
//! a live network learns how near the collision is; and beside it what the telemetry knows of each frame.

use super::{BrakingRecipe, episodes::Drive};
use crate::nn::braking::HZ;
use lapwing_score::emergency::LabelRule;

/// A car slower than this stands, in km/h: 1 mph.
pub(super) const STANDING_KMH: f32 = 1.6;
/// A pedal held less than this is let go.
const LET_GO: f64 = 0.05;
/// A label lasts at most so long, in seconds, however long the pedal is held.
const LONGEST_S: f64 = 4.0;
/// Something this near ahead in the car's way, in metres, blocks it; something as far as the second does not.
const BLOCKED_M: [f64; 2] = [6.0, 8.0];
/// Nearer collisions are not told apart: the largest inverse time to one, per second.
pub(super) const NEAREST_PER_S: f64 = 2.0;
/// How near something ahead is: 1 where it is touched, one half this many metres away.
pub(super) const HALF_NEAR_M: f64 = 5.0;
/// Until the driver noticed, something that comes sooner than this, in seconds, may be hidden; behind a car, whatever comes.
const UNSEEN_S: f64 = 2.4;
const EVER_S: f64 = 15.0;

/// What should be said at a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Wanted {
    /// How much a brake is due, 0 to 1, and how much that matters.
    pub due: f32,
    pub weight: f32,
    /// Whether something is close ahead, 0 to 1.
    pub blocked: f32,
    /// The inverse of the time to collision, per second, and how near what is ahead is, 0 to 1.
    pub near: [f32; 2],
    /// 1 if what comes can be seen.
    pub seen: f32,
}

/// What should be said at each frame of a drive.
pub(super) fn wanted(drive: &Drive, recipe: &BrakingRecipe) -> Vec<Wanted> {
    let labels = labels(drive, recipe, if recipe.near_s.is_some() { 0.0 } else { recipe.lead });
    let noticed = drive.onsets.first().map(|onset| onset.saturating_sub(earlier(drive, recipe.lead)));
    let may_hide = drive.story.layer == "hidden" || drive.story.scenario == "child";
    let wanted = |i: usize| {
        let (until_s, gap_m) = (drive.until_s[i], drive.gap_m[i]);
        let is_noticed = noticed.is_some_and(|noticed| i >= noticed);
        let is_hidden = drive.story.hazard && !is_noticed && until_s < if may_hide { EVER_S } else { UNSEEN_S };
        let moves = drive.speed_kmh[i] >= STANDING_KMH;
        let nears = match recipe.near_s {
            Some([far_s, near_s]) if is_noticed && moves => between(until_s.recip(), far_s.recip(), near_s.recip()),
            _ => 0.0,
        };
        let due = f64::from(u8::from(labels[i])).max(nears);
        let is_ignored = is_hidden && !labels[i] && recipe.near_s.is_some() && until_s < UNSEEN_S;
        Wanted {
            due: due as f32,
            weight: if is_ignored { 0.0 } else { (1.0 + (recipe.due_weight - 1.0) * due) as f32 },
            blocked: (1.0 - between(gap_m, BLOCKED_M[0], BLOCKED_M[1])) as f32,
            near: [until_s.recip().min(NEAREST_PER_S) as f32, (HALF_NEAR_M / (HALF_NEAR_M + gap_m.max(0.0))) as f32],
            seen: f32::from(u8::from(!is_hidden)),
        }
    };
    (0..drive.frames()).map(wanted).collect()
}

/// 0 up to `from`, 1 from `to` on, and evenly between.
fn between(x: f64, from: f64, to: f64) -> f64 {
    ((x - from) / (to - from)).clamp(0.0, 1.0)
}

/// Frames of a share of the driver's reaction time.
fn earlier(drive: &Drive, lead: f64) -> usize {
    (lead * drive.story.reaction_s * HZ).round() as usize
}

/// At which frames of a drive the network should say 1, by the recipe's rule.
fn labels(drive: &Drive, recipe: &BrakingRecipe, lead: f64) -> Vec<bool> {
    let rule = LabelRule::default();
    let mut labels = drive.due.clone();
    for &onset in &drive.onsets {
        let first = onset.saturating_sub(rule.lead);
        let mut end = (first + rule.length).min(labels.len());
        if recipe.hold {
            let longest = (first + (LONGEST_S * HZ) as usize).min(labels.len());
            let brakes = |i: &usize| drive.pedal[*i] >= LET_GO && drive.speed_kmh[*i] >= STANDING_KMH;
            // The label begins before the foot, so that the pedal is looked at after it.
            end = (end..longest).find(|i| !brakes(i)).unwrap_or(longest.max(end));
        }
        labels[first.saturating_sub(earlier(drive, lead))..end].fill(true);
    }
    labels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::braking::windows::tests::{drive, recipe};

    fn ends(set: impl Iterator<Item = bool>) -> (usize, usize) {
        let set: Vec<bool> = set.collect();
        (set.iter().position(|t| *t).unwrap(), set.iter().rposition(|t| *t).unwrap())
    }

    #[test]
    fn a_target_is_the_papers_label_unless_it_begins_earlier_or_lasts_as_long_as_the_brake() {
        let drive = drive();
        let ends_of = |more: &str| ends(wanted(&drive, &recipe(more)).iter().map(|wanted| wanted.due > 0.0));
        assert_eq!(ends_of(""), ends(drive.due.iter().copied()));
        assert_eq!(ends_of(""), (147, 156));
        assert_eq!(ends_of("lead = 1.0"), (132, 156));
        assert_eq!(ends_of("lead = 0.4\nhold = true"), (141, 168));
    }

    #[test]
    fn from_noticing_on_a_target_rises_as_the_collision_nears() {
        let mut drive = drive();
        // 2.9 s at frame 120, and 15 frames a second less.
        drive.until_s = (0..300).map(|i| (2.9 - (f64::from(i) - 120.0) / 15.0).clamp(0.5, 60.0)).collect();
        let wanted = wanted(&drive, &recipe("lead = 1.0\nnear_s = [2.4, 1.2]\ndue_weight = 3.0"));
        assert_eq!(wanted[120].due, 0.0);
        assert!(wanted[134].due > 0.1 && wanted[134].due < wanted[140].due && wanted[140].due < 1.0, "{wanted:?}");
        assert_eq!((wanted[147].due, wanted[147].weight), (1.0, 3.0));
        assert!((wanted[120].near[0] - (1.0f32 / 2.9)).abs() < 1e-6 && wanted[120].weight == 1.0);
    }

    #[test]
    fn what_comes_close_before_the_driver_notices_it_is_hidden_and_not_learnt_from() {
        let mut drive = drive();
        drive.until_s[100..132].fill(2.0);
        let wanted = wanted(&drive, &recipe("lead = 1.0\nnear_s = [2.4, 1.2]"));
        assert_eq!((wanted[99].weight, wanted[99].seen, wanted[110].weight, wanted[110].seen), (1.0, 1.0, 0.0, 0.0));
        assert_eq!((wanted[132].weight, wanted[132].seen), (1.0, 1.0));
    }

    #[test]
    fn something_six_metres_ahead_blocks_the_way() {
        let mut drive = drive();
        (drive.gap_m[0], drive.gap_m[1], drive.gap_m[2]) = (5.9, 7.0, 8.1);
        let wanted = wanted(&drive, &recipe(""));
        assert_eq!([wanted[0].blocked, wanted[1].blocked, wanted[2].blocked], [1.0, 0.5, 0.0]);
    }
}
