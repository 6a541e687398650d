//! Many drives as one: the plan, the results, the outcome.
//!
//! A [`Suite`] (a small TOML file) is pilots x tracks x conditions x speeds x seeds; each combination is a [`Cell`]. A
//! cell's result is a file of its own, named by a hash of all that the drive depends on ([`Cell::id`]). So a suite that
//! was killed resumes where it was, several machines can share one ([`Shard`]), and their results are merged by copying
//! files ([`merge()`]). The caller provides the pilots and worlds: [`Course`].
//!
//! ```toml
//! tracks = ["lake", "jungle", "mountain"]
//! conditions = ["fair", "noise=4", "random"]   # as --conditions; fair is none
//! speeds_mph = [20, 30]
//! seeds = 10                                   # 0 to 9, or a list
//!
//! [[pilot]]
//! name = "built in"
//!
//! [[pilot]]
//! name = "mine"
//! model = "runs/mine/model.safetensors"
//!
//! [[pilot]]
//! name = "expert"
//! expert = true
//! ```
//!
//! If a seed changes nothing, in fair weather for example, only the first one is driven: ten times the same drive
//! counts as one.
//!
//! # Files
//! The folder of the results contains `cells/ID.json`, one for each cell that was driven, `runs/ID.mcap` and
//! `runs/ID.html` of the runs that are kept ([`Keep`]), `plan.json`, `suite.json` and `suite.html`. A key's meaning never changes under one number of a schema; new keys may be added.
//!
//! ## `cells/ID.json`: `lapwing.cell/1`
//! `ID` is [`Cell::id`], which differs for each drive. Written by [`Results::keep`].
//!
//! | key | type | is |
//! |---|---|---|
//! | `schema` | string | `lapwing.cell/1` |
//! | `cell.pilot` | string | the pilot's name in the suite |
//! | `cell.model_sha256` | string or null | SHA-256 of its model in hexadecimal; null for the expert |
//! | `cell.track` | string | the track, as `--track` takes it |
//! | `cell.conditions` | string | the conditions, as `--conditions` takes them, or `fair` |
//! | `cell.speed_mph` | number, mph | the set speed |
//! | `cell.seed` | integer | the seed |
//! | `cell.laps` | integer | laps asked for |
//! | `cell.longest_s` | number, s | simulated time after which the drive ends |
//! | `cell.settings.lapwing` | string | the version of Lapwing that drove, and a hash of the sources that it was built from: `0.1.0+0123456789abcdef` |
//! | `cell.settings.control` | object | settings in force, with the keys of `[control]`: [`ControlSettings`](lapwing_core::config::ControlSettings) |
//! | `cell.settings.perception` | object | with those of `[perception]`: [`PerceptionSettings`](lapwing_core::config::PerceptionSettings) |
//! | `cell.settings.simulator` | object | and with those of `[simulator]`: [`SimulatorSettings`](lapwing_core::config::SimulatorSettings) |
//! | `cell.settings.beside_model_sha256` | string or null | SHA-256 of the `.toml` beside a TorchScript or ONNX model; null for others |
//! | `cell.world.conditions` | object | what `cell.conditions` means with this seed: `lapwing_sim::conditions::Conditions` has its keys and units |
//! | `cell.world.track_sha256` | string or null | SHA-256 of the track's file; null for a track that comes with Lapwing |
//! | `card` | object | the scorecard, `lapwing.scorecard/1`: [`Scorecard`](crate::score::Scorecard) |
//! | `fingerprint` | string | SHA-256 over all frames and commands in hexadecimal: equal if two drives were the same |
//! | `bad_frames` | string or absent | if more than 1 % of its frames were bad: how many, and why the first was |
//! | `took_s` | number, s | how long the drive took, in real time |
//! | `run` | string or absent | its run, if it was kept: the path from this folder, such as `runs/ID.mcap` |
//!
//! ## `plan.json`: `lapwing.plan/1`
//! All cells of the suite that was driven here last, in the order of driving, including those of other parts. Written
//! by [`Results::keep_plan`] before the first drive.
//!
//! | key | type | is |
//! |---|---|---|
//! | `schema` | string | `lapwing.plan/1` |
//! | `cells[].id` | string | its file's name in `cells` without `.json` |
//! | `cells[].drive` | string | its name for people, such as `mine on lake, fair, 20 mph, seed 0` |
//!
//! ## `suite.json`: `lapwing.suite/1`
//! The outcome of the drives ([`SuiteOutcome`]); `--json` prints the same.
//!
//! | key | type | is |
//! |---|---|---|
//! | `schema` | string | `lapwing.suite/1` |
//! | `planned` | integer or null | cells of the suite, including those of other parts; null without a plan |
//! | `missing` | integer | those without a result; without a plan only those whose file cannot be read |
//! | `groups[]` | object | cells that differ only in their seed |
//! | `groups[].pilot` | string | the pilot's name, followed by ` (settings ID)` if the name alone does not tell groups apart |
//! | `groups[].model_sha256` | string or null | as `cell.model_sha256` |
//! | `groups[].track` | string | as `cell.track` |
//! | `groups[].conditions` | string | as `cell.conditions` |
//! | `groups[].speed_mph` | number, mph | as `cell.speed_mph` |
//! | `groups[].figures.KEY` | object | the figure of this key over the drives, in the unit of [`Figure`](crate::score::Figure); a share is 0 to 1; absent if no drive reports it |
//! | `groups[].figures.KEY.runs` | integer | drives that report it, n |
//! | `groups[].figures.KEY.mean` | number | mean over them; for the collision rate, over their episodes |
//! | `groups[].figures.KEY.deviation` | number or null | standard deviation of one drive, with divisor n - 1; null for a single one |
//! | `groups[].figures.KEY.least` | number | smallest |
//! | `groups[].figures.KEY.most` | number | largest |
//! | `groups[].figures.KEY.confidence` | number or null | half the width of the mean's confidence interval at 95 %, by Student's t; null for a single drive |
//! | `groups[].figures.KEY.interval` | two numbers or null | the mean's interval at 95 %, within the possible range: Student's t, for counts of occasional events at least Garwood's; null for a single drive, and if all report the same; the table and the page show this one |
//! | `groups[].drives[]` | object | the drives that failed, or whose run was kept |
//! | `groups[].drives[].seed` | integer | as `cell.seed` |
//! | `groups[].drives[].failed` | string or null | what went wrong: too many bad frames, laps not finished, collisions, times off the road |
//! | `groups[].drives[].bad_frames` | string or null | as `bad_frames` of `cells/ID.json`; null if there were few or none |
//! | `groups[].drives[].run` | string or null | as `run` of `cells/ID.json` |

mod drive;
mod merge;
mod outcome;
mod page;
mod plan;
mod results;
mod spec;

pub use drive::{Course, DriveError, Driven, Keep, Planned, Stop, Watch, drive_all};
pub use merge::{MergeError, Merged, check_parts, merge};
pub use outcome::{Group, GroupDrive, Over, SuiteOutcome, groups, table};
pub use page::render;
pub use plan::Plan;
pub use results::{Done, Results, ResultsError, Unreadable};
pub use spec::{Cell, Contestant, Seeds, Shard, ShardError, Suite, SuiteError};

#[cfg(test)]
mod tests;
