//! A closed-loop world of our own and how it speaks to a bridge.
//!
//! | file | holds |
//! |---|---|
//! | [`track`] | roads: the stock simulator's three, and random ones |
//! | [`vehicle`] | the car's physics |
//! | [`expert`] | drives a known road well: for recordings, and as the scripted human |
//! | [`scene`] | what stands and moves on the road |
//! | [`scenario`], [`traffic`] | scripts of other traffic, and who follows them |
//! | [`obstacles`] | oriented boxes, whether they touch, and when they will |
//! | [`collision_course`] | how long until the car hits what is ahead |
//! | [`judge`] | laps, collisions, off the road, stuck, wrong way |
//! | [`camera`], [`conditions`] | what a camera on the car sees, in which light and weather |
//! | [`world`] | all of it under one clock, as a [`crate::protocol::World`] |
//! | [`film`], [`map`] | films and maps for people |
//! | [`survey`] | where a recorded drive was on a track, by its pictures and odometry |
//! | [`client`] | plays any [`crate::protocol::World`] to any bridge as the Unity build does |

pub mod camera;
pub mod client;
pub mod collision_course;
pub mod conditions;
pub mod expert;
pub mod film;
pub mod judge;
pub mod map;
pub mod obstacles;
pub mod scenario;
pub mod scene;
pub mod survey;
pub mod track;
pub mod traffic;
pub mod vehicle;
pub mod world;
