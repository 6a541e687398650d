//! A driver who brakes as people do.
//!
//! | what | how | source |
//! |---|---|---|
//! | steering | the expert's line | [`PurePursuit`] |
//! | following and gentle stops | the intelligent driver model, with its authors' numbers | Treiber, Hennecke, Helbing, Congested traffic states in empirical observations and microscopic simulations (2000) |
//! | when the danger is noticed, if the driver looked away | at a time to collision of 2.4 s | the earliest of the three times by which U.S. NCAP wants a forward collision warning (2.0 s slower, 2.1 s standing, 2.4 s braking car) |
//! | when it is noticed, if the driver looks ahead | at 1.5 s | below it an encounter is critical: van der Horst and Hogema, Time-to-collision and collision avoidance systems (1993) |
//! | from there to the foot | the reaction time, drawn around 1 s | ours, see `plan` |
//! | how fast the foot goes down then | so that 4 m/s² are reached in 0.2 s, all of it in 0.35 s | the braking robot of Euro NCAP's AEB Car-to-Car protocol, for forward collision warnings |
//!
//! The texts of U.S. NCAP and Euro NCAP, and the two papers of 1993 and 2000, were not at hand: these numbers are from memory.
//!
//! Only what [can be seen](super::sight) counts.

use super::sight::Sight;
use crate::{
    collision_course::{InTheWay, in_the_way, time_to_collision},
    expert::{DRAG_PER_S, FULL_THROTTLE_MPS2, path_ahead},
    vehicle::{HARDEST_BRAKING, braking_throttle},
    world::Simulation,
};
use lapwing_core::{
    car::GRAVITY,
    pilot::{PurePursuit, PursuitGains},
    protocol::Command,
    units::{MetresPerSecond, PathPoint, Steering, Throttle},
};

/// Noticed at this time to collision, in seconds, by a driver who looked away, and by one who looks ahead.
const NOTICED_LATE_S: f64 = 2.4;
const CRITICAL_S: f64 = 1.5;
/// The foot goes all the way down in this time, in seconds, and in the quickest gentle stop presses this share in a second.
const FOOT_DOWN_S: f64 = 0.2 * HARDEST_BRAKING / 4.0;
const GENTLE_PER_S: f64 = 0.3;
/// It comes off the pedal this fast, in pedals per second.
const OFF_PER_S: f64 = 2.0;
/// The intelligent driver model: acceleration and comfortable deceleration in m/s², time headway in s, gap at a standstill
/// in m, and the exponent of the free road.
const IDM_ACCELERATION: f64 = 0.73;
const IDM_DECELERATION: f64 = 1.67;
const IDM_HEADWAY_S: f64 = 1.6;
const IDM_GAP_M: f64 = 2.0;
const IDM_EXPONENT: i32 = 4;
/// Nobody follows something farther away, in metres.
const FOLLOWED_M: f64 = 120.0;
/// A driver leaves this much room beside the car, in metres.
const SPARE_M: f64 = 0.15;
/// Slower than this the car stands, in m/s.
const STANDING: f64 = 0.15;
/// How much of the pedal holds a car that stands.
const HOLDING: f64 = 0.3;
/// The course must be clear for so long before the foot comes off, in seconds; and the way ahead for so many metres, with this
/// much room beside the car, before the driver goes on.
const CLEAR_S: f64 = 0.6;
const CLEAR_M: f64 = 10.0;
const CLEAR_BESIDE_M: f64 = 0.8;

/// Where the driver's eyes are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Attention {
    /// On the road: whatever stands or drives ahead is braked for in time, and gently.
    Ahead,
    /// Elsewhere, until danger is noticed; from then on ahead.
    Away,
}

/// What the driver does.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Doing {
    Driving,
    /// Noticed something: the foot moves at this time.
    Reacting {
        until_s: f64,
    },
    /// The pedal goes all the way down. Nothing is on a collision course since this time.
    Emergency {
        clear_s: Option<f64>,
    },
    /// Stands after an emergency, since this time.
    Standing {
        since_s: f64,
    },
}

/// How a driver is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Temper {
    /// From noticing to the foot, in seconds.
    pub reaction_s: f64,
    /// The speed to hold, in m/s.
    pub speed_mps: f64,
    /// Where the eyes are at first.
    pub attention: Attention,
    /// How long the car is kept standing after an emergency, in seconds, at least.
    pub rest_s: f64,
    /// For how long the car does not answer the brake in an emergency, in seconds, and keeps its speed. 0 but in what is to be
    /// learnt from.
    pub fails_s: f64,
}

/// A person at the wheel.
#[derive(Debug, Clone)]
pub struct Human {
    temper: Temper,
    doing: Doing,
    attention: Attention,
    pursuit: PurePursuit,
    path: Vec<PathPoint>,
    pedal: f64,
    /// When the foot moved in an emergency first, in seconds of the run.
    pressed_s: Option<f64>,
}

impl Human {
    /// A driver with the foot off the brake.
    pub fn new(temper: Temper) -> Self {
        // Calmer in bends than the expert, whose gains suit laps against time.
        let gains = PursuitGains { lateral_mps2: 3.0, braking_mps2: 1.5, ..PursuitGains::default() };
        Self {
            temper,
            doing: Doing::Driving,
            attention: temper.attention,
            pursuit: PurePursuit::new(gains),
            path: vec![],
            pedal: 0.0,
            pressed_s: None,
        }
    }

    /// How far the brake pedal is down, 0 to 1, since the last command.
    pub fn pedal(&self) -> f64 {
        self.pedal
    }

    /// When the pedal began to go all the way down, in seconds of the run; the first time.
    pub fn pressed_s(&self) -> Option<f64> {
        self.pressed_s
    }

    /// Steering and throttle now, to hold for `dt_s`.
    pub fn drive(&mut self, world: &Simulation, dt_s: f64) -> Command {
        let (track, car, place) = (&*world.setup().track, world.car(), world.place());
        let seen = Sight::of(world).seen();
        let until_s = time_to_collision(track, car, place, &seen);
        let ahead = in_the_way(track, car, place, &seen, SPARE_M);
        let free = in_the_way(track, car, place, &seen, CLEAR_BESIDE_M).is_none_or(|other| other.gap_m > CLEAR_M);
        self.think(world.time_s(), car.speed, until_s, free);
        path_ahead(track, place, car, &mut self.path);
        let pursuit = self.pursuit.pursue(&self.path, MetresPerSecond::saturating(car.speed));
        let limit = pursuit.map_or(0.0, |pursuit| pursuit.speed_limit.metres_per_second().get());
        let uphill = GRAVITY * place.station.grade * (car.yaw - place.station.yaw).cos();
        let throttle = match self.doing {
            Doing::Emergency { .. } => {
                self.press(1.0, FOOT_DOWN_S.recip(), dt_s);
                if self.pressed_s.is_some_and(|pressed_s| world.time_s() - pressed_s < self.temper.fails_s) {
                    Throttle::saturating((DRAG_PER_S * car.speed + uphill) / FULL_THROTTLE_MPS2)
                } else {
                    held(self.pedal, car.speed, uphill)
                }
            }
            Doing::Standing { .. } => {
                self.press(HOLDING, FOOT_DOWN_S.recip(), dt_s);
                held(self.pedal, car.speed, uphill)
            }
            Doing::Driving | Doing::Reacting { .. } => {
                let ahead = ahead.filter(|_| self.attention == Attention::Ahead);
                let wanted = acceleration(car.speed, limit.min(self.temper.speed_mps), ahead);
                self.accelerate(wanted, car.speed, uphill, dt_s)
            }
        };
        Command { steering: Steering::saturating(pursuit.map_or(0.0, |pursuit| pursuit.steering)), throttle }
    }

    /// What follows from a time to collision, and from whether the way is free.
    fn think(&mut self, now_s: f64, speed: f64, until_s: f64, free: bool) {
        let noticed_s = if self.attention == Attention::Away { NOTICED_LATE_S } else { CRITICAL_S };
        self.doing = match self.doing {
            Doing::Driving if until_s < noticed_s && speed > STANDING => {
                Doing::Reacting { until_s: now_s + self.temper.reaction_s }
            }
            // Whoever has noticed something looks there, and lets it be if it is over.
            Doing::Reacting { until_s: foot_s } if now_s >= foot_s => {
                self.attention = Attention::Ahead;
                if until_s.is_finite() { self.presses(now_s) } else { Doing::Driving }
            }
            Doing::Emergency { .. } if speed < STANDING => Doing::Standing { since_s: now_s },
            Doing::Emergency { clear_s } => match clear_s.filter(|_| until_s.is_infinite()) {
                Some(since_s) if now_s - since_s >= CLEAR_S => Doing::Driving,
                Some(since_s) => Doing::Emergency { clear_s: Some(since_s) },
                None => Doing::Emergency { clear_s: until_s.is_infinite().then_some(now_s) },
            },
            Doing::Standing { since_s } if free && now_s - since_s >= self.temper.rest_s => Doing::Driving,
            same => same,
        };
    }

    fn presses(&mut self, now_s: f64) -> Doing {
        self.pressed_s.get_or_insert(now_s);
        Doing::Emergency { clear_s: None }
    }

    /// Moves the foot towards a place of the pedal.
    fn press(&mut self, wanted: f64, per_s: f64, dt_s: f64) {
        self.pedal = (self.pedal + (wanted - self.pedal).clamp(-OFF_PER_S * dt_s, per_s * dt_s)).clamp(0.0, 1.0);
    }

    /// The throttle for an acceleration, in m/s²; brakes only for more than the engine's drag takes.
    fn accelerate(&mut self, wanted: f64, speed: f64, uphill: f64, dt_s: f64) -> Throttle {
        let push = wanted + DRAG_PER_S * speed + uphill;
        let brake = if push < 0.0 { -push / HARDEST_BRAKING } else { 0.0 };
        let stands = speed < STANDING && wanted <= 0.0;
        self.press(if stands { HOLDING } else { brake.min(1.0) }, GENTLE_PER_S, dt_s);
        if stands {
            held(self.pedal, speed, uphill)
        } else if push > 0.0 && self.pedal == 0.0 {
            Throttle::saturating(push / FULL_THROTTLE_MPS2)
        } else {
            braking_throttle(self.pedal, speed)
        }
    }
}

/// The throttle of a pressed pedal, which does not reverse a car that stands, nor let it roll downhill.
fn held(pedal: f64, speed: f64, uphill: f64) -> Throttle {
    if speed > STANDING {
        return braking_throttle(pedal, speed);
    }
    // The stock car has no brake at a standstill: drive and reverse gear hold it against the slope.
    let push = uphill - 2.0 * speed;
    if push > 0.0 {
        Throttle::saturating((push / FULL_THROTTLE_MPS2).min(1.0))
    } else {
        braking_throttle(-push / HARDEST_BRAKING, speed)
    }
}

/// The intelligent driver model's acceleration, in m/s², at a speed on a road with a speed to hold.
fn acceleration(speed: f64, wanted: f64, ahead: Option<InTheWay>) -> f64 {
    let free = if speed <= wanted {
        1.0 - (speed / wanted.max(0.1)).powi(IDM_EXPONENT)
    } else {
        -IDM_DECELERATION / IDM_ACCELERATION * (1.0 - wanted / speed)
    };
    let hindered = ahead.filter(|other| other.gap_m < FOLLOWED_M).map_or(0.0, |other| {
        let root = 2.0 * (IDM_ACCELERATION * IDM_DECELERATION).sqrt();
        let wanted_m = IDM_GAP_M + (speed * IDM_HEADWAY_S + speed * (speed - other.speed_mps) / root).max(0.0);
        (wanted_m / other.gap_m.max(0.1)).powi(2)
    });
    (IDM_ACCELERATION * (free - hindered)).max(-HARDEST_BRAKING)
}
