//! Where a recorded drive was on a road, found out from its pictures.
//!
//! A recording says speed, steering and time, but not where the car was.
//! [`localise()`] finds that out: distance from the speed, the place along the
//! road from where the steering bends and where the bridge's paving shows, and
//! then for each picture the offset and the yaw at which the road's edges lie
//! where [`Detector`] sees them. With that, pictures of a real drive and of the
//! simulator's camera can be put side by side at the same places; the program
//! `compare_camera` does so.
//!
//! | file | holds |
//! |---|---|
//! | `edges` | finds the road's edges in a row of a picture |
//! | `view` | where a road's edges lie in a picture, by geometry |
//! | `localise` | from a log and the edges to places on the road |

mod edges;
mod localise;
mod view;

pub use edges::{Detector, Edges};
pub use localise::{FIT_ROWS, Fix, LocaliseError, Odometry, Sighting, localise};
pub use view::{Pose, SurveyLens};

#[cfg(test)]
mod tests;
