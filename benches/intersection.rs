//! What the intersection of the agents costs, on one core. Counted are agents that drive: those that have ended, and
//! background cars, are not. 1,000,000 agent-steps a second are asked for without traffic, 400,000 with it.

use std::hint::black_box;

use divan::{Bencher, counter::ItemsCount};
use lapwing_sim::intersection::{ACTIONS, Batch, Buffers, CARS, Missions, OBSERVATION, Settings};

/// Intersections side by side.
const COUNT: usize = 64;
/// Steps of each that are timed together: a few episodes.
const STEPS: usize = 300;

/// Agents that act at random for half a second each, on new missions; the places of the background cars are filled to
/// five sixths on average.
#[divan::bench(args = [0, CARS], sample_count = 20, sample_size = 1)]
fn agent_steps(bencher: Bencher<'_, '_>, cars: usize) {
    let settings = Settings { missions: Missions::Random, cars, ..Settings::default() };
    let drive = |batch: &mut Batch| {
        let agents = batch.agents();
        let mut observations = vec![0.0; agents * OBSERVATION];
        let (mut rewards, mut flags) = (vec![0.0; agents], [(); 3].map(|()| vec![false; agents]));
        let mut actions = vec![0; agents];
        let mut counted = 0;
        for step in 0..STEPS {
            if step % 5 == 0 {
                let act = |i: usize| ((step * 7 + i * 31) % 13 % ACTIONS) as u8;
                actions.iter_mut().enumerate().for_each(|(i, action)| *action = act(i));
            }
            let [drove, terminated, truncated] = &mut flags;
            let buffers =
                Buffers { observations: &mut observations, rewards: &mut rewards, drove, terminated, truncated };
            batch.step(black_box(&actions), buffers);
            counted += flags[0].iter().filter(|drove| **drove).count();
        }
        black_box(&observations);
        counted
    };
    // The same episodes each time, so as many agent-steps.
    let counted = drive(&mut Batch::new(settings, COUNT, 1));
    bencher.counter(ItemsCount::new(counted)).with_inputs(|| Batch::new(settings, COUNT, 1)).bench_local_refs(drive);
}
