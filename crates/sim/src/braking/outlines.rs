//! What a picture of an episode shows, as the simulator knows it: where in the picture something stands, how far away it is, and
//! whether our car will get past it.
//!
//! None of it is recorded: an episode's run holds what was drawn at random for it, so the episode is driven again without
//! pictures, which takes a hundredth of the time ([`retell`]).

use glam::{DVec2, DVec3, Vec3};

use super::{
    human::Human,
    plan::Episode,
    play::{Shown, play},
    record::{DataError, Places},
    sight::Sight,
};
use crate::{
    camera::{
        Camera, RIDE_M,
        viewpoint::{NEAR, Viewpoint},
    },
    collision_course::{Pass, obstacles, pass},
    obstacles::{Box2, FRONT_M},
    scene::Actor,
    world::Simulation,
};
use lapwing_core::{protocol::Truth, units::Metres};

/// The distances along the road, in metres, at which our path is told.
pub const COURSE_M: [f64; 3] = [8.0, 16.0, 30.0];
/// A place on our path is told as at most so many half widths of the picture from its middle.
const WIDEST: f32 = 2.0;

/// Something that a picture shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outline {
    /// Its left and right ends, in pixels from the picture's left edge.
    pub columns: [f32; 2],
    /// How far away its nearest corner is along the camera's axis, in metres.
    pub away_m: f32,
    /// How our car gets past it.
    pub pass: Pass,
}

/// What a picture shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// What stands in our path or beside it, in no particular order; nearer things hide those behind them.
    pub outlines: Vec<Outline>,
    /// Where our path, along the road at our present offset, is after each of [`COURSE_M`]: in half widths of the picture, to
    /// the right of its middle.
    pub course: [f32; 3],
    /// Our speed, in m/s, without its sign.
    pub speed_mps: f64,
    /// Time to collision, in seconds, as the telemetry tells it; long where it does not.
    pub until_s: f64,
    /// Distance to what is ahead, in metres; likewise.
    pub gap_m: f64,
}

/// What the pictures of an episode show, found by driving it again; `hz` is the rate at which it was recorded.
///
/// # Errors
/// [`DataError`] if its scenario cannot be played on its road.
pub fn retell(places: &Places, episode: &Episode, hz: f64) -> Result<Vec<Picture>, DataError> {
    let mut world = episode.world(places, hz, false)?;
    let mut pictures = vec![];
    play(&mut world, &mut Human::new(episode.temper()), |shown| {
        if let Shown::Turn(turn, world) = shown {
            let truth = turn.telemetry().map(|telemetry| telemetry.truth.clone()).unwrap_or_default();
            pictures.push(Picture::of(world, &truth));
        }
        Ok::<_, DataError>(())
    })?;
    Ok(pictures)
}

impl Picture {
    fn of(world: &Simulation, truth: &Truth) -> Self {
        let (car, track, place) = (world.car(), &*world.setup().track, world.place());
        let Camera { lens, mount, .. } = Camera::CENTER;
        let view = Viewpoint::new(&lens, &mount, car.position + DVec3::Y * RIDE_M, car.yaw, car.pitch);
        let reach_m = Sight::of(world).reach_m() as f32;
        let outline = |actor: &Actor| {
            let (columns, away_m) = seen(&view, actor)?;
            (away_m < reach_m).then(|| Outline { columns, away_m, pass: pass(track, car, place, actor) })
        };
        let course = COURSE_M.map(|way_m| {
            let point = view.turn(track.point(place.station.s + FRONT_M + way_m, place.offset).as_vec3());
            let (column, _) = view.project(point.with_z(point.z.max(NEAR)));
            (column / view.cx - 1.0).clamp(-WIDEST, WIDEST)
        });
        Self {
            outlines: obstacles(world.actors()).filter_map(outline).collect(),
            course,
            speed_mps: car.speed.abs(),
            until_s: truth.time_to_collision_s.unwrap_or(Truth::CLEAR_S),
            gap_m: truth.gap.map_or(Truth::CLEAR_M, Metres::get),
        }
    }
}

/// The columns between which something is seen, and how far away its nearest corner is; `None` if it is beside the picture or
/// behind the camera.
fn seen(view: &Viewpoint, actor: &Actor) -> Option<([f32; 2], f32)> {
    let (mut columns, mut away_m) = ([f32::INFINITY, f32::NEG_INFINITY], f32::INFINITY);
    let mut take = |point: Vec3| {
        let (column, _) = view.project(point);
        columns = [columns[0].min(column), columns[1].max(column)];
        away_m = away_m.min(point.z);
    };
    for height_m in [0.0, actor.size().y] {
        let corner = |flat: DVec2| DVec3::new(flat.x, actor.position.y + height_m, flat.y).as_vec3();
        let corners = Box2::of_actor(actor).corners().map(|flat| view.turn(corner(flat)));
        // The outline, cut where it is behind the camera.
        for (i, a) in corners.into_iter().enumerate() {
            let b = corners[(i + 1) % corners.len()];
            if a.z >= NEAR {
                take(a);
            }
            if (a.z < NEAR) != (b.z < NEAR) {
                take(a.lerp(b, (NEAR - a.z) / (b.z - a.z)));
            }
        }
    }
    (columns[0] < view.width as f32 && columns[1] > 0.0).then_some((columns, away_m))
}
