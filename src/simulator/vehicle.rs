//! The car: how it answers to steering and throttle.
//!
//! Numbers are the stock simulator's `CarController` unless they say otherwise.

use glam::DVec3;

use crate::{
    protocol::Command,
    units::{FULL_STEERING_DEG, MPS_PER_MPH},
};

/// One step of the physics, in seconds (Unity's fixed timestep).
pub const STEP_S: f64 = 0.02;
/// From axle to axle, in metres.
pub const WHEELBASE_M: f64 = 2.87;
/// Top speed, in metres per second.
pub const TOP_SPEED: f64 = 30.0 * MPS_PER_MPH;
/// Width, height and length of the body, in metres.
pub const BODY: DVec3 = DVec3::new(2.43, 1.4, 4.47);

/// The ground under the car.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ground {
    /// Height of the road, in metres.
    pub height: f64,
    /// Metres climbed a metre forward.
    pub grade: f64,
    /// Share of the tyres' grip on asphalt: 1 on the road, less beside it.
    pub grip: f64,
}

/// A car in motion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Car {
    /// Where its origin is, on the ground between the axles as Unity's car object.
    pub position: DVec3,
    /// Where it faces, radians clockwise from +z.
    pub yaw: f64,
    /// Metres a second, negative in reverse.
    pub speed: f64,
    /// Radians a second, clockwise.
    pub yaw_rate: f64,
    /// Nose up, in radians.
    pub pitch: f64,
}

impl Car {
    /// One step of [`STEP_S`].
    pub fn step(&mut self, command: Command, ground: Ground) {
        let steering = (command.steering.get() * FULL_STEERING_DEG).to_radians();
        let throttle = command.throttle.get();
        let acceleration = if throttle >= 0.0 { throttle * 5.0 } else { throttle * 8.0 };
        self.speed = (self.speed + (acceleration - 9.81 * ground.grade) * STEP_S).clamp(0.0, TOP_SPEED);
        self.yaw_rate = self.speed * steering.tan() / WHEELBASE_M;
        self.yaw += self.yaw_rate * STEP_S;
        self.position += DVec3::new(self.yaw.sin(), 0.0, self.yaw.cos()) * (self.speed * STEP_S);
        self.position.y = ground.height;
        self.pitch = ground.grade.atan();
    }
}
