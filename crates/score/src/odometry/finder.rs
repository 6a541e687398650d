//! On which road a drive was, which way round, and where: by its bends, and by what its start looks like.

use std::sync::Arc;

use super::{
    Look, Match, Matcher, Milestone, Road,
    filter::{EXPLAINED, VAGUE_M},
};
use lapwing_core::{
    motion::{Motion, around},
    recording::Break,
};

/// The seed of the particles: the same drive is always found alike.
const SEED: u64 = 0;
/// A road counts as found if it explains the drive better than every other by this much, as a log likelihood: 150 to 1.
pub const SURE: f64 = 5.0;
/// Metres of road needed to recognise it by its bends if no picture shows the start.
pub const BENDS_M: f64 = 250.0;
/// Roads that explain a drive worse than the best by less than this, as a log likelihood, may be the one. By as much the
/// bends must speak for another road, or another place, before they outweigh what the start looks like.
pub const LIKELY: f64 = 15.0;
/// Places told from before and behind are compared if they are no farther apart than this, in metres driven.
const COMPARED_M: f64 = 150.0;
/// They contradict one another if they are this many standard deviations apart, besides …
const CONTRADICTS: f64 = 3.0;
/// … what a place is unsure at best, in metres, and how wrong the way between them may be.
pub const NEAR_M: f64 = 5.0;
/// Of places so close together, the less sure one does not count, in metres driven.
const ALONGSIDE_M: f64 = 40.0;
/// How wrong the distance driven may be, as a share.
pub const ASTRAY: f64 = 0.1;
/// How far the mean of the speeds before and after a gap may be from the mean speed in it, in m/s.
const UNSEEN_MPS: f64 = 2.5;
/// How far a car that is put back may be from where it was, as a standard deviation in metres.
const PUT_BACK_M: f64 = 20.0;
/// How far from a road's start a car may have been turned round, as a standard deviation in metres: a guess.
const TURNED_M: f64 = 10.0;
/// What a drive's start looks like counts only for one that sets off from there: others begin anywhere, and many places look a
/// little like a road's start. For this many seconds …
const BEGINS_S: f64 = 0.5;
/// … it is no faster than this on average, in m/s: at full throttle the stock car gains 5 m/s each second, which is 1.25 m/s …
const SETS_OFF_MPS: f64 = 3.0;
/// … and in all it goes at least this far, in metres.
const LEAST_M: f64 = 5.0;
/// If another start agrees with the picture within this much of the best one, the bends decide. A guess: in random weather, a start agrees
/// with itself by 0.33 to 1.
const ALIKE: f64 = 0.1;
/// A road is not believed if the car would have gone more or less than this many times as far there as its speed says. Real recordings
/// that are found by their bends went 0.99 to 1.01; 656 m of a road that nobody knew, on the lake, 2.01.
pub const PLAUSIBLE_WAY: std::ops::RangeInclusive<f64> = 0.92..=1.08;
/// A longer gap, in seconds, says nothing about where the car went on.
const FORGOTTEN_S: f64 = 20.0;

/// How a car came to a moment from the one before.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Leg {
    /// How far it went and how it turned.
    pub motion: Motion,
    /// Seconds since that moment.
    pub apart_s: f64,
    /// Why it does not continue from there.
    pub broken: Option<Break>,
}

/// A drive that is shorter than this, in metres, may be on the best road although that does not explain it.
const SHORT_M: f64 = 2.0 * BENDS_M;

/// A road that falls short of explaining a drive by no more than this may be the one: clean pieces of known roads of up to 370 m
/// were explained by -2.7, roads that nobody knows by -2.6 at best.
const NEARLY: f64 = 0.5;

/// Whether a road that explains a drive of this length only so well may be the one all the same.
pub fn is_nearly(way_m: f64, fit: f64) -> bool {
    way_m < SHORT_M || nearly_explains(fit)
}

/// Whether a road that explains a drive only so well nearly explains it.
pub fn nearly_explains(fit: f64) -> bool {
    fit > EXPLAINED - NEARLY
}

/// Whether another drive begins after this break: nothing that is known of the one says anything of the other.
pub fn joins(broken: Break) -> bool {
    match broken {
        Break::Joined | Break::Back(_) => true,
        Break::Gap(passed) => passed.as_secs_f64() > FORGOTTEN_S,
        Break::PutBack | Break::TakenOver | Break::Unseen(_) => false,
    }
}

/// The roads that may have been driven, and how well each explains the drive.
#[derive(Debug, Clone, Default)]
pub struct Found {
    /// Those that explain it, the likeliest first; the next are about as likely. By the look of the start: those that look like it, which
    /// may explain it a little less well.
    pub likely: Vec<Match>,
    /// All that were tried, the best first.
    pub tried: Vec<Tried>,
    /// Whether the drive begins where the likeliest road does, by the look of it.
    pub by_start: bool,
}

/// How well a road explains a drive.
#[derive(Debug, Clone)]
pub struct Tried {
    /// The road, in the direction that was tried.
    pub road: Arc<Road>,
    /// See [`Match::fit`].
    pub fit: f64,
    /// By how much it explains the drive worse than the best road, as a log likelihood; more than this, if it was given up.
    pub behind: f64,
    /// Whether that is well enough for the road to be the one.
    pub explains: bool,
}

impl Found {
    /// The road, if no other explains the drive about as well.
    pub fn sure(&self) -> Option<&Match> {
        let best = self.likely.first()?;
        self.likely.get(1).is_none_or(|next| best.evidence - next.evidence > SURE).then_some(best)
    }

    /// The same, or in words why the road is unknown.
    ///
    /// # Errors
    /// If no road explains the drive, or several do about as well.
    pub fn road(&self) -> Result<&Match, String> {
        let Some(best) = self.likely.first() else {
            return Err(self.tried.first().map_or_else(
                || "no road is known".to_owned(),
                |nearest| {
                    let least = format!("the right road explains a drive by more than {EXPLAINED}");
                    let (words, fit) = (nearest.road.words(), nearest.fit);
                    format!("the nearest, {words}, explains it by {fit:.1} each 10 m; {least}")
                },
            ));
        };
        let next = self.likely.get(1).map_or_else(String::new, |next| next.road.words());
        self.sure().ok_or_else(|| format!("{}, or {next}: both explain it about as well", best.road.words()))
    }
}

/// The roads that a drive may have been on: its legs, what it looks like where it begins, and roads in each direction in
/// which they may be driven.
pub fn find(legs: &[Leg], first: Option<&Look>, roads: &[Arc<Road>]) -> Found {
    let free = followed(Matcher::new(roads.iter().cloned(), SEED), legs.iter().map(|leg| (leg, false)));
    let most = free.first().map_or(0.0, |best| best.evidence);
    let tried =
        |on: &Match| Tried { road: on.road.clone(), fit: on.fit(), behind: most - on.evidence, explains: on.explains };
    let all: Vec<Tried> = free.iter().map(tried).collect();
    let likely: Vec<Match> = free.into_iter().filter(|on| on.explains && on.evidence > most - LIKELY).collect();
    let first = first.filter(|_| sets_off(legs));
    let agrees = |road: &Arc<Road>| road.start.as_ref().zip(first).map_or(0.0, |(start, look)| start.agrees(look));
    let alike = roads.iter().map(agrees).fold(Look::SAME, |most, agrees| most.max(agrees - ALIKE));
    let is_short = way_m(legs) <= BENDS_M;
    let from_start = |road: &Arc<Road>| {
        let matcher = Matcher::at_start(road.clone(), SEED);
        let on = followed(matcher, legs.iter().map(|leg| (leg, false))).into_iter().next()?;
        // Perhaps by the same road, elsewhere: many places along a road look a little like its start.
        let contradicted = likely.first().is_some_and(|best| best.evidence > on.evidence + LIKELY);
        // Who begins at the start of a road may leave it later, and is on it all the same.
        ((is_short || nearly_explains(on.fit())) && !contradicted).then_some(on)
    };
    let mut by_start: Vec<_> = roads.iter().filter(|road| agrees(road) >= alike).filter_map(from_start).collect();
    by_start.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    match by_start[..] {
        [] => Found { likely, tried: all, by_start: false },
        _ => Found { likely: by_start, tried: all, by_start: true },
    }
}

/// Whether a drive begins from rest, or nearly, and then goes somewhere.
fn sets_off(legs: &[Leg]) -> bool {
    let (mut began_s, mut began_m) = (0.0, 0.0);
    for leg in legs {
        began_s += leg.apart_s;
        began_m += leg.motion.way_m;
        if began_s >= BEGINS_S {
            break;
        }
    }
    began_m <= SETS_OFF_MPS * began_s && way_m(legs) >= LEAST_M
}

/// Where a drive was on the way, as told in three ways: by the bends before and behind each place, where they agree; by those
/// before it; and by those behind it.
pub fn both_ways(on: &Match, legs: &[Leg]) -> [Vec<Milestone>; 3] {
    let (length_m, way_m) = (on.road.length_m, way_m(legs));
    let turned = |stone: &Milestone| Milestone { way_m: way_m - stone.way_m, s_m: length_m - stone.s_m, ..*stone };
    let behind = back(on, legs).map_or_else(Vec::new, |back| back.trail.iter().map(turned).collect());
    [surest(&on.trail, &behind, length_m), on.trail.clone(), behind]
}

/// Where a drive may have ended, in metres along this road, if it was there: by its bends alone, the likeliest place first, and some 10 m
/// apart.
pub fn ends(road: &Arc<Road>, legs: &[Leg]) -> Vec<f64> {
    let mut matcher = Matcher::new([road.clone()], SEED);
    follow(&mut matcher, legs.iter().map(|leg| (leg, false)));
    matcher.places().pop().unwrap_or_default()
}

/// How far legs go in all, in metres.
fn way_m(legs: &[Leg]) -> f64 {
    legs.iter().map(|leg| leg.motion.way_m).sum()
}

/// The same drive, from its end to its beginning, along the road the other way round.
fn back(on: &Match, legs: &[Leg]) -> Option<Match> {
    let matcher = Matcher::new([Arc::new(on.road.reversed())], SEED);
    followed(matcher, legs.iter().rev().map(|leg| (leg, true))).into_iter().next().filter(|back| back.explains)
}

impl Match {
    /// The same, with what was driven along the road counted from where the drive began to where it was. A filter that loses
    /// and finds the car again has lost count of some metres. `by_start` says that it began at the road's start, or, the other
    /// way round, near it; where the bends tell it more exactly, from the drive's end to its beginning, they count.
    pub fn counted_from_its_start(mut self, by_start: bool, legs: &[Leg]) -> Self {
        let length_m = self.road.length_m;
        let began = if by_start && !self.road.reversed {
            Some((self.road.start_m, 0.0))
        } else {
            let back = back(&self, legs).map(|back| (length_m - back.place.s_m, back.place.deviation_m));
            // Who drives the other way round has turned the car, and so began somewhere about the start.
            let turned = by_start.then_some((self.road.start_m, TURNED_M));
            back.into_iter().chain(turned).min_by(|a, b| a.1.total_cmp(&b.1))
        };
        let Some((began_m, deviation_m)) = began.filter(|(_, deviation_m)| *deviation_m < VAGUE_M) else {
            self.place.deviation_m = self.place.deviation_m.max(VAGUE_M);
            return self;
        };
        let counted = |s_m: f64, progress_m: f64| progress_m + around(s_m - began_m - progress_m, length_m);
        let progress_m = counted(self.place.s_m, self.place.progress_m);
        // Beyond this, one of the two ways found it elsewhere: what it has gone may be wrong in both.
        let unsure_m = CONTRADICTS * (NEAR_M + deviation_m.hypot(self.place.deviation_m));
        let most_m = (unsure_m + 2.0 * ASTRAY * way_m(legs)).min(length_m / 4.0);
        let off_m = progress_m - self.place.progress_m;
        if off_m.abs() > most_m {
            self.place.deviation_m = self.place.deviation_m.max(VAGUE_M).max(off_m.abs() / 2.0);
            self.sure_m += off_m.min(0.0);
            return self;
        }
        for stone in &mut self.trail {
            stone.progress_m = counted(stone.s_m, stone.progress_m);
            stone.deviation_m = stone.deviation_m.hypot(deviation_m);
        }
        self.sure_m += off_m.min(0.0);
        self.place.progress_m = progress_m;
        self.place.deviation_m = self.place.deviation_m.hypot(deviation_m);
        self
    }
}

/// Follows legs, each forwards or backwards.
fn followed<'a>(mut matcher: Matcher, legs: impl Iterator<Item = (&'a Leg, bool)>) -> Vec<Match> {
    follow(&mut matcher, legs);
    matcher.matches()
}

fn follow<'a>(matcher: &mut Matcher, legs: impl Iterator<Item = (&'a Leg, bool)>) {
    for (leg, backwards) in legs {
        let Motion { way_m, turn_rad } = leg.motion;
        let unseen_m = UNSEEN_MPS * leg.apart_s;
        match leg.broken {
            Some(Break::PutBack) => matcher.skip(0.0, PUT_BACK_M),
            // The clock of a driving log leaves out the time of a gap.
            Some(Break::Gap(passed)) if passed.as_secs_f64() > 2.0 * leg.apart_s => {
                matcher.skip(way_m, unseen_m.max(way_m / leg.apart_s.max(1e-3) * passed.as_secs_f64()));
            }
            Some(Break::Unseen(_)) | None => {
                matcher.step(Motion { way_m, turn_rad: if backwards { -turn_rad } else { turn_rad } });
            }
            Some(_) => matcher.skip(way_m, unseen_m),
        }
    }
}

/// Of the places that the bends before and those behind tell, the surer one; none where they contradict one another. They may
/// do so without lying side by side: a car does not leap.
fn surest(before: &[Milestone], behind: &[Milestone], length_m: f64) -> Vec<Milestone> {
    let apart_m = |stone: &Milestone, other: &Milestone| (other.way_m - stone.way_m).abs();
    let nearest = |stone: &Milestone, of: &[Milestone]| {
        let nearest = of.iter().min_by(|a, b| apart_m(stone, a).total_cmp(&apart_m(stone, b)));
        nearest.copied().filter(|other| apart_m(stone, other) < COMPARED_M)
    };
    let surer = |stone: &&Milestone, of: &[Milestone]| {
        nearest(stone, of).is_none_or(|other| {
            let off_m = around(stone.s_m - stone.way_m - other.s_m + other.way_m, length_m).abs();
            let unsure_m = NEAR_M + stone.deviation_m.hypot(other.deviation_m);
            let agrees = off_m < CONTRADICTS * unsure_m + ASTRAY * apart_m(stone, &other);
            agrees && (stone.deviation_m <= other.deviation_m || apart_m(stone, &other) > ALONGSIDE_M)
        })
    };
    let surest = before.iter().filter(|stone| surer(stone, behind));
    surest.chain(behind.iter().filter(|stone| surer(stone, before))).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stone(way_m: f64, s_m: f64) -> Milestone {
        Milestone { way_m, s_m, progress_m: way_m, deviation_m: 3.0 }
    }

    fn ways(stones: &[Milestone]) -> Vec<f64> {
        stones.iter().map(|stone| stone.way_m).collect()
    }

    #[test]
    fn places_from_before_and_behind_that_a_car_would_have_to_leap_between_do_not_count() {
        // The bends behind tell the first 100 m, those before the rest.
        let before = [stone(128.0, 554.0), stone(150.0, 575.0), stone(240.0, 664.0)];
        let agreeing = [stone(83.0, 512.0), stone(19.0, 446.0)];
        assert_eq!(ways(&surest(&before, &agreeing, 1138.0)), [128.0, 150.0, 240.0, 83.0, 19.0]);
        let elsewhere = [stone(83.0, 41.0), stone(19.0, 1115.0)];
        assert_eq!(ways(&surest(&before, &elsewhere, 1138.0)), [240.0], "too far from any that contradicts it");
    }

    #[test]
    fn who_gives_full_throttle_from_rest_sets_off_whenever_pictures_come_and_who_rolls_by_does_not() {
        let legs = |from_mps: f64, first_s: f64, apart_s: f64| -> Vec<Leg> {
            let way_m = |at_s: f64| from_mps * at_s + 5.0 / 2.0 * at_s * at_s;
            let moments: Vec<f64> =
                (0..30).map(|i| if i == 0 { 0.0 } else { first_s + f64::from(i - 1) * apart_s }).collect();
            let leg = |pair: &[f64]| {
                let motion = Motion { way_m: way_m(pair[1]) - way_m(pair[0]), turn_rad: 0.0 };
                Leg { motion, apart_s: pair[1] - pair[0], broken: None }
            };
            moments.windows(2).map(leg).collect()
        };
        for apart_s in [0.05, 0.1, 0.17, 0.3, 0.5] {
            for first_s in [0.02, 0.11, 0.17, 0.4] {
                assert!(sets_off(&legs(0.0, first_s, apart_s)), "{first_s} s, then every {apart_s} s");
                assert!(!sets_off(&legs(4.0, first_s, apart_s)), "{first_s} s, then every {apart_s} s");
            }
        }
        assert!(!sets_off(&legs(0.0, 0.1, 0.1)[..9]), "2 m in all");
    }

    #[test]
    fn of_places_side_by_side_the_surer_one_counts() {
        let (before, mut behind) = ([stone(100.0, 100.0)], [stone(110.0, 112.0)]);
        behind[0].deviation_m = 2.0;
        assert_eq!(ways(&surest(&before, &behind, 1138.0)), [110.0]);
        behind[0].s_m = 200.0;
        assert_eq!(ways(&surest(&before, &behind, 1138.0)), [0.0; 0]);
    }
}
