//! On which road a drive was, and which way round: by its bends, and by what its start looks like.

use std::sync::Arc;

use super::{rows::Row, stretch::NEAR_M};
use crate::known::Roads;
use lapwing_core::{
    motion::{Motion, around},
    recording::Break,
};
use lapwing_score::odometry::{Look, Match, Matcher, Milestone, Road};
use lapwing_sim::track::TrackError;

/// The seed of the particles: the same recording is always located alike.
const SEED: u64 = 0;
/// Roads that explain a drive worse than the best by less than this, as a log likelihood, may be the one.
const LIKELY: f64 = 15.0;
/// Places told from before and behind are compared within so many metres driven, and contradict one another if they are this
/// many standard deviations apart.
const ALONGSIDE_M: f64 = 40.0;
const CONTRADICTS: f64 = 3.0;
/// How far the mean of the speeds before and after a gap may be from the mean speed in it, in m/s.
const UNSEEN_MPS: f64 = 2.5;
/// How far a car that is put back may be from where it was, as a standard deviation in metres.
const PUT_BACK_M: f64 = 20.0;

/// The road that a drive was on.
pub(super) struct Found {
    pub road: Arc<Road>,
    /// How well its bends explain the drive, as a log likelihood.
    pub evidence: f64,
    /// Where the car was on the way: by the bends before and behind each place, where they agree; by those before it; and by
    /// those behind it.
    pub stones: [Vec<Milestone>; 3],
}

/// The roads that a drive may have been on, by its bends or by what its start looks like; the likeliest first.
pub(super) fn found(rows: &[Row], first: Option<&Look>, roads: &Roads) -> Result<Vec<Found>, TrackError> {
    let agrees = |road: &&Arc<Road>| road.start.as_ref().zip(first).map_or(0.0, |(start, look)| start.agrees(look));
    let known = roads.both_ways()?;
    let start = known.iter().max_by(|a, b| agrees(a).total_cmp(&agrees(b))).filter(|road| agrees(road) >= Look::SAME);
    let matcher =
        start.map_or_else(|| Matcher::new(known.iter().cloned(), SEED), |road| Matcher::at_start(road.clone(), SEED));
    let matches = followed(matcher, rows.iter().skip(1).map(|row| (row, false)));
    let most = matches.first().map_or(0.0, |best| best.evidence);
    let likely = matches.into_iter().filter(|on| on.explains && on.evidence > most - LIKELY);
    Ok(likely.map(|on| both_ways(on, rows)).collect())
}

/// The bends behind a place tell it as well as those before it: the same drive, from its end to its beginning.
fn both_ways(on: Match, rows: &[Row]) -> Found {
    let (length_m, way_m) = (on.road.length_m, rows.iter().skip(1).map(|row| row.motion.way_m).sum::<f64>());
    let back = Matcher::new([Arc::new(on.road.reversed())], SEED);
    let back = followed(back, rows.windows(2).rev().map(|pair| (&pair[1], true))).into_iter().next();
    let turned = |stone: &Milestone| Milestone { way_m: way_m - stone.way_m, s_m: length_m - stone.s_m, ..*stone };
    let behind =
        back.filter(|back| back.explains).map_or_else(Vec::new, |back| back.trail.iter().map(turned).collect());
    let agreed = surest(&on.trail, &behind, length_m);
    Found { road: on.road, evidence: on.evidence, stones: [agreed, on.trail, behind] }
}

/// Follows rows, each forwards or backwards.
fn followed<'a>(mut matcher: Matcher, rows: impl Iterator<Item = (&'a Row, bool)>) -> Vec<Match> {
    for (row, backwards) in rows {
        let Motion { way_m, turn_rad } = row.motion;
        match row.broken {
            Some(Break::PutBack) => matcher.skip(0.0, PUT_BACK_M),
            Some(_) => matcher.skip(way_m, UNSEEN_MPS * row.apart_s),
            None => matcher.step(Motion { way_m, turn_rad: if backwards { -turn_rad } else { turn_rad } }),
        }
    }
    matcher.matches()
}

/// Of the places that the bends before and those behind tell, the surer one; none where they contradict one another.
fn surest(before: &[Milestone], behind: &[Milestone], length_m: f64) -> Vec<Milestone> {
    let nearest = |stone: &Milestone, of: &[Milestone]| {
        let off = |other: &Milestone| (other.way_m - stone.way_m).abs();
        of.iter().min_by(|a, b| off(a).total_cmp(&off(b))).copied().filter(|other| off(other) < ALONGSIDE_M)
    };
    let surer = |stone: &&Milestone, of: &[Milestone]| {
        nearest(stone, of).is_none_or(|other| {
            let off_m = around(stone.s_m - stone.way_m - other.s_m + other.way_m, length_m).abs();
            let unsure_m = NEAR_M + stone.deviation_m.hypot(other.deviation_m);
            off_m < CONTRADICTS * unsure_m && stone.deviation_m <= other.deviation_m
        })
    };
    let surest = before.iter().filter(|stone| surer(stone, behind));
    surest.chain(behind.iter().filter(|stone| surer(stone, before))).copied().collect()
}
