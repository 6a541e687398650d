//! Stepping the intersection allocates nothing. A binary of its own, as a program has one allocator.

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
};

use lapwing_sim::intersection::{Batch, Buffers, CARS, Reward, Settings, Sight};

/// The system's allocator, which counts what this thread asks for: the test harness has threads of its own.
struct Counting;

thread_local! {
    static ASKED: Cell<u64> = const { Cell::new(0) };
}

fn count() {
    ASKED.set(ASKED.get() + 1);
}

// SAFETY: all is left to the system's allocator; the counter is in memory that is there when a thread begins.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller upholds the contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller upholds the contract.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller upholds the contract.
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: the caller upholds the contract.
        unsafe { System.dealloc(block, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

#[test]
fn a_batch_is_stepped_through_many_episodes_without_an_allocation() {
    for sight in [Sight::Sectors, Sight::Routes] {
        let settings = Settings { cars: CARS, reward: Reward::Corrected, sight, ..Settings::default() };
        let before = ASKED.get();
        let mut batch = Batch::mixed(settings, 8, 1);
        let (agents, numbers) = (batch.agents(), sight.numbers());
        let (mut observations, mut rewards) = (vec![0.0; agents * numbers], vec![0.0; agents]);
        let [mut drove, mut terminated, mut truncated] = [(); 3].map(|()| vec![false; agents]);
        let mut actions = vec![0; agents];
        assert!(ASKED.get() > before, "otherwise nothing is counted");
        let (mut since, mut episodes, mut timed_out) = (0, 0, 0);
        for step in 0..2500_usize {
            // Some act at random, some keep their lanes, and those of the first intersection stand still.
            let act = |i: usize| match i % 3 {
                _ if i < 4 => 1,
                0 => 0,
                _ => ((step / 7 * 5 + i * 3) % 11 / 3) as u8,
            };
            actions.iter_mut().enumerate().for_each(|(i, action)| *action = act(i));
            batch.step(
                &actions,
                Buffers {
                    observations: &mut observations,
                    rewards: &mut rewards,
                    drove: &mut drove,
                    terminated: &mut terminated,
                    truncated: &mut truncated,
                },
            );
            batch.observe(&mut observations);
            episodes += batch.finished().count();
            timed_out += truncated.iter().filter(|truncated| **truncated).count();
            // The table of ways that conflict is made when it is first needed.
            if step == 0 {
                since = ASKED.get();
            }
        }
        assert!(episodes > 100 && timed_out > 0, "{episodes} episodes, {timed_out} agents were truncated");
        assert_eq!(ASKED.get() - since, 0, "{sight:?}");
    }
}
