//! Real pictures beside drawn ones of the same places: what differs, and whether a network can tell them apart.
//!
//! ```sh
//! lapwing locate DIR --csv lane.csv
//! cargo run --release -p lapwing-tools --bin real_or_drawn -- DIR --lane lane.csv --out compared
//! ```
//! Both kinds of picture have passed through a JPEG coder of the stock build's quality. With `--control` the second kind
//! is not drawn but the real one, coded once more by our coder: nothing but the coder could then tell them apart.
//!
//! | file | holds |
//! |---|---|
//! | `pairs` | the same places, real and drawn |
//! | `figures` | colours, grain, and the road's cross-section of both |
//! | `judge` | the network, how it is trained, what it tells by |
//! | `sheet` | the pictures that are written |

#![allow(clippy::print_stdout)] // its result, for us to read

mod figures;
mod judge;
mod pairs;
mod sheet;

use std::{fs, path::PathBuf};

use anyhow::{Result, ensure};
use clap::Parser;
use lapwing_sim::conditions::Conditions;

/// Compares real pictures with drawn ones of the same places, and trains a network to tell them apart.
#[derive(Debug, Parser)]
struct Args {
    /// A recording: a Udacity folder, or a run.
    recording: PathBuf,
    /// Where the car was in each of its pictures: the table of `lapwing locate --csv`.
    #[arg(long)]
    lane: PathBuf,
    /// Folder for the pictures; they show parts of the recording.
    #[arg(long)]
    out: PathBuf,
    /// Places that are compared, evenly spread over the recording.
    #[arg(long, default_value_t = 300)]
    places: usize,
    /// How often the network sees each picture.
    #[arg(long, default_value_t = 8)]
    passes: usize,
    /// Seed of the network and of the order in which it learns.
    #[arg(long, default_value_t = 1)]
    seed: i64,
    /// Light, weather and graphics settings of the drawn pictures, such as grain=1.5,warmth=-1 [default: fair weather].
    #[arg(long, value_name = "LIST", value_parser = Conditions::parse)]
    conditions: Option<Conditions>,
    /// Compares the real pictures with themselves, coded once more.
    #[arg(long, conflicts_with = "conditions")]
    control: bool,
    /// Processors that the network may use.
    #[arg(long, default_value_t = 1)]
    threads: usize,
}

fn main() -> Result<()> {
    let args = Args::parse();
    let drawn = (!args.control).then(|| args.conditions.unwrap_or_default());
    let (track, pairs) = pairs::read(&args.recording, &args.lane, args.places, drawn.as_ref())?;
    fs::create_dir_all(&args.out)?;
    sheet::side_by_side(&pairs, &args.out.join("side_by_side.png"))?;
    print!("{}", figures::Figures::of(&track, &pairs));

    let held_out = pairs.iter().filter(|pair| pair.held_out()).count();
    let learnt = pairs.iter().filter(|pair| pair.learnt()).count();
    ensure!(held_out > 0 && learnt > 0, "expected places to learn from and places held out, got {learnt}, {held_out}");
    println!("network: {learnt} pairs learnt, {held_out} held out");
    tch::set_num_threads(i32::try_from(args.threads.max(1))?);
    let judge = judge::Judge::train(&pairs, args.passes, args.seed)?;
    let verdict = judge.verdict(&pairs)?;
    print!("{verdict}");
    sheet::tells(&verdict, &args.out.join("tells.png"))?;
    Ok(())
}
