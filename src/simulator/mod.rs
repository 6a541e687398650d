//! A closed-loop world of our own and how it speaks to a bridge.
//!
//! | file | holds |
//! |---|---|
//! | [`track`] | roads: the stock simulator's three, and random ones |
//! | [`vehicle`] | the car's physics |
//! | [`scene`] | what stands and moves on the road |
//! | [`client`] | plays any [`crate::protocol::World`] to any bridge as the Unity build does |

pub mod client;
pub mod scene;
pub mod track;
pub mod vehicle;
