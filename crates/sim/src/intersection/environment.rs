//! One intersection: four agents, the traffic, and what becomes of them.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{
    AGENTS, CARS, STEPS,
    agents::{ACTIONS, Action, Agents},
    crash::{self, Crash, Hit, Party},
    missions::{BENCHMARK, Mission},
    observation::{self, Axes, FRAME, OBSERVATION, STATE},
    reward::{Event, Reward},
    roads,
    sight::{self, ROUTES, Sight},
    traffic::Traffic,
};

/// How near to its goal an agent must come, in metres (`goal_dist_th` of SMARTS' metrics).
const GOAL_M: f32 = 2.0;

/// Which missions the agents get.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Missions {
    /// The benchmark's four, the same in each episode.
    #[default]
    Benchmark,
    /// New ones in each episode, one from each arm.
    Random,
}

/// What an intersection is like.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Settings {
    /// What the agents are to do.
    pub missions: Missions,
    /// Places for background cars, 0 to [`CARS`]; 0 is no traffic.
    pub cars: usize,
    /// What they are rewarded for.
    pub reward: Reward,
    /// The axes on which they see, if they see sectors.
    pub axes: Axes,
    /// What they see.
    #[serde(default)]
    pub sight: Sight,
}

/// How an agent's episode ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ending {
    /// It reached its goal.
    Goal,
    /// It crashed.
    Crash(Crash),
    /// It left the road; who drives past its goal does so at the road's end.
    OffRoad,
    /// It was still driving after [`STEPS`] steps: truncated, not terminated.
    TimeUp,
}

impl Ending {
    /// Whether nothing can come after it; otherwise the value of the last state counts.
    pub fn is_terminal(self) -> bool {
        self != Self::TimeUp
    }
}

/// What is told of an agent's episode.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Tally {
    /// Steps driven.
    pub steps: u32,
    /// Sum of rewards, undiscounted.
    pub reward: f32,
    /// Sum over its steps of the speed, in m/s.
    pub speed: f32,
    /// Sum of the offset from the lane's middle, in metres.
    pub offset: f32,
    /// Sum of its square.
    pub offset_squared: f32,
    /// How often it was told to do what, in the order of [`Action::ALL`].
    pub actions: [u32; ACTIONS],
}

/// What a step gave each agent.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Step {
    /// Whether it drove: only then the rest means anything.
    pub drove: [bool; AGENTS],
    /// Its reward.
    pub rewards: [f32; AGENTS],
    /// Whether it ended for good.
    pub terminated: [bool; AGENTS],
    /// Whether its time is up.
    pub truncated: [bool; AGENTS],
}

/// An intersection in the midst of an episode.
#[derive(Debug, Clone)]
pub struct Environment {
    settings: Settings,
    random: ChaCha8Rng,
    step: u32,
    agents: Agents,
    traffic: Traffic,
    alive: [bool; AGENTS],
    /// The step at which its nose came into the box.
    entered: [Option<u32>; AGENTS],
    /// The step at which it came into its lane; none if it began there.
    changed: [Option<u32>; AGENTS],
    endings: [Option<Ending>; AGENTS],
    tallies: [Tally; AGENTS],
    /// The benchmark's observations, which its reward is computed from, too.
    stacks: [[f32; OBSERVATION]; AGENTS],
    /// Those with [`Sight::Routes`].
    routes: [[f32; ROUTES]; AGENTS],
}

impl Environment {
    /// An intersection at the begin of an episode; the seed and the actions determine everything that follows.
    pub fn new(settings: Settings, seed: u64) -> Self {
        let mut environment = Self {
            settings,
            random: ChaCha8Rng::seed_from_u64(seed),
            step: 0,
            agents: Agents::default(),
            traffic: Traffic::default(),
            alive: [true; AGENTS],
            entered: [None; AGENTS],
            changed: [None; AGENTS],
            endings: [None; AGENTS],
            tallies: [Tally::default(); AGENTS],
            stacks: [[0.0; OBSERVATION]; AGENTS],
            routes: [[0.0; ROUTES]; AGENTS],
        };
        environment.begin();
        environment
    }

    /// Begins the episode of a seed.
    pub fn reset(&mut self, seed: u64) {
        self.random = ChaCha8Rng::seed_from_u64(seed);
        self.begin();
    }

    /// Begins the next episode, drawn from where the last one's draws ended.
    pub fn begin(&mut self) {
        let missions = match self.settings.missions {
            Missions::Benchmark => BENCHMARK,
            Missions::Random => Mission::random_four(&mut self.random),
        };
        self.step = 0;
        self.agents.start(missions);
        self.traffic.start(self.settings.cars, &self.agents, &mut self.random);
        (self.alive, self.entered, self.changed) = ([true; AGENTS], [None; AGENTS], [None; AGENTS]);
        (self.endings, self.tallies) = ([None; AGENTS], [Tally::default(); AGENTS]);
        for i in 0..AGENTS {
            let mut frame = [0.0; FRAME];
            observation::observe(&self.agents, i, self.alive, &self.traffic, self.settings.axes, &mut frame);
            // The first frame fills the stack, as in SMARTS' `FrameStack.reset`.
            self.stacks[i].as_chunks_mut().0.fill(frame);
            self.see_routes(i);
        }
    }

    /// A tenth of a second. Actions of agents that have ended are ignored.
    pub fn step(&mut self, actions: [Action; AGENTS]) -> Step {
        let driven_before = self.agents.driven;
        let mut step = Step { drove: self.alive, ..Step::default() };
        self.step += 1;
        self.traffic.decide(&self.agents, self.alive, self.step);
        let aims: [u8; AGENTS] = std::array::from_fn(|i| self.agents.aim(i, actions[i]));
        for _ in 0..2 {
            for i in (0..AGENTS).filter(|i| self.alive[*i]) {
                let lane = self.agents.lane[i];
                self.agents.drive(i, actions[i], aims[i]);
                if self.agents.lane[i] != lane {
                    self.changed[i] = Some(self.step);
                }
                let to_box = roads::ALL[self.agents.way(i)].approach_m - super::LENGTH_M / 2.0 - self.agents.along[i];
                if self.entered[i].is_none() && to_box < 0.0 {
                    self.entered[i] = Some(self.step);
                }
            }
            self.traffic.roll(self.step);
            self.end_some();
        }
        if self.step == STEPS {
            for i in (0..AGENTS).filter(|i| self.alive[*i]) {
                self.endings[i] = Some(Ending::TimeUp);
            }
        }
        self.traffic.arrivals(&self.agents, self.alive, &mut self.random);
        for i in (0..AGENTS).filter(|i| step.drove[*i]) {
            self.see_routes(i);
            let mut before = [0.0; FRAME];
            let stack = &mut self.stacks[i];
            before.copy_from_slice(&stack[OBSERVATION - FRAME..]);
            stack.copy_within(FRAME.., 0);
            let Some(now) = stack.last_chunk_mut() else { continue };
            observation::observe(&self.agents, i, self.alive, &self.traffic, self.settings.axes, now);
            let event = match self.endings[i] {
                None => Event::None,
                Some(Ending::Goal) => Event::Goal,
                Some(Ending::TimeUp) => Event::TimeUp,
                Some(Ending::Crash(_) | Ending::OffRoad) => Event::Failure,
            };
            let reward = self.settings.reward.of(&before, now, self.agents.driven[i] - driven_before[i], event);
            step.rewards[i] = reward;
            step.terminated[i] = self.endings[i].is_some_and(Ending::is_terminal);
            step.truncated[i] = self.endings[i] == Some(Ending::TimeUp);
            let (tally, offset) = (&mut self.tallies[i], self.agents.offset[i]);
            tally.steps += 1;
            tally.reward += reward;
            tally.speed += self.agents.speed[i];
            tally.offset += offset;
            tally.offset_squared += offset * offset;
            tally.actions[actions[i] as usize] += 1;
        }
        for i in 0..AGENTS {
            self.alive[i] &= self.endings[i].is_none();
        }
        step
    }

    fn see_routes(&mut self, i: usize) {
        if self.settings.sight == Sight::Routes {
            sight::routes(&self.agents, i, self.alive, &self.traffic, &mut self.routes[i]);
        }
    }

    /// Ends the agents that crashed, reached their goals, or left the road since the last half step. Their cars are gone
    /// from then on.
    fn end_some(&mut self) {
        let alive = self.alive;
        for i in (0..AGENTS).filter(|i| alive[*i]) {
            let (x, y) = (self.agents.x[i], self.agents.y[i]);
            let is_near = |dx: f32, dy: f32| (dx - x) * (dx - x) + (dy - y) * (dy - y) < crash::NEAR_M2;
            for k in (i + 1..AGENTS).filter(|k| alive[*k]) {
                if is_near(self.agents.x[k], self.agents.y[k]) {
                    let (own, other) = (self.agent(i), self.agent(k));
                    if own.touches(&other) {
                        self.crash(i, Hit::Agent(k as u8), &own, &other);
                        self.crash(k, Hit::Agent(i as u8), &other, &own);
                    }
                }
            }
            for j in 0..self.traffic.places {
                let pose = self.traffic.pose[j];
                if self.traffic.present[j] && is_near(pose.x, pose.y) {
                    let (own, other) = (self.agent(i), self.car(j));
                    if own.touches(&other) {
                        self.crash(i, Hit::Traffic(j as u8), &own, &other);
                    }
                }
            }
            if self.endings[i].is_none() {
                if self.agents.to_goal(i) < GOAL_M {
                    self.endings[i] = Some(Ending::Goal);
                } else if !roads::is_on_road(x, y) {
                    self.endings[i] = Some(Ending::OffRoad);
                }
            }
        }
        for i in 0..AGENTS {
            self.alive[i] &= self.endings[i].is_none();
        }
    }

    /// Of several crashes in the same moment the first counts.
    fn crash(&mut self, i: usize, with: Hit, own: &Party, other: &Party) {
        if self.endings[i].is_none() {
            let (manner, fault) = crash::judge(own, other);
            self.endings[i] = Some(Ending::Crash(Crash { with, manner, fault }));
        }
    }

    fn agent(&self, i: usize) -> Party {
        let agents = &self.agents;
        Party {
            x: agents.x[i],
            y: agents.y[i],
            hx: agents.hx[i],
            hy: agents.hy[i],
            from: agents.missions[i].from,
            entered: self.entered[i],
            beyond_m: agents.along[i] - roads::ALL[agents.way(i)].leaves_m(),
            offset: agents.offset[i],
            in_lane_for: self.changed[i].map_or(u32::MAX, |at| self.step - at),
        }
    }

    fn car(&self, j: usize) -> Party {
        let traffic = &self.traffic;
        let (pose, way) = (traffic.pose[j], &roads::ALL[usize::from(traffic.way[j])]);
        Party {
            x: pose.x,
            y: pose.y,
            hx: pose.hx,
            hy: pose.hy,
            from: way.from,
            entered: traffic.entered[j],
            beyond_m: traffic.along[j] - way.leaves_m(),
            offset: 0.0,
            in_lane_for: u32::MAX,
        }
    }

    /// Pairs of background cars that touch. There should never be one; nothing but tests asks.
    pub fn crashes_among_traffic(&self) -> usize {
        let present: Vec<usize> = (0..CARS).filter(|j| self.traffic.present[*j]).collect();
        let touches =
            |(n, j): (usize, &usize)| present[..n].iter().filter(|k| self.car(*j).touches(&self.car(**k))).count();
        present.iter().enumerate().map(touches).sum()
    }

    /// Takes all agents but one away, as if they had reached their goals.
    #[cfg(test)]
    pub(super) fn leave_only(&mut self, agent: usize) {
        for i in (0..AGENTS).filter(|i| *i != agent) {
            (self.alive[i], self.endings[i]) = (false, Some(Ending::Goal));
        }
    }

    /// The background cars, to be put where a test wants them.
    #[cfg(test)]
    pub(super) fn traffic_mut(&mut self) -> &mut Traffic {
        &mut self.traffic
    }

    /// What it is like.
    pub fn settings(&self) -> Settings {
        self.settings
    }

    /// Steps taken in this episode.
    pub fn steps(&self) -> u32 {
        self.step
    }

    /// The agents' cars, also those that have ended: where they were last.
    pub fn agents(&self) -> &Agents {
        &self.agents
    }

    /// The background cars.
    pub fn traffic(&self) -> &Traffic {
        &self.traffic
    }

    /// Which agents still drive.
    pub fn alive(&self) -> [bool; AGENTS] {
        self.alive
    }

    /// Whether all have ended.
    pub fn is_over(&self) -> bool {
        self.alive == [false; AGENTS]
    }

    /// How the agents ended; none while they drive.
    pub fn endings(&self) -> [Option<Ending>; AGENTS] {
        self.endings
    }

    /// What is told of the agents' episodes so far.
    pub fn tallies(&self) -> [Tally; AGENTS] {
        self.tallies
    }

    /// How the agents' episodes ended, and what is told of them; who still drives counts as if time were up.
    pub fn episode(&self) -> [(Ending, Tally); AGENTS] {
        std::array::from_fn(|i| (self.endings[i].unwrap_or(Ending::TimeUp), self.tallies[i]))
    }

    /// What an agent sees; once it has ended, what it saw last. As many numbers as its [`Sight`] has.
    pub fn observation(&self, i: usize) -> &[f32] {
        match self.settings.sight {
            Sight::Sectors => &self.stacks[i],
            Sight::Routes => &self.routes[i],
        }
    }

    /// The whole situation, see [`observation`]. Agents whose time is up are still there.
    pub fn state(&self, out: &mut [f32; STATE]) {
        let there = std::array::from_fn(|i| self.alive[i] || self.endings[i] == Some(Ending::TimeUp));
        observation::state(&self.agents, there, &self.traffic, out);
    }
}
