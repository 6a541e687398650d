//! The stock simulator's car: its dimensions, and the rules of its `CarController` that other modules need.
//!
//! Plain numbers, with their units in the names. How they act on one another is `lapwing_sim::vehicle`; how a car moves
//! on its wheels is [`motion`](crate::motion).

/// The steering angle at full command in every build of the simulator (`CarController`'s maximum), in degrees.
pub const FULL_STEERING_DEG: f64 = 25.0;

/// From the car's origin, which is its centre of mass, to the front axle, in metres: z +1.27 of Unity's car object.
pub const FRONT_AXLE_M: f64 = 1.27;

/// From the origin to the rear axle, in metres: z -1.60.
pub const REAR_AXLE_M: f64 = 1.60;

/// From axle to axle, in metres.
pub const WHEELBASE_M: f64 = FRONT_AXLE_M + REAR_AXLE_M;

/// Width of the body, in metres.
pub const WIDTH_M: f64 = 2.43;

/// Its height, in metres.
pub const HEIGHT_M: f64 = 1.4;

/// Its length, in metres.
pub const LENGTH_M: f64 = 4.47;

/// The speed cap, in mph.
pub const TOP_SPEED_MPH: f64 = 30.0;

/// A car that is this far from where it was a telemetry before was put there, in metres: at its cap it takes one and a half
/// seconds for them.
pub const PUT_M: f64 = 20.0;

/// Below this speed, in mph, the car's brake is its reverse gear (`CarController`: brake torque only above 5 mph).
pub const REVERSES_BELOW_MPH: f64 = 5.0;

/// Gravity, in metres per second squared. Full brake locks the wheels, and tyres on asphalt hold about this much.
pub const GRAVITY: f64 = 9.81;

/// A car below this speed, in mph, is stuck …
pub const STUCK_MPH: f64 = 1.0;

/// … if it stays below it for this long, in seconds (SelfOracle: 120 game frames at 60 Hz).
pub const STUCK_S: f64 = 2.0;

/// A car that stands with less throttle than this is waiting, not stuck.
pub const STUCK_THROTTLE: f64 = 0.05;

/// How long after a start or a reset a car may stand, in seconds.
pub const GRACE_S: f64 = 5.0;
