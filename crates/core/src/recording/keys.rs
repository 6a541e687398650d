//! How a keyboard steers in a driving log.
//!
//! A key moves the steering towards full lock while it is pressed. When it is released, the steering goes back as fast in most
//! builds of the stock simulator, and in some it is zero at once. In those the steering grows by a twentieth of full lock with each
//! step of the physics, and the keys are read once a drawn frame. Some builds record one row per frame: a row's steering then held up to
//! that row, and no longer. Others draw two frames between most rows, so half of the releases come halfway. The first value after a
//! press tells which: it is what the steering gains in the time between two rows, or in half of it. With more frames between rows, or
//! rows left out, up to a tenth of the steering is missed.

use std::ops::Range;

use super::{Break, By, LONGEST_GAP, Moment, Recording, RecordingError, RunKind};

/// Rows that are compared lie no farther apart, in seconds.
const NEXT_S: f64 = 0.3;
/// The steering, of 1, from which no key goes back to zero gradually in that time without being seen on its way.
const FAR: f64 = 0.4;
/// So many releases must tell it, and so many presses that there are two frames between rows.
const ENOUGH: usize = 10;
/// A step of the physics, in seconds, and how much of full lock the steering grows in it while a key is pressed.
const STEP_S: f64 = 0.02;
const GROWTH_PER_STEP: f64 = 0.05;
/// Rows that are farther apart than this, in seconds, have two frames between them, if there are two anywhere: the real
/// jungle's are 0.07 s or 0.12 s apart.
const TWO_FRAMES_S: f64 = 0.095;
/// A first value of less than this share of what grows between two rows shows a key that was pressed halfway between them.
const HALFWAY: f64 = 0.75;

/// A drive by hand whose steering is zero at once when a key is released.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReleasedAtOnce {
    /// Its rows.
    pub rows: Range<usize>,
    /// Whether keys are read halfway between most rows, too.
    pub two_frames_per_row: bool,
}

/// The drives by hand whose steering is zero at once when a key is released. `joins` says after which breaks
/// another drive begins, perhaps in another build. Only driving logs tell, and runs converted from them: other runs do not
/// hold what a human steered, so nothing is read from them.
///
/// # Errors
/// What cannot be read of the recording.
pub fn released_at_once(
    recording: Recording,
    joins: impl Fn(Break) -> bool,
) -> Result<Vec<ReleasedAtOnce>, RecordingError> {
    if recording.header().kind != RunKind::DrivingLog {
        return Ok(vec![]);
    }
    let (mut drives, mut drive, mut releases, mut before) = (vec![], 0..0, Releases::default(), None);
    for moment in recording {
        let moment = moment?;
        if moment.broken.is_some_and(&joins) {
            drives.push((drive, std::mem::take(&mut releases)));
            drive = moment.row..moment.row;
        }
        drive.end = moment.row + 1;
        let now = by_hand(&moment).map(|steering| (moment.at.as_secs_f64(), steering));
        if let (Some((then_s, was)), Some((now_s, is)), None) = (before, now, moment.broken)
            && now_s - then_s < NEXT_S
        {
            releases.between(was, is, now_s - then_s);
        }
        before = now;
    }
    drives.push((drive, releases));
    let at_once = drives.into_iter().filter(|(_, releases)| releases.at_once());
    Ok(at_once
        .map(|(rows, releases)| ReleasedAtOnce { rows, two_frames_per_row: releases.two_frames_per_row() })
        .collect())
}

impl ReleasedAtOnce {
    /// The mean of what was steered between two rows that are so many seconds apart.
    pub(super) fn mean(&self, was: f64, is: f64, apart_s: f64) -> f64 {
        let (from, to) = (was.abs(), is.abs());
        let count = steps(apart_s);
        if to == 0.0 {
            // Half of the releases come at the frame between the rows: until then the key was held.
            let held = self.two_frames_per_row && from > 0.0 && apart_s > TWO_FRAMES_S;
            return if held { was.signum() * mean_while_held(from, count / 2.0) / 4.0 } else { 0.0 };
        }
        let mean = if was * is > 0.0 && to >= from {
            let held = if to >= 1.0 { count } else { ((to - from) / GROWTH_PER_STEP).round().max(1.0) };
            mean_while_held(from, held).min(to)
        } else {
            // Another key, or this one anew: as late as its value tells.
            let held = (to / GROWTH_PER_STEP).round().clamp(1.0, count);
            mean_while_held((to - GROWTH_PER_STEP * held).max(0.0), held).min(to) * (held / count)
        };
        is.signum() * mean
    }
}

/// The steps of the physics in a time; of a gap, as many as in the longest that is none.
fn steps(apart_s: f64) -> f64 {
    (apart_s.min(LONGEST_GAP.as_secs_f64()) / STEP_S).round().max(1.0)
}

/// The mean of the steering over so many steps in which a key is held: it grows before each of them, up to full lock.
fn mean_while_held(from: f64, steps: f64) -> f64 {
    let count = steps.floor().max(1.0) as u32;
    (1..=count).map(|step| (from + GROWTH_PER_STEP * f64::from(step)).min(1.0)).sum::<f64>() / f64::from(count)
}

/// What a human steered from this moment on.
fn by_hand(moment: &Moment) -> Option<f64> {
    moment.command.as_ref().filter(|command| command.by == By::Human).map(|command| command.steering.get())
}

/// From far to zero, and from far to less; and first values after zero, in all and of keys pressed halfway between rows.
#[derive(Debug, Default)]
struct Releases {
    at_once: usize,
    gradual: usize,
    pressed: usize,
    pressed_halfway: usize,
}

impl Releases {
    fn between(&mut self, was: f64, is: f64, apart_s: f64) {
        if was == 0.0 && is != 0.0 && apart_s > TWO_FRAMES_S {
            self.pressed += 1;
            self.pressed_halfway += usize::from(is.abs() < HALFWAY * GROWTH_PER_STEP * steps(apart_s));
        }
        if was.abs() > FAR && is == 0.0 {
            self.at_once += 1;
        } else if was.abs() > FAR && was * is > 0.0 && is.abs() < was.abs() {
            self.gradual += 1;
        }
    }

    fn at_once(&self) -> bool {
        self.at_once >= ENOUGH && self.at_once > 4 * self.gradual
    }

    fn two_frames_per_row(&self) -> bool {
        self.pressed_halfway >= ENOUGH && 4 * self.pressed_halfway > self.pressed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn released(values: &[f64]) -> bool {
        let mut releases = Releases::default();
        let values = values.repeat(ENOUGH);
        values.windows(2).for_each(|pair| releases.between(pair[0], pair[1], 0.12));
        releases.at_once()
    }

    #[test]
    fn steering_that_drops_from_far_to_zero_is_released_at_once() {
        assert!(released(&[0.0, -0.15, -0.45, -0.75, -1.0, 0.0]));
        assert!(!released(&[0.0, -0.2, -0.45, -0.35, -0.1, 0.0]), "goes back gradually");
        assert!(!released(&[0.0, 0.1, 0.05, 0.0]), "too little to tell");
    }

    #[test]
    fn first_values_tell_whether_keys_are_read_halfway_between_rows() {
        let two_frames = |halfway: usize, full: usize, apart_s: f64| {
            let mut releases = Releases::default();
            (0..halfway).for_each(|_| releases.between(0.0, 0.15, apart_s));
            (0..full).for_each(|_| releases.between(0.0, -0.3, apart_s));
            releases.two_frames_per_row()
        };
        assert!(two_frames(ENOUGH, 2 * ENOUGH, 0.12));
        assert!(!two_frames(ENOUGH - 1, 2 * ENOUGH, 0.12), "too few to tell");
        assert!(!two_frames(ENOUGH, 4 * ENOUGH, 0.12), "one in four are rare taps");
        assert!(!two_frames(ENOUGH, 2 * ENOUGH, 0.08), "rows a frame apart");
    }

    /// What such a key steers, step by step, against what is said of it by its rows alone.
    #[test]
    fn what_is_steered_between_rows_adds_up_to_what_a_keyboard_steers() {
        for frames in [1_usize, 2] {
            // Six steps between rows; keys are read once a frame, for so many frames, with pauses, in turns left and right.
            let each = 6 / frames;
            let keys: Vec<f64> =
                (0..4000).map(|i| [1.0, 0.0, -1.0, 0.0, 0.0][i / 7 % 5] * f64::from(i % 11 != 0)).collect();
            let (mut steering, mut sum, mut told, mut row) = (0.0_f64, 0.0, 0.0, 0.0);
            let (mut rows, mut releases) = (vec![], Releases::default());
            for (frame, key) in keys.iter().enumerate() {
                for _ in 0..each {
                    steering = if *key == 0.0 || steering * key < 0.0 { 0.0 } else { steering };
                    steering = (steering + GROWTH_PER_STEP * key).clamp(-1.0, 1.0);
                    sum += steering.abs();
                }
                if (frame + 1) % frames == 0 {
                    releases.between(row, steering, 0.12);
                    rows.push((row, steering));
                    row = steering;
                }
            }
            assert_eq!(releases.two_frames_per_row(), frames == 2);
            let keys = ReleasedAtOnce { rows: 0..rows.len(), two_frames_per_row: frames == 2 };
            rows.iter().for_each(|(was, is)| told += keys.mean(*was, *is, 0.12).abs() * 6.0);
            let ratio: f64 = told / sum;
            let within = if frames == 1 { 1e-9 } else { 0.02 };
            assert!((ratio - 1.0).abs() < within, "{frames} frames: {ratio}");
        }
    }

    #[test]
    fn after_a_release_nothing_is_steered_until_the_next_row() {
        let keys = ReleasedAtOnce { rows: 0..9, two_frames_per_row: false };
        let mean = |was, is| (keys.mean(was, is, 0.12) * 1e3).round() / 1e3;
        assert_eq!([mean(-0.45, -0.75), mean(0.0, 0.3), mean(1.0, 1.0)], [-0.625, 0.175, 1.0]);
        assert_eq!([mean(-0.75, 0.0), mean(-0.5, 0.3), mean(-0.5, -0.2), mean(0.0, 0.0)], [0.0, 0.175, -0.083, 0.0]);
        let two = ReleasedAtOnce { two_frames_per_row: true, ..keys };
        assert_eq!([two.mean(0.5, 0.0, 0.08), (two.mean(-0.5, 0.0, 0.12) * 1e3).round()], [0.0, -150.0]);
        assert_eq!([two.mean(0.5, 0.5, 1e9), (two.mean(0.2, 1.0, f64::MAX) * 1e3).round()], [0.5, 880.0]);
    }
}
