//! All integration tests in one binary: every further one would link libtorch again.

mod parity;
