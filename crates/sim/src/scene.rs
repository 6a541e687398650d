//! What stands and moves on a road: seen by the camera, hit by the car.

use std::fmt;

use glam::DVec3;

/// Something on or beside the road: an oriented box to the car, a picture to the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Actor {
    /// What it is.
    pub kind: ActorKind,
    /// The middle of its footprint, on the ground.
    pub position: DVec3,
    /// Where it faces, radians clockwise from +z.
    pub yaw: f64,
    /// Metres a second along `yaw`.
    pub speed: f64,
    /// Selects its colour.
    pub look: u32,
}

/// Kinds of actors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActorKind {
    /// Another car.
    Car,
    /// An adult on foot.
    Pedestrian,
    /// A child on foot.
    Child,
    /// A traffic cone.
    Cone,
    /// A barrier across part of the road.
    Barrier,
}

impl ActorKind {
    /// Width, height and length of its box, in metres.
    pub fn size(self) -> DVec3 {
        match self {
            Self::Car => DVec3::new(1.8, 1.5, 4.4),
            Self::Pedestrian => DVec3::new(0.5, 1.8, 0.6), // Euro NCAP's adult target
            Self::Child => DVec3::new(0.5, 1.15, 0.71 / 1.2), // Euro NCAP's child target
            Self::Cone => DVec3::new(0.4, 0.75, 0.4),
            Self::Barrier => DVec3::new(2.0, 1.0, 0.4),
        }
    }
}

impl fmt::Display for ActorKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Car => "a car",
            Self::Pedestrian => "a pedestrian",
            Self::Child => "a child",
            Self::Cone => "a cone",
            Self::Barrier => "a barrier",
        })
    }
}
