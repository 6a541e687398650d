//! What was found, row by row, as CSV.

use super::{LocatedRecording, network::NetworkLane};
use lapwing_sim::locate::table::{COLUMNS, cells};

/// The columns after those that are read again: the road's left and right edge, as metres right of the lane's middle;
/// standard deviations of place, offset and heading; how well the drawn road agrees with the picture, -1 to 1. They are
/// empty where the place is not known.
const MORE: &str = "edge_left_m,edge_right_m,place_sd_m,offset_sd_m,heading_sd_deg,agreement";

/// The columns after those, if a network was asked: what it sees, and how sure it is, as standard deviations. They are empty
/// where the picture cannot be looked at.
const NETWORK: &str = "network_offset_m,network_heading_deg,network_offset_sd_m,network_heading_sd_deg";

impl LocatedRecording {
    /// As CSV: a line for each moment with a picture.
    pub fn csv(&self) -> String {
        let mut text = COLUMNS.join(",") + "," + MORE;
        if self.network.is_some() {
            text = text + "," + NETWORK;
        }
        text.push('\n');
        for part in &self.parts {
            for (i, row) in self.rows[part.rows.clone()].iter().enumerate() {
                let place = part.on.as_ref().and_then(|on| Some((&on.drive.track, on.drive.places[i]?)));
                text += &place.map_or_else(
                    || format!("{},{:.3}{}", row.moment, row.at_s, ",".repeat(11)),
                    |(track, located)| {
                        let (lane, deviation) = (located.pose.in_lane(track), located.deviation);
                        format!(
                            "{},{:.2},{:.2},{:.2},{:.3},{:.3},{:.3}",
                            cells(row.moment, row.at_s, track, Some(located.pose)),
                            lane.edges_m.0,
                            lane.edges_m.1,
                            deviation.s_m,
                            deviation.offset_m,
                            deviation.heading_rad.to_degrees(),
                            located.fit.agreement
                        )
                    },
                );
                if let Some(network) = &self.network {
                    text += &network.rows.get(part.rows.start + i).copied().flatten().map_or_else(
                        || ",".repeat(4),
                        |NetworkLane { offset_m, heading_deg, deviation: (offset_sd_m, heading_sd_deg) }| {
                            format!(",{offset_m:.3},{heading_deg:.3},{offset_sd_m:.3},{heading_sd_deg:.3}")
                        },
                    );
                }
                text.push('\n');
            }
        }
        text
    }
}
