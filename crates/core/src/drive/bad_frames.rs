//! How many frames may be bad.

/// Share of bad frames above which a drive or a replay says too little about a driver to pass.
const MOST: f64 = 0.01;

/// The error, if too many of `all` frames are bad.
pub fn too_many_bad_frames(bad: u64, all: u64) -> Option<String> {
    let most = MOST * 100.0;
    (bad as f64 > MOST * all as f64)
        .then(|| format!("expected at most {most} % bad frames, which no network sees, got {bad} of {all}"))
}
