//! `lapwing marl watch`: an episode from above.

use std::{
    fmt::Write as _,
    io::{self, IsTerminal, Write},
    thread,
    time::{Duration, Instant},
};

use super::{Ended, drivers::Drivers, print};
use crate::{
    cli::MarlWatch,
    commands::{Interrupted, interrupted, outputs},
    film::Film,
    top_view,
};
use lapwing_core::perception::Frame;
use lapwing_sim::intersection::{
    AGENTS, Action, Crash, Ending, Environment, Fault, SUBSTEP_S, crash::Hit, crash::Manner, parallel::NAMES,
};

/// A film is this many pixels wide.
const FILM: u32 = 960;
/// In the terminal a pixel is half a character: as wide as a usual window.
const TERMINAL: u32 = 118;
/// Steps a second.
const HZ: f64 = 10.0;
/// How long the end is shown, in steps.
const END: usize = 10;

pub(super) fn run(arguments: &MarlWatch) -> anyhow::Result<Ended> {
    arguments.video.as_deref().map_or(Ok(()), outputs::check_film)?;
    let mut drivers = Drivers::new(&arguments.drivers)?;
    let mut environment = Environment::new(drivers.settings(arguments.intersection), arguments.seed);
    let mut film = None;
    if let Some(path) = &arguments.video {
        let first = top_view::draw(&environment, FILM)?;
        film = Some(Film::create(path, first.width(), first.height(), HZ)?);
    }
    let mut screen = (film.is_none() && io::stdout().is_terminal()).then(Screen::new);
    let stop = interrupted();
    while !environment.is_over() && !stop.is_pressed() {
        show(&environment, film.as_mut(), screen.as_mut(), 1)?;
        let mut actions = [[Action::default(); AGENTS]];
        drivers.act(std::slice::from_ref(&environment), &mut actions)?;
        environment.step(actions[0]);
    }
    show(&environment, film.as_mut(), screen.as_mut(), END)?;
    if let Some(film) = film {
        say!("the film is in {}", film.finish()?);
    }
    print(&told(&environment, arguments.seed, &stop))?;
    Ok(if stop.is_pressed() { Ended::Failed } else { Ended::Passed })
}

/// Shows a moment for so many steps.
fn show(
    environment: &Environment,
    film: Option<&mut Film>,
    screen: Option<&mut Screen>,
    steps: usize,
) -> anyhow::Result<()> {
    if let Some(film) = film {
        let frame = top_view::draw(environment, FILM)?;
        (0..steps).try_for_each(|_| film.frame(&frame))?;
    }
    if let Some(screen) = screen {
        screen.show(&top_view::draw(environment, TERMINAL)?, &mut io::stdout().lock())?;
    }
    Ok(())
}

/// The terminal, as pixels.
struct Screen {
    next: Instant,
    is_clear: bool,
}

impl Screen {
    fn new() -> Self {
        Self { next: Instant::now(), is_clear: false }
    }

    /// Shows a picture when its time has come: two rows of pixels in a line of characters.
    fn show(&mut self, frame: &Frame, out: &mut impl Write) -> io::Result<()> {
        let mut text = String::from(if self.is_clear { "\x1b[H" } else { "\x1b[2J\x1b[H" });
        let pixel = |x, y| frame.pixel(x, y).unwrap_or_default();
        for y in (0..frame.height()).step_by(2) {
            let mut last = None;
            for x in 0..frame.width() {
                let both = (pixel(x, y), pixel(x, y + 1));
                if last.replace(both) != Some(both) {
                    let ([r, g, b], [r2, g2, b2]) = both;
                    // Writing to a string does not fail.
                    let _ = write!(text, "\x1b[38;2;{r};{g};{b}m\x1b[48;2;{r2};{g2};{b2}m");
                }
                text.push('\u{2580}');
            }
            text += "\x1b[0m\n";
        }
        thread::sleep(self.next.saturating_duration_since(Instant::now()));
        (self.is_clear, self.next) = (true, Instant::now() + Duration::from_secs_f64(1.0 / HZ));
        out.write_all(text.as_bytes())?;
        out.flush()
    }
}

/// How it went, in words.
fn told(environment: &Environment, seed: u64, stop: &Interrupted) -> String {
    let seconds = |steps: u32| f64::from(steps) * f64::from(2.0 * SUBSTEP_S);
    let mut told = format!("seed {seed}: {:.1} s", seconds(environment.steps()));
    if stop.is_pressed() {
        told += ", interrupted";
    }
    for (i, (ending, tally)) in environment.episode().into_iter().enumerate() {
        let mission = &environment.agents().missions[i];
        let way = format!("{:?} to {:?}", mission.from, mission.from.after(mission.turn)).to_lowercase();
        let end = match ending {
            Ending::Goal => "reached its goal".into(),
            Ending::OffRoad => "left the road".into(),
            Ending::TimeUp => "was still driving".into(),
            Ending::Crash(crash) => crashed(crash),
        };
        told += &format!("\n  {} {way:<14} {end} after {:.1} s", NAMES[i], seconds(tally.steps));
    }
    told
}

fn crashed(Crash { with, manner, fault }: Crash) -> String {
    let with = match with {
        Hit::Agent(other) => NAMES[usize::from(other) % AGENTS],
        Hit::Traffic(_) => "a background car",
    };
    let how = match manner {
        Manner::Crossing => "crossing",
        Manner::FromBehind => "from behind",
        Manner::Sideswipe => "side by side",
    };
    let fault = match fault {
        Fault::Own => "its own fault",
        Fault::Other => "the other's fault",
        Fault::Shared => "the fault of both",
    };
    format!("crashed with {with}, {how}, {fault},")
}

#[cfg(test)]
mod tests {
    use super::*;
    use lapwing_sim::intersection::Settings;

    #[test]
    fn a_picture_is_shown_two_rows_to_a_line_and_the_next_one_over_it() {
        let (mut screen, mut out) = (Screen::new(), Vec::<u8>::new());
        let (red, blue) = ([255_u8, 0, 0], [0_u8, 0, 255]);
        let frame = Frame::new(2, 2, [red, red, blue, blue].concat()).unwrap();
        screen.show(&frame, &mut out).unwrap();
        screen.show(&frame, &mut out).unwrap();
        let line = "\x1b[38;2;255;0;0m\x1b[48;2;0;0;255m\u{2580}\u{2580}\x1b[0m\n";
        assert_eq!(String::from_utf8(out).unwrap(), format!("\x1b[2J\x1b[H{line}\x1b[H{line}"));
    }

    #[test]
    fn the_intersection_fills_the_lines_of_a_terminal() {
        let frame = top_view::draw(&Environment::new(Settings::default(), 0), TERMINAL).unwrap();
        let mut out = Vec::<u8>::new();
        Screen::new().show(&frame, &mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        assert_eq!(text.lines().count(), frame.height() / 2);
        assert!(text.lines().all(|line| line.matches('\u{2580}').count() == TERMINAL as usize), "{text}");
    }
}
