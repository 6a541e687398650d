//! Tracks as scoring needs them: known roads on which drives are located, and their outlines on a page.

use std::{
    cell::OnceCell,
    collections::{HashMap, HashSet},
    fs,
    path::PathBuf,
    sync::Arc,
};

use glam::DVec3;

use lapwing_core::recording::Roadway;
#[cfg(feature = "bridge")]
use lapwing_live::page::Course;
use lapwing_score::{
    odometry::{Look, Road},
    score::{Scorecard, page::Outline},
};
use lapwing_sim::{
    known::{KnownRoad, Line},
    track::{Start, Track, TrackError},
};

/// Roads that a run may be on if it does not say: the tracks that come with Lapwing, and others. They are made on first
/// use.
#[derive(Debug, Default)]
pub struct Roads {
    more: Vec<String>,
    known: OnceCell<Vec<[Arc<Road>; 2]>>,
}

impl Roads {
    /// The roads that come with Lapwing, and more, named as for [`Track::open`]. None is known twice: it would explain a drive as well
    /// as itself.
    pub fn with(more: &[String]) -> Self {
        let (mut others, mut seen): (Vec<String>, HashSet<PathBuf>) = Default::default();
        for name in more.iter().filter(|name| !Track::NAMES.contains(&name.as_str())) {
            let same = match name.as_str() {
                "random" => "random:0".into(),
                "random-lanes" => "random-lanes:0".into(),
                path => fs::canonicalize(path).unwrap_or_else(|_| path.into()),
            };
            if seen.insert(same) {
                others.push(name.clone());
            }
        }
        Self { more: others, ..Self::default() }
    }

    /// All of them.
    ///
    /// # Errors
    /// Those of [`Track::open`]; [`TrackError::SameName`].
    pub fn known(&self) -> Result<Vec<Arc<Road>>, TrackError> {
        Ok(self.ways()?.iter().map(|[road, _]| road.clone()).collect())
    }

    /// All of them, each in its own direction and the other way round.
    ///
    /// # Errors
    /// As [`Roads::known`].
    pub fn both_ways(&self) -> Result<Vec<Arc<Road>>, TrackError> {
        Ok(self.ways()?.concat())
    }

    fn ways(&self) -> Result<&[[Arc<Road>; 2]], TrackError> {
        if let Some(known) = self.known.get() {
            return Ok(known);
        }
        let known = self
            .names()
            .map(|name| Ok(known_road(Track::open(name)?)?.map(Arc::new)))
            .collect::<Result<Vec<_>, TrackError>>()?;
        let mut called = HashMap::new();
        for ([road, _], second) in known.iter().zip(self.names()) {
            if let Some(first) = called.insert(&road.name, second) {
                let (first, second) = (first.to_owned(), second.to_owned());
                return Err(TrackError::SameName { first, second, name: road.name.clone() });
            }
        }
        Ok(self.known.get_or_init(|| known))
    }

    /// The track of this name, if it is known.
    pub fn track(&self, name: &str) -> Option<Track> {
        let known = |track: &Track| track.file().name == name;
        Track::open(name).ok().or_else(|| self.names().filter_map(|name| Track::open(name).ok()).find(known))
    }

    fn names(&self) -> impl Iterator<Item = &str> {
        Track::NAMES.into_iter().chain(self.more.iter().map(String::as_str))
    }
}

/// A track's edges, as a page shows them.
pub fn outline(track: &Track) -> Outline {
    let Roadway { left, right, .. } = track.roadway();
    let Start { x, y, z, .. } = track.file().start;
    let start_s = track.locate(DVec3::new(x, y, z), None).station.s;
    let count = left.len();
    let start = (start_s / track.length() * count as f64).round() as usize % count;
    Outline { left: flat(left), right: flat(right), start }
}

/// The known roads as the bridge's page draws them.
///
/// # Errors
/// Those of [`Track::open`].
#[cfg(feature = "bridge")]
pub fn courses(roads: &Roads) -> Result<Vec<Course>, TrackError> {
    let ways = roads.ways()?.iter().cloned();
    ways.zip(roads.names()).map(|(ways, name)| Ok(course(&Track::open(name)?, ways))).collect()
}

/// The known roads as viewers draw them.
///
/// # Errors
/// Those of [`Track::open`].
#[cfg(feature = "bridge")]
pub fn roadways(roads: &Roads) -> Result<Arc<[Roadway]>, TrackError> {
    roads.names().map(|name| Ok(Track::open(name)?.roadway())).collect()
}

/// A track as the page draws it.
#[cfg(feature = "bridge")]
pub fn course(track: &Track, ways: [Arc<Road>; 2]) -> Course {
    let Roadway { name, line, .. } = track.roadway();
    Course { name, outline: outline(track), line: flat(line), ways }
}

/// Where a run without positions seems to have been: seconds, and places on the line to drive.
pub fn whereabouts(card: &Scorecard, track: &Track) -> Vec<(f64, [f32; 2])> {
    card.whereabouts.iter().map(|(at, s)| (*at, from_above(track.on_driving_line(*s).position))).collect()
}

fn flat(points: Vec<[f64; 3]>) -> Vec<[f32; 2]> {
    points.into_iter().map(|point| from_above(point.into())).collect()
}

fn from_above(point: DVec3) -> [f32; 2] {
    [point.x as f32, point.z as f32]
}

/// The road of a track, by its driving line, with the look of its start; and the same road the other
/// way round, by the line there, with what is seen at the start if the car is turned round.
///
/// # Errors
/// Those of [`Track::reversed`].
pub fn known_road(track: Track) -> Result<[Road; 2], TrackError> {
    let KnownRoad { name, line, back: (back, places), starts } = KnownRoad::of(track)?;
    let [there, away] = starts.each_ref().map(Look::of);
    let road = |Line { start_m, length_m, headings }, look| Road::new(name.clone(), start_m, length_m, look, headings);
    Ok([road(line, there), road(back, away).against(places)])
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use lapwing_core::{
        motion::{Motion, turn},
        perception::Frame,
    };
    use lapwing_score::odometry::Filter;
    use lapwing_sim::{
        camera::{Camera, Renderer, Scenery},
        conditions::Conditions,
        known::see_starts,
        world::{Setup, Simulation},
    };

    #[test]
    fn no_road_is_known_twice() {
        let more = ["lake", "random:3", "jungle", "random:3"].map(str::to_owned);
        assert_eq!(Roads::with(&more).names().collect::<Vec<_>>(), ["lake", "jungle", "mountain", "random:3"]);
        let more = ["random:0", "random"].map(str::to_owned);
        assert_eq!(Roads::with(&more).names().count(), 4);
    }

    #[test]
    fn two_roads_of_one_name_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let files = [1, 2].map(|seed| {
            let mut file = Track::open(&format!("random:{seed}")).unwrap().file().clone();
            file.name = "mine".into();
            let path = dir.path().join(format!("{seed}.toml"));
            fs::write(&path, toml::to_string(&file).unwrap()).unwrap();
            path.display().to_string()
        });
        let error = Roads::with(&files).known().unwrap_err().to_string();
        let [first, second] = &files;
        let expected =
            format!("--track {first}, --track {second}: expected roads of different names, got \"mine\" in both");
        assert!(error.starts_with(&expected), "{error}");
    }

    #[test]
    fn who_drives_a_tracks_line_is_followed_to_its_end() {
        for name in ["jungle", "lake"] {
            let track = Track::named(name).unwrap();
            let line = track.driving_line().to_vec();
            let [road, _] = known_road(Track::open(name).unwrap()).unwrap().map(Arc::new);
            let first = line.iter().position(|point| point.travelled >= road.start_m).unwrap();
            let mut filter = Filter::at_start(road.clone(), rand_chacha::ChaCha8Rng::seed_from_u64(3));
            let mut driven = 0.0;
            for i in first..first + line.len() / 2 {
                let (here, next) = (line[i % line.len()], line[(i + 1) % line.len()]);
                let way_m = (next.position - here.position).with_y(0.0).length();
                filter.step(Motion { way_m, turn_rad: turn(next.yaw - here.yaw) });
                driven += way_m;
            }
            let place = filter.found().place;
            assert!((place.progress_m - driven).abs() < 8.0, "{name}: {place:?}, driven {driven}");
        }
    }

    #[test]
    fn an_outline_begins_where_drives_start_and_runs_the_way_they_go() {
        for name in Track::NAMES {
            let track = Track::named(name).unwrap();
            let Outline { left, right, start } = outline(&track);
            let middle = |i: usize| {
                let i = i % left.len();
                [0, 1].map(|axis| f64::from(left[i][axis] + right[i][axis]) / 2.0)
            };
            let Start { x, z, yaw_deg, .. } = track.file().start;
            let ([from_x, from_z], [to_x, to_z]) = (middle(start), middle(start + 1));
            let apart = (to_x - from_x).hypot(to_z - from_z);
            assert!((from_x - x).hypot(from_z - z) < track.half_width() + apart, "{name}");
            let (sin, cos) = yaw_deg.to_radians().sin_cos();
            assert!((to_x - from_x) * sin + (to_z - from_z) * cos > 0.0, "{name}: the way that the car faces");
        }
    }

    #[test]
    fn the_starts_that_come_along_are_those_that_the_camera_sees() {
        for name in Track::NAMES {
            let track = Track::named(name).unwrap();
            let back = track.reversed().unwrap();
            for (road, frame) in
                known_road(Track::open(name).unwrap()).unwrap().into_iter().zip(see_starts(track, back))
            {
                let (agrees, words) = (road.start.as_ref().unwrap().agrees(&Look::of(&frame).unwrap()), road.words());
                assert!(
                    agrees > 0.95,
                    "{words}: {agrees:.3}; see STARTS of lapwing_sim::known for how to draw them anew"
                );
            }
        }
    }

    #[test]
    fn who_drives_the_other_way_round_goes_back_along_the_road_lap_by_lap() {
        for name in Track::NAMES {
            let [there, back] = known_road(Track::open(name).unwrap()).unwrap();
            let steps: Vec<f64> = (0..100).map(|i| back.length_m * f64::from(i) / 100.0).collect();
            let places: Vec<f64> = steps.iter().map(|s_m| back.on_track(*s_m)).collect();
            assert!(places.windows(2).all(|two| two[1] < two[0]), "{name}: {places:.0?}");
            for (s_m, place) in steps.iter().zip(&places) {
                let again = back.on_track(s_m + 3.0 * back.length_m);
                let apart = (again - place).rem_euclid(there.length_m);
                assert!(apart.min(there.length_m - apart) < 1.0, "{name}, {s_m} m: {again} and {place}");
                assert!((there.on_track(*s_m % there.length_m) - s_m % there.length_m).abs() < 1e-6, "{name}, {s_m} m");
            }
        }
    }

    #[test]
    fn in_any_weather_a_start_looks_most_like_itself() {
        let ways: Vec<Road> =
            Track::NAMES.iter().flat_map(|name| known_road(Track::open(name).unwrap()).unwrap()).collect();
        for (i, name) in Track::NAMES.iter().enumerate() {
            let track = Track::named(name).unwrap();
            let (scenery, back) = (Arc::new(Scenery::new(&track)), track.reversed().unwrap());
            for (way, track) in [track, back].into_iter().map(Arc::new).enumerate() {
                for seed in 0..6 {
                    let conditions = Conditions::random(seed);
                    let setup = Setup { conditions, ..Setup::new(track.clone(), scenery.clone()) };
                    let mut frame = Frame::default();
                    let world = Simulation::new(setup).unwrap();
                    world.draw(&mut Renderer::new(scenery.clone()), &Camera::CENTER, &mut frame);
                    let look = Look::of(&frame).unwrap();
                    let agrees: Vec<f64> = ways.iter().map(|road| road.start.as_ref().unwrap().agrees(&look)).collect();
                    let best = (0..ways.len()).max_by(|a, b| agrees[*a].total_cmp(&agrees[*b])).unwrap();
                    assert_eq!(best, 2 * i + way, "{}, seed {seed}: {agrees:.2?}", track.file().name);
                }
            }
        }
    }
}
