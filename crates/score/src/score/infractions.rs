//! Infractions of a run, and what each costs.

/// What was hit, in the categories of CARLA's leaderboard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Struck {
    Person,
    Vehicle,
    Static,
}

impl Struck {
    /// By the words of a collision event.
    pub(super) fn by_name(with: &str) -> Self {
        let is = |names: &[&str]| with.split(|c: char| !c.is_alphabetic()).any(|word| names.contains(&word));
        if is(&["pedestrian", "child", "person", "walker", "cyclist"]) {
            Self::Person
        } else if is(&["car", "vehicle", "truck", "bus", "motorcycle", "bicycle"]) {
            Self::Vehicle
        } else {
            Self::Static
        }
    }

    /// What it adds to the divisor of the driving score (CARLA leaderboard 2.1).
    fn coefficient(self) -> f64 {
        match self {
            Self::Person => 1.0,
            Self::Vehicle => 0.7,
            Self::Static => 0.6,
        }
    }

    /// What the driving score is multiplied by (CARLA leaderboard 1.0).
    fn factor(self) -> f64 {
        match self {
            Self::Person => 0.5,
            Self::Vehicle => 0.6,
            Self::Static => 0.65,
        }
    }
}

/// Driving scores of CARLA's leaderboard 2.1 and 1.0, 0 to 100, from the distance driven as a share of what was asked
/// for, and the share of it off the road.
pub(super) fn driving_scores(completion: f64, off_road_share: f64, struck: &[Struck]) -> (f64, f64) {
    let way = 100.0 * completion * (1.0 - off_road_share);
    let sum: f64 = struck.iter().map(|hit| hit.coefficient()).sum();
    (way / (1.0 + sum), way * struck.iter().map(|hit| hit.factor()).product::<f64>())
}

/// What an intervention costs, in seconds (Bojarski et al. 2016).
pub(super) const INTERVENTION_S: f64 = 6.0;

/// Autonomy after Bojarski et al. 2016, and the same with the real length of takeovers; 0 to 1.
pub(super) fn autonomies(time_s: f64, takeovers: u32, human_s: f64, interventions: u32) -> (f64, f64) {
    let without = |lost_s: f64| (1.0 - lost_s / time_s).max(0.0);
    let virtual_s = INTERVENTION_S * f64::from(interventions);
    (without(INTERVENTION_S * f64::from(takeovers) + virtual_s), without(human_s + virtual_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_interventions_in_ten_minutes_are_90_percent_autonomous() {
        // The example of Bojarski et al., section 7.1.
        let (autonomy, measured) = autonomies(600.0, 4, 120.0, 6);
        assert!((autonomy - 0.9).abs() < 1e-12);
        assert!((measured - (1.0 - 156.0 / 600.0)).abs() < 1e-12);
        assert_eq!(autonomies(10.0, 3, 0.0, 0).0, 0.0);
    }

    #[test]
    fn a_car_and_a_wall_hit_on_half_the_way() {
        let (new, old) = driving_scores(0.5, 0.1, &[Struck::Vehicle, Struck::Static]);
        assert!((new - 45.0 / 2.3).abs() < 1e-9);
        assert!((old - 45.0 * 0.6 * 0.65).abs() < 1e-9);
        assert_eq!(driving_scores(1.0, 0.0, &[]), (100.0, 100.0));
    }

    #[test]
    fn what_was_hit_is_known_by_its_name() {
        let names = ["a pedestrian", "a child", "a car", "a barrier", "Vehicle_12", "cartwheel"];
        let kinds = [Struck::Person, Struck::Person, Struck::Vehicle, Struck::Static, Struck::Static, Struck::Static];
        assert_eq!(names.map(Struck::by_name), kinds);
    }
}
