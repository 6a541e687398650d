//! Tests of what pictures must show, whatever they look like.

use std::sync::{Arc, OnceLock};

use glam::DVec3;

use super::{raster::COLOURED, *};
use crate::{
    scene::ActorKind,
    track::{LandmarkKind, Theme, Track, TrackFile},
};

/// Mean difference over the road's rows, which a pilot steers by, out of 255.
pub(crate) fn apart(a: &Frame, b: &Frame) -> f64 {
    let rows = 62 * Lens::STOCK.width * 3..134 * Lens::STOCK.width * 3;
    let differences = a.rgb()[rows.clone()].iter().zip(&b.rgb()[rows.clone()]);
    differences.map(|(&a, &b)| f64::from(a.abs_diff(b))).sum::<f64>() / rows.len() as f64
}

/// A shipped track and what stands along it, built once for all tests.
pub(crate) fn scenery(name: &str) -> (Track, Arc<Scenery>) {
    static ALL: [OnceLock<(Track, Arc<Scenery>)>; Track::NAMES.len()] = [const { OnceLock::new() }; _];
    let i = Track::NAMES.iter().position(|known| *known == name).unwrap();
    let build = || {
        let track = Track::named(name).unwrap();
        let scenery = Arc::new(Scenery::new(&track));
        (track, scenery)
    };
    ALL[i].get_or_init(build).clone()
}

pub(super) fn car(track: &Track, s: f64, offset: f64) -> Car {
    let station = track.at(s);
    Car { position: track.point(s, offset), yaw: station.yaw, pitch: station.grade.atan(), ..Car::default() }
}

pub(super) fn picture(
    renderer: &mut Renderer,
    camera: &Camera,
    car: &Car,
    actors: &[Actor],
    conditions: &Conditions,
) -> Frame {
    let mut frame = Frame::new(0, 0, vec![]).unwrap();
    renderer.render(camera, &Shot { car, actors, conditions, seed: 7, time_s: 1.5 }, &mut frame);
    frame
}

/// Where a point of the world is in the picture, by an independent pinhole camera formula.
fn column_and_row(camera: &Camera, car: &Car, point: DVec3) -> (f64, f64) {
    let turned = |v: DVec3, axis: usize, angle: f64| {
        let (s, c) = angle.sin_cos();
        match axis {
            0 => DVec3::new(v.x, c * v.y - s * v.z, s * v.y + c * v.z),
            1 => DVec3::new(c * v.x + s * v.z, v.y, c * v.z - s * v.x),
            _ => DVec3::new(c * v.x - s * v.y, s * v.x + c * v.y, v.z),
        }
    };
    let local = turned(point - car.position - DVec3::Y * 0.06, 1, -car.yaw);
    let local = turned(local, 0, car.pitch) - camera.mount.position;
    let local = turned(local, 1, -camera.mount.yaw_deg.to_radians());
    let local = turned(local, 0, -camera.mount.pitch_deg.to_radians());
    let local = turned(local, 2, -camera.mount.roll_deg.to_radians());
    let focal = 138.564;
    (160.0 + focal * local.x / local.z, 80.0 - focal * local.y / local.z)
}

/// Where the camera is in the world.
fn eye(camera: &Camera, car: &Car) -> DVec3 {
    let (across, up, ahead) = camera.mount.position.into();
    let (climb, level) = car.pitch.sin_cos();
    let (up, ahead) = (up * level + ahead * climb, ahead * level - up * climb);
    let (sin, cos) = car.yaw.sin_cos();
    car.position + DVec3::new(across * cos + ahead * sin, up + 0.06, ahead * cos - across * sin)
}

#[test]
fn the_horizon_of_flat_ground_is_where_the_pitch_puts_it() {
    // 7.5 degrees down at a focal length of 138.56 pixels: 18.2 rows above the middle, in a picture rolled by 1.2
    // degrees.
    let view = Viewpoint::new(&Lens::STOCK, &Camera::CENTER.mount, DVec3::ZERO, 0.7, 0.0);
    let far = Vec3::new(0.7f32.sin(), 0.0, 0.7f32.cos()) * 1e6 + Vec3::Y * view.eye.y;
    let (column, row) = view.project(view.turn(far));
    assert!((row - 61.8).abs() < 0.1 && (column - 158.3).abs() < 0.7, "{column} {row}");
    let right = Vec3::new(1.2f32.sin(), 0.0, 1.2f32.cos()) * 1e6 + Vec3::Y * view.eye.y;
    let (_, lower) = view.project(view.turn(right));
    assert!(lower > row + 1.0, "positive roll lets the horizon fall to the right");
}

#[test]
fn the_car_nose_up_sees_more_sky() {
    let level = Viewpoint::new(&Lens::STOCK, &Camera::CENTER.mount, DVec3::ZERO, 0.0, 0.0);
    let up = Viewpoint::new(&Lens::STOCK, &Camera::CENTER.mount, DVec3::ZERO, 0.0, 0.1);
    let row = |view: &Viewpoint| view.project(view.turn(Vec3::new(0.0, view.eye.y, 1e6))).1;
    assert!(row(&up) > row(&level) + 12.0, "{} {}", row(&up), row(&level));
}

#[test]
fn road_edges_are_where_projection_puts_them() {
    let (track, scenery) = scenery("lake");
    let mut renderer = Renderer::new(scenery);
    for s in [262.0, 455.0, 940.0] {
        for offset in [-1.0, 0.0, 0.8] {
            let car = car(&track, s, offset);
            picture(&mut renderer, &Camera::CENTER, &car, &[], &Conditions::default());
            for side in [-1.0, 1.0] {
                for ahead in [5.0, 8.0, 12.0] {
                    let edge = track.point(s + ahead, side * track.half_width());
                    let (column, row) = column_and_row(&Camera::CENTER, &car, edge);
                    if !(1.0..319.0).contains(&column) || !(0.0..134.0).contains(&row) {
                        continue;
                    }
                    // The offset that the renderer has at that very pixel.
                    let raster = &renderer.raster;
                    let (x, y) = (column as usize, row as usize);
                    let setup = raster.setups[raster.ids[y * 320 + x] as usize - 1];
                    let at = |plane: &raster::Plane| plane.row(y) + plane.x * x as f32;
                    let shown = f64::from(at(&setup.v) / at(&setup.w));
                    // One pixel is ahead / focal length wide, and ahead^2 / (focal length * height) long.
                    let pixel = ahead / 138.56 + 0.02 * ahead;
                    let off = (shown - side * track.half_width()).abs();
                    assert!(off < pixel + 0.03, "{s} {offset} {side} {ahead}: {shown:.2} m from the middle");
                }
            }
        }
    }
}

#[test]
fn the_same_shot_is_the_same_bytes() {
    let conditions = Conditions { rain: 0.5, noise: 5.0, haze: 0.2, blur: 0.6, ..Conditions::default() };
    for name in Track::NAMES {
        let (track, shared) = scenery(name);
        let here = car(&track, 200.0, 0.0);
        let one = picture(&mut Renderer::new(Arc::clone(&shared)), &Camera::CENTER, &here, &[], &conditions);
        let mut used = Renderer::new(Arc::new(Scenery::new(&track)));
        picture(&mut used, &Camera::LEFT, &car(&track, 400.0, 1.0), &[], &Conditions::default());
        let two = std::thread::scope(|scope| {
            scope.spawn(|| picture(&mut used, &Camera::CENTER, &here, &[], &conditions)).join().unwrap()
        });
        assert!(one == two, "{name}");
    }
}

#[test]
fn every_condition_of_the_picture_changes_it() {
    let (track, scenery) = scenery("lake");
    let mut renderer = Renderer::new(scenery);
    let car = car(&track, 940.0, 0.0);
    let plain = picture(&mut renderer, &Camera::CENTER, &car, &[], &Conditions::default());
    for text in [
        "sun_height_deg=10",
        "sun_azimuth_deg=300",
        "brightness=1.2",
        "haze=0.5",
        "rain=0.7",
        "night=1",
        "noise=4",
        "blur=1",
        "grain=0",
        "grain=2",
        "verge=2",
        "warmth=-1",
    ] {
        let changed = picture(&mut renderer, &Camera::CENTER, &car, &[], &Conditions::parse(text).unwrap());
        let pixels = plain.rgb().iter().zip(changed.rgb()).filter(|(a, b)| a != b).count();
        assert!(pixels > 3000, "{text}: {pixels} bytes differ");
    }
    let again =
        picture(&mut renderer, &Camera::CENTER, &car, &[], &Conditions::parse("latency_ms=90,dropped=0.1").unwrap());
    assert!(plain == again, "latency and dropped frames are no matter of the picture");
}

#[test]
fn night_is_dark_but_for_the_headlights() {
    let (track, scenery) = scenery("lake");
    let mut renderer = Renderer::new(scenery);
    let car = car(&track, 455.0, 0.0);
    let night = picture(&mut renderer, &Camera::CENTER, &car, &[], &Conditions::parse("night=1").unwrap());
    let sky = night.pixel(20, 5).unwrap()[1];
    let road = night.pixel(158, 100).unwrap()[1];
    assert!(sky < 20 && road > 60, "sky {sky}, road {road}");
}

#[test]
fn side_cameras_are_shifted_as_their_mounts_say() {
    let (track, scenery) = scenery("lake");
    let mut renderer = Renderer::new(scenery);
    let car = car(&track, 262.0, 0.0);
    let mut offset_at = |camera: &Camera| {
        picture(&mut renderer, camera, &car, &[], &Conditions::default());
        let (x, y) = (160, 115);
        let setup = renderer.raster.setups[renderer.raster.ids[y * 320 + x] as usize - 1];
        let at = |plane: &raster::Plane| plane.row(y) + plane.x * x as f32;
        f64::from(at(&setup.v) / at(&setup.w))
    };
    let (left, center, right) = (offset_at(&Camera::LEFT), offset_at(&Camera::CENTER), offset_at(&Camera::RIGHT));
    assert!((left - center + 0.806).abs() < 0.03, "left sees {:.3} m beside the centre", left - center);
    assert!((right - center - 0.825).abs() < 0.03, "right sees {:.3} m beside the centre", right - center);
}

#[test]
fn nothing_covers_the_road_along_a_whole_lap() {
    for name in Track::NAMES {
        let (track, scenery) = scenery(name);
        let mut renderer = Renderer::new(scenery);
        let line = track.file().driving_line_m;
        let (mut seen, mut hidden) = (0, 0);
        for k in 0..track.length() as usize / 5 {
            let s = k as f64 * 5.0;
            let car = car(&track, s, line);
            picture(&mut renderer, &Camera::CENTER, &car, &[], &Conditions::default());
            // The road's own crests may hide it: the ray from the eye then comes within a pixel's height of the road
            // before the point.
            let eye = eye(&Camera::CENTER, &car);
            let behind_a_crest = |point: DVec3| {
                (1..=18).map(|i| f64::from(i) / 20.0).any(|part| {
                    let on_the_ray = eye.lerp(point, part);
                    let place = track.locate(on_the_ray, Some(s));
                    let clear = on_the_ray.y - track.point(place.station.s, place.offset).y;
                    clear < 0.08
                })
            };
            for ahead in [4.0, 7.0, 10.0] {
                for across in [-0.9, -0.5, 0.0, 0.5, 0.9] {
                    let point = track.point(s + ahead, across * track.half_width());
                    let (column, row) = column_and_row(&Camera::CENTER, &car, point);
                    if !(0.0..320.0).contains(&column) || !(0.0..134.0).contains(&row) {
                        continue;
                    }
                    seen += 1;
                    if behind_a_crest(point) {
                        hidden += 1;
                        continue;
                    }
                    let i = row as usize * 320 + column as usize;
                    let id = renderer.raster.ids[i];
                    assert!(
                        id & COLOURED == 0 && id != 0,
                        "{name} {s} m, {ahead} m ahead at {across}: a sprite or sky"
                    );
                    let paint = renderer.raster.setups[id as usize - 1].paint;
                    let road = matches!(paint, Paint::Road { .. });
                    assert!(road, "{name} {s} m, {ahead} m ahead at {across}: {paint:?}");
                }
            }
        }
        assert!(hidden * 14 < seen, "{name}: {hidden} of {seen} places are behind a crest");
    }
}

#[test]
fn no_plant_reaches_over_a_road() {
    for name in Track::NAMES {
        let (track, scenery) = scenery(name);
        for sprite in &scenery.sprites {
            let near = track.stations().iter().map(|station| {
                let d = station.position.as_vec3() - sprite.at;
                d.x.hypot(d.z)
            });
            let nearest = near.fold(f32::MAX, f32::min);
            assert!(nearest > track.half_width() as f32 + sprite.width / 2.0, "{name}: {sprite:?}");
        }
    }
}

#[test]
fn landmarks_stand_where_the_tracks_file_has_them() {
    let (track, scenery) = scenery("lake");
    for (kind, picture, count) in
        [(LandmarkKind::Pylon, sprites::picture::PYLON, 3), (LandmarkKind::Sign, sprites::picture::SIGN, 6)]
    {
        let told = track.file().landmarks.iter().filter(|landmark| landmark.kind == kind);
        let told: Vec<[f32; 2]> = told.map(|landmark| [landmark.x as f32, landmark.z as f32]).collect();
        let stand = scenery.sprites.iter().filter(|sprite| sprite.picture == picture);
        let stand: Vec<[f32; 2]> = stand.map(|sprite| [sprite.at.x, sprite.at.z]).collect();
        assert_eq!((stand.len(), stand), (count, told), "{kind:?}");
    }
}

#[test]
fn an_actor_stands_where_it_stands() {
    let (track, scenery) = scenery("lake");
    let mut renderer = Renderer::new(scenery);
    let car = car(&track, 455.0, 0.0);
    let plain = picture(&mut renderer, &Camera::CENTER, &car, &[], &Conditions::default());
    for kind in [ActorKind::Car, ActorKind::Pedestrian, ActorKind::Child, ActorKind::Cone, ActorKind::Barrier] {
        let position = track.point(467.0, 1.0);
        let actor = Actor { kind, position, yaw: track.at(467.0).yaw, speed: 0.0, look: 1 };
        let shown = picture(&mut renderer, &Camera::CENTER, &car, &[actor], &Conditions::default());
        // Above the gap between legs or bars.
        let middle = position + DVec3::Y * kind.size().y * if kind == ActorKind::Barrier { 0.45 } else { 0.6 };
        let (column, row) = column_and_row(&Camera::CENTER, &car, middle);
        let (x, y) = (column as usize, row as usize);
        assert_ne!(plain.pixel(x, y), shown.pixel(x, y), "{kind:?} at {x}, {y}");
        let far = plain.rgb().iter().zip(shown.rgb()).position(|(a, b)| a != b).unwrap() / 3;
        assert!(far / 320 > 20, "{kind:?} touches row {}", far / 320);
    }
}

#[test]
fn no_pixel_is_left_out() {
    // There is no hole between sky and ground: down a column, the sky never comes back.
    for name in Track::NAMES {
        let (track, scenery) = scenery(name);
        let mut renderer = Renderer::new(scenery);
        for k in 0..60 {
            let s = track.length() * f64::from(k) / 60.0;
            let car = car(&track, s, track.file().driving_line_m);
            picture(&mut renderer, &Camera::CENTER, &car, &[], &Conditions::default());
            let ids = &renderer.raster.ids;
            let holes = (0..320).filter(|x| (85..160).any(|y| ids[y * 320 + x] == raster::SKY)).count();
            assert_eq!(holes, 0, "{name} {s:.0} m: sky below the horizon in {holes} columns");
        }
    }
}

#[test]
fn every_size_of_picture_can_be_taken_and_encoded() {
    let (track, scenery) = scenery("mountain");
    let mut renderer = Renderer::new(scenery);
    let car = car(&track, 100.0, 0.0);
    for camera in [Camera::CENTER, Camera::RIGHT, Camera::follow(640, 360), Camera::top(128, 96), Camera::follow(1, 1)]
    {
        let frame = picture(&mut renderer, &camera, &car, &[], &Conditions::default());
        assert_eq!((frame.width(), frame.height()), (camera.lens.width, camera.lens.height));
        let jpeg = encode_jpeg(&frame, 75);
        assert!(jpeg.starts_with(&[0xFF, 0xD8, 0xFF]) && jpeg.ends_with(&[0xFF, 0xD9]));
    }
}

#[test]
fn a_car_that_is_nowhere_sees_black() {
    let (track, scenery) = scenery("lake");
    let mut renderer = Renderer::new(scenery);
    let lost = Car { yaw: f64::NAN, ..car(&track, 100.0, 0.0) };
    let frame = picture(&mut renderer, &Camera::CENTER, &lost, &[], &Conditions::default());
    assert!(frame.rgb().iter().all(|c| *c == 0));
    let frame = picture(&mut renderer, &Camera::follow(0, 0), &lost, &[], &Conditions::default());
    assert!(frame.rgb().is_empty());
}

#[test]
fn a_small_round_track_of_any_theme_has_a_scenery() {
    let points: Vec<String> = (0..12)
        .map(|k| {
            let angle = std::f64::consts::TAU * f64::from(k) / 12.0;
            format!("[{:.2}, {:.2}, {:.2}]", 30.0 * angle.sin(), 2.0 * (2.0 * angle).sin(), 30.0 * angle.cos())
        })
        .collect();
    for theme in ["lake", "jungle", "mountain"] {
        let text = format!(
            "name = \"round\"\ntheme = \"{theme}\"\nwidth_m = 7.0\nscenery_seed = 4\n\
             start = {{ x = 0.0, y = 0.0, z = 30.0, yaw_deg = 90.0 }}\ncontrol_points = [{}]\n",
            points.join(", ")
        );
        let track = Track::new(TrackFile::parse(&text).unwrap()).unwrap();
        assert!(matches!(track.file().theme, Theme::Lake | Theme::Jungle | Theme::Mountain));
        let mut renderer = Renderer::new(Arc::new(Scenery::new(&track)));
        let frame = picture(&mut renderer, &Camera::CENTER, &car(&track, 5.0, 0.0), &[], &Conditions::default());
        let road = frame.pixel(158, 110).unwrap();
        assert!(road.iter().all(|c| (30..230).contains(c)), "{theme}: {road:?}");
    }
}
