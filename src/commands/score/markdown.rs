//! `lapwing score --markdown`: the summary, with the map and the worst moment of each run as files beside it.

use std::{fs, path::Path};

use anyhow::Context;
use glam::DVec3;

use super::super::outputs;
use crate::{
    known::{Roads, whereabouts},
    map::{self, DrivenPoint, Mark, MarkKind},
};
use lapwing_core::units::Metres;
use lapwing_score::score::{
    against::Comparison,
    markdown::{self, ShownRun, WorstWatch},
    report::{JudgedRun, Report},
};

/// Width of a map: half a screen.
const MAP_PX: u32 = 800;
/// A place counts for telemetries within so many seconds.
const APART_S: f64 = 0.1;

/// Where pictures go: beside this file, and how they are called in it.
pub(super) struct Pictures<'a> {
    /// The Markdown file.
    pub(super) file: &'a Path,
    /// What stands before a picture's name; a CI service shows only what it can fetch.
    pub(super) base: Option<&'a str>,
}

/// The text; with `pictures` their files are written.
pub(super) fn summary(
    report: &Report<'_>,
    runs: &[(&JudgedRun, &WorstWatch)],
    against: Option<&Comparison>,
    roads: &Roads,
    pictures: Option<&Pictures<'_>>,
) -> anyhow::Result<String> {
    let mut shown = vec![];
    for (nth, (run, watch)) in runs.iter().enumerate() {
        let (mut map, mut worst) = (None, None);
        if let Some(pictures) = pictures {
            map = draw(run, watch, roads, &pictures.path(nth, "map.png"))?.then(|| pictures.address(nth, "map.png"));
            if let Some(moment) = watch.worst() {
                let path = pictures.path(nth, "worst.jpg");
                fs::write(&path, &moment.jpeg).with_context(|| format!("{}: cannot be written", path.display()))?;
                worst = Some((pictures.address(nth, "worst.jpg"), moment.words.clone()));
            }
        }
        let has_thresholds = !run.checks.is_empty();
        let missed = run.missed().collect();
        shown.push(ShownRun { title: run.title(), card: &run.card, has_thresholds, missed, map, worst });
    }
    let text = markdown::render(report, &shown, against);
    if let Some(pictures) = pictures {
        outputs::write(pictures.file, &text)?;
    }
    Ok(text)
}

impl Pictures<'_> {
    fn name(&self, nth: usize, what: &str) -> String {
        let stem = self.file.file_stem().map_or_else(|| "score".into(), |stem| stem.to_string_lossy());
        format!("{stem}-{}-{what}", nth + 1)
    }

    fn path(&self, nth: usize, what: &str) -> std::path::PathBuf {
        self.file.with_file_name(self.name(nth, what))
    }

    fn address(&self, nth: usize, what: &str) -> String {
        let name = self.name(nth, what).replace(' ', "%20");
        self.base.map_or_else(|| name.clone(), |base| format!("{}/{name}", base.trim_end_matches('/')))
    }
}

/// Draws the driven line; false where the road or the line is not known.
fn draw(run: &JudgedRun, watch: &WorstWatch, roads: &Roads, path: &Path) -> anyhow::Result<bool> {
    let Some(track) = run.card.track.as_deref().and_then(|name| roads.track(name)) else { return Ok(false) };
    let place = |[x, y, z]: [Metres; 3]| DVec3::new(x.get(), y.get(), z.get());
    let told =
        watch.line.iter().filter_map(|(_, at, mph)| Some(DrivenPoint { position: place((*at)?), speed_mph: *mph }));
    let mut line: Vec<_> = told.collect();
    if line.is_empty() {
        let estimated = whereabouts(&run.card, &track);
        let speed = |at: f64| {
            let next = watch.line.partition_point(|(then, ..)| *then < at);
            watch.line.get(next).filter(|(then, ..)| then - at < APART_S).map(|(_, _, mph)| *mph)
        };
        line.extend(estimated.into_iter().filter_map(|(at, [x, z])| {
            Some(DrivenPoint { position: DVec3::new(f64::from(x), 0.0, f64::from(z)), speed_mph: speed(at)? })
        }));
    }
    if line.is_empty() {
        return Ok(false);
    }
    let mark = |(hit, at): &(bool, [Metres; 3])| Mark {
        position: place(*at),
        kind: if *hit { MarkKind::Crash } else { MarkKind::OffRoad },
    };
    map::draw(&track, &line, &watch.marks.iter().map(mark).collect::<Vec<_>>(), path, MAP_PX)?;
    Ok(true)
}
