//! The road on a map: surface, edges, what stands along it, start, direction and distances.

use glam::DVec3;

use super::{Colour, INK, LETTER, LINE_PX, MapScale, PAPER, Shape};
use lapwing_sim::track::{Edge, Side, Start, Station, Theme, Track};

/// Stations in a piece of road: pieces are painted from the lowest to the highest, so that bridges are above.
const PIECE: usize = 16;

/// How an edge looks on the map: colour, and width in metres.
pub(super) fn look(edge: Edge) -> (Colour, f64, &'static str) {
    match edge {
        Edge::Kerb => ([0xd6, 0x28, 0x28], 1.2, "kerb"),
        Edge::Dirt => ([0xc9, 0x9f, 0x6b], 4.0, "dirt"),
        Edge::Bridge => ([0x11, 0x13, 0x16], 0.9, "bridge"),
        Edge::Blocks => ([0x9a, 0xa0, 0xa6], 1.4, "blocks"),
        Edge::Rock => ([0x8a, 0x7d, 0x6d], 4.0, "rock"),
        Edge::Water => ([0x8e, 0xc1, 0xde], 6.0, "water"),
        Edge::Posts => ([0xb0, 0x4e, 0x4e], 0.5, "posts"),
    }
}

/// All edges, flat and distant ones first.
pub(super) const EDGES: [Edge; 7] =
    [Edge::Water, Edge::Rock, Edge::Dirt, Edge::Kerb, Edge::Posts, Edge::Blocks, Edge::Bridge];

fn asphalt(theme: Theme) -> Colour {
    match theme {
        Theme::Lake => [0x50, 0x53, 0x58],
        Theme::Jungle => [0x5c, 0x5d, 0x5a],
        Theme::Mountain => [0x5b, 0x52, 0x4a],
    }
}

const PAVING: Colour = [0x6f, 0x69, 0x63];
const EDGE_LINE: Colour = [0xff, 0xff, 0xff];

pub(super) fn draw(track: &Track, scale: &MapScale, shapes: &mut Vec<Shape>) {
    for edge in [Edge::Water, Edge::Rock, Edge::Dirt] {
        strips(track, edge, 0..track.stations().len(), scale, shapes);
    }
    let stations = track.stations();
    let mut pieces: Vec<usize> = (0..stations.len()).step_by(PIECE).collect();
    pieces.sort_by(|&a, &b| stations[a].position.y.total_cmp(&stations[b].position.y));
    for from in pieces {
        piece(track, from, scale, shapes);
    }
    for i in 1..=(track.length() / 100.0) as u32 {
        signpost(track, f64::from(i) * 100.0, scale, shapes);
    }
}

fn beside(station: &Station, offset: f64) -> DVec3 {
    station.position + station.right() * offset
}

/// The station of an index that may lie beyond the end.
fn wrapped(track: &Track, i: usize) -> Station {
    track.stations()[i % track.stations().len()]
}

fn piece(track: &Track, from: usize, scale: &MapScale, shapes: &mut Vec<Shape>) {
    let half = track.half_width();
    let stations: Vec<Station> =
        (from..=(from + PIECE).min(track.stations().len())).map(|i| wrapped(track, i)).collect();
    let Some(first) = stations.first() else { return };
    // Pieces overlap by a little, or the paper would shine through between them.
    let back = DVec3::ZERO - first.ahead() * (0.7 / scale.px_per_m);
    let edge = |side: f64| {
        let begin = scale.at(beside(first, side * half) + back);
        std::iter::once(begin).chain(stations.iter().map(move |s| scale.at(beside(s, side * half)))).collect::<Vec<_>>()
    };
    let (left, right) = (edge(-1.0), edge(1.0));
    let is_bridge = [Side::Left, Side::Right].iter().any(|side| track.file().has(Edge::Bridge, *side, first.s));
    let colour = if is_bridge { PAVING } else { asphalt(track.file().theme) };
    shapes.push(Shape::Area { points: left.iter().chain(right.iter().rev()).copied().collect(), colour });
    for points in [left, right] {
        shapes.push(Shape::Line { points, colour: EDGE_LINE, width: (0.25 * scale.px_per_m).max(1.0) });
    }
    for edge in [Edge::Kerb, Edge::Blocks, Edge::Bridge] {
        strips(track, edge, from..(from + PIECE).min(track.stations().len()), scale, shapes);
    }
}

/// Strips along a range of stations, wherever an edge is of that kind.
fn strips(track: &Track, edge: Edge, range: std::ops::Range<usize>, scale: &MapScale, shapes: &mut Vec<Shape>) {
    let (colour, width, _) = look(edge);
    for (side, sign) in [(Side::Left, -1.0), (Side::Right, 1.0)] {
        let offset = sign * (track.half_width() + edge.stands_off_m() + width / 2.0);
        let mut points = Vec::new();
        for i in range.clone() {
            let station = wrapped(track, i);
            let is_there = track.file().has(edge, side, station.s);
            if is_there {
                points.push(scale.at(beside(&station, offset)));
            }
            let is_last = i + 1 == range.end;
            if !points.is_empty() && (!is_there || is_last) {
                points.push(scale.at(beside(&wrapped(track, i + usize::from(is_there)), offset)));
                let width = (width * scale.px_per_m).max(2.0);
                shapes.push(Shape::Line { points: std::mem::take(&mut points), colour, width });
            }
        }
    }
}

/// A chequered line across the road, and an arrow where the car is stationary.
pub(super) fn start(track: &Track, scale: &MapScale, shapes: &mut Vec<Shape>) {
    let Start { x, y, z, yaw_deg } = track.file().start;
    let car = DVec3::new(x, y, z);
    let place = track.locate(car, None);
    let (station, half) = (place.station, track.half_width());
    // Squares of at least 4 pixels, and an even number of them.
    let squares = ((half * scale.px_per_m / 4.0) as u32).clamp(1, 5) * 2;
    let size = 2.0 * half / f64::from(squares);
    for row in 0..2 {
        for column in 0..squares {
            let corner = |along: u32, across: u32| {
                let along = f64::from(row + along) - 1.0;
                let across = f64::from(column + across);
                scale.at(beside(&station, across * size - half) + station.ahead() * (along * size))
            };
            let points = vec![corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
            let colour = if (row + column) % 2 == 0 { PAPER } else { INK };
            shapes.push(Shape::Area { points, colour });
        }
    }
    let (sin, cos) = yaw_deg.to_radians().sin_cos();
    for (colour, size) in [(INK, 15.0), (PAPER, 10.0)] {
        arrow(scale.at(car), (sin, -cos), size, colour, shapes);
    }
    label(&station, "start", track, scale, shapes);
}

/// A triangle that points along a direction on the sheet.
fn arrow((x, y): super::Point, (dx, dy): (f64, f64), size: f64, colour: Colour, shapes: &mut Vec<Shape>) {
    let corner =
        |along: f64, across: f64| (x + size * (dx * along - dy * across), y + size * (dy * along + dx * across));
    let points = vec![corner(1.0, 0.0), corner(-0.6, 0.65), corner(-0.3, 0.0), corner(-0.6, -0.65)];
    shapes.push(Shape::Area { points, colour });
}

/// An arrow in driving direction beside the road, and how far along the road this is.
fn signpost(track: &Track, s: f64, scale: &MapScale, shapes: &mut Vec<Shape>) {
    let station = track.at(s);
    let across = [-1.0, 1.0].map(|side| scale.at(beside(&station, side * track.half_width())));
    shapes.push(Shape::Line { points: across.to_vec(), colour: EDGE_LINE, width: 1.5 });
    let ahead = station.ahead();
    let at = scale.at(beside(&station, track.half_width() + 9.0 / scale.px_per_m));
    arrow(at, (ahead.x, -ahead.z), 7.0, INK, shapes);
    label(&station, &format!("{s:.0}"), track, scale, shapes);
}

/// Text beside the road, clear of it whichever way the road runs: left of it, or right where the left
/// is taken by another part of the road.
fn label(station: &Station, text: &str, track: &Track, scale: &MapScale, shapes: &mut Vec<Shape>) {
    let half_width = text.len() as f64 * LETTER / 2.0;
    let place = |side: f64| {
        let out = station.right() * side;
        let away = 6.0 + (out.x * half_width).abs() + (out.z * LINE_PX / 2.0).abs();
        station.position + out * (track.half_width() + away / scale.px_per_m)
    };
    let is_clear = |middle: &DVec3| {
        track.stations().iter().all(|s| {
            // The text is wider than high.
            let apart = (s.position - *middle) * scale.px_per_m;
            let road = track.half_width() * scale.px_per_m;
            apart.x.abs() > half_width + road || apart.z.abs() > LINE_PX / 2.0 + road || {
                let nearest = (apart.x.abs() - half_width).max(0.0).hypot((apart.z.abs() - LINE_PX / 2.0).max(0.0));
                nearest > road
            }
        })
    };
    let middle = [-1.0, 1.0].map(place).into_iter().find(is_clear).unwrap_or_else(|| place(-1.0));
    let (x, y) = scale.at(middle);
    shapes.push(Shape::Text { at: (x - half_width, y), text: text.into() });
}
