//! On which road a drive was, and where, by its pictures: where its bends leave several roads, or several places on one.

use std::{collections::BTreeMap, ops::Range, path::Path, sync::Arc};

use glam::DVec3;
use rayon::prelude::*;

use super::{
    FOUND, Laid, LocateError, Row, Scenes, follow, followed, mirrored,
    pictures::{Job, Pictures, Scene, decoded},
    stretch::{OnRoad, Stretch, continuous, cuts, pose},
};
use lapwing_core::{
    motion::around,
    perception::Frame,
    recording::{CameraPosition, Picture},
};
use lapwing_score::odometry::{self, Leg, Match, Milestone, NEAR_M, Road};
use lapwing_sim::{
    along::SIZE,
    locate::{Glimpse, Located, Overlay},
};

/// Rows that are looked at on each road if several explain a drive about as well; of drives in one piece of no more rows than the
/// second, all are, and from several places.
const SAMPLE: usize = 80;
const WHOLE: usize = 320;

/// By how much pictures must agree better with a road, or a place on it, than with the next. The right and the wrong one of 142 m of the
/// real lake: 0.504 and 0.496. Pictures of 110 m of its straight road agree by 0.531 with a place on the bridge, whose walls lie along
/// the edges of any straight road, and by 0.506 with the next.
const AGREES_BETTER: f64 = 0.04;

/// By how much pictures must agree better if they are mirrored. Of four mirrored drives of 400 m on the real lake by 0.03 to
/// 0.17, of three others, darker ones and fewer a second among them, worse by 0.03 to 0.12.
const MIRRORED_BETTER: f64 = 0.02;

/// So many pictures of a short drive are looked at from every place where its bends may have led, this far around: metres along the
/// road and across it, radians.
const GLANCES: usize = 5;
const AROUND: DVec3 = DVec3::new(5.0, 2.0, 0.16);
/// If the bends fit more places than this, one of them may look like the right one by chance: of 72 in the jungle, which all look
/// much alike, one in the wrong direction agreed by 0.40.
const SEARCHED: usize = 50;
/// Places so close together, in metres, are one.
const APART_M: f64 = 25.0;
/// A place from which these agree worse than from the best by more than this is none. If more than so many are left, the pictures do
/// not show the place.
const CLEARLY_WORSE: f64 = 0.04;
const PLACES: usize = 6;

/// A road that a drive was on, and where.
pub(super) struct Shown {
    pub on: OnRoad,
    pub scene: Scene,
    /// Where each picture of the centre camera was taken, if all were looked at to find out.
    pub laid: Option<Laid>,
}

/// What its pictures show of where a drive was.
pub(super) struct Sight {
    pub shown: Option<Shown>,
    /// Whether its bends fit too many places to look for it.
    pub is_vague: bool,
}

/// Whether a drive that its bends do not place is looked for wherever they may have led: a short one, driven in one piece.
pub(super) fn is_short(rows: &[Row], part: &Range<usize>) -> bool {
    part.len() <= WHOLE && continuous(rows, part.clone()).len() == 1
}

/// A drive of a recording.
pub(super) struct Drive<'a> {
    pub path: &'a Path,
    /// All rows of the recording, and those of the drive.
    pub rows: &'a [Row],
    pub part: Range<usize>,
    pub legs: &'a [Leg],
    /// The rows whose picture of the centre camera cannot be read.
    pub lost: &'a BTreeMap<usize, String>,
}

impl Drive<'_> {
    /// If its bends leave one road, that one; with the place that its pictures show if it is short, and was followed from the place
    /// that the bends tell in vain.
    pub fn on(&self, on: OnRoad, laid: Laid, scenes: &mut Scenes) -> Result<Sight, LocateError> {
        let scene = scenes.of(&on.road.name)?;
        if !is_short(self.rows, &self.part) {
            return Ok(Sight { shown: Some(Shown { on, scene, laid: None }), is_vague: false });
        }
        let by_bends = Looked { on, scene, laid, is_whole: true };
        if by_bends.share() >= FOUND {
            return Ok(Sight { shown: Some(by_bends.shown()), is_vague: false });
        }
        let (looked, is_vague) = self.look_from_places(&[&by_bends.on.road], scenes)?;
        let is_better = |it: &Looked| it.share() >= FOUND && it.mean() >= by_bends.mean() + AGREES_BETTER;
        let by_pictures = chosen(looked).filter(is_better);
        Ok(Sight { shown: Some(by_pictures.unwrap_or(by_bends).shown()), is_vague })
    }

    /// Of the roads that explain it about as well, and of the places there, the one that its pictures show.
    pub fn among(&self, likely: &[Match], scenes: &mut Scenes) -> Result<Sight, LocateError> {
        let (looked, is_vague) = if is_short(self.rows, &self.part) {
            self.look_from_places(&likely.iter().map(|on| &on.road).collect::<Vec<_>>(), scenes)?
        } else {
            let sampled = |on: &Match| Looked::sample(self, OnRoad::new(on, self.legs), scenes.of(&on.road.name)?);
            (likely.iter().map(sampled).collect::<Result<_, _>>()?, false)
        };
        Ok(Sight { shown: chosen(looked).map(Looked::shown), is_vague })
    }

    /// The road that the pictures show once they are mirrored, if they match it clearly better than they match `shown` unmirrored. Over a
    /// few hundred metres, bends and mirrored bends may both fit a road; a longer drive around a loop turns too far one way.
    pub fn mirrored_on(
        &self,
        shown: &Shown,
        likely: &Match,
        roads: &[Arc<Road>],
        scenes: &mut Scenes,
    ) -> Result<Option<Arc<Road>>, LocateError> {
        let legs: Vec<Leg> = self.legs.iter().map(|leg| Leg { motion: mirrored(leg.motion), ..*leg }).collect();
        let found = odometry::find(&legs, None, roads);
        let Some(on) = found.likely.first().filter(|on| on.evidence > likely.evidence - odometry::LIKELY) else {
            return Ok(None);
        };
        let Some(window) = surest(self, &shown.on, &shown.scene, WHOLE) else { return Ok(None) };
        let follow = |on: OnRoad, scene: Scene, stretch: Stretch| Looked::over(self, on, scene, Some(stretch));
        let rows = window.shown.clone();
        let plain = follow(shown.on.clone(), shown.scene.clone(), window)?;
        let Some(unmirrored) = plain.agreement() else { return Ok(None) };
        // The same rows, so that what no road explains is in both.
        let scene = scenes.of(&on.road.name)?;
        let mirrored_on = OnRoad::new(on, &legs);
        let stretches = cuts(&self.part, self.rows, &mirrored_on, &scene.0);
        let Some(same) = stretches.iter().find_map(|stretch| stretch.only(rows.clone())) else { return Ok(None) };
        let flipped = follow(mirrored_on, scene, Stretch { is_mirrored: true, ..same })?;
        let is_better = flipped.share() >= FOUND && flipped.mean() >= unmirrored + MIRRORED_BETTER;
        Ok(is_better.then(|| on.road.clone()))
    }

    /// Follows a short drive from each of the places that some of its pictures leave, and says whether there were too many to look at.
    fn look_from_places(&self, roads: &[&Arc<Road>], scenes: &mut Scenes) -> Result<(Vec<Looked>, bool), LocateError> {
        let ends: Vec<(&Arc<Road>, Vec<f64>)> =
            roads.iter().map(|road| (*road, odometry::ends(road, self.legs))).collect();
        let number: usize = ends.iter().map(|(_, ends)| ends.len()).sum();
        if number == 0 {
            return Ok((vec![], false));
        }
        if number > SEARCHED {
            tracing::debug!("the bends fit {number} places: too many to look at");
            return Ok((vec![], true));
        }
        let pictures = Pictures::open(self.path, CameraPosition::Center, [])?.read(&self.part)?;
        let glances = self.glances(&pictures);
        if glances.is_empty() {
            return Ok((vec![], false));
        }
        let mut seen = vec![];
        for (road, ends) in ends {
            let scene = scenes.of(&road.name)?;
            let look = |end_m: f64| {
                let mut overlay = Overlay::new(scene.0.clone(), scene.1.clone(), SIZE);
                let agrees = |glance: &Glance| {
                    let from = pose(&scene.0, road, end_m - glance.before_m);
                    overlay.glance(&glance.glimpse, from, AROUND)
                };
                let agreement = glances.iter().map(agrees).sum::<f64>() / glances.len() as f64;
                Place { road, scene: scene.clone(), end_m, agreement }
            };
            seen.extend(ends.into_par_iter().map(look).collect::<Vec<_>>());
        }
        let best = best_of(seen);
        let told = |place: &Place| format!("{} at {:.0} m: {:.4}", place.road.words(), place.end_m, place.agreement);
        tracing::debug!("pictures leave of {number} places: {}", best.iter().map(told).collect::<Vec<_>>().join("; "));
        if best.len() > PLACES {
            return Ok((vec![], false));
        }
        let way_m: f64 = self.legs.iter().map(|leg| leg.motion.way_m).sum();
        let at = |Place { road, scene, end_m, .. }: Place| {
            let stone = |glance: &Glance| {
                let way_m = way_m - glance.before_m;
                let s_m = (end_m - glance.before_m).rem_euclid(road.length_m);
                Milestone { way_m, s_m, progress_m: way_m, deviation_m: NEAR_M }
            };
            let on = OnRoad::at(road.clone(), glances.iter().map(stone).collect());
            Looked::all(self, &pictures, on, scene)
        };
        Ok((best.into_iter().map(at).collect(), false))
    }

    /// Some of its pictures, evenly spaced over its way.
    fn glances(&self, pictures: &[Option<Picture>]) -> Vec<Glance> {
        let mut before_m = 0.0;
        let mut readable = vec![];
        for (i, picture) in self.part.clone().zip(pictures).rev() {
            readable
                .extend(picture.as_ref().filter(|_| !self.lost.contains_key(&i)).map(|picture| (before_m, picture)));
            // How the car came to the first row was not on this drive.
            before_m += if i > self.part.start { self.rows[i].motion.way_m } else { 0.0 };
        }
        let mut frame = Frame::default();
        let mut glances: Vec<Glance> = vec![];
        for i in 0..GLANCES {
            let at_m = before_m * (i as f64 + 0.5) / GLANCES as f64;
            let off_m = |(before_m, _): &&(f64, &Picture)| (before_m - at_m).abs();
            let Some((before_m, picture)) = readable.iter().min_by(|a, b| off_m(a).total_cmp(&off_m(b))) else { break };
            let is_new = glances.iter().all(|glance| glance.before_m != *before_m);
            if is_new && decoded(Some(picture), &mut frame).is_ok() {
                glances.push(Glance { glimpse: Glimpse::new(&frame), before_m: *before_m });
            }
        }
        glances
    }
}

/// Where a short drive may have ended.
struct Place<'a> {
    road: &'a Arc<Road>,
    scene: Scene,
    end_m: f64,
    /// How well some pictures agree with the road as it is seen from there.
    agreement: f64,
}

impl Place<'_> {
    fn is_near(&self, other: &Place) -> bool {
        let length_m = self.road.length_m;
        Arc::ptr_eq(self.road, other.road) && around(self.end_m - other.end_m, length_m).abs() < APART_M
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

/// At most so many of a drive's rows, in one stretch, around the one whose place on a road is known best.
fn surest(drive: &Drive, on: &OnRoad, scene: &Scene, most: usize) -> Option<Stretch> {
    let deviation_m =
        |stretch: &Stretch| stretch.known.iter().flatten().map(|known| known.deviation_m).fold(f64::INFINITY, f64::min);
    let stretches = cuts(&drive.part, drive.rows, on, &scene.0).into_iter();
    let best = stretches.min_by(|a, b| deviation_m(a).total_cmp(&deviation_m(b)));
    best.map(|stretch| stretch.around_surest(most))
}

/// A picture, and how far before the drive's end it was taken, in metres driven.
struct Glance {
    glimpse: Glimpse,
    before_m: f64,
}

/// A road that was laid over the pictures of a drive, or over [`SAMPLE`] of them.
struct Looked {
    on: OnRoad,
    scene: Scene,
    laid: Laid,
    is_whole: bool,
}

impl Looked {
    /// Over all.
    fn all(drive: &Drive, pictures: &[Option<Picture>], on: OnRoad, scene: Scene) -> Self {
        let part = &drive.part;
        let job = |stretch: Stretch| {
            let of = |row: usize| pictures.get(row - part.start).cloned().flatten();
            let pictures = stretch.shown.clone().map(of).collect();
            follow(drive.rows, Job { stretch, scene: scene.clone(), pictures }, |_, _| (), &|| ())
        };
        let laid = cuts(part, drive.rows, &on, &scene.0).into_par_iter().map(job).collect();
        Self { on, scene, laid, is_whole: true }.told()
    }

    /// Over some, around the one whose place is known best.
    fn sample(drive: &Drive, on: OnRoad, scene: Scene) -> Result<Self, LocateError> {
        let stretch = surest(drive, &on, &scene, SAMPLE);
        Self::over(drive, on, scene, stretch)
    }

    /// Over those of a stretch.
    fn over(drive: &Drive, on: OnRoad, scene: Scene, stretch: Option<Stretch>) -> Result<Self, LocateError> {
        let stretches = stretch.into_iter().map(|stretch| (stretch, scene.clone()));
        let laid = followed(drive.path, drive.rows, CameraPosition::Center, stretches, |_, _| (), &|| ())?;
        Ok(Self { on, scene, laid, is_whole: false }.told())
    }

    fn told(self) -> Self {
        tracing::debug!("{}: {:.2} located, agreement {:.4}", self.on.road.words(), self.share(), self.mean());
        self
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
        Shown { on: self.on, scene: self.scene, laid: self.is_whole.then_some(self.laid) }
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
