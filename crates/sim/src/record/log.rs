//! What is written of each moment of a lesson: a row of the log, and one of the table of places.

use std::{fs, path::PathBuf, time::Duration};

use bytes::Bytes;

use super::{LANE_NAME, Lesson, RecordError};
use crate::{
    camera::{Camera, JPEG_QUALITY, Renderer, encode_jpeg},
    locate::{Pose, table},
    track::Track,
    world::Simulation,
};
use lapwing_core::{
    drive::{Observer, ObserverError},
    perception::Frame,
    protocol::{CameraImage, Command},
    recording::udacity::{DrivingLogWriter, NewRow},
    turn::Turn,
    units::{MPS_PER_MPH, Mph},
};

/// A log with its table.
pub(super) struct Rows {
    log: DrivingLogWriter,
    table: String,
}

/// A moment to write.
pub(super) struct Moment<'a> {
    pub at: Duration,
    /// The centre camera's picture, and the side cameras'.
    pub center: &'a [u8],
    pub sides: Option<&'a [Bytes; 2]>,
    /// What the expert would do.
    pub label: Command,
    pub speed: Mph,
    /// Where the car is.
    pub track: &'a Track,
    pub pose: Pose,
}

impl Rows {
    pub fn new(log: DrivingLogWriter) -> Self {
        Self { log, table: table::heading() }
    }

    /// Marks that the next row does not continue from the last one.
    pub fn cut(&mut self) {
        self.log.cut();
    }

    pub fn write(&mut self, moment: &Moment<'_>) -> Result<(), RecordError> {
        let row = self.log.rows() as usize;
        self.log.row(&NewRow {
            at: moment.at,
            center: moment.center,
            left: moment.sides.map(|[left, _]| &left[..]),
            right: moment.sides.map(|[_, right]| &right[..]),
            steering: moment.label.steering,
            throttle: moment.label.throttle,
            brake: (-moment.label.throttle.get()).max(0.0),
            speed: moment.speed,
        })?;
        self.table += &table::line(row, self.log.at().as_secs_f64(), moment.track, Some(moment.pose));
        Ok(())
    }

    pub fn finish(self) -> Result<u64, RecordError> {
        let path: PathBuf = self.log.path().with_file_name(LANE_NAME);
        let rows = self.log.finish()?;
        fs::write(&path, self.table).map_err(|source| RecordError::Lane { path, source })?;
        Ok(rows)
    }
}

/// Writes a lesson's moments.
pub(super) struct LessonLog {
    rows: Rows,
    side_cameras: bool,
    renderer: Renderer,
    frame: Frame,
}

impl LessonLog {
    pub fn new(log: DrivingLogWriter, side_cameras: bool, world: &Simulation) -> Self {
        let renderer = Renderer::new(world.setup().scenery.clone());
        Self { rows: Rows::new(log), side_cameras, renderer, frame: Frame::default() }
    }

    pub fn finish(self) -> Result<u64, RecordError> {
        self.rows.finish()
    }

    fn picture(&mut self, world: &Simulation, camera: &Camera) -> Bytes {
        world.draw(&mut self.renderer, camera, &mut self.frame);
        encode_jpeg(&self.frame, JPEG_QUALITY).into()
    }
}

impl<F> Observer<Lesson<'_, F>> for LessonLog {
    fn turn(&mut self, lesson: &Lesson<'_, F>, turn: &Turn) -> Result<(), ObserverError> {
        let Some(telemetry) = turn.telemetry() else { return Ok(()) };
        let world = lesson.simulation();
        let conditions = &world.setup().conditions;
        let is_late = conditions.latency_ms > 0.0 || conditions.dropped > 0.0;
        let center = match &telemetry.image {
            CameraImage::Jpeg(jpeg) if !is_late => jpeg.clone(),
            // The label belongs to what is to be seen now, not to what has arrived.
            _ => self.picture(world, &Camera::CENTER),
        };
        let sides =
            self.side_cameras.then(|| [&Camera::LEFT, &Camera::RIGHT].map(|camera| self.picture(world, camera)));
        if lesson.is_cut() {
            self.rows.cut();
        }
        self.rows.write(&Moment {
            at: turn.at(),
            center: &center,
            sides: sides.as_ref(),
            label: lesson.label(),
            speed: Mph::saturating(world.car().speed.abs() / MPS_PER_MPH),
            track: &world.setup().track,
            pose: Pose::of(world),
        })?;
        Ok(())
    }
}
