//! The roads: four arms with two lanes a direction, the box in which they cross, and the ways across it.
//!
//! Seen from above, x points east and y north, in metres from the middle of the box. Traffic keeps to the right. Lane 0
//! is the outer one, as in SUMO. Offsets and curvatures are positive to the right of the driving direction.
//!
//! A [`Way`] leads from the begin of an arm to the end of another, along one of its lanes: a straight line, an arc, a
//! straight line. There are twelve routes, and on each two ways side by side, so that a car may change lanes anywhere.
//! Background traffic only takes those that a driver may take: left turns from the inner lane, right turns from the
//! outer one.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use super::{LENGTH_M, WIDTH_M};

/// Width of a lane, in metres.
pub const LANE_M: f32 = 3.2;
/// Half the side of the box, in metres: two lanes, and corners of 4 m.
pub const HALF_BOX_M: f32 = 10.4;
/// Speed limit, in m/s: 50 km/h.
pub const SPEED_LIMIT: f32 = 13.89;
/// Lengths of the arms, in metres, in the order of [`Arm`].
pub const ARMS_M: [f32; 4] = [54.2, 63.4, 47.0, 63.4];

/// Radius of the kerbs at the corners of the box, in metres.
const KERB_M: f32 = HALF_BOX_M - 2.0 * LANE_M;
/// SUMO's speed limits of left and right turns on this map, in m/s.
const TURN_SPEEDS: (f32, f32) = (9.26, 6.5);
/// Ways whose middles come closer than this in the box are in conflict, in metres: two half widths, the ends of the
/// cars that swing out in a turn, and 0.6 m between them.
const CONFLICT_M: f32 = WIDTH_M + 1.1;

/// Where a road comes from, clockwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Arm {
    /// 54.2 m.
    South,
    /// 63.4 m.
    West,
    /// 47.0 m.
    North,
    /// 63.4 m.
    East,
}

impl Arm {
    /// All, in order.
    pub const ALL: [Self; 4] = [Self::South, Self::West, Self::North, Self::East];

    /// Its length up to the box, in metres.
    pub fn length_m(self) -> f32 {
        ARMS_M[self as usize]
    }

    /// The arm that is reached from here by a turn.
    pub fn after(self, turn: Turn) -> Self {
        Self::ALL[(self as usize + turn as usize + 1) % 4]
    }
}

/// What a car does in the box.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    /// To the next arm clockwise.
    Left,
    /// Across.
    Straight,
    /// To the next arm anticlockwise.
    Right,
}

impl Turn {
    /// All, in order.
    pub const ALL: [Self; 3] = [Self::Left, Self::Straight, Self::Right];

    /// The turn from one arm to another; none back into the same.
    pub fn between(from: Arm, to: Arm) -> Option<Self> {
        match (to as usize + 4 - from as usize) % 4 {
            0 => None,
            n => Some(Self::ALL[n - 1]),
        }
    }
}

/// A place with a direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// East of the middle, in metres.
    pub x: f32,
    /// North of the middle, in metres.
    pub y: f32,
    /// Where the car points: the unit vector's eastern part.
    pub hx: f32,
    /// And its northern part.
    pub hy: f32,
}

/// Number of ways.
pub const WAYS: usize = 24;

/// All ways: by arm, turn and lane, see [`way_of`].
pub static ALL: [Way; WAYS] = all();

/// For each way, as bits, the ways that may not be driven at the same time. Ways that begin in the same lane are none of
/// them: there cars follow one another.
pub static CONFLICTS: LazyLock<[u32; WAYS]> = LazyLock::new(conflicts);

/// One lane's way from an arm's begin to another arm's end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Way {
    /// Where it begins.
    pub from: Arm,
    /// Where it ends.
    pub to: Arm,
    /// What lies between.
    pub turn: Turn,
    /// 0 is the outer lane, 1 the inner.
    pub lane: u8,
    /// Metres before the box.
    pub approach_m: f32,
    /// Metres in the box.
    pub across_m: f32,
    /// Metres behind it.
    pub exit_m: f32,
    /// How fast a car may be in the box, in m/s.
    pub speed: f32,
    /// In the box, in 1/m, positive to the right.
    pub curvature: f32,
    /// Where the lane is on its own arm: metres to the right of the road's middle.
    beside: f32,
}

/// Which way that is.
pub fn way_of(from: Arm, turn: Turn, lane: u8) -> usize {
    (from as usize * 3 + turn as usize) * 2 + lane as usize
}

const fn all() -> [Way; WAYS] {
    let straight = Way {
        from: Arm::South,
        to: Arm::North,
        turn: Turn::Straight,
        lane: 0,
        approach_m: 0.0,
        across_m: 2.0 * HALF_BOX_M,
        exit_m: 0.0,
        speed: SPEED_LIMIT,
        curvature: 0.0,
        beside: 0.0,
    };
    let mut ways = [straight; WAYS];
    let mut i = 0;
    while i < WAYS {
        let (arm, turn, lane) = (i / 6, i / 2 % 3, i % 2);
        let way = &mut ways[i];
        (way.from, way.to) = (Arm::ALL[arm], Arm::ALL[(arm + turn + 1) % 4]);
        (way.turn, way.lane) = (Turn::ALL[turn], lane as u8);
        (way.approach_m, way.exit_m) = (ARMS_M[arm], ARMS_M[(arm + turn + 1) % 4]);
        way.beside = LANE_M * (1.5 - lane as f32);
        let radius = match way.turn {
            Turn::Straight => 0.0,
            Turn::Left => HALF_BOX_M + way.beside,
            Turn::Right => HALF_BOX_M - way.beside,
        };
        if radius > 0.0 {
            let is_left = matches!(way.turn, Turn::Left);
            way.across_m = radius * std::f32::consts::FRAC_PI_2;
            (way.curvature, way.speed) =
                if is_left { (-1.0 / radius, TURN_SPEEDS.0) } else { (1.0 / radius, TURN_SPEEDS.1) };
        }
        i += 1;
    }
    ways
}

impl Way {
    /// Whether the rules allow it: a car turns left from the inner lane and right from the outer one.
    pub fn is_legal(&self) -> bool {
        match self.turn {
            Turn::Straight => true,
            Turn::Left => self.lane == 1,
            Turn::Right => self.lane == 0,
        }
    }

    /// Where the box ends, in metres along.
    pub fn leaves_m(&self) -> f32 {
        self.approach_m + self.across_m
    }

    /// Metres in all.
    pub fn length_m(&self) -> f32 {
        self.leaves_m() + self.exit_m
    }

    /// 1/m at a distance along.
    pub fn curvature_at(&self, s: f32) -> f32 {
        if s > self.approach_m && s < self.leaves_m() { self.curvature } else { 0.0 }
    }

    /// The direction at a distance along, as a unit vector.
    pub fn heading(&self, s: f32) -> (f32, f32) {
        let (hx, hy) = if self.curvature == 0.0 {
            (0.0, 1.0)
        } else {
            let turned = (s - self.approach_m).clamp(0.0, self.across_m) * self.curvature;
            let (sin, cos) = turned.sin_cos();
            (sin, cos)
        };
        from_south(self.from, hx, hy)
    }

    /// The place at a distance along, also before the begin and beyond the end.
    pub fn at(&self, s: f32) -> Pose {
        let u = s - self.approach_m;
        let Self { beside, curvature, across_m, .. } = *self;
        let (x, y, hx, hy) = if curvature == 0.0 || u <= 0.0 {
            (beside, u - HALF_BOX_M, 0.0, 1.0)
        } else {
            let side = curvature.signum(); // of the arc's middle, which is a corner of the box
            let radius = HALF_BOX_M - side * beside;
            let beyond = (u - across_m).max(0.0);
            if beyond > 0.0 {
                (side * (HALF_BOX_M + beyond), radius - HALF_BOX_M, side, 0.0)
            } else {
                let (sin, cos) = (u / radius).sin_cos();
                (side * (HALF_BOX_M - radius * cos), radius * sin - HALF_BOX_M, side * sin, cos)
            }
        };
        let ((x, y), (hx, hy)) = (from_south(self.from, x, y), from_south(self.from, hx, hy));
        Pose { x, y, hx, hy }
    }

    /// How far along a place is, and how far to the right of the way, in metres.
    pub fn project(&self, x: f32, y: f32) -> (f32, f32) {
        self.project_within(x, y, f32::INFINITY).unwrap_or_default()
    }

    /// The same for places up to so many metres beside the way; none for others.
    pub fn project_within(&self, x: f32, y: f32, beside_m: f32) -> Option<(f32, f32)> {
        let (x, y) = to_south(self.from, x, y);
        let Self { beside, curvature, approach_m, across_m, .. } = *self;
        let within = |offset: f32| offset.abs() <= beside_m;
        if curvature == 0.0 || y < -HALF_BOX_M {
            let offset = x - beside;
            return within(offset).then_some((approach_m + y + HALF_BOX_M, offset));
        }
        let side = curvature.signum();
        let radius = HALF_BOX_M - side * beside;
        let beyond = side * x - HALF_BOX_M;
        if beyond > 0.0 {
            let offset = side * (radius - HALF_BOX_M - y);
            return within(offset).then_some((approach_m + across_m + beyond, offset));
        }
        let (dx, dy) = (-beyond, y + HALF_BOX_M); // from the corner
        let offset = side * (radius - (dx * dx + dy * dy).sqrt());
        within(offset).then(|| (approach_m + dy.atan2(dx) * radius, offset))
    }
}

/// From the axes in which the arm is the southern one to the world's.
fn from_south(arm: Arm, x: f32, y: f32) -> (f32, f32) {
    match arm {
        Arm::South => (x, y),
        Arm::West => (y, -x),
        Arm::North => (-x, -y),
        Arm::East => (-y, x),
    }
}

/// And back.
fn to_south(arm: Arm, x: f32, y: f32) -> (f32, f32) {
    match arm {
        Arm::South => (x, y),
        Arm::West => (-y, x),
        Arm::North => (-x, -y),
        Arm::East => (y, -x),
    }
}

/// Whether a place is on asphalt.
pub fn is_on_road(x: f32, y: f32) -> bool {
    let (across, along) = (x.abs(), y.abs());
    let half = 2.0 * LANE_M;
    if across <= HALF_BOX_M && along <= HALF_BOX_M {
        let (dx, dy) = (HALF_BOX_M - across, HALF_BOX_M - along);
        return across <= half || along <= half || dx * dx + dy * dy >= KERB_M * KERB_M;
    }
    let arm = match (across > along, x > 0.0, y > 0.0) {
        (true, true, _) => Arm::East,
        (true, false, _) => Arm::West,
        (false, _, true) => Arm::North,
        (false, _, false) => Arm::South,
    };
    across.min(along) <= half && across.max(along) <= HALF_BOX_M + arm.length_m()
}

/// For each way, and each other in [conflict](CONFLICTS) with it, from where to where along it a car's middle is too near
/// to the other way's middle, in metres; 0 to 0 without a conflict.
pub static SPANS: LazyLock<[[(f32, f32); WAYS]; WAYS]> = LazyLock::new(spans);

/// How close the places are that are compared, in metres.
const SAMPLE_M: f32 = 0.25;

fn conflicts() -> [u32; WAYS] {
    SPANS.map(|spans| (0..WAYS).filter(|j| spans[*j].1 > 0.0).map(|j| 1 << j).sum())
}

fn spans() -> [[(f32, f32); WAYS]; WAYS] {
    let begin = |way: &Way| way.approach_m - LENGTH_M / 2.0;
    let samples = |way: &Way| -> Vec<Pose> {
        let (from, until) = (begin(way), way.leaves_m() + LENGTH_M / 2.0);
        (0..=((until - from) / SAMPLE_M) as usize).map(|i| way.at(from + i as f32 * SAMPLE_M)).collect()
    };
    let middles: Vec<Vec<Pose>> = ALL.iter().map(samples).collect();
    let are_near = |a: &Pose, b: &Pose| (a.x - b.x).hypot(a.y - b.y) < CONFLICT_M;
    let mut found = [[(0.0, 0.0); WAYS]; WAYS];
    for (i, way) in ALL.iter().enumerate() {
        for (j, other) in ALL.iter().enumerate() {
            let follow = way.from == other.from && way.lane == other.lane;
            let is_near = |a: &&Pose| middles[j].iter().any(|b| are_near(a, b));
            let place = |n: usize| begin(way) + n as f32 * SAMPLE_M;
            let first = middles[i].iter().position(|a| is_near(&a));
            let last = middles[i].iter().rposition(|a| is_near(&a));
            if let (false, Some(first), Some(last)) = (follow, first, last) {
                found[i][j] = (place(first), place(last));
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_on_a_way_is_found_again_and_steps_are_as_long_as_they_say() {
        for way in &ALL {
            let mut last = way.at(-5.0);
            for i in 1..((way.length_m() + 10.0) * 10.0) as i32 {
                let s = i as f32 / 10.0 - 5.0;
                let pose = way.at(s);
                let step = (pose.x - last.x).hypot(pose.y - last.y);
                assert!((step - 0.1).abs() < 1e-3, "{way:?} at {s}: {step}");
                let (found, offset) = way.project(pose.x + 0.3 * pose.hy, pose.y - 0.3 * pose.hx);
                assert!((found - s).abs() < 1e-3 && (offset - 0.3).abs() < 1e-3, "{way:?} at {s}: {found}, {offset}");
                let (hx, hy) = way.heading(s);
                assert!((hx - pose.hx).hypot(hy - pose.hy) < 1e-5, "{way:?} at {s}");
                assert!(s < 0.0 || s > way.length_m() || is_on_road(pose.x, pose.y), "{way:?} at {s}");
                last = pose;
            }
        }
    }

    #[test]
    fn the_arms_are_as_long_as_those_of_the_benchmark_and_the_box_is_20_8_m_wide() {
        let way = ALL[way_of(Arm::West, Turn::Straight, 0)];
        assert_eq!((way.to, way.approach_m, way.across_m, way.exit_m), (Arm::East, 63.4, 20.8, 63.4));
        let begin = way.at(0.0);
        assert_eq!((begin.x, begin.y, begin.hx, begin.hy), (-73.8, -4.8, 1.0, 0.0));
        assert_eq!(ALL[way_of(Arm::South, Turn::Left, 1)].to, Arm::West);
        assert!((ALL[way_of(Arm::South, Turn::Right, 0)].across_m - 5.6 * std::f32::consts::FRAC_PI_2).abs() < 1e-3);
    }

    #[test]
    fn ways_that_cross_or_merge_are_in_conflict_and_those_side_by_side_are_not() {
        let conflict = |a: usize, b: usize| CONFLICTS[a] & 1 << b != 0;
        let (south, west, north, east) = (Arm::South, Arm::West, Arm::North, Arm::East);
        for (name, a, b, expected) in [
            ("crossing", way_of(south, Turn::Straight, 0), way_of(west, Turn::Straight, 1), true),
            ("left across the oncoming", way_of(south, Turn::Left, 1), way_of(north, Turn::Straight, 0), true),
            ("merging", way_of(south, Turn::Left, 1), way_of(east, Turn::Straight, 1), true),
            ("merging from the right", way_of(south, Turn::Right, 0), way_of(west, Turn::Straight, 0), true),
            ("into the lane beside", way_of(south, Turn::Right, 0), way_of(west, Turn::Straight, 1), false),
            ("oncoming", way_of(south, Turn::Straight, 1), way_of(north, Turn::Straight, 1), false),
            ("side by side", way_of(south, Turn::Straight, 0), way_of(south, Turn::Straight, 1), false),
            ("one behind the other", way_of(south, Turn::Straight, 1), way_of(south, Turn::Left, 1), false),
        ] {
            assert_eq!((conflict(a, b), conflict(b, a)), (expected, expected), "{name}");
        }
    }

    #[test]
    fn straight_ways_cross_where_their_lanes_do() {
        let (south, west) = (way_of(Arm::South, Turn::Straight, 1), way_of(Arm::West, Turn::Straight, 0));
        // At (1.6, -4.8): 5.6 m into the box from the south, 12 m from the west; the ways are near for 2.57 m each way.
        for (way, other, into) in [(south, west, 5.6), (west, south, 12.0)] {
            let (from, until) = SPANS[way][other];
            let middle = ALL[way].approach_m + into;
            assert!((from - middle + CONFLICT_M).abs() < 0.3 && (until - middle - CONFLICT_M).abs() < 0.3);
        }
        assert_eq!(SPANS[south][way_of(Arm::North, Turn::Straight, 1)], (0.0, 0.0));
    }

    #[test]
    fn the_road_ends_at_the_kerbs_and_at_the_arms_ends() {
        for (x, y, expected) in [
            (6.3, -60.0, true),
            (6.5, -60.0, false),
            (0.0, -64.5, true),
            (0.0, -64.7, false),
            (0.0, 57.3, true),
            (0.0, 57.5, false),
            (9.0, 9.0, false),
            (7.4, 7.4, true), // the corner is cut in a circle
            (7.7, 7.7, false),
        ] {
            assert_eq!(is_on_road(x, y), expected, "{x}, {y}");
        }
    }
}
