//! The verbs about the program itself.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use clap_complete::Shell;

/// `lapwing config`
#[derive(Debug, Args)]
pub struct Config {
    /// Print the settings as JSON, each with its value and origin
    #[arg(long)]
    pub json: bool,
}

/// `lapwing completions`
#[derive(Debug, Args)]
pub struct Completions {
    /// Shell to write the completions for
    #[arg(value_enum)]
    pub shell: CompletedShell,
}

/// A shell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum CompletedShell {
    Bash,
    Elvish,
    Fish,
    #[value(name = "powershell")]
    PowerShell,
    Zsh,
}

impl From<CompletedShell> for Shell {
    fn from(shell: CompletedShell) -> Self {
        match shell {
            CompletedShell::Bash => Self::Bash,
            CompletedShell::Elvish => Self::Elvish,
            CompletedShell::Fish => Self::Fish,
            CompletedShell::PowerShell => Self::PowerShell,
            CompletedShell::Zsh => Self::Zsh,
        }
    }
}

/// `lapwing man`
#[derive(Debug, Args)]
pub struct Man {
    /// Write a page for each verb, lapwing.1, lapwing-model-check.1, …, to this folder [default: lapwing's own page to stdout]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}
