//! Pretrained weights as the start of a training.

use std::{fs, path::Path};

use safetensors::SafeTensors;
use tch::Tensor;

use super::{Network, NnError, checkpoint::tensor_of, gru, stack};

/// The first convolution, which has more channels for five frames.
const FIRST: &str = "conv1.weight";

/// Copies the backbone's tensors from a file with torchvision's names into the variables that `network` was built from,
/// and those of the layers after it if they fit; returns how many there were.
///
/// PilotNet and CPS take all of a checkpoint of their own, to continue to learn.
///
/// The file is a `.safetensors` of f32, f16 or bf16, such as a ResNet's `state_dict`, or a checkpoint of this crate,
/// whose backbones use the same names; the network is then a ResNet of as many layers, with or without memory. For `-stack`
/// the first convolution is widened if the file's is for one frame.
///
/// From a checkpoint the perceptron (`head.*`) is copied as well, and the memory (`gru.*` with `out.*`), each if the
/// network has one and all its tensors are in the file with its shapes: so `resnet50-gru` can start with the perceptron
/// of a `resnet50` without the speed, and a network can continue to learn on other data. With such a perceptron a memory that
/// the file lacks starts by passing its steering on, so the network answers as the `resnet50` does.
/// `fc.*`, `num_batches_tracked` and everything else are left out. After an error nothing is changed.
///
/// # Errors
/// [`NnError::Read`], [`NnError::NotSafetensors`]; [`NnError::Shape`] and [`NnError::Dtype`] if a tensor does not fit;
/// [`NnError::NoneFits`] if the file has none for this network; [`NnError::MissingTensor`] and
/// [`NnError::SurplusTensor`] if it is a ResNet of another depth.
pub fn load_pretrained(network: &Network, path: &Path) -> Result<usize, NnError> {
    let bytes = fs::read(path).map_err(|source| NnError::Read { path: path.to_owned(), source })?;
    let file = SafeTensors::deserialize(&bytes).map_err(NnError::NotSafetensors)?;
    if !network.architecture().is_resnet() {
        return load_whole(network, path, &file);
    }
    let tensors = network.tensors();
    let (backbone, behind): (Vec<_>, Vec<_>) = tensors.into_iter().partition(|(name, _)| of_backbone(name));
    let mut taken: Vec<(Tensor, Tensor)> = Vec::new();
    let mut missing = None;
    let mut surplus: Vec<&str> = file.names();
    surplus.retain(|name| of_backbone(name) && !name.ends_with("num_batches_tracked"));
    for (name, variable) in backbone {
        let Ok(view) = file.tensor(&name) else {
            missing.get_or_insert((name, variable.size()));
            continue;
        };
        surplus.retain(|of_file| *of_file != name);
        let shape = variable.size();
        let of_one_frame = [shape[0], 3, 7, 7];
        let widens = name == FIRST && shape[1] == stack::CHANNELS && view.shape() == of_one_frame.map(|n| n as usize);
        let value = if widens {
            stack::widen(&tensor_of(&view, &name, &of_one_frame)?)?
        } else {
            tensor_of(&view, &name, &shape)?
        };
        taken.push((variable, value));
    }
    if taken.is_empty() {
        return Err(NnError::NoneFits { path: path.to_owned(), architecture: network.architecture() });
    }
    // A ResNet of another depth shares some names: its weights would give half a network.
    if let Some((name, expected)) = missing {
        return Err(NnError::MissingTensor { name, expected });
    }
    if let Some(name) = surplus.into_iter().min() {
        return Err(NnError::SurplusTensor { architecture: network.architecture(), name: name.to_owned() });
    }
    let (head, memory): (Vec<_>, Vec<_>) = behind.into_iter().partition(|(name, _)| name.starts_with("head."));
    // Whole or not at all: half a perceptron is useless.
    let mut take = |part: &[(String, Tensor)]| -> Result<bool, NnError> {
        let fits = |(name, variable): &(String, Tensor)| {
            file.tensor(name).is_ok_and(|of| of.shape().iter().map(|n| *n as i64).eq(variable.size()))
        };
        let all = part.iter().all(fits);
        for (name, variable) in part.iter().filter(|_| all) {
            let value = tensor_of(&file.tensor(name).map_err(NnError::NotSafetensors)?, name, &variable.size())?;
            taken.push((variable.shallow_clone(), value));
        }
        Ok(all)
    };
    let (has_head, has_memory) = (take(&head)?, take(&memory)?);
    let count = taken.len();
    if has_head && !has_memory {
        taken.extend(gru::passing_on(memory)?);
    }
    tch::no_grad(|| {
        for (variable, value) in &mut taken {
            variable.f_copy_(value)?;
        }
        Ok(count)
    })
}

/// Copies all tensors of a checkpoint of the same architecture: the smaller networks have no backbone of their own.
fn load_whole(network: &Network, path: &Path, file: &SafeTensors<'_>) -> Result<usize, NnError> {
    let none_fits = || NnError::NoneFits { path: path.to_owned(), architecture: network.architecture() };
    if file.len() != network.tensors().len() {
        return Err(none_fits());
    }
    let value = |(name, variable): (String, Tensor)| {
        let view = file.tensor(&name).map_err(|_| none_fits())?;
        Ok((tensor_of(&view, &name, &variable.size())?, variable))
    };
    let taken: Vec<_> = network.tensors().into_iter().map(value).collect::<Result<_, NnError>>()?;
    tch::no_grad(|| {
        for (value, mut variable) in taken {
            variable.f_copy_(&value)?;
        }
        Ok(file.len())
    })
}

/// Whether a ResNet's tensor belongs to the part that torchvision also has.
pub(super) fn of_backbone(name: &str) -> bool {
    stage(name).is_some()
}

/// The stage of the backbone, 1 to 4, to which the tensor of this name belongs; the first convolution counts as of the first.
pub(super) fn stage(name: &str) -> Option<usize> {
    match name.split('.').next().unwrap_or_default() {
        "conv1" | "bn1" | "layer1" => Some(1),
        "layer2" => Some(2),
        "layer3" => Some(3),
        "layer4" => Some(4),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind, nn::VarStore};

    use super::*;
    use crate::nn::{Architecture, Design, Metadata, Precision, in_variable_store, save};

    fn fresh(architecture: Architecture) -> (VarStore, Network) {
        let store = VarStore::new(Device::Cpu);
        let network = Network::build(&Design::of(architecture), &mut in_variable_store(store.root())).unwrap();
        (store, network)
    }

    /// A file like torchvision's ResNet18, with `fc` and counts of batches, and the weights in it.
    fn file(folder: &tempfile::TempDir) -> (std::path::PathBuf, VarStore) {
        let (store, network) = fresh(Architecture::ResNet18);
        let mut tensors = network.tensors();
        tensors.retain(|(name, _)| of_backbone(name));
        tensors.push(("fc.weight".into(), Tensor::zeros([1000, 512], (Kind::Float, Device::Cpu))));
        tensors.push(("bn1.num_batches_tracked".into(), Tensor::from(7i64)));
        let tensors: Vec<_> = tensors.iter().map(|(name, t)| (name.as_str(), t.detach())).collect();
        let path = folder.path().join("resnet18.safetensors");
        Tensor::write_safetensors(&tensors, &path).unwrap();
        (path, store)
    }

    #[test]
    fn the_backbone_is_taken_from_a_file_and_the_head_stays() {
        let folder = tempfile::tempdir().unwrap();
        let (path, from) = file(&folder);
        for architecture in [Architecture::ResNet18, Architecture::ResNet18Gru] {
            let (store, network) = fresh(architecture);
            let head = store.variables()["head.1.weight"].copy();
            // 20 convolutions, each with four vectors of its batch norm.
            assert_eq!(load_pretrained(&network, &path).unwrap(), 100);
            let variables = store.variables();
            for (name, tensor) in from.variables().into_iter().filter(|(name, _)| of_backbone(name)) {
                assert!(variables[&name].equal(&tensor), "{name}");
            }
            assert!(variables["head.1.weight"].equal(&head) && variables["conv1.weight"].requires_grad());
        }
    }

    #[test]
    fn with_a_resnets_weights_five_frames_are_answered_as_the_newest_alone_was() {
        let folder = tempfile::tempdir().unwrap();
        let (path, from) = file(&folder);
        let (mut store, stacked) = fresh(Architecture::ResNet18Stack);
        assert_eq!(load_pretrained(&stacked, &path).unwrap(), 100);
        let (mut one, single) = fresh(Architecture::ResNet18);
        one.copy(&from).unwrap();
        for store in [&mut store, &mut one] {
            store.freeze();
        }
        for (name, variable) in store.variables() {
            if name.starts_with("head.") {
                variable.shallow_clone().copy_(&one.variables()[&name]);
            }
        }
        let five = Tensor::randn([2, 5, 3, 40, 70], (Kind::Float, Device::Cpu)); // (2, 5, 3, 40, 70)
        let expected = single.forward(&five.select(1, 4), None, false).unwrap();
        let difference = (stacked.forward(&five, None, false).unwrap() - expected).abs().max().double_value(&[]);
        assert!(difference < 1e-4, "{difference}");
    }

    #[test]
    fn a_file_for_another_network_is_an_error_and_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let (path, _from) = file(&folder);
        let (store, network) = fresh(Architecture::ResNet50);
        let before = store.variables()["bn1.weight"].copy();
        let error = load_pretrained(&network, &path).unwrap_err().to_string();
        assert_eq!(error, "tensor layer1.0.conv1.weight: expected shape [64, 64, 1, 1], got [64, 64, 3, 3]");
        assert!(store.variables()["bn1.weight"].equal(&before));
        let (_store, network) = fresh(Architecture::PilotNet);
        let error = load_pretrained(&network, &path).unwrap_err().to_string();
        assert!(error.starts_with("expected tensors for the backbone of pilotnet in "), "{error}");
        let missing = load_pretrained(&network, Path::new("no.safetensors")).unwrap_err();
        assert!(matches!(missing, NnError::Read { .. }));
    }

    #[test]
    fn weights_of_a_resnet_of_another_depth_are_refused_whole() {
        let folder = tempfile::tempdir().unwrap();
        let (path, _) = file(&folder);
        let (_store, network) = fresh(Architecture::ResNet18);
        let tensors = Tensor::read_safetensors(&path).unwrap();
        let write = |tensors: Vec<(String, Tensor)>| Tensor::write_safetensors(&tensors, &path).unwrap();
        let mut deeper: Vec<_> = tensors.iter().map(|(n, t)| (n.clone(), t.shallow_clone())).collect();
        deeper.push(("layer1.2.bn1.weight".into(), Tensor::ones([64], (Kind::Float, Device::Cpu))));
        write(deeper);
        assert!(
            matches!(load_pretrained(&network, &path), Err(NnError::SurplusTensor { name, .. }) if name == "layer1.2.bn1.weight")
        );
        write(tensors.into_iter().filter(|(name, _)| name != "layer4.1.conv2.weight").collect());
        assert!(
            matches!(load_pretrained(&network, &path), Err(NnError::MissingTensor { name, .. }) if name == "layer4.1.conv2.weight")
        );
    }

    /// A checkpoint of a fresh network as training writes it, and its weights.
    fn checkpoint(folder: &tempfile::TempDir, design: &Design) -> (std::path::PathBuf, VarStore) {
        let store = VarStore::new(Device::Cpu);
        let network = Network::build(design, &mut in_variable_store(store.root())).unwrap();
        let text = String::new;
        let preprocess = design.preprocess.clone();
        let metadata = Metadata { preprocess, outputs: vec!["steering".into()], training: text(), result: text() };
        let path = folder.path().join("model.safetensors");
        save(&path, &metadata, &network, Precision::F32).unwrap();
        (path, store)
    }

    #[test]
    fn of_a_checkpoint_the_perceptron_is_taken_and_the_memory_where_there_is_one() {
        let folder = tempfile::tempdir().unwrap();
        let (path, from) = checkpoint(&folder, &Design::of(Architecture::ResNet18));
        let (store, network) = fresh(Architecture::ResNet18Gru);
        assert_eq!(load_pretrained(&network, &path).unwrap(), 106);
        for name in ["conv1.weight", "head.1.weight", "head.3.bias"] {
            assert!(store.variables()[name].equal(&from.variables()[name]), "{name}");
        }
        // The memory starts by passing on what the perceptron says of the newest frame.
        let five = Tensor::randn([4, 5, 3, 40, 70], (Kind::Float, Device::Cpu)); // (4, 5, 3, 40, 70)
        let single = Network::build(
            &Design::of(Architecture::ResNet18),
            &mut in_variable_store(VarStore::new(Device::Cpu).root()),
        );
        let single = single.unwrap();
        load_pretrained(&single, &path).unwrap();
        let expected = single.forward(&five.select(1, 4), None, false).unwrap();
        let difference = (network.forward(&five, None, false).unwrap() - &expected).abs().max().double_value(&[]);
        assert!(difference < 0.01 && expected.std(false).double_value(&[]) > 0.0, "{difference}");

        let (path, from) = checkpoint(&folder, &Design::of(Architecture::ResNet18Gru));
        assert_eq!(load_pretrained(&network, &path).unwrap(), 112);
        assert!(store.variables()["out.weight"].equal(&from.variables()["out.weight"]));
    }

    #[test]
    fn a_pilotnet_goes_on_from_all_weights_of_another() {
        let folder = tempfile::tempdir().unwrap();
        let (path, from) = checkpoint(&folder, &Design::of(Architecture::PilotNet));
        let (store, network) = fresh(Architecture::PilotNet);
        assert_eq!(load_pretrained(&network, &path).unwrap(), 18);
        let from = from.variables();
        assert!(store.variables().iter().all(|(name, tensor)| tensor.equal(&from[name])));
        let (_store, other) = fresh(Architecture::Cps);
        assert!(matches!(load_pretrained(&other, &path), Err(NnError::NoneFits { .. })));
    }

    #[test]
    fn a_perceptron_of_another_shape_is_left_out_whole() {
        let folder = tempfile::tempdir().unwrap();
        let (path, _from) = checkpoint(&folder, &Design { speed: true, ..Design::of(Architecture::ResNet18) });
        let (store, network) = fresh(Architecture::ResNet18Gru);
        let last = store.variables()["head.3.weight"].copy();
        assert_eq!(load_pretrained(&network, &path).unwrap(), 100);
        assert!(store.variables()["head.3.weight"].equal(&last));
    }
}
