//! What the virtual car is judged by: what its place is measured from, how far off it may be, and where it goes on after
//! an intervention.

use std::{fmt, str::FromStr};

use super::warp::Beside;
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
    /// Where its middle passes the road's edge; [`DEFAULT_LIMIT_M`] from the recorded path where the road is not known.
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
    /// The place of a car beside the recorded one, of which it is known where in its lane it is, or not.
    pub(super) fn new(limit: Limit, recorded: Option<InLane>, beside: Beside) -> Self {
        let metres = |limit_m: f64| (LimitEdge::Metres, (-limit_m, limit_m));
        let Beside { offset_m, heading_rad, .. } = beside;
        let Some(lane) = recorded else {
            let (edge, limits_m) = metres(limit.metres());
            return Self { line: MeasuredLine::RecordedPath, edge, limits_m, offset_m, heading_rad };
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
pub(super) fn on_the_line(recorded: Option<InLane>) -> Beside {
    let on_lane = |lane: InLane| Beside {
        offset_m: -lane.offset_m / lane.heading_rad.cos().max(0.3),
        heading_rad: -lane.heading_rad,
        ..Beside::default()
    };
    recorded.map_or_else(Beside::default, on_lane)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LANE: InLane = InLane { offset_m: 0.8, heading_rad: -0.1, curvature: 0.02, edges_m: (-6.0, 2.0) };

    #[test]
    fn a_car_on_the_line_is_in_the_lanes_middle_wherever_the_recorded_one_is() {
        let measured = Measured::new(Limit::Road, Some(LANE), on_the_line(Some(LANE)));
        assert!(measured.offset_m.abs() < 1e-12 && measured.heading_rad.abs() < 1e-12, "{measured:?}");
        assert_eq!(on_the_line(None), Beside::default());
    }

    #[test]
    fn the_roads_edge_is_the_limit_where_it_is_known_and_metres_are_where_it_is_not() {
        let beyond = |limit: Limit, lane: Option<InLane>, offset_m: f64| {
            Measured::new(limit, lane, Beside { offset_m, heading_rad: 0.0, ..Beside::default() }).is_beyond()
        };
        // The lane's middle is 0.8 m to the recorded car's left.
        assert!(!beyond(Limit::Road, Some(LANE), -6.7) && beyond(Limit::Road, Some(LANE), -6.9));
        assert!(!beyond(Limit::Road, Some(LANE), 1.1) && beyond(Limit::Road, Some(LANE), 1.3));
        assert!(!beyond(Limit::Metres(1.0), Some(LANE), 0.1) && beyond(Limit::Metres(1.0), Some(LANE), 0.3));
        assert!(!beyond(Limit::Road, None, 0.9) && beyond(Limit::Road, None, -1.1));
        assert!(!beyond(Limit::Metres(2.0), None, 1.9) && beyond(Limit::Metres(2.0), None, 2.1));
        let askew = Beside { offset_m: 0.0, heading_rad: 0.8, ..Beside::default() };
        assert!(Measured::new(Limit::Road, None, askew).is_beyond(), "it faces elsewhere");
    }

    #[test]
    fn a_limit_is_the_road_or_metres() {
        assert_eq!(("road".parse(), "1.5".parse()), (Ok(Limit::Road), Ok(Limit::Metres(1.5))));
        for wrong in ["0", "-1", "nan", "lane", ""] {
            assert!(wrong.parse::<Limit>().unwrap_err().starts_with("expected road"), "{wrong}");
        }
    }
}
