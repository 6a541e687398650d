//! The car's position over time, from its positions by distance driven.

use std::ops::Range;

use crate::odometry::Milestone;

/// Most metres driven between a known place and one extrapolated from it.
const FURTHEST_M: f64 = 250.0;

/// The distance driven over time.
#[derive(Debug, Clone, Default)]
pub(super) struct DistanceLog {
    driven: Vec<(f64, f64)>,
    /// Seconds that the times leave out: when they would have been, and how many.
    left_out: Vec<(f64, f64)>,
}

impl DistanceLog {
    /// Notes that at this time it had driven this many metres. Neither goes back.
    pub fn note(&mut self, at: f64, way_m: f64) {
        self.driven.push((at, way_m));
    }

    /// Notes that just before this time so many seconds passed that the times do not count.
    pub fn leave_out(&mut self, at: f64, seconds: f64) {
        self.left_out.push((at, seconds));
    }

    #[cfg(test)]
    pub fn len(&self) -> usize {
        self.driven.len()
    }

    /// How far it had driven then, in metres.
    pub fn way_m(&self, at: f64) -> f64 {
        self.driven[..self.driven.partition_point(|(then, _)| *then <= at)].last().map_or(0.0, |(_, way_m)| *way_m)
    }

    /// When it had driven this far, in seconds; `None` before and after the drive.
    fn at(&self, way_m: f64) -> Option<f64> {
        let next = self.driven.partition_point(|(_, way)| *way < way_m);
        let (until, to) = *self.driven.get(next)?;
        let Some((since, from)) = next.checked_sub(1).map(|i| self.driven[i]) else {
            return (to <= way_m).then_some(until);
        };
        Some(since + (until - since) * (way_m - from) / (to - from))
    }

    /// The time between each of these distances and the one before, the first from the drive's beginning, in seconds, with what
    /// the times leave out; empty if one of them was not driven.
    pub fn laps(&self, began_s: f64, ways_m: &[f64]) -> Vec<f64> {
        let Some(ends) = ways_m.iter().map(|way| self.at(*way)).collect::<Option<Vec<f64>>>() else { return vec![] };
        let begins = std::iter::once(began_s).chain(ends.iter().copied());
        let left_out = |begin: f64, end: f64| -> f64 {
            self.left_out.iter().filter(|(at, _)| (begin..end).contains(at)).map(|(_, seconds)| seconds).sum()
        };
        ends.iter().zip(begins).map(|(end, begin)| end - begin + left_out(begin, *end)).collect()
    }

    /// The most seconds in one piece that the times leave out within so many metres of this distance.
    pub fn left_out_near(&self, way_m: f64, within_m: f64) -> f64 {
        let near = self.left_out.iter().filter(|(at, _)| (self.way_m(*at) - way_m).abs() <= within_m);
        near.map(|(_, seconds)| *seconds).fold(0.0, f64::max)
    }

    /// Its places along a road of this length over time, while these metres were driven: seconds and metres. Between
    /// milestones, the metres driven are added.
    pub fn whereabouts(&self, trail: &[Milestone], within: Range<f64>, length_m: f64) -> Vec<(f64, f64)> {
        let place = |&(at, way_m): &(f64, f64)| {
            let passed = trail.partition_point(|milestone| milestone.way_m <= way_m);
            let near = trail.get(passed.saturating_sub(1))?;
            let on = way_m - near.way_m;
            (on.abs() <= FURTHEST_M).then(|| (at, (near.s_m + on).rem_euclid(length_m)))
        };
        let driven = self.driven.iter().filter(|(_, way_m)| (within.start..=within.end).contains(way_m));
        driven.filter_map(place).collect()
    }
}

/// How far the car had driven when it first came this far along the road, in metres, and the standard deviation of
/// that.
pub(super) fn way_to(progress_m: f64, trail: &[Milestone]) -> Option<(f64, f64)> {
    let (before, after) = trail
        .array_windows()
        .find_map(|[a, b]| (a.progress_m < progress_m && progress_m <= b.progress_m).then_some((a, b)))?;
    let part = (progress_m - before.progress_m) / (after.progress_m - before.progress_m);
    Some((before.way_m + part * (after.way_m - before.way_m), before.deviation_m.max(after.deviation_m)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 10 m/s, a stop of 5 s at 200 m, and on.
    fn clock() -> DistanceLog {
        let mut clock = DistanceLog::default();
        (0..=20).for_each(|s| clock.note(f64::from(s), f64::from(10 * s)));
        (1..=30).for_each(|s| clock.note(f64::from(s + 25), f64::from(200 + 10 * s)));
        clock
    }

    #[test]
    fn laps_take_the_time_from_end_to_end_and_a_stop_counts() {
        let laps = clock().laps(0.0, &[105.0, 215.0, 500.0]);
        assert!(laps.iter().zip([10.5, 16.0, 28.5]).all(|(got, wanted)| (got - wanted).abs() < 1e-9), "{laps:?}");
        assert_eq!(clock().laps(0.0, &[105.0, 501.0]), [0.0; 0]);
        // Time that a log leaves out passed all the same; where a lap ends in it, nobody knows at what time.
        let mut gap = clock();
        gap.leave_out(15.0, 20.0);
        assert_eq!((gap.left_out_near(140.0, 10.0), gap.left_out_near(139.0, 10.0)), (20.0, 0.0));
        let laps = gap.laps(0.0, &[105.0, 215.0, 500.0]);
        assert!(laps.iter().zip([10.5, 36.0, 28.5]).all(|(got, wanted)| (got - wanted).abs() < 1e-9), "{laps:?}");
        assert_eq!(DistanceLog::default().laps(0.0, &[1.0]), [0.0; 0]);
        assert_eq!((clock().way_m(10.4), clock().way_m(-1.0)), (100.0, 0.0));
    }

    #[test]
    fn between_milestones_the_metres_driven_count_and_far_from_them_nothing_is_known() {
        let trail = [(100.0, 390.0), (120.0, 9.0)].map(|(way_m, s_m)| Milestone {
            way_m,
            s_m,
            progress_m: way_m,
            deviation_m: s_m / 100.0,
        });
        let seen = clock().whereabouts(&trail, 0.0..1e9, 400.0);
        let at = |t: f64| seen.iter().find(|(at, _)| *at == t).map(|(_, s)| *s);
        assert_eq!([at(0.0), at(10.0), at(11.0), at(13.0)], [Some(290.0), Some(390.0), Some(0.0), Some(19.0)]);
        assert_eq!((at(42.0), at(43.0)), (Some(259.0), None));
        assert_eq!(way_to(110.0, &trail), Some((110.0, 3.9)));
        assert_eq!(way_to(121.0, &trail), None);
    }
}
