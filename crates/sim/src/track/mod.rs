//! Roads: their course, their general look, and where on them a point is.
//!
//! A [`TrackFile`] is what a person writes: the closed spline through the
//! road's middle, its width, what stands along it. A [`Track`] is that file
//! laid out in [`Station`]s half a metre apart. Axes are Unity's: x right, y
//! up, z forward, in metres; yaw clockwise from +z, in radians. A distance `s`
//! along the road counts from the first control point in driving order and
//! wraps around; an offset is positive to the right of the middle.

mod driving;
mod file;
mod line;
mod random;

use std::fs;

use glam::DVec3;
use lapwing_core::{motion::turn, recording::Roadway, words};

pub use driving::LinePoint;
pub use file::{Edge, Landmark, LandmarkKind, Side, Start, Stretch, Theme, TrackError, TrackFile};
pub use random::RandomTrack;

/// Distance between stations, at most: they divide the length evenly.
pub const STATION_STEP_M: f64 = 0.5;

/// Metres between points of a road that is drawn.
const DRAWN_M: f64 = 3.0;
/// A start this far above or below the road is not meant to be on it, in metres.
const START_M: f64 = 5.0;

/// One place on the road's middle line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Station {
    /// Distance along the road, in metres.
    pub s: f64,
    /// The road's middle, at road level.
    pub position: DVec3,
    /// Direction of travel, radians clockwise from +z.
    pub yaw: f64,
    /// 1/m, positive where the road turns right.
    pub curvature: f64,
    /// Metres climbed per metre travelled.
    pub grade: f64,
}

impl Station {
    /// The unit vector of travel in the horizontal plane.
    pub fn ahead(&self) -> DVec3 {
        DVec3::new(self.yaw.sin(), 0.0, self.yaw.cos())
    }

    /// The unit vector to the right of travel.
    pub fn right(&self) -> DVec3 {
        DVec3::new(self.yaw.cos(), 0.0, -self.yaw.sin())
    }
}

/// Where a point is relative to the road.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// The station beside the point, interpolated.
    pub station: Station,
    /// Metres from the road's middle, positive to the right.
    pub offset: f64,
}

/// A closed road.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    file: TrackFile,
    stations: Vec<Station>,
    length: f64,
    driving_line: Vec<LinePoint>,
    driving_line_length: f64,
}

impl Track {
    /// Names of the tracks that come with Lapwing.
    pub const NAMES: [&str; 3] = ["lake", "jungle", "mountain"];

    /// A track that comes with Lapwing.
    ///
    /// # Errors
    /// [`TrackError::Unknown`] for a name that is not one of [`Track::NAMES`].
    pub fn named(name: &str) -> Result<Self, TrackError> {
        let text = match name {
            "lake" => include_str!("lake.toml"),
            "jungle" => include_str!("jungle.toml"),
            "mountain" => include_str!("mountain.toml"),
            _ => return Err(TrackError::Unknown { got: name.to_owned() }),
        };
        Self::new(TrackFile::parse(text)?)
    }

    /// A track by name: one of [`Track::NAMES`], `random:SEED` for a [`RandomTrack`], `random-lanes:SEED` for one of
    /// [`RandomTrack::lanes`] (without `:SEED`, seed 0), or the path of a track's file, which ends in `.toml`.
    ///
    /// # Errors
    /// [`TrackError`], naming the file if there is one.
    pub fn open(name: &str) -> Result<Self, TrackError> {
        let unknown = || TrackError::Unknown { got: name.to_owned() };
        let seed_of = |kind: &str| match name.strip_prefix(kind)? {
            "" => Some("0"),
            rest => rest.strip_prefix(':'),
        };
        if let Some(seed) = seed_of("random") {
            let seed = seed.parse().map_err(|_| unknown())?;
            return Self::new(RandomTrack { seed, ..RandomTrack::default() }.build()?);
        }
        if let Some(seed) = seed_of("random-lanes") {
            let seed = seed.parse().map_err(|_| unknown())?;
            return Self::new(RandomTrack::lanes(seed).build()?);
        }
        if !name.ends_with(".toml") {
            return Self::named(name);
        }
        let text = fs::read_to_string(name).map_err(|source| TrackError::Read { path: name.into(), source })?;
        TrackFile::parse(&text)
            .and_then(|file| file.check_name().map(|()| file))
            .and_then(Self::new)
            .and_then(Self::starting_on_it)
            .map_err(|source| TrackError::File { path: name.into(), source: Box::new(source) })
    }

    /// The same, if its cars start on the road and face along it.
    fn starting_on_it(self) -> Result<Self, TrackError> {
        let Start { x, y, z, yaw_deg } = self.file.start;
        let Place { station, offset } = self.locate(DVec3::new(x, y, z), None);
        let ahead = station.ahead();
        let faces = ahead.x * yaw_deg.to_radians().sin() + ahead.z * yaw_deg.to_radians().cos();
        if offset.abs() <= self.half_width() && (y - station.position.y).abs() <= START_M && faces > 0.0 {
            return Ok(self);
        }
        let here = station.position;
        let along_deg = ahead.x.atan2(ahead.z).to_degrees();
        Err(TrackError::Value {
            name: self.file.name.clone(),
            what: "start".into(),
            expected: "a place on the road, and a direction along it",
            got: format!(
                "{:?}, where the nearest middle of the road is at x = {:.2}, y = {:.2}, z = {:.2}, yaw_deg = {along_deg:.1}",
                self.file.start, here.x, here.y, here.z
            ),
        })
    }

    /// The track that is called so: one that [`Track::open`] knows by this name, or `own`, the path of a track's file, if that is its
    /// name.
    ///
    /// # Errors
    /// Those of [`Track::open`].
    pub fn called(name: &str, own: Option<&str>) -> Result<Self, TrackError> {
        let Some(path) = own else { return Self::open(name) };
        let track = Self::open(path)?;
        if track.file().name == name {
            return Ok(track);
        }
        let (path, expected, got) = (path.into(), name.to_owned(), track.file().name.clone());
        Self::open(name).map_err(|_| TrackError::Called { path, expected, got })
    }

    /// Lays a road out.
    ///
    /// # Errors
    /// [`TrackError`] if the file does not describe a road that can be driven.
    pub fn new(file: TrackFile) -> Result<Self, TrackError> {
        file.check()?;
        let (stations, length) = line::lay_out(&file.control_points, STATION_STEP_M);
        let (driving_line, driving_line_length) = driving::smooth(&stations, file.driving_line_m, file.width_m);
        Ok(Self { file, stations, length, driving_line, driving_line_length })
    }

    /// The same road the other way round, with what stands at its edges and a start that faces the other way. A lane on the
    /// right stays one. What grows farther off is not the same.
    ///
    /// # Errors
    /// None that the track itself did not have.
    pub fn reversed(&self) -> Result<Self, TrackError> {
        let mut file = self.file.clone();
        let given = file.start;
        let Place { station, offset } = self.locate(DVec3::new(given.x, given.y, given.z), None);
        let DVec3 { x, y, z } = self.point(station.s, -offset);
        file.start = Start { x, y: y + given.y - station.position.y, z, yaw_deg: given.yaw_deg + 180.0 };
        file.name = words::road(&file.name, true);
        file.control_points[1..].reverse(); // the first stays where s is 0
        for stretch in &mut file.stretches {
            let Stretch { from_m, to_m, side, .. } = *stretch;
            (stretch.from_m, stretch.to_m) = ((self.length - to_m).max(0.0), (self.length - from_m).max(0.0));
            stretch.side = side.other();
        }
        Self::new(file)
    }

    /// The same road, with its start on the line to drive, `s` metres along the road.
    pub fn starting_at(mut self, s: f64) -> Self {
        let (station, DVec3 { x, y, z }) = (self.at(s), self.point(s, self.file.driving_line_m));
        self.file.start = Start { x, y, z, yaw_deg: station.yaw.to_degrees() };
        self
    }

    /// The file that it was laid out from.
    pub fn file(&self) -> &TrackFile {
        &self.file
    }

    /// Length of a lap, in metres along the ground plane.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Half the road's width, in metres: where its edge is.
    pub fn half_width(&self) -> f64 {
        self.file.width_m / 2.0
    }

    /// All stations, evenly spaced from `s` = 0 around to just before it.
    pub fn stations(&self) -> &[Station] {
        &self.stations
    }

    /// The line to drive, smoothed: a point beside each station.
    pub fn driving_line(&self) -> &[LinePoint] {
        &self.driving_line
    }

    /// Length of a lap on the line to drive, in metres along the ground plane.
    pub fn driving_line_length(&self) -> f64 {
        self.driving_line_length
    }

    /// The line to drive at a distance along it, which wraps.
    pub fn on_driving_line(&self, travelled: f64) -> LinePoint {
        let (line, length) = (&self.driving_line, self.driving_line_length);
        let travelled = travelled.rem_euclid(length);
        let after = line.partition_point(|point| point.travelled <= travelled);
        let a = line[after.saturating_sub(1)];
        // The way from the last point to the first is part of the road, too.
        let (b, until) = line.get(after).map_or((line[0], length), |point| (*point, point.travelled));
        let t = (travelled - a.travelled) / (until - a.travelled).max(1e-9);
        LinePoint {
            travelled,
            position: a.position.lerp(b.position, t),
            offset: a.offset + t * (b.offset - a.offset),
            yaw: a.yaw + t * turn(b.yaw - a.yaw),
            curvature: a.curvature + t * (b.curvature - a.curvature),
        }
    }

    /// The road at distance `s`, which wraps.
    pub fn at(&self, s: f64) -> Station {
        let n = self.stations.len();
        let s = s.rem_euclid(self.length);
        let step = self.length / n as f64;
        let i = ((s / step) as usize).min(n - 1);
        let (a, b) = (self.stations[i], self.stations[(i + 1) % n]);
        let t = s / step - i as f64;
        Station {
            s,
            position: a.position.lerp(b.position, t),
            yaw: a.yaw + t * turn(b.yaw - a.yaw),
            curvature: a.curvature + t * (b.curvature - a.curvature),
            grade: a.grade + t * (b.grade - a.grade),
        }
    }

    /// Where a point is on the road. `near` is the `s` of a moment ago, if known: then only the road within 25 m of it
    /// is searched, which keeps a car on its level where the road crosses itself. Without it the whole road is
    /// searched, with height counting as distance.
    pub fn locate(&self, point: DVec3, near: Option<f64>) -> Place {
        let n = self.stations.len();
        let step = self.length / n as f64;
        let flat = |i: usize| {
            let d = self.stations[i].position - point;
            d.x * d.x + d.z * d.z
        };
        let nearest = match near {
            Some(s) => {
                // Descend from where it was: a few steps are enough, as a car moves less than a metre at a time.
                let mut i = ((s.rem_euclid(self.length) / step) as usize).min(n - 1);
                let mut best = flat(i);
                for _ in 0..(25.0 / step) as usize {
                    let (back, on) = ((i + n - 1) % n, (i + 1) % n);
                    let (b, o) = (flat(back), flat(on));
                    if b.min(o) >= best {
                        break;
                    }
                    (i, best) = if b < o { (back, b) } else { (on, o) };
                }
                i
            }
            None => (0..n)
                .min_by(|&a, &b| {
                    let far = |i: usize| self.stations[i].position.distance_squared(point);
                    far(a).total_cmp(&far(b))
                })
                .unwrap_or(0),
        };
        // The foot of the perpendicular, between the stations.
        let here = self.stations[nearest];
        let along = (point - here.position).dot(here.ahead());
        let lateral = (point - here.position).dot(here.right());
        let bend = (1.0 - here.curvature * lateral).max(0.2); // nearer the centre of a bend, a metre of road is less
        let station = self.at(here.s + (along / bend).clamp(-step, step));
        Place { station, offset: (point - station.position).dot(station.right()) }
    }

    /// The point beside `s` at an offset, at road level.
    pub fn point(&self, s: f64, offset: f64) -> DVec3 {
        let station = self.at(s);
        station.position + station.right() * offset
    }

    /// The road for drawing: its edges and the line to drive, with a point every few metres.
    pub fn roadway(&self) -> Roadway {
        let steps = |length_m: f64| (length_m / DRAWN_M).ceil().max(1.0);
        let edge = |offset: f64| {
            let count = steps(self.length);
            (0..count as u32).map(|i| self.point(f64::from(i) * self.length / count, offset).to_array()).collect()
        };
        let (length_m, count) = (self.driving_line_length, steps(self.driving_line_length));
        let line = |i: u32| self.on_driving_line(length_m * f64::from(i) / count).position.to_array();
        Roadway {
            name: self.file.name.clone(),
            left: edge(-self.half_width()),
            right: edge(self.half_width()),
            line: (0..count as u32).map(line).collect(),
        }
    }

    /// Distance from `from` to `to` in driving direction, in metres, from 0 to less than a lap.
    pub fn ahead(&self, from: f64, to: f64) -> f64 {
        (to - from).rem_euclid(self.length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_ones_own_whose_cars_cannot_set_off_along_the_road_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mine.toml").to_str().unwrap().to_owned();
        let lake = Track::named("lake").unwrap();
        type Change<'a> = &'a dyn Fn(&mut TrackFile);
        let refused = |change: Change<'_>| {
            let mut file = TrackFile { name: "mine".into(), ..lake.file().clone() };
            change(&mut file);
            fs::write(&path, toml::to_string(&file).unwrap()).unwrap();
            Track::open(&path).err().map(|error| error.to_string())
        };
        assert_eq!(refused(&|_| ()), None);
        let wrong: [(Change<'_>, &str); 8] = [
            (&|file| file.start.x += 500.0, "start: expected a place on the road"),
            (&|file| file.start.y -= 500.0, "start: expected a place on the road"),
            (&|file| file.start.yaw_deg += 180.0, "and a direction along it"),
            (&|file| file.stretches[0].from_m = f64::NAN, "stretch 0: expected metres along the road"),
            (&|file| file.landmarks[0].x = f64::INFINITY, "landmark 0: expected finite metres"),
            (&|file| file.name = String::new(), "name: expected a word"),
            (&|file| file.name = "a\nb".into(), "name: expected a word"),
            (
                &|file| file.control_points = (0..400).map(|i| [f64::from(i) * 100.0, 0.0, f64::from(i % 2)]).collect(),
                "control point 399",
            ),
        ];
        for (change, expected) in wrong {
            let error = refused(change).unwrap();
            assert!(error.contains(expected) && error.starts_with(&path), "{expected}: {error}");
        }
        let round = |radius: f64| {
            (0..400)
                .map(move |i| f64::from(i) * std::f64::consts::TAU / 400.0)
                .map(move |a| [radius * a.cos(), 0.0, radius * a.sin()])
        };
        let long = refused(&|file| file.control_points = round(4000.0).collect()).unwrap();
        assert!(long.contains("expected a road of at most 20,000 m, got 25132 m"), "{long}");
    }

    #[test]
    fn the_driving_line_goes_around_without_a_leap() {
        let track = Track::named("jungle").unwrap();
        let (length, step) = (track.driving_line_length(), 0.4);
        for i in 0..(length / step) as u32 + 4 {
            let travelled = step * f64::from(i);
            let (here, next) = (track.on_driving_line(travelled), track.on_driving_line(travelled + step));
            let moved = (next.position - here.position).with_y(0.0).length();
            assert!((0.9 * step..=1.001 * step).contains(&moved), "{travelled}: {moved}");
            assert!(turn(next.yaw - here.yaw).abs() < 0.1, "{travelled}");
            let middle = track.locate(here.position, None);
            assert!((middle.offset - here.offset).abs() < 0.05, "{travelled}: {middle:?}, {here:?}");
        }
    }

    #[test]
    fn the_other_way_round_a_road_is_the_same_with_its_sides_changed() {
        for name in Track::NAMES {
            let track = Track::named(name).unwrap();
            let other = track.reversed().unwrap();
            assert_eq!(other.file().name, format!("{name}, the other way round"));
            assert!((track.length() - other.length()).abs() < 1e-6);
            for s in (0..60).map(|i| track.length() * f64::from(i) / 60.0) {
                let (there, back) = (track.at(s), other.at(other.length() - s));
                assert!(there.position.distance(back.position) < 0.01, "{name} {s}: {there:?}, {back:?}");
                assert!((turn(there.yaw - back.yaw).abs() - std::f64::consts::PI).abs() < 0.01, "{name} {s}");
                for edge in [Edge::Kerb, Edge::Dirt, Edge::Bridge, Edge::Blocks, Edge::Rock, Edge::Water, Edge::Posts] {
                    let near_end = |at: f64| track.file().has(edge, Side::Left, at);
                    if near_end(s - 0.1) == near_end(s + 0.1) {
                        let back = other.file().has(edge, Side::Right, (other.length() - s) % other.length());
                        assert_eq!(near_end(s), back, "{name} {s}: {edge}");
                    }
                }
            }
            let start = other.file().start;
            let place = other.locate(DVec3::new(start.x, start.y, start.z), None);
            let given = track.file().start;
            let was = track.locate(DVec3::new(given.x, given.y, given.z), None);
            assert!((place.offset - was.offset).abs() < 0.01, "{name}: {place:?}, {was:?}");
            assert!(turn(start.yaw_deg.to_radians() - place.station.yaw).abs() < 0.3, "{name}");
        }
    }

    #[test]
    fn the_tracks_are_as_long_as_the_simulators() {
        for (name, length) in [("lake", 1137.5), ("jungle", 1484.7)] {
            let track = Track::named(name).unwrap();
            assert!((track.length() - length).abs() < 6.0, "{name} is {} m long, expected {length}", track.length());
        }
    }

    #[test]
    fn a_track_is_opened_by_name_by_seed_or_by_file() {
        assert_eq!(Track::open("lake").unwrap(), Track::named("lake").unwrap());
        assert_eq!(Track::open("random:3").unwrap().file().name, "random:3");
        assert_eq!(Track::open("random").unwrap(), Track::open("random:0").unwrap());
        assert_eq!(Track::open("random-lanes:3").unwrap().file().name, "random-lanes:3");
        assert_eq!(Track::open("random-lanes").unwrap(), Track::open("random-lanes:0").unwrap());
        let dir = tempfile::tempdir().unwrap();
        let file = |called: &str| {
            let path = dir.path().join(format!("{}.toml", called.replace(':', "-")));
            let text = include_str!("jungle.toml").replace("name = \"jungle\"", &format!("name = {called:?}"));
            fs::write(&path, text).unwrap();
            path.to_str().unwrap().to_owned()
        };
        let own = file("mine");
        assert_eq!(Track::open(&own).unwrap().stations(), Track::named("jungle").unwrap().stations());
        assert_eq!(Track::called("mine", Some(&own)).unwrap(), Track::open(&own).unwrap());
        assert_eq!(Track::called("lake", Some(&own)).unwrap(), Track::named("lake").unwrap());
        let error = Track::called("theirs", Some(&own)).unwrap_err().to_string();
        assert_eq!(error, format!("{own}: expected the road \"theirs\", got \"mine\": name the file of that road"));
        // Recordings tell the road by its name alone.
        for taken in ["jungle", "random:3", "random-lanes"] {
            let error = Track::open(&file(taken)).unwrap_err().to_string();
            assert!(error.contains("name: expected one other than lake") && error.contains(taken), "{error}");
        }
        for name in ["moon", "random:", "random:-1", "random:x", "random-", "random-lanes:", "random-lanes:x"] {
            let error = Track::open(name).unwrap_err().to_string();
            assert!(error.ends_with(&format!("or a file ending in .toml, got {name:?}")), "{error}");
        }
        let error = Track::open("nowhere/my.toml").unwrap_err().to_string();
        assert!(error.starts_with("nowhere/my.toml cannot be read: "), "{error}");
        let error = Track::open(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml")).unwrap_err().to_string();
        assert!(error.contains("/Cargo.toml: track file: TOML parse error at line "), "{error}");
    }

    #[test]
    fn a_point_beside_the_road_is_found_again() {
        for name in Track::NAMES {
            let track = Track::named(name).unwrap();
            for i in 0..500 {
                let (s, offset) = (track.length() * f64::from(i) / 500.0, f64::from(i % 7) - 3.0);
                for near in [None, Some(s - 3.0), Some(s + 3.0)] {
                    let place = track.locate(track.point(s, offset), near);
                    let along = track.ahead(s, place.station.s);
                    let along = along.min(track.length() - along);
                    assert!(along < 0.3, "{name} {s:.0} {offset} {near:?}: {along:.3} m off along the road");
                    assert!((place.offset - offset).abs() < 0.05, "{name} {s:.0} {offset}: {}", place.offset);
                }
            }
        }
    }

    #[test]
    fn no_bend_is_tighter_than_the_car_can_turn() {
        for name in Track::NAMES {
            let tightest = Track::named(name).unwrap().stations().iter().map(|s| s.curvature.abs()).fold(0.0, f64::max);
            assert!(tightest < 1.0 / 8.0, "{name}: radius {:.1} m", 1.0 / tightest);
        }
    }
}
