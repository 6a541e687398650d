//! The car's cameras: a software renderer that gives the same picture on every machine.
//!
//! A [`Scenery`] is built once from a track and shared; a [`Renderer`] is one
//! thread's working memory. Nothing here is random from frame to frame except
//! what [`Conditions`] ask for, and that comes from the shot's seed and time.
//!
//! | file | holds |
//! |---|---|
//! | `look` | light, sky and colours of each theme, taken from real frames |
//! | `terrain` | the ground: heights, always below the roads, and their mesh |
//! | `road` | the road's strip, bridge walls, rock faces, concrete blocks |
//! | `section` | the road's cross-section: lines, kerbs, verge, antialiased |
//! | `plants`, `sprites` | trees, bushes, boulders, posts: where they stand, their pictures |
//! | `wires` | the wires of power lines |
//! | `models`, `wardrobe` | cars, people, cones and barriers, and their colours |
//! | `light` | sun and shadows on ground and road, worked out once for each sun |
//! | `viewpoint` | where a camera is, and where in its picture a point falls |
//! | `raster` | which triangle a pixel shows |
//! | `shade` | which colour it has |
//! | `bonnet`, `paintwork` | the car's own bonnet, and its colours |
//! | `contour` | where the road's own edges are seen |
//! | `weather` | [`Conditions`], laid over the finished picture |
//! | `texture`, `noise` | what surfaces are made of |
//! | `jpeg` | [`encode_jpeg`] |

mod bonnet;
pub(crate) mod contour;
mod jpeg;
mod light;
mod look;
mod models;
mod noise;
mod paintwork;
mod plants;
mod raster;
mod road;
mod scenery;
mod section;
mod shade;
mod sprites;
mod terrain;
mod texture;
pub(crate) mod viewpoint;
mod wardrobe;
mod weather;
mod wires;

#[cfg(test)]
mod graphics_tests;
#[cfg(test)]
pub(crate) mod tests;

use std::sync::Arc;

use glam::{DVec3, Vec3};

use self::{
    bonnet::Bonnet,
    light::{Light, Sun},
    raster::{Paint, Raster},
    section::Section,
    shade::{Graphics, Shader, model_light},
    viewpoint::Viewpoint,
    weather::Weather,
};
use super::{conditions::Conditions, scene::Actor, vehicle::Car};
use lapwing_core::perception::Frame;

pub use self::{bonnet::bonnet_row, jpeg::encode_jpeg, scenery::Scenery};

/// How high the stock car's origin rides over the ground, in metres: its camera at 1.2 m was measured 1.26 m up.
pub const RIDE_M: f64 = 0.06;

/// Size and field of view of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// From the top to the bottom of the picture, in degrees.
    pub vertical_fov_deg: f64,
}

impl Lens {
    /// The stock simulator's: 320x160, 60 degrees, a focal length of 138.56 pixels.
    pub const STOCK: Self = Self { width: 320, height: 160, vertical_fov_deg: 60.0 };
}

/// Where a camera sits on the car, and where it looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mount {
    /// In the car's frame: x right, y up, z forward, in metres.
    pub position: DVec3,
    /// Degrees down from straight ahead.
    pub pitch_deg: f64,
    /// Degrees to the right.
    pub yaw_deg: f64,
    /// Degrees about the line of sight, as Unity's z: positive lets the horizon fall to the right.
    pub roll_deg: f64,
}

impl Mount {
    /// A stock camera at a place on the car. It is pitched 9.5 degrees down in a body that stands nose up at speed: 7.5
    /// degrees in all, between the 7.2 measured from the yellow lines of 80 real pictures ([`super::survey`]) and the
    /// 7.8 at which the edges of the bridge meet.
    const fn stock(x: f64, z: f64) -> Self {
        Self { position: DVec3::new(x, 1.2, z), pitch_deg: 7.5, yaw_deg: 0.72, roll_deg: 1.2 }
    }
}

/// A camera on a car.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Size and field of view.
    pub lens: Lens,
    /// Where it sits.
    pub mount: Mount,
    /// Whether it sees the car's own bonnet; a camera that does not sees the whole car.
    pub bonnet: bool,
}

/// JPEG quality of the stock build's pictures.
pub const JPEG_QUALITY: u8 = 75;

/// JPEG quality of pictures that are made from recorded ones, which have already been compressed at the stock build's.
pub const JPEG_QUALITY_AGAIN: u8 = 95;

impl Camera {
    /// The stock centre camera, which is also the one of autonomous mode.
    pub const CENTER: Self = Self { lens: Lens::STOCK, mount: Mount::stock(0.0, 1.0), bonnet: true };
    /// The stock left camera.
    pub const LEFT: Self = Self { lens: Lens::STOCK, mount: Mount::stock(-0.806, 0.984), bonnet: true };
    /// The stock right camera.
    pub const RIGHT: Self = Self { lens: Lens::STOCK, mount: Mount::stock(0.825, 0.999), bonnet: true };

    /// From behind and above the car, for people.
    pub fn follow(width: usize, height: usize) -> Self {
        let mount = Mount { position: DVec3::new(0.0, 3.4, -8.0), pitch_deg: 14.0, yaw_deg: 0.0, roll_deg: 0.0 };
        Self { lens: Lens { width, height, vertical_fov_deg: 55.0 }, mount, bonnet: false }
    }

    /// From straight above, the car in the lower half of the picture, for people.
    pub fn top(width: usize, height: usize) -> Self {
        let mount = Mount { position: DVec3::new(0.0, 42.0, 9.0), pitch_deg: 90.0, yaw_deg: 0.0, roll_deg: 0.0 };
        Self { lens: Lens { width, height, vertical_fov_deg: 50.0 }, mount, bonnet: false }
    }
}

/// What one frame shows.
#[derive(Debug, Clone, Copy)]
pub struct Shot<'a> {
    /// The car that carries the camera.
    pub car: &'a Car,
    /// Everything else on the road.
    pub actors: &'a [Actor],
    /// Weather and light.
    pub conditions: &'a Conditions,
    /// Random seed of noise and rain.
    pub seed: u64,
    /// Simulated time, in seconds.
    pub time_s: f64,
}

/// One thread's working memory for pictures of a [`Scenery`].
#[derive(Debug)]
pub struct Renderer {
    scenery: Arc<Scenery>,
    light: Arc<Light>,
    sun: Sun,
    /// Cross-sections other than the scenery's own, and how much their lines and verge stand out.
    sections: Option<(f64, Vec<Section>)>,
    raster: Raster,
    bonnets: Vec<(Camera, Bonnet)>,
    weather: Weather,
}

impl Renderer {
    /// A renderer that has drawn nothing yet.
    pub fn new(scenery: Arc<Scenery>) -> Self {
        let sun = scenery.sun(&Conditions::default());
        let light = scenery.light(sun);
        let (raster, weather) = (Raster::default(), Weather::default());
        Self { scenery, light, sun, sections: None, raster, bonnets: Vec::new(), weather }
    }

    /// Paints what a camera sees. The frame takes the camera's size; its memory is reused.
    pub fn render(&mut self, camera: &Camera, shot: &Shot<'_>, frame: &mut Frame) {
        let (width, height) = (camera.lens.width, camera.lens.height);
        frame.resize(width, height);
        let sun = self.scenery.sun(shot.conditions);
        if sun != self.sun {
            self.light = self.scenery.light(sun);
            self.sun = sun;
        }
        let car = shot.car;
        let view = Viewpoint::new(&camera.lens, &camera.mount, car.position + DVec3::Y * RIDE_M, car.yaw, car.pitch);
        if frame.rgb().is_empty() || !(view.eye.is_finite() && view.forward.is_finite()) {
            frame.rgb_mut().fill(0); // from no valid position there is nothing to see
            return;
        }
        self.rasterize(&view);
        let light = Arc::clone(&self.light);
        let mut models: Vec<_> = shot.actors.iter().map(|actor| models::actor(actor, shot.time_s)).collect();
        if !camera.bonnet {
            let turned = [car.yaw, car.pitch, car.steering].map(|radians| radians as f32);
            models.extend(models::own_car(car.position.as_vec3(), turned[0], turned[1], turned[2]));
        }
        for model in models.iter().filter(|model| view.sees(model.centre, model.radius)) {
            self.raster.draw(&view, model, true, |normal| model_light(&light, normal));
        }
        let graphics = Graphics::of(shot.conditions);
        let verge = shot.conditions.verge;
        if verge != 1.0 && self.sections.as_ref().is_none_or(|(known, _)| *known != verge) {
            self.sections = Some((verge, self.scenery.sections(verge as f32)));
        }
        let others = self.sections.as_ref().filter(|_| verge != 1.0);
        let sections = others.map_or(&self.scenery.sections, |(_, sections)| sections);
        let shader = Shader { scenery: &self.scenery, light: &light, view: &view, sections, graphics };
        for sprite in &self.scenery.sprites {
            sprite.draw(&mut self.raster, &view, &self.scenery.pictures, |sprite, z| shader.tint(sprite, z));
        }
        for wire in &self.scenery.wires {
            wire.draw(&mut self.raster, &view);
        }
        let in_shadow = light.shade.map(|shade| graphics.lit(shade));
        let rgb = frame.rgb_mut();
        shader.shade(&self.raster, rgb);
        for model in &models {
            self.raster.shadow(
                &view,
                model,
                light.sun,
                |setup| matches!(setup.paint, Paint::Ground | Paint::Road { .. }),
                |i| {
                    let pixel = &mut rgb[i * 3..i * 3 + 3];
                    for (c, shade) in pixel.iter_mut().zip(in_shadow) {
                        *c = (f32::from(*c) * shade) as u8;
                    }
                },
            );
        }
        if camera.bonnet {
            let known = self.bonnets.iter().position(|(known, _)| known == camera);
            let i = known.unwrap_or_else(|| {
                self.bonnets.push((*camera, Bonnet::new(camera, self.scenery.look.bonnet)));
                self.bonnets.len() - 1
            });
            let tint = Graphics::bonnet_tint(shot.conditions);
            self.bonnets[i].1.draw((rgb, &mut self.raster.depth), car, light.sun, tint);
        }
        self.weather.apply(shot.conditions, (shot.seed, shot.time_s), (&view, car), &self.raster, rgb);
    }

    /// Says of each pixel what of the road and the land it shows.
    fn rasterize(&mut self, view: &Viewpoint) {
        self.raster.clear(view.width, view.height);
        let on = |normal: Vec3| self.light.on(normal);
        for (chunks, one_sided) in
            [(&self.scenery.strip, false), (&self.scenery.walls, true), (&self.scenery.land, true)]
        {
            for chunk in chunks {
                if view.sees(chunk.centre, chunk.radius) {
                    self.raster.draw(view, chunk, one_sided, on);
                }
            }
        }
    }
}
