//! Driving logs and drives of other people, read as they are. They cannot be
//! part of this project; where they are absent, these tests say so and pass.

use std::{fs, sync::Arc};

use crate::support::shared;
use lapwing::known::Roads;
use lapwing_core::{protocol::number, recording::Recording, recording::udacity::DrivingLog};
use lapwing_learn::dataset;
use lapwing_score::{
    odometry::Road,
    score::{self, Figure, Scorer},
};

#[test]
fn every_shared_driving_log_is_read_to_its_last_row() {
    let Some(folder) = shared("driving_logs") else { return };
    let mut count = 0;
    for file in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if file.extension().is_none_or(|e| e != "csv") {
            continue;
        }
        count += 1;
        let log = DrivingLog::open(&file).unwrap();
        let text = fs::read_to_string(&file).unwrap();
        let header = usize::from(text.starts_with("center,"));
        assert_eq!(log.rows.len(), text.lines().count() - header, "{}", file.display());
        let last = log.rows.last().unwrap();
        assert!(last.taken_at.is_some() && last.left.is_some() && last.right.is_some(), "{}", file.display());
        for row in &log.rows {
            assert!((0.0..=31.0).contains(&row.speed.get()), "{}, line {}", file.display(), row.line);
        }
    }
    assert_eq!(count, 7);
}

#[test]
fn real_drives_are_read_with_all_their_pictures() {
    let Some(folder) = shared("recordings") else { return };
    for (name, count, interval_ms) in [("lake", 2200, 71.0), ("jungle", 1500, 117.0), ("mountain", 1084, 102.0)] {
        let log = DrivingLog::open(folder.join(name)).unwrap();
        assert_eq!(log.rows.len(), count, "{name}");
        for row in &log.rows {
            for picture in [Some(&row.center), row.left.as_ref(), row.right.as_ref()].into_iter().flatten() {
                assert!(picture.is_file(), "{}", picture.display());
            }
        }
        let mut intervals: Vec<_> = log.rows.windows(2).map(|r| (r[1].at - r[0].at).as_secs_f64() * 1e3).collect();
        intervals.sort_by(f64::total_cmp);
        let median = intervals[intervals.len() / 2];
        assert!((median - interval_ms).abs() < 15.0, "{name}: {median} ms");
    }
}

#[test]
fn every_number_of_real_drives_is_written_as_the_simulator_wrote_it() {
    let Some(folder) = shared("recordings") else { return };
    let (mut count, mut with_exponent) = (0, 0);
    for name in ["lake", "jungle", "mountain"] {
        for line in fs::read_to_string(folder.join(name).join("driving_log.csv")).unwrap().lines() {
            for text in line.split(',').skip(3).map(str::trim) {
                assert_eq!(number::single(text.parse().unwrap()), text, "{name}");
                count += 1;
                with_exponent += u32::from(text.contains('E'));
            }
        }
    }
    assert!(
        count == 4 * (2200 + 1500 + 1084) && with_exponent > 10,
        "{count} numbers, {with_exponent} with an exponent"
    );
}

#[test]
fn real_drives_are_known_by_their_bends_and_their_collisions_found_in_log_and_run_alike() {
    let Some(folder) = shared("recordings") else { return };
    let roads: Vec<Arc<Road>> = Roads::default().known().unwrap();
    let dir = tempfile::tempdir().unwrap();
    for (name, track, laps, collision_s) in [
        ("lake", Some("lake"), Some(1.0), 152.5),
        ("jungle", Some("jungle"), Some(0.0), 119.1),
        ("mountain", Some("mountain"), Some(0.0), 107.6),
    ] {
        let log = folder.join(name);
        let card =
            score::of_recording(&mut Recording::open(&log).unwrap(), Scorer::on(&roads, Some(1)), |_, _| ()).unwrap();
        assert_eq!((card.track.as_deref(), card.value(Figure::Laps)), (track, laps), "{name}: {card}");
        assert_eq!(card.value(Figure::Collisions), Some(1.0), "{name}: {card}");
        assert!((card.value(Figure::SurvivalS).unwrap() - collision_s).abs() < 0.1, "{name}: {card}");
        let run = dir.path().join(name).with_extension("mcap");
        dataset::convert(&log, &run, &mut |_, _| std::ops::ControlFlow::Continue(())).unwrap();
        let mut run = Recording::open(&run).unwrap();
        let of_run = score::of_recording(&mut run, Scorer::on(&roads, Some(1)), |_, _| ()).unwrap();
        assert_eq!(of_run, card, "{name}");
    }
}
