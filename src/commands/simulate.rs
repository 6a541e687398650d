//! `lapwing simulate`: the headless simulator for any bridge, or for the expert.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use serde::Serialize;

use super::{Ended, Interrupted, thresholds, world};
use crate::cli;
use lapwing_core::{
    client::{self, ClientOptions},
    config::{Control, Settings},
    control::{Change, Handover},
    driver::Driver,
    pilot::PurePursuit,
    protocol::{Answer, Observation, Sight, World},
    recording::{EventRecord, Eventful},
    units::Mph,
};
use lapwing_score::score::{self, Scorecard, Scorer};
use lapwing_sim::world::{Human, Simulation};

#[derive(Serialize)]
struct Result_<'a> {
    driver: &'a str,
    seed: u64,
    #[serde(flatten)]
    card: &'a Scorecard,
    missed: &'a [String],
}

pub(super) fn run(arguments: cli::Simulate, config: Option<&Path>) -> anyhow::Result<Ended> {
    let interrupted = super::interrupted();
    let connect = arguments.connect.as_deref().map(super::bridge_address).transpose()?;
    let layers = world::layers(super::undriven_layers(config)?, &arguments.world)?;
    let settings = thresholds::layers(layers, &arguments.thresholds)?.resolve()?;
    let mut setup = world::spec(&arguments.world, arguments.laps).setup(&settings.simulator)?;
    setup.human = arguments.human_from.zip(arguments.human_for).map(|(from_s, for_s)| Human {
        from_s,
        for_s,
        speed: Mph::saturating(arguments.speed),
    });
    let pictures = world::Pictures::new(&arguments.pictures, &setup)?;
    let mut live = Live {
        simulation: Simulation::new(setup)?,
        judge: Judge::default(),
        pictures,
        progress: world::Progress::new(),
        interrupted,
        began: arguments.realtime.then(Instant::now),
        answered: false,
    };
    let driver = match &connect {
        Some(address) => {
            let options = ClientOptions { culture: arguments.culture, stock: arguments.stock, ..Default::default() };
            let played = client::play(&mut live, address, &options, |_| ());
            live.progress.clear();
            let report = match played {
                Ok(report) => report,
                Err(error) => {
                    // What was driven until then is still worth its pictures and its score.
                    if live.answered {
                        finish(live, address, &arguments, &settings)?;
                    }
                    return Err(error.into());
                }
            };
            super::tell_ignored(report.lost_tokens);
            format!("the bridge at {address}")
        }
        None => {
            let control = Control { speed_mph: Mph::saturating(arguments.speed), ..settings.control };
            let mut driver = Driver::new(Box::new(PurePursuit::default()), &control, Instant::now);
            while let Some(observation) = live.observe().map_err(|error| anyhow::anyhow!(error))? {
                live.apply(driver.drive(&observation).0);
            }
            live.progress.clear();
            "the expert".to_owned()
        }
    };
    finish(live, &driver, &arguments, &settings)
}

fn finish(mut live: Live, driver: &str, arguments: &cli::Simulate, settings: &Settings) -> anyhow::Result<Ended> {
    live.listen();
    let (made, drawn) = live.pictures.finish(&live.simulation);
    let card = live.judge.scorer.finish();
    let missed = score::missed(&settings.thresholds, &card);
    let seed = live.simulation.setup().seed;
    let result = if arguments.json {
        let result = Result_ { driver, seed, card: &card, missed: &missed };
        serde_json::to_string_pretty(&result)?
    } else {
        let mut text = format!("{driver} on {}, seed {seed}\n{card}", live.simulation.setup().track.file().name);
        for (what, path) in made {
            text += &format!("\n  {what:<17} {}", path.display());
        }
        text
    };
    let printed = super::print(&result);
    let ended = thresholds::ended(&missed);
    drawn?;
    printed?;
    Ok(ended)
}

/// The world while somebody drives it: paced, filmed, scored.
struct Live {
    simulation: Simulation,
    judge: Judge,
    pictures: world::Pictures,
    progress: world::Progress,
    interrupted: Interrupted,
    /// When, where it keeps step with the clock on the wall.
    began: Option<Instant>,
    /// Whether anybody drove.
    answered: bool,
}

impl Live {
    fn listen(&mut self) {
        for (at, event) in self.simulation.take_events() {
            self.judge.scorer.event(at, &event);
        }
    }
}

/// The scorer, and what a bridge's driver would tell it: who has the wheel.
struct Judge {
    scorer: Scorer,
    handover: Handover,
}

impl Default for Judge {
    fn default() -> Self {
        Self { scorer: Scorer::default(), handover: Handover::new(false) }
    }
}

impl Judge {
    fn sight(&mut self, at: Duration, sight: &Sight) {
        let change = match sight {
            Sight::HumanDrives => self.handover.human_drives(at),
            Sight::Telemetry(_) => self.handover.command_asked(at),
            Sight::Unreadable(_) => None,
        };
        let event = change.map(|change| match change {
            Change::TakeoverBegan => EventRecord::TakeoverBegan,
            Change::TakeoverEnded(after) => EventRecord::TakeoverEnded { duration_s: after.as_secs_f64() },
        });
        if let Some(event) = event {
            self.scorer.event(at, &event);
        }
        if let Sight::Telemetry(telemetry) = sight {
            self.scorer.telemetry(at, telemetry);
        }
    }
}

impl World for Live {
    fn observe(&mut self) -> Result<Option<Observation>, Box<dyn std::error::Error + Send + Sync>> {
        self.progress.show(&self.simulation);
        self.interrupted.end(&mut self.simulation);
        let observation = self.simulation.observe()?;
        self.listen();
        if let Some(Observation { at, sight }) = &observation {
            if let Some(began) = self.began {
                std::thread::sleep((began + *at).saturating_duration_since(Instant::now()).min(Duration::from_secs(1)));
            }
            self.judge.sight(*at, sight);
            self.pictures.take(&self.simulation)?;
        }
        Ok(observation)
    }

    fn apply(&mut self, answer: Answer) {
        self.answered = true;
        self.simulation.apply(answer);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use lapwing_score::score::Figure;
    use lapwing_sim::{camera::Scenery, track::Track, world::Setup};

    /// The judgement of half a minute on the lake, driven by the expert, with this human.
    fn judged(human: Option<Human>) -> Scorecard {
        let track = Track::named("lake").unwrap();
        let scenery = Arc::new(Scenery::new(&track));
        let setup = Setup { laps: None, longest_s: Some(30.0), hz: 5.0, human, ..Setup::new(Arc::new(track), scenery) };
        let mut world = Simulation::new(setup).unwrap();
        let mut judge = Judge::default();
        loop {
            let seen = world.observe().unwrap();
            world.take_events().iter().for_each(|(at, event)| judge.scorer.event(*at, event));
            let Some(Observation { at, sight }) = seen else { break };
            judge.sight(at, &sight);
            let command = world.expert(Mph::constant(10.0));
            world.apply(Answer::Steer(command));
        }
        judge.scorer.finish()
    }

    #[test]
    fn a_human_who_takes_the_wheel_is_heard_of_and_costs_autonomy() {
        let card = judged(Some(Human { from_s: 10.0, for_s: 9.0, speed: Mph::constant(10.0) }));
        assert_eq!((card.value(Figure::Takeovers), card.value(Figure::HumanS)), (Some(1.0), Some(9.0)), "{card}");
        let text = card.to_string();
        assert!(text.contains("(1 takeover, 0 interventions)") && !text.contains("± 0 "), "{text}");
        assert!(!text.contains("± 0.0"), "{text}");
        let time_s = card.value(Figure::TimeS).unwrap();
        let autonomies = [Figure::Autonomy, Figure::AutonomyMeasured].map(|figure| card.value(figure).unwrap());
        // Bojarski's 6 s, and as long as it was.
        for (autonomy, lost_s) in autonomies.into_iter().zip([6.0, 9.0]) {
            assert!((autonomy - (1.0 - lost_s / time_s)).abs() < 1e-9, "{card}");
        }
        assert!((card.value(Figure::SurvivalS).unwrap() - 10.0).abs() < 1e-9, "{card}");
    }

    #[test]
    fn without_a_human_the_pilot_drives_all_the_way() {
        let card = judged(None);
        let figures = [Figure::Takeovers, Figure::HumanS, Figure::Autonomy].map(|figure| card.value(figure));
        assert_eq!(figures, [Some(0.0), Some(0.0), Some(1.0)], "{card}");
    }
}
