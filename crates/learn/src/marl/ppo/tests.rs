//! PPO's formulas against figures found by hand, what a rollout holds, and that it learns.

use super::*;
use crate::nn::runtime;
use lapwing_sim::intersection::{AGENTS, Buffers};

/// With 32 agents, all in one part.
fn small(critic: Critic, seed: u64) -> Ppo {
    of_size(8, PpoSettings { critic, seed, ..PpoSettings::default() })
}

fn of_size(intersections: usize, settings: PpoSettings) -> Ppo {
    runtime::set_threads(1);
    Ppo::new(PpoSettings { intersections, steps: 64, minibatch: 256, ..settings }, World::default()).unwrap()
}

/// A whole rollout.
fn drive(ppo: &mut Ppo) {
    draw_luck(&mut ppo.parts, ppo.settings.steps, &mut ppo.random);
    collect(&mut ppo.parts, &ppo.networks, &ppo.settings).unwrap();
}

/// Actions and values for what was seen, without driving.
fn look(ppo: &mut Ppo) {
    draw_luck(&mut ppo.parts, ppo.settings.steps, &mut ppo.random);
    for part in &mut ppo.parts {
        (0..ppo.settings.steps).for_each(|step| part.act(step, &ppo.networks).unwrap());
        part.judge(&ppo.networks).unwrap();
    }
}

fn numbers(tensor: &Tensor) -> Vec<f32> {
    Vec::try_from(tensor.detach().flatten(0, -1)).unwrap()
}

fn of(numbers: &[f32]) -> Tensor {
    Tensor::from_slice(numbers)
}

/// Of the actor.
fn weights(ppo: &Ppo) -> Vec<f32> {
    ppo.actor().weights().iter().flat_map(|(_, weight)| numbers(weight)).collect()
}

/// Whatever an agent sees, its actions are as likely as these logits say.
fn prefer(ppo: &Ppo, logits: [f32; ACTIONS]) {
    let weights = ppo.networks.actor.weights();
    let [.., (_, weight), (_, bias)] = &weights[..] else { panic!("no last layer") };
    no_grad(|| {
        let _ = weight.detach().zero_();
        bias.detach().copy_(&of(&logits));
    });
}

#[test]
fn advantages_end_with_an_episode_and_one_that_is_truncated_is_worth_what_it_promises() {
    // What nobody may count.
    const NONE: f32 = 100.0;
    // Values before each step and after the last; rewards; d: drove, x: and was terminated, t: truncated, -: was not there.
    let drives = ([1.0, 2.0, 3.0, 4.0, 5.0], [1.0; 4]);
    let ended = ([1.0, 2.0, NONE, 4.0, 6.0], [1.0, -3.0, NONE, 2.0]);
    let promising = ([1.0, 2.0, 8.0, 4.0, 6.0], [1.0, -3.0, NONE, 2.0]);
    let all = [
        (drives, "dddd", [1.061_523_4, 0.492_187_5, -0.0625, -0.5]),
        (drives, "dddt", [1.061_523_4, 0.492_187_5, -0.0625, -0.5]),
        (drives, "dddx", [1.056_640_6, 0.453_125, -0.375, -3.0]),
        (ended, "dx-d", [0.375, -5.0, 0.0, 1.0]),
        (promising, "dt-d", [0.875, -1.0, 0.0, 1.0]),
        // A new episode begins at once.
        (drives, "dxdd", [0.875, -1.0, -0.0625, -0.5]),
        (drives, "dtdd", [1.0625, 0.5, -0.0625, -0.5]),
        (drives, "----", [0.0; 4]),
    ];
    let mut rollout = Rollout::default();
    for step in 0..4 {
        for ((values, rewards), went, _) in &all {
            let went = went.as_bytes()[step];
            rollout.values.push(values[step]);
            rollout.rewards.push(rewards[step]);
            rollout.drove.push(went != b'-');
            rollout.terminated.push(went == b'x');
            rollout.truncated.push(went == b't');
        }
    }
    rollout.values.extend(all.iter().map(|((values, _), ..)| values[4]));
    rollout.advantages = vec![f32::NAN; 4 * all.len()];
    rollout.estimate_advantages(all.len(), 0.5, 0.25);
    for (agent, (_, went, expected)) in all.iter().enumerate() {
        let found: Vec<f32> = (0..4).map(|step| rollout.advantages[step * all.len() + agent]).collect();
        assert_eq!(found, expected, "{went}");
    }
}

#[test]
fn values_explain_the_returns_as_far_as_they_are_right_where_somebody_drove() {
    let found = |values: [f32; 4], advantages: [f32; 4]| {
        let drove = vec![true, true, true, false];
        let all = Rollout { values: values.to_vec(), advantages: advantages.to_vec(), drove, ..Rollout::default() };
        explained([&all].into_iter())
    };
    // The returns are 1, 2 and 3.
    assert!((found([1.0, 2.0, 3.0, 50.0], [0.0, 0.0, 0.0, 9.0]) - 1.0).abs() < 1e-9);
    assert!(found([2.0, 2.0, 2.0, 50.0], [-1.0, 0.0, 1.0, 9.0]).abs() < 1e-9);
    assert!(found([3.0, 2.0, 1.0, 50.0], [-2.0, 0.0, 2.0, 9.0]) < -2.9);
}

#[test]
fn the_surrogate_rewards_likelier_good_actions_up_to_a_fifth_and_rarer_bad_ones_down_to_a_fifth() {
    for (advantage, ratio, loss, slope) in [
        (1.0, 1.0, -1.0, -1.0),
        (1.0, 1.1, -1.1, -1.0),
        (1.0, 1.3, -1.2, 0.0),
        (1.0, 0.7, -0.7, -1.0), // too rare: back without a limit
        (-1.0, 1.0, 1.0, 1.0),
        (-1.0, 0.9, 0.9, 1.0),
        (-1.0, 0.7, 0.8, 0.0),
        (-1.0, 1.3, 1.3, 1.0),
        (-3.0, 0.5, 2.4, 0.0),
    ] {
        let ratios = of(&[ratio, ratio]).set_requires_grad(true);
        let found = surrogate(&of(&[advantage, advantage]), &ratios, 0.2).unwrap();
        found.backward();
        let slopes: f32 = numbers(&ratios.grad()).iter().sum();
        let near = |a: f64, b: f64| (a - b).abs() < 1e-6;
        assert!(near(found.double_value(&[]), loss), "{advantage} at {ratio}: {found:?}, expected {loss}");
        assert!(near(f64::from(slopes), slope), "{advantage} at {ratio}: {slopes}, expected {slope}");
    }
    let both = surrogate(&of(&[1.0, -1.0]), &of(&[1.3, 1.3]), 0.2).unwrap();
    assert!((both.double_value(&[]) - 0.05).abs() < 1e-6, "the mean of -1.2 and 1.3");
}

#[test]
fn the_value_is_led_to_its_target_by_a_fifth_at_a_time() {
    // What it was, what it is, where it should be; loss and slope.
    for (was, value, target, loss, slope) in [
        (0.0, 0.1, 1.0, 0.405, -0.9),
        (0.0, 0.5, 1.0, 0.32, 0.0), // further than it may go: (0.2 - 1)^2 / 2
        (0.0, -0.5, 1.0, 1.125, -1.5),
        (0.0, 1.5, 1.0, 0.32, 0.0),
        (0.0, 2.5, 1.0, 1.125, 1.5),
        (3.0, 2.0, 2.0, 0.32, 0.0), // it is there, but in one leap
        (2.0, 2.0, 2.0, 0.0, 0.0),
    ] {
        let values = of(&[value, value]).set_requires_grad(true);
        let found = value_loss(&values, &of(&[was, was]), &of(&[target, target]), 0.2).unwrap();
        found.backward();
        let slopes: f32 = numbers(&values.grad()).iter().sum();
        assert!((found.double_value(&[]) - loss).abs() < 1e-6, "{was}, {value}, {target}: {found:?}");
        assert!((slopes - slope).abs() < 1e-6, "{was}, {value}, {target}: {slopes}, expected {slope}");
    }
}

#[test]
fn advantages_are_brought_to_a_mean_of_0_and_a_deviation_of_1() {
    let found = numbers(&normalised(&of(&[1.0, 3.0, 5.0])).unwrap());
    assert!(found.iter().zip([-1.0, 0.0, 1.0]).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}");
    assert_eq!(numbers(&normalised(&of(&[2.0, 2.0])).unwrap()), [0.0, 0.0]);
}

#[test]
fn actions_are_drawn_as_often_as_the_policy_says_and_their_probabilities_are_told() {
    let mut ppo = small(Critic::Own, 1);
    prefer(&ppo, [0.0, 1.0, -1.0, 2.0]);
    let shares = [0.0871, 0.2369, 0.0321, 0.6439];
    let (mut counts, rows) = ([0_u32; ACTIONS], ppo.parts[0].rollout.actions.len());
    for _ in 0..4 {
        look(&mut ppo);
        let rollout = &ppo.parts[0].rollout;
        for (action, log) in rollout.actions.iter().zip(&rollout.log_probabilities) {
            counts[usize::from(*action)] += 1;
            assert!((log.exp() - shares[usize::from(*action)]).abs() < 1e-3, "{action}: {log}");
        }
    }
    for (count, share) in counts.iter().zip(shares) {
        let found = *count as f32 / (4 * rows) as f32;
        assert!((found - share).abs() < 0.02, "{counts:?}: {found}, expected {share}");
    }
}

#[test]
fn a_rollout_holds_what_was_seen_before_each_step_and_what_the_step_then_gave() {
    let mut ppo = small(Critic::Central, 2);
    let (agents, each) = (ppo.parts[0].world.agents(), ppo.parts[0].world.numbers());
    let rows = ppo.settings.steps * agents;
    let mut gone = 0;
    // The second goes on where the first one ended.
    for _ in 0..2 {
        let mut world = ppo.parts[0].world.clone();
        drive(&mut ppo);
        let ([part], networks) = (&ppo.parts[..], &ppo.networks) else { panic!("expected one part") };
        let rollout = &part.rollout;
        let seen = part.seen(0, rows, &networks.scale).unwrap();
        let situations = part.situations(0, rows).unwrap();
        let logs = numbers(&networks.actor.forward(&seen).unwrap().log_softmax(1, Kind::Float));
        let values = numbers(&networks.value(&seen, situations.as_ref()).unwrap());
        let situations = numbers(&situations.unwrap());
        let (mut observations, mut states) = (vec![0.0; agents * each], vec![0.0; agents / AGENTS * STATE]);
        let (mut rewards, mut flags) = (vec![0.0; agents], [(); 3].map(|()| vec![false; agents]));
        for step in 0..ppo.settings.steps {
            world.observe(&mut observations);
            world.states(&mut states);
            let before = observations.clone();
            let [drove, terminated, truncated] = &mut flags;
            let buffers =
                Buffers { observations: &mut observations, rewards: &mut rewards, drove, terminated, truncated };
            world.step(&rollout.actions[step * agents..][..agents], buffers);
            let at = step * agents..(step + 1) * agents;
            let [drove, terminated, truncated] = &flags;
            assert_eq!((&rollout.drove[at.clone()], &rollout.terminated[at.clone()]), (&drove[..], &terminated[..]));
            assert_eq!(&rollout.truncated[at], truncated);
            for agent in 0..agents {
                let row = step * agents + agent;
                assert_eq!(rollout.rewards[row], rewards[agent] * ppo.settings.reward_scale);
                if !drove[agent] {
                    gone += 1;
                    continue;
                }
                assert_eq!(rollout.observations[row * each..][..each], before[agent * each..][..each], "{row}");
                assert_eq!(situations[row * STATE..][..STATE], states[agent / AGENTS * STATE..][..STATE], "{row}");
                assert!((values[row] - rollout.values[row]).abs() < 1e-4, "{row}");
                let log = logs[row * ACTIONS + usize::from(rollout.actions[row])];
                assert!((log - rollout.log_probabilities[row]).abs() < 1e-4, "{row}");
            }
        }
        world.observe(&mut observations);
        let there = |agent: &usize| world.environments()[agent / AGENTS].alive()[agent % AGENTS];
        for agent in (0..agents).filter(there) {
            assert_eq!(rollout.observations[(rows + agent) * each..][..each], observations[agent * each..][..each]);
        }
    }
    assert!(gone > 0, "otherwise everybody drove all the time");
}

#[test]
fn agents_that_are_not_there_do_not_count() {
    for critic in [Critic::Own, Critic::Central] {
        let learn = |spoil: bool| {
            // Of 32 intersections and of 8.
            let mut ppo = of_size(40, PpoSettings { critic, seed: 3, ..PpoSettings::default() });
            drive(&mut ppo);
            for Part { world, rollout, .. } in &mut ppo.parts {
                let each = world.numbers();
                rollout.estimate_advantages(world.agents(), 0.99, 0.95);
                let gone: Vec<usize> = (0..rollout.drove.len()).filter(|row| !rollout.drove[*row]).collect();
                assert!(gone.len() > 20);
                for row in gone.into_iter().filter(|_| spoil) {
                    rollout.observations[row * each..][..each].fill(f32::NAN);
                    rollout.actions[row] = 3;
                    rollout.log_probabilities[row] = f32::NAN;
                    rollout.values[row] = f32::NAN;
                    rollout.advantages[row] = f32::NAN;
                }
            }
            let before = weights(&ppo);
            let losses = ppo.learn(1e-3, 0.01).unwrap();
            let after: Vec<f32> = ppo.tensors().iter().flat_map(|(_, tensor)| numbers(tensor)).collect();
            assert!(before != after[..before.len()], "it learnt");
            (losses, explained(ppo.rollouts()), after)
        };
        assert!(learn(true) == learn(false), "{critic:?}");
    }
}

#[test]
fn the_entropys_weight_makes_the_policy_more_even_and_without_it_nothing_changes_it_where_all_is_as_good() {
    let mut ppo = small(Critic::Own, 4);
    prefer(&ppo, [2.0, 0.0, 0.0, 0.0]);
    let before = weights(&ppo);
    look(&mut ppo);
    ppo.parts[0].rollout.drove.fill(true);
    let [.., even, moved, _] = ppo.learn(1e-2, 0.0).unwrap();
    // Probabilities of 0.7113 and three times 0.0963.
    assert!((even - 0.9185).abs() < 1e-3 && moved.abs() < 1e-6 && weights(&ppo) == before, "{even}");
    let more = (0..5).map(|_| ppo.learn(1e-2, 1.0).unwrap()[2]).collect::<Vec<_>>();
    assert!(more[0] > even && more[4] > 1.3, "{more:?}: at most ln 4 is 1.386");
}

#[test]
fn what_is_paid_is_learnt_by_the_policy_and_by_the_value_and_those_who_are_gone_teach_nothing() {
    let mut ppo = small(Critic::Own, 5);
    let each = ppo.parts[0].world.numbers();
    // Where the lane's middle is on one side the first action is paid, otherwise the third; one side pays more.
    let wanted = |offset: f32| if offset > 0.0 { 2 } else { 0 };
    let paid = |offset: f32, action: u8| f32::from(action == wanted(offset)) + offset;
    for _ in 0..30 {
        let rollout = &mut ppo.parts[0].rollout;
        rollout.observations.fill(0.0);
        for seen in rollout.observations.chunks_exact_mut(each) {
            seen[2] = if ppo.random.random_bool(0.5) { 1.0 } else { -1.0 };
        }
        look(&mut ppo);
        let rollout = &mut ppo.parts[0].rollout;
        for row in 0..rollout.drove.len() {
            let (offset, action) = (rollout.observations[row * each + 2], rollout.actions[row]);
            rollout.drove[row] = row % 3 > 0;
            rollout.rewards[row] = if row % 3 > 0 { paid(offset, action) } else { 100.0 * f32::from(action == 1) };
            rollout.terminated[row] = true;
        }
        rollout.estimate_advantages(32, 0.99, 0.95);
        ppo.learn(2e-3, 0.0).unwrap();
    }
    assert!(explained(ppo.rollouts()) > 0.9, "{}", explained(ppo.rollouts()));
    for offset in [-1.0_f32, 1.0] {
        ppo.parts[0].rollout.observations[2] = offset;
        let seen = ppo.parts[0].seen(0, 1, &ppo.networks.scale).unwrap();
        let likely = numbers(&ppo.actor().forward(&seen).unwrap().softmax(1, Kind::Float));
        assert!(likely[usize::from(wanted(offset))] > 0.9, "{offset}: {likely:?}");
        let value = ppo.networks.value(&seen, None).unwrap().double_value(&[0]);
        assert!((value - f64::from(1.0 + offset)).abs() < 0.2, "{offset}: {value}");
    }
}

#[test]
fn the_same_is_learnt_however_many_collectors_there_are() {
    for critic in [Critic::Own, Critic::Central] {
        let train = |collectors| {
            // 32 intersections, 32 and 6.
            let mut ppo = of_size(70, PpoSettings { critic, collectors, seed: 6, ..PpoSettings::default() });
            let updates = [(); 3].map(|()| ppo.update(&|| false).unwrap());
            assert!(updates.iter().map(|update| update.episodes).sum::<u64>() > 0);
            (updates, ppo.tensors().iter().flat_map(|(_, tensor)| numbers(tensor)).collect::<Vec<_>>())
        };
        let one = train(1);
        for collectors in [2, 3, 5] {
            assert!(train(collectors) == one, "{critic:?}, {collectors} collectors");
        }
    }
}

#[test]
fn what_an_agent_did_is_learnt_with_what_it_saw_in_whichever_part_it_was() {
    for critic in [Critic::Own, Critic::Central] {
        let settings = PpoSettings { critic, epochs: 1, seed: 7, ..PpoSettings::default() };
        let mut ppo = of_size(40, settings);
        // All agents in one batch, and a policy that is less even than at first.
        ppo.settings.minibatch = 40 * AGENTS * ppo.settings.steps;
        no_grad(|| {
            let _ = ppo.actor().weights()[4].1.detach().f_mul_scalar_(300.0);
        });
        drive(&mut ppo);
        let [_, _, entropy, moved, _] = ppo.learn(1e-4, 0.0).unwrap();
        assert!(entropy < 1.2 && moved.abs() < 1e-5, "{critic:?}: {entropy}, {moved}");
    }
}
