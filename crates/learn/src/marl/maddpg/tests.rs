//! What the replay memory is fed with, and what changes in the course of a training.

use super::*;
use lapwing_sim::intersection::{Action, Settings, Sight};

/// One intersection, whose agents do the same whatever they see.
fn always(action: Action) -> Maddpg {
    crate::nn::runtime::set_threads(1);
    let settings = MaddpgSettings {
        agent_steps: 1000,
        intersections: 1,
        memory: 3000,
        replay: Replay::Proportional,
        hidden: 8,
        ..MaddpgSettings::default()
    };
    let intersection = Settings { sight: Sight::Routes, ..Settings::default() };
    let maddpg = Maddpg::new(settings, World { intersection, mixed: false }).unwrap();
    let mut logits = [0.0_f32; ACTIONS];
    logits[action as usize] = 50.0; // more than any noise
    let weights = maddpg.core.networks.actor.weights();
    let [.., (_, weight), (_, bias)] = &weights[..] else { panic!("no last layer") };
    no_grad(|| {
        let _ = weight.detach().zero_();
        bias.detach().copy_(&Tensor::from_slice(&logits));
    });
    maddpg
}

#[test]
fn what_agents_see_when_their_time_is_up_counts_in_the_replay_and_what_they_see_after_a_crash_does_not() {
    for (action, steps, goes_on) in [(Action::SlowDown, 1000..=1000, true), (Action::KeepLane, 10..=999, false)] {
        let mut maddpg = always(action);
        let mut row = 0;
        while row == 0 || !maddpg.collector.world.environments()[0].is_over() {
            let Maddpg { collector, core, settings, memory, .. } = &mut maddpg;
            collector.step(&core.networks.actor, settings).unwrap();
            memory.push(collector.moment());
            row += 1;
        }
        assert!(steps.contains(&row), "{action:?}: {row} steps");
        let Collector { observations, drove, truncated, terminated, .. } = &maddpg.collector;
        assert_eq!((truncated.contains(&true), terminated.contains(&true)), (goes_on, !goes_on));
        // Such errors that the last moment alone is drawn.
        let errors: Vec<f32> = (1..=row).map(|of| if of == row { 1e9 } else { 0.0 }).collect();
        maddpg.memory.update(&(1..=row).collect::<Vec<_>>(), &errors);
        maddpg.memory.draw(16, 1.0, &mut maddpg.random, &mut maddpg.drawing);
        let (drawing, numbers) = (&maddpg.drawing, Sight::Routes.numbers());
        assert_eq!(drawing.rows, [row; 16]);
        let seats: Vec<usize> = (0..AGENTS).filter(|seat| drove[*seat]).collect();
        assert_eq!(drawing.then.len(), 16 * seats.len());
        let nobody = (drawing.next.len() / numbers - 1) as i64;
        for (i, then) in drawing.then.iter().enumerate() {
            let seen = &observations[seats[i % seats.len()] * numbers..][..numbers];
            let next = &drawing.next[*then as usize * numbers..][..numbers];
            assert_eq!((*then < nobody, next == seen), (goes_on, goes_on), "{action:?}");
        }
    }
}

#[test]
fn the_priorities_bias_is_undone_wholly_in_the_end_and_the_learning_rates_fall_to_almost_nothing() {
    let mut maddpg = always(Action::KeepLane);
    for (agent_steps, beta, share) in [(0, 0.4, 1.0), (500, 0.7, 0.5), (1000, 1.0, 1e-3), (2000, 1.0, 1e-3)] {
        maddpg.collector.agent_steps = agent_steps;
        let found = (maddpg.beta(), maddpg.share_of_rates());
        assert!((found.0 - beta).abs() < 1e-12 && (found.1 - share).abs() < 1e-12, "{agent_steps}: {found:?}");
    }
    maddpg.settings.rates_fall = false;
    assert_eq!(maddpg.share_of_rates(), 1.0);
}

#[test]
fn a_gradient_step_is_due_for_each_so_many_transitions_after_the_warm_up() {
    let settings = MaddpgSettings { every: 100.0, warm_up: 10_000, ..MaddpgSettings::default() };
    let due = |origin: Origin| [10_099, 10_100, 30_000].map(|transitions| origin.due(&settings, transitions));
    assert_eq!(due(Origin::default()), [0, 1, 200]);
    // The memory is filled anew after a pause.
    assert_eq!(due(Origin { steps: 7, transitions: 5000 }), [7, 7, 157]);
    let few = MaddpgSettings { warm_up: 0, batch: 1024, ..settings };
    assert_eq!([1123, 1124].map(|transitions| Origin::default().due(&few, transitions)), [0, 1]);
}
