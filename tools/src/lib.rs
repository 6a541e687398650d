//! Tools that check the simulator against reality; nothing here is part of the product.
//!
//! | | |
//! |---|---|
//! | [`drive`] | a recorded drive: pictures, and the motion between them |
//! | [`survey`] | where a recorded drive was on a track, by its pictures and odometry |
//! | `bin/calibrate` | compares the simulator's car with recordings of the stock simulator's |
//! | `bin/fit_road` | fits a track's control points to a real drive |
//! | `bin/judge_road` | how well the pictures of a real drive lie on a track |
//! | `bin/compare_camera` | real pictures beside rendered ones of the same places |

pub mod drive;
pub mod survey;
