//! What is written of each moment of a lesson: a row of the log, and one of the table of places.

use std::{fs, path::PathBuf, sync::Arc, time::Duration};

use bytes::Bytes;

use super::{LANE_NAME, Lesson, RecordError};
use crate::{
    camera::{Camera, JPEG_QUALITY, Renderer, Scenery, encode_jpeg},
    locate::{Pose, table},
    track::Track,
    world::Simulation,
};
use lapwing_core::{
    drive::{Observer, ObserverError},
    perception::Frame,
    protocol::{CameraImage, Command, Telemetry},
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

/// Takes the pictures of a row of training data: what is to be seen at a moment.
#[derive(Default)]
pub struct Shots {
    /// Of the world that was seen last.
    renderer: Option<(Arc<Scenery>, Renderer)>,
    frame: Frame,
}

impl Shots {
    /// The centre camera's picture.
    pub fn center(&mut self, world: &Simulation, telemetry: &Telemetry) -> Bytes {
        let conditions = &world.setup().conditions;
        let is_late = conditions.latency_ms > 0.0 || conditions.dropped > 0.0;
        match &telemetry.image {
            CameraImage::Jpeg(jpeg) if !is_late => jpeg.clone(),
            // The label belongs to what is to be seen now, not to what has arrived.
            _ => self.picture(world, &Camera::CENTER),
        }
    }

    /// The left camera's picture and the right one's.
    pub fn sides(&mut self, world: &Simulation) -> [Bytes; 2] {
        [&Camera::LEFT, &Camera::RIGHT].map(|camera| self.picture(world, camera))
    }

    fn picture(&mut self, world: &Simulation, camera: &Camera) -> Bytes {
        let scenery = &world.setup().scenery;
        let known = self.renderer.take().filter(|(known, _)| Arc::ptr_eq(known, scenery));
        let (_, renderer) =
            self.renderer.insert(known.unwrap_or_else(|| (scenery.clone(), Renderer::new(scenery.clone()))));
        world.draw(renderer, camera, &mut self.frame);
        encode_jpeg(&self.frame, JPEG_QUALITY).into()
    }
}

/// Writes a lesson's moments.
pub(super) struct LessonLog {
    rows: Rows,
    side_cameras: bool,
    shots: Shots,
}

impl LessonLog {
    pub fn new(log: DrivingLogWriter, side_cameras: bool) -> Self {
        Self { rows: Rows::new(log), side_cameras, shots: Shots::default() }
    }

    pub fn finish(self) -> Result<u64, RecordError> {
        self.rows.finish()
    }
}

impl<F> Observer<Lesson<'_, F>> for LessonLog {
    fn turn(&mut self, lesson: &Lesson<'_, F>, turn: &Turn) -> Result<(), ObserverError> {
        let Some(telemetry) = turn.telemetry() else { return Ok(()) };
        let world = lesson.simulation();
        let center = self.shots.center(world, telemetry);
        let sides = self.side_cameras.then(|| self.shots.sides(world));
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
