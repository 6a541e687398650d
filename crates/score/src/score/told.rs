//! What worlds report in their telemetry, and what follows from it: laps, waypoints, collisions, leaving the road,
//! being put back, as a judge would have reported them.

mod waypoints;

pub(super) use waypoints::Waypoints;

use self::waypoints::Arrival;
use super::infractions::Struck;
use lapwing_core::{
    protocol::Truth,
    units::{MPS_PER_MPH, Metres},
};

/// A car this much nearer to the line than when it left the road is back on it, in metres.
const BACK_M: f64 = 0.2;
/// A car that reaches a waypoint this slowly was put there, in m/s.
const STANDS_MPS: f64 = 1.0 * MPS_PER_MPH;

/// Watches what telemetry reports.
#[derive(Debug, Clone, Default)]
pub(super) struct Told {
    pub laps: Counter,
    pub crashes: Counter,
    pub out_of_bounds: Counter,
    pub distance_m: Counter,
    pub waypoints: Waypoints,
    pub tells_cte: bool,
    pub track: Option<String>,
    /// Whether anything beyond the stock build is reported.
    pub tells: bool,
    /// Contacts, for worlds that do not count them: so far, and whether there is one now.
    contacts: (u32, bool),
    /// What was hit, each time a name came with exactly one more collision.
    pub struck: Vec<Struck>,
    /// When the lap began, if that was seen.
    lap_began_s: Option<f64>,
    pub lap_times_s: Vec<f64>,
    /// How far off each of them may be, in seconds.
    pub lap_times_off_s: f64,
    /// How far from the line it was when it left the road.
    left_at_m: Option<f64>,
}

/// A telemetry's properties besides its truth.
#[derive(Debug, Clone, Copy)]
pub(super) struct Now {
    pub at_s: f64,
    /// Seconds since the telemetry before; `None` for the first.
    pub apart_s: Option<f64>,
    /// Whether it is unknown what happened in between.
    pub after_gap: bool,
    pub mps: f64,
    /// Metres driven until then, by its speed.
    pub driven_m: f64,
    /// Whether nothing of the run came before this telemetry.
    pub is_beginning: bool,
}

/// What has happened since the previous telemetry.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct News {
    pub crashes: u32,
    /// Times that the road was left.
    pub left_road: u32,
    pub back_on_road: bool,
    pub put_back: bool,
}

impl Told {
    pub(super) fn telemetry(&mut self, truth: &Truth, now: Now) -> News {
        self.tells |= !truth.is_empty() && *truth != Truth { brake: truth.brake, ..Truth::default() };
        self.tells_cte |= truth.cte.is_some();
        if self.track.is_none() {
            self.track.clone_from(&truth.track);
        }
        self.distance_m.take(truth.distance.map(Metres::get));
        let way_m = self.distance_m.total().unwrap_or(now.driven_m);
        let laps = self.laps.take(truth.lap.map(f64::from));
        let seen = match now.after_gap {
            true => Arrival::Unseen,
            _ if now.mps < STANDS_MPS => Arrival::Standing,
            _ => Arrival::Driving,
        };
        let passed = self.waypoints.telemetry(truth.waypoint, laps > 0, way_m, seen);
        self.time_laps(laps, truth.waypoint, now);
        let contacts = self.contacts(truth);
        let crashes = self.crashes.take(contacts);
        self.struck.extend(truth.hit.as_deref().filter(|_| crashes == 1).map(Struck::by_name));
        let left_road = self.out_of_bounds.take(truth.out_of_bounds.map(f64::from));
        let off_m = truth.cte.map(|cte| cte.get().abs());
        let put_back = passed && seen == Arrival::Standing;
        if put_back {
            self.waypoints.put();
        }
        let back_on_road =
            put_back || self.left_at_m.zip(off_m).is_some_and(|(left_at_m, off_m)| off_m < left_at_m - BACK_M);
        if back_on_road {
            self.left_at_m = None;
        }
        if left_road > 0 && !put_back {
            self.left_at_m = off_m;
        }
        News { crashes, left_road, back_on_road, put_back }
    }

    /// The count of collisions: the world's own, or of the contacts that it names.
    fn contacts(&mut self, truth: &Truth) -> Option<f64> {
        let (count, touched) = &mut self.contacts;
        let touches = truth.crashed.unwrap_or(false) || truth.hit.is_some();
        *count += u32::from(touches && !*touched);
        *touched = touches;
        if truth.crashes.is_none() && truth.crashed.is_none() && touches {
            // Builds that name what is hit report nothing before the first hit, so the count begins at zero.
            self.crashes.last.get_or_insert(0.0);
        }
        // If none is named, it is unknown whether they would be.
        let named = (*count > 0 || truth.crashed.is_some()).then_some(f64::from(*count));
        truth.crashes.map(f64::from).or(named)
    }

    fn time_laps(&mut self, laps: u32, waypoint: Option<u32>, now: Now) {
        let Some(apart_s) = now.apart_s else {
            self.lap_began_s = (now.is_beginning && waypoint.unwrap_or(0) == 0).then_some(now.at_s);
            return;
        };
        if laps > 0 {
            // Somewhere between the two telemetries.
            let ended_s = now.at_s - apart_s / 2.0;
            if let Some(began_s) = self.lap_began_s.filter(|_| laps == 1) {
                self.lap_times_s.push(ended_s - began_s);
                self.lap_times_off_s = self.lap_times_off_s.max(apart_s);
            }
            self.lap_began_s = Some(ended_s);
        }
    }

    /// The last lap, whose end was not reported, ended then.
    pub(super) fn last_lap_ended(&mut self, at_s: f64, off_s: f64) {
        if let Some(began_s) = self.lap_began_s {
            self.lap_times_s.push(at_s - began_s);
            self.lap_times_off_s = self.lap_times_off_s.max(off_s);
        }
    }
}

/// A count that may have begun before the run and may restart.
#[derive(Debug, Clone, Default)]
pub(super) struct Counter {
    last: Option<f64>,
    total: f64,
}

impl Counter {
    /// By how much it went up.
    fn take(&mut self, count: Option<f64>) -> u32 {
        // A count below 0 is no count.
        let count = count.filter(|count| *count >= 0.0);
        let more = count.zip(self.last).map_or(0.0, |(now, before)| (now - before).max(0.0));
        self.total += more;
        self.last = count.or(self.last);
        more as u32
    }

    pub(super) fn total(&self) -> Option<f64> {
        self.last.map(|_| self.total)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_thing_that_is_hit_counts_where_builds_only_name_what_is_hit() {
        let mut told = Told::default();
        let mut see = |second: u32, hit: Option<&str>| {
            let at_s = f64::from(second);
            let apart_s = (second > 0).then_some(1.0);
            let now =
                Now { at_s, apart_s, after_gap: false, mps: 9.0, driven_m: 9.0 * at_s, is_beginning: second == 0 };
            told.telemetry(&Truth { hit: hit.map(str::to_owned), ..Truth::default() }, now).crashes
        };
        let hits = [None, Some("block"), Some("block"), None, Some("tree")];
        let crashes: Vec<_> = (0..).zip(hits).map(|(second, hit)| see(second, hit)).collect();
        assert_eq!(crashes, [0, 1, 0, 0, 1]);
        assert_eq!(told.crashes.total(), Some(2.0));
    }
}
