//! How a keyboard steers in a driving log.
//!
//! A key moves the steering towards full lock while it is pressed. When it is released, the steering goes back as fast in most
//! builds of the stock simulator, and in some it is zero at once. Those read the keys once a picture, as they record: what
//! a row tells was steered up to that row and no longer.

use std::ops::Range;

use super::{Break, By, Moment, Recording, RecordingError, RunKind};

/// Rows that are compared lie no farther apart, in seconds.
const NEXT_S: f64 = 0.3;
/// The steering, of 1, from which no key goes back to zero gradually in that time without being seen on its way.
const FAR: f64 = 0.4;
/// So many releases must tell it.
const ENOUGH: usize = 10;

/// The rows of the drives by hand whose steering is zero at once when a key is released. `joins` says after which breaks
/// another drive begins, perhaps in another build. Only driving logs tell, and runs converted from them: other runs do not
/// hold what a human steered, so nothing is read from them.
///
/// # Errors
/// What cannot be read of the recording.
pub fn released_at_once(
    recording: Recording,
    joins: impl Fn(Break) -> bool,
) -> Result<Vec<Range<usize>>, RecordingError> {
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
            releases.between(was, is);
        }
        before = now;
    }
    drives.push((drive, releases));
    Ok(drives.into_iter().filter(|(_, releases)| releases.at_once()).map(|(drive, _)| drive).collect())
}

/// The mean of what was steered between two rows, if a release is at once.
pub(super) fn mean(was: f64, is: f64) -> f64 {
    let pressed_on = was * is >= 0.0 && is.abs() >= was.abs();
    if pressed_on { f64::midpoint(was, is) } else { is / 2.0 }
}

/// What a human steered from this moment on.
fn by_hand(moment: &Moment) -> Option<f64> {
    moment.command.as_ref().filter(|command| command.by == By::Human).map(|command| command.steering.get())
}

/// From far to zero, and from far to less.
#[derive(Debug, Default)]
struct Releases {
    at_once: usize,
    gradual: usize,
}

impl Releases {
    fn between(&mut self, was: f64, is: f64) {
        if was.abs() > FAR && is == 0.0 {
            self.at_once += 1;
        } else if was.abs() > FAR && was * is > 0.0 && is.abs() < was.abs() {
            self.gradual += 1;
        }
    }

    fn at_once(&self) -> bool {
        self.at_once >= ENOUGH && self.at_once > 4 * self.gradual
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn released(values: &[f64]) -> bool {
        let mut releases = Releases::default();
        let values = values.repeat(ENOUGH);
        values.windows(2).for_each(|pair| releases.between(pair[0], pair[1]));
        releases.at_once()
    }

    #[test]
    fn steering_that_drops_from_far_to_zero_is_released_at_once() {
        assert!(released(&[0.0, -0.15, -0.45, -0.75, -1.0, 0.0]));
        assert!(!released(&[0.0, -0.2, -0.45, -0.35, -0.1, 0.0]), "goes back gradually");
        assert!(!released(&[0.0, 0.1, 0.05, 0.0]), "too little to tell");
    }

    #[test]
    fn after_a_release_nothing_is_steered_until_the_next_row() {
        assert_eq!([mean(-0.45, -0.75), mean(0.0, 0.3), mean(1.0, 1.0)], [-0.6, 0.15, 1.0]);
        assert_eq!([mean(-0.75, 0.0), mean(-0.5, 0.3), mean(-0.5, -0.2)], [0.0, 0.15, -0.1]);
    }
}
