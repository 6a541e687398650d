//! `lapwing model`: looks at a model's file, or makes one.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::{Context, bail};

use super::{
    Ended,
    outputs::{self, Usage},
};
use crate::cli::{self, ModelVerb};
use lapwing_core::words::{count, did_you_mean};
use lapwing_learn::{
    models::{self, SideFile, check},
    nn::{Architecture, Checkpoint, Design, Metadata, Precision, rename::rename, runtime, save},
};

/// A run of the lake, which the repository and the archive of a release hold.
const SHIPPED: &str = "recordings/lake.mcap";

pub(super) fn run(arguments: &cli::Model) -> anyhow::Result<Ended> {
    match &arguments.verb {
        ModelVerb::Check(arguments) => checked(arguments),
        ModelVerb::Rename(arguments) => renamed(arguments),
    }
}

fn checked(arguments: &cli::ModelCheck) -> anyhow::Result<Ended> {
    let pictures = arguments.pictures.as_deref();
    pictures.map(outputs::check_folder).transpose()?;
    // First: what is wrong with the network matters, whatever it would be shown.
    let model = match &arguments.model {
        Some(path) => models::load(path, Instant::now)?,
        None => models::built_in(Instant::now)?,
    };
    let run = match &arguments.run {
        Some(run) => run.clone(),
        None => {
            let program = std::env::current_exe().unwrap_or_default();
            let folders = [Some(Path::new("")), program.parent()];
            shipped_run(folders.into_iter().flatten())?
        }
    };
    // As `drive` does.
    runtime::set_threads(1);
    let checked = check::check(&model, &run, pictures).with_context(|| {
        format!("{}: cannot be shown to {} (--run RUN names another recording)", run.display(), model.name())
    })?;
    outputs::print(&if arguments.json { serde_json::to_string_pretty(&checked)? } else { checked.to_string() })?;
    Ok(if checked.troubles.is_empty() { Ended::Passed } else { Ended::Failed })
}

/// The run that Lapwing ships, in the first of these folders that has it.
fn shipped_run<'a>(mut folders: impl Iterator<Item = &'a Path>) -> anyhow::Result<PathBuf> {
    let found = folders.find_map(|folder| Some(folder.join(SHIPPED)).filter(|run| run.is_file()));
    found.with_context(|| {
        format!("expected {SHIPPED} here or beside the program, found none: --run RUN names a recording")
    })
}

fn renamed(arguments: &cli::ModelRename) -> anyhow::Result<Ended> {
    let cli::ModelRename { input, network, out, preprocess } = arguments;
    let Some(architecture) = Architecture::named(network) else {
        let names = Architecture::ALL.map(Architecture::name);
        let (expected, meant) = (names.join(", "), did_you_mean(network, names));
        bail!(Usage(format!("--network: expected one of {expected}, got {network:?}{meant}")));
    };
    if input.extension().is_none_or(|ending| ending != "safetensors") {
        let todo = match models::advice(input) {
            Some((kind, todo)) => format!("got {kind}: {todo}"),
            None if models::is_torchscript(input) => {
                let weights = models::UNPICKLE;
                format!("a TorchScript network drives as it is, with --model; if it holds pickled weights, {weights}")
            }
            None => "whole networks (.onnx, .pt) drive as they are, with --model (docs/how-to/own-network.md)".into(),
        };
        bail!("{}: expected PyTorch's tensors, a file ending in .safetensors; {todo}", input.display());
    }
    outputs::check_network(out, [input.as_path()])?;
    if out.extension().is_none_or(|extension| extension != "safetensors") {
        bail!(Usage(format!("--out: expected a file ending in .safetensors, got {}", out.display())));
    }
    let beside = input.with_extension("toml");
    // Beside a network that was trained here, it is a recipe.
    let taken = || {
        let (beside, input) = (beside.display(), input.display());
        format!("{beside} beside {input} was read for its preprocessing; --preprocess FILE names another file")
    };
    let side = match preprocess {
        Some(path) => Some(SideFile::read(path)?),
        None if beside.is_file() => Some(SideFile::beside(input).with_context(taken)?),
        None => None,
    };
    let bytes = fs::read(input).with_context(|| format!("{} cannot be read", input.display()))?;
    // Of a checkpoint of ours all that it says is kept, but for the preprocessing if a file says another.
    let ours = Checkpoint::from_bytes(&bytes).ok().filter(|ours| ours.network.architecture() == architecture);
    let mut design = ours.as_ref().map_or_else(|| Design::of(architecture), |ours| ours.network.design().clone());
    let outputs: Vec<String> = architecture.outputs().iter().map(|name| (*name).to_owned()).collect();
    let own = side.is_none();
    if let Some(side) = side {
        anyhow::ensure!(
            side.outputs == outputs,
            "expected the outputs {outputs:?} of {network}, got {:?}",
            side.outputs
        );
        design.preprocess = side.preprocess;
    }
    let renamed = rename(&bytes, &design).with_context(|| input.display().to_string())?;
    let training = format!("made elsewhere; tensors of {}", name_of(input));
    let made = Metadata { preprocess: design.preprocess.clone(), outputs, training, result: String::new() };
    let is_ours = ours.is_some();
    let preprocess = made.preprocess.clone();
    let metadata = ours.map_or(made, |ours| Metadata { preprocess, ..ours.metadata });
    save(out, &metadata, &renamed.network, Precision::F32)?;
    let moved = renamed.names.iter().filter(|(old, new)| old != new);
    let mut lines: Vec<String> = moved.map(|(old, new)| format!("{old:<24} {new}")).collect();
    let tensors = count(renamed.names.len(), "tensor");
    lines.push(format!(
        "{}: {tensors} of {network}, which has {} between its layers",
        out.display(),
        architecture.activation()
    ));
    lines.push(if is_ours && own {
        "preprocessing and training: as the checkpoint says".into()
    } else if own {
        format!("preprocessing: {network}'s own; --preprocess FILE.toml says another (docs/how-to/own-network.md)")
    } else {
        "preprocessing: as the .toml says".into()
    });
    lines.push(format!("look at it: lapwing model check {}", out.display()));
    outputs::print(&lines.join("\n"))?;
    Ok(Ended::Passed)
}

fn name_of(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_run_is_looked_for_here_and_beside_the_program() {
        let [here, program] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let found = || shipped_run([here.path(), program.path()].into_iter());
        assert!(found().unwrap_err().to_string().contains("--run RUN names a recording"));
        for folder in [&program, &here] {
            fs::create_dir(folder.path().join("recordings")).unwrap();
            fs::write(folder.path().join(SHIPPED), "").unwrap();
            assert_eq!(found().unwrap(), folder.path().join(SHIPPED));
        }
    }
}
