//! The parts, runs and stretches that a recording is cut into, and where each is known to have been.

use std::{ops::Range, sync::Arc};

use super::rows::Row;
use lapwing_score::odometry::{ASTRAY, Leg, Match, Milestone, NEAR_M, Road, both_ways, joins};
use lapwing_sim::{
    locate::{Known, Pose},
    track::Track,
};

/// Rows of a stretch, and how many more on either side are looked at to locate its ends as surely as its middle.
const STRETCH: usize = 250;
const BESIDE: usize = 40;
/// Places that the bends tell are [`NEAR_M`] sure at best, and as they err alike, less sure than each by itself.
const ALIKE: f64 = 2.0;

/// A road that a drive may have been on.
#[derive(Clone)]
pub(super) struct OnRoad {
    pub road: Arc<Road>,
    /// Where the car was on the way: by the bends before and behind each place, where they agree; by those before it; and by
    /// those behind it.
    stones: [Vec<Milestone>; 3],
}

impl OnRoad {
    pub fn new(on: &Match, legs: &[Leg]) -> Self {
        Self { road: on.road.clone(), stones: both_ways(on, legs) }
    }

    /// Where it was, told otherwise.
    pub fn at(road: Arc<Road>, stones: Vec<Milestone>) -> Self {
        Self { road, stones: [stones, vec![], vec![]] }
    }
}

/// The drives of a recording: where one is joined to another, nothing that is known of one says anything of the other.
pub(super) fn parts_of(rows: &[Row]) -> Vec<Range<usize>> {
    split(rows, 0..rows.len(), |row| row.broken.is_some_and(joins))
}

/// The runs of rows within a part in which each continues from the one before.
pub(super) fn continuous(rows: &[Row], part: Range<usize>) -> Vec<Range<usize>> {
    split(rows, part, |row| row.broken.is_some())
}

fn split(rows: &[Row], within: Range<usize>, begins: impl Fn(&Row) -> bool) -> Vec<Range<usize>> {
    let first = within.start;
    let starts = within.clone().filter(|&i| i == first || begins(&rows[i])).collect::<Vec<_>>();
    let ends = starts.iter().skip(1).copied().chain([within.end]);
    starts.iter().zip(ends).map(|(&start, end)| start..end).collect()
}

/// Rows to follow in one go.
#[derive(Debug, Clone)]
pub(super) struct Stretch {
    /// Those that are looked at.
    pub shown: Range<usize>,
    /// Those of them that are located; the others belong to the stretches beside it.
    pub kept: Range<usize>,
    /// Where the car was now and then, by its bends: what is believed first, and what may be true instead. Pictures are
    /// counted from the first that is looked at.
    pub known: Vec<Vec<Known>>,
    /// Whether its pictures are mirrored before they are looked at, and its turns with them.
    pub is_mirrored: bool,
}

impl Stretch {
    /// At most so many of its rows, around the one whose place is known best.
    pub fn around_surest(&self, most: usize) -> Self {
        let surest = self.known.iter().flatten().min_by(|a, b| a.deviation_m.total_cmp(&b.deviation_m));
        let middle = self.shown.start + surest.map_or(0, |known| known.picture);
        let start = middle.saturating_sub(most / 2).max(self.shown.start);
        self.cut_to(start..(start + most).min(self.shown.end))
    }

    /// These rows alone, if it shows all of them.
    pub fn only(&self, rows: Range<usize>) -> Option<Self> {
        (self.shown.start <= rows.start && rows.end <= self.shown.end).then(|| self.cut_to(rows))
    }

    fn cut_to(&self, rows: Range<usize>) -> Self {
        let within = |known: &Known| {
            let picture = (self.shown.start + known.picture).checked_sub(rows.start)?;
            (picture < rows.len()).then_some(Known { picture, ..*known })
        };
        let known = self.known.iter().map(|known| known.iter().filter_map(within).collect());
        Self { known: known.collect(), kept: rows.clone(), shown: rows, ..*self }
    }
}

/// Cuts a drive into stretches, none of which goes over a break.
pub(super) fn cuts(part: &Range<usize>, rows: &[Row], found: &OnRoad, track: &Track) -> Vec<Stretch> {
    continuous(rows, part.clone()).iter().flat_map(|run| cut(run, part, rows, found, track)).collect()
}

/// Cuts a run of rows into stretches.
fn cut(run: &Range<usize>, part: &Range<usize>, rows: &[Row], found: &OnRoad, track: &Track) -> Vec<Stretch> {
    let count = run.len().div_ceil(STRETCH).max(1);
    let bound = |i: usize| run.start + run.len() * i / count;
    let mut way_m = 0.0;
    let driven = |(i, row): (usize, &Row)| {
        way_m += if i > 0 { row.motion.way_m } else { 0.0 };
        way_m
    };
    let ways: Vec<f64> = rows[part.clone()].iter().enumerate().map(driven).collect();
    let stretch = |i: usize| {
        let kept = bound(i)..bound(i + 1);
        let shown = kept.start.saturating_sub(BESIDE).max(run.start)..(kept.end + BESIDE).min(run.end);
        let ways = &ways[shown.start - part.start..shown.end - part.start];
        let known = |stone: &Milestone, deviation_m: f64| {
            let picture = ways.partition_point(|way_m| *way_m < stone.way_m).min(ways.len() - 1);
            let s_m = stone.s_m + ways[picture] - stone.way_m;
            Known { picture, pose: pose(track, &found.road, s_m), deviation_m }
        };
        let within = |stone: &&Milestone| (ways[0]..=ways[ways.len() - 1]).contains(&stone.way_m);
        let told = |stone: &Milestone| known(stone, (stone.deviation_m * ALIKE).max(NEAR_M));
        let off = |stone: &&Milestone| (stone.way_m - ways[ways.len() / 2]).abs();
        let of = |stones: &Vec<Milestone>| {
            let here: Vec<_> = stones.iter().filter(within).map(told).collect();
            let nearest = stones.iter().min_by(|a, b| off(a).total_cmp(&off(b))).filter(|_| here.is_empty());
            let nearest =
                nearest.map(|stone| known(stone, (stone.deviation_m * ALIKE).max(NEAR_M) + ASTRAY * off(&stone)));
            here.into_iter().chain(nearest).collect()
        };
        let mut places: Vec<Vec<Known>> = found.stones.iter().map(of).collect();
        places.dedup();
        Stretch { shown, kept, known: places, is_mirrored: false }
    };
    (0..count).map(stretch).collect()
}

/// The pose of a car on the line to drive, so many metres along the road that it drives. The other way round, the car keeps to its
/// own right, which is the road's left.
pub(super) fn pose(track: &Track, road: &Road, s_m: f64) -> Pose {
    let point = track.on_driving_line(road.on_track(s_m));
    let s_m = track.locate(point.position, None).station.s;
    let (offset_m, heading_rad) =
        if road.reversed { (-point.offset, std::f64::consts::PI) } else { (point.offset, 0.0) };
    Pose { s_m, offset_m, heading_rad, pitch_rad: 0.0 }
}
