//! The recording as a world to drive in.

use std::{ops::Range, path::Path, time::Duration};

use super::{
    ClosedLoopError, DEFAULT_LIMIT_M, Limit, Measured, Protocol, Sights, Sources, Yaw,
    abreast::{Abreast, RecordedStep as Then},
    flow::Pyramid,
    judging::{Line, lines, on_the_line},
    motion::{Interval, Moved},
    recorded::{ALL_ROWS, PathBreak, PathRow, RecordedDrive},
    screen::Screen,
    warp::Beside,
};
use crate::{
    camera::{JPEG_QUALITY_AGAIN, encode_jpeg},
    locate::{LocatedDrive, Pose},
    vehicle::STEP_S,
};
use lapwing_core::{
    drive::Eventful,
    perception::Frame,
    protocol::{Answer, CameraImage, Observation, Sight, Telemetry, Truth, World},
    recording::{RunKind, udacity::FALLBACK_INTERVAL},
    turn::{EventRecord, LimitEdge, MeasuredLine},
    units::{Degrees, Metres, Steering},
    words::count,
};

/// Metres between the waypoints that telemetry counts, as the simulator's.
const WAYPOINT_M: f64 = 20.0;

/// A recording as a world, closed loop.
pub struct RecordedWorld {
    recorded: RecordedDrive,
    located: Option<LocatedDrive>,
    /// What each row's place is measured from.
    lines: Vec<Line>,
    name: String,
    limit: Limit,
    protocol: Protocol,
    yaw: Yaw,
    /// How many times as far both cars turn as the simulator's would for the same steering.
    gearing: f64,
    abreast: Abreast,
    /// The row that is shown next, or was shown last and waits for its answer.
    row: usize,
    /// What the virtual car sees there.
    screen: Screen,
    /// The row's own centre picture, prepared for the flow.
    pyramid: Option<Pyramid>,
    steering: Steering,
    steps: u64,
    driven_m: f64,
    /// Seconds of the recording that were left out after interventions.
    left_out_s: f64,
    /// Whether the virtual car goes on from the line here, as behind a break of the path.
    restarts: bool,
    /// What the events last said that its place is measured from.
    announced: Option<(MeasuredLine, LimitEdge, (f64, f64))>,
    interventions: u32,
    sources: Sources,
    failed: Option<ClosedLoopError>,
    ended: Option<String>,
    announced_end: bool,
    events: Vec<(Duration, EventRecord)>,
}

impl RecordedWorld {
    /// Opens a run (a file) or a Udacity folder (a folder, or its CSV). If it is `located`, the virtual car's place is
    /// measured from the lane's middle wherever that is known. The default `limit` is the road's edge if the lane is known
    /// along most of the way, otherwise [`DEFAULT_LIMIT_M`].
    ///
    /// # Errors
    /// [`ClosedLoopError`]: what cannot be read, pictures of another size than 320x160, no motion.
    pub fn open(
        path: &Path,
        limit: Option<Limit>,
        yaw: Yaw,
        located: Option<LocatedDrive>,
    ) -> Result<Self, ClosedLoopError> {
        Self::within(path, ALL_ROWS, limit, yaw, located)
    }

    /// The same of a part of the recording: these of its rows with a picture, counted from 0; up to its last one if the
    /// range ends at `usize::MAX`.
    ///
    /// # Errors
    /// [`ClosedLoopError`], as [`open`](Self::open); [`ClosedLoopError::Rows`].
    pub fn within(
        path: &Path,
        rows: Range<usize>,
        limit: Option<Limit>,
        yaw: Yaw,
        located: Option<LocatedDrive>,
    ) -> Result<Self, ClosedLoopError> {
        let mut recorded = RecordedDrive::open(path, rows)?;
        let in_lane = |row: &PathRow| located.as_ref().and_then(|drive| drive.in_lane(row.index));
        let lines = lines(&recorded.rows, in_lane);
        let is_mostly_known = recorded.length_m_where(|row| in_lane(row).is_some()) > recorded.length_m() / 2.0;
        let limit = limit.unwrap_or(if is_mostly_known { Limit::Road } else { Limit::Metres(DEFAULT_LIMIT_M) });
        let edge_m = match (limit, &located) {
            (Limit::Road, Some(drive)) => drive.track.half_width(),
            _ => limit.metres(),
        };
        let name = path.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let screen = Screen::new(&mut recorded, located.as_ref())?;
        let length_m = recorded.length_m();
        let waypoints = ((length_m / WAYPOINT_M).ceil() as u32).max(1);
        let course = EventRecord::recorded_path(&name, length_m, waypoints, edge_m);
        let mut world = Self {
            abreast: Abreast::default(),
            row: 0,
            screen,
            pyramid: None,
            lines,
            steering: Steering::ZERO,
            steps: 0,
            driven_m: 0.0,
            left_out_s: 0.0,
            restarts: false,
            announced: None,
            interventions: 0,
            sources: Sources::default(),
            failed: None,
            ended: None,
            announced_end: false,
            events: vec![(Duration::ZERO, course)],
            recorded,
            located,
            name,
            limit,
            protocol: Protocol::default(),
            yaw,
            gearing: 1.0,
        };
        world.pyramid = world.pyramid();
        world.arrive();
        Ok(world)
    }

    /// The same world by another protocol.
    pub fn by(self, protocol: Protocol) -> Self {
        Self { protocol, ..self }
    }

    /// The same world with cars that turn this many times as far as the simulator's for the same steering, as the
    /// recorded one did.
    pub fn geared(self, gearing: f64) -> Self {
        Self { gearing, ..self }
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

    /// The virtual car's place, and how far it may be from what that is measured from.
    pub fn measured(&self) -> Measured {
        Measured::new(self.limit, self.line(), self.abreast.beside())
    }

    /// Where on its road the virtual car is, if that is known.
    pub fn pose(&self) -> Option<Pose> {
        let drive = self.located.as_ref()?;
        let recorded = drive.places.get(self.picture_number()?).copied().flatten()?.pose;
        let Measured { offset_m, heading_rad, .. } = self.measured();
        Some(Pose::from_lane(&drive.track, recorded.s_m, recorded.direction() < 0.0, offset_m, heading_rad))
    }

    /// Rows loaded so far without a picture of a side camera, and all that were loaded.
    pub fn without_side_cameras(&self) -> (usize, usize) {
        (self.recorded.sideless, self.recorded.loaded)
    }

    /// Whether it is known along all of the way where in its lane the recorded car was.
    pub fn knows_the_lane(&self) -> bool {
        self.lines.iter().all(|line| matches!(line, Line::Lane(_)))
    }

    /// Whether it is known anywhere along the way where in its lane the recorded car was.
    pub fn knows_the_lane_somewhere(&self) -> bool {
        self.lines.iter().any(|line| matches!(line, Line::Lane(_)))
    }

    /// Where the recorded drive is known to have been.
    pub fn located(&self) -> Option<&LocatedDrive> {
        self.located.as_ref()
    }

    /// Which of the recording's pictures is shown, counted from 0; `None` at its end.
    pub fn picture_number(&self) -> Option<usize> {
        Some(self.recorded.rows.get(self.row)?.index)
    }

    /// What the place is measured from.
    fn line(&self) -> Line {
        self.lines.get(self.row).copied().unwrap_or(Line::PATH)
    }

    /// The picture that was shown last, as the pilot saw it before JPEG.
    pub fn picture(&self) -> &Frame {
        &self.screen.picture
    }

    /// How often the virtual car was put back so far.
    pub fn interventions(&self) -> u32 {
        self.interventions
    }

    /// What was shown so far.
    pub fn sights(&self) -> &Sights {
        &self.screen.sights
    }

    /// How many of the pictures so far were taken in another lap of the recording than the one that is driven along.
    pub fn of_another_lap(&self) -> u32 {
        self.screen.of_another_lap
    }

    /// Where it is put back.
    pub fn limit(&self) -> Limit {
        self.limit
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
        let last = self.recorded.rows.len() - 1;
        Duration::from_secs_f64(self.recorded.rows[self.row.min(last)].at_s - self.left_out_s)
    }

    /// The centre picture, ready for the flow.
    fn pyramid(&self) -> Option<Pyramid> {
        match self.yaw {
            Yaw::Pictures => self.screen.recorded(self.row)?.frames[0].as_ref().and_then(Pyramid::of),
            Yaw::Steering => None,
        }
    }

    /// Arrives at a row: reports what happened before it, and paints the virtual car's picture.
    fn arrive(&mut self) {
        let Some(row) = self.recorded.rows.get(self.row).copied() else { return };
        if std::mem::take(&mut self.restarts) || row.cut.is_some() {
            self.abreast = Abreast::default();
            self.screen.cut(&row);
            self.put_on_the_line();
            self.steps = (row.at_s / STEP_S) as u64;
        }
        if let Some(cut) = row.cut.filter(|cut| *cut != PathBreak::Begins) {
            self.events.push((self.at(), EventRecord::Note { text: told(cut) }));
        }
        if let Some(why) = self.screen.recorded(self.row).and_then(|shown| shown.unusable.as_ref()) {
            self.events.push((self.at(), EventRecord::Note { text: why.to_string() }));
        }
        self.announce();
        let cars = (self.abreast.beside(), self.abreast.place());
        self.screen.paint(&self.recorded.rows, self.row, self.located.as_ref(), cars);
    }

    /// Drives from a row to the next one under a steering command.
    fn drive(&mut self, from: PathRow, to: PathRow, before: Option<Pyramid>) {
        let until = (to.at_s / STEP_S + 1e-9) as u64;
        let interval = Interval { from, to, simulated_s: until.saturating_sub(self.steps) as f64 * STEP_S };
        let located = self.located.as_ref().filter(|_| self.yaw != Yaw::Steering);
        let by_lane = located.and_then(|drive| interval.by_lane(drive));
        let moved = by_lane.or_else(|| interval.by_pictures(&before?, self.pyramid.as_ref()?));
        match (by_lane, moved) {
            (Some(_), _) => self.sources.lane += 1,
            (None, Some(_)) => self.sources.pictures += 1,
            (None, None) => self.sources.steering += 1,
        }
        let Moved { yaw_rate, aside } = moved.unwrap_or_default();
        let geared = |steering: Steering| Steering::saturating(self.gearing * steering.get());
        let (recorded, driven) = (geared(from.steering), geared(self.steering));
        while self.steps < until {
            self.steps += 1;
            let share = ((self.steps as f64 * STEP_S - from.at_s) / interval.seconds()).clamp(0.0, 1.0);
            let speed = from.mps() + share * (to.mps() - from.mps());
            self.abreast.step(Then { speed, steering: recorded, yaw_rate, aside }, driven);
        }
        self.driven_m += interval.mps() * interval.seconds();
    }

    /// Puts the virtual car back if it is too far off. No telemetry shows it there; the event reports how far it was.
    fn intervene(&mut self) -> Result<(), ClosedLoopError> {
        let place = self.measured();
        if !place.is_beyond() {
            return Ok(());
        }
        self.announce();
        self.interventions += 1;
        let waypoint = (self.driven_m / WAYPOINT_M) as u32;
        let at = self.at();
        self.events.push((at, EventRecord::OffRoad { offset_m: place.offset_m }));
        self.events.push((at, EventRecord::Reset { waypoint }));
        self.put_on_the_line();
        self.leave_out(self.protocol.left_out_s())
    }

    /// Puts the virtual car on the lane's middle if that is known, otherwise on the recorded path.
    fn put_on_the_line(&mut self) {
        match (self.line(), self.recorded.rows.get(self.row)) {
            (Line::Lane(lane), Some(row)) => {
                let yaw_rate = lane.curvature * row.mps();
                self.abreast.put(on_the_line(Line::Lane(lane)), yaw_rate);
            }
            (line, _) => self.abreast.put_back(on_the_line(line)),
        }
    }

    /// Goes on this many seconds further along the recording, or where the path breaks off before.
    fn leave_out(&mut self, seconds: f64) -> Result<(), ClosedLoopError> {
        if seconds <= 0.0 {
            return Ok(());
        }
        let rows = &self.recorded.rows;
        let was_s = rows[self.row].at_s;
        let next = |row: &PathRow| row.cut.is_some() || row.at_s >= was_s + seconds;
        let further = rows[self.row + 1..].iter().position(next);
        self.row = further.map_or(rows.len(), |further| self.row + 1 + further);
        let Some(to) = rows.get(self.row) else {
            self.left_out_s += rows[rows.len() - 1].at_s - was_s;
            return Ok(());
        };
        // The two rows are as far apart as those before and behind a break.
        self.left_out_s += to.at_s - was_s - FALLBACK_INTERVAL.as_secs_f64();
        self.restarts = true;
        self.show()
    }

    /// Loads the pictures of this row.
    fn show(&mut self) -> Result<(), ClosedLoopError> {
        self.screen.wind(&mut self.recorded, self.row)?;
        self.pyramid = self.pyramid();
        Ok(())
    }

    /// Says what the car's place is measured from, if that has changed.
    fn announce(&mut self) {
        let Measured { line, edge, mut limits_m, .. } = self.measured();
        if line == MeasuredLine::RecordedPath {
            // Where it goes over into a lane, the limits are others at each row.
            limits_m = (-self.limit.metres(), self.limit.metres());
        }
        if self.announced.replace((line, edge, limits_m)) != Some((line, edge, limits_m)) {
            let (left_m, right_m) = limits_m;
            self.events.push((self.at(), EventRecord::MeasuredFrom { line, edge, left_m, right_m }));
        }
    }

    fn telemetry(&self, row: PathRow) -> Telemetry {
        let Measured { offset_m, heading_rad, .. } = self.measured();
        // On the path there is nothing to warp, so no second compression blurs the picture; and what cannot be used is no
        // picture anywhere.
        let on_path = self.abreast.beside() == Beside::default();
        let recorded = self.screen.recorded(self.row).filter(|shown| on_path || shown.unusable.is_some());
        let jpeg = recorded.map(|shown| shown.jpeg.clone());
        let jpeg = jpeg.unwrap_or_else(|| encode_jpeg(self.picture(), JPEG_QUALITY_AGAIN).into());
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
                let why = self.ended.take().unwrap_or_else(|| "the recording ends".into());
                self.events.push((self.at(), EventRecord::RunEnded { why }));
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
        let arrived = self.show().and_then(|()| {
            if to.cut.is_some() {
                return Ok(());
            }
            self.drive(from, to, before);
            self.intervene()
        });
        match arrived {
            Ok(()) => self.arrive(),
            Err(error) => self.failed = Some(error),
        }
    }
}
