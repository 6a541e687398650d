//! Random tracks from a seed.
//!
//! [`shape`] draws the road's plan: a round trip through random points, relaxed until no bend is too sharp and no two
//! parts of it come too near. [`dress`] adds hills, bridges over itself, and what stands along it. The result is
//! measured on the road itself and thrown away if it breaks a promise; then the next draw tries again.

mod dress;
mod shape;

use glam::DVec2;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{Start, Station, Theme, Track, TrackError, TrackFile};

/// Parts of the road that are not neighbours stay this many of its widths apart, middle to middle.
pub const WIDTHS_APART: f64 = 3.0;
/// Height from road to road where it crosses itself, in metres, at least.
pub const CROSSING_HEIGHT_M: f64 = 6.0;
/// Draws before giving up; of 200 seeds at the defaults 189 need one, 10 two and one three.
const DRAWS: u32 = 80;

/// What is drawn for [`RandomTrack::lanes`], from a stream of its own: draws of roads have the low numbers.
const LANES_STREAM: u64 = 1 << 32;
/// Widths of these roads, and the least width of one with a lane on the right, in metres: in the middle of a narrower
/// lane our car would be too near to the edge for the line to drive.
const LANES_WIDTH_M: (f64, f64) = (6.0, 11.0);
const LEAST_WITH_LANE_M: f64 = 7.5;

/// What a random track should be like.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RandomTrack {
    /// The random seed.
    pub seed: u64,
    /// Length of a lap, in metres, 300 to 5000: kept within 5%.
    pub length_m: f64,
    /// No bend of the road's middle is tighter, in metres, 10 to 100.
    pub min_radius_m: f64,
    /// Width of the road, in metres, 5 to 20.
    pub width_m: f64,
    /// The line to drive: metres to the right of the middle, 0 to half of the width.
    pub driving_line_m: f64,
    /// From the lowest to the highest place, in metres, 0 to 100; less if [`RandomTrack::max_grade`] requires it.
    pub hills_m: f64,
    /// Most metres climbed per metre, 0 to 0.3.
    pub max_grade: f64,
    /// Its landscape; `None` leaves the choice to the seed.
    pub theme: Option<Theme>,
    /// Whether it may cross itself, on a bridge with at least 6 m from road to road.
    pub crossings: bool,
    /// Whether its hills are short, with posts on their crests, as in the jungle; its name is then `random-lanes:SEED`.
    pub crests: bool,
}

impl Default for RandomTrack {
    fn default() -> Self {
        Self {
            seed: 0,
            length_m: 1000.0,
            min_radius_m: 25.0,
            width_m: 7.0,
            driving_line_m: 0.0,
            hills_m: 8.0,
            max_grade: 0.12,
            theme: None,
            crossings: false,
            crests: false,
        }
    }
}

/// A place where the road crosses itself, as distances along it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Crossing {
    over: f64,
    under: f64,
}

impl RandomTrack {
    /// The track that is called `random-lanes:SEED`: a road like the jungle's, 6 to 11 m wide, with posts on its
    /// crests. About half of the seeds have two lanes, of which the right one is driven: its middle is a quarter of the
    /// road's width to the right.
    pub fn lanes(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(LANES_STREAM);
        let has_lane = rng.random_bool(0.5);
        let (least, most) = LANES_WIDTH_M;
        let least = if has_lane { LEAST_WITH_LANE_M } else { least };
        let width_m = (rng.random_range(least..most) * 10.0).round() / 10.0;
        Self {
            seed,
            width_m,
            driving_line_m: if has_lane { width_m / 4.0 } else { 0.0 },
            hills_m: 20.0,
            max_grade: 0.25,
            theme: Some(Theme::Jungle),
            crests: true,
            ..Self::default()
        }
    }

    /// The track of this seed.
    ///
    /// # Errors
    /// [`TrackError::Value`] for a number out of its range, or if no such road is found.
    pub fn build(&self) -> Result<TrackFile, TrackError> {
        self.check()?;
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let theme = rng.random_range(0..3);
        let theme = self.theme.unwrap_or([Theme::Lake, Theme::Jungle, Theme::Mountain][theme]);
        let scenery_seed = rng.random_range(0..1u64 << 53); // a number that JSON carries exactly
        for draw in 0..DRAWS {
            let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
            rng.set_stream(u64::from(draw) + 1);
            if let Some(file) = self.draw(&mut rng, 1.0 + f64::from(draw / 8) * 0.2, theme, scenery_seed)? {
                return Ok(file);
            }
        }
        Err(self.wrong("road", "a length in which such bends fit", format!("{DRAWS} draws that do not fit")))
    }

    fn name(&self) -> String {
        format!("{}:{}", if self.crests { "random-lanes" } else { "random" }, self.seed)
    }

    fn wrong(&self, what: &str, expected: &'static str, got: String) -> TrackError {
        TrackError::Value { name: self.name(), what: what.to_owned(), expected, got }
    }

    fn check(&self) -> Result<(), TrackError> {
        for (what, value, (min, max), expected) in [
            ("length_m", self.length_m, (300.0, 5000.0), "300 to 5000"),
            ("min_radius_m", self.min_radius_m, (10.0, 100.0), "10 to 100"),
            ("width_m", self.width_m, (5.0, 20.0), "5 to 20"),
            ("driving_line_m", self.driving_line_m, (0.0, self.width_m / 2.0), "0 to half of the width"),
            ("hills_m", self.hills_m, (0.0, 100.0), "0 to 100"),
            ("max_grade", self.max_grade, (0.0, 0.3), "0 to 0.3"),
        ] {
            if !(min..=max).contains(&value) {
                return Err(self.wrong(what, expected, value.to_string()));
            }
        }
        if self.min_radius_m > self.length_m / 10.0 {
            return Err(self.wrong("min_radius_m", "a tenth of the length at most", self.min_radius_m.to_string()));
        }
        if self.width_m > self.length_m / 40.0 {
            return Err(self.wrong("width_m", "a fortieth of the length at most", self.width_m.to_string()));
        }
        if self.min_radius_m < self.width_m {
            return Err(self.wrong("min_radius_m", "the width of the road at least", self.min_radius_m.to_string()));
        }
        Ok(())
    }

    /// One try, with legs this many times longer than usual, which is easier; `None` if a promise is not kept.
    fn draw(
        &self,
        rng: &mut ChaCha8Rng,
        ease: f64,
        theme: Theme,
        scenery_seed: u64,
    ) -> Result<Option<TrackFile>, TrackError> {
        let Some(plan) = shape::draw(self, ease, rng) else { return Ok(None) };
        let mut file = TrackFile {
            name: self.name(),
            theme,
            width_m: self.width_m,
            driving_line_m: self.driving_line_m,
            scenery_seed,
            start: Start { x: 0.0, y: 0.0, z: 0.0, yaw_deg: 0.0 },
            control_points: plan.iter().map(|p| [p.x, 0.0, p.y]).collect(),
            stretches: vec![],
            landmarks: vec![],
        };
        // Scaled to exactly the length asked for, measured along its middle; then it begins on its longest straight.
        let long = Track::new(file.clone())?.length();
        for point in &mut file.control_points {
            *point = point.map(|x| x * self.length_m / long);
        }
        let first = dress::longest_straight(Track::new(file.clone())?.stations(), file.control_points.len());
        file.control_points.rotate_left(first);

        let flat = Track::new(file.clone())?;
        let Some(crossings) = self.crossings_of(flat.stations()) else { return Ok(None) };
        let Some(heights) = dress::heights(self, &flat, &crossings, rng) else { return Ok(None) };
        for (point, height) in file.control_points.iter_mut().zip(heights) {
            point[1] = height;
        }
        let track = Track::new(file.clone())?;
        if !self.keeps_promises(&track) {
            return Ok(None);
        }
        file.stretches = dress::stretches(self, &track, &crossings, rng);
        let start = track.driving_line()[0];
        let round = |x: f64| (x * 100.0).round() / 100.0;
        file.start = Start {
            x: round(start.position.x),
            y: round(start.position.y),
            z: round(start.position.z),
            yaw_deg: round(start.yaw.to_degrees()),
        };
        Ok(Some(file))
    }

    /// Metres along the road within which two places are neighbours: a half circle just wide enough to keep its ends
    /// apart, and a little more.
    fn neighbourhood_m(&self) -> f64 {
        WIDTHS_APART * self.width_m * 2.0
    }

    /// Pairs of places that are not neighbours and whose middles are too near on the plan.
    fn too_near<'a>(&self, stations: &'a [Station]) -> impl Iterator<Item = (&'a Station, &'a Station)> {
        let (n, step) = (stations.len(), 2); // each metre
        let length = self.length_m;
        let (near, apart) = (self.neighbourhood_m(), WIDTHS_APART * self.width_m);
        (0..n).step_by(step).flat_map(move |i| {
            let a = &stations[i];
            let mut j = i + 1;
            std::iter::from_fn(move || {
                while j < n {
                    let b = &stations[j];
                    let along = (b.s - a.s).min(length - (b.s - a.s));
                    let distance = DVec2::new(b.position.x - a.position.x, b.position.z - a.position.z).length();
                    // The distance changes by at most a metre per metre of road, so the stations in between are too far
                    // as well.
                    let skip = ((distance - apart) / 0.5) as usize;
                    j += skip.max(1);
                    if distance < apart && along > near {
                        return Some((a, b));
                    }
                }
                None
            })
        })
    }

    /// Where the road crosses itself; `None` if it comes too near to itself elsewhere.
    fn crossings_of(&self, stations: &[Station]) -> Option<Vec<Crossing>> {
        let mut found: Vec<(Crossing, f64)> = vec![];
        for (a, b) in self.too_near(stations) {
            if !self.crossings {
                return None;
            }
            let distance = (a.position - b.position).length();
            let close =
                |x: f64, y: f64| (x - y).abs().min(self.length_m - (x - y).abs()) < self.neighbourhood_m() * 2.0;
            match found.iter_mut().find(|(c, _)| close(c.over, a.s) && close(c.under, b.s)) {
                Some((crossing, least)) if distance < *least => {
                    (*crossing, *least) = (Crossing { over: a.s, under: b.s }, distance);
                }
                Some(_) => {}
                None => found.push((Crossing { over: a.s, under: b.s }, distance)),
            }
        }
        found.iter().all(|(_, least)| *least < 1.0).then(|| found.iter().map(|(c, _)| *c).collect())
    }

    /// Whether all that the fields' documentation promises holds, measured on the road.
    fn keeps_promises(&self, track: &Track) -> bool {
        let stations = track.stations();
        let tightest = stations.iter().map(|s| s.curvature.abs()).fold(0.0, f64::max);
        let steepest = stations.iter().map(|s| s.grade.abs()).fold(0.0, f64::max);
        tightest <= 1.0 / self.min_radius_m
            && steepest <= self.max_grade
            && (track.length() / self.length_m - 1.0).abs() < 0.05
            && self.too_near(stations).all(|(a, b)| (a.position.y - b.position.y).abs() >= CROSSING_HEIGHT_M)
    }
}

#[cfg(test)]
mod tests;
