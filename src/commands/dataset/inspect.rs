//! `lapwing dataset inspect`: what is in data sets, and what is wrong with them.

use super::{Ended, RowBar};
use crate::{
    cli,
    commands::{outputs, print},
};
use lapwing_core::words::count;
use lapwing_learn::dataset::{self, CameraCount, Gap, Inspection, Problem, Size};

/// Gaps and problems that are listed one by one; `--json` has all.
const NAMED: usize = 10;

pub(super) fn run(arguments: cli::DatasetInspect) -> anyhow::Result<Ended> {
    let pictures = || [&arguments.sheet, &arguments.plot].into_iter().flatten();
    outputs::check_apart(pictures())?;
    for picture in pictures() {
        outputs::check_drawing(picture)?;
    }
    // Check all of them before the first is inspected.
    for source in &arguments.sources {
        dataset::check(source)?;
    }
    let mut inspections = Vec::new();
    for source in &arguments.sources {
        let bar = RowBar::new();
        inspections.push(dataset::inspect(source, &mut |done, total| bar.show(done, total))?);
    }
    // A failed drawing does not affect the other results.
    let sheet = arguments.sheet.as_ref().map_or(Ok(()), |path| {
        dataset::contact_sheet(&inspections)?.write(path)?;
        anyhow::Ok(())
    });
    let plot = arguments.plot.as_ref().map_or(Ok(()), |path| dataset::steering_chart(&inspections).write(path));
    if arguments.json {
        print(&serde_json::to_string_pretty(&inspections)?)?;
    } else {
        print(&table(&inspections))?;
    }
    sheet?;
    plot?;
    for picture in pictures() {
        say!("written: {}", picture.display());
    }
    let sound = inspections.iter().all(|i| i.problems.is_empty() && i.truncated.is_none());
    Ok(if sound { Ended::Passed } else { Ended::Failed })
}

/// A column for each data set, then details of each.
fn table(inspections: &[Inspection]) -> String {
    let columns: Vec<Vec<(&str, String)>> = inspections.iter().map(column).collect();
    let width = |column: &Vec<(&str, String)>| column.iter().map(|(_, text)| text.chars().count()).max();
    let widths: Vec<usize> = columns.iter().map(|column| width(column).unwrap_or(0)).collect();
    let mut text = String::new();
    for (line, (name, _)) in columns.first().into_iter().flatten().enumerate() {
        let mut row = format!("{name:19}");
        for (column, width) in columns.iter().zip(&widths) {
            row += &format!("  {:width$}", column[line].1);
        }
        text += row.trim_end();
        text.push('\n');
    }
    for inspection in inspections {
        text += &particulars(inspection);
    }
    text.trim_end().to_owned()
}

fn column(inspection: &Inspection) -> Vec<(&'static str, String)> {
    let Inspection { steering, speed_mph, .. } = inspection;
    let cameras = |what: fn(&CameraCount) -> u64| {
        let counts = inspection.cameras.iter().map(|count| format!("{} {}", count.camera, what(count)));
        list(counts, "none")
    };
    let size = |Size { width, height, pictures }: &Size| format!("{width}x{height} ({pictures})");
    let intervals = inspection.intervals_ms.map_or_else(
        || "not known".into(),
        |ms| format!("median {:.0}, 95 % below {:.0}, max {:.0} ms", ms.median, ms.p95, ms.max),
    );
    vec![
        ("data set", inspection.path.display().to_string()),
        ("kind", inspection.kind.into()),
        ("rows", inspection.rows.to_string()),
        ("duration", format!("{:.1} s", inspection.duration_s)),
        ("cameras", cameras(|count| count.rows)),
        ("missing", cameras(|count| count.missing)),
        ("broken", cameras(|count| count.broken)),
        ("picture sizes", list(inspection.sizes.iter().map(size), "none")),
        ("pictures", format!("{:.1} MB", inspection.picture_bytes as f64 / 1e6)),
        ("steering", format!("{:+.3} to {:+.3}", steering.min, steering.max)),
        ("  mean, deviation", format!("{:+.4}, {:.4}", steering.mean, steering.std)),
        ("  exactly 0", format!("{:.1} %", 100.0 * inspection.zero_steering)),
        ("speed", format!("{:.1} to {:.1} mph", speed_mph.min, speed_mph.max)),
        ("  mean, deviation", format!("{:.1}, {:.1} mph", speed_mph.mean, speed_mph.std)),
        ("  standing", format!("{:.1} %", 100.0 * inspection.standing)),
        ("intervals", intervals),
        ("  rows without time", inspection.untimed.to_string()),
        ("gaps", inspection.gaps.len().to_string()),
    ]
}

fn list(texts: impl Iterator<Item = String>, none: &str) -> String {
    let texts: Vec<String> = texts.collect();
    if texts.is_empty() { none.into() } else { texts.join(", ") }
}

/// Gaps, problems, and how a run was answered and ended.
fn particulars(inspection: &Inspection) -> String {
    let mut lines = Vec::new();
    if !inspection.answered.is_empty() {
        let by = inspection.answered.iter().map(|(by, count)| format!("{by} {count}"));
        lines.push(format!("answered by: {}", list(by, "nobody")));
    }
    let place = |row: usize, line: Option<usize>| {
        line.map_or_else(|| format!("row {row}"), |line| format!("row {row} (line {line})"))
    };
    let gap = |gap: &Gap| format!("gap of {:.3} s before {}", gap.seconds, place(gap.row, gap.line));
    lines.extend(some(&inspection.gaps, "gaps", gap));
    let problem = |Problem { row, line, camera, file, missing, why }: &Problem| {
        let file = file.as_ref().map_or_else(String::new, |file| format!(" {}:", file.display()));
        let state = if *missing { "missing" } else { "broken" };
        let what = camera.map_or_else(|| "unreadable".into(), |camera| format!("{camera} {state}"));
        format!("{}: {what}:{file} {why}", place(*row, *line))
    };
    // Those of the centre camera first, without whose picture a row is no use.
    let mut problems: Vec<&Problem> = inspection.problems.iter().collect();
    problems.sort_by_key(|problem| problem.camera.is_some_and(|camera| camera != "center"));
    lines.extend(some(&problems, "problems", |it| problem(it)));
    if inspection.sizes.len() > 1 {
        lines.push("pictures have several sizes: no network can learn from them together".into());
    }
    if inspection.repeated > 0 {
        let rows = count(inspection.repeated, "row");
        lines.push(format!("{rows} repeat the picture of an earlier row: leave them out of the log"));
    }
    lines.extend(inspection.truncated.iter().map(|why| format!("the run is {why}")));
    if lines.is_empty() {
        return String::new();
    }
    format!("\n{}\n  {}\n", inspection.path.display(), lines.join("\n  "))
}

/// The first few, and how many more there are.
fn some<T>(all: &[T], what: &str, told: impl Fn(&T) -> String) -> Vec<String> {
    let more = all.len().saturating_sub(NAMED);
    let more = (more > 0).then(|| format!("and {more} more {what}; --json names them all"));
    all.iter().take(NAMED).map(told).chain(more).collect()
}
