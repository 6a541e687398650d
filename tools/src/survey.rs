//! Finds where a recorded drive was on a road, from its pictures.
//!
//! A recording has speed, steering and time, but not the car's place. [`localise()`] finds it: the distance from the
//! speed, the place along the road from the steering and from the bridge's paving, and then for each picture the offset
//! and the yaw at which the road's edges are where [`Detector`] sees them. So pictures of a real drive and of the
//! simulator's camera can be compared at the same places, as the program `compare_camera` does.
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
