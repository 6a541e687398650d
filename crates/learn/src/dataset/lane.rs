//! Labels from where in its lane the car was: the place of each camera, and what the simulator's expert steers from there,
//! not what was recorded.

use std::{collections::HashMap, path::Path, sync::Arc};

use super::{CameraPosition, DatasetError, Source, places, samples::CameraInLane};
use lapwing_core::{
    units::{Mph, Steering},
    words::count,
};
use lapwing_sim::{
    camera::Camera,
    expert::LaneExpert,
    locate::{InLane, LaneTableError, Pose},
    track::Track,
};

/// What is known of one camera's picture.
#[derive(Debug, Clone, Copy)]
struct LaneLabel {
    steering: Steering,
    at: CameraInLane,
}

/// The labels of a data set's rows, one for each camera.
#[derive(Debug)]
pub(super) struct LaneLabels {
    /// `None` where the car's place is not known.
    rows: Vec<Option<[LaneLabel; 3]>>,
    /// Pictures of roads that are not known.
    elsewhere: usize,
}

impl LaneLabels {
    /// Reads the table, and makes the centre camera's labels those of the rows.
    pub fn open(path: &Path, source: &mut Source) -> Result<Self, DatasetError> {
        let table = places::table(source, path)?;
        let wrong = |source| LaneTableError::Track { path: path.to_owned(), source: Box::new(source) };
        let mut experts = HashMap::new();
        for track in table.tracks() {
            experts.insert(track.file().name.as_str(), LaneExpert::new(Arc::clone(track)).map_err(wrong)?);
        }
        let poses = places::poses(&table, source);
        source.places = places::of(&poses);
        let mut poses = poses.into_iter();
        let mut labels = |track: &Track, pose: Pose, speed: Mph| {
            let expert = experts.get_mut(track.file().name.as_str())?;
            Some([&Camera::CENTER, &Camera::LEFT, &Camera::RIGHT].map(|camera| {
                // What a side camera sees is what the centre one would see from a car that far to the side.
                let (sin, cos) = pose.heading_rad.sin_cos();
                let right_m = camera.mount.position.x;
                let (s_m, offset_m) = (pose.s_m - right_m * sin, pose.offset_m + right_m * cos);
                let pose = Pose { s_m, offset_m, ..pose };
                let InLane { offset_m, heading_rad, .. } = pose.in_lane(track);
                let at = CameraInLane { offset_m, heading_deg: heading_rad.to_degrees() };
                LaneLabel { steering: expert.steering(pose, speed), at }
            }))
        };
        let mut rows = Vec::with_capacity(source.rows.len());
        source.relabel(|row| {
            let of_cameras = poses.next().flatten().and_then(|(track, pose)| labels(track, pose, row.speed));
            rows.push(of_cameras);
            of_cameras.map(|[center, ..]| center.steering)
        });
        Ok(Self { rows, elsewhere: table.elsewhere })
    }

    /// Whether the car's place is known in this row.
    pub fn knows(&self, row: usize) -> bool {
        self.rows.get(row).is_some_and(Option::is_some)
    }

    /// What to steer where this camera is.
    pub fn steering(&self, row: usize, camera: CameraPosition) -> Option<f64> {
        Some(self.label(row, camera)?.steering.get())
    }

    /// Where in its lane this camera is.
    pub fn in_lane(&self, row: usize, camera: CameraPosition) -> Option<CameraInLane> {
        Some(self.label(row, camera)?.at)
    }

    fn label(&self, row: usize, camera: CameraPosition) -> Option<LaneLabel> {
        Some((*self.rows.get(row)?)?[camera as usize])
    }

    /// Says how many of the selected rows are labelled, and how many are left out.
    pub fn tell(&self, source: &Source, (first, end): (usize, usize)) {
        let selected = self.rows.get(first..end.min(self.rows.len())).unwrap_or_default();
        let known = selected.iter().flatten().count();
        let left_out = count(selected.len() - known, "row");
        let elsewhere = match self.elsewhere {
            0 => String::new(),
            pictures => format!("; {} of the whole table on unknown roads", count(pictures, "picture")),
        };
        let path = source.path.display();
        tracing::info!("{path}: {} labelled from the lane, {left_out} left out{elsewhere}", count(known, "row"));
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::dataset::{
        Balance, Samples, Selection, Set,
        fixture::{folder, weaving},
    };
    use lapwing_sim::locate::table;

    #[test]
    fn labels_of_a_weaving_drive_are_the_experts_whatever_was_steered() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("weaving");
        let expert = weaving(&folder);
        let recorded = Selection::of(&folder);
        let from_lane = Selection { lane: Some(folder.join("lane.csv")), ..recorded.clone() };
        let open = |selection: &Selection| {
            Samples::open(std::slice::from_ref(selection), Set::Training, None, &Balance::default()).unwrap()
        };
        let (recorded, from_lane) = (open(&recorded), open(&from_lane));
        let worst = |samples: &Samples| {
            let centre = samples.samples.iter().filter(|sample| sample.camera == CameraPosition::Center);
            centre.map(|sample| (sample.steering - expert[sample.row as usize]).abs()).fold(0.0, f64::max)
        };
        assert!(worst(&recorded) > 0.1, "the driver weaves: {:.3}", worst(&recorded));
        assert!(worst(&from_lane) < 0.01, "{:.3} from what the expert steers", worst(&from_lane));
        // Rows without a place are left out, with all of their cameras.
        let rows = recorded.samples.len() / 3;
        let unseen = (0..rows).filter(|row| row % 10 == 5).count();
        assert_eq!(from_lane.samples.len(), 3 * (rows - unseen));
        assert!(from_lane.samples.iter().all(|sample| sample.row % 10 != 5));
        // The left camera sees what a car further left sees, which steers further to the right.
        for three in from_lane.samples.chunks(3) {
            let three: &[_; 3] = three.try_into().unwrap();
            let [center, left, right] = three;
            assert!(left.steering > center.steering && right.steering < center.steering, "{three:?}");
            let [center, left, right] = three.each_ref().map(|sample| sample.in_lane.unwrap());
            let along = center.heading_deg.to_radians().cos();
            assert!((left.offset_m - center.offset_m + 0.806 * along).abs() < 1e-6, "{three:?}");
            assert!((right.offset_m - center.offset_m - 0.825 * along).abs() < 1e-6, "{three:?}");
            assert!((left.heading_deg - center.heading_deg).abs() < 0.5, "only as far as the road bends: {three:?}");
        }
    }

    #[test]
    fn rows_of_two_roads_in_one_log_are_labelled_each_from_its_own() {
        let dir = tempfile::tempdir().unwrap();
        let folder = folder(&dir.path().join("joined"), 20, false);
        let tracks = ["lake", "jungle"].map(|name| Arc::new(Track::named(name).unwrap()));
        let offsets_m = [0.3, -0.4];
        let road = |row: usize| usize::from(row >= 12);
        let pose = |row: usize| {
            let road = road(row);
            Pose::from_lane(&tracks[road], 50.0 + row as f64, false, offsets_m[road], 0.0)
        };
        let text = (0..20).fold(table::heading(), |text, row| {
            text + &table::line(row, 0.067 * row as f64, &tracks[road(row)], Some(pose(row)))
        });
        fs::write(folder.join("lane.csv"), text).unwrap();
        let selection = Selection { lane: Some(folder.join("lane.csv")), ..Selection::of(&folder) };
        let samples = Samples::open(&[selection], Set::Training, None, &Balance::default()).unwrap();
        assert_eq!(samples.samples.len(), 20);
        let mut experts = tracks.each_ref().map(|track| LaneExpert::new(Arc::clone(track)).unwrap());
        for sample in &samples.samples {
            let row = sample.row as usize;
            let expected = experts[road(row)].steering(pose(row), samples.sources[0].rows[row].speed).get();
            assert!((sample.steering - expected).abs() < 0.01, "{row}: {}, expected {expected}", sample.steering);
            let offset_m = sample.in_lane.unwrap().offset_m;
            assert!((offset_m - offsets_m[road(row)]).abs() < 1e-3, "{row}: {offset_m}");
        }
    }

    #[test]
    fn the_table_is_of_this_recording() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("weaving");
        weaving(&folder);
        let lane = folder.join("lane.csv");
        let text = fs::read_to_string(&lane).unwrap();
        let heading = table::heading();
        // The rows of a shorter recording, and those of one that began a row later.
        let later: String = text.lines().skip(2).enumerate().fold(heading, |text, (moment, line)| {
            let cells = line.split_once(',').unwrap().1;
            text + &format!("{moment},{cells}\n")
        });
        let shorter = text.lines().take(40).fold(String::new(), |text, line| text + line + "\n");
        for other in [shorter, later] {
            fs::write(&lane, other).unwrap();
            let selection = Selection { lane: Some(lane.clone()), ..Selection::of(&folder) };
            let error = Samples::open(&[selection], Set::Training, None, &Balance::default()).unwrap_err().to_string();
            assert!(error.contains("rows of other moments: make it again with `lapwing locate --csv`"), "{error}");
        }
    }

    #[test]
    fn labels_from_the_lane_are_not_averaged() {
        let selection = Selection { lane: Some("lane.csv".into()), smooth: 9, ..Selection::of("lake") };
        let error = Samples::open(&[selection], Set::Training, None, &Balance::default()).unwrap_err();
        assert_eq!(error.to_string(), "lake: smooth: expected 1 with labels from the lane, got 9");
    }
}
