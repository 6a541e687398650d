//! The integration tests, one binary: every further one would link libtorch again.

mod architecture;
mod blind;
mod brake;
mod bridge;
mod closed_loop;
mod controls;
mod corpus;
mod documentation;
mod driver;
mod driving_logs;
mod lane_loop;
mod locate;
mod locate_network;
mod model_files;
mod models;
mod parity;
mod program;
mod recorded_world;
mod recording;
mod replay;
mod results;
mod rounds;
mod serve;
mod simulator;
mod support;
mod truth;
