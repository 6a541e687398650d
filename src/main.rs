//! The `lapwing` program: parses, dispatches, and returns the exit status.

use std::{
    fmt,
    io::{self, Write},
    panic::{self, PanicHookInfo},
};

use lapwing::{allocator::Allocator, cli::Cli, commands};

#[global_allocator]
static ALLOCATOR: Allocator = Allocator;

/// What is told where the program itself is wrong, in place of Rust's own words.
struct Mistake<'a>(&'a PanicHookInfo<'a>);

impl fmt::Display for Mistake<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(panic) = self;
        write!(f, "error: a mistake in lapwing itself: {}", panic.payload_as_str().unwrap_or("no words"))?;
        if let Some(place) = panic.location() {
            write!(f, " ({}:{})", place.file(), place.line())?;
        }
        f.write_str("; please report this line and what you ran")
    }
}

fn main() {
    panic::set_hook(Box::new(|panic| eprintln!("{}", Mistake(panic))));
    #[cfg(feature = "networks")]
    lapwing_learn::nn::runtime::keep_tensor_memory();
    let status = match Cli::read(std::env::args_os()) {
        Ok(cli) => commands::run(cli),
        // Wrong usage; or requested help, which is a result.
        Err(told) => match (told.print().and_then(|()| io::stdout().flush()), told.use_stderr()) {
            (_, true) => 2,
            (Ok(()), false) => 0,
            (Err(_), false) => 1,
        },
    };
    commands::exit_at_once(status);
}

#[cfg(test)]
mod tests {
    use std::{
        panic::{self, catch_unwind},
        sync::mpsc,
    };

    use super::Mistake;

    #[test]
    fn a_mistake_of_the_program_is_told_in_one_line_without_rusts_words() {
        let (told, heard) = mpsc::channel();
        panic::set_hook(Box::new(move |panic| told.send(Mistake(panic).to_string()).unwrap()));
        let happened = catch_unwind(|| panic!("expected a road, got {}", 7));
        let _ = panic::take_hook();
        assert!(happened.is_err());
        let line = heard.recv().unwrap();
        assert!(line.starts_with("error: a mistake in lapwing itself: expected a road, got 7 (src/main.rs:"), "{line}");
        assert!(line.ends_with("; please report this line and what you ran") && !line.contains("thread"), "{line}");
    }
}
