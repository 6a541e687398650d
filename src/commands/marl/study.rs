//! `lapwing marl study`: many trainings, and what they say.

use std::{
    io::{self, IsTerminal},
    process::{Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::sleep,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use anyhow::bail;
use indicatif::{ProgressBar, ProgressStyle};
use rayon::{
    ThreadPoolBuilder,
    iter::{ParallelBridge, ParallelIterator},
};
use serde::Serialize;

use super::{Ended, print, this_call::ThisCall};
use crate::{
    cli::{MarlStudy, TaskKind},
    commands::{Interrupted, interrupted, outputs},
};
use lapwing_core::config::ConfigError;
use lapwing_learn::{
    marl::{
        MarlError,
        study::{
            Cell, CellResult, StudySettings, TASKS, Variant,
            findings::{Estimate, Finding, Findings, Row, Verdict},
            plan,
        },
    },
    nn::runtime,
};
use lapwing_score::{
    drawing::chart::{Axis, Chart, Marks, Series, stack},
    score::page::{COLOURS, SORTING},
};
use lapwing_sim::intersection::{CARS, Reward};

/// How often it is looked whether a training beside others is over.
const POLL: Duration = Duration::from_millis(50);
/// Size of a chart, in pixels.
const CHART: (u32, u32) = (960, 420);

/// What SMARTS publishes of its own trainings at this intersection (collision / completion, 10 episodes): without traffic,
/// and with random traffic.
const PUBLISHED: [(&str, [[f64; 2]; 2]); 2] =
    [("SMARTS MADDPG", [[0.0, 1.0], [0.3, 0.7]]), ("SMARTS PPO", [[0.1, 0.07], [0.5, 0.45]])];

/// What `study.json` holds.
#[derive(Debug, Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    findings: &'a Findings,
    this_call: ThisCall,
}

pub(super) fn run(arguments: &MarlStudy) -> anyhow::Result<Ended> {
    outputs::check_folder(&arguments.out)?;
    let study = StudySettings {
        seeds: arguments.seeds,
        agent_steps: arguments.agent_steps,
        episodes: arguments.episodes,
        every: arguments.every,
    };
    runtime::set_threads(1);
    let (cells, stop) = (plan(&study, &tasks(arguments)), interrupted());
    let bar = if io::stderr().is_terminal() { ProgressBar::new(1000) } else { ProgressBar::hidden() };
    bar.set_style(ProgressStyle::with_template("{wide_bar} {msg}, {elapsed}")?);
    let wall = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs_f64();
    let mut done: Vec<CellResult> = Vec::new();
    if let Some(name) = &arguments.only {
        let names = || cells.iter().map(Cell::name).collect::<Vec<_>>().join(", ");
        let Some(cell) = cells.iter().find(|cell| cell.name() == *name) else {
            let why = format!("expected one of {}, got {name}", names());
            return Err(ConfigError::Value { layer: "--only".into(), why }.into());
        };
        let let_go = arguments.held.then(let_go);
        let is_stopped = || stop.is_pressed() || let_go.as_ref().is_some_and(|it| it.load(Ordering::Relaxed));
        let result = cell.run(&study, &arguments.out, wall, is_stopped, |_| ())?;
        return Ok(if result.is_some() { Ended::Passed } else { Ended::Failed });
    }
    let (began, mut finished_now) = (Instant::now(), Vec::<u64>::new());
    // Before anything is trained, those that are done are compared with what is asked for.
    let done_before = cells.iter().map(|cell| Ok(cell.done(&study, &arguments.out)?.is_some()));
    let done_before: Vec<bool> = done_before.collect::<Result<_, MarlError>>()?;
    if arguments.jobs > 1 {
        train_side_by_side(arguments, &cells, &stop)?;
    }
    for (i, cell) in cells.iter().enumerate() {
        // Those that are done count, wherever they stand in the plan.
        let enough = arguments.most.is_some_and(|most| finished_now.len() >= most as usize);
        if (enough || stop.is_pressed()) && !cell.is_done(&arguments.out) {
            continue;
        }
        let message = format!("{} of {}: {}", i + 1, cells.len(), cell.name());
        bar.set_message(message.clone());
        let show = |share: f64| bar.set_position((share * 1000.0) as u64);
        let result = cell.run(&study, &arguments.out, wall, || stop.is_pressed(), show)?;
        if bar.is_hidden() {
            say!("{message}");
        }
        finished_now.extend(result.iter().filter(|_| !done_before[i]).map(|result| result.agent_steps));
        done.extend(result);
    }
    bar.finish_and_clear();
    let this_call = ThisCall::of(&finished_now, arguments.jobs, began.elapsed(), stop.is_pressed());
    let findings = Findings::of(&done);
    let json = serde_json::to_string_pretty(&Report { findings: &findings, this_call })?;
    let told = told(&findings, &this_call);
    outputs::write(&arguments.out.join("study.json"), &json)?;
    outputs::write(&arguments.out.join("study.csv"), &csv(&findings.rows))?;
    let curves = stack(&charts(&done), CHART.0, CHART.1);
    curves.write(arguments.out.join("curves.svg"))?;
    outputs::write(&arguments.out.join("study.html"), &page(&findings, &this_call, &curves.svg()?))?;
    print(&if arguments.json { json } else { told })?;
    let finished = done.len() == cells.len();
    if !finished {
        say!("{} of {} trainings are done; the same command goes on", done.len(), cells.len());
    }
    let enough = arguments.most.is_some() && !stop.is_pressed();
    Ok(if finished || enough { Ended::Passed } else { Ended::Failed })
}

/// Set once whoever started this process lets go of its standard input, or is gone.
fn let_go() -> Arc<AtomicBool> {
    let ended = Arc::new(AtomicBool::new(false));
    std::thread::spawn({
        let ended = ended.clone();
        move || {
            // Nothing is sent: all that matters is when it ends.
            let _ = io::copy(&mut io::stdin(), &mut io::sink());
            ended.store(true, Ordering::Relaxed);
        }
    });
    ended
}

/// Trains what is not done, each in a process of its own: libtorch's random numbers are a process's, and a training must be
/// the same whatever is trained beside it. Each is held by its standard input, and so ends with this process.
fn train_side_by_side(arguments: &MarlStudy, cells: &[Cell], stop: &Interrupted) -> anyhow::Result<()> {
    let program = std::env::current_exe()?;
    let most = arguments.most.map_or(cells.len(), |most| most as usize);
    let waiting: Vec<&Cell> = cells.iter().filter(|cell| !cell.is_done(&arguments.out)).take(most).collect();
    let failed = AtomicBool::new(false);
    let ends = || stop.is_pressed() || failed.load(Ordering::Relaxed);
    let train = |(i, cell): (usize, &&Cell)| {
        if ends() {
            return Ok(());
        }
        let MarlStudy { out, seeds, agent_steps, episodes, every, .. } = arguments;
        let mut process = Command::new(&program)
            .args(["marl", "study", "--held", "--only", &cell.name(), "--out"])
            .arg(out)
            .args(["--seeds", &seeds.to_string(), "--agent-steps", &agent_steps.to_string()])
            .args(["--episodes", &episodes.to_string(), "--every", &every.to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()?;
        let mut hold = process.stdin.take();
        let status = loop {
            if let Some(status) = process.try_wait()? {
                break status;
            }
            if ends() {
                hold = None;
            }
            sleep(POLL);
        };
        drop(hold);
        if !status.success() && !ends() {
            failed.store(true, Ordering::Relaxed);
            bail!("{}: its process ended with {status}", cell.name());
        }
        if status.success() {
            say!("{} of {}: {}", i + 1, waiting.len(), cell.name());
        }
        Ok(())
    };
    let pool = ThreadPoolBuilder::new().num_threads(usize::from(arguments.jobs)).build()?;
    // In the plan's order, so that a study that is stopped is balanced.
    pool.install(|| waiting.iter().enumerate().par_bridge().try_for_each(train))
}

fn tasks(arguments: &MarlStudy) -> Vec<(Reward, usize)> {
    if arguments.tasks.is_empty() {
        return TASKS.to_vec();
    }
    let task = |kind: &TaskKind| match kind {
        TaskKind::Smarts => (Reward::Smarts, 0),
        TaskKind::Corrected => (Reward::Corrected, 0),
        TaskKind::SmartsTraffic => (Reward::Smarts, CARS),
        TaskKind::CorrectedTraffic => (Reward::Corrected, CARS),
    };
    arguments.tasks.iter().map(task).collect()
}

fn reward(reward: Reward) -> &'static str {
    match reward {
        Reward::Smarts => "smarts",
        Reward::Corrected => "corrected",
    }
}

/// Heads of the table's columns.
const HEADS: [&str; 16] = [
    "variant",
    "reward",
    "cars",
    "runs",
    "M steps",
    "updates",
    "s",
    "80 %",
    "no traffic 10",
    "no traffic",
    "traffic 10",
    "traffic",
    "random missions",
    "m/s",
    "offset m2",
    "bits",
];

/// A row's cells; rates are collision / completion.
fn cells(row: &Row) -> [String; 16] {
    let pair = |[collision, completion]: [f64; 2]| format!("{collision:.2} / {completion:.2}");
    let Estimate { value, interval: [low, high], .. } = row.completion;
    [
        row.variant.name().into(),
        reward(row.reward).into(),
        row.cars.to_string(),
        row.runs.to_string(),
        format!("{:.2}", row.agent_steps / 1e6),
        format!("{:.0}", row.gradient_steps),
        format!("{:.0}", row.seconds),
        format!("{} of {}", row.reached_80, row.runs),
        pair(row.rates[0]),
        pair(row.rates[1]),
        pair(row.rates[2]),
        pair(row.rates[3]),
        format!("{value:.2} ({low:.2} to {high:.2})"),
        format!("{:.2}", row.speed),
        format!("{:.3}", row.offset_variance),
        format!("{:.2}", row.control_diversity),
    ]
}

fn published() -> impl Iterator<Item = [String; 16]> {
    PUBLISHED.iter().map(|(name, rates)| {
        let mut cells: [String; 16] = std::array::from_fn(|_| String::new());
        let pair = |[collision, completion]: [f64; 2]| format!("{collision:.2} / {completion:.2}");
        (cells[0], cells[8], cells[10]) = ((*name).into(), pair(rates[0]), pair(rates[1]));
        cells
    })
}

fn table(findings: &Findings) -> Vec<[String; 16]> {
    findings.rows.iter().map(cells).chain(published()).collect()
}

fn verdict(finding: &Finding) -> String {
    let verdict = match finding.verdict {
        Verdict::Holds => "holds",
        Verdict::Fails => "does not hold",
        Verdict::Open => "open",
    };
    match finding.found {
        None => format!("{verdict}: no runs"),
        Some(Estimate { value, interval: [low, high], .. }) => {
            format!("{verdict}: {} {value:.2} ({low:.2} to {high:.2})", finding.measure)
        }
    }
}

fn told(findings: &Findings, this_call: &ThisCall) -> String {
    let lines = table(findings);
    let width = |column: usize| {
        lines.iter().map(|line| line[column].len()).chain([HEADS[column].len()]).max().unwrap_or_default()
    };
    let widths: [usize; 16] = std::array::from_fn(width);
    let line = |cells: &mut dyn Iterator<Item = &str>| {
        let padded = cells.zip(widths).map(|(cell, width)| format!("{cell:<width$}"));
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    let mut told = line(&mut HEADS.into_iter());
    for cells in &lines {
        told += "\n";
        told += &line(&mut cells.iter().map(String::as_str));
    }
    told += "\nRates are collision / completion on the benchmark's missions, interquartile means over the runs; with random missions completion\nalone, with which the claims are judged.\n";
    told += &this_call.told("This call");
    told.push('\n');
    for finding in &findings.findings {
        told += &format!("\n{}. {}: {}", finding.claim, finding.says, verdict(finding));
    }
    told
}

fn csv(rows: &[Row]) -> String {
    let mut text = String::from(
        "variant,reward,cars,runs,agent_steps,gradient_steps,seconds,reached_80,collision_none_few,completion_none_few,\
         collision_none,completion_none,collision_traffic_few,completion_traffic_few,collision_traffic,completion_traffic,\
         completion,completion_low,completion_high,speed,offset_variance,control_diversity,time_up,duration,reward_earned\n",
    );
    for row in rows {
        let [few, many, traffic_few, traffic] = row.rates;
        let Estimate { value, interval: [low, high], .. } = row.completion;
        let numbers = [
            row.agent_steps,
            row.gradient_steps,
            row.seconds,
            row.reached_80 as f64,
            few[0],
            few[1],
            many[0],
            many[1],
            traffic_few[0],
            traffic_few[1],
            traffic[0],
            traffic[1],
            value,
            low,
            high,
            row.speed,
            row.offset_variance,
            row.control_diversity,
            row.time_up,
            row.duration,
            row.earned,
        ];
        let numbers: Vec<String> = numbers.iter().map(f64::to_string).collect();
        let (name, reward) = (row.variant.name(), reward(row.reward));
        text += &format!("{name},{reward},{},{},{}\n", row.cars, row.runs, numbers.join(","));
    }
    text
}

/// A chart for each task that was trained: completion rate by agent-steps, a line for each variant, its seeds' mean.
fn charts(cells: &[CellResult]) -> Vec<Chart> {
    let mut charts = Vec::new();
    for cars in [0, CARS] {
        for rewarded in [Reward::Smarts, Reward::Corrected] {
            let title = format!("reward {}, {cars} background cars", reward(rewarded));
            let y = Axis::new("agents that reach their goals").from_to(0.0, 1.0);
            let mut chart = Chart::new(title, Axis::new("agent-steps, millions"), y);
            for variant in Variant::ALL {
                let is_there = |cell: &&CellResult| {
                    (cell.cell.variant, cell.cell.reward, cell.cell.cars) == (variant, rewarded, cars)
                };
                let curves: Vec<_> = cells.iter().filter(is_there).map(|cell| &cell.curve).collect();
                // As far as all seeds go: a mean of fewer would jump.
                let shared = curves.iter().map(|curve| curve.len()).min().unwrap_or_default();
                let mean = |i: usize| {
                    let points: Vec<_> = curves.iter().filter_map(|curve| curve.get(i)).collect();
                    let n = points.len() as f64;
                    let steps = points.iter().map(|point| point.agent_steps as f64).sum::<f64>() / n;
                    (steps / 1e6, points.iter().map(|point| point.completion).sum::<f64>() / n)
                };
                if shared > 0 {
                    chart.series.push(Series::new(variant.name(), Marks::Line((0..shared).map(mean).collect())));
                }
            }
            charts.extend((!chart.series.is_empty()).then_some(chart));
        }
    }
    charts
}

fn page(findings: &Findings, this_call: &ThisCall, curves: &str) -> String {
    let row = |tag: &str, cells: &mut dyn Iterator<Item = String>| {
        let cells: String = cells.map(|cell| format!("<{tag}>{cell}</{tag}>")).collect();
        format!("<tr>{cells}</tr>")
    };
    let mut rows = format!("<thead>{}</thead><tbody>", row("th", &mut HEADS.into_iter().map(String::from)));
    for cells in table(findings) {
        rows += &row("td", &mut cells.into_iter());
    }
    rows += "</tbody>";
    let claims: String = findings
        .findings
        .iter()
        .map(|finding| {
            let (class, says) = (format!("{:?}", finding.verdict).to_lowercase(), finding.says);
            format!("<li class=\"{class}\"><b>{}. {says}</b><br>{}</li>", finding.claim, verdict(finding))
        })
        .collect();
    include_str!("study.html")
        .replace("/*COLOURS*/", COLOURS)
        .replace("/*SORTING*/", SORTING)
        .replace("/*CLAIMS*/", &claims)
        .replace("/*ROWS*/", &rows)
        .replace("/*CALL*/", &this_call.told("The call that wrote this page"))
        .replace("/*CURVES*/", curves)
}
