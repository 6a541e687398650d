//! Tools that check the simulator against reality; nothing here is part of the product.
//!
//! | | |
//! |---|---|
//! | [`survey`] | where a recorded drive was on a track, by its pictures and odometry |
//! | `bin/calibrate` | compares the simulator's car with recordings of the stock simulator's |
//! | `bin/compare_camera` | real pictures beside rendered ones of the same places |

pub mod survey;
