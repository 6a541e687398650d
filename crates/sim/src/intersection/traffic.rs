//! Background traffic: cars that arrive on the arms, follow one another, wait for their turn to cross, and leave.
//!
//! They keep to their lanes' middles. Following is the Intelligent Driver Model (Treiber, Hennecke and Helbing 2000)
//! with SUMO's default acceleration and braking; who may enter the box is decided in `right_of_way`. An agent in the
//! way of a car is to it as a car ahead.
//!
//! All state stands in arrays over the cars.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{
    AGENTS, LENGTH_M, SUBSTEP_S, WIDTH_M,
    agents::Agents,
    missions::turn_limit,
    right_of_way::{self, Right},
    roads::{self, Pose, SPEED_LIMIT, WAYS, Way},
};

/// The most background cars at a time.
pub const CARS: usize = 12;

/// IDM: acceleration, in m/s2 (SUMO's passenger car).
const ACCELERATION: f32 = 2.6;
/// IDM: comfortable braking, in m/s2.
const BRAKING: f32 = 4.5;
/// IDM: time gap, in seconds.
const HEADWAY_S: f32 = 1.0;
/// IDM: gap at a standstill, in metres.
const GAP_M: f32 = 2.5;
/// The hardest a car brakes, in m/s2 (SUMO's emergency braking).
const EMERGENCY: f32 = 9.0;
/// m/s2 for each m/s too fast for a turn.
const TURN_GAIN: f32 = 2.0;
/// Spread of the drivers' speeds around their means, as a share of the limit (`speedFactor`).
const SPEED_SPREAD: f32 = 0.2;
/// Mean speeds of impatient and patient drivers, as shares of the limit (`4lane_sv` of SMARTS has half of each).
const SPEED_MEANS: (f32, f32) = (1.0, 0.8);
/// Slowest and fastest driver, as shares of the limit.
const SPEED_RANGE: (f32, f32) = (0.5, 1.5);
/// How long a place in the traffic stays empty on average, in seconds.
const EMPTY_S: f32 = 1.5;
/// A car that finds no room to arrive tries again after this long, in seconds.
const AGAIN_S: f32 = 0.5;
/// An agent whose middle is this far or less beside a car's way is in its way, in metres.
const IN_THE_WAY_M: f32 = WIDTH_M + 0.3;
/// Cars look this far ahead, in metres.
const SIGHT_M: f32 = 60.0;
/// At the start of an episode no car is nearer to an agent in its lane than this, in metres.
const CLEAR_M: f32 = 25.0;

/// All background cars.
#[derive(Debug, Clone)]
pub struct Traffic {
    /// How many of the places are used.
    pub places: usize,
    /// Whether a car is in that place.
    pub present: [bool; CARS],
    /// The way it is on.
    pub way: [u8; CARS],
    /// Metres along.
    pub along: [f32; CARS],
    /// In m/s.
    pub speed: [f32; CARS],
    /// Where it is.
    pub pose: [Pose; CARS],
    /// The step at which its nose came into the box.
    pub entered: [Option<u32>; CARS],
    /// Whether it may enter the box.
    pub right: [Right; CARS],
    /// Since which step it has been waiting to.
    pub since: [u32; CARS],
    /// The time that it leaves an agent between their crossings, in seconds.
    pub margin_s: [f32; CARS],
    /// The speed that its driver wants, in m/s.
    wish: [f32; CARS],
    /// m/s2 in this step.
    pub acceleration: [f32; CARS],
    /// Seconds until the next car arrives in an empty place.
    empty_s: [f32; CARS],
}

/// How one way's cars matter to another's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Related {
    No,
    /// They begin in the same lane.
    Begin,
    /// They end in the same lane.
    End,
    /// They are the same.
    Same,
}

const RELATED: [[Related; WAYS]; WAYS] = {
    let mut related = [[Related::No; WAYS]; WAYS];
    let mut i = 0;
    while i < WAYS {
        let mut j = 0;
        while j < WAYS {
            let (a, b) = (&roads::ALL[i], &roads::ALL[j]);
            if a.lane == b.lane {
                let begin = a.from as usize == b.from as usize;
                related[i][j] = match (begin, a.to as usize == b.to as usize) {
                    (true, true) => Related::Same,
                    (true, false) => Related::Begin,
                    (false, true) => Related::End,
                    (false, false) => Related::No,
                };
            }
            j += 1;
        }
        i += 1;
    }
    related
};

impl Default for Traffic {
    fn default() -> Self {
        Self {
            places: 0,
            present: [false; CARS],
            way: [0; CARS],
            along: [0.0; CARS],
            speed: [0.0; CARS],
            pose: [Pose::default(); CARS],
            entered: [None; CARS],
            right: [Right::None; CARS],
            since: [0; CARS],
            margin_s: [0.0; CARS],
            wish: [0.0; CARS],
            acceleration: [0.0; CARS],
            empty_s: [0.0; CARS],
        }
    }
}

impl Traffic {
    /// An episode's traffic: half of the places have a car somewhere on an arm, the others fill up within seconds.
    pub fn start(&mut self, places: usize, agents: &Agents, random: &mut ChaCha8Rng) {
        self.places = places.min(CARS);
        self.present = [false; CARS];
        for i in 0..self.places {
            self.empty_s[i] = random.random_range(0.0..2.0 * EMPTY_S);
            if random.random_bool(0.5) {
                let way = self.draw(i, random);
                let s = random.random_range(LENGTH_M..way.approach_m - 20.0);
                let is_clear = |lane: (u8, usize), along: f32| lane != lane_of(way) || (along - s).abs() > CLEAR_M;
                let free = (0..AGENTS).all(|k| is_clear(lane_of(&roads::ALL[agents.way(k)]), agents.along[k]))
                    && (0..self.places).all(|j| {
                        !self.present[j] || is_clear(lane_of(&roads::ALL[self.way[j] as usize]), self.along[j])
                    });
                if free {
                    self.arrive(i, s);
                }
            }
        }
    }

    /// Draws who comes next into a place, without letting it in.
    fn draw(&mut self, i: usize, random: &mut ChaCha8Rng) -> &'static Way {
        let way = loop {
            let way = random.random_range(0..WAYS);
            // Straight on from two lanes, turns from one: as many turns as not.
            if roads::ALL[way].is_legal() {
                break way;
            }
        };
        let is_patient = random.random_bool(0.5);
        let mean = if is_patient { SPEED_MEANS.1 } else { SPEED_MEANS.0 };
        // The sum of twelve uniform numbers is as good as normal, and the same on every machine.
        let normal = (0..12).map(|_| random.random_range(0.0..1.0f32)).sum::<f32>() - 6.0;
        self.wish[i] = SPEED_LIMIT * (mean + SPEED_SPREAD * normal).clamp(SPEED_RANGE.0, SPEED_RANGE.1);
        self.margin_s[i] = if is_patient { 1.0 } else { 0.3 };
        self.way[i] = way as u8;
        &roads::ALL[way]
    }

    /// Lets the car drawn for a place begin at a distance along its way, as fast as it can be and still stop.
    fn arrive(&mut self, i: usize, s: f32) {
        let way = &roads::ALL[self.way[i] as usize];
        let room = way.approach_m - s - LENGTH_M / 2.0 - GAP_M;
        self.present[i] = true;
        self.along[i] = s;
        self.speed[i] = self.wish[i].min((2.0 * 0.6 * BRAKING * room.max(0.0)).sqrt());
        self.pose[i] = way.at(s);
        (self.right[i], self.entered[i], self.acceleration[i]) = (Right::None, None, 0.0);
    }

    /// Fills empty places whose time has come, where there is room.
    pub fn arrivals(&mut self, agents: &Agents, alive: [bool; AGENTS], random: &mut ChaCha8Rng) {
        for i in 0..self.places {
            if self.present[i] {
                continue;
            }
            self.empty_s[i] -= 2.0 * SUBSTEP_S;
            if self.empty_s[i] > 0.0 {
                continue;
            }
            let way = self.draw(i, random);
            let s = LENGTH_M / 2.0;
            // As far as it takes to brake from its speed to that of the car ahead, and IDM's gap.
            let is_clear = |along: f32, speed: f32| {
                let wish = self.wish[i];
                let needs = (wish * wish - speed * speed).max(0.0) / (2.0 * 0.6 * BRAKING);
                along - s > LENGTH_M + GAP_M + wish * HEADWAY_S + needs
            };
            let free = (0..self.places).all(|j| {
                let other = &roads::ALL[self.way[j] as usize];
                !self.present[j] || lane_of(other) != lane_of(way) || is_clear(self.along[j], self.speed[j])
            }) && (0..AGENTS).all(|k| {
                !alive[k]
                    || lane_of(&roads::ALL[agents.way(k)]) != lane_of(way)
                    || is_clear(agents.along[k], agents.speed[k])
            });
            if free {
                self.arrive(i, s);
            } else {
                self.empty_s[i] = AGAIN_S;
            }
        }
    }

    /// Decides for this step who may enter the box, and how all accelerate.
    pub fn decide(&mut self, agents: &Agents, alive: [bool; AGENTS], step: u32) {
        right_of_way::decide(self, agents, alive, step);
        for i in 0..self.places {
            if self.present[i] {
                self.acceleration[i] = self.accelerate(i, agents, alive);
            }
        }
    }

    fn accelerate(&self, i: usize, agents: &Agents, alive: [bool; AGENTS]) -> f32 {
        let (own, s, speed) = (usize::from(self.way[i]), self.along[i], self.speed[i]);
        let way = &roads::ALL[own];
        let mut acceleration = follow(speed, self.wish[i], f32::INFINITY, 0.0);
        let mut behind = |ahead: f32, its_speed: f32| {
            if ahead > s && ahead < s + SIGHT_M {
                acceleration = acceleration.min(follow(speed, self.wish[i], ahead - s - LENGTH_M, its_speed));
            }
        };
        for j in 0..self.places {
            if self.present[j] && j != i {
                let (other, along) = (usize::from(self.way[j]), self.along[j]);
                let leaves = roads::ALL[other].leaves_m();
                match RELATED[own][other] {
                    Related::Same => behind(along, self.speed[j]),
                    Related::Begin if along < leaves + LENGTH_M / 2.0 => behind(along, self.speed[j]),
                    Related::End if along > leaves => behind(along - leaves + way.leaves_m(), self.speed[j]),
                    _ => {}
                }
            }
        }
        for k in (0..AGENTS).filter(|k| alive[*k]) {
            if let Some((along, _)) = way.project_within(agents.x[k], agents.y[k], IN_THE_WAY_M)
                && along > s
            {
                let (hx, hy) = way.heading(along);
                let with_it = agents.speed[k] * (agents.hx[k] * hx + agents.hy[k] * hy);
                behind(along, with_it.max(0.0));
            }
        }
        if self.right[i].must_wait() && s < way.approach_m {
            // The line is where the middle of a car would be that stands with its tail on it.
            behind(way.approach_m + LENGTH_M / 2.0, 0.0);
        }
        let allowed = turn_limit(way, s, speed, 1.0 / TURN_GAIN);
        acceleration.min(TURN_GAIN * (allowed - speed)).max(-EMERGENCY)
    }

    /// Moves all by half a step.
    pub fn roll(&mut self, step: u32) {
        for i in 0..self.places {
            if !self.present[i] {
                continue;
            }
            let before = self.speed[i];
            self.speed[i] = (before + self.acceleration[i] * SUBSTEP_S).max(0.0);
            self.along[i] += (before + self.speed[i]) / 2.0 * SUBSTEP_S;
            let way = &roads::ALL[self.way[i] as usize];
            self.pose[i] = way.at(self.along[i]);
            if self.entered[i].is_none() && self.along[i] + LENGTH_M / 2.0 > way.approach_m {
                self.entered[i] = Some(step);
            }
            if self.along[i] > way.length_m() - LENGTH_M / 2.0 {
                self.present[i] = false;
                self.empty_s[i] = EMPTY_S;
            }
        }
    }

    /// Adds a car whose driver wants the limit and is impatient; returns its place.
    #[cfg(test)]
    pub(super) fn put(&mut self, way: usize, along: f32, speed: f32) -> usize {
        let i = self.places;
        self.places += 1;
        (self.present[i], self.way[i], self.along[i], self.speed[i]) = (true, way as u8, along, speed);
        (self.wish[i], self.margin_s[i], self.pose[i]) = (SPEED_LIMIT, 0.3, roads::ALL[way].at(along));
        i
    }

    /// How many cars there are.
    pub fn count(&self) -> usize {
        self.present.iter().filter(|present| **present).count()
    }
}

/// The lane in which a way begins.
fn lane_of(way: &Way) -> (u8, usize) {
    (way.lane, way.from as usize)
}

/// IDM's acceleration at a speed, behind something at a gap, in metres, and a speed.
fn follow(speed: f32, wish: f32, gap: f32, its_speed: f32) -> f32 {
    let free = (speed / wish).powi(4);
    let root = 2.0 * (ACCELERATION * BRAKING).sqrt();
    let wanted = GAP_M + (speed * HEADWAY_S + speed * (speed - its_speed) / root).max(0.0);
    ACCELERATION * (1.0 - free - (wanted / gap.max(0.1)).powi(2))
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn idm_holds_its_gap_behind_a_car_of_the_same_speed_and_its_speed_on_a_free_road() {
        // Equilibrium of the model: gap = (s0 + vT) / sqrt(1 - (v/v0)^4).
        let (speed, wish) = (10.0_f32, 13.89_f32);
        let gap = (2.5 + speed * 1.0) / (1.0 - (speed / wish).powi(4)).sqrt();
        assert!(follow(speed, wish, gap, speed).abs() < 1e-4);
        assert!(follow(speed, wish, gap - 1.0, speed) < 0.0);
        assert!(follow(wish, wish, f32::INFINITY, 0.0).abs() < 1e-4);
        assert!((follow(0.0, wish, f32::INFINITY, 0.0) - 2.6).abs() < 1e-6);
    }

    #[test]
    fn idm_brakes_for_a_slower_car_and_keeps_less_distance_to_a_faster_one() {
        // a = 2.6, b = 4.5, T = 1.0 s, s0 = 2.5 m: 2 sqrt(ab) = 6.841.
        for (its_speed, expected) in [
            (4.0, -2.790_67), // wanted 2.5 + 10 + 10 x 6 / 6.841 = 21.271 m; 2.6 x (1 - 0.0625 - (21.271 / 15)^2)
            (16.0, 2.276_78), // wanted 2.5 + 10 - 10 x 6 / 6.841 = 3.729 m
        ] {
            let found = follow(10.0, 20.0, 15.0, its_speed);
            assert!((found - expected).abs() < 1e-4, "behind {its_speed} m/s: {found}");
        }
    }

    #[test]
    fn half_of_the_drivers_want_the_limit_and_half_four_fifths_of_it_each_with_a_spread_of_a_fifth() {
        let (mut traffic, mut random) = (Traffic::default(), ChaCha8Rng::seed_from_u64(0));
        let (mut impatient, mut patient) = (Vec::new(), Vec::new());
        for _ in 0..20_000 {
            traffic.draw(0, &mut random);
            let factor = f64::from(traffic.wish[0]) / 13.89;
            assert!((0.4999..1.5001).contains(&factor), "{factor}");
            let alike = if traffic.margin_s[0] > 0.5 { &mut patient } else { &mut impatient };
            alike.push(factor);
        }
        // Who would be slower than half the limit drives at half of it; so quartiles, 0.6745 standard deviations off.
        for (mut factors, middle) in [(impatient, 1.0), (patient, 0.8)] {
            factors.sort_by(f64::total_cmp);
            let n = factors.len();
            assert!((9_500..10_500).contains(&n), "{n}");
            let spread = (factors[3 * n / 4] - factors[n / 4]) / 2.0 / 0.6745;
            assert!((factors[n / 2] - middle).abs() < 0.01, "{}", factors[n / 2]);
            assert!((spread - 0.2).abs() < 0.01, "{spread}");
        }
    }
}
