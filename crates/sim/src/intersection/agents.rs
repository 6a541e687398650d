//! The agents' cars: kinematic bicycles, each with a controller that turns an action into steering and acceleration.
//!
//! All state stands in arrays over the agents. A car's place is the middle of its body, halfway between the axles.

use serde::{Deserialize, Serialize};

use super::{
    AGENTS, SUBSTEP_S,
    missions::{BENCHMARK, Mission, turn_limit},
    roads::{self, Way},
};

/// From axle to axle, in metres: that of a car as short as SUMO's and SMARTS' passenger cars here.
pub const WHEELBASE_M: f32 = 2.4;
/// The tangent of the front wheels' largest angle, 29 degrees: a turning circle of 4.3 m. The tightest way has 5.6 m.
const FULL_STEERING: f32 = 0.56;
/// How fast the front wheels turn, in tangents a second: near the middle, radians.
const STEERING_RATE: f32 = 1.0;
/// What the controller accelerates with at most, in m/s2: SUMO's passenger car.
const ACCELERATION: f32 = 2.6;
/// And brakes with: what tyres hold on asphalt, a little less than SUMO's emergency braking.
const BRAKING: f32 = 8.0;
/// Acceleration for each m/s of wrong speed, in 1/s.
const SPEED_GAIN: f32 = 2.0;
/// Steepest angle at which a car approaches its lane, as a sine.
const APPROACH: f32 = 0.22;
/// Lateral acceleration that corrections may take, in m/s2.
const CORRECTION: f32 = 4.0;
/// How far ahead in time the way's curvature is looked up, in seconds: the wheels turn at a finite rate.
const PREVIEW_S: f32 = 0.12;

/// What an agent may do, in the benchmark's order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[repr(u8)]
pub enum Action {
    /// Keep the lane at 15 m/s.
    #[default]
    KeepLane,
    /// Keep the lane and brake to 0.
    SlowDown,
    /// To the lane on the left, at 12.5 m/s.
    ChangeLeft,
    /// To the lane on the right, at 12.5 m/s.
    ChangeRight,
}

/// Number of actions.
pub const ACTIONS: usize = 4;

impl Action {
    /// All, in order.
    pub const ALL: [Self; ACTIONS] = [Self::KeepLane, Self::SlowDown, Self::ChangeLeft, Self::ChangeRight];

    /// The action of a number; beyond the last it is the last.
    pub fn of(number: u8) -> Self {
        Self::ALL[usize::from(number).min(ACTIONS - 1)]
    }

    /// Target speed, in m/s (`smarts/core/controllers`: keep_lane, slow_down, change_lane_left, change_lane_right).
    pub fn speed(self) -> f32 {
        match self {
            Self::KeepLane => 15.0,
            Self::SlowDown => 0.0,
            Self::ChangeLeft | Self::ChangeRight => 12.5,
        }
    }

    /// The lane it aims at from a lane.
    fn lane(self, lane: u8) -> u8 {
        match self {
            Self::KeepLane | Self::SlowDown => lane,
            Self::ChangeLeft => 1,
            Self::ChangeRight => 0,
        }
    }
}

/// All agents' cars.
#[derive(Debug, Clone)]
pub struct Agents {
    /// Middle of the body, in metres.
    pub x: [f32; AGENTS],
    /// As `x`.
    pub y: [f32; AGENTS],
    /// Where it points, a unit vector.
    pub hx: [f32; AGENTS],
    /// As `hx`.
    pub hy: [f32; AGENTS],
    /// In m/s.
    pub speed: [f32; AGENTS],
    /// In m/s2, in the last half step.
    pub acceleration: [f32; AGENTS],
    /// The tangent of the front wheels' angle, positive to the right. Kinematics need no other form of it.
    pub steering: [f32; AGENTS],
    /// What it is to do.
    pub missions: [Mission; AGENTS],
    /// Its goal, x and y.
    pub goals: [(f32, f32); AGENTS],
    /// The nearer lane of its route.
    pub lane: [u8; AGENTS],
    /// Metres along that lane's way.
    pub along: [f32; AGENTS],
    /// Metres to the right of that lane's middle.
    pub offset: [f32; AGENTS],
    /// Metres driven.
    pub driven: [f32; AGENTS],
}

impl Default for Agents {
    fn default() -> Self {
        let none = [0.0; AGENTS];
        let mut agents = Self {
            x: none,
            y: none,
            hx: none,
            hy: none,
            speed: none,
            acceleration: none,
            steering: none,
            missions: BENCHMARK,
            goals: [(0.0, 0.0); AGENTS],
            lane: [0; AGENTS],
            along: none,
            offset: none,
            driven: none,
        };
        agents.start(BENCHMARK);
        agents
    }
}

impl Agents {
    /// Puts all agents where their missions begin.
    pub fn start(&mut self, missions: [Mission; AGENTS]) {
        self.missions = missions;
        for (i, mission) in missions.iter().enumerate() {
            let pose = roads::ALL[mission.way(mission.from_lane)].at(mission.from_m);
            (self.x[i], self.y[i], self.hx[i], self.hy[i]) = (pose.x, pose.y, pose.hx, pose.hy);
            (self.speed[i], self.steering[i], self.driven[i]) = (mission.speed(), 0.0, 0.0);
            self.acceleration[i] = 0.0;
            (self.lane[i], self.along[i], self.offset[i]) = (mission.from_lane, mission.from_m, 0.0);
            self.goals[i] = mission.goal();
        }
    }

    /// The way an agent is on: its route, in the nearer lane.
    pub fn way(&self, i: usize) -> usize {
        self.missions[i].way(self.lane[i])
    }

    /// How far from the goal, in metres.
    pub fn to_goal(&self, i: usize) -> f32 {
        let (x, y) = self.goals[i];
        ((x - self.x[i]).powi(2) + (y - self.y[i]).powi(2)).sqrt()
    }

    /// Moves an agent's car by half a step. The lane that the action aims at was chosen at the step's begin, see
    /// [`aim`](Self::aim).
    pub fn drive(&mut self, i: usize, action: Action, aim: u8) {
        let way = &roads::ALL[self.missions[i].way(aim)];
        let (s, offset) =
            if aim == self.lane[i] { (self.along[i], self.offset[i]) } else { way.project(self.x[i], self.y[i]) };
        let speed = self.speed[i];
        let wanted = self.wheels(i, way, s, offset);
        let most = STEERING_RATE * SUBSTEP_S;
        let steering = self.steering[i] + (wanted - self.steering[i]).clamp(-most, most);
        let target = action.speed().min(turn_limit(way, s, speed, 1.0 / SPEED_GAIN));
        let acceleration = (SPEED_GAIN * (target - speed)).clamp(-BRAKING, ACCELERATION);
        let after = (speed + acceleration * SUBSTEP_S).max(0.0);
        self.roll(i, steering, (speed + after) / 2.0 * SUBSTEP_S);
        self.acceleration[i] = (after - speed) / SUBSTEP_S;
        (self.speed[i], self.steering[i]) = (after, steering);
        self.locate(i);
    }

    /// The lane that an action aims at.
    pub fn aim(&self, i: usize, action: Action) -> u8 {
        action.lane(self.lane[i])
    }

    /// The tangent of the front wheels' angle that leads to the way: towards it at an angle that falls with the offset,
    /// and turning into that angle within a quarter of the same length.
    fn wheels(&self, i: usize, way: &Way, s: f32, offset: f32) -> f32 {
        let speed = self.speed[i];
        let length = 2.0 + 0.4 * speed;
        let (wx, wy) = way.heading(s);
        let (cx, cy) = self.course(i, self.steering[i]);
        let error = wy * cx - wx * cy; // sine of the angle to the right of the way
        let towards = (-offset / length).clamp(-APPROACH, APPROACH);
        let most = CORRECTION / speed.max(2.0).powi(2);
        let correction = (4.0 / length * (towards - error)).clamp(-most, most);
        let curvature = way.curvature_at(s + speed * PREVIEW_S) + correction;
        (curvature * WHEELBASE_M).clamp(-FULL_STEERING, FULL_STEERING)
    }

    /// Where the body's middle moves, a unit vector: to the side of where the car points if it steers.
    fn course(&self, i: usize, steering: f32) -> (f32, f32) {
        let slip = steering / 2.0; // tangent; the middle is halfway between the axles
        let cos = 1.0 / (1.0 + slip * slip).sqrt();
        turned(self.hx[i], self.hy[i], cos, slip * cos)
    }

    /// Rolls a distance with the wheels held (kinematic bicycle).
    fn roll(&mut self, i: usize, steering: f32, metres: f32) {
        let cos = 1.0 / (1.0 + steering * steering / 4.0).sqrt();
        // Half the turn before the move and half after it: exact on a circle up to the third order.
        let half = metres * cos * steering / WHEELBASE_M / 2.0;
        let (turn_cos, turn_sin) = small_turn(half);
        let (hx, hy) = turned(self.hx[i], self.hy[i], turn_cos, turn_sin);
        (self.hx[i], self.hy[i]) = (hx, hy);
        let (cx, cy) = self.course(i, steering);
        self.x[i] += metres * cx;
        self.y[i] += metres * cy;
        let (hx, hy) = turned(hx, hy, turn_cos, turn_sin);
        let norm = 1.0 / (hx * hx + hy * hy).sqrt(); // rounding would add up
        (self.hx[i], self.hy[i]) = (hx * norm, hy * norm);
        self.driven[i] += metres;
    }

    /// Finds the nearer lane of the route, and the place in it.
    fn locate(&mut self, i: usize) {
        let (own, other) = (self.lane[i], 1 - self.lane[i]);
        let (s, offset) = roads::ALL[self.missions[i].way(own)].project(self.x[i], self.y[i]);
        (self.along[i], self.offset[i]) = (s, offset);
        if offset.abs() > roads::LANE_M / 2.0 {
            let (s, offset) = roads::ALL[self.missions[i].way(other)].project(self.x[i], self.y[i]);
            if offset.abs() < self.offset[i].abs() {
                (self.lane[i], self.along[i], self.offset[i]) = (other, s, offset);
            }
        }
    }
}

/// A vector turned to the right.
fn turned(x: f32, y: f32, cos: f32, sin: f32) -> (f32, f32) {
    (x * cos + y * sin, y * cos - x * sin)
}

/// Cosine and sine of a small angle, by the tangent of its half.
fn small_turn(angle: f32) -> (f32, f32) {
    let t = angle / 2.0;
    let scale = 1.0 / (1.0 + t * t);
    ((1.0 - t * t) * scale, 2.0 * t * scale)
}

#[cfg(test)]
mod tests {
    use super::{super::roads::Turn, *};

    /// Drives one agent with an action, chosen from its state each step; returns the largest offset from the nearer
    /// lane once it is `settled` metres along.
    fn drive(mission: Mission, steps: usize, act: impl Fn(&Agents) -> Action) -> Agents {
        let mut agents = Agents::default();
        agents.start([mission; AGENTS]);
        for _ in 0..steps {
            let action = act(&agents);
            let aim = agents.aim(0, action);
            agents.drive(0, action, aim);
            agents.drive(0, action, aim);
        }
        agents
    }

    #[test]
    fn a_car_keeps_its_lane_through_every_turn_to_a_third_of_a_metre() {
        for from in roads::Arm::ALL {
            for (turn, lane) in Turn::ALL.into_iter().flat_map(|turn| [(turn, 0), (turn, 1)]) {
                let mission = Mission { from, from_lane: lane, from_m: 20.0, turn, to_lane: lane, to_m: 30.0 };
                let worst = std::cell::Cell::new(0.0_f32);
                let agents = drive(mission, 80, |agents| {
                    worst.set(worst.get().max(agents.offset[0].abs()));
                    Action::KeepLane
                });
                assert!(worst.get() < 0.35, "{turn:?} in lane {lane}: {}", worst.get());
                assert_eq!(agents.lane[0], lane);
                assert!(agents.along[0] > mission.goal_m(&roads::ALL[mission.way(lane)]) - 10.0);
            }
        }
    }

    #[test]
    fn a_car_changes_lanes_within_40_m_at_speed_and_does_not_swing_over() {
        let mission =
            Mission { from: roads::Arm::West, from_lane: 1, from_m: 5.0, turn: Turn::Straight, to_lane: 0, to_m: 60.0 };
        let (worst, settled) = (std::cell::Cell::new(0.0_f32), std::cell::Cell::new(f32::INFINITY));
        drive(mission, 60, |agents| {
            let beside = roads::ALL[mission.way(0)].project(agents.x[0], agents.y[0]).1;
            worst.set(worst.get().max(beside));
            if beside.abs() > 0.3 {
                settled.set(agents.along[0]);
            }
            Action::ChangeRight
        });
        assert!(worst.get() < 0.2, "{}", worst.get());
        assert!(settled.get() - 5.0 < 40.0, "{}", settled.get());
    }

    #[test]
    fn a_car_reaches_15_m_per_s_in_its_lane_and_12_5_while_it_changes_lanes() {
        assert_eq!(Action::ALL.map(Action::speed), [15.0, 0.0, 12.5, 12.5]);
        let mission = Mission { from_m: 0.0, ..BENCHMARK[1] };
        for (action, expected) in [(Action::KeepLane, 15.0), (Action::ChangeRight, 12.5)] {
            let speed = drive(mission, 60, |_| action).speed[0];
            assert!((speed - expected).abs() < 0.01, "{action:?}: {speed}");
        }
    }

    #[test]
    fn braking_from_the_limit_takes_12_to_15_m_and_ends_in_a_standstill() {
        let mission = Mission { from_m: 0.0, ..BENCHMARK[1] };
        let agents = drive(mission, 60, |_| Action::SlowDown);
        assert!(agents.speed[0] < 1e-3, "{}", agents.speed[0]);
        assert!((12.0..17.0).contains(&agents.along[0]), "{}", agents.along[0]);
    }

    #[test]
    fn turns_are_taken_at_sumos_speeds() {
        for (turn, expected) in [(Turn::Left, 9.26), (Turn::Right, 6.5)] {
            let lane = u8::from(turn == Turn::Left);
            let mission =
                Mission { from: roads::Arm::West, from_lane: lane, from_m: 20.0, turn, to_lane: lane, to_m: 30.0 };
            let way = &roads::ALL[mission.way(lane)];
            let most = std::cell::Cell::new(0.0_f32);
            drive(mission, 80, |agents| {
                if (way.approach_m + 1.0..way.leaves_m()).contains(&agents.along[0]) {
                    most.set(most.get().max(agents.speed[0]));
                }
                Action::KeepLane
            });
            assert!((most.get() - expected).abs() < 0.6, "{turn:?}: {}", most.get());
        }
    }
}
