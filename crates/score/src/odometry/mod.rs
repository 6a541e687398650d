//! Where a car was, by its speed, its steering and its pictures: the stock build reports no position.
//!
//! Speed and steering say how far the car went and how it turned; a known road says where it bends. A particle filter
//! for each known road ([`Filter`]) compares the two, and [`Matcher`] says which road explains the drive best and where
//! on it the car is; [`find`] puts that together with what the drive's start looks like, for scoring and for locating
//! alike. The method is that of Monte Carlo localisation (Thrun, Burgard and Fox, Probabilistic Robotics,
//! 2005, chapter 8), with the fact that drivers stay on the road in place of a sensor.
//!
//! Pictures identify a place that was seen before ([`Look`]): the start of a known road, or the drive's own beginning,
//! which gives the length of a lap on an unknown road ([`laps`]).
//!
//! The cost of a filter's step grows with its particles, so telemetries are collected until the car has moved
//! [`STEP_M`].

mod filter;
mod finder;
mod look;
mod matcher;
mod revisits;

use std::f64::consts::PI;

use lapwing_core::motion::turn;

pub use filter::{EXPLAINED, Filter, Milestone, Whereabouts};
pub use finder::{
    ASTRAY, BENDS_M, Found, LIKELY, Leg, NEAR_M, PLAUSIBLE_WAY, SURE, Tried, both_ways, ends, find, is_nearly, joins,
    nearly_explains,
};
pub use lapwing_core::words::road as words;
pub use look::Look;
pub use matcher::{Match, Matcher, STEP_M};
pub use revisits::{BEGINNING_M, EVERY_M, laps};

/// A road for matching: its heading by the distance along it.
#[derive(Debug, Clone, PartialEq)]
pub struct Road {
    /// Its name.
    pub name: String,
    /// Where drives begin, in metres along it.
    pub start_m: f64,
    /// Length of a lap, in metres.
    pub length_m: f64,
    /// The look of its start.
    pub start: Option<Look>,
    /// Whether it is driven against the direction of the track of this name.
    pub reversed: bool,
    /// Headings in radians, clockwise, without jumps, evenly spaced from 0 to the whole length, both ends included.
    headings: Vec<f64>,
    /// Headings per metre.
    per_m: f64,
    /// For each heading, how far along the track's own line it is, in the track's own direction; without jumps.
    places: Vec<f64>,
}

impl Road {
    /// A road by its driving line: headings in radians, clockwise, evenly spaced over a lap; the first and the last are
    /// at the same place. There must be at least two.
    pub fn new(name: String, start_m: f64, length_m: f64, start: Option<Look>, mut headings: Vec<f64>) -> Self {
        assert!(headings.len() > 1, "a road has headings, got {}", headings.len());
        // No step between two headings turns by half a circle.
        let mut before = headings.first().copied().unwrap_or(0.0);
        for heading in &mut headings {
            *heading = before + turn(*heading - before);
            before = *heading;
        }
        let per_m = (headings.len() - 1) as f64 / length_m;
        let places = (0..headings.len()).map(|i| i as f64 / per_m).collect();
        Self { name, start_m, length_m, start, reversed: false, headings, per_m, places }
    }

    /// The same line, driven from its end to its beginning. What is seen at its start is not known. On a road with two lanes, who
    /// drives the other way round keeps to another line: [`Road::against`].
    pub fn reversed(&self) -> Self {
        Self {
            name: self.name.clone(),
            start_m: self.length_m - self.start_m,
            length_m: self.length_m,
            start: None,
            reversed: !self.reversed,
            headings: self.headings.iter().rev().map(|heading| heading + PI).collect(),
            per_m: self.per_m,
            places: self.places.iter().rev().copied().collect(),
        }
    }

    /// A line of its own for the same road the other way round, with the places of the road's own line that are beside its
    /// headings, in metres, without jumps. There must be as many of these as headings.
    pub fn against(mut self, places: Vec<f64>) -> Self {
        assert_eq!(places.len(), self.headings.len(), "each heading has a place on the road");
        (self.reversed, self.places) = (true, places);
        self
    }

    /// How far along the track's own line a place is, in the track's own direction, in metres. It may be some metres below 0 or
    /// beyond a lap; whole laps do not count.
    pub fn on_track(&self, s_m: f64) -> f64 {
        let (_, i, part) = self.between(s_m);
        self.places[i] * (1.0 - part) + self.places[i + 1] * part
    }

    /// Whether a lap of it turns to the right, all bends taken together.
    pub fn is_clockwise(&self) -> bool {
        self.headings[self.headings.len() - 1] > self.headings[0]
    }

    /// Its name, and the way round if that is not its own.
    pub fn words(&self) -> String {
        words(&self.name, self.reversed)
    }

    /// The heading at any distance along it, over any number of laps.
    fn heading(&self, s: f64) -> f64 {
        let (first, last) = (self.headings[0], self.headings[self.headings.len() - 1]);
        let (laps, i, part) = self.between(s);
        self.headings[i] * (1.0 - part) + self.headings[i + 1] * part + laps * (last - first)
    }

    /// After how many laps, between which heading and the next, and how far from the one to the other.
    fn between(&self, s: f64) -> (f64, usize, f64) {
        // Nearly all are asked for on the first lap, and this is what a filter does most.
        let laps = if (0.0..self.length_m).contains(&s) { 0.0 } else { (s / self.length_m).floor() };
        let place = (s - laps * self.length_m) * self.per_m;
        let i = (place as usize).min(self.headings.len() - 2);
        (laps, i, place - i as f64)
    }
}

#[cfg(test)]
mod tests;
