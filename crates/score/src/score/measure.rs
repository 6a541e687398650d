//! A measure: a value and how certain it is.

/// What a run says about a figure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measure {
    /// The run reports it.
    Told(f64),
    /// It follows from what the run reports, approximately.
    Estimate {
        /// The value.
        value: f64,
        /// How far off it may be, in the figure's unit.
        uncertainty: f64,
        /// Its source.
        from: &'static str,
    },
    /// Not measurable.
    Unknown(&'static str),
}

impl Measure {
    /// A value, or why there is none.
    pub fn told(value: Option<f64>, why: &'static str) -> Self {
        value.map_or(Self::Unknown(why), Self::Told)
    }

    /// The value, if there is one.
    pub fn value(self) -> Option<f64> {
        match self {
            Self::Told(value) | Self::Estimate { value, .. } => Some(value),
            Self::Unknown(_) => None,
        }
    }

    /// A part of this value, as certain a share of it as the whole is.
    pub fn part(self, part: f64, whole: f64) -> Self {
        self.map(|_| part, if whole > 0.0 { part / whole } else { 1.0 })
    }

    /// Another value computed from this one, equally certain; `scale` converts the uncertainty to the new unit.
    pub fn map(self, of: impl Fn(f64) -> f64, scale: f64) -> Self {
        match self {
            Self::Told(value) => Self::Told(of(value)),
            Self::Estimate { value, uncertainty, from } => {
                Self::Estimate { value: of(value), uncertainty: uncertainty * scale.abs(), from }
            }
            unknown @ Self::Unknown(_) => unknown,
        }
    }
}
