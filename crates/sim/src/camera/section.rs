//! The road's cross-section: its colour by distance from the middle.

use glam::{Vec3, Vec4};

use super::noise::{mix3, nearest};

/// What changes along the road within a cross-section.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Pattern {
    /// Nothing changes.
    Plain,
    /// Bars across: period in metres, and the share of it that shows the second colour.
    Bars { period: f32, share: f32 },
    /// Flecks where the mask of the road's texture is set.
    Flecks,
}

/// A texture's two colours at an offset, how strong the texture is there, and how much the pattern counts.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Stripe {
    pub(super) plain: Vec4,
    pub(super) other: Vec4,
    /// How much of the texture shows, 0 to 1.
    pub(super) rough: f32,
    /// How much of the pattern shows, 0 to 1; `other` includes it.
    pub(super) pattern: f32,
}

/// How far from the middle a cross-section reaches, in metres.
pub(super) const REACH_M: f32 = 12.8;
const FINEST: usize = 512;
/// Stripes a metre, in the finest copy.
pub(super) const STRIPES_PER_M: f32 = FINEST as f32 / REACH_M;

/// A cross-section in ever coarser copies.
#[derive(Debug, Clone)]
pub(super) struct Section {
    levels: Vec<Vec<Stripe>>,
    pub(super) texture: u8,
    pub(super) pattern: Pattern,
}

/// A band of a cross-section: from and to in metres from the middle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Band {
    pub(super) from: f32,
    pub(super) to: f32,
    pub(super) colour: [f32; 3],
    pub(super) other: [f32; 3],
    pub(super) rough: f32,
    pub(super) pattern: f32,
}

impl Band {
    pub(super) fn plain(from: f32, to: f32, colour: [f32; 3], rough: f32) -> Self {
        Self { from, to, colour, other: colour, rough, pattern: 0.0 }
    }
}

impl Band {
    /// The same, its colours so many times as far from the asphalt's. Asphalt itself, the roughest of all, stays.
    pub(super) fn standing_out(self, asphalt: [f32; 3], times: f32) -> Self {
        let far = |c: [f32; 3]| mix3(asphalt, c, times).map(|c| c.clamp(0.0, 255.0));
        if self.rough >= 1.0 || times == 1.0 {
            self
        } else {
            Self { colour: far(self.colour), other: far(self.other), ..self }
        }
    }
}

impl Section {
    /// Lays bands over one another, the last on top.
    pub(super) fn new(texture: u8, pattern: Pattern, bands: &[Band]) -> Self {
        const FINER: usize = 8;
        let at = |metres: f32| {
            let mut top = Band::plain(0.0, 0.0, [128.0; 3], 1.0);
            for band in bands.iter().filter(|band| (band.from..band.to).contains(&metres)) {
                top = *band;
            }
            top
        };
        let stripe = |colours: &[([f32; 3], [f32; 3], f32, f32)]| {
            let n = colours.len() as f32;
            let sum = colours.iter().fold(([0.0; 3], [0.0; 3], 0.0, 0.0), |sum, c| {
                let add = |a: [f32; 3], b: [f32; 3]| [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
                (add(sum.0, c.0), add(sum.1, c.1), sum.2 + c.2, sum.3 + c.3)
            });
            (sum.0.map(|c| c / n), sum.1.map(|c| c / n), sum.2 / n, sum.3 / n)
        };
        let mut level: Vec<_> = (0..FINEST)
            .map(|i| {
                let fine: Vec<_> = (0..FINER)
                    .map(|k| {
                        let band = at((i as f32 + (k as f32 + 0.5) / FINER as f32) / STRIPES_PER_M);
                        (band.colour, mix3(band.colour, band.other, band.pattern), band.rough, band.pattern)
                    })
                    .collect();
                stripe(&fine)
            })
            .collect();
        let mut levels = Vec::new();
        loop {
            levels.push(
                level
                    .iter()
                    .map(|(plain, other, rough, pattern)| Stripe {
                        plain: Vec3::from_array(*plain).extend(0.0),
                        other: Vec3::from_array(*other).extend(0.0),
                        rough: *rough,
                        pattern: *pattern,
                    })
                    .collect(),
            );
            if level.len() == 1 {
                return Self { levels, texture, pattern };
            }
            level = level.chunks(2).map(stripe).collect();
        }
    }

    /// Stripes that each average about `1 << level` of the finest.
    #[inline]
    pub(super) fn level(&self, level: usize) -> Stripes<'_> {
        let level = level.min(self.levels.len() - 1);
        Stripes { stripes: &self.levels[level], per_m: STRIPES_PER_M / (1 << level) as f32 }
    }
}

/// One of the copies of a cross-section.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stripes<'a> {
    stripes: &'a [Stripe],
    per_m: f32,
}

impl Stripes<'_> {
    /// The stripe at a distance from the middle.
    #[inline]
    pub(super) fn at(&self, metres: f32) -> &Stripe {
        &self.stripes[nearest(metres * self.per_m - 0.5).min(self.stripes.len() - 1)]
    }
}

impl Pattern {
    /// How much of the second colour shows at `s`, seen `footprint` metres long; `mask` is the texture's.
    #[inline]
    pub(super) fn share(self, s: f32, footprint: f32, mask: u8) -> f32 {
        match self {
            Self::Plain => 0.0,
            Self::Flecks => f32::from(mask) * (1.0 / 255.0),
            Self::Bars { period, share } => {
                let phase = s / period;
                let phase = phase - phase as i32 as f32; // s is never negative
                // Distance from the bar's edge, positive inside, in units of the footprint.
                let inside = (share / 2.0 - (phase - 0.5).abs()) * period;
                let sharp = (inside / footprint + 0.5).clamp(0.0, 1.0);
                let far = (footprint / period - 0.5).clamp(0.0, 1.0);
                sharp + (share - sharp) * far
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_as_wide_as_it_was_laid() {
        let bands = [Band::plain(0.0, 20.0, [100.0; 3], 1.0), Band::plain(3.0, 3.1, [200.0; 3], 1.0)];
        let section = Section::new(0, Pattern::Plain, &bands);
        let bright: f32 = section.levels[0].iter().map(|s| (s.plain.x - 100.0) / 100.0).sum();
        assert!((bright / STRIPES_PER_M - 0.1).abs() < 0.01, "{} m", bright / STRIPES_PER_M);
        let far = section.level(5).at(3.05).plain.x;
        assert!((102.0..140.0).contains(&far), "seen from afar it pales: {far}");
    }

    #[test]
    fn bars_become_their_mean_from_afar() {
        let bars = Pattern::Bars { period: 9.0, share: 1.0 / 3.0 };
        assert_eq!(bars.share(4.5, 0.1, 0), 1.0);
        assert_eq!(bars.share(0.2, 0.1, 0), 0.0);
        assert!((bars.share(0.2, 50.0, 0) - 1.0 / 3.0).abs() < 1e-6);
    }
}
