//! Open-loop replays: a driver's steering compared with the recorded one.

use lapwing_core::stats::Agreement;

use super::{Figure, Measure, Scorecard, card::Figures};

const NO_REPLAY: &str = "the run reports only one driver's steering: lapwing replay compares another with it";
const OPEN_LOOP: &str = "nothing was driven: an open-loop replay shows what was recorded";
const NO_VARIATION: &str = "the steering does not vary";

/// The figures of a run's steering if nothing was replayed.
pub(super) fn not_replayed() -> [(Figure, Measure); 3] {
    [Figure::SteeringMae, Figure::SteeringMse, Figure::SteeringR].map(|figure| (figure, Measure::Unknown(NO_REPLAY)))
}

impl Scorecard {
    /// The scorecard of an open-loop replay: how well the driver's steering agrees with the recorded one, and nothing
    /// else, as the car's motion is the recorded drive's. Or the reason why there is nothing to compare.
    pub fn of_replay(steering: Result<&Agreement, &'static str>) -> Self {
        let mut figures = Figures::unknown(OPEN_LOOP);
        let why = steering.err().unwrap_or(NO_VARIATION);
        figures.told(Figure::SteeringMae, steering.map(|agreement| agreement.mae).ok(), why);
        figures.told(Figure::SteeringMse, steering.map(|agreement| agreement.mse).ok(), why);
        figures.told(Figure::SteeringR, steering.ok().and_then(|agreement| agreement.r), why);
        figures.card()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_replays_card_tells_the_steering_and_why_it_tells_nothing_else() {
        let card = Scorecard::of_replay(Agreement::of([(0.1, 0.0), (0.1, 0.4)].into_iter()).as_ref().ok_or(""));
        assert_eq!(card.words(Figure::SteeringMae), "0.2000 of full lock");
        assert_eq!(card.words(Figure::SteeringMse), "0.05000 of full lock squared");
        assert_eq!(card.get(Figure::SteeringR), Measure::Unknown(NO_VARIATION));
        assert_eq!(card.get(Figure::Collisions), Measure::Unknown(OPEN_LOOP));
        let json = serde_json::to_value(&card).unwrap();
        assert_eq!((json["steering_mae"].as_f64(), &json["completion"]), (Some(0.2), &serde_json::Value::Null));
        let nothing = Scorecard::of_replay(Err("no network saw a frame"));
        assert_eq!(nothing.get(Figure::SteeringMse), Measure::Unknown("no network saw a frame"));
    }
}
