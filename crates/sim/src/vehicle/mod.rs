//! The car: how it answers to steering and throttle.
//!
//! A single-track car on one plane that tilts with the road: forward speed, lateral speed and yaw rate, tyres whose
//! force rises with slip to a peak and then falls, and around it what the simulator's `CarController` (Unity's Standard
//! Assets) does each physics step: steering without a rate limit, drive and brake torque, reverse, traction control,
//! steer helper, speed cap, downforce. Collisions are not handled here.
//!
//! Numbers are the stock simulator's unless they say otherwise. Those fitted to
//! recordings of it are checked by `calibrate` in `tools/`.

mod tyre;

use glam::DVec3;

use lapwing_core::{
    car::{
        FRONT_AXLE_M, FULL_STEERING_DEG, GRAVITY, HEIGHT_M, LENGTH_M, REAR_AXLE_M, REVERSES_BELOW_MPH, TOP_SPEED_MPH,
        WHEELBASE_M, WIDTH_M,
    },
    protocol::Command,
    units::{MPS_PER_MPH, Mph, Steering, Throttle},
};

/// One step of the physics, in seconds (Unity's fixed timestep).
pub const STEP_S: f64 = 0.02;
/// Top speed, in metres per second. It is enforced before the forces of a step act, so that a car at full
/// throttle shows 30.19 mph, as the recordings do.
pub const TOP_SPEED: f64 = TOP_SPEED_MPH * MPS_PER_MPH;
/// Width, height and length of the body, in metres.
pub const BODY: DVec3 = DVec3::new(WIDTH_M, HEIGHT_M, LENGTH_M);

const MASS_KG: f64 = 1000.0;
/// What the drive has to accelerate: the car, and four wheels of Unity's default 20 kg as discs, each with the inertia
/// of half its mass. From a standstill the mountain recording gains 11.8 mph/s: 5.5 m/s2 less drag.
const INERTIAL_MASS_KG: f64 = MASS_KG + 4.0 * 0.5 * 20.0;
/// Moment of inertia about the upright axis, in kg m2. Fitted: the yaw rate seen in the frames lags the steering by
/// about 0.15 s at 30 mph and half of that at 10 mph (`calibrate`: 1500 gives correlations of 0.983 over lake
/// and jungle; 2157, a solid box's, and 3000 gave 0.98 and 0.97).
const YAW_INERTIA: f64 = 1500.0;
/// Sum over the wheels of 1 / radius, per metre: converts a torque per wheel into a force.
const WHEELS_PER_M: f64 = 2.0 / 0.335 + 2.0 / 0.37;
/// Of this, the front wheels' share.
const FRONT_SHARE: f64 = 2.0 / 0.335 / WHEELS_PER_M;
/// Drive torque over all wheels at full throttle, in Nm.
const DRIVE_NM: f64 = 2000.0;
/// Brake torque of each wheel at full brake, in Nm: enough to lock it.
const BRAKE_NM: f64 = 20_000.0;
/// Torque of each wheel at full reverse, in Nm.
const REVERSE_NM: f64 = 150.0;
/// Below this speed, in metres per second, negative throttle reverses instead of braking.
const REVERSE_BELOW: f64 = REVERSES_BELOW_MPH * MPS_PER_MPH;
/// Beyond this angle between heading and motion, in degrees, negative throttle reverses at any speed.
const BRAKE_WITHIN_DEG: f64 = 50.0;
/// Rigid body's drag, per second.
const DRAG: f64 = 0.1;
/// Rigid body's angular drag, per second.
const ANGULAR_DRAG: f64 = 0.05;
/// The wheels' own damping, in N per m/s: Unity's default 0.25 kg m2/s a wheel.
const WHEEL_DAMPING: f64 = 0.25 * (2.0 / (0.335 * 0.335) + 2.0 / (0.37 * 0.37));
/// Downforce, in N per m/s.
const DOWNFORCE: f64 = 100.0;
/// The share of each turn that `SteerHelper` also applies to the velocity: only the rest must come from the tyres.
const STEER_HELPER: f64 = 0.774;
/// What traction control takes from or gives back to the drive torque each step, in Nm: 10 x TractionControl.
const TRACTION_CONTROL_NM: f64 = 10.0;
/// Slower than this, in metres per second, a car without any drive is put to sleep (Unity: energy under 0.005 J/kg).
const SLEEP_BELOW: f64 = 0.1;
/// Rolling drag of loose ground that has no grip at all, as a share of the weight; on asphalt none. A choice: the
/// recordings hold no drive across dirt. With a verge's grip of 0.6 it costs 0.8 m/s2.
const LOOSE_GROUND_DRAG: f64 = 0.2;

/// How hard full brake slows the car at a crawl, in m/s2: its wheels lock and slide. Downforce adds a tenth at 20 mph.
pub const HARDEST_BRAKING: f64 = tyre::SLIDING * GRAVITY * MASS_KG / INERTIAL_MASS_KG;

/// The throttle under which the brakes give a share, 0 to 1, of [`HARDEST_BRAKING`] at a speed in m/s. The stock car's brakes
/// lock the wheels at a 25th of their torque, so a foot that asks for a share needs this; below 5 mph the brake is the
/// reverse gear, which gives a quarter of it at most.
pub fn braking_throttle(share: f64, speed: f64) -> Throttle {
    let newton = share * HARDEST_BRAKING * INERTIAL_MASS_KG;
    let most = if speed > REVERSE_BELOW { BRAKE_NM } else { REVERSE_NM };
    Throttle::saturating(-(newton / (most * WHEELS_PER_M)).clamp(0.0, 1.0))
}

/// The ground under the car.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ground {
    /// Height of the road, in metres.
    pub height: f64,
    /// Metres climbed per metre forward.
    pub grade: f64,
    /// Share of the tyres' grip on asphalt: 1 on the road, less beside it.
    pub grip: f64,
}

impl Default for Ground {
    /// Level asphalt at height 0.
    fn default() -> Self {
        Self { height: 0.0, grade: 0.0, grip: 1.0 }
    }
}

/// A car in motion. The default stands at the origin, faces +z, and its engine has its full torque.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Car {
    /// Where its origin is, on the ground between the axles as Unity's car object.
    pub position: DVec3,
    /// Where it faces, radians clockwise from +z; not wrapped, so that it counts turns.
    pub yaw: f64,
    /// Metres a second along its heading, negative in reverse.
    pub speed: f64,
    /// Metres a second to its right: it slips.
    pub lateral_speed: f64,
    /// Radians a second, clockwise.
    pub yaw_rate: f64,
    /// Nose up, in radians.
    pub pitch: f64,
    /// Angle of the front wheels during the last step, in radians, positive to the right.
    pub steering: f64,
    /// Throttle during the last step, -1 to 1: a negative one brakes or reverses.
    pub throttle: f64,
    /// What traction control has taken from the drive torque, in Nm over all wheels: 0 to 2000.
    pub torque_cut: f64,
}

impl Car {
    /// A car that stands at `position`; `yaw` in radians clockwise from +z.
    pub fn standing(position: DVec3, yaw: f64) -> Self {
        Self { position, yaw, ..Self::default() }
    }

    /// What the simulator reports as speed: how fast it moves, in any direction, hence never negative.
    pub fn telemetry_speed(&self) -> Mph {
        Mph::saturating(self.speed.hypot(self.lateral_speed) / MPS_PER_MPH)
    }

    /// The unit vector of its heading in the horizontal plane.
    pub fn ahead(&self) -> DVec3 {
        DVec3::new(self.yaw.sin(), 0.0, self.yaw.cos())
    }

    /// Its velocity, in metres per second, in the horizontal plane.
    pub fn velocity(&self) -> DVec3 {
        let (sin, cos) = self.yaw.sin_cos();
        let forward = self.speed * self.pitch.cos();
        DVec3::new(sin * forward + cos * self.lateral_speed, 0.0, cos * forward - sin * self.lateral_speed)
    }

    /// One step of [`STEP_S`].
    pub fn step(&mut self, command: Command, ground: Ground) {
        let throttle = command.throttle.get();
        self.throttle = throttle;
        self.steering = (command.steering.get() * FULL_STEERING_DEG).to_radians();
        let motion = self.speed.hypot(self.lateral_speed);
        let braking = self.brakes_at(motion);
        self.cap(motion);
        let motion = motion.min(TOP_SPEED);

        self.pitch = ground.grade.atan();
        let (climb, upright) = self.pitch.sin_cos();
        let load = MASS_KG * GRAVITY * upright + DOWNFORCE * motion;
        let grip = load * ground.grip.max(0.0);

        // Forces along the wheels. Locked ones slide; reversing and driving ones may spin.
        let mut along = throttle.max(0.0) * (DRIVE_NM - self.torque_cut) / 4.0 * WHEELS_PER_M;
        if throttle < 0.0 && !braking {
            along += throttle * REVERSE_NM * WHEELS_PER_M;
        }
        let spins = along.abs() > grip;
        along = along.clamp(-grip, grip);
        let cut = if spins { TRACTION_CONTROL_NM } else { -TRACTION_CONTROL_NM };
        self.torque_cut = (self.torque_cut + cut).clamp(0.0, DRIVE_NM);
        let brake =
            if braking { (-throttle.min(0.0) * BRAKE_NM * WHEELS_PER_M).min(tyre::SLIDING * grip) } else { 0.0 };
        // The tyres cannot give sideways what they give lengthwise.
        let used = if grip > 0.0 { (along.abs() + brake) / grip } else { 1.0 };
        let sideways = grip * (1.0 - used * used).max(0.0).sqrt();

        let across = self.steer_and_slip(sideways);
        let resistance = brake + LOOSE_GROUND_DRAG * (1.0 - ground.grip).clamp(0.0, 1.0) * load;
        let push = along * (FRONT_SHARE * self.steering.cos() + 1.0 - FRONT_SHARE) - across - MASS_KG * GRAVITY * climb;
        self.roll(push, resistance, throttle);

        // The helper turns the velocity, too, so the body turns relative to it only by the rest.
        let (sin, cos) = ((1.0 - STEER_HELPER) * self.yaw_rate * STEP_S).sin_cos();
        let (forward, lateral) = (self.speed, self.lateral_speed);
        self.speed = forward * cos + lateral * sin;
        self.lateral_speed = lateral * cos - forward * sin;

        self.yaw += self.yaw_rate * STEP_S;
        self.position += self.velocity() * STEP_S;
        self.position.y = ground.height;
    }

    /// One step of [`STEP_S`] on level asphalt at a speed that is known, in metres a second.
    pub fn step_at(&mut self, speed: f64, steering: Steering) {
        self.speed = speed;
        self.step(Command { steering, throttle: Throttle::ZERO }, Ground::default());
    }

    /// Whether negative throttle brakes; otherwise it reverses.
    fn brakes_at(&self, motion: f64) -> bool {
        motion > REVERSE_BELOW && self.speed > motion * BRAKE_WITHIN_DEG.to_radians().cos()
    }

    /// The speed cap, which keeps the direction of motion.
    fn cap(&mut self, motion: f64) {
        if motion > TOP_SPEED {
            self.speed *= TOP_SPEED / motion;
            self.lateral_speed *= TOP_SPEED / motion;
        }
    }

    /// Lateral speed and yaw rate one step on, under tyres that can give `grip` newtons sideways in all. Returns the
    /// force with which the steered front tyres hold the car back, in newtons.
    ///
    /// The tyres' forces are taken at the end of the step, linearised: otherwise they would be far too stiff for the
    /// step at walking speed, and the car would tremble.
    fn steer_and_slip(&mut self, grip: f64) -> f64 {
        let (sin, cos) = self.steering.sin_cos();
        let at_front = self.lateral_speed + FRONT_AXLE_M * self.yaw_rate;
        let at_rear = self.lateral_speed - REAR_AXLE_M * self.yaw_rate;
        let front = tyre::force(
            grip * REAR_AXLE_M / WHEELBASE_M,
            self.speed * cos + at_front * sin,
            at_front * cos - self.speed * sin,
        );
        let rear = tyre::force(grip * FRONT_AXLE_M / WHEELBASE_M, self.speed, at_rear);

        let (stiff_front, stiff_rear) = (front.stiffness * cos * cos, rear.stiffness);
        let sway = (front.newton * cos + rear.newton) / MASS_KG - DRAG * self.lateral_speed;
        let twist = (FRONT_AXLE_M * front.newton * cos - REAR_AXLE_M * rear.newton) / YAW_INERTIA
            - ANGULAR_DRAG * self.yaw_rate;
        // (1 - dt J) (change) = dt (rate), solved for the change of lateral speed and yaw rate.
        let moment = FRONT_AXLE_M * stiff_front - REAR_AXLE_M * stiff_rear;
        let square = FRONT_AXLE_M * FRONT_AXLE_M * stiff_front + REAR_AXLE_M * REAR_AXLE_M * stiff_rear;
        let a = 1.0 + STEP_S * ((stiff_front + stiff_rear) / MASS_KG + DRAG);
        let b = STEP_S * moment / MASS_KG;
        let c = STEP_S * moment / YAW_INERTIA;
        let d = 1.0 + STEP_S * (square / YAW_INERTIA + ANGULAR_DRAG);
        let determinant = a * d - b * c;
        let (sway, twist) = (STEP_S * sway, STEP_S * twist);
        let (more_lateral, more_yaw) = ((d * sway - b * twist) / determinant, (a * twist - c * sway) / determinant);
        self.lateral_speed += more_lateral;
        self.yaw_rate += more_yaw;
        let newton = front.newton - front.stiffness * cos * (more_lateral + FRONT_AXLE_M * more_yaw);
        newton * sin
    }

    /// Forward speed one step on, pushed by a force and held by a resistance that never turns the motion around.
    fn roll(&mut self, push: f64, resistance: f64, throttle: f64) {
        let force = push - WHEEL_DAMPING * self.speed;
        let free = self.speed + STEP_S * (force / INERTIAL_MASS_KG - DRAG * self.speed);
        let held = STEP_S * resistance / INERTIAL_MASS_KG;
        self.speed = if free.abs() <= held { 0.0 } else { free - held.copysign(free) };
        let asleep = throttle == 0.0 && push.abs() < MASS_KG * SLEEP_BELOW && self.speed.abs() < SLEEP_BELOW;
        if asleep && self.lateral_speed.abs() < SLEEP_BELOW {
            (self.speed, self.lateral_speed, self.yaw_rate) = (0.0, 0.0, 0.0);
        }
    }
}

#[cfg(test)]
mod tests;
