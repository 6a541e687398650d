//! The second way: a network looks at each picture by itself. It knows no road and no drive, and says how sure it is; what it
//! sees is held against the truth, if that is told, against the drawn road, and from camera to camera.

#[cfg(feature = "networks")]
mod looking;

use std::{fmt, ops::Range};

use serde::Serialize;

#[cfg(feature = "networks")]
pub use looking::look;

use super::{
    LocatedRecording, On, Part, RowTruth,
    summary::{AgainstTruth, Errors, Sides, Spread},
};

/// A network that is less sure of the offset than this, in metres (a standard deviation), does not see the lane.
const UNSURE_M: f64 = 0.5;

/// What a network sees in one picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NetworkLane {
    /// Metres that the camera is to the right of its lane's middle.
    pub offset_m: f64,
    /// Degrees that it is turned clockwise from the lane's direction.
    pub heading_deg: f64,
    /// Standard deviations of both, in metres and degrees: how sure it is.
    pub deviation: (f64, f64),
}

impl NetworkLane {
    /// Whether it is sure enough to have seen the lane.
    pub fn is_sure(&self) -> bool {
        self.deviation.0 < UNSURE_M
    }
}

/// What a network sees in the pictures of one camera.
#[derive(Debug, Clone)]
pub struct ByNetwork {
    /// The network, for people.
    pub model: String,
    /// For each moment with a picture what the network sees; `None` where the picture cannot be looked at.
    pub rows: Vec<Option<NetworkLane>>,
}

impl ByNetwork {
    /// How wrong what is seen surely enough is, where the truth of a row is told.
    pub fn against(&self, truth: impl Fn(usize) -> Option<RowTruth>, rows: Range<usize>) -> Option<AgainstTruth> {
        let told: Vec<_> = rows.filter_map(|i| Some((self.sure(i)?, truth(i)?))).collect();
        let offset = |(lane, truth): &(NetworkLane, RowTruth)| (lane.offset_m - truth.offset_m, lane.deviation.0);
        let heading =
            |(lane, truth): &(NetworkLane, RowTruth)| Some((lane.heading_deg - truth.heading_deg?, lane.deviation.1));
        Some(AgainstTruth {
            offset_m: Errors::with_sd(&told.iter().map(offset).collect::<Vec<_>>())?,
            heading_deg: Errors::with_sd(&told.iter().filter_map(heading).collect::<Vec<_>>()),
            place_m: None,
        })
    }

    /// Where the left and the right camera are seen, against where they sit.
    pub fn beside(&self, sides: [&Self; 2], rows: Range<usize>) -> Option<Sides> {
        Sides::of(sides.map(|side| {
            let both = rows.clone().filter_map(|i| Some((self.sure(i)?, side.sure(i)?)));
            both.map(|(center, beside)| (center.heading_deg.to_radians().cos(), beside.offset_m - center.offset_m))
                .collect()
        }))
    }

    /// What is seen surely enough in that row.
    pub fn sure(&self, row: usize) -> Option<NetworkLane> {
        self.rows.get(row).copied().flatten().filter(NetworkLane::is_sure)
    }
}

/// How a network and the track's drawing agree where both see the lane.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Agreement {
    /// The share of the pictures in which both do.
    pub pictures: f64,
    /// How far apart the offsets are, in metres.
    pub offset_m: Errors,
    /// How far apart the headings are, in degrees.
    pub heading_deg: Errors,
}

/// What a network sees on a drive, whether its road is known or not.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NetworkSummary {
    /// The network.
    pub model: String,
    /// The share of the pictures in which it is sure enough to have seen the lane.
    pub seen: f64,
    /// From the lane's middle, in metres, positive to the right.
    pub offset_m: Option<Spread>,
    /// From the lane's direction, in degrees, positive to the right.
    pub heading_deg: Option<Spread>,
    /// The medians of how sure that is, as standard deviations: metres and degrees; absent if it is sure of none.
    pub unsure: Option<[f64; 2]>,
    /// If the road is known: how it agrees with the drawn one.
    pub agreement: Option<Agreement>,
    /// If the recording or a table tells its place: how wrong what was seen is.
    pub against_truth: Option<AgainstTruth>,
    /// If the side cameras' pictures were looked at.
    pub sides: Option<Sides>,
}

impl NetworkSummary {
    /// Of a drive; `None` if no network looked at it.
    pub(super) fn new(found: &LocatedRecording, part: &Part, sides: Option<&[LocatedRecording; 2]>) -> Option<Self> {
        let seen = found.network.as_ref()?;
        let sure: Vec<_> = part.rows.clone().filter_map(|i| Some((i, seen.sure(i)?))).collect();
        let all = |of: fn(&NetworkLane) -> f64| sure.iter().map(|(_, lane)| of(lane)).collect::<Vec<_>>();
        let median = |of| Errors::of(all(of)).map_or(0.0, |errors| errors.median);
        let sides = sides.and_then(|[left, right]| {
            let (left, right) = (left.network.as_ref()?, right.network.as_ref()?);
            seen.beside([left, right], part.rows.clone())
        });
        Some(Self {
            model: seen.model.clone(),
            seen: sure.len() as f64 / part.rows.len().max(1) as f64,
            offset_m: Spread::of(&all(|lane| lane.offset_m)),
            heading_deg: Spread::of(&all(|lane| lane.heading_deg)),
            unsure: (!sure.is_empty()).then(|| [median(|lane| lane.deviation.0), median(|lane| lane.deviation.1)]),
            agreement: part.on.as_ref().and_then(|on| agreement(on, &sure, part.rows.clone())),
            against_truth: seen.against(|i| found.rows[i].truth, part.rows.clone()),
            sides,
        })
    }
}

fn agreement(on: &On, sure: &[(usize, NetworkLane)], rows: Range<usize>) -> Option<Agreement> {
    let both: Vec<_> = sure.iter().filter_map(|(i, lane)| Some((on.drive.in_lane(i - rows.start)?, lane))).collect();
    Some(Agreement {
        pictures: both.len() as f64 / rows.len().max(1) as f64,
        offset_m: Errors::of(both.iter().map(|(drawn, lane)| lane.offset_m - drawn.offset_m).collect())?,
        heading_deg: Errors::of(
            both.iter().map(|(drawn, lane)| lane.heading_deg - drawn.heading_rad.to_degrees()).collect(),
        )?,
    })
}

impl fmt::Display for NetworkSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut line = |label: &str, what: String| write!(f, "\n  {label:<12} {what}");
        line("network", format!("{}, sure of {:.1} % of the pictures", self.model, 100.0 * self.seen))?;
        self.offset_m.as_ref().map_or(Ok(()), |of| line("", format!("offset: {}", of.told(" m"))))?;
        self.heading_deg.as_ref().map_or(Ok(()), |of| line("", format!("heading: {}", of.told("\u{b0}"))))?;
        if let Some([offset, heading]) = self.unsure {
            line("", format!("uncertainty: offset {offset:.2} m, heading {heading:.2}\u{b0} (medians)"))?;
        }
        if let Some(Agreement { pictures, offset_m, heading_deg }) = &self.agreement {
            let share = 100.0 * pictures;
            line("", format!("from the drawn road, in {share:.1} % of the pictures: offset {}", offset_m.told(" m")))?;
            line("", format!("    heading {}", heading_deg.told("\u{b0}")))?;
        }
        if let Some(AgainstTruth { offset_m, heading_deg, .. }) = &self.against_truth {
            line("", format!("error: offset {}", offset_m.told(" m")))?;
            heading_deg.as_ref().map_or(Ok(()), |of| line("", format!("    heading {}", of.told("\u{b0}"))))?;
        }
        self.sides.as_ref().map_or(Ok(()), |sides| line("", format!("side cameras: {sides}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::locating::{Row, Summary};
    use lapwing_core::motion::Motion;

    /// A drive on no known road, of which a network sees these offsets, and is unsure of the last.
    fn seen(offsets_m: &[f64]) -> LocatedRecording {
        let truth = Some(RowTruth { offset_m: 0.5, heading_deg: Some(2.0), position: None });
        let row = |moment| Row {
            at_s: 0.1,
            moment,
            apart_s: 0.1,
            motion: Motion::default(),
            steered_rad: 0.0,
            broken: None,
            truth,
        };
        let lane = |(i, offset_m): (usize, &f64)| {
            let unsure = i + 1 == offsets_m.len();
            let deviation = (if unsure { 0.9 } else { 0.02 }, 0.3);
            Some(NetworkLane { offset_m: *offset_m, heading_deg: 2.5, deviation })
        };
        let rows = offsets_m.iter().enumerate().map(lane).collect();
        let unknown = Some("no road is known".into());
        LocatedRecording {
            parts: vec![Part { rows: 0..offsets_m.len(), way_m: 3.0, on: None, unknown }],
            rows: (0..offsets_m.len()).map(row).collect(),
            network: Some(ByNetwork { model: "lane (a file)".into(), rows }),
            released_at_once: vec![],
            laps: None,
            unreadable: (0, None),
        }
    }

    #[test]
    fn on_an_unknown_road_a_networks_figures_stand_alone() {
        let summary = Summary::new("x".into(), &seen(&[0.6, 0.4, 0.5, 3.0]), None);
        let network = summary.drives[0].network.as_ref().unwrap();
        assert_eq!((network.seen, &network.agreement, &summary.drives[0].on), (0.75, &None, &None));
        assert!((network.offset_m.unwrap().mean - 0.5).abs() < 1e-9, "not what it is unsure of");
        let errors = network.against_truth.as_ref().unwrap();
        let heading = errors.heading_deg.unwrap();
        assert!((errors.offset_m.median - 0.1).abs() < 1e-9 && heading.median == 0.5);
        assert_eq!(heading.within_two_sd, Some(1.0), "0.5 is within twice 0.3 degrees");
        assert_eq!(errors.offset_m.within_two_sd, Some(1.0 / 3.0), "only the error of 0 is within twice 0.02 m");
        let told = summary.to_string();
        assert!(told.contains("on no known road: no road is known"), "{told}");
        assert!(told.contains("sure of 75.0 % of the pictures"), "{told}");
    }

    #[test]
    fn side_cameras_are_held_against_where_they_sit() {
        let sides = [seen(&[-0.2, -0.4, 0.0]), seen(&[1.4, 1.2, 0.0])];
        let summary = Summary::new("x".into(), &seen(&[0.6, 0.4, 0.5]), Some(&sides));
        let sides = summary.drives[0].network.as_ref().unwrap().sides.clone().unwrap();
        assert_eq!(sides.errors_m.rows, 4, "two pictures of each side in which the network is sure");
        assert!((sides.left_m + 0.8).abs() < 1e-9 && (sides.right_m - 0.8).abs() < 1e-9, "{sides:?}");
        assert!(sides.errors_m.p95 < 0.03, "{sides:?}");
    }

    #[test]
    fn the_table_has_a_networks_columns_if_one_was_asked() {
        let mut found = seen(&[0.6, 0.4]);
        let lines: Vec<String> = found.csv().lines().map(str::to_owned).collect();
        assert!(
            lines[0]
                .ends_with("agreement,network_offset_m,network_heading_deg,network_offset_sd_m,network_heading_sd_deg")
        );
        assert_eq!(lines[1], "0,0.100,,,,,,,,,,,,0.600,2.500,0.020,0.300");
        let columns = |line: &str| line.split(',').count();
        assert!(lines.iter().all(|line| columns(line) == columns(&lines[0])), "{lines:?}");
        found.network = None;
        assert!(found.csv().lines().next().unwrap().ends_with("agreement"));
    }
}
