//! On which road a drive was, and where, by its pictures: where its bends leave several roads, or several places on one.

use std::{ops::Range, path::Path, sync::Arc};

use glam::DVec3;
use rayon::prelude::*;

use super::{
    FOUND, Laid, LocateError, Row, Scenes, follow,
    pictures::{Pictures, Scene, decoded},
    stretch::{OnRoad, Stretch, continuous, cut, pose},
};
use lapwing_core::{
    motion::around,
    perception::Frame,
    recording::{CameraPosition, RecordingError},
};
use lapwing_score::odometry::{self, Leg, Match, Milestone};
use lapwing_sim::{
    along::SIZE,
    locate::{Glimpse, Located, Overlay},
};

/// Rows of each road that are looked at if several explain a drive about as well; of drives of no more rows than the second, all are,
/// and from several places.
const SAMPLE: usize = 80;
const WHOLE: usize = 320;

/// By how much pictures must agree better with a road, or a place on it, than with the next. The right and the wrong one of 142 m of the
/// real lake: 0.504 and 0.496. Pictures of 110 m of its straight road agree by 0.531 with a place on the bridge, whose walls lie along
/// the edges of any straight road, and by 0.506 with the next.
const AGREES_BETTER: f64 = 0.04;

/// So many pictures of a short drive are looked at from every place where its bends may have led, this far around: metres along the
/// road and across it, radians.
const GLANCES: usize = 5;
const AROUND: DVec3 = DVec3::new(5.0, 2.0, 0.16);
/// Of more places than this the bends tell too little.
const SEARCHED: usize = 250;
/// Places so close together, in metres, are one.
const APART_M: f64 = 25.0;
/// A place from which these agree worse than from the best by more than this is none. If more than so many are left, the pictures do
/// not show the place.
const CLEARLY_WORSE: f64 = 0.04;
const PLACES: usize = 6;

/// A road that a drive was on, and where.
pub(super) struct Shown {
    pub on: OnRoad,
    /// Where each picture of the centre camera was taken, if all were looked at to find out.
    pub laid: Option<Laid>,
}

/// Of the roads that explain a drive about as well, and of the places there, the one that its pictures show. If the bends leave only
/// one road, it is that in any case.
pub(super) fn shown(
    path: &Path,
    rows: &[Row],
    part: &Range<usize>,
    (likely, legs): (odometry::Found, &[Leg]),
    scenes: &mut Scenes,
) -> Result<Option<Shown>, LocateError> {
    let is_short = part.len() <= WHOLE;
    let sure = likely.sure();
    if let Some(on) = sure.filter(|_| !is_short) {
        return Ok(Some(Shown { on: OnRoad::new(on, legs), laid: None }));
    }
    let mut looked = vec![];
    if let Some(on) = sure {
        let by_bends = Looked::over(path, rows, part, (OnRoad::new(on, legs), scenes.of(&on.road.name)?))?;
        if by_bends.share() >= FOUND {
            return Ok(Some(by_bends.shown()));
        }
        for from in places(path, rows, part, (&[on], legs), scenes)? {
            looked.push(Looked::over(path, rows, part, from)?);
        }
        let by_pictures = chosen(looked).filter(|looked| looked.share() >= FOUND);
        return Ok(Some(by_pictures.unwrap_or(by_bends).shown()));
    }
    let likely: Vec<&Match> = likely.likely.iter().collect();
    if is_short {
        for from in places(path, rows, part, (&likely, legs), scenes)? {
            looked.push(Looked::over(path, rows, part, from)?);
        }
    } else {
        for on in likely {
            looked.push(Looked::over(path, rows, part, (OnRoad::new(on, legs), scenes.of(&on.road.name)?))?);
        }
    }
    Ok(chosen(looked).map(Looked::shown))
}

/// Where a short drive may have ended.
struct Place<'a> {
    on: &'a Match,
    scene: Scene,
    end: Milestone,
    /// How well some pictures agree with the road as it is seen from there.
    agreement: f64,
}

impl Place<'_> {
    fn is_near(&self, other: &Place) -> bool {
        let length_m = self.on.road.length_m;
        Arc::ptr_eq(&self.on.road, &other.on.road) && around(self.end.s_m - other.end.s_m, length_m).abs() < APART_M
    }
}

/// Of places, those that are not clearly worse than the best, the best first, and of those that are one, the best.
fn best_of(mut places: Vec<Place>) -> Vec<Place> {
    places.sort_by(|a, b| b.agreement.total_cmp(&a.agreement));
    let least = places.first().map_or(0.0, |best| best.agreement) - CLEARLY_WORSE;
    let mut apart: Vec<Place> = vec![];
    for place in places.into_iter().take_while(|place| place.agreement >= least) {
        if !apart.iter().any(|better| better.is_near(&place)) {
            apart.push(place);
        }
    }
    apart
}

/// A picture, and how far before the drive's end it was taken, in metres driven.
struct Glance {
    glimpse: Glimpse,
    before_m: f64,
}

/// Pictures evenly spaced over what was driven in one piece before a drive's end.
fn glimpses(path: &Path, rows: &[Row], part: &Range<usize>, scene: &Scene) -> Result<Vec<Glance>, RecordingError> {
    let Some(run) = continuous(rows, part.clone()).pop() else { return Ok(vec![]) };
    let stretch = Stretch { shown: run.clone(), kept: run.clone(), known: vec![] };
    let Some(job) = Pictures::open(path, CameraPosition::Center, [(stretch, scene.clone())])?.next() else {
        return Ok(vec![]);
    };
    let pictures = job?.pictures;
    let mut before_m = 0.0;
    let mut readable = vec![];
    for (row, picture) in rows[run].iter().zip(pictures).rev() {
        readable.extend(picture.map(|picture| (before_m, picture)));
        before_m += row.motion.way_m;
    }
    let mut frame = Frame::default();
    let chosen = (0..GLANCES).filter_map(|i| {
        let at_m = before_m * (i as f64 + 0.5) / GLANCES as f64;
        let nearest = readable.iter().min_by(|a, b| (a.0 - at_m).abs().total_cmp(&(b.0 - at_m).abs()))?;
        decoded(Some(&nearest.1), &mut frame).ok()?;
        Some(Glance { glimpse: Glimpse::new(&frame), before_m: nearest.0 })
    });
    Ok(chosen.collect())
}

/// Where a short drive may have been, the place first from which its pictures agree best with the road; none if they show too many
/// places alike.
fn places(
    path: &Path,
    rows: &[Row],
    part: &Range<usize>,
    (likely, legs): (&[&Match], &[Leg]),
    scenes: &mut Scenes,
) -> Result<Vec<(OnRoad, Scene)>, LocateError> {
    let Some(first) = likely.first() else { return Ok(vec![]) };
    let ends: Vec<(&Match, Vec<Milestone>)> = likely.iter().map(|on| (*on, odometry::ends(&on.road, legs))).collect();
    let number: usize = ends.iter().map(|(_, ends)| ends.len()).sum();
    if number > SEARCHED {
        tracing::debug!("the bends leave {number} places: too many to look at");
        return Ok(vec![]);
    }
    let glances = glimpses(path, rows, part, &scenes.of(&first.road.name)?)?;
    if glances.is_empty() {
        return Ok(vec![]);
    }
    let mut seen = vec![];
    for (on, ends) in ends {
        let scene = scenes.of(&on.road.name)?;
        let look = |end: Milestone| {
            let mut overlay = Overlay::new(scene.0.clone(), scene.1.clone(), SIZE);
            let agrees = |glance: &Glance| {
                let from = pose(&scene.0, &on.road, end.s_m - glance.before_m);
                overlay.glance(&glance.glimpse, from, AROUND)
            };
            let agreement = glances.iter().map(agrees).sum::<f64>() / glances.len() as f64;
            Place { on, scene: scene.clone(), end, agreement }
        };
        seen.extend(ends.into_par_iter().map(look).collect::<Vec<_>>());
    }
    let best = best_of(seen);
    let told = |place: &Place| format!("{} at {:.0} m: {:.4}", place.on.road.words(), place.end.s_m, place.agreement);
    tracing::debug!("places that pictures leave of {number}: {}", best.iter().map(told).collect::<Vec<_>>().join("; "));
    if best.len() > PLACES {
        return Ok(vec![]);
    }
    let at = |Place { on, scene, end, .. }: Place| {
        let stone = |glance: &Glance| Milestone {
            way_m: end.way_m - glance.before_m,
            s_m: (end.s_m - glance.before_m).rem_euclid(on.road.length_m),
            ..end
        };
        (OnRoad::at(on.road.clone(), glances.iter().map(stone).collect()), scene)
    };
    Ok(best.into_iter().map(at).collect())
}

/// A road that was laid over the pictures of a drive, or over [`SAMPLE`] of them if there are more than [`WHOLE`].
struct Looked {
    on: OnRoad,
    laid: Laid,
    is_whole: bool,
}

impl Looked {
    fn over(path: &Path, rows: &[Row], part: &Range<usize>, (on, scene): (OnRoad, Scene)) -> Result<Self, LocateError> {
        let runs = continuous(rows, part.clone());
        let cuts = runs.iter().flat_map(|run| cut(run, part, rows, &on, &scene.0));
        let surest = |stretch: &Stretch| {
            stretch.known.iter().flatten().map(|known| known.deviation_m).fold(f64::INFINITY, f64::min)
        };
        let is_whole = part.len() <= WHOLE;
        let looked_at: Vec<Stretch> = if is_whole {
            cuts.collect()
        } else {
            let best = cuts.min_by(|a, b| surest(a).total_cmp(&surest(b)));
            best.map(|stretch| stretch.around_surest(SAMPLE)).into_iter().collect()
        };
        let jobs = looked_at.into_iter().map(|stretch| (stretch, scene.clone()));
        let pictures = Pictures::open(path, CameraPosition::Center, jobs)?.par_bridge();
        let mut laid: Laid =
            pictures.map(|job| Ok(follow(rows, job?, |_, _| (), &|| ()))).collect::<Result<_, RecordingError>>()?;
        // In their order, so that sums are the same each time.
        laid.sort_by_key(|(of, _)| of.start);
        let looked = Self { on, laid, is_whole };
        tracing::debug!("{}: {:.2} located, agreement {:.4}", looked.on.road.words(), looked.share(), looked.mean());
        Ok(looked)
    }

    fn pictures(&self) -> f64 {
        self.laid.iter().map(|(of, _)| of.len()).sum::<usize>().max(1) as f64
    }

    fn located(&self) -> impl Iterator<Item = &Located> {
        self.laid.iter().flat_map(|(_, places)| places.iter().flatten())
    }

    /// The share of the pictures that are located.
    fn share(&self) -> f64 {
        self.located().count() as f64 / self.pictures()
    }

    /// How well those agree, over all.
    fn mean(&self) -> f64 {
        self.located().map(|located| located.fit.agreement).sum::<f64>() / self.pictures()
    }

    /// The same; none if less than half of them is located.
    fn agreement(&self) -> Option<f64> {
        (self.share() > 0.5).then(|| self.mean())
    }

    fn shown(self) -> Shown {
        Shown { on: self.on, laid: self.is_whole.then_some(self.laid) }
    }
}

/// Of roads and places, the likeliest first, the one that the pictures show.
fn chosen(mut looked: Vec<Looked>) -> Option<Looked> {
    let agreements: Vec<Option<f64>> = looked.iter().map(Looked::agreement).collect();
    best(&agreements).map(|i| looked.swap_remove(i))
}

/// Of roads and places, the likeliest first, the one that the pictures show, by how well each agrees with them: not if another agrees
/// about as well, or if a likelier one could not be seen in them: the right one may have been lost there, and another agree by chance.
pub(super) fn best(agreements: &[Option<f64>]) -> Option<usize> {
    let seen = |i: &usize| agreements[*i].unwrap_or(f64::NEG_INFINITY);
    let best = (0..agreements.len()).max_by(|a, b| seen(a).total_cmp(&seen(b)))?;
    let others = (0..agreements.len()).filter(|i| *i != best);
    let next = others.map(|i| seen(&i)).fold(f64::NEG_INFINITY, f64::max);
    (agreements[..=best].iter().all(Option::is_some) && seen(&best) - next >= AGREES_BETTER).then_some(best)
}
