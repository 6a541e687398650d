//! The bridge over real sockets, as simulators and clients see it.

mod bad_input;
mod beside;
mod braking;
mod clients;
mod dialects;
mod documented;
mod hands;
mod live_page;
mod liveness;
mod pages;
mod port;
mod schema;
mod tokens;
mod viewers;
mod wire;
