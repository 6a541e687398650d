//! The integration tests, one binary: every further one would link libtorch again.

mod driving_logs;
mod parity;
mod recording;
