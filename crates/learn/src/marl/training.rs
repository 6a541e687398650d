//! A training in a folder: it can be watched, stopped and resumed.

use std::{
    collections::{HashMap, VecDeque},
    fmt::Write as _,
    fs::{self, File, OpenOptions},
    io::Write as _,
    path::{Path, PathBuf},
    time::Instant,
};

use serde::{Deserialize, Serialize};

use super::{
    MaddpgSettings, MarlError, Policy, PpoSettings, Update, file,
    learner::{Algorithm, Counters, Learner, World},
    policy::{FORMAT, PolicyMetadata},
};
use crate::train::events::Events;
use lapwing_core::{files, words::did_you_mean};
use lapwing_sim::intersection::{Axes, Settings, Sight};

const POLICY: &str = "policy.safetensors";
const STATE: &str = "state.safetensors";
const LOG: &str = "log.csv";
const SETTINGS: &str = "settings.json";
const EVENTS: &str = "events.out.tfevents.";
const POSITION: &str = "lapwing.training";
/// Seconds between two saves; one more at the end.
const SAVE_EVERY_S: f64 = 30.0;
/// The share of the last so many episodes, or a few more, in which all agents must reach their goals for
/// [`MarlOutcome::seconds_to_80`].
const WELL: f64 = 0.8;
const LAST_EPISODES: u64 = 100;
/// The column and the curve of that share, the last of all columns.
const ALL_COMPLETED: &str = "all_completed";

/// Everything that decides how a training goes.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct TrainingSettings {
    /// Where it takes place.
    #[serde(flatten)]
    pub world: World,
    /// How they learn.
    #[serde(flatten)]
    pub algorithm: Algorithm,
}

impl TrainingSettings {
    /// A recipe: the settings as TOML. What is not told of an algorithm is its default.
    ///
    /// # Errors
    /// [`MarlError`], if the file cannot be read, is not a recipe, or has a key that nothing reads.
    pub fn read(path: &Path) -> Result<Self, MarlError> {
        let wrong = |why: String| MarlError::Recipe { path: path.to_owned(), why };
        let text = fs::read_to_string(path).map_err(MarlError::io("read", path))?;
        let told: toml::Table = toml::from_str(&text).map_err(|why| wrong(why.to_string()))?;
        let known = serde_json::to_value(Settings::default()).map_err(|why| wrong(why.to_string()))?;
        let known: Vec<_> = known.as_object().into_iter().flat_map(serde_json::Map::keys).map(String::as_str).collect();
        // Serde's own message would not suggest the right key.
        for (place, told, known) in [
            ("", Some(&told), &["intersection", "mixed", "ppo", "maddpg"][..]),
            ("intersection.", told.get("intersection").and_then(toml::Value::as_table), &known),
        ] {
            let mut keys = told.into_iter().flat_map(toml::Table::keys);
            if let Some(key) = keys.find(|key| !known.contains(&key.as_str())) {
                let meant = did_you_mean(key, known.iter().copied());
                return Err(wrong(format!("expected one of {}, got {place}{key}{meant}", known.join(", "))));
            }
        }
        let Recipe { intersection, mixed, ppo, maddpg } =
            toml::from_str(&text).map_err(|why| wrong(why.to_string()))?;
        if (intersection.axes, intersection.sight) == (Axes::Car, Sight::Routes) {
            let why = "intersection.axes: expected world beside sight = \"routes\", which is told from the car in any case, got car";
            return Err(wrong(why.into()));
        }
        let algorithm = match (ppo, maddpg) {
            (Some(ppo), None) => Algorithm::Ppo(ppo),
            (None, Some(maddpg)) => Algorithm::Maddpg(maddpg),
            (None, None) => return Err(wrong("expected a table [ppo] or [maddpg], got neither".into())),
            (Some(_), Some(_)) => return Err(wrong("expected one table, [ppo] or [maddpg], got both".into())),
        };
        Ok(Self { world: World { intersection, mixed }, algorithm })
    }
}

/// A recipe as it is written. Without a flattened table Serde knows the line of what is wrong.
#[derive(Deserialize)]
struct Recipe {
    intersection: Settings,
    #[serde(default)]
    mixed: bool,
    ppo: Option<PpoSettings>,
    maddpg: Option<MaddpgSettings>,
}

/// Holds a folder, which is made if it is not there, for one training alone.
pub(super) fn hold(out: &Path) -> Result<Option<File>, MarlError> {
    fs::create_dir_all(out).map_err(MarlError::io("create", out))?;
    files::lock(out, false).map_err(MarlError::io("train in", out))
}

/// Where a training is.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
struct Position {
    #[serde(flatten)]
    counters: Counters,
    seconds: f64,
    /// See [`MarlOutcome::seconds_to_80`].
    #[serde(default)]
    seconds_to_80: Option<f64>,
    /// How often it was resumed.
    resumed: u64,
}

/// How a training ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MarlOutcome {
    /// The policy's file.
    pub policy: PathBuf,
    /// The last update; none if there was none.
    pub last: Option<Update>,
    /// Seconds of training.
    pub seconds: f64,
    /// Whether it came to its end; otherwise it can be resumed.
    pub finished: bool,
    /// Seconds until for the first time all four agents had reached their goals in 80 % of the last hundred episodes; none if
    /// they never did.
    pub seconds_to_80: Option<f64>,
}

/// A training.
#[derive(Debug)]
pub struct Training {
    out: PathBuf,
    /// Held until the training ends.
    _lock: Option<File>,
    settings: TrainingSettings,
    learner: Box<dyn Learner>,
    position: Position,
}

impl Training {
    /// Begins one in a folder.
    ///
    /// # Errors
    /// [`MarlError`], if there is a training already, or the settings cannot be followed.
    pub fn new(out: &Path, settings: TrainingSettings) -> Result<Self, MarlError> {
        // Before there is a folder.
        let learner = settings.algorithm.clone().begin(settings.world)?;
        Self::begun(out, hold(out)?, settings, learner)
    }

    /// The same in a folder that is [held](hold).
    pub(super) fn held(out: &Path, lock: Option<File>, settings: TrainingSettings) -> Result<Self, MarlError> {
        let learner = settings.algorithm.clone().begin(settings.world)?;
        Self::begun(out, lock, settings, learner)
    }

    fn begun(
        out: &Path,
        lock: Option<File>,
        settings: TrainingSettings,
        learner: Box<dyn Learner>,
    ) -> Result<Self, MarlError> {
        if out.join(STATE).exists() {
            let why = "expected a new folder, got one with a training; add --resume to go on with it";
            return Err(MarlError::File { path: out.to_owned(), why: why.into() });
        }
        Ok(Self { out: out.to_owned(), _lock: lock, settings, learner, position: Position::default() })
    }

    /// Goes on with the one in a folder, with its settings; more `agent_steps` make it longer, and stretch what changes in
    /// its course, such as the learning rate. It has new episodes: its weights and the optimiser's state are kept, what
    /// was on the road is not, so it is not the same as one in a go.
    ///
    /// # Errors
    /// [`MarlError`], if there is none, or one that is longer than `agent_steps`.
    pub fn resume(out: &Path, agent_steps: Option<u64>) -> Result<Self, MarlError> {
        let lock = files::lock(out, false).map_err(MarlError::io("train in", out))?;
        let (path, state) = (out.join(SETTINGS), out.join(STATE));
        if !state.exists() {
            let why = match path.exists() {
                true => {
                    "expected a training to resume, got one that had saved nothing yet: start it again without --resume"
                }
                false => "expected a training to resume, got none",
            };
            return Err(MarlError::File { path: out.to_owned(), why: why.into() });
        }
        let text = fs::read_to_string(&path).map_err(MarlError::io("read", &path))?;
        let mut settings: TrainingSettings =
            serde_json::from_str(&text).map_err(|why| MarlError::File { path, why: why.to_string() })?;
        if let Some(told) = agent_steps {
            let stored = settings.algorithm.agent_steps();
            if told < *stored {
                let expected = "at least as many as the training in that folder has";
                return Err(MarlError::Setting {
                    name: "agent_steps",
                    expected,
                    got: format!("{told}, and the training has {stored}"),
                });
            }
            *stored = told;
        }
        let stored = file::Read::open(&state, "the resume state of lapwing marl train")?;
        let mut position: Position = stored.json(POSITION)?;
        position.resumed += 1;
        let mut algorithm = settings.algorithm.clone();
        let seed = algorithm.seed();
        *seed = seed.wrapping_add(position.resumed << 32);
        let mut learner = algorithm.begin(settings.world)?;
        stored.copy_to(&learner.tensors())?;
        learner.go_on_at(position.counters);
        Ok(Self { out: out.to_owned(), _lock: lock, settings, learner, position })
    }

    /// The settings that are followed.
    pub fn settings(&self) -> &TrainingSettings {
        &self.settings
    }

    /// Trains to the end, or until it `is_stopped`, which is asked after each update and, where one may take long, within
    /// it. `told` is shown each update with the agent-steps a second that it took, and the share of the training that is
    /// done. `wall` is the wall clock in seconds since 1970.
    ///
    /// # Errors
    /// [`MarlError`]; the last state that was saved stays.
    pub fn run(
        &mut self,
        wall: impl Fn() -> f64,
        is_stopped: impl Fn() -> bool,
        mut told: impl FnMut(&Update, f64, f64),
    ) -> Result<MarlOutcome, MarlError> {
        let json = |why: serde_json::Error| MarlError::File { path: self.out.join(SETTINGS), why: why.to_string() };
        let text = serde_json::to_string_pretty(&self.settings).map_err(json)?;
        let path = self.out.join(SETTINGS);
        files::write(&path, text.as_bytes()).map_err(MarlError::io("write", &path))?;
        self.cut_log()?;
        let named = self.out.join(EVENTS);
        let from = step_of(self.position.counters.agent_steps.saturating_add(1));
        let mut events = Events::create(&self.out, wall(), from).map_err(MarlError::io("write", &named))?;
        let (mut last, mut saved) = (None, Instant::now());
        let mut recent = Recent::default();
        let mut finished = self.learner.progress() >= 1.0;
        while !finished {
            let (began, before) = (Instant::now(), self.learner.counters().agent_steps);
            let update = self.learner.update(&is_stopped)?;
            let seconds = began.elapsed().as_secs_f64();
            self.position.seconds += seconds;
            let pace = (update.agent_steps - before) as f64 / seconds.max(1e-9);
            let share = recent.share_after(&update);
            self.log(&update, pace, share)?;
            curves(&mut events, &update, pace, share, wall()).map_err(MarlError::io("write", &named))?;
            if share.is_some_and(|share| share >= WELL) {
                self.position.seconds_to_80 = self.position.seconds_to_80.or(Some(self.position.seconds));
            }
            told(&update, pace, self.learner.progress());
            let stop = is_stopped();
            last = Some(update);
            finished = self.learner.progress() >= 1.0;
            if finished || stop || saved.elapsed().as_secs_f64() > SAVE_EVERY_S {
                self.save()?;
                events.flush().map_err(MarlError::io("write", &named))?;
                saved = Instant::now();
            }
            if stop {
                break;
            }
        }
        let policy = self.out.join(POLICY);
        let Position { seconds, seconds_to_80, .. } = self.position;
        Ok(MarlOutcome { policy, last, seconds, finished, seconds_to_80 })
    }

    fn save(&mut self) -> Result<(), MarlError> {
        let (path, policy) = (self.out.join(STATE), self.out.join(POLICY));
        self.position.counters = self.learner.counters();
        let json = |why: serde_json::Error| MarlError::File { path: path.clone(), why: why.to_string() };
        let position = serde_json::to_string(&self.position).map_err(json)?;
        let (actor, algorithm) = (self.learner.actor(), &self.settings.algorithm);
        let metadata = PolicyMetadata {
            format: FORMAT.into(),
            algorithm: algorithm.name().into(),
            hidden: algorithm.hidden(),
            activation: actor.activation(),
            settings: self.settings.world.intersection,
            agent_steps: self.position.counters.agent_steps,
            training: serde_json::to_value(&self.settings).map_err(json)?,
        };
        Policy::save(&policy, actor, &metadata)?;
        file::save(&path, HashMap::from([(POSITION.to_owned(), position)]), &self.learner.tensors())
    }

    /// Leaves in the log what led to the stored state: a training that was killed has logged more than it saved. An older
    /// log gets the column [`ALL_COMPLETED`], without values.
    fn cut_log(&self) -> Result<(), MarlError> {
        let path = self.out.join(LOG);
        if !path.exists() {
            return Ok(());
        }
        let stored = self.position.counters.updates;
        let is_kept = |line: &&str| {
            let number = line.split(',').next().and_then(|number| number.parse::<u64>().ok());
            line.ends_with('\n') && number.map_or(stored > 0, |number| number <= stored)
        };
        let text = fs::read_to_string(&path).map_err(MarlError::io("read", &path))?;
        let mut kept: String = text.split_inclusive('\n').filter(is_kept).collect();
        if kept.lines().next().is_some_and(|names| !names.ends_with(ALL_COMPLETED)) {
            kept = kept.replace('\n', ",\n").replacen(",\n", &format!(",{ALL_COMPLETED}\n"), 1);
        }
        files::write(&path, kept.as_bytes()).map_err(MarlError::io("write", &path))
    }

    /// Adds a line to the log.
    fn log(&self, update: &Update, pace: f64, share: Option<f64>) -> Result<(), MarlError> {
        let path = self.out.join(LOG);
        let mut text = String::new();
        if update.number == 1 || !path.exists() {
            let names: Vec<_> = columns(update, share).map(|(name, _)| name).collect();
            text = format!("update,agent_steps,seconds,agent_steps_per_s,{}\n", names.join(","));
        }
        let Position { seconds, .. } = self.position;
        let _ = write!(text, "{},{},{seconds:.2},{pace:.0}", update.number, update.agent_steps);
        for (_, value) in columns(update, share) {
            text += &value.map_or_else(|| ",".to_owned(), |value| format!(",{value:.6}"));
        }
        text.push('\n');
        let file = OpenOptions::new().create(true).append(true).open(&path);
        file.and_then(|mut file| file.write_all(text.as_bytes())).map_err(MarlError::io("write", &path))
    }
}

/// The episodes that ended last: of each update, how many, and in how many of them all reached their goals.
#[derive(Debug, Default)]
struct Recent(VecDeque<(u64, f64)>);

impl Recent {
    /// The share of them in which all did, once there are [`LAST_EPISODES`].
    fn share_after(&mut self, update: &Update) -> Option<f64> {
        self.0.push_back((update.episodes, update.all_completed * update.episodes as f64));
        let ended = |updates: &VecDeque<(u64, f64)>| updates.iter().map(|(episodes, _)| episodes).sum::<u64>();
        while self.0.front().is_some_and(|(first, _)| ended(&self.0) - first >= LAST_EPISODES) {
            self.0.pop_front();
        }
        let episodes = ended(&self.0);
        (episodes >= LAST_EPISODES)
            .then(|| self.0.iter().map(|(_, completed)| completed).sum::<f64>() / episodes as f64)
    }
}

/// The curves of an update, and the share of the last hundred episodes in which all reached their goals; where no episode
/// ended, nothing is known of them.
fn columns(update: &Update, share: Option<f64>) -> impl Iterator<Item = (&'static str, Option<f64>)> {
    let of_episodes = |value: f64| (update.episodes > 0).then_some(value);
    let charts = [
        ("gradient_steps", Some(update.gradient_steps as f64)),
        ("episodes", Some(update.episodes as f64)),
        ("collision_rate", of_episodes(update.collision_rate)),
        ("completion_rate", of_episodes(update.completion_rate)),
        ("reward", of_episodes(update.reward)),
        ("duration_s", of_episodes(update.seconds)),
        ("learning_rate", Some(update.learning_rate)),
    ];
    let losses = update.losses.iter().map(|(name, value)| (*name, Some(*value)));
    charts.into_iter().chain(losses).chain([(ALL_COMPLETED, share)])
}

/// A point's position along a curve.
fn step_of(agent_steps: u64) -> i64 {
    i64::try_from(agent_steps).unwrap_or(i64::MAX)
}

fn curves(events: &mut Events, update: &Update, pace: f64, share: Option<f64>, wall: f64) -> std::io::Result<()> {
    let step = step_of(update.agent_steps);
    for (name, value) in columns(update, share).chain([("agent_steps_per_s", Some(pace))]) {
        let Some(value) = value else { continue };
        let group = if update.losses.contains_key(name) { "losses" } else { "charts" };
        events.scalar(&format!("{group}/{name}"), step, wall, value as f32)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    fn update(episodes: u64, all_completed: f64) -> Update {
        Update {
            number: 2,
            agent_steps: 0,
            gradient_steps: 0,
            episodes,
            collision_rate: 0.0,
            completion_rate: 1.0,
            all_completed,
            reward: 0.0,
            seconds: 0.0,
            learning_rate: 0.0,
            losses: BTreeMap::new(),
        }
    }

    #[test]
    fn a_share_of_the_last_hundred_episodes_takes_a_hundred_and_forgets_those_before() {
        let mut recent = Recent::default();
        assert_eq!(recent.share_after(&update(99, 1.0)), None, "a few that ended well say little");
        assert_eq!(recent.share_after(&update(0, 0.0)), None);
        assert_eq!(recent.share_after(&update(51, 0.0)), Some(0.66));
        assert_eq!(
            recent.share_after(&update(49, 1.0)),
            Some(0.49),
            "the first 99 are no longer among the last hundred"
        );
    }

    #[test]
    fn of_episodes_that_did_not_end_nothing_is_logged() {
        let names = |update: &Update| columns(update, Some(0.5)).filter(|(_, value)| value.is_none()).count();
        assert_eq!((names(&update(0, 0.0)), names(&update(1, 0.0))), (4, 0));
    }
}
