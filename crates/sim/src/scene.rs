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
    /// Selects its colour, and by [`Looks`] its size and shape.
    pub look: u32,
}

impl Actor {
    /// Width, height and length of its box, in metres.
    pub fn size(&self) -> DVec3 {
        self.kind.size() * Looks::stretch(self.kind, self.look)
    }
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
    /// An adult on a bicycle.
    Bicycle,
    /// A traffic cone.
    Cone,
    /// A barrier across part of the road.
    Barrier,
    /// A steel plate that covers a trench: driven over.
    SteelPlate,
}

impl ActorKind {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::Car, Self::Pedestrian, Self::Child, Self::Bicycle, Self::Cone, Self::Barrier, Self::SteelPlate];

    /// Width, height and length of its box, in metres.
    pub fn size(self) -> DVec3 {
        match self {
            Self::Car => DVec3::new(1.8, 1.5, 4.4),
            Self::Pedestrian => DVec3::new(0.5, 1.8, 0.6), // Euro NCAP's adult target
            Self::Child => DVec3::new(0.5, 1.15, 0.71 / 1.2), // Euro NCAP's child target
            Self::Bicycle => DVec3::new(0.5, 1.865, 1.89), // Euro NCAP's bicyclist target, from memory
            Self::Cone => DVec3::new(0.4, 0.75, 0.4),
            Self::Barrier => DVec3::new(2.0, 1.0, 0.4),
            Self::SteelPlate => DVec3::new(2.4, 0.025, 3.7), // FMVSS 127's trench plate, as others quote it
        }
    }

    /// Whether a car cannot drive over it.
    pub fn is_obstacle(self) -> bool {
        self != Self::SteelPlate
    }
}

/// From which wardrobe the looks of actors are drawn: colours, clothes, shapes and sizes. What is learnt from one can be
/// tested on another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Looks {
    /// Every kind in its own size, in a few plain colours.
    #[default]
    Plain,
    /// More colours and shapes, to learn from.
    Learnt,
    /// Others, which nothing was learnt from.
    HeldOut,
}

/// The looks from here on are of the wardrobes other than the plain one, half of them of each.
const OTHERS_FROM: u32 = 0xFFF0_0000;
const HELD_OUT_FROM: u32 = 0xFFF8_0000;

impl Looks {
    /// The look of a random number.
    pub fn look(self, random: u32) -> u32 {
        match self {
            Self::Plain => random % OTHERS_FROM,
            Self::Learnt => OTHERS_FROM + random % (HELD_OUT_FROM - OTHERS_FROM),
            Self::HeldOut => HELD_OUT_FROM + random % (u32::MAX - HELD_OUT_FROM),
        }
    }

    /// The wardrobe of a look.
    pub fn of(look: u32) -> Self {
        match look {
            HELD_OUT_FROM.. => Self::HeldOut,
            OTHERS_FROM.. => Self::Learnt,
            _ => Self::Plain,
        }
    }

    /// How much wider, higher and longer than its kind's box something of this look is.
    fn stretch(kind: ActorKind, look: u32) -> DVec3 {
        let cars = |sizes: [[f64; 3]; 3]| DVec3::from_array(sizes[Self::shape(look)]);
        let grown = |sizes: [f64; 3]| DVec3::splat(sizes[Self::shape(look)]);
        match (kind, Self::of(look)) {
            (ActorKind::Car, Self::Learnt) => cars([[1.0, 1.0, 1.0], [0.95, 1.0, 0.88], [1.06, 1.33, 1.12]]),
            (ActorKind::Car, Self::HeldOut) => cars([[1.03, 1.13, 1.02], [0.91, 1.02, 0.80], [1.10, 1.5, 1.22]]),
            (ActorKind::Pedestrian | ActorKind::Child, Self::Learnt) => grown([1.0, 0.94, 1.05]),
            (ActorKind::Pedestrian | ActorKind::Child, Self::HeldOut) => grown([0.97, 0.9, 1.08]),
            (ActorKind::Bicycle, Self::HeldOut) => grown([0.97, 0.95, 1.03]),
            _ => DVec3::ONE,
        }
    }

    /// Which of a wardrobe's three shapes a look has: saloon, hatchback or van among the cars.
    pub fn shape(look: u32) -> usize {
        look as usize / 32 % 3
    }
}

impl fmt::Display for ActorKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Car => "a car",
            Self::Pedestrian => "a pedestrian",
            Self::Child => "a child",
            Self::Bicycle => "a bicycle",
            Self::Cone => "a cone",
            Self::Barrier => "a barrier",
            Self::SteelPlate => "a steel plate",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_that_is_held_out_has_the_size_of_anything_that_is_learnt_from() {
        for kind in [ActorKind::Car, ActorKind::Pedestrian, ActorKind::Child, ActorKind::Bicycle] {
            let sizes = |looks: Looks| (0..96).step_by(32).map(move |random| Looks::stretch(kind, looks.look(random)));
            for learnt in sizes(Looks::Learnt) {
                assert!(sizes(Looks::HeldOut).all(|size| size != learnt), "{kind}: {learnt}");
            }
        }
    }

    #[test]
    fn a_look_is_of_the_wardrobe_that_it_was_drawn_from() {
        for random in [0, 7, 0x7FFF_FFFF, OTHERS_FROM - 1, OTHERS_FROM, HELD_OUT_FROM, u32::MAX] {
            for looks in [Looks::Plain, Looks::Learnt, Looks::HeldOut] {
                assert_eq!(Looks::of(looks.look(random)), looks, "{random:x}");
            }
        }
    }
}
