//! Where the car was in each row: what a picture has to be warped by to show the road as the car sees it a moment later.

use std::{collections::HashMap, path::Path, sync::Arc};

use glam::DVec3;

use super::{DatasetError, Labelled, Source};
use lapwing_core::{
    perception::{Frame, decode_jpeg},
    recording::udacity::LOG_NAME,
};
use lapwing_sim::{
    along::SIZE,
    locate::{LaneTable, LaneTableError, Pose},
    record::LANE_NAME,
    track::Track,
    vehicle::{Car, STEP_S},
};

/// A place in the world, in metres, and a yaw, in radians.
pub(super) type CarPlace = (DVec3, f64);

/// A table of a data set's places.
pub(super) fn table(source: &Source, path: &Path) -> Result<LaneTable, LaneTableError> {
    LaneTable::of(&source.path, path, |name| Track::called(name, source.track.as_deref()))
}

/// Each row's road and pose in the table, where that is known.
pub(super) fn poses<'a>(table: &'a LaneTable, source: &Source) -> Vec<Option<(&'a Arc<Track>, Pose)>> {
    let poses: HashMap<usize, (&Arc<Track>, Pose)> = table.known().collect();
    source.rows.iter().map(|row| poses.get(&row.moment).copied()).collect()
}

/// Poses on their tracks as places.
pub(super) fn of(poses: &[Option<(&Arc<Track>, Pose)>]) -> Vec<Option<CarPlace>> {
    poses.iter().map(|known| known.map(|(track, pose)| pose.in_world(track))).collect()
}

/// Fills in where the car was, if its labels from the lane have not told: from the table that `record` writes beside a log, and
/// otherwise from speed and steering. (What `record --recovery` logs is not what was steered.)
pub(super) fn place(source: &mut Source) -> Result<(), DatasetError> {
    check_size(source)?;
    if !source.places.is_empty() {
        return Ok(());
    }
    let beside = match source.path.ends_with(LOG_NAME) {
        true => source.path.with_file_name(LANE_NAME),
        false => source.path.join(LANE_NAME),
    };
    source.places = match beside.is_file() {
        true => of(&poses(&table(source, &beside)?, source)),
        false => reckoned(source),
    };
    Ok(())
}

/// Only the stock camera's lens is known: refuses a data set whose first picture is not one of its.
fn check_size(source: &Source) -> Result<(), DatasetError> {
    let Some(picture) = source.rows.iter().flat_map(|row| &row.pictures).flatten().next() else { return Ok(()) };
    let mut frame = Frame::default();
    let image = |why| DatasetError::Image { picture: picture.to_string(), why };
    decode_jpeg(&super::read(picture)?, &mut frame).map_err(image)?;
    if (frame.width(), frame.height()) == SIZE { Ok(()) } else { Err(not_stock(&frame)) }
}

/// A picture that cannot be moved to where the car is.
pub(super) fn not_stock(frame: &Frame) -> DatasetError {
    let expected = "0 unless all pictures are 320x160, as the stock camera takes them";
    let got = format!("a picture of {}x{}", frame.width(), frame.height());
    DatasetError::Setting { name: "augment.late", expected, got }
}

/// Dead reckoning with the simulator's own model of the car: only what is between rows of a stretch that are a second apart or less
/// means anything.
fn reckoned(source: &Source) -> Vec<Option<CarPlace>> {
    // Counted from the beginning, so that no part of a step is lost from row to row.
    let steps = |row: &Labelled| (row.at.as_secs_f64() / STEP_S).round() as u64;
    let mut car = Car::default();
    let place = |(i, row): (usize, &Labelled)| {
        if i > 0 && source.one_stretch(i - 1, i) {
            for _ in steps(&source.rows[i - 1])..steps(row) {
                car.step_at(row.speed.metres_per_second().get(), row.steering);
            }
        }
        Some((car.position, car.yaw))
    };
    source.rows.iter().enumerate().map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{
        Augmentation, Balance, Batch, Cache, CameraPosition, Inputs, Loader, Numbers, Samples, Selection, Set, Workers,
        fixture::{folder, weaving},
    };
    use lapwing_core::perception::{ColourSpace, Crop, PixelScale, Preprocess, Resize, ResizeFilter};

    /// The centre camera's pictures of a drive.
    fn samples(folder: &Path) -> Samples {
        let centre = Selection { cameras: vec![CameraPosition::Center], ..Selection::of(folder) };
        let mut samples = Samples::open(&[centre], Set::Training, None, &Balance::default()).unwrap();
        samples.place().unwrap();
        samples
    }

    #[test]
    fn speed_and_steering_tell_how_the_car_moved_in_a_moment() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("weaving");
        weaving(&folder);
        let known = samples(&folder).sources.remove(0);
        std::fs::remove_file(folder.join(LANE_NAME)).unwrap();
        let reckoned = samples(&folder).sources.remove(0);
        let mut compared = 0;
        for row in 15..known.rows.len() {
            let Some((then, truth)) = known.earlier(row, 0.2) else { continue };
            let (from, beside) = reckoned.earlier(row, 0.2).unwrap();
            assert_eq!(then, from);
            let off = [truth.ahead_m - beside.ahead_m, truth.offset_m - beside.offset_m];
            let turned_deg = (truth.heading_rad - beside.heading_rad).to_degrees();
            assert!(off.iter().all(|m| m.abs() < 0.1) && turned_deg.abs() < 0.5, "{row}: {truth:?}, {beside:?}");
            compared += 1;
        }
        assert!(compared > 100, "{compared}");
    }

    /// (B), each picture's numbers, in the order of the rows.
    fn seen(samples: &Arc<Samples>, augmentation: Augmentation) -> Vec<Vec<f32>> {
        let resize = Resize { height: 38, width: 160, filter: ResizeFilter::BilinearAntialiased };
        let preprocess = Preprocess::of(Some(Crop::rows(60, 135)), resize, ColourSpace::Grey, PixelScale::Unit);
        let count = preprocess.shape().iter().product();
        let order = (0..samples.samples.len() as u32).collect();
        let workers = Workers { threads: 1, beside: true };
        let cache = Cache::new(samples, 1 << 26);
        let inputs = Inputs::plain(preprocess, 1);
        let loader = Loader::start(Arc::clone(samples), cache, inputs, augmentation, order, 16, (1, 0, 0), workers);
        let rows = |batch: Batch| match &*batch.frames {
            Numbers::F32(all) => all.chunks(count).map(<[f32]>::to_vec).collect::<Vec<_>>(),
            Numbers::Bf16(_) => unreachable!(),
        };
        loader.unwrap().flat_map(|batch| rows(batch.unwrap())).collect()
    }

    #[test]
    fn an_older_picture_moved_to_where_the_car_is_shows_what_the_car_sees() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("weaving");
        weaving(&folder);
        let samples = Arc::new(samples(&folder));
        let now = seen(&samples, Augmentation::none());
        let moved = seen(&samples, Augmentation { late: 1.0, late_s: 0.4, ..Augmentation::none() });
        let differ = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.len() as f32;
        let from_now: Vec<f32> = now.iter().zip(&moved).map(|(a, b)| differ(a, b)).collect();
        let older: Vec<f32> = now.windows(3).map(|of| differ(&of[0], &of[2])).collect();
        let mean = |all: &[f32]| all.iter().sum::<f32>() / all.len() as f32;
        let replaced = from_now.iter().filter(|x| **x > 0.0).count() as f64 / now.len() as f64;
        assert!(replaced > 0.6, "{replaced} of the pictures");
        assert!(mean(&from_now) < 0.7 * mean(&older), "{} of {}", mean(&from_now), mean(&older));
    }

    #[test]
    fn pictures_of_an_unknown_lens_cannot_be_moved() {
        let dir = tempfile::tempdir().unwrap();
        let folder = folder(&dir.path().join("small"), 20, false);
        let mut samples = Samples::open(&[Selection::of(folder)], Set::Training, None, &Balance::default()).unwrap();
        assert_eq!(
            samples.place().unwrap_err().to_string(),
            "augment.late: expected 0 unless all pictures are 320x160, as the stock camera takes them, got a picture \
             of 64x32"
        );
    }
}
