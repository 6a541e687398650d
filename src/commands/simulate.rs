//! `lapwing simulate`: the headless simulator for any bridge, or for the expert.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use serde::Serialize;

use super::{Ended, Interrupted, thresholds, world};
use crate::{
    cli,
    config::{Control, Settings},
    driver::Driver,
    pilot::PurePursuit,
    protocol::{Answer, Observation, Sight, World},
    recording::Eventful,
    score::{self, Scorecard, Scorer},
    simulator::{
        client::{self, ClientOptions},
        world::{Human, Simulation},
    },
    units::Mph,
};

#[derive(Serialize)]
struct Result_<'a> {
    driver: &'a str,
    seed: u64,
    #[serde(flatten)]
    card: &'a Scorecard,
    missed: &'a [String],
}

pub(super) fn run(arguments: cli::Simulate, config: Option<&Path>) -> anyhow::Result<Ended> {
    let layers = world::layers(super::undriven_layers(config)?, &arguments.world)?;
    let settings = thresholds::layers(layers, &arguments.thresholds)?.resolve()?;
    let mut setup = world::setup(&settings, &arguments.world, arguments.laps)?;
    setup.human = arguments.human_from.zip(arguments.human_for).map(|(from_s, for_s)| Human {
        from_s,
        for_s,
        speed: Mph::saturating(arguments.speed),
    });
    let pictures = world::Pictures::new(&arguments.pictures, &setup)?;
    let mut live = Live {
        simulation: Simulation::new(setup)?,
        scorer: Scorer::default(),
        pictures,
        progress: world::Progress::new(),
        interrupted: super::interrupted(),
        began: arguments.realtime.then(Instant::now),
    };
    let driver = match &arguments.connect {
        Some(address) => {
            let options = ClientOptions { culture: arguments.culture, stock: arguments.stock, ..Default::default() };
            let played = client::play(&mut live, address, &options, |_| ());
            live.progress.clear();
            let report = match played {
                Ok(report) => report,
                Err(error) => {
                    // What was driven until then is still worth its pictures and its score.
                    finish(live, address, &arguments, &settings)?;
                    return Err(error.into());
                }
            };
            if report.lost_tokens > 0 {
                eprintln!("the simulator would have swallowed {} of the bridge's answers", report.lost_tokens);
            }
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
    let made = live.pictures.finish(&live.simulation)?;
    let card = live.scorer.finish();
    let missed = score::missed(&settings.thresholds, &card);
    let seed = live.simulation.setup().seed;
    if arguments.json {
        let result = Result_ { driver, seed, card: &card, missed: &missed };
        super::print(&serde_json::to_string_pretty(&result)?);
    } else {
        let mut text = format!("{driver} on {}, seed {seed}\n{card}", live.simulation.setup().track.file().name);
        for (what, path) in made {
            text += &format!("\n  {what:<17} {}", path.display());
        }
        super::print(&text);
    }
    Ok(thresholds::ended(&missed))
}

/// The world while somebody drives it: paced, filmed, scored.
struct Live {
    simulation: Simulation,
    scorer: Scorer,
    pictures: world::Pictures,
    progress: world::Progress,
    interrupted: Interrupted,
    /// When, where it keeps step with the clock on the wall.
    began: Option<Instant>,
}

impl Live {
    fn listen(&mut self) {
        for (at, event) in self.simulation.take_events() {
            self.scorer.event(at, &event);
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
            if let Sight::Telemetry(telemetry) = sight {
                self.scorer.telemetry(*at, telemetry);
            }
            self.pictures.take(&self.simulation)?;
        }
        Ok(observation)
    }

    fn apply(&mut self, answer: Answer) {
        self.simulation.apply(answer);
    }
}
