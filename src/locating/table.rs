//! What was found, row by row, as CSV.

use std::fmt::Write;

use super::LocatedRecording;

/// The columns: the moment, counted from 0; seconds; the road; whether it is driven against its direction; metres along
/// it; metres right of the lane's middle; degrees clockwise from its direction; the road's left and right edge, as metres
/// right of the lane's middle; standard deviations of place, offset and heading; how well the drawn road agrees with the
/// picture, -1 to 1. All but the first two are empty where the place is not known.
const COLUMNS: &str = "moment,at_s,track,reversed,place_m,offset_m,heading_deg,edge_left_m,edge_right_m,\
                       place_sd_m,offset_sd_m,heading_sd_deg,agreement";

impl LocatedRecording {
    /// As CSV: a line for each moment with a picture.
    pub fn csv(&self) -> String {
        let mut text = format!("{COLUMNS}\n");
        for part in &self.parts {
            for (i, row) in self.rows[part.rows.clone()].iter().enumerate() {
                let place = part.on.as_ref().and_then(|on| Some((on, on.drive.places[i]?)));
                let rest = place.map_or_else(
                    || ",".repeat(10),
                    |(on, located)| {
                        let lane = located.pose.in_lane(&on.drive.track);
                        let deviation = located.deviation;
                        format!(
                            "{},{},{:.2},{:.3},{:.3},{:.2},{:.2},{:.2},{:.3},{:.3},{:.3}",
                            quoted(on.road()),
                            on.reversed,
                            located.pose.s_m.rem_euclid(on.drive.track.length()),
                            lane.offset_m,
                            lane.heading_rad.to_degrees(),
                            lane.edges_m.0,
                            lane.edges_m.1,
                            deviation.s_m,
                            deviation.offset_m,
                            deviation.heading_rad.to_degrees(),
                            located.fit.agreement
                        )
                    },
                );
                // Writing to a string does not fail.
                let _ = writeln!(text, "{},{:.3},{rest}", row.moment, row.at_s);
            }
        }
        text
    }
}

/// A name as a field: quoted if it must be.
fn quoted(name: &str) -> String {
    if name.contains([',', '"', '\n', '\r']) { format!("\"{}\"", name.replace('"', "\"\"")) } else { name.to_owned() }
}
