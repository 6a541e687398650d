//! What holds of any explanation.

use std::time::Instant;

use super::*;
use crate::{
    models,
    nn::{Architecture, Design, in_variable_store},
};
use tch::{Device, Kind, nn::VarStore};

fn shipped() -> Explainer {
    Explainer::of(&models::built_in(Instant::now).unwrap()).unwrap()
}

/// A grey road between two bright lines before a dark ground, seen from so many pixels right of its middle.
fn road_from(right_px: f64) -> Frame {
    let pixel = |i: usize| {
        let (x, y) = ((i % 320) as f64, (i / 320) as f64);
        let (middle, half) = (160.0 - right_px * (y - 60.0) / 100.0, (y - 50.0) * 1.5);
        let beside = (x - middle).abs() - half;
        if y < 60.0 {
            [140, 180, 220]
        } else if beside.abs() < 4.0 {
            [220, 210, 120]
        } else if beside < 0.0 {
            [110, 110, 110]
        } else {
            [70, 90, 50]
        }
    };
    Frame::new(320, 160, (0..320 * 160).flat_map(pixel).collect()).unwrap()
}

fn road() -> Frame {
    road_from(40.0)
}

#[test]
fn the_shares_of_all_pixels_add_up_to_what_the_picture_adds_to_the_steering() {
    let mut explainer = shipped();
    let rows = explainer.preprocessor.preprocess().area_of(320, 160).unwrap();
    let steering = |explainer: &Explainer, input: &Tensor| {
        tch::no_grad(|| explainer.network.forward(input, None, false)).unwrap().double_value(&[0, 0])
    };
    let added = [-80.0, 80.0].map(|right_px| {
        let frame = road_from(right_px);
        let input = explainer.input_of(&frame).unwrap();
        let nothing = explainer.input_of(&plain(&frame, rows.top..rows.bottom)).unwrap();
        let shares = integrated_gradients(&explainer.network, &input, &nothing, None).unwrap();
        let added = steering(&explainer, &input) - steering(&explainer, &nothing);
        let sum = shares.sum(Kind::Double).double_value(&[]);
        assert!((sum - added).abs() < 0.01, "{right_px}: expected {added}, got {sum}");
        added
    });
    assert!(added[0] > added[1] + 0.1, "from the road's left more to the right than from its right: {added:?}");
}

#[test]
fn every_network_of_one_frame_is_explained_pixel_by_pixel() {
    tch::manual_seed(3);
    for architecture in [Architecture::PilotNet, Architecture::Cps, Architecture::ResNet18] {
        let store = VarStore::new(Device::Cpu);
        let design = Design { speed: true, ..Design::of(architecture) };
        let network = Network::build(&design, &mut in_variable_store(store.root())).unwrap();
        let mut explainer = Explainer::new(network, Preprocessor::new(design.preprocess).unwrap());
        for method in [Method::VisualBackProp, Method::IntegratedGradients] {
            let found = explainer.explain(&road(), Mph::ZERO, method).unwrap();
            assert_eq!(found.values.len(), found.rows.len() * 320, "{}", architecture.name());
            assert!(found.values.iter().all(|value| (-1.0..=1.0).contains(value)), "{}", architecture.name());
            assert!(found.values.iter().any(|value| value.abs() == 1.0), "{}", architecture.name());
            let drawn = found.over(&road());
            assert_eq!((drawn.width(), drawn.height()), (320, 160));
        }
    }
}

#[test]
fn nothing_matters_in_a_picture_that_shows_nothing() {
    let grey = Frame::new(320, 160, vec![100; 320 * 160 * 3]).unwrap();
    let found = shipped().explain(&grey, Mph::ZERO, Method::IntegratedGradients).unwrap();
    assert!(found.values.iter().all(|value| *value == 0.0));
}

#[test]
fn a_network_of_several_frames_is_refused() {
    tch::manual_seed(3);
    let store = VarStore::new(Device::Cpu);
    let design = Design::of(Architecture::ResNet18Stack);
    let network = Network::build(&design, &mut in_variable_store(store.root())).unwrap();
    let metadata = crate::nn::Metadata {
        preprocess: design.preprocess,
        outputs: vec!["steering".into()],
        training: String::new(),
        result: String::new(),
    };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("stack.safetensors");
    std::fs::write(&path, crate::nn::encode(&metadata, &network, crate::nn::Precision::F32).unwrap()).unwrap();
    let error = Explainer::of(&models::load(&path, Instant::now).unwrap()).unwrap_err().to_string();
    assert!(error.starts_with("expected a network that steers by one picture"), "{error}");
}

#[test]
fn the_layer_by_itself_over_a_picture_is_the_picture_that_is_written() {
    let mut explainer = shipped();
    for method in [Method::VisualBackProp, Method::IntegratedGradients] {
        let found = explainer.explain(&road(), Mph::ZERO, method).unwrap();
        let (drawn, layer) = (found.over(&road()), found.layer(320, 160));
        assert_eq!(layer.len(), 320 * 160 * 4);
        let beneath = road();
        for (i, pixel) in layer.chunks_exact(4).enumerate() {
            for (channel, colour) in pixel[..3].iter().enumerate() {
                let (level, opacity) = (f64::from(beneath.rgb()[3 * i + channel]), f64::from(pixel[3]) / 255.0);
                let over = level * (1.0 - opacity) + f64::from(*colour) * opacity;
                let expected = f64::from(drawn.rgb()[3 * i + channel]);
                assert!((over - expected).abs() < 2.5, "{i}: expected {expected}, got {over}");
            }
        }
    }
}
