//! The headless simulator: a closed-loop world of our own.
//!
//! ```text
//! Command ─▶ vehicle ─▶ judge ─▶ camera ─▶ Observation
//!              ▲          ▲        ▲
//!              └─ track, traffic ──┘  (conditions: light, weather, latency)
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`track`] | roads: the stock simulator's three, and random ones |
//! | [`vehicle`] | the car's physics |
//! | [`expert`] | drives a known road well: for recordings, and as the scripted human |
//! | [`scene`] | what stands and moves on the road |
//! | [`scenario`], [`traffic`] | scripts of other traffic, and the traffic that follows them |
//! | [`obstacles`] | oriented boxes, whether they touch, and when they will |
//! | [`collision_course`] | how long until the car hits what is ahead |
//! | [`judge`] | laps, collisions, off the road, stuck, wrong way |
//! | [`camera`], [`conditions`] | what a camera on the car sees, in which light and weather |
//! | [`world`] | all of it under one clock, as a [`World`](lapwing_core::protocol::World) |
//! | [`spec`] | a world as people name it |
//! | [`known`] | a track as a known road, on which drives are located |
//! | [`locate`] | where a car was in each picture of a recording |
//! | [`along`] | a recording as a closed-loop world |
//! | [`ahead`] | a pilot that allows for commands that take effect late |
//! | [`braking`] | hazards, a driver who brakes as people do, and their recordings |
//! | [`record`] | training data: what the expert would do, whoever drives |
//! | [`intersection`] | four agents at an intersection: the world of multi-agent learning |
//!
//! No libtorch, no async runtime, no C++: this crate and `lapwing-core` are all that a simulation needs.
//!
//! # Example
//! Two seconds of the expert on a random road, in lock step:
//! ```
//! use std::{sync::Arc, time::Instant};
//! use lapwing_core::{config::ControlSettings, drive, driver::Driver, pilot::PurePursuit};
//! use lapwing_sim::{camera::Scenery, track::Track, world::{Setup, Simulation}};
//!
//! let track = Arc::new(Track::open("random:7")?);
//! let scenery = Arc::new(Scenery::new(&track));
//! let mut world = Simulation::new(Setup { longest_s: Some(2.0), ..Setup::new(track, scenery) })?;
//! let mut driver = Driver::new(Box::new(PurePursuit::default()), &ControlSettings::default(), Instant::now);
//! drive::run(&mut world, &mut driver, &mut [])?;
//! assert!(world.time_s() >= 2.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod ahead;
pub mod along;
pub mod braking;
pub mod camera;
pub mod collision_course;
pub mod conditions;
pub mod expert;
pub mod intersection;
pub mod judge;
pub mod known;
pub mod locate;
pub mod obstacles;
pub mod record;
pub mod scenario;
pub mod scene;
pub mod spec;
pub mod track;
pub mod traffic;
pub mod vehicle;
pub mod world;
