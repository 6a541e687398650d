//! What a network's steering comes from lies where the road's edges are, more often than chance: on drawn pictures, of which it
//! is known. By VisualBackProp that does not hold on the lake.
//!
//! `-- --nocapture` prints the figures of `docs/how-to/explain.md`.

use std::{path::Path, sync::Arc, time::Instant};

use lapwing_core::{perception::Frame, units::Mph};
use lapwing_learn::{
    explain::{Explainer, Method},
    models,
    nn::{Architecture, Design, Metadata, Network, Precision, in_variable_store, save},
};
use lapwing_sim::{
    camera::{Camera, Renderer, Scenery, Shot},
    conditions::Conditions,
    locate::{Overlay, Pose},
    track::Track,
};
use tch::{Device, nn::VarStore};

use crate::{program::lapwing_in, support::shared};

/// Pictures of each road, and the share of their pixels that counts as marked.
const PICTURES: usize = 20;
const MARKED: f64 = 0.05;
/// So near, in pixels, is on an edge.
const NEAR_PX: f64 = 3.0;

/// A picture of a road, and of each of its pixels, row by row, whether it is near one of the road's edges.
struct Picture {
    frame: Frame,
    near: Vec<bool>,
}

/// Pictures from all over a road.
fn pictures(road: &str) -> Vec<Picture> {
    let track = Arc::new(Track::open(road).unwrap());
    let scenery = Arc::new(Scenery::new(&track));
    let (overlay, mut renderer) = (Overlay::new(track.clone(), scenery.clone(), (320, 160)), Renderer::new(scenery));
    let half = track.half_width();
    let mut pictures = vec![];
    for i in 0..PICTURES {
        let (s_m, offset_m) = (track.length() * i as f64 / PICTURES as f64, track.file().driving_line_m);
        let pose = Pose { s_m, offset_m, ..Pose::default() };
        let mut frame = Frame::default();
        let shot = Shot {
            car: &pose.car(&track),
            actors: &[],
            conditions: &Conditions::default(),
            seed: i as u64,
            time_s: 0.0,
        };
        renderer.render(&Camera::CENTER, &shot, &mut frame);
        let edges: Vec<_> = [-half, half].into_iter().flat_map(|edge_m| along(&overlay.line(pose, edge_m))).collect();
        pictures.push(Picture { frame, near: near(&edges) });
    }
    pictures
}

/// Of each pixel of a picture, whether it is near one of these points.
fn near(points: &[(f64, f64)]) -> Vec<bool> {
    let mut near = vec![false; 320 * 160];
    let around = |at: f64, size: usize| {
        let [first, end] = [at - NEAR_PX - 1.0, at + NEAR_PX + 1.0].map(|at| at.max(0.0) as usize);
        first..end.min(size)
    };
    for &(column, row) in points {
        for y in around(row, 160) {
            for x in around(column, 320) {
                near[y * 320 + x] |= (x as f64 + 0.5 - column).hypot(y as f64 + 0.5 - row) <= NEAR_PX;
            }
        }
    }
    near
}

/// How much oftener than chance what a method marks lies on the road's edges: in the mean over pictures, the share of
/// the marked pixels that do, over the share of all pixels that the network sees.
fn on_edges(explainer: &mut Explainer, pictures: &[Picture], method: Method) -> f64 {
    let (mut marked, mut chance) = (0.0, 0.0);
    for Picture { frame, near } in pictures {
        let found = explainer.explain(frame, Mph::ZERO, method).unwrap();
        let near = &near[found.rows.start * 320..];
        let mut order: Vec<usize> = (0..found.values.len()).collect();
        order.sort_by(|a, b| found.values[*b].abs().total_cmp(&found.values[*a].abs()));
        let share = |pixels: &[usize]| pixels.iter().filter(|pixel| near[**pixel]).count() as f64 / pixels.len() as f64;
        marked += share(&order[..(MARKED * order.len() as f64) as usize]);
        chance += share(&order);
    }
    marked / chance
}

/// Points of a line, at most a pixel apart where it is seen.
fn along(line: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let between = |pair: &[(f64, f64)]| {
        let ((x, y), (x_on, y_on)) = (pair[0], pair[1]);
        let steps = ((x_on - x).hypot(y_on - y).ceil() as usize).clamp(1, 320);
        (0..steps).map(move |i| {
            let t = i as f64 / steps as f64;
            (x + t * (x_on - x), y + t * (y_on - y))
        })
    };
    let seen = |(x, y): &(f64, f64)| (-10.0..330.0).contains(x) && (-10.0..170.0).contains(y);
    line.windows(2).flat_map(|pair| between(pair).collect::<Vec<_>>()).filter(seen).collect()
}

/// The built-in network with random weights in place of what it has learnt: what any convolutions mark.
fn untrained(folder: &Path) -> Explainer {
    tch::manual_seed(5);
    let design = Design::of(Architecture::PilotNet);
    let store = VarStore::new(Device::Cpu);
    let network = Network::build(&design, &mut in_variable_store(store.root())).unwrap();
    let metadata = Metadata {
        preprocess: design.preprocess,
        outputs: vec!["steering".into()],
        training: String::new(),
        result: String::new(),
    };
    let path = folder.join("untrained.safetensors");
    save(&path, &metadata, &network, Precision::F32).unwrap();
    Explainer::of(&models::load(&path, Instant::now).unwrap()).unwrap()
}

#[test]
fn what_is_marked_lies_on_the_roads_edges_more_often_than_with_random_weights_and_mostly_than_chance() {
    let dir = tempfile::tempdir().unwrap();
    let mut trained = Explainer::of(&models::built_in(Instant::now).unwrap()).unwrap();
    let mut untrained = untrained(dir.path());
    for road in ["lake", "jungle", "mountain"] {
        let pictures = pictures(road);
        for (name, method) in
            [("VisualBackProp", Method::VisualBackProp), ("integrated gradients", Method::IntegratedGradients)]
        {
            let [learnt, control] =
                [&mut trained, &mut untrained].map(|explainer| on_edges(explainer, &pictures, method));
            println!("{road}: {name} {learnt:.2} times as often as chance, {control:.2} with random weights");
            let least = match (method, road) {
                (Method::IntegratedGradients, _) => 2.0,
                // Less often than chance, but still more often than with random weights.
                (Method::VisualBackProp, "lake") => 0.3,
                (Method::VisualBackProp, _) => 1.2,
            };
            assert!(
                learnt > least && learnt > control,
                "{road}: {name} {learnt:.2} times as often as chance, {control:.2} with random weights"
            );
        }
    }
}

#[test]
fn a_picture_of_a_recording_is_explained() {
    let dir = tempfile::tempdir().unwrap();
    let lake = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/lake.mcap");
    let (code, text, _) = lapwing_in(dir.path(), "", &["explain", lake, "--frame", "60", "--out", "why.png"]);
    assert_eq!(code, 0, "{text}");
    assert!(text.contains("moment 60: steering") && text.contains("recorded"), "{text}");
    let drawn = std::fs::read(dir.path().join("why.png")).unwrap();
    assert!(drawn.starts_with(b"\x89PNG"));
    let (code, _, text) = lapwing_in(dir.path(), "", &["explain", lake, "--frame", "60000"]);
    assert!(code == 1 && text.contains("expected a moment from 0 to 224 (--frame), got 60000"), "{code} {text}");
    if let Some(folder) = shared("recordings/jungle") {
        let (code, text, _) = lapwing_in(dir.path(), "", &["explain", folder.to_str().unwrap(), "--frame", "700"]);
        assert!(code == 0 && dir.path().join("explained.png").exists(), "{code} {text}");
    }
}
