//! Emergency braking: what there is to be braked for, a driver who brakes as people do, what is recorded of it, and how well a
//! guard does.
//!
//! ```text
//! Case, Layer, speed, seed ─▶ Staging ─▶ Simulation ◀─▶ Human ─▶ runs and episodes.csv
//!                                            ◀─▶ Driver and its guard ─▶ what is avoided
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `case` | [`Case`]s, hazards and negatives, and [`Layer`]s of robustness |
//! | `stage` | [`Staging`]: a case as a world, on a road, in some weather |
//! | `stretch` | where on a road it is played |
//! | `sight` | [`Sight`]: what can be seen from the car |
//! | `human` | [`Human`]: the driver |
//! | `play` | a drive with that driver |
//! | `outlines` | [`retell`]: what each picture of a recorded drive shows, and where |
//! | `plan` | the [`Episode`]s of a data set |
//! | `record` | [`record()`]: the data set |
//! | `trial` | [`Trial`]: the closed loop, without and with a guard |

mod case;
mod human;
mod outlines;
mod plan;
mod play;
mod record;
mod sight;
mod stage;
mod stretch;
mod trial;

pub use case::{Case, Kind, Layer, Part};
pub use human::{Attention, Human, Temper};
pub use outlines::{COURSE_M, Outline, Picture, retell};
pub use plan::{Episode, SPEEDS_MPH, episodes, tracks};
pub use play::{Blind, Played, Shown, play};
pub use record::{DataError, DataOptions, DataReport, EPISODES_NAME, HEADING, Places, Recorded, record};
pub use sight::Sight;
pub use stage::{Place, Staging};
pub use trial::{Braker, Outcome, Trial, TrialError, TrialOptions, Tried, trials, try_all};

#[cfg(test)]
mod tests;
