//! The recording as a world to drive in.

use std::{path::Path, time::Duration};

use super::{
    ClosedLoopError,
    abreast::{Abreast, RecordedStep as Then},
    flow::Pyramid,
    recorded::{MomentPictures, PathBreak, PathRow, RecordedDrive},
    rotation,
    warp::{Beside, Warp},
};
use crate::{camera::encode_jpeg, vehicle::STEP_S};
use lapwing_core::{
    car::FULL_STEERING_DEG,
    drive::Eventful,
    motion,
    perception::Frame,
    protocol::{Answer, CameraImage, Observation, Sight, Telemetry, Truth, World},
    recording::RunKind,
    turn::EventRecord,
    units::{Degrees, Metres, Steering},
    words::count,
};

/// How far beside the path the virtual car may be, in metres: NVIDIA's (Bojarski et al. 2016, section 6.1).
pub const DEFAULT_LIMIT_M: f64 = 1.0;

/// A virtual car whose heading is off by more than this, in degrees, is put back, too: the picture would show nothing
/// of what it sees.
pub const FURTHEST_HEADING_DEG: f64 = 45.0;

/// JPEG quality of warped pictures; the recorded ones have already been compressed at the stock build's 75.
const QUALITY: u8 = 95;

/// Metres between the waypoints that telemetry counts, as the simulator's.
const WAYPOINT_M: f64 = 20.0;

/// Where the recorded car's yaw rate comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Yaw {
    /// The shift of the scenery from picture to picture if it can be seen, otherwise the steering.
    #[default]
    Pictures,
    /// Recorded steering and speed alone.
    Steering,
}

/// Where the recorded car's yaw rate came from, counted in intervals between two rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sources {
    /// Intervals measured from the pictures.
    pub pictures: usize,
    /// Intervals computed from the steering.
    pub steering: usize,
}

/// A recording as a world, closed loop.
pub struct RecordedWorld {
    recorded: RecordedDrive,
    name: String,
    limit_m: f64,
    yaw: Yaw,
    warp: Warp,
    abreast: Abreast,
    /// The row that is shown next, or was shown last and waits for its answer.
    row: usize,
    /// Its pictures, and the centre one prepared for the flow.
    shown: MomentPictures,
    pyramid: Option<Pyramid>,
    seen: Frame,
    steering: Steering,
    steps: u64,
    driven_m: f64,
    interventions: u32,
    sources: Sources,
    failed: Option<ClosedLoopError>,
    ended: Option<String>,
    announced_end: bool,
    events: Vec<(Duration, EventRecord)>,
}

impl RecordedWorld {
    /// Opens a run (a file) or a Udacity folder (a folder, or its CSV). The virtual car may be up to `limit_m` from the
    /// recorded path.
    ///
    /// # Errors
    /// [`ClosedLoopError`]: what cannot be read, pictures of another size than 320x160, no motion.
    pub fn open(path: &Path, limit_m: f64, yaw: Yaw) -> Result<Self, ClosedLoopError> {
        let mut recorded = RecordedDrive::open(path)?;
        let name = path.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let shown = recorded.show(0)?;
        let length_m = recorded.length_m();
        let waypoints = ((length_m / WAYPOINT_M).ceil() as u32).max(1);
        let course = EventRecord::recorded_path(&name, length_m, waypoints, limit_m);
        let mut world = Self {
            warp: Warp::new(),
            abreast: Abreast::default(),
            row: 0,
            pyramid: None,
            shown,
            seen: Frame::default(),
            steering: Steering::ZERO,
            steps: 0,
            driven_m: 0.0,
            interventions: 0,
            sources: Sources::default(),
            failed: None,
            ended: None,
            announced_end: false,
            events: vec![(Duration::ZERO, course)],
            recorded,
            name,
            limit_m,
            yaw,
        };
        world.pyramid = world.pyramid();
        world.arrive();
        Ok(world)
    }

    /// The recording's name, without folders and extension.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Rows that are driven along, rows with a picture in the recording, and those of them in which the car stands.
    pub fn rows(&self) -> (usize, usize, usize) {
        (self.recorded.rows.len(), self.recorded.read, self.recorded.stood)
    }

    /// Where the virtual car is beside the recorded one.
    pub fn beside(&self) -> Beside {
        self.abreast.beside()
    }

    /// The picture that was shown last, as the pilot saw it before JPEG.
    pub fn picture(&self) -> &Frame {
        &self.seen
    }

    /// How often the virtual car was put back so far.
    pub fn interventions(&self) -> u32 {
        self.interventions
    }

    /// How far it may be from the path, in metres.
    pub fn limit_m(&self) -> f64 {
        self.limit_m
    }

    /// Where the recorded car's yaw rate came from so far.
    pub fn sources(&self) -> Sources {
        self.sources
    }

    /// Pictures a second of the recording: the median.
    pub fn hz(&self) -> f64 {
        let mut apart: Vec<f64> =
            self.recorded.rows.windows(2).filter(|p| p[1].cut.is_none()).map(|p| p[1].at_s - p[0].at_s).collect();
        apart.sort_by(f64::total_cmp);
        apart.get(apart.len() / 2).map_or(15.0, |apart| 1.0 / apart.max(1e-3))
    }

    /// Ends the drive at the next telemetry.
    pub fn end(&mut self, why: impl Into<String>) {
        self.ended.get_or_insert(why.into());
    }

    fn at(&self) -> Duration {
        Duration::from_secs_f64(self.recorded.rows.get(self.row).map_or(0.0, |row| row.at_s))
    }

    /// The centre picture, ready for the flow.
    fn pyramid(&self) -> Option<Pyramid> {
        match self.yaw {
            Yaw::Pictures => self.shown.frames[0].as_ref().and_then(Pyramid::of),
            Yaw::Steering => None,
        }
    }

    /// Arrives at a row: reports what happened before it, and paints the virtual car's picture.
    fn arrive(&mut self) {
        let Some(row) = self.recorded.rows.get(self.row).copied() else { return };
        if let Some(cut) = row.cut {
            self.abreast = Abreast::default();
            self.steps = (row.at_s / STEP_S) as u64;
            if cut != PathBreak::Begins {
                self.events.push((self.at(), EventRecord::Note { text: told(cut) }));
            }
        }
        self.warp.render(self.shown.frames(), self.abreast.beside(), &mut self.seen);
    }

    /// Drives from a row to the next one under a steering command.
    fn drive(&mut self, from: PathRow, to: PathRow, before: Option<Pyramid>) {
        let apart = to.at_s - from.at_s;
        let mps = |row: PathRow| row.speed.metres_per_second().get();
        let rolled = (mps(from) + mps(to)) / 2.0 * apart;
        let seen = before.zip(self.pyramid.as_ref()).and_then(|(before, next)| rotation::turn(&before, next, rolled));
        let yaw_rate = seen.map(|turn| turn.yaw / apart).filter(|rate| believable(*rate, mps(from)));
        match yaw_rate {
            Some(_) => self.sources.pictures += 1,
            None => self.sources.steering += 1,
        }
        let until = (to.at_s / STEP_S + 1e-9) as u64;
        while self.steps < until {
            self.steps += 1;
            let share = ((self.steps as f64 * STEP_S - from.at_s) / apart).clamp(0.0, 1.0);
            let speed = mps(from) + share * (mps(to) - mps(from));
            self.abreast.step(Then { speed, steering: from.steering, yaw_rate }, self.steering);
        }
        self.driven_m += rolled;
    }

    /// Puts the virtual car back if it is too far off. No telemetry shows it there; the event reports how far it was.
    fn intervene(&mut self) {
        let Beside { offset_m, heading_rad } = self.abreast.beside();
        if offset_m.abs() <= self.limit_m && heading_rad.abs() <= FURTHEST_HEADING_DEG.to_radians() {
            return;
        }
        self.interventions += 1;
        self.abreast.put_back();
        let waypoint = (self.driven_m / WAYPOINT_M) as u32;
        let at = self.at();
        self.events.push((at, EventRecord::OffRoad { offset_m }));
        self.events.push((at, EventRecord::Reset { waypoint }));
    }

    fn telemetry(&self, row: PathRow) -> Telemetry {
        let Beside { offset_m, heading_rad } = self.abreast.beside();
        // On the path there is nothing to warp, so no second compression blurs the picture.
        let jpeg = if self.abreast.beside() == Beside::default() {
            self.shown.jpeg.clone()
        } else {
            encode_jpeg(&self.seen, QUALITY).into()
        };
        Telemetry {
            steering: self.steering.degrees(),
            throttle: row.throttle,
            speed: row.speed,
            image: CameraImage::Jpeg(jpeg),
            truth: Truth {
                cte: Some(Metres::saturating(offset_m)),
                heading_error: Some(Degrees::saturating(heading_rad.to_degrees())),
                distance: Some(Metres::saturating(self.driven_m)),
                waypoint: Some((self.driven_m / WAYPOINT_M) as u32),
                ..Truth::default()
            },
        }
    }
}

/// Whether a car on its tyres can turn this fast, in radians a second: up to twice what full steering asks for, and a
/// little more for contact with a wall.
fn believable(rate: f64, speed: f64) -> bool {
    rate.abs() < 0.5 + motion::yaw_rate(2.0 * speed, FULL_STEERING_DEG)
}

fn told(cut: PathBreak) -> String {
    match cut {
        PathBreak::Begins => "the recording begins".into(),
        PathBreak::Stood(rows) => format!("left out: {} in which the recorded car stands", count(rows, "row")),
        PathBreak::Gap(Some(apart)) => format!("left out: {apart:.1} s that are not recorded"),
        PathBreak::Gap(None) => "left out: a time of unknown length that is not recorded".into(),
        PathBreak::Put => "the recorded car was put elsewhere".into(),
    }
}

impl Eventful for RecordedWorld {
    fn take_events(&mut self) -> Vec<(Duration, EventRecord)> {
        std::mem::take(&mut self.events)
    }

    fn kind(&self) -> RunKind {
        RunKind::RecordedPath
    }

    fn interrupt(&mut self) {
        self.end("interrupted");
    }
}

impl World for RecordedWorld {
    type Error = ClosedLoopError;

    fn observe(&mut self) -> Result<Option<Observation>, ClosedLoopError> {
        if let Some(error) = self.failed.take() {
            return Err(error);
        }
        let row = self.recorded.rows.get(self.row).copied().filter(|_| self.ended.is_none());
        let Some(row) = row else {
            if !std::mem::replace(&mut self.announced_end, true) {
                let last = self.recorded.rows.len() - 1;
                let at = Duration::from_secs_f64(self.recorded.rows[self.row.min(last)].at_s);
                let why = self.ended.take().unwrap_or_else(|| "the recording ends".into());
                self.events.push((at, EventRecord::RunEnded { why }));
            }
            return Ok(None);
        };
        Ok(Some(Observation { at: self.at(), sight: Sight::Telemetry(self.telemetry(row)) }))
    }

    fn apply(&mut self, answer: Answer) {
        if let Answer::Steer(command) = answer {
            self.steering = command.steering;
        }
        let Some(from) = self.recorded.rows.get(self.row).copied() else { return };
        self.row += 1;
        let Some(to) = self.recorded.rows.get(self.row).copied() else { return };
        let before = self.pyramid.take();
        match self.recorded.show(self.row) {
            Ok(shown) => {
                self.shown = shown;
                self.pyramid = self.pyramid();
            }
            Err(error) => {
                self.failed = Some(error);
                return;
            }
        }
        if to.cut.is_none() {
            self.drive(from, to, before);
            self.intervene();
        }
        self.arrive();
    }
}
