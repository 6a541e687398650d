//! `lapwing config`, `completions` and `man`: the program tells of itself.

use std::{collections::BTreeMap, fs, path::Path};

use anyhow::Context;
use clap::CommandFactory;
use clap_mangen::Man;

use super::{Ended, outputs, own_settings};
use crate::cli::{self, Cli};
use lapwing_core::config::{FILE, Origin};

/// Column in which origins stand.
const ORIGIN: usize = 44;

pub(super) fn config(arguments: &cli::Config, config: Option<&Path>) -> anyhow::Result<Ended> {
    let told = super::undriven_layers(config)?.told()?;
    if arguments.json {
        let by_key: BTreeMap<_, _> = told.iter().map(|setting| (&setting.key, setting)).collect();
        outputs::print(&serde_json::to_string_pretty(&by_key)?)?;
        return Ok(Ended::Passed);
    }
    let looked = |path: &Path| if path.is_file() { "read" } else { "not there" };
    let own = own_settings();
    let mut lines = vec![];
    for path in own.as_deref().into_iter().chain([config.unwrap_or(Path::new(FILE))]) {
        lines.push(format!("# {}: {}", path.display(), looked(path)));
    }
    let mut table = "";
    for setting in &told {
        let (section, key) = setting.key.rsplit_once('.').unwrap_or(("", &setting.key));
        if section != table {
            lines.push(format!("\n[{section}]"));
            table = section;
        }
        let line = format!("{key} = {}", setting.value);
        let origin = match &setting.origin {
            Origin::Default => "default".to_owned(),
            Origin::Layer(layer) => layer.clone(),
        };
        lines.push(format!("{line:<ORIGIN$} # {origin}"));
    }
    outputs::print(&lines.join("\n"))?;
    Ok(Ended::Passed)
}

pub(super) fn completions(arguments: &cli::Completions) -> anyhow::Result<Ended> {
    let mut script = Vec::new();
    clap_complete::generate(clap_complete::Shell::from(arguments.shell), &mut Cli::command(), "lapwing", &mut script);
    outputs::print(String::from_utf8(script)?.trim_end())?;
    Ok(Ended::Passed)
}

pub(super) fn man(arguments: &cli::Man) -> anyhow::Result<Ended> {
    let Some(folder) = &arguments.out else {
        outputs::print(page(Cli::command().name("lapwing"))?.trim_end())?;
        return Ok(Ended::Passed);
    };
    outputs::check_folder(folder)?;
    fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    // The verb `help` prints what these pages hold.
    let mut command = Cli::command().name("lapwing").disable_help_subcommand(true);
    command.build();
    pages(folder, "lapwing", command)?;
    Ok(Ended::Passed)
}

/// Writes the page of a command by this name, and those of its verbs.
fn pages(folder: &Path, name: &str, command: clap::Command) -> anyhow::Result<()> {
    for verb in command.get_subcommands() {
        pages(folder, &format!("{name}-{}", verb.get_name()), verb.clone())?;
    }
    outputs::write(&folder.join(format!("{name}.1")), &page(command.name(name.to_owned()))?)
}

/// A command's page, in roff.
fn page(command: clap::Command) -> anyhow::Result<String> {
    let mut page = Vec::new();
    Man::new(command).render(&mut page)?;
    Ok(String::from_utf8(page)?)
}
