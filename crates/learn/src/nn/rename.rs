//! Tensors of PyTorch under other names, mapped to those of an architecture where their shapes leave exactly one way.
//!
//! Names of `nn.Sequential` are the places of its layers, `0.weight`, `2.weight`; those of a class are its fields'. Tensors of
//! one layer share the name before the last point, and are mapped together.

use std::collections::BTreeMap;

use safetensors::SafeTensors;
use tch::{Device, Kind, Tensor};

use super::{Design, Network, NnError, checkpoint::read_tensor};

/// A network with the tensors of a file, and what they were called there.
#[derive(Debug)]
pub struct Renamed {
    /// The network.
    pub network: Network,
    /// For each tensor its name in the file and in the architecture, in the order in which the network uses them.
    pub names: Vec<(String, String)>,
}

/// Why tensors cannot be mapped. Its text shows all layers that are expected, and all that the file has.
#[derive(Debug, thiserror::Error)]
pub enum RenameError {
    /// The file, or a tensor of it.
    #[error(transparent)]
    Nn(#[from] NnError),
    /// Layers that are missing, or of other shapes.
    #[error(
        "expected the layers of {name} as PyTorch shapes them, with {activation} between them:\n{expected}\ngot\n{got}\nno layer \
         for {unmatched}",
        name = .0.name, activation = .0.activation, expected = .0.expected, got = .0.got, unmatched = .0.unmatched
    )]
    Layers(Box<Mismatch>),
    /// Layers of the same shapes whose names do not tell their order.
    #[error(
        "expected names that tell the order of layers of the same shapes, as nn.Sequential's 0, 2, 4, got {got}: rename them as \
         {expected} before they are saved"
    )]
    Order {
        /// The file's.
        got: String,
        /// The architecture's.
        expected: String,
    },
}

/// What was expected and what there is.
#[derive(Debug)]
pub struct Mismatch {
    name: &'static str,
    activation: &'static str,
    expected: String,
    got: String,
    unmatched: String,
}

/// A layer: what comes before the last point of its tensors' names, and the rest of each name with the shape.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Layer {
    name: String,
    tensors: BTreeMap<String, Vec<i64>>,
}

impl std::fmt::Display for Layer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let tensors: Vec<_> = self.tensors.iter().map(|(name, shape)| format!("{name} {shape:?}")).collect();
        write!(f, "  {:<10} {}", self.name, tensors.join(", "))
    }
}

/// Builds the design from the tensors of a `.safetensors` file whose names may be others.
///
/// # Errors
/// [`RenameError`].
pub fn rename(bytes: &[u8], design: &Design) -> Result<Renamed, RenameError> {
    let file = SafeTensors::deserialize(bytes).map_err(NnError::NotSafetensors)?;
    let expected = expected_layers(design)?;
    let given = layers(
        file.iter()
            .filter(|(name, _)| !name.ends_with("num_batches_tracked"))
            .map(|(name, view)| (name.to_owned(), view.shape().iter().map(|n| *n as i64).collect())),
    );
    let mut pairs: Vec<(&Layer, &Layer)> = Vec::new();
    for layer in &expected {
        // Of the same name, or else of the same shapes, the nth of them.
        let same = |of: &[Layer]| of.iter().filter(|other| other.tensors == layer.tensors).count();
        let alike: Vec<&Layer> = given.iter().filter(|other| other.tensors == layer.tensors).collect();
        let nth = expected.iter().filter(|other| other.tensors == layer.tensors).position(|other| other == layer);
        let by_name = alike.iter().find(|other| other.name == layer.name);
        let in_order = || nth.and_then(|nth| alike.get(nth)).filter(|_| alike.len() == same(&expected));
        match by_name.or_else(in_order) {
            Some(found) => pairs.push((found, layer)),
            None => return Err(mismatch(design, &expected, &given, &layer.name)),
        }
        let renamed = by_name.is_none() && alike.len() > 1;
        if renamed && !is_ordered(&alike) {
            let names = |of: Vec<&Layer>| of.iter().map(|layer| layer.name.clone()).collect::<Vec<_>>().join(", ");
            let expected = expected.iter().filter(|other| other.tensors == layer.tensors).collect();
            return Err(RenameError::Order { got: names(alike), expected: names(expected) });
        }
    }
    if let Some(surplus) = given.iter().find(|layer| !pairs.iter().any(|(found, _)| found.name == layer.name)) {
        return Err(mismatch(design, &expected, &given, &surplus.name));
    }
    let old_name = |name: &str| {
        let (layer, tensor) = parts(name);
        let pair = pairs.iter().find(|(_, expected)| expected.name == layer);
        pair.map(|(found, _)| joined(&found.name, tensor)).ok_or_else(|| missing(name))
    };
    let mut names = Vec::new();
    let network = Network::build(design, &mut |name, shape, _| {
        let old = old_name(name)?;
        let tensor = read_tensor(&file, &old, shape)?;
        names.push((old, name.to_owned()));
        Ok(tensor)
    })?;
    Ok(Renamed { network, names })
}

fn missing(name: &str) -> NnError {
    NnError::MissingTensor { name: name.to_owned(), expected: vec![] }
}

fn parts(name: &str) -> (&str, &str) {
    name.rsplit_once('.').unwrap_or(("", name))
}

fn joined(layer: &str, tensor: &str) -> String {
    if layer.is_empty() { tensor.to_owned() } else { format!("{layer}.{tensor}") }
}

/// The layers that the design asks for, in its order.
fn expected_layers(design: &Design) -> Result<Vec<Layer>, NnError> {
    let mut tensors = Vec::new();
    Network::build(design, &mut |name, shape, _| {
        tensors.push((name.to_owned(), shape.to_vec()));
        Ok(Tensor::f_zeros(shape, (Kind::Float, Device::Cpu))?)
    })?;
    let mut ordered: Vec<Layer> = Vec::new();
    for (name, shape) in tensors {
        let (layer, tensor) = parts(&name);
        let known = ordered.iter().position(|known| known.name == layer).unwrap_or_else(|| {
            ordered.push(Layer { name: layer.to_owned(), tensors: BTreeMap::new() });
            ordered.len() - 1
        });
        ordered[known].tensors.insert(tensor.to_owned(), shape);
    }
    Ok(ordered)
}

/// The layers of a file, in the order of their names: `2` before `10`.
fn layers(tensors: impl Iterator<Item = (String, Vec<i64>)>) -> Vec<Layer> {
    let mut layers: BTreeMap<Vec<(u64, String)>, Layer> = BTreeMap::new();
    for (name, shape) in tensors {
        let (layer, tensor) = parts(&name);
        let natural = layer.split('.').map(|part| (part.parse().unwrap_or(u64::MAX), part.to_owned())).collect();
        let known = layers.entry(natural).or_insert_with(|| Layer { name: layer.to_owned(), tensors: BTreeMap::new() });
        known.tensors.insert(tensor.to_owned(), shape);
    }
    layers.into_values().collect()
}

/// Whether they differ in one number alone: places in one `nn.Sequential`.
fn is_ordered(layers: &[&Layer]) -> bool {
    let split = |layer: &Layer| {
        let (sequence, place) = layer.name.rsplit_once('.').unwrap_or(("", &layer.name));
        place.parse::<u64>().ok().map(|_| sequence.to_owned())
    };
    let sequences: Vec<_> = layers.iter().map(|layer| split(layer)).collect();
    sequences.iter().all(|sequence| sequence.is_some() && *sequence == sequences[0])
}

fn mismatch(design: &Design, expected: &[Layer], given: &[Layer], unmatched: &str) -> RenameError {
    let lines = |layers: &[Layer]| layers.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
    RenameError::Layers(Box::new(Mismatch {
        name: design.architecture.name(),
        activation: design.architecture.activation(),
        expected: lines(expected),
        got: if given.is_empty() { "  no tensors".into() } else { lines(given) },
        unmatched: unmatched.to_owned(),
    }))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::nn::{Architecture, Precision, checkpoint::encode_tensors};

    /// Tensors of an architecture under other names.
    fn file(architecture: Architecture, renamed: impl Fn(&str) -> String) -> Vec<u8> {
        let mut number = 0.0;
        let mut tensors = Vec::new();
        Network::build(&Design::of(architecture), &mut |name, shape, _| {
            number += 1.0;
            let tensor = Tensor::f_full(shape, number, (Kind::Float, Device::Cpu))?;
            tensors.push((renamed(name), tensor.shallow_clone()));
            Ok(tensor)
        })
        .unwrap();
        encode_tensors(BTreeMap::new(), tensors, Precision::F32).unwrap()
    }

    /// conv1 … fc4 as the places of layers with a function behind each.
    fn sequential(name: &str) -> String {
        let (layer, tensor) = parts(name);
        let number: usize = layer[layer.len() - 1..].parse().unwrap();
        let place = if layer.starts_with("conv") { 2 * (number - 1) } else { 2 * (number + 5) };
        format!("net.{place}.{tensor}")
    }

    #[test]
    fn names_of_nn_sequential_are_mapped_where_shapes_leave_one_way() {
        let architecture = Architecture::PilotNet;
        let Renamed { network, names } = rename(&file(architecture, sequential), &Design::of(architecture)).unwrap();
        assert_eq!(names[0], ("net.0.weight".to_owned(), "conv1.weight".to_owned()));
        assert_eq!(names.last().unwrap(), &("net.18.bias".to_owned(), "fc4.bias".to_owned()));
        for (i, (name, tensor)) in network.tensors().iter().enumerate() {
            assert_eq!(tensor.double_value(&vec![0; tensor.dim()]), i as f64 + 1.0, "{name}");
        }
    }

    #[test]
    fn layers_of_the_same_shapes_are_told_apart_by_their_places_and_by_nothing_else() {
        // Convolutions 2 to 5 of `cps` have the same shapes.
        let architecture = Architecture::Cps;
        let Renamed { names, .. } = rename(&file(architecture, sequential), &Design::of(architecture)).unwrap();
        assert_eq!(names[8], ("net.8.weight".to_owned(), "conv5.weight".to_owned()));
        let fields = |name: &str| name.replace("conv", "layer_");
        let error = rename(&file(architecture, fields), &Design::of(architecture)).unwrap_err().to_string();
        assert!(error.contains("got layer_2, layer_3, layer_4, layer_5: rename them as conv2"), "{error}");
        let own = rename(&file(architecture, str::to_owned), &Design::of(architecture)).unwrap();
        assert!(own.names.iter().all(|(old, new)| old == new));
    }

    #[test]
    fn what_does_not_fit_is_told_with_all_names_shapes_and_the_activation() {
        let design = Design::of(Architecture::PilotNet);
        let error = rename(&file(Architecture::Cps, sequential), &design).unwrap_err().to_string();
        let begin = "expected the layers of pilotnet as PyTorch shapes them, with ELU between them:\n  conv1      bias [24], \
                     weight [24, 3, 5, 5]\n";
        assert!(error.starts_with(begin), "{error}");
        assert!(error.contains("\ngot\n  net.0      bias [32], weight [32, 1, 3, 3]\n"), "{error}");
        assert!(error.ends_with("no layer for conv1"), "{error}");
        let more = |name: &str| if name == "fc4.bias" { "fc4.offset".to_owned() } else { name.to_owned() };
        let error = rename(&file(Architecture::PilotNet, more), &design).unwrap_err().to_string();
        assert!(error.ends_with("no layer for fc4"), "{error}");
    }
}
