//! Missions: where the agents begin and where they are to go.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{
    AGENTS,
    roads::{self, Arm, SPEED_LIMIT, Turn, Way, way_of},
};

/// How hard a car is braked on its way to a turn, in m/s2: gently enough to be able to stop at any time.
pub const TURN_BRAKING: f32 = 4.0;

/// From a place on one arm to a place on another, as SUMO names them: a lane, and metres from the lane's begin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mission {
    /// Where it begins, towards the box.
    pub from: Arm,
    /// In which lane.
    pub from_lane: u8,
    /// How far from the arm's outer end, in metres.
    pub from_m: f32,
    /// What it does in the box.
    pub turn: Turn,
    /// The lane of the goal, on the arm after that turn.
    pub to_lane: u8,
    /// How far from the box the goal is, in metres.
    pub to_m: f32,
}

/// The benchmark's (`benchmark/scenarios/intersections/4lane` of SMARTS): all change lanes.
pub const BENCHMARK: [Mission; AGENTS] = [
    Mission { from: Arm::South, from_lane: 1, from_m: 40.0, turn: Turn::Left, to_lane: 0, to_m: 60.0 },
    Mission { from: Arm::West, from_lane: 1, from_m: 50.0, turn: Turn::Straight, to_lane: 0, to_m: 60.0 },
    Mission { from: Arm::North, from_lane: 0, from_m: 40.0, turn: Turn::Straight, to_lane: 1, to_m: 40.0 },
    Mission { from: Arm::East, from_lane: 0, from_m: 50.0, turn: Turn::Straight, to_lane: 1, to_m: 40.0 },
];

impl Mission {
    /// The way along its route in a lane.
    pub fn way(&self, lane: u8) -> usize {
        way_of(self.from, self.turn, lane)
    }

    /// How far along its ways the goal is, in metres. Ways of the same route differ in the box alone.
    pub fn goal_m(&self, way: &Way) -> f32 {
        way.leaves_m() + self.to_m
    }

    /// The goal's middle: x and y, in metres.
    pub fn goal(&self) -> (f32, f32) {
        let way = &roads::ALL[self.way(self.to_lane)];
        let goal = way.at(self.goal_m(way));
        (goal.x, goal.y)
    }

    /// The speed at its begin, in m/s: the limit, as SMARTS has it, or what still lets the car slow down for its turn.
    pub fn speed(&self) -> f32 {
        let way = &roads::ALL[self.way(self.from_lane)];
        approach_speed(way, way.approach_m - self.from_m).min(SPEED_LIMIT)
    }

    /// A mission from an arm at random. Before the box there are at least 7 m, as in the benchmark, and behind it 30 m.
    pub fn random(from: Arm, random: &mut ChaCha8Rng) -> Self {
        let turn = Turn::ALL[random.random_range(0..3)];
        Self {
            from,
            from_lane: random.random_range(0..2),
            from_m: random.random_range(10.0..from.length_m() - 7.0),
            turn,
            to_lane: random.random_range(0..2),
            to_m: random.random_range(30.0..from.after(turn).length_m() - 3.0),
        }
    }

    /// One mission from each arm, the agents in any order.
    pub fn random_four(random: &mut ChaCha8Rng) -> [Self; AGENTS] {
        let mut arms = Arm::ALL;
        for i in (1..arms.len()).rev() {
            arms.swap(i, random.random_range(0..=i));
        }
        arms.map(|arm| Self::random(arm, random))
    }
}

/// How fast a car may be at a distance along its way, in m/s, with what lies before it. A car that corrects its speed
/// within so many seconds looks as far ahead.
pub fn turn_limit(way: &Way, s: f32, speed: f32, lag_s: f32) -> f32 {
    if s < way.leaves_m() { approach_speed(way, way.approach_m - s - speed * lag_s) } else { f32::INFINITY }
}

/// How fast a car may be this many metres before the box, in m/s, to take its turn.
fn approach_speed(way: &Way, before_m: f32) -> f32 {
    if way.turn == Turn::Straight {
        return f32::INFINITY;
    }
    (way.speed * way.speed + 2.0 * TURN_BRAKING * before_m.max(0.0)).sqrt()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn the_benchmarks_missions_lead_from_the_south_to_the_west_and_across() {
        let goals = BENCHMARK.map(|mission| (mission.from.after(mission.turn), mission.goal()));
        let expected = [
            (Arm::West, (-70.4, 4.8)),
            (Arm::East, (70.4, -4.8)),
            (Arm::South, (-1.6, -50.4)),
            (Arm::West, (-50.4, 1.6)),
        ];
        for ((arm, (x, y)), (expected_arm, (expected_x, expected_y))) in goals.into_iter().zip(expected) {
            assert_eq!(arm, expected_arm);
            assert!((x - expected_x).hypot(y - expected_y) < 1e-4, "{x}, {y}");
        }
        assert!(BENCHMARK.iter().all(|mission| mission.from_lane != mission.to_lane));
        assert!(BENCHMARK.iter().all(|mission| mission.speed() == SPEED_LIMIT), "as SMARTS starts them");
    }

    #[test]
    fn random_missions_begin_on_all_arms_and_end_on_the_road() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut routes = std::collections::BTreeSet::new();
        for _ in 0..200 {
            let missions = Mission::random_four(&mut random);
            let mut arms = missions.map(|mission| mission.from as usize);
            arms.sort_unstable();
            assert_eq!(arms, [0, 1, 2, 3]);
            for mission in missions {
                let (x, y) = mission.goal();
                assert!(roads::is_on_road(x, y), "{mission:?}");
                routes.insert((mission.way(mission.from_lane), mission.to_lane));
            }
        }
        assert_eq!(routes.len(), 48);
    }
}
