//! Tests of what graphics settings change in a picture, and of what they leave as it is.

use std::sync::Arc;

use super::{
    raster::{COLOURED, Plane, SKY},
    tests::{car, picture, scenery},
    *,
};
use crate::{scene::ActorKind, track::Track};

/// What a pixel shows.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Shown {
    Bonnet,
    /// So many metres from the middle of the road, and from the camera.
    Road(f32, f32),
    Other,
}

fn shown(renderer: &Renderer) -> Vec<Shown> {
    let raster = &renderer.raster;
    (0..320 * 160)
        .map(|i| {
            let id = raster.ids[i];
            if raster.depth[i] == 1.0 {
                return Shown::Bonnet;
            }
            if id == SKY || id & COLOURED != 0 {
                return Shown::Other;
            }
            let setup = &raster.setups[id as usize - 1];
            let at = |plane: &Plane| plane.row(i / 320) + plane.x * (i % 320) as f32;
            let w = at(&setup.w);
            if matches!(setup.paint, Paint::Road { .. }) {
                Shown::Road((at(&setup.v) / w).abs(), 1.0 / w)
            } else {
                Shown::Other
            }
        })
        .collect()
}

/// Places at which pictures are taken, under some conditions and without.
fn compare(name: &str, text: &str, mut each: impl FnMut(Shown, [u8; 3], [u8; 3])) {
    let (track, scenery) = scenery(name);
    let mut renderer = Renderer::new(scenery);
    for k in 0..8 {
        let car = car(&track, track.length() * f64::from(k) / 8.0 + 12.0, 0.3);
        let plain = picture(&mut renderer, &Camera::CENTER, &car, &[], &Conditions::default());
        let changed = picture(&mut renderer, &Camera::CENTER, &car, &[], &Conditions::parse(text).unwrap());
        let pixels = plain.rgb().as_chunks::<3>().0.iter().zip(changed.rgb().as_chunks::<3>().0);
        for (shown, (plain, changed)) in shown(&renderer).into_iter().zip(pixels) {
            each(shown, *plain, *changed);
        }
    }
}

fn sum(pixel: [u8; 3]) -> i32 {
    pixel.iter().map(|c| i32::from(*c)).sum()
}

#[test]
fn conditions_as_they_are_anyway_change_no_byte() {
    for (name, text) in [
        ("lake", "grain=1,verge=1,warmth=0,shadows=0"),
        ("jungle", "grain=1,verge=1,warmth=0,shadows=1"),
        ("mountain", "grain=1,verge=1,warmth=0,shadows=1"),
    ] {
        compare(name, text, |_, plain, changed| assert_eq!(plain, changed, "{name}"));
    }
}

#[test]
fn grain_changes_the_road_alone_from_smooth_to_crisp() {
    for name in Track::NAMES {
        for text in ["grain=0", "grain=0.5", "grain=1.5", "grain=2"] {
            let (mut same, mut other) = (0, 0);
            compare(name, text, |shown, plain, changed| {
                if matches!(shown, Shown::Road(..)) {
                    *if plain == changed { &mut same } else { &mut other } += 1;
                } else {
                    assert_eq!(plain, changed, "{name}, {text}: {shown:?}");
                }
            });
            assert!(other > same, "{name}, {text}: {other} pixels of the road changed, {same} did not");
        }
        // Differences of neighbours across, on the asphalt ahead.
        let (track, scenery) = scenery(name);
        let mut renderer = Renderer::new(scenery);
        let car = car(&track, 262.0, 0.0);
        let mut differs = |text: &str| {
            let frame = picture(&mut renderer, &Camera::CENTER, &car, &[], &Conditions::parse(text).unwrap());
            let at = |x: usize, y: usize| sum(frame.pixel(x, y).unwrap()) as f32 / 3.0;
            let all = (92..130).flat_map(|y| (120..200).map(move |x| (y, x)));
            all.map(|(y, x)| (at(x + 1, y) - at(x, y)).abs()).sum::<f32>() / (38.0 * 80.0)
        };
        let [smooth, half, stock, crisp] = ["grain=0", "grain=0.5", "grain=1", "grain=2"].map(&mut differs);
        let rising = smooth < 0.6 * half && half < 0.8 * stock && 1.3 * stock < crisp;
        assert!(rising, "{name}: {smooth} {half} {stock} {crisp}");
    }
}

#[test]
fn verge_changes_what_is_beside_the_asphalt_and_not_the_asphalt() {
    for name in ["lake", "jungle"] {
        let half = scenery(name).0.half_width() as f32;
        for (text, times) in [("verge=0.4", 0.4), ("verge=1.7", 1.7)] {
            let (mut beside, mut nearer, mut farther) = (0, 0, 0);
            compare(name, text, |shown, plain, changed| match shown {
                Shown::Road(out, away) if out > half - 0.3 && away < 12.0 && plain != changed => {
                    beside += 1;
                    let (plain, changed) = (sum(plain), sum(changed));
                    // The asphalt is darker than nearly all that is beside it.
                    *if changed < plain { &mut nearer } else { &mut farther } += 1;
                }
                Shown::Road(out, away) if out < half - 0.6 && out > 0.4 && away < 12.0 => {
                    assert_eq!(plain, changed, "{name}, {text}: {out} m from the middle, {away} m ahead");
                }
                Shown::Road(..) => {}
                _ => assert_eq!(plain, changed, "{name}, {text}: {shown:?}"),
            });
            assert!(beside > 1500, "{name}, {text}: {beside} pixels beside the asphalt");
            if name == "lake" {
                assert_eq!(times < 1.0, nearer > farther, "{text}: {nearer} darker, {farther} brighter");
            }
        }
    }
}

#[test]
fn warmth_tints_road_and_bonnet_and_nothing_else() {
    for (text, colder) in [("warmth=-1", true), ("warmth=1.5", false)] {
        let (mut road, mut bonnet, mut wrong) = (0, 0, 0);
        compare("lake", text, |shown, plain, changed| {
            let count = match shown {
                Shown::Road(..) => &mut road,
                Shown::Bonnet => &mut bonnet,
                Shown::Other => return assert_eq!(plain, changed, "{text}"),
            };
            *count += i32::from(plain != changed);
            let bluer =
                i32::from(changed[2]) * i32::from(plain[0].max(1)) - i32::from(plain[2]) * i32::from(changed[0]);
            // Of two bytes at their limit, or next to black, none can differ.
            wrong += i32::from(
                plain[0] > 20 && changed[2] < 255 && changed[0] < 255 && (bluer < -600) == colder && bluer.abs() > 600,
            );
        });
        assert!(road > 50_000 && bonnet > 5_000, "{text}: {road} {bonnet}");
        assert!(wrong * 100 < road, "{text}: {wrong} of {road} pixels are tinted the other way");
    }
}

#[test]
fn shadows_darken_the_road_alone_as_much_as_is_asked_for() {
    // How many pixels of the road change, and by how much in all.
    let changes = |name: &str, text: &str, darker: bool| {
        let (mut pixels, mut sums) = (0, 0);
        compare(name, text, |shown, plain, changed| {
            if plain == changed {
                return;
            }
            assert!(matches!(shown, Shown::Road(..)), "{name}, {text}: {shown:?}");
            assert_eq!(sum(changed) <= sum(plain), darker, "{name}, {text}: {plain:?} {changed:?}");
            pixels += 1;
            sums += (sum(changed) - sum(plain)).abs();
        });
        (pixels, sums)
    };
    let (dark, faint) = (changes("lake", "shadows=1", true), changes("lake", "shadows=0.4", true));
    assert!(dark.0 > 800, "the lake's trees throw shadows when they are asked to: {dark:?}");
    assert!((0.33..0.47).contains(&(f64::from(faint.1) / f64::from(dark.1))), "{faint:?} of {dark:?}");
    let (none, half) = (changes("jungle", "shadows=0", false), changes("jungle", "shadows=0.5", false));
    assert!(none.0 > 800, "{none:?}");
    assert!((0.42..0.58).contains(&(f64::from(half.1) / f64::from(none.1))), "{half:?} of {none:?}");
}

#[test]
fn a_car_without_shadow_stands_on_a_road_as_bright_as_any() {
    let (track, scenery) = scenery("lake");
    let mut renderer = Renderer::new(Arc::clone(&scenery));
    let here = car(&track, 455.0, 0.0);
    let position = track.point(467.0, 1.0);
    let actor = Actor { kind: ActorKind::Car, position, yaw: track.at(467.0).yaw, speed: 0.0, look: 1 };
    let empty = picture(&mut renderer, &Camera::CENTER, &here, &[], &Conditions::default());
    let mut shaded = |text: &str| {
        let frame = picture(&mut renderer, &Camera::CENTER, &here, &[actor], &Conditions::parse(text).unwrap());
        let road = shown(&renderer);
        let pixels = empty.rgb().as_chunks::<3>().0.iter().zip(frame.rgb().as_chunks::<3>().0).zip(road);
        pixels.filter(|((a, b), road)| matches!(road, Shown::Road(..)) && 4 * sum(**b) < 3 * sum(**a)).count()
    };
    let (none, dark) = (shaded("shadows=0"), shaded(""));
    // Beside what hides a part of it, the road's grain is a little elsewhere.
    assert!(dark > 80 && none * 10 < dark, "{none} of {dark} pixels are much darker than without a car");
}

#[test]
fn the_shadow_of_somebody_behind_the_camera_falls_into_the_picture_whole() {
    let (track, scenery) = scenery("lake");
    let mut renderer = Renderer::new(Arc::clone(&scenery));
    let here = car(&track, 455.0, 0.0);
    // The sun is low behind the car, so that the shadow begins beside the camera and ends 12 m ahead of it.
    let low = format!("sun_height_deg=8,sun_azimuth_deg={}", (here.yaw.to_degrees() + 180.0).rem_euclid(360.0));
    let low = Conditions::parse(&low).unwrap();
    let position = track.point(454.6, 1.0);
    let somebody = Actor { kind: ActorKind::Pedestrian, position, yaw: here.yaw, speed: 0.0, look: 1 };
    let empty = picture(&mut renderer, &Camera::CENTER, &here, &[], &low);
    let frame = picture(&mut renderer, &Camera::CENTER, &here, &[somebody], &low);
    let pixels = empty.rgb().as_chunks::<3>().0.iter().zip(frame.rgb().as_chunks::<3>().0).zip(shown(&renderer));
    let dark = pixels.map(|((a, b), road)| matches!(road, Shown::Road(..)) && 4 * sum(*b) < 3 * sum(*a));
    let dark: Vec<bool> = dark.collect();
    let widths: Vec<usize> = dark.chunks(320).map(|row| row.iter().filter(|dark| **dark).count()).collect();
    let begins = widths.iter().position(|width| *width > 0).unwrap();
    // Down to the bonnet, 27 rows from the bottom, it widens towards the eye and has no gap.
    let seen = &widths[begins..133];
    assert!(seen.len() > 40, "{widths:?}");
    assert!(seen.array_windows().all(|[far, near]| near + 1 >= *far && *near <= far + 2), "{widths:?}");
    assert!(seen[seen.len() - 1] > 20, "{widths:?}");
}
