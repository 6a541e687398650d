use std::collections::HashMap;

use safetensors::tensor::TensorView;
use tch::nn::VarStore;

use super::*;
use crate::nn::in_variable_store;

const PREPROCESS: &str = r#"{"crop":{"top":60,"bottom":135},"resize":{"height":66,"width":200,"filter":"bilinear-antialiased"},"colour":"yuv","scale":"x/127.5-1","layout":"nchw"}"#;

fn metadata() -> Metadata {
    Metadata {
        preprocess: serde_json::from_str(PREPROCESS).unwrap(),
        outputs: vec!["steering".into()],
        training: "drawn at random".into(),
        result: "none".into(),
    }
}

fn network() -> Network {
    let store = VarStore::new(Device::Cpu);
    Network::build(&Design::of(Architecture::PilotNet), &mut in_variable_store(store.root())).unwrap()
}

/// A checkpoint taken apart: metadata, and for each tensor its kind, shape and bytes.
struct Parts {
    metadata: HashMap<String, String>,
    tensors: HashMap<String, (Dtype, Vec<usize>, Vec<u8>)>,
}

impl Parts {
    fn of(bytes: &[u8]) -> Self {
        let file = SafeTensors::deserialize(bytes).unwrap();
        let (_, table) = SafeTensors::read_metadata(bytes).unwrap();
        let part = |(name, view): (&str, TensorView<'_>)| {
            (name.to_owned(), (view.dtype(), view.shape().to_vec(), view.data().to_vec()))
        };
        Self { metadata: table.metadata().clone().unwrap(), tensors: file.iter().map(part).collect() }
    }

    fn bytes(&self) -> Vec<u8> {
        let views = self
            .tensors
            .iter()
            .map(|(name, (dtype, shape, data))| (name, TensorView::new(*dtype, shape.clone(), data).unwrap()));
        safetensors::serialize(views, Some(self.metadata.clone())).unwrap()
    }
}

/// The error when a sound checkpoint is read after `change`.
fn error_after(change: impl FnOnce(&mut Parts)) -> String {
    let mut parts = Parts::of(&encode(&metadata(), &network(), Precision::F32).unwrap());
    change(&mut parts);
    Checkpoint::from_bytes(&parts.bytes()).unwrap_err().to_string()
}

fn set(key: &'static str, text: &'static str) -> impl FnOnce(&mut Parts) {
    move |parts| {
        parts.metadata.insert(key.into(), text.into());
    }
}

#[test]
fn what_is_saved_is_what_is_loaded_and_the_hash_is_the_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    let network = network();
    let sha256 = save(&path, &metadata(), &network, Precision::F32).unwrap();
    let loaded = Checkpoint::load(&path).unwrap();
    assert_eq!(loaded.metadata, metadata());
    assert_eq!((loaded.sha256.as_str(), sha256.len()), (sha256.as_str(), 64));
    for ((name, a), (same_name, b)) in network.tensors().iter().zip(loaded.network.tensors()) {
        assert_eq!(*name, same_name);
        assert!(a.equal(&b), "{name}");
        assert!(!b.requires_grad(), "{name}");
    }
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "no partial file stays behind");
}

#[test]
fn the_same_network_makes_the_same_bytes_loaded_or_not() {
    let bytes = encode(&metadata(), &network(), Precision::F32).unwrap();
    let again = Checkpoint::from_bytes(&bytes).unwrap();
    assert_eq!(encode(&again.metadata, &again.network, Precision::F32).unwrap(), bytes);
    assert_eq!(again.sha256, sha256(&bytes));
}

#[test]
fn half_precision_is_widened_to_f32() {
    let network = network();
    for (kind, dtype) in [(Kind::Half, Dtype::F16), (Kind::BFloat16, Dtype::BF16)] {
        let mut parts = Parts::of(&encode(&metadata(), &network, Precision::F32).unwrap());
        let (name, bias) = network.tensors().into_iter().find(|(name, _)| name == "fc1.bias").unwrap();
        let narrow = bias.detach().to_kind(kind); // (100,)
        let mut data = vec![0u8; 200];
        narrow.f_copy_data_u8(&mut data, 100).unwrap();
        parts.tensors.insert(name.clone(), (dtype, vec![100], data));
        let loaded = Checkpoint::from_bytes(&parts.bytes()).unwrap();
        let (_, read) = loaded.network.tensors().into_iter().find(|(n, _)| *n == name).unwrap();
        assert_eq!(read.kind(), Kind::Float);
        assert!(read.equal(&narrow.to_kind(Kind::Float)), "{dtype:?}");
    }
}

#[test]
fn a_file_that_is_not_there_is_named() {
    let error = Checkpoint::load("nowhere/model.safetensors").unwrap_err().to_string();
    assert_eq!(error, "nowhere/model.safetensors cannot be read: No such file or directory (os error 2)");
}

#[test]
fn bytes_that_are_not_safetensors_are_an_error() {
    let error = |bytes: &[u8]| Checkpoint::from_bytes(bytes).unwrap_err().to_string();
    assert_eq!(error(b""), "expected a whole safetensors file: header too small");
    assert_eq!(error(b"PK\x03\x04 a pickle in a zip"), "expected a whole safetensors file: header too large");
    let whole = encode(&metadata(), &network(), Precision::F32).unwrap();
    assert_eq!(
        error(&whole[..whole.len() - 1]),
        "expected a whole safetensors file: incomplete metadata, file not fully covered"
    );
    for length in [1, 7, 8, 9, 100, 1000] {
        assert!(error(&whole[..length]).starts_with("expected a whole safetensors file: "), "{length}");
    }
}

#[test]
fn a_header_that_lies_is_an_error() {
    let lie = |tensor: &str| {
        let header = format!(r#"{{"__metadata__":{{"format":"lapwing/1"}},"conv1.weight":{tensor}}}"#);
        let bytes = [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &[0; 16]].concat();
        Checkpoint::from_bytes(&bytes).unwrap_err().to_string()
    };
    for tensor in [
        r#"{"dtype":"F32","shape":[4],"data_offsets":[0,64]}"#,
        r#"{"dtype":"F32","shape":[5],"data_offsets":[0,16]}"#,
        r#"{"dtype":"F32","shape":[4],"data_offsets":[16,0]}"#,
        r#"{"dtype":"F32","shape":[18446744073709551615,8],"data_offsets":[0,16]}"#,
        r#"{"dtype":"F33","shape":[4],"data_offsets":[0,16]}"#,
    ] {
        assert!(lie(tensor).starts_with("expected a whole safetensors file: "), "{tensor}");
    }
    let huge = [&u64::MAX.to_le_bytes()[..], b"{}"].concat();
    assert!(Checkpoint::from_bytes(&huge).is_err());
}

#[test]
fn flipped_bytes_in_the_header_never_panic() {
    let whole = encode(&metadata(), &network(), Precision::F32).unwrap();
    let mut state = 1u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize
    };
    for _ in 0..300 {
        let mut bytes = whole.clone();
        bytes[random() % 2500] = random() as u8;
        let _ = Checkpoint::from_bytes(&bytes);
    }
}

#[test]
fn a_missing_metadata_key_is_named() {
    for key in ["format", "architecture", "preprocess", "outputs", "training", "result"] {
        let error = error_after(|parts| drop(parts.metadata.remove(key)));
        assert_eq!(error, format!("expected the metadata key {key}, got none"));
    }
}

#[test]
fn another_format_and_another_architecture_are_refused_with_what_is_known() {
    assert_eq!(error_after(set("format", "lapwing/2")), r#"expected the format "lapwing/1", got "lapwing/2""#);
    assert_eq!(
        error_after(set("architecture", "alexnet")),
        format!(r#"expected one of the architectures {}, got "alexnet""#, Architecture::names())
    );
}

#[test]
fn metadata_that_is_no_json_or_has_an_unknown_key_is_refused() {
    assert_eq!(error_after(set("outputs", "steering")), "metadata key outputs: expected value at line 1 column 1");
    assert_eq!(
        error_after(set("preprocess", r#"{"sharpen":1}"#)),
        "metadata key preprocess: unknown field `sharpen`, expected one of `crop`, `blur`, `colour_first`, `resize`, `crop_resized`, `colour`, `scale`, `layout` at line 1 column 10"
    );
}

#[test]
fn preprocessing_for_another_network_is_refused() {
    let with = |from: &str, to: &str| {
        let text = PREPROCESS.replace(from, to);
        error_after(|parts| drop(parts.metadata.insert("preprocess".into(), text)))
    };
    assert_eq!(with("66", "80"), "expected preprocessing to 3x66x200 for pilotnet, got 3x80x200");
    assert_eq!(with("yuv", "grey"), "expected preprocessing to 3x66x200 for pilotnet, got 1x66x200");
    assert_eq!(
        with("135", "60"),
        "metadata key preprocess: expected a crop whose top lies above its bottom, got rows 60 to 60"
    );
}

#[test]
fn the_outputs_are_as_many_as_the_networks() {
    assert_eq!(
        error_after(set("outputs", r#"["steering","throttle"]"#)),
        r#"expected 1 outputs for pilotnet, got ["steering", "throttle"]"#
    );
}

#[test]
fn a_missing_and_a_surplus_tensor_are_named() {
    assert_eq!(
        error_after(|parts| drop(parts.tensors.remove("conv1.weight"))),
        "expected the tensor conv1.weight of shape [24, 3, 5, 5], got none"
    );
    let surplus = (Dtype::F32, vec![1], vec![0; 4]);
    assert_eq!(
        error_after(|parts| drop(parts.tensors.insert("fc5.bias".into(), surplus))),
        "expected only the tensors of pilotnet, got fc5.bias as well"
    );
}

#[test]
fn a_misshapen_tensor_and_one_of_integers_are_named() {
    let put = |dtype, shape: Vec<usize>, size| {
        error_after(move |parts| drop(parts.tensors.insert("fc3.bias".into(), (dtype, shape, vec![0; size]))))
    };
    assert_eq!(put(Dtype::F32, vec![2, 5], 40), "tensor fc3.bias: expected shape [10], got [2, 5]");
    assert_eq!(put(Dtype::I64, vec![10], 80), "tensor fc3.bias: expected F32, F16 or BF16, got I64");
}

#[test]
fn weights_that_are_no_numbers_are_named() {
    for (bad, name) in [(f32::NAN, "conv3.weight"), (f32::INFINITY, "fc2.bias")] {
        let error = error_after(|parts| {
            let (_, _, data) = parts.tensors.get_mut(name).unwrap();
            data[..4].copy_from_slice(&bad.to_le_bytes());
            data[8..12].copy_from_slice(&bad.to_le_bytes());
        });
        assert_eq!(error, format!("tensor {name}: expected finite numbers, got 2 that are NaN or infinite"));
    }
}

#[test]
fn a_crop_beyond_any_picture_is_refused() {
    let text = PREPROCESS.replace("135", "1000");
    assert_eq!(
        error_after(|parts| drop(parts.metadata.insert("preprocess".into(), text))),
        "metadata key preprocess: expected a crop within a picture's rows, 0 to 480, got rows 60 to 1000"
    );
}

fn design(architecture: Architecture, speed: bool) -> (Metadata, Network) {
    let design = Design { speed, ..Design::of(architecture) };
    let store = VarStore::new(Device::Cpu);
    let network = Network::build(&design, &mut in_variable_store(store.root())).unwrap();
    let outputs = architecture.outputs().iter().map(|name| (*name).to_owned()).collect();
    (Metadata { preprocess: design.preprocess, outputs, ..metadata() }, network)
}

#[test]
fn a_network_of_several_frames_and_the_speed_is_rebuilt_as_it_was() {
    for architecture in [Architecture::Cps, Architecture::ResNet18Gru, Architecture::ResNet18Stack] {
        let (metadata, network) = design(architecture, true);
        let bytes = encode(&metadata, &network, Precision::F32).unwrap();
        let loaded = Checkpoint::from_bytes(&bytes).unwrap();
        assert_eq!((loaded.network.design(), &loaded.metadata), (network.design(), &metadata));
        for ((name, a), (_, b)) in network.tensors().iter().zip(loaded.network.tensors()) {
            assert!(a.equal(&b), "{name}");
        }
    }
}

#[test]
fn bf16_halves_the_file_and_rounds_all_but_vectors() {
    let (metadata, network) = design(Architecture::ResNet18, false);
    let whole = encode(&metadata, &network, Precision::F32).unwrap();
    let half = encode(&metadata, &network, Precision::Bf16).unwrap();
    assert!(half.len() < whole.len() * 51 / 100, "{} of {}", half.len(), whole.len());
    let loaded = Checkpoint::from_bytes(&half).unwrap();
    for ((name, a), (_, b)) in network.tensors().iter().zip(loaded.network.tensors()) {
        let expected = if a.dim() > 1 { a.to_kind(Kind::BFloat16).to_kind(Kind::Float) } else { a.detach() };
        assert!(b.equal(&expected), "{name}");
    }
    assert_eq!(encode(&loaded.metadata, &loaded.network, Precision::Bf16).unwrap(), half);
}

#[test]
fn a_file_that_does_not_say_its_inputs_means_one_frame_and_no_speed() {
    let mut parts = Parts::of(&encode(&metadata(), &network(), Precision::F32).unwrap());
    assert_eq!(parts.metadata.remove("inputs").as_deref(), Some(r#"{"frames":1,"speed":false}"#));
    let loaded = Checkpoint::from_bytes(&parts.bytes()).unwrap();
    assert!(!loaded.network.design().speed);
}

#[test]
fn inputs_that_are_not_the_architectures_are_refused() {
    assert_eq!(error_after(set("inputs", r#"{"frames":5,"speed":false}"#)), "expected 1 frames for pilotnet, got 5");
    assert_eq!(
        error_after(set("inputs", r#"{"frames":1,"speed":true}"#)),
        "tensor fc1.weight: expected shape [100, 1153], got [100, 1152]"
    );
    assert!(error_after(set("inputs", r#"{"frames":1}"#)).starts_with("metadata key inputs: missing field `speed`"));
}

#[test]
fn metadata_with_another_preprocessing_than_the_networks_is_not_written() {
    let mut metadata = metadata();
    metadata.preprocess.crop = None;
    let error = encode(&metadata, &network(), Precision::F32).unwrap_err().to_string();
    assert!(
        error.starts_with("expected the preprocessing that the network was built with, got another in its metadata: "),
        "{error}"
    );
    assert!(error.ends_with("train the network anew by its recipe (lapwing train, lapwing brake train)"), "{error}");
}
