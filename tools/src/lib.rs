//! Tools that check the simulator against reality; nothing here is part of the product.
//!
//! | | |
//! |---|---|
//! | [`course`] | a road by its control points, and where its points are seen |
//! | [`drive`] | a recorded drive: pictures, and the motion between them |
//! | [`linear`] | systems of linear equations |
//! | [`survey`] | where a recorded drive was on a track, by its pictures and odometry |
//! | `bin/calibrate` | compares the simulator's car with recordings of the stock simulator's |
//! | `bin/fit_road` | fits a track's control points to a real drive |
//! | `bin/fit_heights` | mends a track's heights by the scene's waypoints and by how drives slowed down |
//! | `bin/judge_road` | how well the pictures of a real drive lie on a track |
//! | `bin/compare_camera` | do the road's edges lie in the same columns of real and rendered pictures? |
//! | `bin/real_or_drawn` | real pictures beside drawn ones: what differs, and whether a network can tell |

pub mod course;
pub mod drive;
pub mod linear;
pub mod survey;
