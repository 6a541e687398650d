//! How far from the line the car was.

/// Distances from the line of which the card says for how much of the time they were exceeded, in metres.
const BEYOND_M: [f64; 2] = [1.0, 2.0];

/// |cte| of each telemetry that reports it, in metres.
#[derive(Debug, Clone, Default)]
pub(super) struct Offsets {
    pub(super) n: u64,
    pub(super) sum: f64,
    pub(super) squares: f64,
    pub(super) most: f64,
    /// Seconds between two of them, and how many of those beyond each of [`BEYOND_M`].
    pub(super) timed_s: f64,
    pub(super) beyond_s: [f64; 2],
    /// When the last one was, and what.
    pub(super) last: Option<(f64, f64)>,
    /// Empty when live.
    pub(super) all: Vec<f64>,
}

impl Offsets {
    /// Takes one; `goes_on` if the time since the last one was driven.
    pub(super) fn take(&mut self, at_s: f64, cte_m: f64, goes_on: bool, keep: bool) {
        let off_m = cte_m.abs();
        if let Some((then_s, then_m)) = self.last.replace((at_s, off_m)).filter(|_| goes_on) {
            // Each stands for half the time between the two.
            let half_s = (at_s - then_s).max(0.0) / 2.0;
            self.timed_s += 2.0 * half_s;
            for (beyond_s, limit_m) in self.beyond_s.iter_mut().zip(BEYOND_M) {
                *beyond_s += half_s * f64::from(u8::from(then_m > limit_m) + u8::from(off_m > limit_m));
            }
        }
        self.n += 1;
        self.sum += off_m;
        self.squares += off_m * off_m;
        self.most = self.most.max(off_m);
        self.all.extend(keep.then_some(off_m));
    }
}
