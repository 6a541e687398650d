//! What keeps the simulator honest; nothing here is part of the product.
//!
//! | | |
//! |---|---|
//! | [`survey`] | where a recorded drive was on a track, by its pictures and odometry |
//! | `bin/calibrate` | holds the simulator's car against recordings of the stock simulator's |
//! | `bin/compare_camera` | real pictures beside rendered ones of the same places |

pub mod survey;
