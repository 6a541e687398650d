//! Lessons along a located recording: the driver drives, and the log holds the warped pictures with what the expert would
//! do.

use std::sync::Arc;

use super::{
    Disagreement, RecordError, RecordReport,
    log::{Moment, Rows},
};
use crate::{along::RecordedWorld, expert::LaneExpert, world::Ending};
use lapwing_core::{
    drive::{self, Observer, ObserverError},
    driver::Driver,
    protocol::{Answer, CameraImage, Command},
    recording::udacity::DrivingLogWriter,
    turn::Turn,
};

/// Lets a driver drive along a recording, as far as its place in the lane is known, and logs each moment. Where the place
/// is not known, nothing is logged. `is_over` ends the drive.
///
/// # Errors
/// [`RecordError`] where a picture cannot be read or the log cannot be written.
pub fn along(
    world: &mut RecordedWorld,
    driver: &mut Driver,
    log: DrivingLogWriter,
    is_over: impl Fn() -> bool,
) -> Result<RecordReport, RecordError> {
    let expert = world.located().map(|drive| LaneExpert::new(Arc::clone(&drive.track))).transpose()?;
    let last = world.located().and_then(|drive| drive.places.iter().rposition(Option::is_some));
    let mut written = AlongLog {
        rows: Rows::new(log),
        expert,
        last: last.unwrap_or(0),
        before: None,
        apart: Disagreement::default(),
        ended: false,
        is_over,
    };
    drive::run(world, driver, &mut [&mut written]).map_err(RecordError::of)?;
    let AlongLog { rows, apart, is_over, .. } = written;
    let ending = if is_over() { Ending::Interrupted } else { Ending::LapsDone };
    Ok(RecordReport {
        rows: rows.finish()?,
        laps: 0,
        ending,
        put_back: world.interventions(),
        disagreement: apart.rms(),
    })
}

struct AlongLog<F> {
    rows: Rows,
    expert: Option<LaneExpert>,
    /// The last picture whose place is known.
    last: usize,
    /// The picture before this one, and how often the car had been put back.
    before: Option<(usize, u32)>,
    apart: Disagreement,
    ended: bool,
    is_over: F,
}

impl<F: Fn() -> bool> Observer<RecordedWorld> for AlongLog<F> {
    fn turn(&mut self, world: &RecordedWorld, turn: &Turn) -> Result<(), ObserverError> {
        let Some(picture) = world.picture_number() else { return Ok(()) };
        self.ended = picture >= self.last;
        let known = world.pose().zip(world.located()).zip(turn.telemetry()).zip(self.expert.as_mut());
        let Some((((pose, drive), telemetry), expert)) = known else { return Ok(()) };
        let CameraImage::Jpeg(jpeg) = &telemetry.image else { return Ok(()) };
        let steering = expert.steering(pose, telemetry.speed);
        if let Answer::Steer(command) = turn.answer {
            self.apart.add(command.steering, steering);
        }
        let now = (picture, world.interventions());
        if self.before.replace(now).is_some_and(|(before, put_back)| (before + 1, put_back) != now) {
            self.rows.cut();
        }
        self.rows.write(&Moment {
            at: turn.at(),
            center: jpeg,
            sides: None,
            label: Command { steering, throttle: telemetry.throttle },
            speed: telemetry.speed,
            track: &drive.track,
            pose,
        })?;
        Ok(())
    }

    fn has_seen_enough(&self) -> bool {
        self.ended || (self.is_over)()
    }
}
