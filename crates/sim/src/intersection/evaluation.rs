//! How well agents drive: collision and completion rates over episodes, and how they behave.

use std::{fmt, ops::Range};

use serde::{Deserialize, Serialize};

use super::{
    ACTIONS, AGENTS, Action, Crash, Ending, Environment, Fault, Reward, SUBSTEP_S, Settings, Tally, crash::Hit,
};
use lapwing_core::{stats::share_interval, words::count};

/// Episodes to evaluate on begin here; training draws its seeds from all 64 bits, of which these are few.
pub const HELD_OUT: u64 = 1 << 32;

/// What agents did in a number of episodes. Rates are shares of the agents, as in SMARTS' metrics.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Evaluation {
    /// Episodes.
    pub episodes: u64,
    /// Share of the agents that crashed.
    pub collision_rate: f64,
    /// 95 % interval, taking each episode as one trial: agents that crash do so together.
    pub collision_interval: [f64; 2],
    /// Share of the agents that reached their goals.
    pub completion_rate: f64,
    /// 95 % interval.
    pub completion_interval: [f64; 2],
    /// Share of the agents that left the road; who misses its goal does.
    pub off_road_rate: f64,
    /// Share of the agents that were still driving after 1000 steps.
    pub time_up_rate: f64,
    /// Share of the episodes in which all reached their goals.
    pub all_completed: f64,
    /// Crashes of agents with one another, as a share of the agents.
    pub with_agents: f64,
    /// Crashes of agents with background cars, as a share of the agents.
    pub with_traffic: f64,
    /// Share of the crashes that were the agent's own fault.
    pub own_fault: f64,
    /// And of those that were the other's; the rest is shared.
    pub others_fault: f64,
    /// Agility: mean speed, in m/s.
    pub speed: f64,
    /// Stability: variance of the offset from the lane's middle during an agent's episode, in m2; the mean over agents.
    pub offset_variance: f64,
    /// Control diversity: entropy of an agent's actions during its episode, in bits, from 0 (always the same) to 2 (all four
    /// equally often); the mean over agents.
    pub control_diversity: f64,
    /// Mean undiscounted sum of rewards of an agent, by the settings' reward.
    pub reward: f64,
    /// Mean duration of an agent's episode, in seconds.
    pub seconds: f64,
}

/// Adds up episodes.
#[derive(Debug, Clone, Default)]
pub struct Sums {
    episodes: u64,
    all_completed: u64,
    goals: u64,
    off_road: u64,
    time_up: u64,
    with_agents: u64,
    with_traffic: u64,
    own: u64,
    others: u64,
    steps: f64,
    speed: f64,
    offset_variance: f64,
    control_diversity: f64,
    reward: f64,
}

impl Sums {
    /// Adds an episode.
    pub fn add(&mut self, episode: [(Ending, Tally); AGENTS]) {
        self.episodes += 1;
        self.all_completed += u64::from(episode.iter().all(|(ending, _)| *ending == Ending::Goal));
        for (ending, tally) in episode {
            match ending {
                Ending::Goal => self.goals += 1,
                Ending::OffRoad => self.off_road += 1,
                Ending::TimeUp => self.time_up += 1,
                Ending::Crash(Crash { with, fault, .. }) => {
                    match with {
                        Hit::Agent(_) => self.with_agents += 1,
                        Hit::Traffic(_) => self.with_traffic += 1,
                    }
                    self.own += u64::from(fault == Fault::Own);
                    self.others += u64::from(fault == Fault::Other);
                }
            }
            self.steps += f64::from(tally.steps);
            self.speed += f64::from(tally.speed);
            self.offset_variance += offset_variance(&tally);
            self.control_diversity += entropy_bits(&tally.actions);
            self.reward += f64::from(tally.reward);
        }
    }

    /// Episodes added so far.
    pub fn episodes(&self) -> u64 {
        self.episodes
    }

    /// What they come to.
    pub fn evaluation(&self) -> Evaluation {
        let agents = (self.episodes.max(1) * AGENTS as u64) as f64;
        let share = |n: u64| n as f64 / agents;
        let crashes = self.with_agents + self.with_traffic;
        let of_crashes = |n: u64| n as f64 / crashes.max(1) as f64;
        let steps = self.steps.max(1.0);
        Evaluation {
            episodes: self.episodes,
            collision_rate: share(crashes),
            collision_interval: share_interval(share(crashes), self.episodes),
            completion_rate: share(self.goals),
            completion_interval: share_interval(share(self.goals), self.episodes),
            off_road_rate: share(self.off_road),
            time_up_rate: share(self.time_up),
            all_completed: self.all_completed as f64 / self.episodes.max(1) as f64,
            with_agents: share(self.with_agents),
            with_traffic: share(self.with_traffic),
            own_fault: of_crashes(self.own),
            others_fault: of_crashes(self.others),
            speed: self.speed / steps,
            offset_variance: self.offset_variance / agents,
            control_diversity: self.control_diversity / agents,
            reward: self.reward / agents,
            seconds: self.steps / agents * f64::from(2.0 * SUBSTEP_S),
        }
    }
}

fn offset_variance(tally: &Tally) -> f64 {
    let steps = f64::from(tally.steps.max(1));
    let mean = f64::from(tally.offset) / steps;
    (f64::from(tally.offset_squared) / steps - mean * mean).max(0.0)
}

fn entropy_bits(counts: &[u32; ACTIONS]) -> f64 {
    let all = f64::from(counts.iter().sum::<u32>());
    let share = |count: &u32| f64::from(*count) / all;
    -counts.iter().filter(|count| **count > 0).map(share).map(|share| share * share.log2()).sum::<f64>()
}

/// Drives the episodes of a range of seeds, up to `at_once` of them side by side. `act` is given the intersections and
/// writes an action for each agent of each; actions of agents that have ended are ignored.
///
/// # Errors
/// Those of `act`.
pub fn evaluate<E>(
    settings: Settings,
    seeds: Range<u64>,
    at_once: usize,
    mut act: impl FnMut(&[Environment], &mut [[Action; AGENTS]]) -> Result<(), E>,
) -> Result<Evaluation, E> {
    let mut waiting = seeds;
    let mut environments: Vec<Environment> =
        waiting.by_ref().take(at_once.max(1)).map(|seed| Environment::new(settings, seed)).collect();
    let mut actions = vec![[Action::default(); AGENTS]; environments.len()];
    let mut sums = Sums::default();
    while !environments.is_empty() {
        act(&environments, &mut actions)?;
        for (environment, actions) in environments.iter_mut().zip(&actions) {
            environment.step(*actions);
        }
        // From the back, so that one that goes moves none that is still to be looked at.
        for e in (0..environments.len()).rev().filter(|e| environments[*e].is_over()).collect::<Vec<_>>() {
            sums.add(environments[e].episode());
            match waiting.next() {
                Some(seed) => environments[e].reset(seed),
                None => drop(environments.swap_remove(e)),
            }
        }
        actions.truncate(environments.len());
    }
    Ok(sums.evaluation())
}

impl Evaluation {
    /// The figures with their names, one a line, without a line break at the end; `reward` is that of the settings.
    pub fn in_words(self, reward: Reward) -> impl fmt::Display {
        InWords(self, reward)
    }
}

struct InWords(Evaluation, Reward);

impl fmt::Display for InWords {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(found, reward) = self;
        let percent = |share: f64| format!("{:.2} %", share * 100.0);
        let between = |[low, high]: [f64; 2]| format!("({:.2} to {:.2})", low * 100.0, high * 100.0);
        writeln!(f, "{} of {AGENTS} agents", count(found.episodes, "episode"))?;
        writeln!(f, "  collisions  {:>9} {}", percent(found.collision_rate), between(found.collision_interval))?;
        writeln!(f, "    agents    {:>9}", percent(found.with_agents))?;
        writeln!(f, "    traffic   {:>9}", percent(found.with_traffic))?;
        if found.collision_rate > 0.0 {
            let both = (1.0 - found.own_fault - found.others_fault).max(0.0);
            let [own, others, both] = [found.own_fault, found.others_fault, both].map(percent);
            writeln!(f, "    own fault {own:>9} of them, the other's {others}, both {both}")?;
        }
        writeln!(f, "  completed   {:>9} {}", percent(found.completion_rate), between(found.completion_interval))?;
        writeln!(f, "  off road    {:>9}", percent(found.off_road_rate))?;
        writeln!(f, "  time up     {:>9}", percent(found.time_up_rate))?;
        writeln!(f, "  all four    {:>9} of the episodes", percent(found.all_completed))?;
        writeln!(f, "  agility     {:>5.2} m/s  mean speed", found.speed)?;
        writeln!(f, "  stability   {:>5.3} m2   variance of the offset", found.offset_variance)?;
        writeln!(f, "  diversity   {:>5.2} bits entropy of the actions", found.control_diversity)?;
        let whose = match reward {
            Reward::Smarts => "SMARTS' reward",
            Reward::Corrected => "corrected reward",
        };
        writeln!(f, "  reward      {:>5.1}      {whose}", found.reward)?;
        write!(f, "  duration    {:>5.1} s", found.seconds)
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::{super::scripted, *};

    fn scripted(environments: &[Environment], actions: &mut [[Action; AGENTS]]) -> Result<(), Infallible> {
        for (environment, actions) in environments.iter().zip(actions) {
            *actions = std::array::from_fn(|i| scripted::act(environment, i));
        }
        Ok(())
    }

    #[test]
    fn agents_are_as_steady_and_as_diverse_as_each_is_in_its_own_episode() {
        // One keeps 1 m to the left, one 1 m to the right; the others sway by 1 m, and do two things in turns.
        let still = |offset: f32, actions| Tally {
            steps: 4,
            offset: 4.0 * offset,
            offset_squared: 4.0,
            actions,
            ..Tally::default()
        };
        let swaying = Tally { steps: 4, offset_squared: 4.0, actions: [2, 0, 2, 0], ..Tally::default() };
        let mut sums = Sums::default();
        sums.add(
            [still(1.0, [4, 0, 0, 0]), still(-1.0, [1, 1, 1, 1]), swaying, swaying].map(|tally| (Ending::Goal, tally)),
        );
        let Evaluation { offset_variance, control_diversity, .. } = sums.evaluation();
        assert_eq!((offset_variance, control_diversity), (0.5, (0.0 + 2.0 + 1.0 + 1.0) / 4.0));
    }

    #[test]
    fn in_words_each_crash_is_somebodys_fault_and_the_reward_is_named() {
        let found = Evaluation {
            collision_rate: 0.5,
            own_fault: 3.0 / 7.0,
            others_fault: 3.0 / 7.0,
            reward: 62.04,
            ..Evaluation::default()
        };
        let told = found.in_words(Reward::Smarts).to_string();
        assert!(told.contains("\n    own fault   42.86 % of them, the other's 42.86 %, both 14.29 %\n"), "{told}");
        assert!(told.contains("\n  reward       62.0      SMARTS' reward\n"), "{told}");
        let told = found.in_words(Reward::Corrected).to_string();
        assert!(told.contains("corrected reward"), "{told}");
        let told = Evaluation { own_fault: 0.9, others_fault: 0.1, ..found }.in_words(Reward::Smarts).to_string();
        assert!(told.contains("90.00 % of them, the other's 10.00 %, both 0.00 %"), "{told}");
    }

    #[test]
    fn episodes_come_out_the_same_however_many_are_driven_side_by_side() {
        let settings = Settings { cars: 12, ..Settings::default() };
        let Ok(one) = evaluate(settings, HELD_OUT..HELD_OUT + 20, 1, scripted);
        let Ok(many) = evaluate(settings, HELD_OUT..HELD_OUT + 20, 7, scripted);
        assert_eq!(one.episodes, 20);
        // Sums are taken in another order.
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9 * a.abs().max(1.0);
        assert!(near(one.reward, many.reward) && near(one.speed, many.speed), "{one:?}, {many:?}");
        assert_eq!((one.collision_rate, one.completion_rate), (many.collision_rate, many.completion_rate));
    }
}
