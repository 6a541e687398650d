//! Many drives as one: which they are, where their results lie, what they come to.
//!
//! A [`Suite`] (a small TOML file) is pilots x tracks x conditions x speeds x seeds; each combination is a [`Cell`]. A cell's
//! result is a file of its own under a name that follows from all that the drive depends on ([`Cell::id`]), so that a
//! suite that was killed goes on where it was, several machines can share one out ([`Shard`]), and what they have done
//! is put together by copying files ([`merge()`]). Who drives, and in which world, is for the caller to say: [`Course`].
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
//! Where a seed changes nothing, in fair weather for example, the first one is driven and the others are left out: ten
//! times the same drive is one.
//!
//! # Files
//! In the folder of the results lie `cells/ID.json`, one for each cell that was driven, `plan.json`, `suite.json` and
//! `suite.html`. A key's meaning never changes under one number of a schema; new keys may come.
//!
//! ## `cells/ID.json`: `lapwing.cell/1`
//! `ID` is [`Cell::id`]: another drive has another one. Written by [`Results::keep`].
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
//! | `cell.longest_s` | number, s | time of the world after which the drive ends |
//! | `cell.settings.lapwing` | string | the version of Lapwing that drove |
//! | `cell.settings.control` | object | settings in force, with the keys of `[control]`: [`ControlSettings`](lapwing_core::config::ControlSettings) |
//! | `cell.settings.simulator` | object | and with those of `[simulator]`: [`SimulatorSettings`](lapwing_core::config::SimulatorSettings) |
//! | `cell.settings.beside_model_sha256` | string or null | SHA-256 of the `.toml` beside a TorchScript model; null for others |
//! | `cell.world.conditions` | object | what `cell.conditions` means with this seed: `lapwing_sim::conditions::Conditions` has its keys and units |
//! | `cell.world.track_sha256` | string or null | SHA-256 of the track's file; null for a track that comes with Lapwing |
//! | `card` | object | the scorecard, `lapwing.scorecard/1`: [`Scorecard`](crate::score::Scorecard) |
//! | `fingerprint` | string | SHA-256 over all frames and commands in hexadecimal: equal where two drives were the same |
//! | `took_s` | number, s | how long the drive took, on the wall |
//!
//! ## `plan.json`: `lapwing.plan/1`
//! All cells of the suite that was driven here last, in the order of driving, those of other parts included. Written by
//! [`Results::keep_plan`] before the first drive.
//!
//! | key | type | is |
//! |---|---|---|
//! | `schema` | string | `lapwing.plan/1` |
//! | `cells[].id` | string | its file's name in `cells` without `.json` |
//! | `cells[].drive` | string | what people call it, such as `mine on lake, fair, 20 mph, seed 0` |
//!
//! ## `suite.json`: `lapwing.suite/1`
//! What the drives come to ([`SuiteOutcome`]); `--json` prints the same.
//!
//! | key | type | is |
//! |---|---|---|
//! | `schema` | string | `lapwing.suite/1` |
//! | `planned` | integer or null | cells of the suite, those of other parts included; null where no plan says so |
//! | `missing` | integer | those without a result; without a plan only those whose file cannot be read |
//! | `groups[]` | object | cells that differ in nothing but their seed |
//! | `groups[].pilot` | string | the pilot's name, and ` (settings ID)` behind it where the name alone does not tell groups apart |
//! | `groups[].model_sha256` | string or null | as `cell.model_sha256` |
//! | `groups[].track` | string | as `cell.track` |
//! | `groups[].conditions` | string | as `cell.conditions` |
//! | `groups[].speed_mph` | number, mph | as `cell.speed_mph` |
//! | `groups[].figures.KEY` | object | the figure of this key over the drives, in the unit of [`Figure`](crate::score::Figure); a share is 0 to 1; absent where no drive tells it |
//! | `groups[].figures.KEY.runs` | integer | drives that tell it, n |
//! | `groups[].figures.KEY.mean` | number | mean over them; of the collision rate over their episodes |
//! | `groups[].figures.KEY.deviation` | number or null | standard deviation of one drive, n - 1 below; null of a single one |
//! | `groups[].figures.KEY.least` | number | smallest |
//! | `groups[].figures.KEY.most` | number | largest |
//! | `groups[].figures.KEY.confidence` | number or null | half the width of the mean's confidence interval at 95 %, by Student's t; null of a single drive |
//! | `groups[].figures.KEY.interval` | two numbers or null | the mean's interval at 95 %, never beyond what can be: Student's t, for counts of what happens now and then at least Garwood's; null of a single drive, and where all tell the same; the table and the page show this one |

mod drive;
mod merge;
mod outcome;
mod page;
mod plan;
mod results;
mod spec;

pub use drive::{Course, DriveError, Planned, Stop, Watch, drive_all};
pub use merge::{MergeError, Merged, check_parts, merge};
pub use outcome::{Group, Over, SuiteOutcome, groups, table};
pub use page::render;
pub use plan::Plan;
pub use results::{Done, Results, ResultsError, Unreadable};
pub use spec::{Cell, Contestant, Seeds, Shard, ShardError, Suite, SuiteError};

#[cfg(test)]
mod tests;
