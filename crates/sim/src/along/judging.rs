//! What the virtual car is judged by: what its place is measured from, how far off it may be, and where it goes on after
//! an intervention.

use std::{fmt, str::FromStr};

use super::{recorded::PathRow, warp::Beside};
use crate::locate::InLane;
use lapwing_core::turn::{LimitEdge, MeasuredLine};

/// How far beside the line the virtual car may be, in metres: NVIDIA's (Bojarski et al. 2016, section 6.1).
pub const DEFAULT_LIMIT_M: f64 = 1.0;

/// A virtual car whose heading is off by more than this, in degrees, is put back, too: the picture would show nothing
/// of what it sees.
pub const FURTHEST_HEADING_DEG: f64 = 45.0;

/// Where the virtual car is put back.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Limit {
    /// Where its middle passes the road's edge; where the road is not known, [`DEFAULT_LIMIT_M`] from the recorded path, or beyond that path
    /// and the middle of a lane that is known nearby.
    Road,
    /// This far from the line, in metres.
    Metres(f64),
}

impl Limit {
    /// The distance from the recorded path that it allows, in metres.
    pub fn metres(self) -> f64 {
        match self {
            Self::Road => DEFAULT_LIMIT_M,
            Self::Metres(metres) => metres,
        }
    }

    /// Its name in JSON: `road`, or `metres`.
    pub fn key(self) -> &'static str {
        match self {
            Self::Road => "road",
            Self::Metres(_) => "metres",
        }
    }
}

impl FromStr for Limit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let metres = || text.parse().ok().filter(|x: &f64| x.is_finite() && *x > 0.0).map(Self::Metres);
        let limit = if text == "road" { Some(Self::Road) } else { metres() };
        limit.ok_or_else(|| "expected road, or a number of metres above 0".into())
    }
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Road => f.write_str("the road's edge"),
            Self::Metres(metres) => write!(f, "{metres} m"),
        }
    }
}

/// How a drive along a recording goes on after an intervention.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Protocol {
    /// At once and at the same place: NVIDIA's (Bojarski et al. 2016).
    #[default]
    Dave2,
    /// Two seconds further on: that of the Rally Estonia study (Tampuu et al. 2022, and the University of Tartu's
    /// vista-evaluation), whose limits are 1 and 2 m.
    RallyEstonia,
}

impl Protocol {
    /// Its name in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Dave2 => "dave2",
            Self::RallyEstonia => "rally-estonia",
        }
    }

    /// How much of the recording is left out after an intervention, in seconds.
    pub(super) fn left_out_s(self) -> f64 {
        match self {
            Self::Dave2 => 0.0,
            Self::RallyEstonia => 2.0,
        }
    }
}

/// Where the lane is not known, the line joins its middle, if that is known before or behind, over at most this many metres.
const JOINS_M: f64 = 20.0;

/// The line of a recorded row, from which the virtual car's place is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Line {
    /// The lane's middle, as it is known where in its lane the recorded car is.
    Lane(InLane),
    /// The recorded path, or what joins it to the lane's middle.
    Path {
        /// Metres that the recorded car is to the right of it.
        offset_m: f64,
        /// From where to where the recorded path, and the middle of the lanes that it joins, lie: in metres to the right of it.
        between_m: (f64, f64),
    },
}

impl Line {
    /// The recorded path, with nothing to join.
    pub(super) const PATH: Self = Self::Path { offset_m: 0.0, between_m: (0.0, 0.0) };
}

/// The line of each row. Where the lane is not known, it is the recorded path, and goes over into the lane's middle before
/// and behind: a car in the middle of its lane is on the line when the lane is lost, and when it is found again.
pub(super) fn lines(rows: &[PathRow], in_lane: impl Fn(&PathRow) -> Option<InLane>) -> Vec<Line> {
    let mut lines: Vec<Line> = rows.iter().map(|row| in_lane(row).map_or(Line::PATH, Line::Lane)).collect();
    let lane_of = |line: &Line| match line {
        Line::Lane(lane) => Some(*lane),
        Line::Path { .. } => None,
    };
    // How far along the recorded path each row is.
    let mut along_m = vec![0.0];
    along_m.extend(rows.windows(2).scan(0.0, |along_m, pair| {
        *along_m += pair[1].mps() * (pair[1].at_s - pair[0].at_s);
        Some(*along_m)
    }));
    let mut begin = 0;
    while let Some(lost) = lines[begin..].iter().position(|line| lane_of(line).is_none()) {
        let first = begin + lost;
        // Up to where the lane is found again, or a new stretch begins.
        let is_over = |i: &usize| rows[*i].cut.is_some() || lane_of(&lines[*i]).is_some();
        let end = (first + 1..rows.len()).find(is_over).unwrap_or(rows.len());
        let known = |lane: Option<usize>| lane.and_then(|i| Some((lane_of(&lines[i])?, along_m[i])));
        let before = known(first.checked_sub(1).filter(|_| rows[first].cut.is_none()));
        let behind = known(Some(end).filter(|end| rows.get(*end).is_some_and(|row| row.cut.is_none())));
        // Between two lanes the one is joined where the other is left, if they are near.
        let over_m = match (before, behind) {
            (Some((_, left_m)), Some((_, found_m))) => JOINS_M.min(found_m - left_m).max(1e-3),
            _ => JOINS_M,
        };
        for i in first..end {
            // Of the lanes that are joined here: how far to their right the recorded car was, and how much that counts.
            let joined: Vec<(f64, f64)> = [before, behind]
                .into_iter()
                .flatten()
                .map(|(lane, at_m)| (lane.offset_m, 1.0 - (along_m[i] - at_m).abs() / over_m))
                .filter(|(_, weight)| *weight > 0.0)
                .collect();
            let offset_m: f64 = joined.iter().map(|(offset_m, weight)| offset_m * weight).sum();
            let middles = joined.iter().map(|(lane_m, _)| offset_m - lane_m);
            let between_m = middles.fold((offset_m.min(0.0), offset_m.max(0.0)), |(left_m, right_m), middle_m| {
                (left_m.min(middle_m), right_m.max(middle_m))
            });
            lines[i] = Line::Path { offset_m, between_m };
        }
        begin = end;
    }
    lines
}

/// The virtual car's place, and how far it may be from what that is measured from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// What it is measured from.
    pub line: MeasuredLine,
    /// What the car must not pass.
    pub edge: LimitEdge,
    /// Where that is on the left and on the right, in metres to the right of the line.
    pub limits_m: (f64, f64),
    /// Metres to the right of the line.
    pub offset_m: f64,
    /// How far it faces to the right of the line's direction, in radians.
    pub heading_rad: f64,
}

impl Measured {
    /// The place of a car beside the recorded one, whose line this is.
    pub(super) fn new(limit: Limit, line: Line, beside: Beside) -> Self {
        let metres = |limit_m: f64| (LimitEdge::Metres, (-limit_m, limit_m));
        let Beside { offset_m, heading_rad, .. } = beside;
        let lane = match line {
            Line::Lane(lane) => lane,
            Line::Path { offset_m: recorded_m, between_m } => {
                let (edge, mut limits_m) = metres(limit.metres());
                if limit == Limit::Road {
                    // Neither a car in the lane's middle nor one on the recorded path is put back where the line is in between.
                    limits_m = (limits_m.0 + between_m.0, limits_m.1 + between_m.1);
                }
                let offset_m = recorded_m + offset_m;
                return Self { line: MeasuredLine::RecordedPath, edge, limits_m, offset_m, heading_rad };
            }
        };
        let (edge, limits_m) = match limit {
            Limit::Road => (LimitEdge::Road, lane.edges_m),
            Limit::Metres(limit_m) => metres(limit_m),
        };
        Self {
            line: MeasuredLine::Lane,
            edge,
            limits_m,
            // Abreast is across the recorded car, which may stand askew in its lane.
            offset_m: lane.offset_m + offset_m * lane.heading_rad.cos(),
            heading_rad: lane.heading_rad + heading_rad,
        }
    }

    /// Whether the car must be put back.
    pub fn is_beyond(&self) -> bool {
        let (left_m, right_m) = self.limits_m;
        !(left_m..=right_m).contains(&self.offset_m) || self.heading_rad.abs() > FURTHEST_HEADING_DEG.to_radians()
    }
}

/// Where a car on the line is beside the recorded one.
pub(super) fn on_the_line(recorded: Line) -> Beside {
    match recorded {
        Line::Lane(lane) => Beside {
            offset_m: -lane.offset_m / lane.heading_rad.cos().max(0.3),
            heading_rad: -lane.heading_rad,
            ..Beside::default()
        },
        Line::Path { offset_m, .. } => Beside { offset_m: 0.0 - offset_m, ..Beside::default() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::along::recorded::PathBreak;
    use lapwing_core::units::{Mph, Steering, Throttle};

    const LANE: InLane = InLane { offset_m: 0.8, heading_rad: -0.1, curvature: 0.02, edges_m: (-6.0, 2.0) };

    /// Rows a metre apart, of which it is known where in its lane the car is at some, and its offset there; new stretches
    /// begin at `cuts`.
    fn offsets(rows: usize, known: &[(usize, f64)], cuts: &[usize]) -> Vec<f64> {
        let offset = |line: Line| match line {
            Line::Lane(lane) => lane.offset_m,
            Line::Path { offset_m, .. } => offset_m,
        };
        lines_of(rows, known, cuts).into_iter().map(offset).collect()
    }

    fn lines_of(rows: usize, known: &[(usize, f64)], cuts: &[usize]) -> Vec<Line> {
        let row = |index: usize| PathRow {
            at_s: index as f64,
            speed: Mph::saturating(1.0 / 0.44704),
            steering: Steering::ZERO,
            throttle: Throttle::ZERO,
            cut: cuts.contains(&index).then_some(PathBreak::Begins),
            index,
        };
        let rows: Vec<PathRow> = (0..rows).map(row).collect();
        let known = |row: &PathRow| {
            let (_, offset_m) = known.iter().find(|(index, _)| *index == row.index)?;
            Some(InLane { offset_m: *offset_m, ..LANE })
        };
        lines(&rows, known)
    }

    fn close(got: &[f64], expected: &[f64]) -> bool {
        got.len() == expected.len() && got.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6)
    }

    #[test]
    fn where_the_lane_is_lost_the_line_goes_over_into_the_recorded_path_and_back_without_a_jump() {
        let short = offsets(5, &[(0, 0.8), (4, 0.4)], &[]);
        assert!(close(&short, &[0.8, 0.7, 0.6, 0.5, 0.4]), "{short:?}");
        let long = offsets(101, &[(0, 0.8), (100, -0.4)], &[]);
        let places = [0, 10, 20, 50, 80, 90, 100].map(|i| long[i]);
        assert!(close(&places, &[0.8, 0.4, 0.0, 0.0, 0.0, -0.2, -0.4]), "{places:?}");
    }

    #[test]
    fn where_the_path_goes_over_into_the_lane_a_car_may_be_on_either_and_a_metre_beside() {
        let limits = |known: &[(usize, f64)], row: usize, limit: Limit| {
            let line = lines_of(41, known, &[])[row];
            let (left_m, right_m) = Measured::new(limit, line, Beside::default()).limits_m;
            [left_m, right_m].map(|metres| (metres * 100.0).round() / 100.0)
        };
        // The recorded car is 2.4 m to the right of the middle at the end: half-way along the last 20 m the line lies between both.
        assert_eq!(limits(&[(40, 2.4)], 30, Limit::Road), [-2.2, 2.2]);
        assert_eq!(limits(&[(40, 2.4)], 25, Limit::Road), [-2.8, 1.6]);
        assert_eq!(limits(&[(40, 2.4)], 20, Limit::Road), [-1.0, 1.0], "too far away");
        assert_eq!(limits(&[(40, 2.4)], 30, Limit::Metres(2.0)), [-2.0, 2.0]);
        assert_eq!(limits(&[(25, -1.0), (35, 3.0)], 30, Limit::Road), [-3.0, 3.0]);
    }

    #[test]
    fn a_new_stretch_has_nothing_to_go_over_from() {
        let cut = offsets(6, &[(0, 0.8), (5, 0.4)], &[3]);
        assert!(close(&cut, &[0.8, 0.76, 0.72, 0.36, 0.38, 0.4]), "{cut:?}");
        assert_eq!(offsets(3, &[], &[]), [0.0; 3]);
    }

    #[test]
    fn a_car_on_the_line_is_in_the_lanes_middle_wherever_the_recorded_one_is() {
        for line in [Line::Lane(LANE), Line::Path { offset_m: 0.4, between_m: (0.0, 0.4) }] {
            let measured = Measured::new(Limit::Road, line, on_the_line(line));
            assert!(measured.offset_m.abs() < 1e-12 && measured.heading_rad.abs() < 1e-12, "{measured:?}");
        }
        assert_eq!(on_the_line(Line::PATH), Beside::default());
    }

    #[test]
    fn the_roads_edge_is_the_limit_where_it_is_known_and_metres_are_where_it_is_not() {
        let beyond = |limit: Limit, lane: Option<InLane>, offset_m: f64| {
            let beside = Beside { offset_m, ..Beside::default() };
            Measured::new(limit, lane.map_or(Line::PATH, Line::Lane), beside).is_beyond()
        };
        // The lane's middle is 0.8 m to the recorded car's left.
        assert!(!beyond(Limit::Road, Some(LANE), -6.7) && beyond(Limit::Road, Some(LANE), -6.9));
        assert!(!beyond(Limit::Road, Some(LANE), 1.1) && beyond(Limit::Road, Some(LANE), 1.3));
        assert!(!beyond(Limit::Metres(1.0), Some(LANE), 0.1) && beyond(Limit::Metres(1.0), Some(LANE), 0.3));
        assert!(!beyond(Limit::Road, None, 0.9) && beyond(Limit::Road, None, -1.1));
        assert!(!beyond(Limit::Metres(2.0), None, 1.9) && beyond(Limit::Metres(2.0), None, 2.1));
        let askew = Beside { offset_m: 0.0, heading_rad: 0.8, ..Beside::default() };
        assert!(Measured::new(Limit::Road, Line::PATH, askew).is_beyond(), "it faces elsewhere");
    }

    #[test]
    fn a_limit_is_the_road_or_metres() {
        assert_eq!(("road".parse(), "1.5".parse()), (Ok(Limit::Road), Ok(Limit::Metres(1.5))));
        for wrong in ["0", "-1", "nan", "lane", ""] {
            assert!(wrong.parse::<Limit>().unwrap_err().starts_with("expected road"), "{wrong}");
        }
    }
}
