//! Whether an agent's car touches another one, and whose fault that is.
//!
//! The rules are those of the road:
//! - **Where ways cross or merge**, who entered the box later is at fault: the other one was in it already.
//! - **In the same direction**, who runs into another from behind is, unless that one has just changed into the lane.
//! - **Side by side**, who is out of its lane is.
//!
//! Where the rules blame both or neither, the fault is shared.

use std::f64::consts::TAU;

use glam::DVec2;
use serde::{Deserialize, Serialize};

use super::{LENGTH_M, STEPS, WIDTH_M, roads::Arm};
use crate::obstacles::Box2;

/// Cars whose middles are further apart cannot touch: twice the circle around a body, squared, in m2.
pub(super) const NEAR_M2: f32 = WIDTH_M * WIDTH_M + LENGTH_M * LENGTH_M;
/// Above this cosine of their angle two cars go the same way: 45 degrees.
const SAME_WAY: f32 = 0.7;
/// A car that came into its lane this many steps ago or less has entered another's way: a driver needs a second.
const CUT_IN_STEPS: u32 = 10;
/// A car further from its lane's middle than this is out of its lane, in metres: it overlaps the line.
const OUT_OF_LANE_M: f32 = 0.9;
/// Behind the box a merging car still counts as such, in metres: as far as it takes a second to be seen.
const MERGED_M: f32 = 10.0;

/// Whose fault a crash is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Fault {
    /// The agent's own.
    Own,
    /// The other's.
    Other,
    /// Of both.
    Shared,
}

/// What kind of crash it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Manner {
    /// Where ways cross or merge.
    Crossing,
    /// One ran into the other from behind.
    FromBehind,
    /// Side by side.
    Sideswipe,
}

/// What was hit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Hit {
    /// Another agent.
    Agent(u8),
    /// A background car.
    Traffic(u8),
}

/// An agent's crash.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Crash {
    /// With whom.
    pub with: Hit,
    /// How.
    pub manner: Manner,
    /// Whose fault it is.
    pub fault: Fault,
}

/// What is known of a car in a crash.
#[derive(Debug, Clone, Copy)]
pub(super) struct Party {
    pub x: f32,
    pub y: f32,
    pub hx: f32,
    pub hy: f32,
    /// Where it came from.
    pub from: Arm,
    /// The step at which it entered the box; none if it has not.
    pub entered: Option<u32>,
    /// How far behind the box it is, in metres; negative before its end.
    pub beyond_m: f32,
    /// How far from the middle of the nearer lane, in metres.
    pub offset: f32,
    /// Steps since it came into that lane.
    pub in_lane_for: u32,
}

impl Party {
    fn footprint(&self) -> Box2 {
        let yaw = f64::from(self.hx).atan2(f64::from(self.hy)).rem_euclid(TAU);
        let half = DVec2::new(f64::from(WIDTH_M), f64::from(LENGTH_M)) / 2.0;
        Box2 { centre: DVec2::new(f64::from(self.x), f64::from(self.y)), half, yaw }
    }

    /// Whether two cars touch.
    pub fn touches(&self, other: &Self) -> bool {
        self.footprint().touches(&other.footprint())
    }

    fn has_just_come(&self) -> bool {
        self.in_lane_for <= CUT_IN_STEPS || self.offset.abs() > OUT_OF_LANE_M
    }
}

/// How two cars crashed, and the first one's share in it.
pub(super) fn judge(own: &Party, other: &Party) -> (Manner, Fault) {
    let same_way = own.hx * other.hx + own.hy * other.hy > SAME_WAY;
    let merges = own.from != other.from && own.beyond_m.min(other.beyond_m) < MERGED_M;
    if !same_way || merges {
        let entered = |party: &Party| party.entered.unwrap_or(STEPS + 1);
        return (Manner::Crossing, blame(entered(own) >= entered(other), entered(other) >= entered(own)));
    }
    let ahead = (other.x - own.x) * own.hx + (other.y - own.y) * own.hy; // of the other one
    if ahead.abs() < LENGTH_M / 2.0 {
        return (Manner::Sideswipe, blame(own.has_just_come(), other.has_just_come()));
    }
    let (front, rear_is_own) = if ahead > 0.0 { (other, true) } else { (own, false) };
    (Manner::FromBehind, if front.has_just_come() == rear_is_own { Fault::Other } else { Fault::Own })
}

fn blame(own: bool, other: bool) -> Fault {
    match (own, other) {
        (true, false) => Fault::Own,
        (false, true) => Fault::Other,
        _ => Fault::Shared,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A car that came from the south a while ago.
    fn party(x: f32, y: f32, (hx, hy): (f32, f32)) -> Party {
        let (entered, beyond_m) = (None, -60.0);
        Party { x, y, hx, hy, from: Arm::South, entered, beyond_m, offset: 0.0, in_lane_for: 1000 }
    }

    const NORTH: (f32, f32) = (0.0, 1.0);
    const EAST: (f32, f32) = (1.0, 0.0);

    #[test]
    fn cars_touch_as_their_bodies_do() {
        let own = party(1.6, 0.0, NORTH);
        for (name, other, expected) in [
            ("bumper to bumper", party(1.6, 3.67, NORTH), true),
            ("a hand's breadth behind", party(1.6, 3.75, NORTH), false),
            ("side by side in lanes", party(4.8, 0.0, NORTH), false),
            ("door to door", party(3.06, 0.0, NORTH), true),
            ("across its front", party(1.6, 2.5, EAST), true),
            ("across, well ahead", party(1.6, 2.7, EAST), false),
        ] {
            assert_eq!(own.touches(&other), expected, "{name}");
        }
    }

    #[test]
    fn the_fault_is_that_of_the_road() {
        let own = party(1.6, -30.0, NORTH);
        let late = |party: Party, entered| Party { entered: Some(entered), from: Arm::West, ..party };
        let crossing = Party { entered: Some(20), ..party(1.6, 0.0, NORTH) };
        let came = |party: Party| Party { in_lane_for: 5, ..party };
        let out = |party: Party| Party { offset: 1.2, ..party };
        for (name, own, other, expected) in [
            ("runs into one ahead", own, party(1.6, -26.4, NORTH), (Manner::FromBehind, Fault::Own)),
            ("is run into", own, party(1.6, -33.6, NORTH), (Manner::FromBehind, Fault::Other)),
            ("runs into one that cut in", own, came(party(1.6, -26.4, NORTH)), (Manner::FromBehind, Fault::Other)),
            ("cut in", came(own), party(1.6, -33.6, NORTH), (Manner::FromBehind, Fault::Own)),
            ("drifts into a neighbour", out(own), party(3.0, -30.0, NORTH), (Manner::Sideswipe, Fault::Own)),
            ("is drifted into", own, out(party(3.0, -30.0, NORTH)), (Manner::Sideswipe, Fault::Other)),
            ("both drift", out(own), out(party(3.0, -30.0, NORTH)), (Manner::Sideswipe, Fault::Shared)),
            ("was in the box first", crossing, late(party(1.6, 2.0, EAST), 22), (Manner::Crossing, Fault::Other)),
            ("came into the box later", crossing, late(party(1.6, 2.0, EAST), 12), (Manner::Crossing, Fault::Own)),
            ("at the same time", crossing, late(party(1.6, 2.0, EAST), 20), (Manner::Crossing, Fault::Shared)),
            (
                "merged before another, which hit it from behind",
                Party { beyond_m: 2.0, ..crossing },
                Party { beyond_m: -1.0, ..late(party(1.6, -3.0, NORTH), 25) },
                (Manner::Crossing, Fault::Other),
            ),
        ] {
            assert_eq!(judge(&own, &other), expected, "{name}");
        }
    }
}
