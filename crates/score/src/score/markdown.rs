//! Runs as Markdown, for a CI job's summary or a pull request's comment, and the worst moment of each.

use std::time::Duration;

use bytes::Bytes;

use super::{Scorecard, against::Comparison, report::Report};
use lapwing_core::{
    recording::Item,
    turn::EventRecord,
    units::{Degrees, Metres},
};

/// A drive begins where the car was put down, not where the pilot took it: what is merely large in so many seconds comes last.
const START_S: f64 = 3.0;

/// How bad a moment is: the later kind is the worse, and within one the larger number.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
enum Badness {
    /// Far from straight, in degrees: of runs that report nothing else.
    Steering(f64),
    /// Far from the line to drive, in metres.
    Offset(f64),
    /// Off the road, in metres from its middle.
    OffRoad(f64),
    /// A collision, at miles per hour.
    Collision(f64),
}

/// The worst moment of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct WorstMoment {
    /// What makes it the worst, and when it was.
    pub words: String,
    /// The last picture before it.
    pub jpeg: Bytes,
    /// Where it was: x, y and z of the telemetry.
    pub position: Option<[Metres; 3]>,
}

/// Watches a run for its worst moment, and for the way that it drove.
#[derive(Debug, Default)]
pub struct WorstWatch {
    /// With whether it counts beyond the start.
    worst: Option<((bool, Badness), WorstMoment)>,
    picture: Bytes,
    position: Option<[Metres; 3]>,
    /// Of each telemetry: seconds, where it was if it says so, and miles per hour.
    pub line: Vec<(f64, Option<[Metres; 3]>, f64)>,
    /// Where the car hit something (true) or left the road.
    pub marks: Vec<(bool, [Metres; 3])>,
}

impl WorstWatch {
    /// Takes an item of a run, in the order of the file.
    pub fn item(&mut self, at: Duration, item: &Item) {
        let seconds = at.as_secs_f64();
        match item {
            Item::Frame(jpeg) => self.picture = jpeg.clone(),
            Item::Telemetry(telemetry) => {
                self.position = telemetry.truth.position;
                self.line.push((seconds, self.position, telemetry.speed.get()));
                let how = match telemetry.truth.cte.map(Metres::get) {
                    Some(cte) => (Badness::Offset(cte.abs()), format!("{:.2} m beside the line", cte.abs())),
                    None => {
                        let steering = Degrees::get(telemetry.steering).abs();
                        (Badness::Steering(steering), format!("{steering:.0} degrees of steering, the most"))
                    }
                };
                let began = self.line.first().map_or(seconds, |(began, ..)| *began);
                self.see(seconds, seconds - began >= START_S, how);
            }
            Item::Event(event) => {
                let bad = match event {
                    EventRecord::Collision { speed_mph, .. } => Badness::Collision(*speed_mph),
                    EventRecord::OffRoad { offset_m } => Badness::OffRoad(offset_m.abs()),
                    _ => return,
                };
                self.marks.extend(self.position.map(|place| (matches!(bad, Badness::Collision(_)), place)));
                self.see(seconds, true, (bad, event.in_words().unwrap_or_default()));
            }
            Item::Command(_) => {}
        }
    }

    fn see(&mut self, seconds: f64, counts: bool, (badness, what): (Badness, String)) {
        let badness = (counts, badness);
        let worse = self.worst.as_ref().is_none_or(|(worst, _)| badness > *worst);
        if worse && !self.picture.is_empty() {
            let words = format!("{what}, after {seconds:.1} s");
            self.worst = Some((badness, WorstMoment { words, jpeg: self.picture.clone(), position: self.position }));
        }
    }

    /// The worst moment that had a picture before it.
    pub fn worst(&self) -> Option<&WorstMoment> {
        self.worst.as_ref().map(|(_, moment)| moment)
    }
}

/// A run as it is shown, beside its place in the report.
#[derive(Debug)]
pub struct ShownRun<'a> {
    /// The run, its model and its track.
    pub title: String,
    /// Its judgement.
    pub card: &'a Scorecard,
    /// Whether it was held to thresholds.
    pub has_thresholds: bool,
    /// Those that it missed.
    pub missed: Vec<&'a str>,
    /// Address of its map, if there is one.
    pub map: Option<String>,
    /// Address of the picture of its worst moment, and what it shows.
    pub worst: Option<(String, String)>,
}

/// All runs as one text.
pub fn render(report: &Report<'_>, runs: &[ShownRun<'_>], against: Option<&Comparison>) -> String {
    let mut text = String::from("## Lapwing\n\n");
    let worse: Vec<String> =
        against.iter().flat_map(|against| against.worse()).map(|change| change.to_string()).collect();
    let missed: usize = runs.iter().map(|run| run.missed.len()).sum();
    let was_asked = against.is_some() || runs.iter().any(|run| run.has_thresholds);
    text += match (missed + worse.len(), report.unscored.len()) {
        (0, 0) if was_asked => "**Passed.**\n",
        (0, 0) => "**Scored.**\n",
        (_, 0) => "**Below what was asked for:**\n",
        _ => "**Not all runs can be scored:**\n",
    };
    for run in runs {
        run.missed.iter().for_each(|missed| text += &format!("- {}: {}\n", escaped(&run.title), escaped(missed)));
    }
    worse.iter().for_each(|worse| text += &format!("- worse: {}\n", escaped(worse)));
    report.unscored.iter().for_each(|(name, why)| text += &format!("- {}: {}\n", escaped(name), escaped(why)));
    text += "\n";
    let (rows, words) = report.rows();
    for (i, row) in rows.iter().enumerate() {
        text += &format!("| {} |\n", row.iter().map(|cell| escaped(cell)).collect::<Vec<_>>().join(" | "));
        if i == 0 {
            text += &format!("|{}{}\n", "---|".repeat(words), "---:|".repeat(row.len() - words));
        }
    }
    text += "\n~ is an estimate, - not measurable, (2 runs) the mean of two runs.\n";
    for run in runs {
        text += &format!("\n<details><summary>{}</summary>\n\n", escaped(&run.title));
        if let Some(map) = &run.map {
            text += &format!("![The driven line from above]({map})\n\n");
        }
        if let Some((picture, words)) = &run.worst {
            text += &format!("![The worst moment: {0}]({picture})\n\nThe worst moment: {0}\n\n", escaped(words));
        }
        text += "| | |\n|---|---|\n";
        for (name, words) in run.card.known_rows() {
            text += &format!("| {} | {} |\n", escaped(name), escaped(&words));
        }
        text += "\n</details>\n";
    }
    text
}

/// Text that Markdown shows as it is: paths and events are not ours.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '\n' | '\r' => escaped.push(' '),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '\\' | '|' | '`' | '*' | '_' | '[' | ']' | '!' | '@' => escaped.extend(['\\', letter]),
            letter => escaped.push(letter),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;
    use lapwing_core::{
        protocol::{CameraImage, Telemetry, Truth},
        units::{Mph, Throttle},
    };

    fn telemetry(cte: Option<f64>, steering: f64) -> Item {
        let truth = Truth { cte: cte.map(|cte| Metres::new(cte).unwrap()), ..Truth::default() };
        Item::Telemetry(Telemetry {
            steering: Degrees::new(steering).unwrap(),
            throttle: Throttle::ZERO,
            speed: Mph::ZERO,
            image: CameraImage::default(),
            truth,
        })
    }

    fn worst(items: Vec<Item>) -> (String, Vec<u8>) {
        let mut watch = WorstWatch::default();
        for (i, item) in items.into_iter().enumerate() {
            watch.item(Duration::from_secs(i as u64), &item);
        }
        let worst = watch.worst().unwrap();
        (worst.words.clone(), worst.jpeg.to_vec())
    }

    #[test]
    fn a_collision_is_worse_than_any_offset_and_an_offset_than_any_steering() {
        let frame = |byte: u8| Item::Frame(vec![byte].into());
        let mut items = vec![frame(1), telemetry(None, 20.0), frame(2), telemetry(None, -9.0)];
        assert_eq!(worst(items.clone()), ("20 degrees of steering, the most, after 1.0 s".into(), vec![1]));
        items.extend([frame(3), telemetry(Some(-0.5), 0.0), frame(4), telemetry(Some(0.2), 0.0)]);
        assert_eq!(worst(items.clone()), ("0.50 m beside the line, after 5.0 s".into(), vec![3]));
        items.push(Item::Event(EventRecord::OffRoad { offset_m: 4.0 }));
        items.push(Item::Event(EventRecord::Collision { with: "a tree".into(), speed_mph: 3.0, own_mph: None }));
        items.push(Item::Event(EventRecord::OffRoad { offset_m: 9.0 }));
        let (words, picture) = worst(items);
        assert!(words.contains("a tree") && words.ends_with("after 9.0 s"), "{words}");
        assert_eq!(picture, [4]);
    }

    #[test]
    fn where_the_car_was_put_down_is_the_worst_only_of_a_run_that_ends_there() {
        let frame = |byte: u8| Item::Frame(vec![byte].into());
        let mut items = vec![frame(1)];
        items.extend([0.74, 0.6, 0.5].map(|cte| telemetry(Some(cte), 0.0)));
        assert_eq!(worst(items.clone()), ("0.74 m beside the line, after 1.0 s".into(), vec![1]));
        items.extend([frame(2), telemetry(Some(0.3), 0.0)]);
        assert_eq!(worst(items.clone()), ("0.30 m beside the line, after 5.0 s".into(), vec![2]));
        items.insert(2, Item::Event(EventRecord::OffRoad { offset_m: 4.0 }));
        assert!(worst(items).0.ends_with("after 2.0 s"), "what happened at the start counts");
    }

    #[test]
    fn text_of_others_cannot_change_what_markdown_shows() {
        assert_eq!(escaped("a|b <img>\n@all [x](y)"), r"a\|b &lt;img&gt; \@all \[x\](y)");
    }
}
