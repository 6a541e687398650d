//! The environment as a whole.

use super::{
    parallel::Parallel,
    roads::{Arm, Turn, way_of},
    *,
};

/// Drives an episode; returns the last state.
fn episode(settings: Settings, seed: u64, act: impl Fn(&Environment, usize) -> Action) -> Environment {
    let mut environment = Environment::new(settings, seed);
    while !environment.is_over() {
        environment.step(std::array::from_fn(|i| act(&environment, i)));
    }
    environment
}

/// Mean undiscounted return of the agents.
fn earned(environment: &Environment) -> f32 {
    environment.tallies().iter().map(|tally| tally.reward).sum::<f32>() / AGENTS as f32
}

/// What an agent earns on the benchmark's mission if it has the roads for itself.
fn alone(settings: Settings, agent: usize) -> f32 {
    let mut environment = Environment::new(settings, 0);
    environment.leave_only(agent);
    while !environment.is_over() {
        environment.step(std::array::from_fn(|i| scripted::act(&environment, i)));
    }
    assert_eq!(environment.endings()[agent], Some(Ending::Goal));
    environment.tallies()[agent].reward
}

/// Shares of agents that crashed and that reached their goals, over so many episodes.
fn rates(settings: Settings, episodes: u64, act: impl Fn(&Environment, usize) -> Action) -> (f64, f64) {
    let (mut crashed, mut reached) = (0, 0);
    for seed in 0..episodes {
        for ending in episode(settings, seed, &act).endings() {
            crashed += u64::from(matches!(ending, Some(Ending::Crash(_))));
            reached += u64::from(ending == Some(Ending::Goal));
        }
    }
    let all = (episodes * AGENTS as u64) as f64;
    (crashed as f64 / all, reached as f64 / all)
}

const BUSY: Settings = Settings {
    missions: Missions::Random,
    cars: CARS,
    reward: Reward::Corrected,
    axes: Axes::World,
    sight: Sight::Sectors,
};

#[test]
fn idling_earns_499_under_the_benchmarks_reward_and_driving_through_about_63() {
    let idle = episode(Settings::default(), 0, |_, _| Action::SlowDown);
    assert_eq!(idle.endings(), [Some(Ending::TimeUp); AGENTS]);
    // On its way to a standstill the car comes nearer to its goal and earns some two points more.
    assert!((499.0..503.0).contains(&earned(&idle)), "{}", earned(&idle));
    // Each alone, so that nobody waits, which would pay, too.
    let through: Vec<f32> = (0..AGENTS).map(|i| alone(Settings::default(), i)).collect();
    let mean = through.iter().sum::<f32>() / AGENTS as f32;
    assert!((60.0..66.0).contains(&mean), "{through:?}");
    let waiting = earned(&episode(Settings::default(), 0, scripted::act));
    assert!(waiting > mean + 10.0, "{waiting}");
}

#[test]
fn idling_does_not_pay_under_the_corrected_reward_and_crashing_pays_less() {
    let settings = Settings { reward: Reward::Corrected, ..Settings::default() };
    let idle = earned(&episode(settings, 0, |_, _| Action::SlowDown));
    let through = earned(&episode(settings, 0, scripted::act));
    let blind = episode(settings, 0, |_, _| Action::KeepLane);
    assert!((-30.0..-20.0).contains(&idle), "{idle} {:?}", episode(settings, 0, |_, _| Action::SlowDown).tallies());
    assert!((35.0..50.0).contains(&through), "{through}");
    assert!(earned(&blind) < idle, "{}, endings {:?}", earned(&blind), blind.endings());
}

#[test]
fn known_good_and_known_bad_drivers_come_out_apart() {
    for missions in [Missions::Benchmark, Missions::Random] {
        let settings = Settings { missions, ..Settings::default() };
        let (good, bad) = (rates(settings, 100, scripted::act), rates(settings, 100, |_, _| Action::KeepLane));
        assert!(good.0 <= 0.01 && good.1 >= 0.98, "{missions:?}: crashes and goals {good:?}");
        assert!(bad.1 < 0.6, "{missions:?}: crashes and goals {bad:?}");
    }
}

#[test]
fn the_same_seed_and_actions_give_the_same_episode_bit_by_bit() {
    let drive = |seed| {
        let mut batch = Batch::new(BUSY, 3, seed);
        let agents = batch.agents();
        let mut observations = vec![0.0; agents * OBSERVATION];
        let (mut rewards, mut flags) = (vec![0.0; agents], [(); 3].map(|()| vec![false; agents]));
        let mut all = Vec::new();
        for step in 0..400_usize {
            let actions: Vec<u8> = (0..agents).map(|i| ((step / 7 + i * 3) % 11 / 3) as u8).collect();
            let [drove, terminated, truncated] = &mut flags;
            let buffers =
                Buffers { observations: &mut observations, rewards: &mut rewards, drove, terminated, truncated };
            batch.step(&actions, buffers);
            all.extend(observations.iter().chain(&rewards).map(|number| number.to_bits()));
        }
        all
    };
    assert!(drive(5) == drive(5));
    assert!(drive(5) != drive(6));
}

#[test]
fn a_batch_that_is_split_keeps_its_intersections_in_their_order() {
    let seen = |batch: &Batch| {
        let mut observations = vec![0.0; batch.agents() * OBSERVATION];
        batch.observe(&mut observations);
        observations
    };
    let whole = Batch::mixed(BUSY, 5, 3);
    let parts = whole.clone().split(2);
    assert_eq!(parts.iter().map(Batch::agents).collect::<Vec<_>>(), [8, 8, 4]);
    assert!(parts.iter().flat_map(seen).collect::<Vec<_>>() == seen(&whole));
    let settings = |batch: &Batch| batch.environments().iter().map(Environment::settings).collect::<Vec<_>>();
    assert_eq!(parts.iter().flat_map(settings).collect::<Vec<_>>(), settings(&whole));
    assert_eq!(whole.split(8).len(), 1);
}

/// Whoever drives, and however badly.
#[test]
fn background_cars_never_crash_among_themselves_in_a_million_steps() {
    assert_eq!(crashes_among_traffic(1_000_000), 0);
}

/// Crashes in so many car-steps: half of the episodes with agents that obey, half with agents that do anything.
fn crashes_among_traffic(steps: usize) -> usize {
    let (mut car_steps, mut crashes, mut seed) = (0, 0, 0);
    while car_steps < steps {
        seed += 1;
        let mut environment = Environment::new(BUSY, seed);
        // Longer than the agents are there.
        for step in 0..300_usize {
            let actions = std::array::from_fn(|i| {
                if seed % 2 == 0 {
                    scripted::act(&environment, i)
                } else {
                    Action::of(((seed as usize * 31 + step / (5 + i) * 17 + i * 7) % 9 / 2) as u8)
                }
            });
            environment.step(actions);
            car_steps += environment.traffic().count();
            crashes += environment.crashes_among_traffic();
        }
    }
    crashes
}

#[test]
fn crashes_among_background_cars_are_counted_where_there_are_some() {
    let mut environment = Environment::new(Settings::default(), 0);
    let way = way_of(Arm::East, Turn::Straight, 1);
    // Alone; a hand's breadth behind the first; touching it; touching that one and the first.
    for (along, expected) in [(20.0, 0), (20.0 - LENGTH_M - 0.1, 0), (20.0 + LENGTH_M - 0.1, 1), (22.0, 3)] {
        environment.traffic_mut().put(way, along, 0.0);
        assert_eq!(environment.crashes_among_traffic(), expected, "{along} m");
    }
}

/// Two cars that would be at the point where their ways cross at the same time, without agents. Returns pairs that touched,
/// added up over the steps, and whether each got through.
fn meet(right: Right) -> (usize, [bool; 2]) {
    let mut environment = Environment::new(Settings::default(), 0);
    environment.leave_only(0);
    environment.leave_only(1);
    assert!(environment.is_over());
    for (from, lane, into_m) in [(Arm::South, 1, 5.6), (Arm::West, 0, 12.0)] {
        let way = way_of(from, Turn::Straight, lane);
        let traffic = environment.traffic_mut();
        let i = traffic.put(way, roads::ALL[way].approach_m + into_m - 25.0, 8.0);
        traffic.right[i] = right;
    }
    let (mut crashes, mut through) = (0, [false; 2]);
    for _ in 0..150 {
        environment.step([Action::SlowDown; AGENTS]);
        crashes += environment.crashes_among_traffic();
        (0..2).for_each(|i| through[i] |= environment.traffic().right[i] == Right::Past);
    }
    (crashes, through)
}

#[test]
fn two_cars_that_are_both_let_in_crash_and_two_that_ask_do_not() {
    assert!(meet(Right::Granted).0 > 0);
    assert_eq!(meet(Right::None), (0, [true; 2]));
}

#[test]
fn traffic_flows_and_nobody_waits_for_ever() {
    let mut environment = Environment::new(BUSY, 3);
    let (mut passed, mut longest) = (0, 0);
    let mut before = environment.traffic().present;
    for step in 0..3000 {
        // The agents' cars are gone within seconds, and the traffic is alone.
        environment.step([Action::KeepLane; AGENTS]);
        let traffic = environment.traffic();
        passed += (0..CARS).filter(|j| before[*j] && !traffic.present[*j]).count();
        before = traffic.present;
        let waits = (0..CARS).filter(|j| traffic.present[*j] && traffic.right[*j] == Right::Asked);
        longest = waits.map(|j| step - traffic.since[j].min(step)).max().unwrap_or(0).max(longest);
    }
    assert!(passed > 60, "{passed} cars in five minutes");
    assert!(longest < 600, "{longest} steps");
}

#[test]
fn an_episode_is_truncated_after_1000_steps_and_the_next_step_begins_a_new_one() {
    let mut batch = Batch::new(Settings::default(), 1, 0);
    let mut observations = vec![0.0; AGENTS * OBSERVATION];
    let (mut rewards, mut flags) = (vec![0.0; AGENTS], [(); 3].map(|()| vec![false; AGENTS]));
    let mut step = |batch: &mut Batch| {
        let [drove, terminated, truncated] = &mut flags;
        let buffers = Buffers { observations: &mut observations, rewards: &mut rewards, drove, terminated, truncated };
        batch.step(&[1; AGENTS], buffers);
        (flags.clone(), rewards.clone())
    };
    for _ in 0..999 {
        step(&mut batch);
    }
    assert_eq!(batch.finished().count(), 0);
    let ([drove, terminated, truncated], rewards) = step(&mut batch);
    assert_eq!((drove, terminated, truncated), (vec![true; 4], vec![false; 4], vec![true; 4]));
    assert!(rewards.iter().all(|reward| (reward + 0.5).abs() < 1e-3), "{rewards:?}");
    assert!(batch.finished().flatten().all(|(ending, tally)| ending == Ending::TimeUp && tally.steps == 1000));
    let ([drove, _, truncated], rewards) = step(&mut batch);
    assert_eq!((drove, truncated, rewards), (vec![false; 4], vec![false; 4], vec![0.0; 4]));
    assert_eq!(step(&mut batch).0[0], vec![true; 4]);
}

#[test]
fn an_agent_that_drives_past_its_goal_leaves_the_road_at_its_end() {
    // It lets the others go first, and stays in the wrong lane.
    let environment = episode(Settings::default(), 0, |environment, i| match i {
        1 if environment.steps() < 100 => Action::SlowDown,
        1 => Action::KeepLane,
        _ => scripted::act(environment, i),
    });
    assert_eq!(environment.endings()[1], Some(Ending::OffRoad), "{:?}", environment.endings());
}

#[test]
fn leaving_the_road_costs_as_much_as_a_crash_and_ends_the_episode_for_good() {
    for reward in [Reward::Smarts, Reward::Corrected] {
        let mut environment = Environment::new(Settings { reward, ..Settings::default() }, 0);
        environment.leave_only(1);
        let mut last = Step::default();
        let mut most = f32::NEG_INFINITY;
        while !environment.is_over() {
            last = environment.step([Action::KeepLane; AGENTS]);
            if !environment.is_over() {
                assert!(last.rewards[1] > -5.0, "{reward:?}: {last:?}");
            }
            most = most.max(last.rewards[1]);
        }
        assert_eq!(environment.endings()[1], Some(Ending::OffRoad), "it stays in the wrong lane");
        assert!((-52.0..-48.0).contains(&last.rewards[1]) && most < 5.0, "{reward:?}: {last:?}");
        assert_eq!((last.terminated[1], last.truncated[1]), (true, false));
    }
}

#[test]
fn an_observation_of_sectors_is_the_last_three_frames_the_oldest_first() {
    let settings = Settings { cars: CARS, ..Settings::default() };
    let mut environment = Environment::new(settings, 1);
    let now = |environment: &Environment| {
        let mut frame = [0.0; FRAME];
        observation::observe(
            environment.agents(),
            0,
            environment.alive(),
            environment.traffic(),
            settings.axes,
            &mut frame,
        );
        frame
    };
    // At first all three are the first one.
    let mut frames = vec![now(&environment); 3];
    for _ in 0..5 {
        assert_eq!(environment.observation(0), frames[frames.len() - 3..].as_flattened());
        environment.step([Action::SlowDown; AGENTS]);
        assert_eq!(environment.alive(), [true; AGENTS]);
        frames.push(now(&environment));
        assert!(frames[frames.len() - 1] != frames[frames.len() - 2]);
    }
}

#[test]
fn agents_whose_time_is_up_are_still_in_the_situation_and_those_that_reached_their_goals_are_not() {
    let of = |environment: &Environment| {
        let mut state = [f32::NAN; STATE];
        environment.state(&mut state);
        state
    };
    let mut environment = Environment::new(Settings::default(), 0);
    environment.leave_only(1);
    let (before, mut after) = (of(&environment), [0.0; STATE]);
    while !environment.is_over() {
        environment.step([Action::SlowDown; AGENTS]);
        after = of(&environment);
    }
    for state in [before, after] {
        assert_eq!([state[0], state[9], state[18], state[27]], [0.0, 1.0, 0.0, 0.0]);
    }
    assert!(after[14] < 1e-3 && environment.endings()[1] == Some(Ending::TimeUp), "it stands: {after:?}");
}

#[test]
fn two_agents_that_crash_agree_on_whose_fault_it_was() {
    let (mut crashes, mut own) = (0, 0);
    for seed in 0..200 {
        let settings = Settings { missions: Missions::Random, ..Settings::default() };
        let environment = episode(settings, seed, |_, _| Action::KeepLane);
        let endings = environment.endings();
        for ending in endings {
            let Some(Ending::Crash(Crash { with: crash::Hit::Agent(other), fault, .. })) = ending else { continue };
            let Some(Ending::Crash(theirs)) = endings[usize::from(other)] else { panic!("{endings:?}") };
            // A third car in the same moment has its own story.
            if theirs.with == crash::Hit::Agent(endings.iter().position(|e| *e == ending).unwrap() as u8) {
                let expected = match fault {
                    Fault::Own => Fault::Other,
                    Fault::Other => Fault::Own,
                    Fault::Shared => Fault::Shared,
                };
                assert_eq!(theirs.fault, expected, "{endings:?}");
            }
            crashes += 1;
            own += usize::from(fault == Fault::Own);
        }
    }
    assert!(crashes > 50 && own > crashes / 4, "{own} of {crashes}");
}

#[test]
fn the_parallel_api_drops_agents_that_have_ended_and_refuses_their_actions() {
    let mut world = Parallel::new(Settings::default());
    let first = world.reset(9);
    assert_eq!((first.len(), first["agent_0"].len()), (AGENTS, OBSERVATION));
    assert_eq!((world.possible_agents(), world.state().len()), (parallel::NAMES, STATE));
    let missing = world.step(&[("agent_0", Action::KeepLane)].into()).unwrap_err();
    assert!(missing.to_string().contains("got none for agent_1"), "{missing}");
    let mut seen = Vec::new();
    while !world.agents().is_empty() {
        let acts = world.agents().into_iter().map(|name| {
            let i = parallel::NAMES.iter().position(|other| *other == name).unwrap();
            (name, scripted::act(world.environment(), i))
        });
        let stepped = world.step(&acts.collect()).unwrap();
        seen.extend(stepped.terminations.iter().filter(|(_, ended)| **ended).map(|(name, _)| *name));
        assert_eq!(stepped.rewards.len(), stepped.infos.len());
    }
    seen.sort_unstable();
    assert_eq!(seen, parallel::NAMES);
    let unknown = world.step(&[("agent_0", Action::KeepLane)].into()).unwrap_err();
    assert!(matches!(unknown, parallel::StepError::Unknown { .. }), "{unknown}");
}

/// So nobody who learns is asked for what cannot be done: other first seconds, and the script's episodes end well.
#[test]
fn whenever_the_script_crashes_some_plan_for_the_first_seconds_would_have_avoided_it() {
    let plans = [(Action::KeepLane, 0), (Action::KeepLane, 10), (Action::KeepLane, 20), (Action::KeepLane, 40)]
        .into_iter()
        .chain([(Action::SlowDown, 10), (Action::SlowDown, 20), (Action::SlowDown, 40)])
        .collect::<Vec<_>>();
    let mut crashed = 0;
    for cars in [0, CARS] {
        let settings = Settings { cars, ..BUSY };
        let crashes = |seed, number: usize| {
            let ended = episode(settings, seed, |environment, i| {
                let (action, steps) = plans[number / plans.len().pow(i as u32) % plans.len()];
                if environment.steps() < steps { action } else { scripted::act(environment, i) }
            });
            ended.endings().iter().any(|ending| matches!(ending, Some(Ending::Crash(_))))
        };
        for seed in (evaluation::HELD_OUT..evaluation::HELD_OUT + 300).filter(|seed| crashes(*seed, 0)) {
            assert!(
                (0..plans.len().pow(AGENTS as u32)).any(|number| !crashes(seed, number)),
                "{cars} cars, seed {seed}"
            );
            crashed += 1;
        }
    }
    assert!(crashed > 0, "otherwise this shows nothing");
}
