//! From the items of a run to its scorecard.

use std::time::Duration;

use super::Scorecard;
use crate::{
    protocol::Telemetry,
    recording::EventRecord,
    units::{Degrees, MPS_PER_MPH, Metres},
};

/// Telemetries farther apart than this say nothing of how the wheel turned between them.
const STEERING_GAP: Duration = Duration::from_secs(1);

/// Watches one run.
#[derive(Debug, Clone, Default)]
pub struct Scorer {
    course: Option<Course>,
    first: Option<Duration>,
    last: Option<(Duration, f64)>,
    driven_m: f64,
    max_mph: f64,
    told_m: Option<f64>,
    /// |cte| of each telemetry that tells it.
    offsets_m: Vec<f64>,
    /// When and where the wheel was last told.
    steered: Option<(Duration, Degrees)>,
    steering_rate: SquaredRate,
    /// Furthest that the car came, in laps.
    progress: f64,
    laps: Vec<f64>,
    collisions: u32,
    off_roads: u32,
    off_road_s: f64,
    off_since: Option<Duration>,
    resets: u32,
    stuck: u32,
    takeovers: u32,
    bad_frames: u32,
    ended: Option<String>,
}

/// The integral of a squared rate of change, and of the time that it is taken over.
#[derive(Debug, Clone, Default)]
struct SquaredRate {
    squares: f64,
    seconds: f64,
}

impl SquaredRate {
    /// A change at an even rate: (change / s)² over s.
    fn take(&mut self, change: f64, seconds: f64) {
        self.squares += change.powi(2) / seconds;
        self.seconds += seconds;
    }

    fn rms(&self) -> Option<f64> {
        (self.seconds > 0.0).then(|| (self.squares / self.seconds).sqrt())
    }
}

#[derive(Debug, Clone)]
struct Course {
    track: String,
    waypoints: u32,
    laps: Option<u32>,
}

impl Scorer {
    /// Takes a telemetry, in the order of time.
    pub fn telemetry(&mut self, at: Duration, telemetry: &Telemetry) {
        let mph = telemetry.speed.get();
        self.first.get_or_insert(at);
        if let Some((before, was_mph)) = self.last {
            // Trapezium: the speed changes evenly between two telemetries.
            self.driven_m += at.saturating_sub(before).as_secs_f64() * (mph + was_mph) / 2.0 * MPS_PER_MPH;
        }
        self.last = Some((at, mph));
        self.max_mph = self.max_mph.max(mph);
        self.steering(at, telemetry.steering);
        let truth = &telemetry.truth;
        self.told_m = truth.distance.map(Metres::get).or(self.told_m);
        self.offsets_m.extend(truth.cte.map(|cte| cte.get().abs()));
        if let (Some(course), Some(lap), Some(waypoint)) = (&self.course, truth.lap, truth.waypoint) {
            let progress = f64::from(lap) + f64::from(waypoint) / f64::from(course.waypoints.max(1));
            self.progress = self.progress.max(progress);
        }
    }

    fn steering(&mut self, at: Duration, angle: Degrees) {
        if let Some((before, was)) = self.steered {
            let apart = at.saturating_sub(before);
            if apart.is_zero() {
                return; // no time in which to turn: the next one is measured from the earlier
            }
            if apart <= STEERING_GAP {
                self.steering_rate.take(angle.get() - was.get(), apart.as_secs_f64());
            }
        }
        self.steered = Some((at, angle));
    }

    /// Takes what happened besides.
    pub fn event(&mut self, at: Duration, event: &EventRecord) {
        match event {
            EventRecord::Course { track, waypoints, laps, .. } => {
                self.course = Some(Course { track: track.clone(), waypoints: *waypoints, laps: *laps });
            }
            EventRecord::Lap { number, time_s } => {
                self.laps.push(*time_s);
                self.progress = self.progress.max(f64::from(*number));
            }
            EventRecord::Collision { .. } => self.collisions += 1,
            EventRecord::OffRoad { .. } => {
                self.off_roads += 1;
                self.off_since = Some(at);
            }
            EventRecord::BackOnRoad { after_s } => {
                self.off_road_s += after_s;
                self.off_since = None;
            }
            EventRecord::Reset { .. } => {
                self.resets += 1;
                self.steered = None; // the wheel is put straight with the car
                self.back_on_road(at);
            }
            EventRecord::Stuck => self.stuck += 1,
            EventRecord::TakeoverBegan => self.takeovers += 1,
            EventRecord::BadFrame { .. } => self.bad_frames += 1,
            EventRecord::RunEnded { why } => {
                self.ended = Some(why.clone());
                self.back_on_road(at);
            }
            _ => {}
        }
    }

    fn back_on_road(&mut self, at: Duration) {
        if let Some(since) = self.off_since.take() {
            self.off_road_s += at.saturating_sub(since).as_secs_f64();
        }
    }

    /// The judgement.
    pub fn finish(mut self) -> Scorecard {
        let (first, last) = (self.first.unwrap_or_default(), self.last.map_or(Duration::ZERO, |(at, _)| at));
        self.back_on_road(last);
        let time_s = last.saturating_sub(first).as_secs_f64();
        let distance_m = self.told_m.unwrap_or(self.driven_m);
        self.offsets_m.sort_by(f64::total_cmp);
        let n = self.offsets_m.len();
        let told = n > 0;
        let judged = self.course.is_some();
        let laps_asked = self.course.as_ref().and_then(|course| course.laps);
        Scorecard {
            track: self.course.as_ref().map(|course| course.track.clone()),
            ended: self.ended,
            time_s,
            distance_m,
            mean_mph: (time_s > 0.0).then(|| self.driven_m / time_s / MPS_PER_MPH),
            max_mph: self.max_mph,
            laps_asked,
            laps: judged.then_some(self.laps.len() as u32),
            lap_times_s: self.laps,
            completion: laps_asked.map(|asked| (self.progress / f64::from(asked.max(1))).min(1.0)),
            collisions: judged.then_some(self.collisions),
            collisions_per_km: (judged && distance_m > 0.0).then(|| f64::from(self.collisions) / (distance_m / 1000.0)),
            off_roads: judged.then_some(self.off_roads),
            off_road_s: judged.then_some(self.off_road_s),
            resets: judged.then_some(self.resets),
            stuck: judged.then_some(self.stuck),
            mean_cte_m: told.then(|| self.offsets_m.iter().sum::<f64>() / n as f64),
            p95_cte_m: told.then(|| self.offsets_m[(n * 95).div_ceil(100).max(1) - 1]),
            max_cte_m: self.offsets_m.last().copied(),
            steering_rate_deg_s: self.steering_rate.rms(),
            takeovers: self.takeovers,
            bad_frames: self.bad_frames,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{protocol::Truth, units::Mph};

    fn at(s: f64) -> Duration {
        Duration::from_secs_f64(s)
    }

    fn told(mph: f64, cte: f64, lap: u32, waypoint: u32) -> Telemetry {
        Telemetry {
            steering: Default::default(),
            throttle: Default::default(),
            speed: Mph::new(mph).unwrap(),
            image: Default::default(),
            truth: Truth {
                cte: Some(Metres::new(cte).unwrap()),
                lap: Some(lap),
                waypoint: Some(waypoint),
                ..Default::default()
            },
        }
    }

    fn course(laps: u32) -> EventRecord {
        EventRecord::Course {
            track: "lake".into(),
            length_m: 1000.0,
            waypoints: 100,
            laps: Some(laps),
            edge_m: 3.35,
            scenario: None,
        }
    }

    #[test]
    fn half_of_the_second_lap_of_two_is_three_quarters() {
        let mut scorer = Scorer::default();
        scorer.event(at(0.0), &course(2));
        scorer.telemetry(at(0.0), &told(10.0, 0.0, 0, 0));
        scorer.event(at(60.0), &EventRecord::Lap { number: 1, time_s: 60.0 });
        scorer.telemetry(at(90.0), &told(10.0, 0.0, 1, 50));
        let card = scorer.finish();
        assert_eq!(card.completion, Some(0.75));
        assert_eq!((card.laps, card.lap_times_s), (Some(1), vec![60.0]));
    }

    #[test]
    fn distance_is_speed_over_time_and_offsets_are_ranked() {
        let mut scorer = Scorer::default();
        scorer.event(at(0.0), &course(1));
        for i in 0..=100 {
            scorer.telemetry(at(f64::from(i) / 10.0), &told(20.0, -f64::from(i) / 100.0, 0, 0));
        }
        let card = scorer.finish();
        assert!((card.distance_m - 10.0 * 20.0 * MPS_PER_MPH).abs() < 1e-9);
        assert!((card.mean_cte_m.unwrap() - 0.5).abs() < 1e-9);
        assert_eq!((card.p95_cte_m, card.max_cte_m), (Some(0.95), Some(1.0)));
    }

    #[test]
    fn a_run_that_tells_nothing_is_not_said_to_be_free_of_collisions() {
        let mut scorer = Scorer::default();
        let mut stock = told(10.0, 0.0, 0, 0);
        stock.truth = Truth::default();
        scorer.telemetry(at(0.0), &stock);
        scorer.telemetry(at(1.0), &stock);
        let card = scorer.finish();
        assert_eq!((card.collisions, card.laps, card.mean_cte_m, card.completion), (None, None, None, None));
    }

    #[test]
    fn time_off_the_road_counts_to_the_end_of_a_run_that_ends_there() {
        let mut scorer = Scorer::default();
        scorer.event(at(0.0), &course(1));
        scorer.telemetry(at(0.0), &told(10.0, 0.0, 0, 0));
        scorer.event(at(2.0), &EventRecord::OffRoad { offset_m: 3.4 });
        scorer.event(at(3.0), &EventRecord::BackOnRoad { after_s: 1.0 });
        scorer.event(at(5.0), &EventRecord::OffRoad { offset_m: 3.4 });
        scorer.telemetry(at(7.5), &told(10.0, 9.0, 0, 1));
        let card = scorer.finish();
        assert_eq!((card.off_roads, card.off_road_s), (Some(2), Some(3.5)));
    }

    /// The steering rate of a wheel told at these times and angles.
    fn steering_rate(told_at: &[(f64, f64)]) -> Option<f64> {
        let mut scorer = Scorer::default();
        for (s, deg) in told_at {
            scorer.telemetry(at(*s), &turned(*deg));
        }
        scorer.finish().steering_rate_deg_s
    }

    fn turned(deg: f64) -> Telemetry {
        Telemetry { steering: Degrees::new(deg).unwrap(), ..told(10.0, 0.0, 0, 0) }
    }

    #[test]
    fn a_second_at_10_and_one_at_20_degrees_a_second_are_15_8_rms() {
        // sqrt((10² + 20²) / 2); three telemetries of the even second are as good as two.
        let rate = steering_rate(&[(0.0, 0.0), (0.25, 2.5), (1.0, 10.0), (2.0, -10.0)]).unwrap();
        assert!((rate - 250f64.sqrt()).abs() < 1e-9, "{rate}");
        assert_eq!(steering_rate(&[(0.0, 5.0), (0.5, 5.0)]), Some(0.0));
    }

    #[test]
    fn one_telemetry_tells_no_steering_rate() {
        assert_eq!(steering_rate(&[]), None);
        assert_eq!(steering_rate(&[(0.0, 5.0)]), None);
        assert_eq!(steering_rate(&[(1.0, 0.0), (1.0, 5.0)]), None);
    }

    #[test]
    fn the_wheel_does_not_turn_in_a_gap_or_across_a_reset() {
        assert_eq!(steering_rate(&[(0.0, 0.0), (1.5, 20.0)]), None);
        let rate = steering_rate(&[(0.0, 0.0), (0.5, 5.0), (9.0, -20.0), (9.5, -15.0)]).unwrap();
        assert!((rate - 10.0).abs() < 1e-9, "{rate}");

        let mut scorer = Scorer::default();
        scorer.telemetry(at(0.0), &turned(0.0));
        scorer.telemetry(at(0.5), &turned(5.0));
        scorer.event(at(0.5), &EventRecord::Reset { waypoint: 0 });
        scorer.telemetry(at(0.6), &turned(-20.0));
        scorer.telemetry(at(1.1), &turned(-15.0));
        let rate = scorer.finish().steering_rate_deg_s.unwrap();
        assert!((rate - 10.0).abs() < 1e-9, "{rate}");
    }

    #[test]
    fn two_telemetries_at_one_time_make_no_infinite_rate() {
        assert_eq!(steering_rate(&[(0.0, 0.0), (0.0, 5.0), (0.5, 5.0)]), Some(10.0));
    }

    #[test]
    fn the_steering_rate_stands_below_the_offset() {
        let mut scorer = Scorer::default();
        scorer.telemetry(at(0.0), &turned(0.0));
        scorer.telemetry(at(0.5), &turned(6.17));
        let card = scorer.finish().to_string();
        let lines: Vec<_> = card.lines().skip_while(|line| !line.contains("|cte|")).collect();
        assert_eq!(lines[1], "  steering rate     12.3 deg/s RMS", "{card}");
    }
}
