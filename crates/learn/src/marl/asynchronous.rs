//! MADDPG with one collector thread and several learner threads (Biswas and Biswas have one and two).
//!
//! What is shared, and how:
//!
//! - The networks and their optimisers ([`Core`]) are behind one lock. A learner copies the weights under it, computes its
//!   gradients from the copy without it, and follows them under it again: as in Gorila (Nair et al. 2015). Weights are so
//!   never read while they change. What others have learnt in between makes a gradient stale, by about one step for each
//!   other learner; how much is logged as `staleness`.
//! - The memory is behind another lock. Learners draw a batch, a copy, under it, and tell its errors under it afterwards. A
//!   row may have been overwritten in between; its error is then that of the row before, until it is drawn.
//! - Who may go on is behind a third. The collector stops when it is too far ahead of the learners, and these stop when the
//!   gradient steps that are due are taken: a run takes as many for as many transitions as a synchronous one does.
//!
//! No thread waits for a lock while it holds another one. All threads are joined before an update ends, so what is stored
//! and logged is at rest. A run is not the same for the same seed: threads go as the system lets them.

use std::{
    sync::{Condvar, Mutex, MutexGuard, PoisonError},
    thread,
};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{
    MarlError,
    gradients::{Core, Losses, learn},
    maddpg::{Maddpg, MaddpgSettings},
    policy::copied,
    replay::{Drawing, Memory},
};

/// The collector is ahead of the learners by at most as many gradient steps for each of them.
const AHEAD: u64 = 2;

/// How far all are.
#[derive(Debug)]
struct Pace {
    /// Gradient steps that are due.
    due: u64,
    /// Those that were begun.
    begun: u64,
    /// Whether no more will come due.
    is_over: bool,
}

/// What the threads share.
struct Shared<'a> {
    settings: &'a MaddpgSettings,
    core: Mutex<&'a mut Core>,
    memory: Mutex<&'a mut Memory>,
    pace: Mutex<Pace>,
    changed: Condvar,
    beta: f64,
    share_of_rates: f64,
}

/// A thread that panicked has brought the whole run down already, so what it left is not used.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Drives and learns until so many joint transitions, or until it is stopped, after one step or more.
pub(super) fn run(maddpg: &mut Maddpg, until: u64, is_stopped: &dyn Fn() -> bool) -> Result<Losses, MarlError> {
    let (before, beta, share_of_rates) = (maddpg.core.steps, maddpg.beta(), maddpg.share_of_rates());
    let seeds: Vec<u64> = (0..maddpg.settings.learners).map(|_| maddpg.random.random()).collect();
    let origin = maddpg.origin();
    let Maddpg { settings, core, collector, memory, scale, .. } = maddpg;
    let settings: &MaddpgSettings = settings;
    let actor = core.networks.actor.copy()?;
    let learners = seeds
        .into_iter()
        .map(|seed| Ok((seed, core.networks.copy()?, copied(scale)?)))
        .collect::<Result<Vec<_>, MarlError>>()?;
    let shared = Shared {
        settings,
        core: Mutex::new(core),
        memory: Mutex::new(memory),
        pace: Mutex::new(Pace { due: before, begun: before, is_over: false }),
        changed: Condvar::new(),
        beta,
        share_of_rates,
    };
    let due = |transitions: u64| origin.due(settings, transitions);
    thread::scope(|scope| {
        let shared = &shared;
        let threads: Vec<_> = learners
            .into_iter()
            .map(|(seed, networks, scale)| {
                scope.spawn(move || {
                    let learnt = (|| -> Result<Losses, MarlError> {
                        let (mut random, mut drawing) = (ChaCha8Rng::seed_from_u64(seed), Drawing::default());
                        let mut losses = Losses::default();
                        while shared.is_due() {
                            let version = {
                                let core = lock(&shared.core);
                                networks.take(&core.networks)?;
                                core.steps
                            };
                            lock(&shared.memory).draw(settings.batch, shared.beta, &mut random, &mut drawing);
                            let gradients = learn(&networks, &drawing, &scale, shared.settings, &mut random)?;
                            lock(&shared.memory).update(&drawing.rows, &gradients.errors);
                            let mut core = lock(&shared.core);
                            losses.staleness += (core.steps - version) as f64;
                            core.apply(&gradients, shared.settings, shared.share_of_rates)?;
                            losses.add(&gradients);
                        }
                        Ok(losses)
                    })();
                    if learnt.is_err() {
                        shared.end();
                    }
                    learnt
                })
            })
            .collect();
        let collected = (|| -> Result<(), MarlError> {
            while collector.transitions < until && !lock(&shared.pace).is_over {
                actor.follow(&lock(&shared.core).networks.actor, 1.0)?;
                collector.step(&actor, settings)?;
                lock(&shared.memory).push(collector.moment());
                shared.allow(due(collector.transitions));
                if is_stopped() {
                    break;
                }
            }
            Ok(())
        })();
        shared.end();
        let mut losses = Losses::default();
        for thread in threads {
            match thread.join() {
                Ok(learnt) => losses.join(&learnt?),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        collected.map(|()| losses)
    })
}

impl Shared<'_> {
    /// Waits for a gradient step to come due; false if none will.
    fn is_due(&self) -> bool {
        let mut pace = lock(&self.pace);
        loop {
            if pace.begun < pace.due {
                pace.begun += 1;
                self.changed.notify_all();
                return true;
            }
            if pace.is_over {
                return false;
            }
            pace = self.changed.wait(pace).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Lets so many gradient steps be taken, and waits if that is far ahead of those that are begun.
    fn allow(&self, due: u64) {
        let ahead = AHEAD * self.settings.learners as u64;
        let mut pace = lock(&self.pace);
        pace.due = due.max(pace.due);
        self.changed.notify_all();
        while pace.due > pace.begun + ahead && !pace.is_over {
            pace = self.changed.wait(pace).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Says that no more steps come due.
    fn end(&self) {
        lock(&self.pace).is_over = true;
        self.changed.notify_all();
    }
}
