use super::*;

const LIMITS: BrakeLimits = BrakeLimits { fires: 0.5, releases: 0.25 };

/// 20 seconds at 15 Hz and 20 mph, a label of ten frames from 150 on, and a value of 1.0 in a range.
fn episode(predicted: Option<Range<usize>>, has_signal: bool) -> Episode {
    let value = |i: usize| f64::from(u8::from(predicted.as_ref().is_some_and(|p| p.contains(&i))));
    Episode {
        at_s: (0..300).map(|i| f64::from(i) / 15.0).collect(),
        due: (0..300).map(|i| has_signal && (150..160).contains(&i)).collect(),
        onsets: if has_signal { vec![151] } else { vec![] },
        values: (0..300).map(|i| if i < 19 { f64::NAN } else { value(i) }).collect(),
        speed_mph: vec![20.0; 300],
        ..Episode::default()
    }
}

fn judged(episodes: &[Episode]) -> Evaluation {
    Evaluation::of(episodes, LIMITS, CountingRule::default(), 7)
}

#[test]
fn an_activation_before_the_label_is_right_for_a_guard_and_touches_nothing_by_the_papers_counting() {
    // A second ahead of the label, for five frames.
    let early = judged(&[episode(Some(135..140), true)]);
    assert_eq!((early.counts.true_positives, early.counts.false_positives), (0, 0));
    assert_eq!((early.activations.true_positives, early.activations.false_positives), (1, 0));
    let lead = early.before_pedal.unwrap();
    assert!((lead.median - 1.0).abs() < 1e-9, "{lead:?}");
    // Held until the label, it is both.
    let held = judged(&[episode(Some(135..155), true)]);
    assert_eq!((held.counts.true_positives, held.activations.true_positives), (1, 1));
    // Far too early it is neither, and it is right by the paper's counting alone if it never ends.
    let far = judged(&[episode(Some(80..85), true)]);
    assert_eq!((far.activations.true_positives, far.activations.false_positives), (0, 1));
    let always = judged(&[episode(Some(19..300), true)]);
    assert_eq!((always.counts.true_positives, always.counts.false_positives), (1, 0));
    assert_eq!((always.activations.true_positives, always.activations.false_positives), (0, 1));
}

#[test]
fn activations_are_those_of_the_bridges_brake() {
    // Two warnings a fifth of a second apart are one brake, and two that are a second apart are two.
    let mut twice = episode(Some(100..110), false);
    twice.values[103..106].fill(0.0);
    assert_eq!(twice.activations(LIMITS), [101]);
    twice.values[110..140].fill(0.0);
    twice.values[140..143].fill(0.9);
    assert_eq!(twice.activations(LIMITS), [101, 141]);
    // Between the limits it goes on.
    twice.values[110..140].fill(0.3);
    assert_eq!(twice.activations(LIMITS), [101]);
    // What it braked for is still close.
    twice.values[110..140].fill(0.0);
    twice.blocked = (0..300).map(|i| f64::from(u8::from((100..140).contains(&i)))).collect();
    assert_eq!(twice.activations(LIMITS), [101]);
    // A car that creeps is not braked.
    twice.blocked.clear();
    twice.speed_mph[..120].fill(1.4);
    assert_eq!(twice.activations(LIMITS), [141]);
}

#[test]
fn an_impact_is_foreseen_by_the_first_activation_that_may_be_for_it() {
    let hit = |predicted| Episode { impact_s: Some(10.4), ..episode(predicted, true) };
    let early = judged(&[hit(Some(135..150)), hit(Some(140..150)), hit(None)]).before_impact.unwrap();
    assert_eq!(early.count, 2);
    assert!((early.median - (10.4 - 138.5 / 15.0)).abs() < 1e-9, "{early:?}");
    assert!((early.tenth - (10.4 - 140.5 / 15.0)).abs() < 1e-9, "{early:?}");
    // Neither what comes after it nor what ended long before foresees anything, nor is there an impact in others.
    let none = judged(&[hit(Some(157..170)), hit(Some(30..40)), episode(Some(140..150), true)]);
    assert_eq!(none.before_impact, None);
}

#[test]
fn a_short_alarm_costs_a_guard_what_the_paper_forgives() {
    let alarmed = judged(&[episode(Some(100..105), false)]);
    assert_eq!((alarmed.counts.false_positives, alarmed.activations.false_positives), (0, 1));
    let per_h = alarmed.false_alarms_per_h.value.unwrap();
    assert!((per_h - 180.0).abs() < 1e-6, "one in 20 s: {per_h}");
    assert_eq!(judged(&[episode(Some(100..101), false)]).activations.false_positives, 0, "one frame alone");
}

#[test]
fn intervals_hold_the_rate_and_are_wider_with_fewer_episodes() {
    let mix = |n: usize| -> Vec<Episode> { (0..n).map(|i| episode((i % 4 != 0).then_some(150..160), true)).collect() };
    let width = |n: usize| {
        let Rate { value, interval } = judged(&mix(n)).recall;
        let [low, high] = interval.unwrap();
        assert_eq!(value, Some(0.75));
        assert!(low <= 0.75 && 0.75 <= high, "{low} {high}");
        high - low
    };
    assert!(width(8) > width(80));
    let silent = judged(&[episode(None, true)]);
    assert_eq!((silent.precision.value, silent.precision.interval, silent.recall.value), (None, None, Some(0.0)));
    assert!(silent.silent_accuracy.unwrap() > 0.99);
}

#[test]
fn the_curve_falls_from_all_found_to_none_and_a_guards_threshold_is_above_the_noise() {
    let mut weak = episode(Some(150..160), true);
    weak.values.iter_mut().for_each(|value| *value *= 0.6);
    let mut noise = episode(Some(100..120), false);
    noise.values.iter_mut().for_each(|value| *value *= 0.3);
    let episodes = [weak, noise];
    let curve = judged(&episodes).curve;
    assert_eq!((curve[0].recall, curve[0].precision), (Some(1.0), Some(0.5)));
    assert_eq!((curve[STEPS - 1].recall, curve[STEPS - 1].precision), (Some(0.0), None));
    // The noise reaches 0.3.
    let chosen = |harmless: &[Episode]| chosen_limits(&episodes, harmless, 0.5).map(|(limits, _)| limits);
    assert_eq!(chosen(&[]), Some(BrakeLimits { fires: 0.325, releases: 0.1625 }));
    assert_eq!(chosen(&episodes[..1]), chosen(&[]), "its activation is right");
}

#[test]
fn which_rule_chose_a_guards_threshold_is_told() {
    let mut weak = episode(Some(150..160), true);
    weak.values.iter_mut().for_each(|value| *value *= 0.6);
    let noise = episode(Some(100..120), false);
    let rule = |episodes: &[Episode]| chosen_limits(episodes, &[], 0.5).map(|(_, rule)| rule);
    assert_eq!(rule(std::slice::from_ref(&weak)), Some(LimitRule::NineOfTen));
    assert_eq!(rule(&[weak, noise]), Some(LimitRule::BestF1), "the noise is as strong wherever the other is found");
}

#[test]
fn no_episodes_have_no_rates() {
    let nothing = judged(&[]);
    assert_eq!((nothing.recall.value, nothing.false_alarms_per_h.value, nothing.hours), (None, None, 0.0));
    assert_eq!(chosen_limits(&[], &[], 0.5), None);
}
