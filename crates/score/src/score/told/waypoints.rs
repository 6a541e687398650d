//! How far into a lap the car is by its reported waypoints, and whether the last lap was complete though not reported.

/// The last waypoint's stretch is done if no more of it is left than this share plus the distance of two telemetries.
const LEFT: f64 = 0.1;
/// Relative error of a road's length computed from the metres driven between waypoints: weaving adds distance.
const LENGTH_OFF: f64 = 0.03;
/// Fewest stretches between waypoints that give the length of one.
const FEWEST: u32 = 3;

/// Watches the waypoints.
#[derive(Debug, Clone, Default)]
pub(in crate::score) struct Waypoints {
    first: Option<u32>,
    last: Option<u32>,
    /// How many a lap has, once one was completed.
    count: Option<u32>,
    /// Metres driven when the last one was reached, if that is known.
    reached_m: Option<f64>,
    /// Metres between successive waypoints, and how many pairs; and the last of them.
    stretches: (f64, u32),
    newest_m: Option<f64>,
    way_m: f64,
    /// Metres driven since the telemetry before.
    step_m: f64,
}

/// How the car arrived at a telemetry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Arrival {
    /// It stands.
    Standing,
    Driving,
    /// After a gap.
    Unseen,
}

/// Where in a lap the car is at the end of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::score) struct Within {
    /// Share of the lap that lies behind it.
    pub share: f64,
    /// Share of a lap from one waypoint to the next.
    pub each: f64,
    /// How far off that may be.
    pub off: f64,
    /// Share of a lap that was behind it at the run's first waypoint.
    pub begun: f64,
    /// Whether the number of waypoints was observed, not inferred.
    pub is_counted: bool,
    /// Whether it is at the end of the lap: the next telemetry would have reported it.
    pub is_done: bool,
}

impl Waypoints {
    /// Whether another waypoint was reached. If the telemetry does not continue from the one before, the place is
    /// unknown; at the start of a run it is known only for a car that stands at waypoint 0.
    pub(super) fn telemetry(&mut self, waypoint: Option<u32>, lap_ended: bool, way_m: f64, seen: Arrival) -> bool {
        (self.step_m, self.way_m) = (way_m - self.way_m, way_m);
        let Some(now) = waypoint else { return false };
        self.first.get_or_insert(now);
        let Some(before) = self.last.replace(now) else {
            self.reached_m = (now == 0 && seen == Arrival::Standing).then_some(way_m);
            return false;
        };
        if now == before {
            return false;
        }
        if now == 0 && !lap_ended && self.count.is_none() {
            // It began just before the line, or the track was reloaded: the count begins here.
            self.first = Some(0);
        }
        if now == 0 && lap_ended {
            self.count = self.count.max(Some(before.saturating_add(1)));
        }
        let follows = seen != Arrival::Unseen && (now == before.saturating_add(1) || now == 0 && lap_ended);
        let since_m = std::mem::replace(&mut self.reached_m, follows.then_some(way_m));
        self.newest_m = since_m.filter(|_| follows).map(|since_m| way_m - since_m);
        if let Some(stretch_m) = self.newest_m {
            self.stretches = (self.stretches.0 + stretch_m, self.stretches.1 + 1);
        }
        true
    }

    /// The car was put at the waypoint, so the distance driven to it says nothing.
    pub(super) fn put(&mut self) {
        if let Some(stretch_m) = self.newest_m.take() {
            self.stretches = (self.stretches.0 - stretch_m, self.stretches.1 - 1);
        }
    }

    pub(in crate::score) fn are_told(&self) -> bool {
        self.last.is_some()
    }

    /// Metres from one waypoint to the next.
    fn stretch_m(&self) -> Option<f64> {
        let (metres, n) = self.stretches;
        (n >= FEWEST && metres > 0.0).then(|| metres / f64::from(n))
    }

    /// Metres of a lap as driven, if its waypoints were counted.
    pub(in crate::score) fn lap_m(&self) -> Option<f64> {
        Some(self.stretch_m()? * f64::from(self.count?))
    }

    /// Whether the car is at the end of a stretch, where a lap may end.
    pub(in crate::score) fn is_at_line(&self) -> bool {
        let Some((stretch_m, reached_m)) = self.stretch_m().zip(self.reached_m) else { return false };
        stretch_m - (self.way_m - reached_m) <= LEFT * stretch_m + 2.0 * self.step_m
    }

    /// Where in the lap the car is, with the road's length in metres if it is known; `None` if the number of waypoints
    /// is unknown.
    pub(in crate::score) fn within(&self, road_m: Option<f64>) -> Option<Within> {
        let (first, last) = self.first.zip(self.last)?;
        let by_road = || Some(road_m? / self.stretch_m()?);
        let count = self.count.map(f64::from).or_else(by_road)?;
        let is_counted = self.count.is_some();
        let off_count = if is_counted { 0.5 } else { (LENGTH_OFF * count).max(0.5) };
        let is_last = (f64::from(last) + 1.0 - count).abs() <= off_count;
        let [begun, share] = [first, last].map(|waypoint| (f64::from(waypoint) / count).min(1.0));
        let is_done = is_last && self.is_at_line();
        let off = match self.stretch_m() {
            Some(stretch_m) if is_done => (LEFT + 2.0 * self.step_m / stretch_m) / count,
            _ if is_counted => 1.0 / count,
            _ => 1.0 / count + (share - begun).abs() * LENGTH_OFF,
        };
        Some(Within { share, each: 1.0 / count, off, begun, is_counted, is_done })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reported 15 times a second at 9 m/s on a lap of 50 waypoints 20 m apart, from metre to metre.
    fn driven(from_m: f64, to_m: f64) -> Waypoints {
        let mut waypoints = Waypoints::default();
        let steps = ((to_m - from_m) / 0.6) as u32;
        let mut lap = (from_m / 1000.0) as u32;
        for i in 0..=steps {
            let way_m = 0.6 * f64::from(i);
            let at = from_m + way_m;
            let ended = (at / 1000.0) as u32 > lap;
            lap = (at / 1000.0) as u32;
            waypoints.telemetry(Some((at % 1000.0 / 20.0) as u32), ended, way_m, Arrival::Driving);
        }
        waypoints
    }

    #[test]
    fn a_lap_of_a_known_road_is_done_where_its_last_stretch_is() {
        let within = driven(0.0, 999.5).within(Some(1004.0)).unwrap();
        assert!(within.is_done && !within.is_counted && (within.share - 0.98).abs() < 0.01, "{within:?}");
        // At another waypoint's line, in the middle of the last stretch, on a road that is longer.
        assert!(!driven(0.0, 499.5).within(Some(1004.0)).unwrap().is_done);
        assert!(!driven(0.0, 990.0).within(Some(1004.0)).unwrap().is_done);
        assert!(!driven(0.0, 999.5).within(Some(1200.0)).unwrap().is_done);
        assert_eq!(driven(0.0, 999.5).within(None), None, "no road, no lap that was closed");
    }

    #[test]
    fn a_lap_that_was_closed_says_how_many_waypoints_there_are() {
        let within = driven(0.0, 1500.5).within(None).unwrap();
        assert!(within.is_counted && !within.is_done && (within.share - 0.5).abs() < 1e-9, "{within:?}");
        let waypoints = driven(0.0, 1999.8);
        assert!(waypoints.within(None).unwrap().is_done);
        assert!((waypoints.lap_m().unwrap() - 1000.0).abs() < 2.0);
    }

    #[test]
    fn a_run_that_begins_in_the_middle_of_a_lap_is_not_ahead_of_its_way() {
        let within = driven(300.0, 600.0).within(Some(1000.0)).unwrap();
        assert!((within.share - within.begun - 0.3).abs() < 0.03, "{within:?}");
    }

    #[test]
    fn waypoints_passed_unseen_do_not_say_how_far_they_are_apart() {
        let mut waypoints = driven(0.0, 505.0);
        let before = waypoints.stretch_m();
        waypoints.telemetry(Some(27), false, 555.0, Arrival::Unseen);
        waypoints.telemetry(Some(28), false, 560.0, Arrival::Driving);
        assert_eq!((waypoints.stretch_m(), waypoints.reached_m), (before, Some(560.0)));
    }

    #[test]
    fn where_the_car_was_put_says_nothing_of_how_far_waypoints_are_apart() {
        let mut waypoints = driven(0.0, 505.0);
        let before = waypoints.stretch_m().unwrap();
        waypoints.telemetry(Some(26), false, 505.0, Arrival::Standing);
        waypoints.put();
        assert!((waypoints.stretch_m().unwrap() - before).abs() < 1e-9);
        assert_eq!(waypoints.reached_m, Some(505.0));
    }
}
