//! The `lapwing` program: parses, dispatches, and says how it ended.

use std::process::ExitCode;

use clap::Parser;
use lapwing::{cli::Cli, commands, nn::runtime};

fn main() -> ExitCode {
    runtime::keep_tensor_memory();
    commands::run(Cli::parse())
}
