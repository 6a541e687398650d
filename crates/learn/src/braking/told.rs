//! What a live network is told of single frames while it learns: how near what lies ahead is, what stands in each column of the
//! picture, and where our path leads.

use tch::{Device, Kind, Reduction, TchError, Tensor};

use super::{
    episodes::Drive,
    targets::{HALF_NEAR_M, NEAREST_PER_S, Wanted},
    windows::Change,
};
use crate::nn::braking::{
    Shows,
    live::{COLUMNS, COURSE, SIZE, TOLD},
};
use lapwing_sim::{braking::Picture, collision_course::Pass};

/// A column shows something if at least so many pixels of its width, or half of it, are in the column.
const LEAST_SHARED_PX: f32 = 2.0;
/// Room beside something is limited to this range, in metres, and told in the unit below.
const ROOM_M: [f32; 2] = [-1.5, 4.0];
const ROOM_UNIT_M: f32 = 2.0;

/// What is told of B x S frames.
pub(super) struct Told {
    /// (B, S, 2) how near what lies ahead is, and (B, S, 1) whether it can be seen.
    pub near: Tensor,
    pub seen: Tensor,
    /// (B, S, 40, 5) what stands in each column, (B, S, 3) where our path leads, and (B, S, 1) whether both are known.
    pub columns: Tensor,
    pub course: Tensor,
    pub known: Tensor,
}

/// Collects what is told, frame by frame.
#[derive(Debug, Default)]
pub(super) struct Telling {
    near: Vec<f32>,
    seen: Vec<f32>,
    columns: Vec<f32>,
    course: Vec<f32>,
    known: Vec<f32>,
}

impl Telling {
    /// Adds a frame of a drive, whose picture is changed by `change`.
    pub(super) fn add(&mut self, drive: &Drive, wanted: &Wanted, frame: usize, change: Option<&Change>) {
        self.near.extend(wanted.near);
        self.seen.push(wanted.seen);
        let (mirrored, right) = change.map_or((false, 0.0), |change| (change.mirrored, change.right as f32));
        let shown = drive.shown.get(frame);
        self.known.push(f32::from(u8::from(shown.is_some())));
        match shown {
            Some(shown) => {
                self.columns.extend(stands(shown, mirrored, right));
                self.course.extend(way(shown, mirrored, right));
            }
            None => {
                self.columns.extend([0.0; COLUMNS * TOLD]);
                self.course.extend([0.0; COURSE]);
            }
        }
    }

    /// What was collected, as so many clips of the same length.
    pub(super) fn told(&self, clips: usize) -> Told {
        let size = |more: &[i64]| [&[clips as i64, (self.seen.len() / clips) as i64], more].concat();
        Told {
            near: Tensor::from_slice(&self.near).view(&size(&[2])[..]),
            seen: Tensor::from_slice(&self.seen).view(&size(&[1])[..]),
            columns: Tensor::from_slice(&self.columns).view(&size(&[COLUMNS as i64, TOLD as i64])[..]),
            course: Tensor::from_slice(&self.course).view(&size(&[COURSE as i64])[..]),
            known: Tensor::from_slice(&self.known).view(&size(&[1])[..]),
        }
    }
}

impl Told {
    pub(super) fn on(self, device: Device) -> Result<Self, TchError> {
        Ok(Self {
            near: self.near.f_to_device(device)?,
            seen: self.seen.f_to_device(device)?,
            columns: self.columns.f_to_device(device)?,
            course: self.course.f_to_device(device)?,
            known: self.known.f_to_device(device)?,
        })
    }

    /// How wrong a network is about what it was told.
    pub(super) fn error(&self, shows: &Shows) -> Result<Tensor, TchError> {
        let near = shows.near.f_sub(&self.near)?.f_square()?.f_mul(&self.seen)?.f_mean(Kind::Float)?;
        let part = |x: &Tensor, from: usize, to: usize| x.f_narrow(3, from as i64, (to - from) as i64);
        let stands = part(&self.columns, 0, 1)?;
        let is_there = part(&shows.columns, 0, 1)?.f_binary_cross_entropy_with_logits::<Tensor>(
            &stands,
            None,
            None,
            Reduction::None,
        )?;
        let is_there = is_there.f_mul(&self.known.f_unsqueeze(3)?)?.f_mean(Kind::Float)?;
        let how = part(&shows.columns, 1, TOLD)?.f_sub(&part(&self.columns, 1, TOLD)?)?.f_square()?.f_mul(&stands)?;
        let how = how.f_sum(Kind::Float)?.f_div(&stands.f_sum(Kind::Float)?.f_clamp_min(1.0)?)?;
        let way = shows.course.f_sub(&self.course)?.f_square()?.f_mul(&self.known)?.f_mean(Kind::Float)?;
        near.f_add(&is_there)?.f_add(&how)?.f_add(&way)
    }
}

/// What a network is told of each column of a frame whose picture was moved to the right by so many pixels and, if `mirrored`,
/// then mirrored: [`TOLD`] numbers for each column, all 0 where nothing stands.
fn stands(shown: &Picture, mirrored: bool, right: f32) -> [f32; COLUMNS * TOLD] {
    let mut told = [0.0; COLUMNS * TOLD];
    let (width, wide) = (SIZE[1] as f32, (SIZE[1] / COLUMNS) as f32);
    let mut outlines: Vec<_> = shown.outlines.iter().collect();
    // What is nearer hides what is behind it.
    outlines.sort_by(|a, b| b.away_m.total_cmp(&a.away_m));
    for outline in outlines {
        let [from, to] = outline.columns.map(|column| column + right);
        let [from, to] = if mirrored { [width - to, width - from] } else { [from, to] };
        for (i, told) in told.chunks_exact_mut(TOLD).enumerate() {
            let left = i as f32 * wide;
            let shared = to.min(left + wide) - from.max(left);
            if shared >= LEAST_SHARED_PX.min((to - from) / 2.0) {
                let Pass { room_m, least_m, until_s } = outline.pass;
                let room = |metres: f32| metres.clamp(ROOM_M[0], ROOM_M[1]) / ROOM_UNIT_M;
                told.copy_from_slice(&[
                    1.0,
                    HALF_NEAR_M as f32 / (HALF_NEAR_M as f32 + outline.away_m.max(0.0)),
                    room(room_m),
                    room(least_m),
                    until_s.recip().min(NEAREST_PER_S as f32),
                ]);
            }
        }
    }
    told
}

/// Where our path leads in such a picture.
fn way(shown: &Picture, mirrored: bool, right: f32) -> [f32; COURSE] {
    let moved = right / (SIZE[1] as f32 / 2.0);
    shown.course.map(|x| if mirrored { -x - moved } else { x + moved })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use lapwing_sim::braking::Outline;

    /// Somebody 15 m away on the right, and a car 5 m away that hides half of a cone behind it.
    pub(in crate::braking) fn shown() -> Picture {
        let outline = |columns, away_m, least_m, until_s| Outline {
            columns,
            away_m,
            pass: Pass { room_m: 1.0, least_m, until_s },
        };
        let outlines = vec![
            outline([203.0, 211.0], 15.0, -0.5, 2.0),
            outline([40.0, 80.0], 5.0, 9.0, f32::INFINITY),
            outline([72.0, 88.0], 20.0, 1.0, 0.1),
        ];
        Picture { outlines, course: [0.0, 0.1, 0.5], speed_mps: 10.0, until_s: 2.0, gap_m: 12.0 }
    }

    fn column(told: &[f32], i: usize) -> &[f32] {
        &told[i * TOLD..][..TOLD]
    }

    #[test]
    fn a_column_tells_the_nearest_of_what_stands_in_it() {
        let told = stands(&shown(), false, 0.0);
        let there: Vec<usize> = (0..COLUMNS).filter(|i| column(&told, *i)[0] > 0.0).collect();
        assert_eq!(there, [5, 6, 7, 8, 9, 10, 25, 26]);
        assert_eq!(column(&told, 25), [1.0, 0.25, 0.5, -0.25, 0.5]);
        assert_eq!(column(&told, 9), [1.0, 0.5, 0.5, 2.0, 0.0], "room is told up to 4 m");
        assert_eq!(column(&told, 10), [1.0, 0.2, 0.5, 0.5, 2.0]);
        assert_eq!(column(&told, 11), [0.0; TOLD]);
    }

    #[test]
    fn what_is_told_of_a_changed_picture_is_changed_as_the_picture_is() {
        let (plain, moved) = (stands(&shown(), false, 8.0), stands(&shown(), true, 8.0));
        assert_eq!(column(&plain, 26), column(&stands(&shown(), false, 0.0), 25));
        for i in 0..COLUMNS {
            assert_eq!(column(&moved, i), column(&plain, COLUMNS - 1 - i), "{i}");
        }
        assert_eq!(way(&shown(), false, 16.0), [0.1, 0.2, 0.6]);
        assert_eq!(way(&shown(), true, 16.0), [-0.1, -0.2, -0.6]);
    }
}
