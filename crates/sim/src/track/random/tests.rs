use super::*;
use crate::{
    track::{Edge, Side},
    vehicle::BODY,
};

fn road(random: &RandomTrack) -> Track {
    Track::new(random.build().unwrap_or_else(|e| panic!("{e}: {random:?}"))).unwrap()
}

/// Every pair of places on the road that is too near on the plan, neighbours excepted, with the height between them.
/// Written without any of the generator's own code.
fn too_near(track: &Track, apart: f64, neighbours: f64) -> Vec<(f64, f64, f64)> {
    let stations: Vec<_> = track.stations().iter().step_by(4).collect();
    let mut found = vec![];
    for (i, a) in stations.iter().enumerate() {
        for b in &stations[i + 1..] {
            let along = track.ahead(a.s, b.s).min(track.ahead(b.s, a.s));
            let (x, z) = (a.position.x - b.position.x, a.position.z - b.position.z);
            if along > neighbours && x.hypot(z) < apart {
                found.push((a.s, b.s, (a.position.y - b.position.y).abs()));
            }
        }
    }
    found
}

#[test]
fn two_hundred_seeds_keep_their_promises() {
    let (mut tight, mut straight, mut turns) = (0, 0.0, 0);
    for seed in 0..200 {
        let random = RandomTrack { seed, ..RandomTrack::default() };
        let track = road(&random);
        let stations = track.stations();
        assert!((950.0..1050.0).contains(&track.length()), "{seed}: {} m", track.length());
        let tightest = stations.iter().map(|s| s.curvature.abs()).fold(0.0, f64::max);
        assert!(tightest <= 1.0 / 25.0, "{seed}: radius {:.2} m", 1.0 / tightest);
        let near = too_near(&track, 21.0, 42.0);
        assert!(near.is_empty(), "{seed}: {near:?}");
        let steepest = stations.iter().map(|s| s.grade.abs()).fold(0.0, f64::max);
        assert!(steepest <= 0.12, "{seed}: {steepest}");
        let heights = stations.iter().map(|s| s.position.y);
        let peak = heights.clone().fold(f64::MIN, f64::max) - heights.fold(f64::MAX, f64::min);
        assert!((6.0..8.1).contains(&peak), "{seed}: hills of {peak:.1} m");

        tight += usize::from(tightest > 1.0 / 30.0);
        straight += stations.iter().filter(|s| s.curvature.abs() < 1.0 / 150.0).count() as f64 / stations.len() as f64;
        let clear: Vec<bool> =
            stations.iter().filter(|s| s.curvature.abs() > 1.0 / 100.0).map(|s| s.curvature > 0.0).collect();
        turns += clear.windows(2).filter(|w| w[0] != w[1]).count();
    }
    assert!(tight > 150, "{tight} of 200 have a bend near the smallest radius");
    assert!(straight / 200.0 > 0.2, "{straight} of 200 roads straight");
    assert!(turns / 200 >= 3, "{turns} changes from left to right in 200 roads");
}

#[test]
fn roads_that_cross_themselves_are_bridged() {
    let mut crossed = 0;
    for seed in 0..60 {
        let random = RandomTrack { seed, crossings: true, ..RandomTrack::default() };
        let track = road(&random);
        let near = too_near(&track, 21.0, 42.0);
        for (a, b, height) in &near {
            assert!(*height >= 6.0, "{seed}: {height:.1} m of height between {a:.0} m and {b:.0} m");
        }
        let steepest = track.stations().iter().map(|s| s.grade.abs()).fold(0.0, f64::max);
        assert!(steepest <= 0.12, "{seed}: {steepest}");
        if !near.is_empty() {
            crossed += 1;
            assert!(track.file().stretches.iter().any(|s| s.edge == Edge::Bridge), "{seed}");
        }
    }
    assert!(crossed > 15, "{crossed} of 60");
}

#[test]
fn other_wishes_are_kept_too() {
    for (length_m, min_radius_m, width_m, hills_m, max_grade) in [
        (300.0, 15.0, 6.0, 3.0, 0.1),
        (600.0, 60.0, 5.0, 0.0, 0.0),
        (2000.0, 12.0, 9.0, 40.0, 0.15),
        (5000.0, 40.0, 7.0, 100.0, 0.3),
        (1500.0, 30.0, 20.0, 10.0, 0.12),
    ] {
        for seed in 0..4 {
            let random =
                RandomTrack { seed, length_m, min_radius_m, width_m, hills_m, max_grade, ..Default::default() };
            let track = road(&random);
            assert!((track.length() / length_m - 1.0).abs() < 0.05, "{random:?}");
            for station in track.stations() {
                assert!(station.curvature.abs() <= 1.0 / min_radius_m, "{random:?} {station:?}");
                assert!(station.grade.abs() <= max_grade, "{random:?} {station:?}");
            }
            assert_eq!(too_near(&track, 3.0 * width_m, 6.0 * width_m), [], "{random:?}");
        }
    }
}

#[test]
fn roads_with_lanes_have_many_widths_and_about_half_of_them_a_lane_on_the_right() {
    let all: Vec<RandomTrack> = (0..100).map(RandomTrack::lanes).collect();
    let with_lane: Vec<&RandomTrack> = all.iter().filter(|random| random.driving_line_m > 0.0).collect();
    assert!((35..65).contains(&with_lane.len()), "{} of 100", with_lane.len());
    for random in &all {
        assert!((6.0..=11.0).contains(&random.width_m), "{random:?}");
    }
    for random in &with_lane {
        assert!(random.width_m >= 7.5 && random.driving_line_m == random.width_m / 4.0, "{random:?}");
    }
    let count = |is: fn(&RandomTrack) -> bool| all.iter().filter(|random| is(random)).count();
    assert!(count(|random| random.width_m < 7.0) > 3 && count(|random| random.width_m > 10.0) > 10);
}

#[test]
fn roads_with_lanes_have_crests_and_at_least_as_many_posts_as_the_jungle_and_are_driven_in_the_lane() {
    let posts = |track: &Track| {
        let has = |side| track.stations().iter().filter(|here| track.file().has(Edge::Posts, side, here.s)).count();
        (has(Side::Left) + has(Side::Right)) as f64 / track.stations().len() as f64
    };
    let (mut all, seeds) = (0.0, 0..8);
    for seed in seeds.clone() {
        let random = RandomTrack::lanes(seed);
        let track = road(&random);
        assert_eq!(track.file().name, format!("random-lanes:{seed}"));
        let falls = |s: f64| track.at(s - 10.0).grade - track.at(s + 10.0).grade;
        let crest = track.stations().iter().max_by(|a, b| falls(a.s).total_cmp(&falls(b.s))).unwrap();
        assert!(falls(crest.s) > 0.1, "{seed}: {}", falls(crest.s));
        assert!(
            [Side::Left, Side::Right].into_iter().any(|side| track.file().has(Edge::Posts, side, crest.s)),
            "{seed}: no posts on the crest at {:.0} m",
            crest.s
        );
        all += posts(&track);
        let line = track.driving_line().iter().map(|point| point.offset);
        let mean = line.clone().sum::<f64>() / track.stations().len() as f64;
        assert!((mean - random.driving_line_m).abs() < 0.2, "{seed}: {mean} of {random:?}");
        if random.driving_line_m > 0.0 {
            let (least, most) = line.fold((f64::MAX, f64::MIN), |(least, most), x| (least.min(x), most.max(x)));
            assert!(least > 0.5 && most < track.half_width() - BODY.x / 2.0, "{seed}: {least} to {most} of {random:?}");
        }
    }
    let jungle = posts(&Track::named("jungle").unwrap());
    assert!(all / seeds.clone().count() as f64 > jungle, "{all} in {seeds:?}, {jungle} in the jungle");
}

#[test]
fn a_seed_is_a_track_and_another_seed_another() {
    let build = |seed| RandomTrack { seed, ..RandomTrack::default() }.build().unwrap();
    assert_eq!(build(7), build(7));
    assert_ne!(build(7).control_points, build(8).control_points);
    let themes: Vec<_> = (0..20).map(|seed| build(seed).theme).collect();
    for theme in [Theme::Lake, Theme::Jungle, Theme::Mountain] {
        assert!(themes.contains(&theme), "{theme:?}");
    }
}

#[test]
fn a_built_track_survives_being_written_and_read() {
    let file = RandomTrack::default().build().unwrap();
    assert_eq!(TrackFile::parse(&toml::to_string(&file).unwrap()).unwrap(), file);
}

#[test]
fn what_is_no_wish_is_refused_with_its_range() {
    let refused = |random: RandomTrack| random.build().unwrap_err().to_string();
    let error = refused(RandomTrack { length_m: 100.0, ..RandomTrack::default() });
    assert_eq!(error, "track random:0: length_m: expected 300 to 5000, got 100");
    let error = refused(RandomTrack { driving_line_m: 4.0, ..RandomTrack::default() });
    assert_eq!(error, "track random:0: driving_line_m: expected 0 to half of the width, got 4");
    assert!(refused(RandomTrack { max_grade: f64::NAN, ..RandomTrack::default() }).contains("max_grade"));
    assert!(refused(RandomTrack { length_m: 300.0, min_radius_m: 50.0, ..RandomTrack::default() }).contains("tenth"));
}
