//! Runs as one page for a browser: everything in it, nothing fetched.
//!
//! A [`Collector`] watches a run as the scorer does and keeps what is drawn: series thinned out to what a screen shows,
//! pictures spread over the run, and those around each event. The page draws itself: `page.js` says what stands where,
//! `map.js` draws the road with the driven lines, `charts.js` the curves by uPlot, which lies in `uplot/` as its authors
//! ship it, and `tables.js` the tables, which can be sorted. Runs of one road are laid over one another.

mod strip;

use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};

pub use strip::Strip;

use base64::{Engine, engine::general_purpose::STANDARD};
use bytes::Bytes;
use serde::Serialize;

use super::{Figure, Scorecard, figure::Described};
use lapwing_core::recording::{EventRecord, Item};

/// Points of a series that are drawn at most: half an hour at 10 Hz is whole, so that there is something to zoom into.
const POINTS: usize = 20_000;
/// Events that are shown with pictures at most; later ones are listed without.
const PICTURED: usize = 60;
/// Bytes of all pictures of events; later ones are left out.
const EVENT_BYTES: usize = 16 << 20;
/// Pictures along a run at most: of a lap, one every two to three seconds.
const STRIP: usize = 96;
/// Their bytes at most.
const STRIP_BYTES: usize = 16 << 20;
/// Pictures of an event are so far from it, in seconds.
const AROUND_S: [f64; 4] = [-1.0, -0.3, 0.0, 0.7];

/// A place counts for telemetries within so many seconds.
const APART_S: f64 = 0.1;

/// Decimals that are kept of a number: a page shows fewer, and all digits would make up half of its size.
const DECIMALS: i32 = 3;

/// uPlot as its authors ship it: which version, and how to take a newer one, is said in `uplot/README.md`.
pub const UPLOT: &str = include_str!("uplot/uPlot.iife.min.js");
/// Its styles.
pub const UPLOT_STYLE: &str = include_str!("uplot/uPlot.min.css");
/// It asks to go with every copy, and each page is one.
pub const UPLOT_LICENCE: &str = include_str!("uplot/LICENSE");

/// What all pages look like: their colours, light and dark, heads that sort a table, and the room that fingers need.
pub const COLOURS: &str = include_str!("colours.css");

/// What reports and the live page have in common: the functions `el`, `clock`, `before`, `between` and `drawRoad`.
pub const SHARED: &str = include_str!("shared.js");

/// What lets a reader of a page sort a table, by mouse or keys: the function `sortable(table)`.
pub const SORTING: &str = include_str!("sorting.js");

/// Both edges of a road as seen from above: x and z in metres, in the telemetry's axes.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Outline {
    /// The left edge, closed.
    pub left: Vec<[f32; 2]>,
    /// The right edge, closed.
    pub right: Vec<[f32; 2]>,
    /// The point of both edges that is nearest to where drives start. The points follow one another in the direction of
    /// travel.
    pub start: usize,
}

/// What is drawn of a run.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Drawn {
    t: Vec<f32>,
    speed: Vec<f32>,
    steering: Vec<f32>,
    /// Null where it is not reported.
    cte: Vec<Option<f32>>,
    /// x and z.
    at: Vec<Option<[f32; 2]>>,
    /// Where it was is an estimate: how far beside the line to drive is not known.
    on_line: bool,
    /// Of each answer: when, and its milliseconds.
    answers: Vec<[f32; 2]>,
    events: Vec<Happened>,
    /// Pictures along the run, if asked for: seconds, and the JPEG in base64.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    frames: Vec<(f32, String)>,
}

impl Drawn {
    /// Where the car seems to have been, for a run that tells no position: seconds in order, and x and z in metres.
    pub fn locate(&mut self, places: &[(f64, [f32; 2])]) {
        if places.is_empty() || self.at.iter().any(Option::is_some) {
            return;
        }
        self.on_line = true;
        for (t, at) in self.t.iter().zip(&mut self.at) {
            let next = places.partition_point(|(then, _)| *then < f64::from(*t));
            let near = places[next.saturating_sub(1)..].iter().take(2);
            let near = near.min_by(|a, b| (a.0 - f64::from(*t)).abs().total_cmp(&(b.0 - f64::from(*t)).abs()));
            *at = near.filter(|(then, _)| (then - f64::from(*t)).abs() < APART_S).map(|(_, at)| *at);
        }
    }
}

#[derive(Debug, Clone, Serialize)]
struct Happened {
    t: f32,
    kind: String,
    words: String,
    /// Seconds from the event, and the JPEG in base64.
    pictures: Vec<(f32, String)>,
}

impl Happened {
    /// Adds a picture of time `t`, if there is room for it beside those of all events.
    fn picture(&mut self, t: f64, jpeg: &[u8], bytes: &mut usize) {
        if *bytes + jpeg.len() <= EVENT_BYTES {
            *bytes += jpeg.len();
            self.pictures.push(((t - f64::from(self.t)) as f32, STANDARD.encode(jpeg)));
        }
    }
}

/// Watches a run.
#[derive(Debug, Default)]
pub struct Collector {
    drawn: Drawn,
    /// Pictures of the last second and a bit.
    recent: VecDeque<(f64, Bytes)>,
    /// Which events still want pictures, and how far from themselves, in seconds.
    wanted: Vec<(usize, f64)>,
    strip: Option<Strip>,
    /// Bytes of the pictures of events so far.
    event_bytes: usize,
}

impl Collector {
    /// One that also keeps pictures along the whole run, for a page that stands alone.
    pub fn with_pictures() -> Self {
        Self { strip: Some(Strip::within(STRIP, STRIP_BYTES)), ..Self::default() }
    }

    /// Takes an item of a run, in the order of the file.
    pub fn item(&mut self, at: Duration, item: &Item) {
        let t = at.as_secs_f64();
        match item {
            Item::Telemetry(telemetry) => {
                let truth = &telemetry.truth;
                self.drawn.t.push(short(t));
                self.drawn.speed.push(short(telemetry.speed.get()));
                self.drawn.steering.push(short(telemetry.steering.get()));
                self.drawn.cte.push(truth.cte.map(|cte| short(cte.get())));
                self.drawn.at.push(truth.position.map(|[x, _, z]| [short(x.get()), short(z.get())]));
            }
            Item::Frame(jpeg) => self.picture(t, jpeg),
            Item::Command(command) => {
                self.drawn.answers.extend(command.latency_ns.map(|ns| [short(t), short(ns as f64 / 1e6)]));
            }
            Item::Event(event) => self.event(t, event),
        }
    }

    fn picture(&mut self, t: f64, jpeg: &Bytes) {
        let earliest = t + AROUND_S[0] - 0.5;
        while self.recent.front().is_some_and(|(then, _)| *then < earliest) {
            self.recent.pop_front();
        }
        self.recent.push_back((t, jpeg.clone()));
        if let Some(strip) = &mut self.strip {
            strip.take(t, jpeg);
        }
        let Self { drawn, wanted, event_bytes, .. } = self;
        wanted.retain(|&(event, from)| {
            let event = &mut drawn.events[event];
            let due = t >= f64::from(event.t) + from;
            if due {
                event.picture(t, jpeg, event_bytes);
            }
            !due
        });
    }

    fn event(&mut self, t: f64, event: &EventRecord) {
        let Some(words) = event.in_words() else { return };
        let mut happened = Happened { t: t as f32, kind: event.kind(), words, pictures: vec![] };
        let index = self.drawn.events.len();
        if index < PICTURED {
            for from in AROUND_S {
                if from >= 0.0 {
                    self.wanted.push((index, from));
                } else if let Some((then, jpeg)) = self.recent.iter().rev().find(|(then, _)| *then <= t + from + 1e-6) {
                    happened.picture(*then, jpeg, &mut self.event_bytes);
                }
            }
        }
        self.drawn.events.push(happened);
    }

    /// What is drawn.
    pub fn finish(mut self) -> Drawn {
        let every = self.drawn.t.len().div_ceil(POINTS).max(1);
        fn thin<T: Clone>(series: &mut Vec<T>, every: usize) {
            *series = series.iter().step_by(every).cloned().collect();
        }
        thin(&mut self.drawn.t, every);
        thin(&mut self.drawn.speed, every);
        thin(&mut self.drawn.steering, every);
        thin(&mut self.drawn.cte, every);
        thin(&mut self.drawn.at, every);
        let every = self.drawn.answers.len().div_ceil(POINTS).max(1);
        // Of each few answers the slowest: that is what one looks for.
        let slowest = |few: &[[f32; 2]]| few.iter().copied().max_by(|a, b| a[1].total_cmp(&b[1]));
        self.drawn.answers = self.drawn.answers.chunks(every).filter_map(slowest).collect();
        let pictures = self.strip.map(Strip::finish).unwrap_or_default();
        self.drawn.frames = pictures.iter().map(|(t, jpeg)| (short(*t), STANDARD.encode(jpeg))).collect();
        self.drawn
    }
}

/// A number of a series with the decimals that are kept.
fn short(value: f64) -> f32 {
    let power = 10f64.powi(DECIMALS);
    ((value * power).round() / power) as f32
}

/// A run on the page.
#[derive(Debug, Serialize)]
pub struct Shown<'a> {
    /// Its heading.
    pub title: String,
    /// Its judgement.
    pub card: &'a Scorecard,
    /// What is drawn of it.
    pub drawn: &'a Drawn,
    /// The road, where it is known.
    pub outline: Option<&'a Outline>,
    /// Thresholds that it missed, in words.
    pub missed: Vec<&'a str>,
}

#[derive(Serialize)]
struct ScorePage<'a> {
    runs: Vec<Estimated<'a>>,
    figures: Vec<Described>,
}

/// A run with the words for how its estimates came about, by figure, as the table has them.
#[derive(Serialize)]
struct Estimated<'a> {
    #[serde(flatten)]
    shown: &'a Shown<'a>,
    how: BTreeMap<&'static str, String>,
}

impl<'a> Estimated<'a> {
    fn of(shown: &'a Shown<'a>) -> Self {
        let how = Figure::ALL.map(|figure| (figure.key(), shown.card.how(figure)));
        let how = how.into_iter().chain([("lap_times_s", shown.card.how_lap_times())]);
        Self { shown, how: how.filter(|(_, how)| !how.is_empty()).collect() }
    }
}

/// The page, as HTML.
///
/// # Errors
/// Where a scorecard holds a number that JSON does not have.
pub fn render(runs: &[Shown<'_>]) -> Result<String, serde_json::Error> {
    let page = ScorePage { runs: runs.iter().map(Estimated::of).collect(), figures: Figure::described() };
    // Inside a script element nothing may look like its end.
    let data = serde_json::to_string(&page)?.replace('<', "\\u003c");
    let uplot = format!("/*\n{UPLOT_LICENCE}*/\n{UPLOT}");
    let style = format!("{UPLOT_STYLE}\n{COLOURS}{}", include_str!("page.css"));
    // The data last: a run may hold any text, such as the name of a place in the page.
    let parts = [
        ("/*STYLE*/", &*style),
        ("/*UPLOT*/", &*uplot),
        ("/*SHARED*/", SHARED),
        ("/*SORTING*/", SORTING),
        ("/*CHARTS*/", include_str!("charts.js")),
        ("/*MAP*/", include_str!("map.js")),
        ("/*TABLES*/", include_str!("tables.js")),
        ("/*PAGE*/", include_str!("page.js")),
        ("/*DATA*/", &*data),
    ];
    Ok(parts.iter().fold(include_str!("page.html").to_owned(), |page, (place, part)| page.replace(place, part)))
}

#[cfg(test)]
mod tests;
