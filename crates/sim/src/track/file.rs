//! Tracks as files.

use std::{fmt, path::PathBuf};

use serde::{Deserialize, Serialize};

use lapwing_core::words::{did_you_mean, suggesting};

/// A track as a person writes it, in TOML.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrackFile {
    /// What it is called.
    pub name: String,
    /// Its landscape: colours, plants, rocks, light.
    pub theme: Theme,
    /// Width of the road, edge to edge, in metres.
    pub width_m: f64,
    /// The line to drive: metres to the right of the middle.
    #[serde(default)]
    pub driving_line_m: f64,
    /// Random seed of the scenery along it.
    pub scenery_seed: u64,
    /// Where the car is stationary when a run begins.
    pub start: Start,
    /// Control points of a closed uniform cubic B-spline through the road's middle: x, y (up), z, in metres.
    pub control_points: Vec<[f64; 3]>,
    /// What is special along the road.
    #[serde(default, rename = "stretch")]
    pub stretches: Vec<Stretch>,
    /// What stands alone in the landscape, in its own place.
    #[serde(default, rename = "landmark", skip_serializing_if = "Vec::is_empty")]
    pub landmarks: Vec<Landmark>,
}

/// Something that stands alone in the landscape.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Landmark {
    /// What it is.
    pub kind: LandmarkKind,
    /// Metres to Unity's right.
    pub x: f64,
    /// Metres to Unity's front.
    pub z: f64,
}

/// What a landmark can be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LandmarkKind {
    /// A pylon of a power line; wires hang from each to the next.
    Pylon,
    /// A road sign on two posts, seen from behind.
    Sign,
}

/// Colours, plants, rocks, light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Theme {
    /// Grey asphalt, double yellow lines, pale verge, water, conifers, clear sky.
    Lake,
    /// Pale asphalt, white edge lines and a dashed middle, steep green rock, palms, hard shadows.
    Jungle,
    /// Brown-grey asphalt, leaves along it, concrete blocks, autumn trees, dark rock.
    Mountain,
}

/// Where the car is stationary when a run begins.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Start {
    /// Metres to Unity's right.
    pub x: f64,
    /// Metres up.
    pub y: f64,
    /// Metres to Unity's front.
    pub z: f64,
    /// Degrees clockwise from +z.
    pub yaw_deg: f64,
}

/// A piece of road with something special along it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stretch {
    /// Where it begins, in metres along the road.
    pub from_m: f64,
    /// Where it ends; smaller than `from_m` if it runs past the start.
    pub to_m: f64,
    /// On which side.
    pub side: Side,
    /// What it is.
    pub edge: Edge,
}

/// A side of the road.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Side {
    /// Left in driving direction.
    Left,
    /// Right in driving direction.
    Right,
    /// Both.
    Both,
}

impl Side {
    pub(super) fn other(self) -> Self {
        match self {
            Self::Left => Self::Right,
            Self::Right => Self::Left,
            Self::Both => Self::Both,
        }
    }
}

/// What a side of the road can be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Edge {
    /// Red and white kerb.
    Kerb,
    /// Open dirt, at the level of the road, without a line.
    Dirt,
    /// The bridge: paving instead of asphalt, and a low black wall that can be hit.
    Bridge,
    /// Concrete blocks in a row, which can be hit.
    Blocks,
    /// A rock face close by, which can be hit.
    Rock,
    /// Water a few metres away.
    Water,
    /// Posts with a red and white board, and behind them the ground falls away; they are not hit.
    Posts,
}

impl Edge {
    /// How far outside the road's edge it begins, in metres.
    pub const fn stands_off_m(self) -> f64 {
        match self {
            Self::Kerb | Self::Dirt => 0.0,
            Self::Bridge => 1.9, // its wall's foot: 1.4 m where it begins, 2.8 m where it ends
            Self::Blocks => 1.2,
            Self::Posts => 1.5,
            Self::Rock => 3.0,
            Self::Water => 8.0,
        }
    }
}

impl fmt::Display for Edge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Kerb => "a kerb",
            Self::Dirt => "the dirt",
            Self::Bridge => "the bridge's wall",
            Self::Blocks => "a concrete block",
            Self::Rock => "a rock face",
            Self::Water => "the water",
            Self::Posts => "a post",
        })
    }
}

/// Why a road cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum TrackError {
    /// No track of that name.
    #[error(
        "unknown track: expected lake, jungle, mountain, random:SEED, random-lanes:SEED \
         or a file ending in .toml, got {got:?}{}",
        did_you_mean(got, super::Track::NAMES)
    )]
    Unknown {
        /// The name.
        got: String,
    },
    /// A track's file cannot be read.
    #[error("{path} cannot be read: {source}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why, in the system's words.
        source: std::io::Error,
    },
    /// A track's file is not valid.
    #[error("{path}: {source}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        source: Box<TrackError>,
    },
    /// The file of another road than the one that a recording names.
    #[error("{}: expected the road {expected:?}, got {got:?}: name the file of that road", path.display())]
    Called {
        /// The file.
        path: PathBuf,
        /// The name that was looked for.
        expected: String,
        /// The name in the file.
        got: String,
    },
    /// Two roads that recordings cannot tell apart.
    #[error(
        "--track {first}, --track {second}: expected roads of different names, got {name:?} in both: rename one of them"
    )]
    SameName {
        /// How one was asked for.
        first: String,
        /// And the other.
        second: String,
        /// What both call themselves.
        name: String,
    },
    /// Not the TOML of a track.
    #[error("track file: {}", suggesting(&.0.to_string()))]
    Toml(#[from] toml::de::Error),
    /// A number that is not valid for a road.
    #[error("track {name}: {what}: expected {expected}, got {got}")]
    Value {
        /// The track.
        name: String,
        /// Which value.
        what: String,
        /// What it should be.
        expected: &'static str,
        /// What it is.
        got: String,
    },
}

/// The ground around a longer road takes minutes to lay out.
const LONGEST_M: f64 = 20_000.0;

/// What a road of one's own may be called.
const NAME: &str =
    "one other than lake, jungle, mountain, random… and random-lanes…, by which recordings tell the road";

impl TrackFile {
    /// Reads TOML.
    ///
    /// # Errors
    /// [`TrackError::Toml`], with line and column.
    pub fn parse(text: &str) -> Result<Self, TrackError> {
        Ok(toml::from_str(text)?)
    }

    /// Whether a stretch of this kind runs along that side at `s`.
    pub fn has(&self, edge: Edge, side: Side, s: f64) -> bool {
        self.stretches.iter().any(|stretch| {
            stretch.edge == edge
                && (stretch.side == side || stretch.side == Side::Both)
                && if stretch.from_m <= stretch.to_m {
                    (stretch.from_m..stretch.to_m).contains(&s)
                } else {
                    s >= stretch.from_m || s < stretch.to_m
                }
        })
    }

    /// Checks that a file does not call its road as one that is known: recordings tell the road by its name.
    pub(super) fn check_name(&self) -> Result<(), TrackError> {
        let is_random =
            |kind: &str| self.name.strip_prefix(kind).is_some_and(|rest| rest.is_empty() || rest.starts_with(':'));
        let known =
            super::Track::NAMES.contains(&self.name.as_str()) || is_random("random") || is_random("random-lanes");
        let is_plain = !self.name.is_empty() && self.name.trim() == self.name && !self.name.contains(char::is_control);
        let expected = match (known, is_plain) {
            (false, true) => return Ok(()),
            (true, _) => NAME,
            (false, false) => "a word or more on one line, without spaces around it",
        };
        let (name, got) = (self.name.clone(), format!("{:?}", self.name));
        Err(TrackError::Value { name, what: "name".into(), expected, got })
    }

    pub(super) fn check(&self) -> Result<(), TrackError> {
        let wrong = |what: String, expected, got: String| {
            Err(TrackError::Value { name: self.name.clone(), what, expected, got })
        };
        if self.control_points.len() < 8 {
            return wrong("control_points".into(), "at least 8", self.control_points.len().to_string());
        }
        let mut around_m = 0.0;
        for (i, point) in self.control_points.iter().enumerate() {
            let next = self.control_points[(i + 1) % self.control_points.len()];
            let apart = (point[0] - next[0]).hypot(point[2] - next[2]);
            if !point.iter().all(|x| x.abs() < 1e5) || !(0.5..=200.0).contains(&apart) {
                let expected =
                    "finite metres, 0.5 to 200 m from the next (after the last comes the first: it is not repeated)";
                return wrong(format!("control point {i}"), expected, format!("{point:?}, {apart:.1} m from {next:?}"));
            }
            around_m += apart;
        }
        if around_m > LONGEST_M {
            return wrong("control_points".into(), "a road of at most 20,000 m", format!("{around_m:.0} m"));
        }
        if !(2.5..=50.0).contains(&self.width_m) {
            return wrong("width_m".into(), "2.5 to 50", self.width_m.to_string());
        }
        if !(0.0..=self.width_m / 2.0).contains(&self.driving_line_m.abs()) {
            return wrong("driving_line_m".into(), "a place on the road", self.driving_line_m.to_string());
        }
        let Start { x, y, z, yaw_deg } = self.start;
        if ![x, y, z, yaw_deg].iter().all(|v| v.abs() < 1e5) {
            return wrong("start".into(), "finite metres and degrees", format!("{:?}", self.start));
        }
        for (i, stretch) in self.stretches.iter().enumerate() {
            if ![stretch.from_m, stretch.to_m].iter().all(|m| (0.0..=LONGEST_M).contains(m)) {
                let got = format!("from {} to {}", stretch.from_m, stretch.to_m);
                return wrong(format!("stretch {i}"), "metres along the road, from its first control point", got);
            }
        }
        for (i, Landmark { x, z, .. }) in self.landmarks.iter().enumerate() {
            if ![x, z].iter().all(|m| m.abs() < 1e5) {
                return wrong(format!("landmark {i}"), "finite metres", format!("x = {x}, z = {z}"));
            }
        }
        Ok(())
    }
}
