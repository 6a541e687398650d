//! Many drives as one: which they are, where their results lie, what they come to.
//!
//! A [`Suite`] (a small TOML file) is pilots x tracks x conditions x speeds x seeds; each combination is a [`Cell`]. A cell's
//! result is a file of its own under a name that follows from all that the drive depends on ([`Cell::id`]), so that a
//! suite that was killed goes on where it was, several machines can share one out ([`Shard`]), and what they have done
//! is put together by copying files. Driving itself is not done here.
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

mod page;
mod results;
mod spec;

pub use page::render;
pub use results::{Done, Group, Results, ResultsError, groups, table};
pub use spec::{Cell, Contestant, Seeds, Shard, Suite, SuiteError};

#[cfg(test)]
mod tests;
