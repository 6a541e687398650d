//! Which of the pictures that were taken around a place are shown there: first the one whose camera was nearest, of any lap,
//! then those that complete it. Drives along a recording and worlds made of recordings choose by this.
//!
//! *Nearest* is what costs least. The costs come from the simulator, which can draw what a camera there would have taken
//! (`cargo test --release -p lapwing-sim --lib what_a_warp_costs -- --ignored --nocapture`; 2026-11-26). Their unit is a metre
//! along the road. Mean errors in grey levels of one camera's picture, on lake, jungle and mountain:
//!
//! | the camera is | costs | above the horizon | beside the road | on the road |
//! |---|---|---|---|---|
//! | 0.5 m ahead of where the picture was taken | 0.5 | 6.5, 8.9, 5.6 | 5.8, 11.9, 6.2 | 5.7, 6.7, 3.9 |
//! | 0.3 m to the side of the nearest camera | 0.45 | 6.3, 8.1, 4.9 | 4.4, 10.2, 5.0 | 4.7, 4.6, 3.0 |
//! | turned by 4 degrees, with its car | 0.5 | 7.2, 6.0, 4.7 | 7.8, 11.7, 6.7 | 4.5, 4.9, 3.3 |
//! | 1 m ahead | 1.0 | 9.3, 11.4, 7.1 | 6.7, 15.7, 9.2 | 7.8, 9.3, 5.5 |
//! | 0.8 m to the side | 1.2 | 10.2, 11.2, 7.2 | 9.5, 17.3, 10.1 | 7.4, 7.6, 5.4 |
//! | turned by 8 degrees | 1.05 | 10.1, 8.6, 6.8 | 12.2, 17.5, 11.9 | 5.6, 6.7, 4.7 |
//! | 1 m behind | 2.0 | 9.5, 11.3, 7.2 | 11.5, 21.7, 12.3 | 13.6, 14.3, 8.7 |
//! | 2 m ahead | 2.0 | 12.9, 13.6, 8.9 | 8.2, 19.8, 13.0 | 11.4, 12.4, 7.4 |

use super::{
    flow::luminance,
    warp::{Beside, CAMERAS, PILOTNET_ROWS, SIZE},
};
use lapwing_core::perception::Frame;

/// A picture that was taken farther ahead or behind than this, in metres, is not the one that is warped first: it is of another
/// piece of road.
pub(super) const NEAR_M: f64 = 3.0;
/// A picture that was taken farther ahead or behind than this, in metres, completes no other: over such a distance the road is
/// not the plane that the warp takes it for.
pub(super) const REACH_M: f64 = 12.0;
/// Nor is a picture shown if its car was turned by more than this, in radians: it drove the other way round, or stood across.
const FACES_ELSEWHERE: f64 = 1.0;

/// What a metre behind the place where a picture was taken costs, in metres ahead of it: the ground just ahead of the bonnet is
/// not in such a picture, while a car that is ahead sees everything that it needs, only enlarged.
const BEHIND: f64 = 2.0;
/// What a metre costs to the side of the nearest camera: what stands up leans.
const ASIDE: f64 = 1.5;
/// What a radian costs: the camera sees past the picture's edge, and colours are interpolated between pixels.
const ASKEW: f64 = 6.0;
/// What another lap than the last one costs. Places found in two laps disagree by 0.15 m and half a degree (medians, on the real
/// lake), and by that the road jumps. So a lap is left only for one that is nearer by more than that.
const ANOTHER: f64 = 0.5;
/// A picture of another lap that is lighter or darker than the last one by more than this, in grey levels over PilotNet's rows, is
/// not used: it shows other weather. Two laps of the real lake, in the same light, differ by 2.0 (median) and 15.5 at most.
const ANOTHER_LIGHT: f64 = 16.0;

/// Of pictures nearer to one another than this along the road, in metres, only one is used to complete another.
const APART_M: f64 = 2.0;

/// Two rows of a recording that show the same place and are more than this many rows apart are of two laps.
const LAP: usize = 100;

/// When a moment was recorded: in which drive, and in which of its rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct When {
    pub drive: usize,
    pub row: usize,
}

impl When {
    /// Whether both are of the same lap, given that they are of the same place.
    pub(super) fn is_same_lap(self, other: Self) -> bool {
        self.drive == other.drive && self.row.abs_diff(other.row) <= LAP
    }
}

/// A moment of which there are pictures.
#[derive(Debug, Clone, Copy)]
pub(super) struct Taken {
    pub when: When,
    /// Where the car that is to see it is, beside the one that took it.
    pub beside: Beside,
    /// Which cameras took a picture.
    pub cameras: [bool; 3],
}

impl Taken {
    /// How far the seeing car's centre camera is to the side and ahead of the nearest camera that took a picture, in metres;
    /// `None` if none did.
    fn camera_apart(&self) -> Option<(f64, f64)> {
        let Beside { offset_m, ahead_m, heading_rad } = self.beside;
        let (sin, cos) = heading_rad.sin_cos();
        let from = CAMERAS[0].mount.position.z;
        let taken =
            CAMERAS.iter().zip(self.cameras).filter(|(_, taken)| *taken).map(|(camera, _)| camera.mount.position);
        let places = taken.map(|at| ((offset_m + from * sin - at.x).abs(), ahead_m + from * cos - at.z));
        places.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// How far apart these two cameras are, in metres.
    pub(super) fn apart_m(&self) -> f64 {
        self.camera_apart().map_or(0.0, |(aside_m, ahead_m)| aside_m.hypot(ahead_m))
    }

    /// What it costs, as metres along the road; `None` if it cannot be shown.
    fn cost(&self, last: Option<When>) -> Option<f64> {
        let (aside_m, ahead_m) = self.camera_apart()?;
        let turned = self.beside.heading_rad.abs();
        let is_here = ahead_m.abs() <= NEAR_M && turned <= FACES_ELSEWHERE;
        is_here.then(|| ahead_m.max(-BEHIND * ahead_m) + ASIDE * aside_m + ASKEW * turned + self.changed(last))
    }

    fn changed(&self, last: Option<When>) -> f64 {
        if last.is_some_and(|last| !last.is_same_lap(self.when)) { ANOTHER } else { 0.0 }
    }
}

/// The picture that was shown last: when it was taken, and how light it is, if that is known.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Last(Option<(When, Option<f64>)>);

impl Last {
    /// For a car that begins where this was recorded.
    pub(super) fn of(when: When) -> Self {
        Self(Some((when, None)))
    }

    /// Which of `around` are shown. The first is the one that is warped first; only those `that_lead` can be. `light` reads a
    /// moment's pictures and says how [light] the centre one is; `None` if it cannot be used.
    pub(super) fn next<T: Copy + PartialEq>(
        &mut self,
        around: &[(T, Taken)],
        that_lead: impl Fn(&Taken) -> bool,
        mut light: impl FnMut(T) -> Option<f64>,
    ) -> Vec<(T, Taken)> {
        let last = self.0.map(|(when, _)| when);
        let mut nearest: Vec<_> = around
            .iter()
            .filter(|(_, taken)| that_lead(taken))
            .filter_map(|(what, taken)| Some((taken.cost(last)?, *what, *taken)))
            .collect();
        nearest.sort_by(|a, b| a.0.total_cmp(&b.0));
        // One in any light is better than none.
        let mut usable = None;
        let first = nearest.into_iter().find_map(|(_, what, taken)| {
            let found = (what, taken, light(what)?);
            usable = usable.or(Some(found));
            self.is_lit_alike(&taken, found.2).then_some(found)
        });
        let Some((what, first, its_light)) = first.or(usable) else {
            *self = Self::default();
            return vec![];
        };
        *self = Self(Some((first.when, Some(its_light))));
        let others = completing(around.iter().copied().filter(|(other, _)| *other != what), first.when);
        let mut shown = vec![(what, first)];
        shown.extend(
            others
                .into_iter()
                .filter(|(what, taken)| light(*what).is_some_and(|light| self.is_lit_alike(taken, light))),
        );
        shown
    }

    fn is_lit_alike(&self, taken: &Taken, light: f64) -> bool {
        let Self(Some((last, Some(last_light)))) = self else { return true };
        last.is_same_lap(taken.when) || (light - last_light).abs() <= ANOTHER_LIGHT
    }
}

/// Which of these moments complete the picture of another one, the nearest first.
fn completing<T>(moments: impl Iterator<Item = (T, Taken)>, first: When) -> Vec<(T, Taken)> {
    let away = |taken: &Taken| taken.beside.ahead_m.abs() + taken.changed(Some(first));
    let is_of_use =
        |taken: &Taken| taken.beside.ahead_m.abs() <= REACH_M && taken.beside.heading_rad.abs() <= FACES_ELSEWHERE;
    let mut moments: Vec<(T, Taken)> = moments.filter(|(_, taken)| is_of_use(taken)).collect();
    moments.sort_by(|(_, a), (_, b)| away(a).total_cmp(&away(b)));
    let mut taken = vec![0.0];
    moments.retain(|(_, at)| {
        let ahead_m = at.beside.ahead_m;
        let is_apart = taken.iter().all(|other_m: &f64| (other_m - ahead_m).abs() >= APART_M);
        if is_apart {
            taken.push(ahead_m);
        }
        is_apart
    });
    moments
}

/// How light a picture is: the mean of every eighth pixel of [`PILOTNET_ROWS`], in grey levels.
pub(super) fn light(picture: &Frame) -> f64 {
    let rows = PILOTNET_ROWS.start * SIZE.0..PILOTNET_ROWS.end * SIZE.0;
    let pixels = picture.rgb().as_chunks().0.get(rows).unwrap_or_default().iter().step_by(8);
    let count = pixels.len().max(1);
    pixels.map(|pixel| f64::from(luminance(pixel))).sum::<f64>() / count as f64
}

#[cfg(test)]
#[path = "nearest_tests.rs"]
mod tests;
