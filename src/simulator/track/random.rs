//! Random tracks from a seed.

/// What a random track is to be like.
#[derive(Debug, Clone, PartialEq)]
pub struct RandomTrack {}
