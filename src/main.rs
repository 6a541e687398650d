//! The `lapwing` program: parses, dispatches, and returns the exit status.

use std::process::ExitCode;

use lapwing::{allocator::Allocator, cli::Cli, commands};

#[global_allocator]
static ALLOCATOR: Allocator = Allocator;

fn main() -> ExitCode {
    #[cfg(feature = "networks")]
    lapwing_learn::nn::runtime::keep_tensor_memory();
    match Cli::read(std::env::args_os()) {
        Ok(cli) => commands::exit_at_once(commands::run(cli)),
        // Wrong usage; or requested help, which is a result.
        Err(told) => match (told.print(), told.use_stderr()) {
            (_, true) => ExitCode::from(2),
            (Ok(()), false) => ExitCode::SUCCESS,
            (Err(_), false) => ExitCode::FAILURE,
        },
    }
}
