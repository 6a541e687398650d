//! The intersection from above, as a picture: roads, goals, cars, and how the agents are doing.
//!
//! Up is north. The same moment gives the same picture.

use lapwing_core::perception::Frame;
use lapwing_score::drawing::{Colour, LINE_PX, MARGIN, PaintError, Point, Shape, Sheet};
use lapwing_sim::intersection::{
    AGENTS, Ending, Environment, LENGTH_M, SUBSTEP_S, WIDTH_M,
    parallel::NAMES,
    roads::{Arm, HALF_BOX_M, LANE_M, Pose},
};

/// The agents' colours.
const AGENTS_COLOURS: [Colour; AGENTS] =
    [[0xe6, 0x39, 0x46], [0x1d, 0x7d, 0xd6], [0xf7, 0xb5, 0x00], [0xb0, 0x4b, 0xe0]];
const GRASS: Colour = [0x8f, 0xa9, 0x7c];
const ASPHALT: Colour = [0x4a, 0x4d, 0x52];
const PAINT: Colour = [0xe8, 0xe8, 0xe4];
const TRAFFIC: Colour = [0xc9, 0xcd, 0xd2];
const GLASS: Colour = [0x1c, 0x22, 0x2a];
/// Around the roads, in metres.
const AROUND_M: f32 = 3.0;

/// From metres to pixels.
#[derive(Clone, Copy)]
struct Scale {
    px_per_m: f64,
    /// The upper left corner, in metres.
    left: f32,
    top: f32,
}

impl Scale {
    fn at(&self, x: f32, y: f32) -> Point {
        (f64::from(x - self.left) * self.px_per_m, f64::from(self.top - y) * self.px_per_m)
    }
}

/// A picture this many pixels wide, with a line of words for each agent if there is room for it.
///
/// # Errors
/// [`PaintError::Size`].
pub fn draw(environment: &Environment, width: u32) -> Result<Frame, PaintError> {
    sheet(environment, width).frame()
}

fn sheet(environment: &Environment, width: u32) -> Sheet {
    let end = |arm: Arm| HALF_BOX_M + arm.length_m() + AROUND_M;
    let (left, top) = (-end(Arm::West), end(Arm::North));
    let (across, along) = (end(Arm::East) - left, top + end(Arm::South));
    let scale = Scale { px_per_m: f64::from(width) / f64::from(across), left, top };
    // Even, as films want it.
    let height = (f64::from(along) * scale.px_per_m / 2.0).ceil() * 2.0;
    let mut shapes = vec![Shape::rectangle((0.0, 0.0), (f64::from(width), height), GRASS)];
    roads(&scale, &mut shapes);
    let (agents, alive, endings) = (environment.agents(), environment.alive(), environment.endings());
    for i in 0..AGENTS {
        let (x, y) = agents.goals[i];
        if alive[i] {
            diamond(scale.at(x, y), 1.4 * scale.px_per_m, AGENTS_COLOURS[i], &mut shapes);
        }
    }
    let traffic = environment.traffic();
    for j in (0..traffic.places).filter(|j| traffic.present[*j]) {
        car(&traffic.pose[j], TRAFFIC, &scale, &mut shapes);
    }
    for i in 0..AGENTS {
        let pose = Pose { x: agents.x[i], y: agents.y[i], hx: agents.hx[i], hy: agents.hy[i] };
        match endings[i] {
            None => car(&pose, AGENTS_COLOURS[i], &scale, &mut shapes),
            Some(Ending::Goal) => {}
            Some(_) => cross(scale.at(pose.x, pose.y), 1.6 * scale.px_per_m, AGENTS_COLOURS[i], &mut shapes),
        }
    }
    if scale.px_per_m > 4.0 {
        words(environment, &mut shapes);
    }
    Sheet { width: f64::from(width), height, title: "intersection4".into(), shapes }
}

fn words(environment: &Environment, shapes: &mut Vec<Shape>) {
    let (agents, endings) = (environment.agents(), environment.endings());
    let seconds = environment.steps() as f32 * 2.0 * SUBSTEP_S;
    shapes.push(Shape::text((MARGIN, MARGIN), 0.0, format!("{seconds:.1} s")));
    for i in 0..AGENTS {
        let y = MARGIN + (i + 1) as f64 * 1.25 * LINE_PX;
        diamond((MARGIN + 5.0, y), 6.0, AGENTS_COLOURS[i], shapes);
        let does = match endings[i] {
            None => format!("{:.1} m/s", agents.speed[i]),
            Some(Ending::Goal) => "goal".into(),
            Some(Ending::Crash(_)) => "crash".into(),
            Some(Ending::OffRoad) => "off road".into(),
            Some(Ending::TimeUp) => "time up".into(),
        };
        shapes.push(Shape::text((MARGIN + 18.0, y), 0.0, format!("{} {does}", NAMES[i])));
    }
}

fn roads(scale: &Scale, shapes: &mut Vec<Shape>) {
    let half = 2.0 * LANE_M;
    let kerb = HALF_BOX_M - half;
    // The box with its round corners, clockwise from the north-east one.
    let corner = |i: usize| {
        let (sx, sy) = [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)][i];
        (0..=8).map(move |n| {
            let (sin, cos) = (n as f32 / 8.0 * std::f32::consts::FRAC_PI_2).sin_cos();
            let (a, b) = (HALF_BOX_M - kerb * cos, HALF_BOX_M - kerb * sin);
            if i.is_multiple_of(2) { (sx * a, sy * b) } else { (sx * b, sy * a) }
        })
    };
    let points = (0..4).flat_map(corner).map(|(x, y)| scale.at(x, y)).collect();
    shapes.push(Shape::Area { points, colour: ASPHALT });
    for arm in Arm::ALL {
        let end = HALF_BOX_M + arm.length_m();
        // On the arm's own axes: to the right of the middle, and away from the box.
        let at = |right: f32, out: f32| {
            let (x, y) = match arm {
                Arm::South => (right, -out),
                Arm::West => (-out, -right),
                Arm::North => (-right, out),
                Arm::East => (out, right),
            };
            scale.at(x, y)
        };
        let overlap = HALF_BOX_M - 0.3;
        let points = vec![at(-half, overlap), at(half, overlap), at(half, end), at(-half, end)];
        shapes.push(Shape::Area { points, colour: ASPHALT });
        let mut line = |from: Point, to: Point, metres: f64| {
            let width = (metres * scale.px_per_m).max(0.6);
            shapes.push(Shape::Line { points: vec![from, to], colour: PAINT, width });
        };
        line(at(0.0, HALF_BOX_M), at(0.0, end), 0.3);
        line(at(0.0, HALF_BOX_M), at(half, HALF_BOX_M), 0.4);
        for side in [-LANE_M, LANE_M] {
            let dashes = (arm.length_m() / 6.0) as i32;
            for dash in 0..dashes {
                let out = HALF_BOX_M + 3.0 + dash as f32 * 6.0;
                line(at(side, out), at(side, out + 3.0), 0.15);
            }
        }
    }
}

fn car(pose: &Pose, colour: Colour, scale: &Scale, shapes: &mut Vec<Shape>) {
    // A part of the car, from and until so far ahead of its middle.
    let part = |from: f32, until: f32, width: f32| {
        let corner = |ahead: f32, right: f32| {
            scale.at(pose.x + ahead * pose.hx + right * pose.hy, pose.y + ahead * pose.hy - right * pose.hx)
        };
        let half = width / 2.0;
        vec![corner(from, -half), corner(until, -half), corner(until, half), corner(from, half)]
    };
    shapes.push(Shape::Area { points: part(-LENGTH_M / 2.0, LENGTH_M / 2.0, WIDTH_M), colour });
    shapes.push(Shape::Area { points: part(0.25, 0.95, WIDTH_M * 0.8), colour: GLASS });
}

fn diamond((x, y): Point, r: f64, colour: Colour, shapes: &mut Vec<Shape>) {
    shapes.push(Shape::Area { points: vec![(x, y - r), (x + r, y), (x, y + r), (x - r, y)], colour });
}

fn cross((x, y): Point, r: f64, colour: Colour, shapes: &mut Vec<Shape>) {
    for (dx, dy) in [(r, r), (r, -r)] {
        shapes.push(Shape::Line {
            points: vec![(x - dx, y - dy), (x + dx, y + dy)],
            colour,
            width: (r / 3.0).max(1.0),
        });
    }
}

#[cfg(test)]
mod tests {
    use lapwing_sim::intersection::{Action, Settings};

    use super::*;

    #[test]
    fn the_agents_are_where_they_are_and_grass_is_beside_the_roads() {
        let mut environment = Environment::new(Settings { cars: 12, ..Settings::default() }, 3);
        environment.step([Action::KeepLane; AGENTS]);
        let sheet = sheet(&environment, 960);
        let frame = sheet.frame().unwrap();
        assert_eq!((frame.width() % 2, frame.height() % 2), (0, 0));
        let scale = Scale { px_per_m: 960.0 / 153.6, left: -76.8, top: 60.4 };
        let at = |x: f32, y: f32| {
            let (x, y) = scale.at(x, y);
            frame.pixel(x as usize, y as usize).unwrap()
        };
        let agents = environment.agents();
        for (i, colour) in AGENTS_COLOURS.into_iter().enumerate() {
            // Its boot: the windows are in front of the middle.
            let boot = at(agents.x[i] - 1.2 * agents.hx[i], agents.y[i] - 1.2 * agents.hy[i]);
            assert_eq!(boot, colour, "{i}");
        }
        assert_eq!(at(30.0, 30.0), GRASS);
        assert_eq!(at(7.2, -7.2), ASPHALT, "the corner is round");
        assert_eq!(at(9.8, -9.8), GRASS);
    }
}
