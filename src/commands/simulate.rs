//! `lapwing simulate`: the headless simulator for any bridge, or for the expert.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use super::{Ended, Interrupted, thresholds, world};
use crate::{cli, film::FilmError, real_time::RealTime};
use lapwing_core::{
    client::{self, ClientOptions},
    config::{ControlSettings, Settings},
    control::Handover,
    drive::{self, Eventful, Observer, ObserverError},
    driver::Driver,
    pilot::PurePursuit,
    protocol::{Answer, Observation, Sight, World},
    turn::{By, EventRecord, Turn},
    units::Mph,
};
use lapwing_score::results::{Bridged, ScoredDrive};
use lapwing_score::score::{self, Scorer};
use lapwing_sim::world::{Human, Simulation};

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
    if connect.is_some() {
        // Whoever sits at the bridge's page may stop the car.
        setup.idle_s = Some(world::STOPPED_S);
    }
    let mut seen = Onlookers {
        judge: BridgeScorer::default(),
        pictures: world::Pictures::new(&arguments.pictures, &setup, "bridge")?,
        progress: world::ProgressLine::new(),
        pace: arguments.realtime.then(RealTime::default),
        interrupted,
    };
    let mut simulation = Simulation::new(setup)?;
    let Some(address) = &connect else {
        let control = ControlSettings { speed_mph: Mph::saturating(arguments.speed), ..settings.control };
        let mut driver = Driver::new(Box::new(PurePursuit::default()), &control, Instant::now);
        let Onlookers { judge, pictures, progress, pace, interrupted } = &mut seen;
        drive::run(&mut simulation, &mut driver, &mut [pace, progress, interrupted, judge, pictures])?;
        return finish(seen, &simulation, "the expert", &arguments, &settings);
    };
    let options = ClientOptions { culture: arguments.culture, stock: arguments.stock, ..Default::default() };
    let mut world = BridgedSimulation { simulation, seen, answered: false };
    let played = client::play(&mut world, address, &options, |_| ());
    world.seen.progress.clear();
    world.listen();
    let BridgedSimulation { simulation, seen, answered } = world;
    let report = match played {
        Ok(report) => report,
        Err(error) => {
            // The drive so far still gets its pictures and its score.
            if answered {
                finish(seen, &simulation, address, &arguments, &settings)?;
            }
            return Err(error.into());
        }
    };
    super::tell_ignored(report.lost_tokens);
    finish(seen, &simulation, &format!("the bridge at {address}"), &arguments, &settings)
}

fn finish(
    seen: Onlookers,
    simulation: &Simulation,
    driver: &str,
    arguments: &cli::Simulate,
    settings: &Settings,
) -> anyhow::Result<Ended> {
    let (made, drawn) = seen.pictures.finish(simulation);
    let card = seen.judge.scorer.finish();
    let missed = score::missed(&settings.thresholds, &card);
    let seed = simulation.setup().seed;
    let result = if arguments.json {
        let drive = ScoredDrive { who: Bridged { driver, seed }, card: &card, how: (), missed: &missed };
        serde_json::to_string_pretty(&drive)?
    } else {
        let mut text = format!("{driver} on {}, seed {seed}\n{card}", simulation.setup().track.file().name);
        for (what, place) in made {
            text += &format!("\n  {what:<17} {place}");
        }
        text
    };
    let printed = super::print(&result);
    let ended = thresholds::ended_whole(&card, &settings.thresholds, &missed);
    drawn?;
    printed?;
    Ok(ended)
}

/// The observers, whoever drives.
struct Onlookers {
    judge: BridgeScorer,
    pictures: world::Pictures,
    progress: world::ProgressLine,
    pace: Option<RealTime>,
    interrupted: Interrupted,
}

/// The world while a bridge drives it. Its turns are made by the bridge, which reports neither who answered nor how,
/// may be working on several telemetries, and may leave one unanswered. So observers are shown each observation when it
/// is made.
struct BridgedSimulation {
    simulation: Simulation,
    seen: Onlookers,
    /// Whether the bridge ever answered.
    answered: bool,
}

impl BridgedSimulation {
    fn listen(&mut self) {
        for (at, event) in self.simulation.take_events() {
            self.seen.judge.scorer.event(at, &event);
        }
    }
}

impl World for BridgedSimulation {
    type Error = FilmError;

    fn observe(&mut self) -> Result<Option<Observation>, FilmError> {
        self.seen.progress.show(&self.simulation);
        if self.seen.interrupted.is_pressed() {
            self.simulation.interrupt();
        }
        let Ok(observation) = self.simulation.observe();
        self.listen();
        if let Some(Observation { at, sight }) = &observation {
            Observer::<Self>::ready(&mut self.seen.pace, *at);
            self.seen.judge.sight(*at, sight);
            let (sent, by) = match sight {
                Sight::Telemetry(telemetry) => (Some(&telemetry.image), By::Pilot),
                Sight::HumanDrives => (None, By::Human),
                Sight::Unreadable(_) => (None, By::Pilot),
            };
            self.seen.pictures.take(&self.simulation, sent, by)?;
        }
        Ok(observation)
    }

    fn apply(&mut self, answer: Answer) {
        self.answered = true;
        self.simulation.apply(answer);
    }
}

/// The scorer, and who has the wheel, as a bridge's driver would report it.
struct BridgeScorer {
    scorer: Scorer,
    handover: Handover,
}

impl Default for BridgeScorer {
    fn default() -> Self {
        Self { scorer: Scorer::default(), handover: Handover::new(false) }
    }
}

impl BridgeScorer {
    fn sight(&mut self, at: Duration, sight: &Sight) {
        let change = match sight {
            Sight::HumanDrives => self.handover.human_drives(at),
            Sight::Telemetry(_) => self.handover.command_asked(at),
            Sight::Unreadable(_) => None,
        };
        if let Some(change) = change {
            self.scorer.event(at, &change.into());
        }
        if let Sight::Telemetry(telemetry) = sight {
            self.scorer.telemetry(at, telemetry);
        }
    }
}

/// Judges every driver as it judges a bridge, whose answers it does not know.
impl<W: ?Sized> Observer<W> for BridgeScorer {
    fn turn(&mut self, _: &W, turn: &Turn) -> Result<(), ObserverError> {
        self.sight(turn.at(), &turn.observation.sight);
        Ok(())
    }

    fn event(&mut self, at: Duration, event: &EventRecord) {
        self.scorer.event(at, event);
    }

    fn untold(&mut self, at: Duration, event: &EventRecord) {
        self.scorer.event(at, event);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use lapwing_score::score::{Figure, Scorecard};
    use lapwing_sim::{camera::Scenery, track::Track, world::Setup};

    /// The scorecard of half a minute on the lake, driven by the expert, with this human.
    fn judged(human: Option<Human>) -> Scorecard {
        let track = Track::named("lake").unwrap();
        let scenery = Arc::new(Scenery::new(&track));
        let setup = Setup { laps: None, longest_s: Some(30.0), hz: 5.0, human, ..Setup::new(Arc::new(track), scenery) };
        let mut world = Simulation::new(setup).unwrap();
        let control = ControlSettings { speed_mph: Mph::constant(10.0), ..ControlSettings::default() };
        let mut driver = Driver::new(Box::new(PurePursuit::default()), &control, Instant::now);
        let mut judge = BridgeScorer::default();
        drive::run(&mut world, &mut driver, &mut [&mut judge]).unwrap();
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
        // Bojarski's 6 s, and the real length.
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
