use super::*;
use lapwing_core::motion::Motion;
use lapwing_score::odometry::{Found, Match, Road, Tried, Whereabouts};

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
    LocatedRecording { parts, rows, released_at_once: false, network: None, laps: None, unreadable: (0, None) }
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
fn a_road_that_is_unknown_is_told_with_the_reason_and_with_what_helps() {
    let road = Arc::new(Road::new("bends".into(), 0.0, 100.0, None, vec![0.0, 1.0]));
    let tried = vec![Tried { road: road.clone(), fit: -3.1, behind: 0.0, explains: false }];
    let none = Found { tried, ..Found::default() };
    let told = unknown(&none).unwrap();
    assert!(told.starts_with("the nearest, bends, explains it by -3.1 each 10 m; "), "{told}");
    assert!(told.ends_with(": if it was on another road, name that with --track FILE.toml"), "{told}");
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
    let told = unknown(&several).unwrap();
    assert!(told.starts_with("bends and bends, the other way round explain it about as well, and its pic"), "{told}");
    assert_eq!(unknown(&Found { likely: vec![on(road)], ..Found::default() }), None);
}
