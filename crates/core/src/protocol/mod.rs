//! The messages on the wire, for both ends, as text only: no sockets, no clock, no decoding of pictures.
//!
//! A simulator's text comes in as a [`Packet`], and its event's [`Payload`] becomes a [`Telemetry`]. The first one
//! reveals the [`Dialect`], in which each [`Command`] goes out. The other end, for this project's own worlds talking to
//! any bridge, writes telemetry with [`number::Culture`] as Unity's C# does and reads commands as its `float.Parse`
//! does.
//!
//! Source: the simulator's public C# sources, and its client code run against servers. The names on the wire
//! (`steering_angle`, `tot_obes`) stay in this module; the rest of the crate knows typed values with units.

mod command;
mod dialect;
pub mod number;
mod packet;
mod payload;
mod telemetry;
mod world;

pub use command::{Answer, Command, MAX_LAPS, SteerError};
pub use dialect::{Dialect, Undrivable};
pub use packet::{Event, Packet, PacketError};
pub use payload::Payload;
pub use telemetry::{CameraImage, Telemetry, TelemetryError, Truth, encode_superset, encode_telemetry};
pub use world::{Observation, Sight, World};
