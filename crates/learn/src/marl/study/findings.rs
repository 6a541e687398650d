//! What a study's cells come to: a table, and whether each claim holds.
//!
//! Scores of several seeds and tasks (a reward and an amount of traffic) are put together as interquartile means, with 95 %
//! intervals by the stratified bootstrap: seeds are drawn anew within each task (Agarwal et al. 2021, Deep Reinforcement
//! Learning at the Edge of the Statistical Precipice). What is compared is the difference, or ratio, of two variants.

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::{CellResult, Variant};
use lapwing_core::stats::middle_95;
use lapwing_sim::intersection::Reward;

/// Bootstrap samples.
const SAMPLES: usize = 2000;
/// Points of a curve that are averaged before it is looked at for falls and ends.
const SMOOTH: usize = 5;

/// With fewer runs of each task than these, an interval says nothing of other seeds.
const ENOUGH: usize = 3;

/// A number with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// Of all runs.
    pub value: f64,
    /// 95 % interval.
    pub interval: [f64; 2],
    /// Runs of the task that has the fewest; 0 if one of those compared made no gradient step.
    pub runs: usize,
}

/// Whether something holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The interval lies on its side, or in its range.
    Holds,
    /// It lies on the other, or outside the range.
    Fails,
    /// It lies in part here, in part there, or there are fewer than three seeds, or runs without a gradient step: more
    /// would tell.
    Open,
}

/// One thing that is claimed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Which claim it belongs to, from 1.
    pub claim: u8,
    /// What is claimed.
    pub says: &'static str,
    /// What the number is.
    pub measure: &'static str,
    /// What was found; none where runs are missing.
    pub found: Option<Estimate>,
    /// Whether it holds.
    pub verdict: Verdict,
}

/// A line of the table: the runs of a variant on a task, interquartile means over seeds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Which variant.
    pub variant: Variant,
    /// What was rewarded.
    pub reward: Reward,
    /// Background cars in training.
    pub cars: usize,
    /// Seeds.
    pub runs: usize,
    /// Agent-steps.
    pub agent_steps: f64,
    /// Gradient steps.
    pub gradient_steps: f64,
    /// Seconds of training.
    pub seconds: f64,
    /// Runs in which all four agents once reached their goals in 80 % of the last hundred episodes.
    pub reached_80: usize,
    /// Without traffic and with it, over few episodes and over many: collision and completion rate.
    pub rates: [[f64; 2]; 4],
    /// With random missions and as much traffic as in training, over many episodes: completion rate.
    pub completion: Estimate,
    /// Mean speed, in m/s.
    pub speed: f64,
    /// Variance of the offset from the lane's middle during an agent's episode, in m2.
    pub offset_variance: f64,
    /// Entropy of an agent's actions during its episode, in bits.
    pub control_diversity: f64,
    /// Share of agents that were still driving after 1000 steps.
    pub time_up: f64,
    /// Mean duration of an agent's episode, in seconds.
    pub duration: f64,
    /// Mean undiscounted sum of rewards.
    pub earned: f64,
}

/// All that a study says.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Findings {
    /// By task and variant.
    pub rows: Vec<Row>,
    /// Claim by claim.
    pub findings: Vec<Finding>,
}

impl Findings {
    /// Of the cells that are done.
    pub fn of(cells: &[CellResult]) -> Self {
        Self { rows: rows(cells), findings: findings(cells) }
    }
}

/// Interquartile mean: the mean of the middle half. Values at its edges count in part, so that few are as good as many.
pub fn interquartile_mean(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len() as f64;
    let (mut sum, mut weights) = (0.0, 0.0);
    for (i, value) in sorted.iter().enumerate() {
        let (from, until) = ((i as f64).max(n * 0.25), (i as f64 + 1.0).min(n * 0.75));
        let weight = (until - from).max(0.0);
        (sum, weights) = (sum + weight * value, weights + weight);
    }
    sum / f64::max(weights, f64::MIN_POSITIVE)
}

/// Largest fall of a curve from what it had reached before, smoothed.
pub fn drawdown(values: &[f64]) -> f64 {
    let smooth = values.windows(SMOOTH.min(values.len().max(1)));
    let (mut highest, mut fall) = (f64::NEG_INFINITY, 0.0_f64);
    for value in smooth.map(|window| window.iter().sum::<f64>() / window.len() as f64) {
        highest = highest.max(value);
        fall = fall.max(highest - value);
    }
    fall
}

/// Values of the runs of a variant, by task.
type Strata = Vec<Vec<f64>>;

/// A statistic of the runs of some variants, each in strata that are drawn anew on their own.
fn estimate(groups: &[Strata], statistic: impl Fn(&[Strata]) -> f64) -> Option<Estimate> {
    let fewest = |strata: &Strata| strata.iter().map(Vec::len).min().unwrap_or_default();
    let runs = groups.iter().map(fewest).min().filter(|runs| *runs > 0)?;
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let mut drawn = groups.to_vec();
    let mut found: Vec<f64> = (0..SAMPLES)
        .map(|_| {
            for (drawn, all) in drawn.iter_mut().flatten().zip(groups.iter().flatten()) {
                drawn.iter_mut().for_each(|value| *value = all[random.random_range(0..all.len())]);
            }
            statistic(&drawn)
        })
        .collect();
    Some(Estimate { value: statistic(groups), interval: middle_95(&mut found)?, runs })
}

fn pooled(strata: &Strata) -> f64 {
    interquartile_mean(&strata.concat())
}

fn difference(groups: &[Strata]) -> f64 {
    pooled(&groups[0]) - pooled(&groups[1])
}

fn ratio(groups: &[Strata]) -> f64 {
    pooled(&groups[0]) / pooled(&groups[1]).max(f64::MIN_POSITIVE)
}

/// Mean over the tasks of the standard deviation over the seeds: the first group's less the second's.
fn spread(groups: &[Strata]) -> f64 {
    let of = |strata: &Strata| {
        let each = strata.iter().map(|values| {
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n).sqrt()
        });
        each.sum::<f64>() / strata.len() as f64
    };
    of(&groups[0]) - of(&groups[1])
}

/// Completion rate of the last points of a curve up to a time.
fn completion_at(cell: &CellResult, seconds: f64) -> f64 {
    let until = cell.curve.iter().take_while(|point| point.seconds <= seconds).count();
    let last = &cell.curve[until.saturating_sub(SMOOTH)..until];
    last.iter().map(|point| point.completion).sum::<f64>() / last.len().max(1) as f64
}

fn findings(cells: &[CellResult]) -> Vec<Finding> {
    let strata = |variant: Variant, of: &dyn Fn(&CellResult) -> f64| -> Strata {
        let mut tasks: BTreeMap<(bool, usize), Vec<f64>> = BTreeMap::new();
        for cell in cells.iter().filter(|cell| cell.cell.variant == variant) {
            tasks.entry((cell.cell.reward == Reward::Smarts, cell.cell.cars)).or_default().push(of(cell));
        }
        tasks.into_values().collect()
    };
    let learnt = |variant: Variant| cells.iter().all(|cell| cell.cell.variant != variant || cell.gradient_steps > 0);
    let compared = |a, b, of: &dyn Fn(&CellResult) -> f64, statistic: fn(&[Strata]) -> f64| {
        let found = estimate(&[strata(a, of), strata(b, of)], statistic);
        found.map(|found| Estimate { runs: if learnt(a) && learnt(b) { found.runs } else { 0 }, ..found })
    };
    let completion = |cell: &CellResult| cell.random.completion_rate;
    let fall = |cell: &CellResult| drawdown(&cell.curve.iter().map(|point| point.completion).collect::<Vec<_>>());
    let above = |claim, says, measure, found: Option<Estimate>, bound: f64, wants_more: bool| {
        let verdict = match found {
            Some(Estimate { interval: [low, _], runs, .. }) if runs >= ENOUGH && low > bound => {
                [Verdict::Fails, Verdict::Holds][usize::from(wants_more)]
            }
            Some(Estimate { interval: [_, high], runs, .. }) if runs >= ENOUGH && high < bound => {
                [Verdict::Holds, Verdict::Fails][usize::from(wants_more)]
            }
            _ => Verdict::Open,
        };
        Finding { claim, says, measure, found, verdict }
    };
    use Variant::{Asynchronous, Batch64, Batch64Samples, Maddpg, Ppo, Proportional, Rank};
    // Of each pair of the same task and seed, the time that the shorter run took.
    let same_time = |cell: &CellResult| {
        let pair = cells.iter().filter(|other| {
            let (a, b) = (&other.cell, &cell.cell);
            matches!(a.variant, Asynchronous | Maddpg) && (a.reward, a.cars, a.seed) == (b.reward, b.cars, b.seed)
        });
        completion_at(cell, pair.map(|other| other.seconds).fold(f64::INFINITY, f64::min))
    };
    let times = compared(Ppo, Maddpg, &|cell| cell.seconds, ratio);
    let within = Finding {
        claim: 1,
        says: "PPO takes 3 to 3.5 times MADDPG's time",
        measure: "ratio of the times for as many agent-steps",
        found: times,
        verdict: match times.filter(|times| times.runs >= ENOUGH).map(|times| times.interval) {
            Some([low, high]) if low >= 3.0 && high <= 3.5 => Verdict::Holds,
            Some([low, high]) if low > 3.5 || high < 3.0 => Verdict::Fails,
            _ => Verdict::Open,
        },
    };
    let rate = "difference of the completion rates";
    vec![
        within,
        above(1, "PPO ends better", rate, compared(Ppo, Maddpg, &completion, difference), 0.0, true),
        above(
            2,
            "proportional priorities are steadier over seeds",
            "difference of the standard deviations of the completion rate",
            compared(Proportional, Maddpg, &completion, spread),
            0.0,
            false,
        ),
        above(
            2,
            "proportional priorities are steadier while learning",
            "difference of the largest falls of the completion rate",
            compared(Proportional, Maddpg, &fall, difference),
            0.0,
            false,
        ),
        above(
            2,
            "priorities by rank are steadier over seeds",
            "difference of the standard deviations of the completion rate",
            compared(Rank, Maddpg, &completion, spread),
            0.0,
            false,
        ),
        above(
            2,
            "priorities by rank are steadier while learning",
            "difference of the largest falls of the completion rate",
            compared(Rank, Maddpg, &fall, difference),
            0.0,
            false,
        ),
        above(
            3,
            "batches of 64 beat 1024 at equal updates",
            rate,
            compared(Batch64, Maddpg, &completion, difference),
            0.0,
            true,
        ),
        above(
            3,
            "batches of 64 beat 1024 at equal samples",
            rate,
            compared(Batch64Samples, Maddpg, &completion, difference),
            0.0,
            true,
        ),
        above(
            4,
            "two asynchronous learners beat one at equal agent-steps",
            rate,
            compared(Asynchronous, Maddpg, &completion, difference),
            0.0,
            true,
        ),
        above(
            4,
            "two asynchronous learners beat one at equal time",
            "difference of the completion rates in training",
            compared(Asynchronous, Maddpg, &same_time, difference),
            0.0,
            true,
        ),
    ]
}

fn rows(cells: &[CellResult]) -> Vec<Row> {
    let mut rows = Vec::new();
    for cars in [0, lapwing_sim::intersection::CARS] {
        for reward in [Reward::Smarts, Reward::Corrected] {
            for variant in Variant::ALL {
                let is_there = |cell: &&CellResult| {
                    (cell.cell.variant, cell.cell.reward, cell.cell.cars) == (variant, reward, cars)
                };
                let these: Vec<&CellResult> = cells.iter().filter(is_there).collect();
                rows.extend((!these.is_empty()).then(|| row(variant, reward, cars, &these)));
            }
        }
    }
    rows
}

fn row(variant: Variant, reward: Reward, cars: usize, cells: &[&CellResult]) -> Row {
    let all = |of: &dyn Fn(&CellResult) -> f64| cells.iter().map(|cell| of(cell)).collect::<Vec<_>>();
    let mean = |of: &dyn Fn(&CellResult) -> f64| interquartile_mean(&all(of));
    let rates = [(false, 0), (false, 1), (true, 0), (true, 1)].map(|(traffic, many)| {
        let of = |cell: &CellResult| if traffic { cell.with[many] } else { cell.without[many] };
        [mean(&|cell| of(cell).collision_rate), mean(&|cell| of(cell).completion_rate)]
    });
    let completions = all(&|cell| cell.random.completion_rate);
    let alone = Estimate { value: completions[0], interval: [completions[0]; 2], runs: 1 };
    Row {
        variant,
        reward,
        cars,
        runs: cells.len(),
        agent_steps: mean(&|cell| cell.agent_steps as f64),
        gradient_steps: mean(&|cell| cell.gradient_steps as f64),
        seconds: mean(&|cell| cell.seconds),
        reached_80: cells.iter().filter(|cell| cell.seconds_to_80.is_some()).count(),
        rates,
        completion: estimate(&[vec![completions]], |groups| pooled(&groups[0])).unwrap_or(alone),
        speed: mean(&|cell| cell.random.speed),
        offset_variance: mean(&|cell| cell.random.offset_variance),
        control_diversity: mean(&|cell| cell.random.control_diversity),
        time_up: mean(&|cell| cell.random.time_up_rate),
        duration: mean(&|cell| cell.random.seconds),
        earned: mean(&|cell| cell.random.reward),
    }
}

#[cfg(test)]
mod tests;
