//! Messages to the person at the terminal, and how they end a verb.
//!
//! Nobody may be there: `eprintln!` panics once the reader of stderr has gone (Ctrl-C in `lapwing serve 2>&1 | tee log`
//! ends `tee` first) or the file behind it is full, and a panic would leave a car with its last throttle. So all
//! diagnostics, including the log, go through here, and whatever cannot be written is dropped.

use std::{
    borrow::Cow,
    io::{self, Write},
    path::Path,
};

/// Prints a line to stderr, as `eprintln!` would.
macro_rules! say {
    ($($line:tt)*) => { $crate::commands::terminal::say_line(format_args!($($line)*)) };
}

/// The exit status of a program that Ctrl-C ended: 128 and the number of SIGINT.
const INTERRUPTED: u8 = 130;

pub(super) fn say_line(line: std::fmt::Arguments<'_>) {
    let _ = Log.write(format!("{}\n", legible(&line.to_string())).as_bytes()); // never an error, see there
}

/// A path as it is pasted into a shell.
pub(super) fn pasted(path: &Path) -> String {
    let text = path.display().to_string();
    let is_plain = |letter: char| letter.is_alphanumeric() || "/._-+,:@%".contains(letter);
    if !text.is_empty() && text.chars().all(is_plain) { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
}

/// Numbers of more digits than this are quoted by their beginning: `1e300` is written out otherwise.
const MOST_DIGITS: usize = 40;

/// A message as it may be shown: what it quotes, a file's name or its content, cannot steer the terminal or fill it.
fn legible(text: &str) -> String {
    let text = uncontrolled(text);
    let mut shown = String::with_capacity(text.len());
    let mut rest = &text[..];
    while let Some(first) = rest.chars().next() {
        let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
        let (piece, after) = rest.split_at(digits.max(first.len_utf8()));
        match digits > MOST_DIGITS {
            true => shown.push_str(&format!("{}... ({digits} digits)", &piece[..6])),
            false => shown.push_str(piece),
        }
        rest = after;
    }
    shown
}

/// A text whose control characters, other than those that end lines and columns, are written out, as JSON and TOML read them.
pub(super) fn uncontrolled(text: &str) -> Cow<'_, str> {
    let steers = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    if !text.contains(steers) {
        return text.into();
    }
    let written = |c: char| if steers(c) { format!("\\u{:04x}", u32::from(c)) } else { c.to_string() };
    text.chars().map(written).collect::<String>().into()
}

/// The log's destination: stderr, as far as it accepts it.
pub(super) struct Log;

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        // There is nowhere to report it, and an error here makes tracing panic.
        let _ = io::stderr().lock().write_all(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Makes a write beyond the limit on file sizes (`ulimit -f`) fail as one to a full disk does: by default the system
/// kills a program that tries.
pub(super) fn outlive_full_files() {
    #[cfg(unix)]
    // SAFETY: no handler is installed, so there is none to break a handler's rules; called before any thread starts.
    unsafe {
        libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
    }
}

/// Requests to end the program in an orderly way: Ctrl-C, SIGTERM, and SIGHUP when the terminal is closed.
#[cfg(unix)]
pub(super) struct Asked {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
    /// Absent if the person who started the program has it ignored, as `nohup` does.
    hang_up: Option<tokio::signal::unix::Signal>,
}

#[cfg(unix)]
impl Asked {
    /// Listens from now on.
    pub(super) fn listen() -> io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hang_up: if is_ignored(libc::SIGHUP) { None } else { Some(signal(SignalKind::hangup())?) },
        })
    }

    /// Waits for the first of them.
    pub(super) async fn first(&mut self) {
        let Self { interrupt, terminate, hang_up } = self;
        let hung_up = async {
            match hang_up {
                Some(hang_up) => hang_up.recv().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            _ = hung_up => {}
        }
    }

    /// Waits for Ctrl-C, and ends the program at once: pressed a second time, it means that. A terminal that closes may
    /// send several SIGHUP.
    pub(super) async fn again(&mut self) {
        self.interrupt.recv().await;
        exit_at_once(INTERRUPTED);
    }
}

/// Ends the program with this exit status, whatever its threads do. An ordinary exit runs the destructors of libtorch's
/// statics, which takes time, and crashes if a thread is at work with a network just then: one that drives when
/// Ctrl-C is pressed a second time, or one that is still loading. Results are flushed as they are printed, so none is lost.
#[cfg(unix)]
pub fn exit_at_once(status: u8) -> ! {
    // SAFETY: no pointer is passed, and nothing of this process runs after it.
    unsafe { libc::_exit(status.into()) }
}

/// Ends the program with this exit status.
#[cfg(not(unix))]
pub fn exit_at_once(status: u8) -> ! {
    std::process::exit(status.into())
}

#[cfg(unix)]
fn is_ignored(signal: libc::c_int) -> bool {
    // SAFETY: a sigaction of zeros is a valid one, and without a new action the call only writes the old one to it.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        libc::sigaction(signal, std::ptr::null(), &raw mut action) == 0 && action.sa_sigaction == libc::SIG_IGN
    }
}

/// Requests to end the program in an orderly way: Ctrl-C.
#[cfg(not(unix))]
pub(super) struct Asked;

#[cfg(not(unix))]
impl Asked {
    /// Listens from now on.
    pub(super) fn listen() -> io::Result<Self> {
        Ok(Self)
    }

    /// Waits for it.
    pub(super) async fn first(&mut self) {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending().await
        }
    }

    /// Waits for another one, and ends the program at once.
    pub(super) async fn again(&mut self) {
        self.first().await;
        exit_at_once(INTERRUPTED);
    }
}

#[cfg(test)]
mod tests {
    use super::{legible, pasted, uncontrolled};

    #[test]
    fn a_path_with_a_space_is_quoted_for_the_shell() {
        for (path, expected) in [("runs/mine-2", "runs/mine-2"), ("my run", "'my run'"), ("it's", r"'it'\''s'")] {
            assert_eq!(pasted(path.as_ref()), expected);
        }
    }

    #[test]
    fn what_is_quoted_cannot_steer_the_terminal_or_fill_it() {
        assert_eq!(legible("a\u{1b}]0;x\u{7}b\r.mcap\n\tnext é"), "a\\u001b]0;x\\u0007b\\u000d.mcap\n\tnext é");
        let name = "a\u{85}\u{7f}b";
        let json = serde_json::to_string(name).unwrap();
        assert_eq!(serde_json::from_str::<String>(&uncontrolled(&json)).unwrap(), name);
        let long = format!("got {}.5 mph", f64::MAX);
        assert_eq!(legible(&long), "got 179769... (309 digits).5 mph");
        let hash = "0123456789".repeat(4);
        assert_eq!(legible(&hash), hash);
    }
}
