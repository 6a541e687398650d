use super::{shown::best, *};
use lapwing_core::motion::Motion;
use lapwing_score::odometry::{Found, Match, Tried, Whereabouts};
use lapwing_sim::locate::table;

/// A recording of these drives: the road of each, if it is known, and how many pictures it has.
fn recording(drives: &[(Option<&str>, usize)]) -> LocatedRecording {
    let mut parts: Vec<Part> = vec![];
    for (road, pictures) in drives {
        let first = parts.last().map_or(0, |part| part.rows.end);
        let on = road.map(|road| {
            let track = Arc::new(Track::open(road).unwrap());
            let places = vec![Some(Located::known(Pose::from_lane(&track, 9.0, false, 0.0, 0.0))); *pictures];
            On { reversed: false, drive: LocatedDrive { track, places } }
        });
        parts.push(Part { rows: first..first + pictures, way_m: 3.0, on, unknown: None });
    }
    let motion = Motion::default();
    let row = Row { at_s: 0.1, moment: 0, apart_s: 0.1, motion, steered_rad: 0.0, broken: None, truth: None };
    let rows = vec![row; parts.last().map_or(0, |part| part.rows.end)];
    LocatedRecording { parts, rows, released_at_once: vec![], network: None, laps: None, unreadable: (0, None) }
}

#[test]
fn drives_that_are_joined_in_one_log_are_kept_on_every_road() {
    let joined = recording(&[(Some("jungle"), 4), (None, 2), (Some("lake"), 3), (Some("lake"), 2)]);
    let known = |drive: &LocatedDrive| {
        let places = drive.places.iter().enumerate().filter(|(_, place)| place.is_some());
        (drive.track.file().name.clone(), places.map(|(i, _)| i).collect::<Vec<_>>(), drive.places.len())
    };
    let drives: Vec<_> = joined.drives().iter().map(known).collect();
    let expected: [(String, Vec<usize>, usize); 2] =
        [("lake".into(), (6..11).collect(), 11), ("jungle".into(), (0..4).collect(), 11)];
    assert_eq!(drives, expected);
    assert_eq!(joined.drive().as_ref().map(known).as_ref(), drives.first());
    assert!(recording(&[(None, 3)]).drives().is_empty());
}

#[test]
fn a_place_that_is_far_off_is_told_as_far_off() {
    let mut found = recording(&[(Some("lake"), 5)]);
    let on = found.parts[0].on.as_ref().unwrap();
    for (row, s_m) in found.rows.iter_mut().zip(500..) {
        row.truth = Some(RowTruth::of_pose(Pose { s_m: f64::from(s_m), ..Pose::default() }, &on.drive.track));
    }
    let told = summary::against_truth(on, &found.rows).unwrap().place_m.unwrap();
    let at_m = on.drive.places[0].unwrap().pose.s_m;
    assert!((told.median - (502.0 - at_m)).abs() < 1.0, "{told:?}, {at_m}");
}

#[test]
fn a_road_on_which_the_car_would_have_gone_too_far_or_that_too_few_pictures_show_is_not_believed() {
    let mut found = recording(&[(Some("lake"), 200)]);
    let mut on = found.parts.remove(0).on.unwrap();
    let mut gone = |metres_a_row: f64| {
        for (i, (row, place)) in found.rows.iter_mut().zip(&mut on.drive.places).enumerate() {
            (row.at_s, row.motion.way_m, row.steered_rad) = (0.1 * i as f64, 0.5, 0.01);
            let s_m = 20.0 + metres_a_row * i as f64;
            *place = Some(Located::known(Pose::from_lane(&on.drive.track, s_m, false, 0.0, 0.0)));
        }
        [Told::Bends, Told::Pictures].map(|told| implausible(&on, told, &found.rows, 0))
    };
    assert_eq!(gone(0.5), [None, None]);
    let [sure, chosen] = gone(1.0).map(Option::unwrap);
    assert!(sure.starts_with("its bends fit lake, but there the car would have gone 2.0"), "{sure}");
    assert!(chosen.contains("most like lake, but there the car would have gone 2.0"), "{chosen}");
    gone(0.5);
    on.drive.places[..80].fill(None);
    assert_eq!(implausible(&on, Told::Bends, &found.rows, 0), None, "its bends tell the road");
    let few = implausible(&on, Told::Pictures, &found.rows, 0).unwrap();
    assert!(few.contains("most like lake, but only 60.0 % of them show it: "), "{few}");
}

#[test]
fn a_road_that_is_unknown_is_told_with_the_reason_and_with_what_helps() {
    let road = Arc::new(Road::new("bends".into(), 0.0, 100.0, None, vec![0.0, 1.0]));
    let tried = vec![Tried { road: road.clone(), fit: -3.1, behind: 0.0, explains: false }];
    let none = Found { tried, ..Found::default() };
    let told = unknown(&none, 900.0, false, false).unwrap();
    assert!(told.starts_with("the nearest, bends, explains it by -3.1 each 10 m; "), "{told}");
    assert!(told.ends_with(": if it was on another road, name that with --track FILE.toml"), "{told}");
    let short = unknown(&none, 368.0, false, false).unwrap();
    assert!(short.ends_with("--track FILE.toml; if not, a longer recording may tell"), "{short}");
    let on = |road: Arc<Road>| Match {
        road,
        evidence: -9.0,
        explains: true,
        place: Whereabouts { s_m: 9.0, deviation_m: 1.0, progress_m: 9.0 },
        sure_m: 0.0,
        trail: vec![],
        tried_m: 90.0,
    };
    let several = Found { likely: vec![on(road.clone()), on(Arc::new(road.reversed()))], ..Found::default() };
    let told = unknown(&several, 900.0, false, false).unwrap();
    assert!(unknown(&several, 900.0, true, false).unwrap().ends_with(UNREAD));
    let vague = unknown(&several, 9.0, false, true).unwrap();
    assert!(
        vague.ends_with("in too many places to look for it in its pictures: a longer recording may tell"),
        "{vague}"
    );
    assert!(
        told.starts_with("bends, or bends, the other way round: both explain it about as well, and its pic"),
        "{told}"
    );
    assert_eq!(unknown(&Found { likely: vec![on(road)], ..Found::default() }, 900.0, false, false), None);
}

#[test]
fn pictures_choose_a_road_only_if_they_agree_clearly_better_with_it_and_all_likelier_ones_were_seen() {
    assert_eq!(best(&[Some(0.34), Some(0.39)]), Some(1));
    assert_eq!(best(&[Some(0.38), None, Some(0.33)]), Some(0), "what is less likely need not be seen");
    assert_eq!(best(&[Some(0.506), Some(0.531)]), None);
    assert_eq!(best(&[None, Some(0.53)]), None);
    assert_eq!((best(&[None, None]), best(&[])), (None, None));
}

#[test]
fn a_drive_of_which_no_picture_is_located_has_a_reason_and_no_uncertainty() {
    let road = Road::new("lake".into(), 0.0, 100.0, None, vec![0.0, 1.0]);
    let (short, long) = (nowhere(&road, 151.0, false, false), nowhere(&road, 900.0, false, false));
    assert!(short.ends_with("do not show where: a longer recording may tell"), "{short}");
    assert!(long.ends_with("there: if it was on another road, name that with --track FILE.toml"), "{long}");
    let mut found = recording(&[(Some("lake"), 3)]);
    found.parts[0].on.as_mut().unwrap().drive.places.fill(None);
    found.parts[0].unknown = Some(short.clone());
    assert_eq!((found.drives().len(), found.unknown()), (0, vec![short.as_str()]));
    let summary = Summary::new("lake".into(), &found, None);
    let drive = serde_json::to_value(&summary.drives[0]).unwrap();
    assert_eq!((&drive["track"], &drive["unknown"]), (&"lake".into(), &short.as_str().into()), "{drive}");
    assert!(drive.get("unsure").is_some_and(serde_json::Value::is_null), "{drive}");
    let told = summary.to_string();
    assert!(told.contains(&short) && !told.contains("uncertainty"), "{told}");
    let located = Summary::new("lake".into(), &recording(&[(Some("lake"), 3)]), None).to_string();
    assert!(located.contains("uncertainty"), "{located}");
}

#[test]
fn of_joined_drives_those_are_named_that_a_keyboard_steered_whose_release_is_at_once() {
    let mut found = recording(&[(Some("lake"), 3), (None, 2)]);
    found.rows.iter_mut().enumerate().for_each(|(i, row)| row.moment = i);
    found.released_at_once = vec![3..5, 9..12];
    let summary = Summary::new("joined".into(), &found, None);
    let each: Vec<bool> = summary.drives.iter().map(|drive| drive.released_at_once).collect();
    assert_eq!((summary.released_at_once, each), (true, vec![false, true]));
    assert!(summary.to_string().contains("\nsteered by keyboard, moments 3 to 4: when a key is released"), "{summary}");
}

/// A table that puts moment 0 on a road, 0.75 m right of the lane's middle.
fn told_of_one(road: &str) -> LaneTable {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("lane.csv");
    let track = Track::open(road).unwrap();
    let pose = Pose::from_lane(&track, 9.0, false, 0.75, 0.0);
    std::fs::write(&path, table::heading() + &table::line(0, 0.1, &track, Some(pose))).unwrap();
    LaneTable::read(&path, Track::open).unwrap()
}

#[test]
fn a_truth_on_another_road_than_the_one_found_is_left_out_and_counted() {
    let told = |road: &str, found: &str| {
        let mut found = recording(&[(Some(found), 1)]);
        let elsewhere = found.tell(&told_of_one(road));
        (elsewhere, found.rows[0].truth.is_some())
    };
    assert_eq!(told("lake", "lake"), (0, true));
    assert_eq!(told("jungle", "lake"), (1, false));
}

#[test]
fn a_table_is_the_truth_even_where_the_recording_itself_tells_its_place() {
    let told = |road: &str| {
        let mut found = recording(&[(Some("lake"), 2)]);
        for (i, row) in found.rows.iter_mut().enumerate() {
            row.moment = i;
            row.truth = Some(RowTruth { offset_m: 0.25, heading_deg: None, position: None });
        }
        let elsewhere = found.tell(&told_of_one(road));
        let offsets_m: Vec<_> = found.rows.iter().map(|row| row.truth.map(|truth| truth.offset_m)).collect();
        (elsewhere, offsets_m)
    };
    let (elsewhere, offsets_m) = told("lake");
    assert!((offsets_m[0].unwrap() - 0.75).abs() < 1e-3, "{offsets_m:?}");
    assert_eq!((elsewhere, offsets_m[1]), (0, Some(0.25)), "the table does not tell of the second");
    assert_eq!(told("jungle"), (1, vec![None, Some(0.25)]));
}
