//! What is put together of cells that are made up.

use super::{
    super::{Cell, Point, StudySettings},
    *,
};
use lapwing_sim::intersection::evaluation::Evaluation;

#[test]
fn the_interquartile_mean_leaves_out_a_quarter_at_each_end() {
    assert_eq!(interquartile_mean(&[9.0, 1.0, 3.0, -50.0]), 2.0);
    // Of five the second and fourth count three quarters: (0.75 x 1 + 2 + 0.75 x 3) / 2.5.
    assert!((interquartile_mean(&[0.0, 1.0, 2.0, 3.0, 100.0]) - 2.0).abs() < 1e-12);
    assert_eq!(interquartile_mean(&[4.0]), 4.0);
}

#[test]
fn a_drawdown_is_the_largest_fall_and_a_curve_that_rises_has_none() {
    let rising: Vec<f64> = (0..50).map(f64::from).collect();
    assert_eq!(drawdown(&rising), 0.0);
    let falls: Vec<f64> = (0..50).map(|i| if i < 25 { 1.0 } else { 0.4 }).collect();
    assert!((drawdown(&falls) - 0.6).abs() < 1e-12);
    assert_eq!(drawdown(&[]), 0.0);
}

fn cell(variant: Variant, seed: u64, completion: f64, seconds: f64) -> CellResult {
    let judged = Evaluation { completion_rate: completion, episodes: 10, ..Evaluation::default() };
    let point = |i: u64| Point { agent_steps: i, seconds: i as f64, reward: 0.0, completion };
    CellResult {
        cell: Cell { variant, reward: Reward::Corrected, cars: 0, seed },
        study: StudySettings::default(),
        agent_steps: 1000,
        gradient_steps: 10,
        seconds,
        seconds_to_80: None,
        curve: (0..20).map(point).collect(),
        without: [judged; 2],
        with: [judged; 2],
        random: judged,
    }
}

#[test]
fn what_is_plain_holds_what_is_contrary_fails_and_what_is_not_known_stays_open() {
    let noise = |seed: u64| seed as f64 * 0.01;
    let mut cells = Vec::new();
    for seed in 0..5 {
        cells.push(cell(Variant::Ppo, seed, 0.9 + noise(seed), 33.0));
        cells.push(cell(Variant::Maddpg, seed, 0.5 + noise(seed), 10.0 + noise(seed)));
        cells.push(cell(Variant::Batch64, seed, 0.2 + noise(seed), 10.0));
        cells.push(cell(Variant::Asynchronous, seed, 0.5 + noise(4 - seed), 10.0));
    }
    let Findings { rows, findings } = Findings::of(&cells);
    let verdict = |says: &str| findings.iter().find(|finding| finding.says.contains(says)).unwrap().verdict;
    assert_eq!(verdict("3 to 3.5 times"), Verdict::Holds);
    assert_eq!(verdict("PPO ends better"), Verdict::Holds);
    assert_eq!(verdict("64 beat 1024 at equal updates"), Verdict::Fails);
    assert_eq!(verdict("learners beat one at equal agent-steps"), Verdict::Open);
    assert_eq!(verdict("64 beat 1024 at equal samples"), Verdict::Open, "there are no runs");
    assert_eq!((rows.len(), rows[0].runs), (4, 5));
    let Estimate { value, interval: [low, high], .. } = rows[0].completion;
    assert!(low <= value && value <= high && low < high, "{:?}", rows[0]);
}

fn verdict(cells: &[CellResult], says: &str) -> Verdict {
    let Findings { findings, .. } = Findings::of(cells);
    let found: Vec<_> = findings.iter().filter(|finding| finding.says.contains(says)).collect();
    assert_eq!(found.len(), 1, "{says}");
    found[0].verdict
}

#[test]
fn a_range_holds_with_the_whole_interval_in_it_fails_with_none_of_it_and_is_open_in_between() {
    let ratio_of = |seconds: [f64; 5]| {
        let pair = |(seconds, seed)| [cell(Variant::Ppo, seed, 0.5, seconds), cell(Variant::Maddpg, seed, 0.5, 10.0)];
        let cells: Vec<_> = seconds.into_iter().zip(0..).flat_map(pair).collect();
        verdict(&cells, "3 to 3.5 times")
    };
    assert_eq!(ratio_of([31.0, 32.0, 33.0, 33.5, 34.0]), Verdict::Holds);
    assert_eq!(ratio_of([2.0, 2.1, 2.2, 2.3, 2.4]), Verdict::Fails);
    assert_eq!(ratio_of([41.0, 42.0, 43.0, 44.0, 45.0]), Verdict::Fails);
    assert_eq!(ratio_of([10.0, 10.0, 33.0, 1000.0, 1000.0]), Verdict::Open, "it says nothing");
    assert_eq!(ratio_of([28.0, 29.0, 31.0, 32.0, 34.0]), Verdict::Open, "it reaches below 3");
}

#[test]
fn where_a_variant_learnt_nothing_its_claims_are_open_and_the_others_are_not() {
    let mut cells = Vec::new();
    for seed in 0..5 {
        cells.push(cell(Variant::Ppo, seed, 0.9, 80.0));
        cells.push(cell(Variant::Maddpg, seed, 0.1, 10.0));
        cells.push(cell(Variant::Batch64, seed, 0.5, 10.0));
    }
    assert_eq!(verdict(&cells, "3 to 3.5 times"), Verdict::Fails);
    let forget = |cells: &mut [CellResult], variant: Variant| {
        let these = cells.iter_mut().filter(|cell| cell.cell.variant == variant);
        these.for_each(|cell| cell.gradient_steps = 0);
    };
    forget(&mut cells, Variant::Ppo);
    let found = ["3 to 3.5 times", "PPO ends better", "equal updates"].map(|says| verdict(&cells, says));
    assert_eq!(found, [Verdict::Open, Verdict::Open, Verdict::Holds]);
    forget(&mut cells, Variant::Maddpg);
    assert_eq!(verdict(&cells, "equal updates"), Verdict::Open);
}

#[test]
fn the_spread_is_that_of_the_first_over_seeds_less_that_of_the_second_the_mean_over_tasks() {
    let steady: Strata = vec![vec![5.0, 5.0], vec![1.0, 3.0]];
    let wild: Strata = vec![vec![0.0, 2.0], vec![0.0, 4.0]];
    assert_eq!(spread(&[wild.clone(), steady.clone()]), 1.0);
    assert_eq!(spread(&[steady, wild]), -1.0);
}

#[test]
fn what_is_said_to_be_steadier_over_seeds_holds_with_the_smaller_spread_and_fails_with_the_larger() {
    let mut cells = Vec::new();
    for seed in 0..5 {
        let at = |step: f64| 0.5 + step * seed as f64;
        cells.push(cell(Variant::Maddpg, seed, at(0.02), 10.0));
        cells.push(cell(Variant::Proportional, seed, at(0.0002), 10.0));
        cells.push(cell(Variant::Rank, seed, at(0.25), 10.0));
    }
    assert_eq!(verdict(&cells, "proportional priorities are steadier over seeds"), Verdict::Holds);
    assert_eq!(verdict(&cells, "priorities by rank are steadier over seeds"), Verdict::Fails);
    for even in &mut cells {
        even.random.completion_rate = 0.5 + 0.02 * even.cell.seed as f64;
    }
    assert_eq!(verdict(&cells, "priorities by rank are steadier over seeds"), Verdict::Open, "both alike");
}

#[test]
fn what_is_said_to_be_steadier_while_learning_holds_with_smaller_falls_and_fails_with_larger_ones() {
    let mut cells = Vec::new();
    for seed in 0..5 {
        for (variant, after) in [(Variant::Maddpg, 0.5), (Variant::Proportional, 0.8), (Variant::Rank, 0.1)] {
            let mut falling = cell(variant, seed, 0.9, 10.0);
            falling.curve[10..].iter_mut().for_each(|point| point.completion = after);
            cells.push(falling);
        }
    }
    assert_eq!(verdict(&cells, "proportional priorities are steadier while learning"), Verdict::Holds);
    assert_eq!(verdict(&cells, "priorities by rank are steadier while learning"), Verdict::Fails);
}

#[test]
fn a_curve_up_to_a_time_ends_with_the_mean_of_its_last_five_points() {
    let mut rising = cell(Variant::Maddpg, 0, 0.0, 20.0);
    rising.curve.iter_mut().for_each(|point| point.completion = point.seconds);
    let found = [7.5, 2.0, -1.0, f64::INFINITY].map(|seconds| completion_at(&rising, seconds));
    assert_eq!(found, [5.0, 1.0, 0.0, 17.0]);
}

#[test]
fn at_equal_time_the_longer_run_is_judged_by_what_it_had_reached_when_the_shorter_one_ended() {
    use Variant::{Asynchronous, Maddpg};
    for (long, short, expected) in [
        (Asynchronous, Maddpg, [Verdict::Holds, Verdict::Fails]),
        (Maddpg, Asynchronous, [Verdict::Fails, Verdict::Holds]),
    ] {
        let mut cells = Vec::new();
        for seed in 0..5 {
            // After 10 s it has reached less, in the end more.
            let mut late = cell(long, seed, 0.9, 20.0);
            late.curve[..11].iter_mut().for_each(|point| point.completion = 0.2);
            cells.extend([late, cell(short, seed, 0.5, 10.0)]);
        }
        let found = ["equal agent-steps", "equal time"].map(|says| verdict(&cells, &format!("one at {says}")));
        assert_eq!(found, expected, "{long:?} takes longer");
        // Runs of another seed end earlier, and say nothing of these.
        cells.iter_mut().filter(|cell| cell.cell.variant == short).for_each(|cell| cell.seconds = 20.0);
        cells.push(cell(short, 5, 0.5, 1.0));
        cells.push(cell(long, 5, 0.5, 1.0));
        let then = verdict(&cells, "one at equal time");
        assert_eq!(then, expected[0], "{long:?} takes as long");
    }
}
