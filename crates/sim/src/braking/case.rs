//! What there is to be braked for and what not, and in which layer of robustness.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Whether an emergency brake is due in a case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Something is hit unless our car brakes.
    Hazard,
    /// Nothing is, if the driver looks ahead.
    Negative,
}

macro_rules! named {
    ($(#[$doc:meta])* $name:ident { $($(#[$of:meta])* $variant:ident = $text:literal,)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
        #[serde(rename_all = "kebab-case")]
        pub enum $name {
            $($(#[$of])* $variant,)*
        }

        impl $name {
            /// All of them.
            pub const ALL: [Self; [$($text),*].len()] = [$(Self::$variant),*];

            /// What it is called in tables and files.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $text,)*
                }
            }

            /// The one of that name.
            pub fn named(name: &str) -> Option<Self> {
                Self::ALL.into_iter().find(|one| one.name() == name)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(self.name())
            }
        }
    };
}

named! {
    /// A situation on the road. Those whose name is a [`Scenario`](crate::scenario::Scenario)'s are played by it.
    Case {
        /// A standing car.
        Ccrs = "ccrs",
        /// A slower car.
        Ccrm = "ccrm",
        /// A car that brakes.
        Ccrb = "ccrb",
        /// A pedestrian from the near side.
        Cpna = "cpna",
        /// A pedestrian from the far side.
        Cpfa = "cpfa",
        /// A pedestrian along the road.
        Cpla = "cpla",
        /// A child from behind parked cars.
        Child = "child",
        /// A bicyclist who crosses.
        Cbna = "cbna",
        /// A bicyclist along the road.
        Cbla = "cbla",
        /// The car ahead stops gently.
        GentleStop = "gentle-stop",
        /// Cars parked beside the road.
        Parked = "parked",
        /// The car ahead turns off.
        TurnOff = "turn-off",
        /// Nothing but shadows of a low sun.
        Shadows = "shadows",
        /// Cars parked beside a bend.
        Bends = "bends",
        /// Oncoming traffic.
        Oncoming = "oncoming",
        /// A steel plate on the road.
        SteelPlate = "steel-plate",
        /// Passing between two parked cars.
        PassThrough = "pass-through",
        /// People beside the road.
        Bystanders = "bystanders",
        /// Somebody crosses well ahead.
        Crosses = "crosses",
        /// Somebody comes up to the road and waits.
        Waits = "waits",
        /// Nothing at all.
        Lap = "lap",
    }
}

impl Case {
    /// Whether there is something to be braked for.
    pub const fn kind(self) -> Kind {
        match self {
            Self::Ccrs
            | Self::Ccrm
            | Self::Ccrb
            | Self::Cpna
            | Self::Cpfa
            | Self::Cpla
            | Self::Child
            | Self::Cbna
            | Self::Cbla => Kind::Hazard,
            _ => Kind::Negative,
        }
    }

    /// Those of a kind.
    pub fn of(kind: Kind) -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(move |case| case.kind() == kind)
    }

    /// The layers in which it is played. Nothing is hidden where there is nothing.
    pub fn layers(self) -> impl Iterator<Item = Layer> {
        Layer::ALL.into_iter().filter(move |layer| match self.kind() {
            Kind::Hazard => true,
            Kind::Negative if self == Self::Shadows => *layer == Layer::LowSun,
            Kind::Negative => *layer != Layer::Hidden,
        })
    }
}

named! {
    /// A layer of robustness.
    Layer {
        /// By day, in fair weather, all in sight.
        Plain = "plain",
        /// Hidden for a while: by parked cars beside the road, or by a car between that leaves the lane.
        Hidden = "hidden",
        /// In rain.
        Rain = "rain",
        /// With a low sun.
        LowSun = "low-sun",
        /// At night.
        Night = "night",
    }
}

named! {
    /// What an episode is recorded for.
    Part {
        /// To learn from.
        Train = "train",
        /// To choose by.
        Validation = "validation",
        /// To judge by: other looks, other places, other weather.
        HeldOut = "held-out",
    }
}

impl Part {
    /// The piece of a road that all parts share on which this one is played, as shares of the lap.
    pub const fn piece(self) -> [f64; 2] {
        match self {
            Self::Train => [0.0, 0.55],
            Self::Validation => [0.55, 0.75],
            Self::HeldOut => [0.75, 1.0],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;

    #[test]
    fn names_are_found_again_and_written_as_in_json() {
        for case in Case::ALL {
            assert_eq!(Case::named(case.name()), Some(case));
            assert_eq!(serde_json::to_value(case).unwrap(), case.name());
        }
        for layer in Layer::ALL {
            assert_eq!(serde_json::to_value(layer).unwrap(), layer.name());
        }
        assert_eq!(Part::named("held-out"), Some(Part::HeldOut));
        assert_eq!(Case::named("nobody"), None);
    }

    #[test]
    fn every_scenario_that_comes_along_is_a_case() {
        assert!(Scenario::NAMES.iter().all(|name| Case::named(name).is_some()));
        assert_eq!((Case::of(Kind::Hazard).count(), Case::of(Kind::Negative).count()), (9, 12));
    }
}
