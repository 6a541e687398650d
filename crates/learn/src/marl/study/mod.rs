//! The study: what Biswas and Biswas say of MADDPG and PPO at this intersection, with several seeds, and judged by what
//! counts.
//!
//! Agents see the routes of those around them ([`Sight::Routes`]), and half of the intersections have random missions: on the
//! benchmark's missions alone, which are the same in each episode, PPO got no further than half of the goals in two million
//! agent-steps; with the benchmark's sectors MADDPG takes several times as many gradient steps until it drives at all.
//!
//! A [`Cell`] is one training: a variant of an algorithm, a reward, an amount of traffic, a seed. All are as long in
//! agent-steps, and all policies are judged in the same held-out episodes. What they come to is in [`findings`].
//!
//! A study's folder holds `cells/NAME/`, each with the training's own files and `cell.json`. A cell that has one is done and
//! is not trained again; one that was interrupted begins anew.

pub mod findings;

use std::{
    fs, io,
    path::{Path, PathBuf},
    time::Instant,
};

use serde::{Deserialize, Serialize};

use super::{
    Algorithm, MaddpgSettings, MarlError, Policy, PpoSettings, Training, World,
    priorities::Replay,
    training::{self, TrainingSettings},
};
use lapwing_core::files;
use lapwing_sim::intersection::{
    CARS, Missions, Reward, Settings, Sight,
    evaluation::{Evaluation, HELD_OUT, evaluate},
};

/// A cell's result, in its folder.
const RESULT: &str = "cell.json";
/// Episodes that are driven side by side.
const AT_ONCE: usize = 64;
/// The few episodes with which policies are often judged, SMARTS' own among them.
pub const FEW: u64 = 10;

/// How many trainings, and how long.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StudySettings {
    /// Random seeds of each.
    pub seeds: u64,
    /// Agent-steps of each.
    pub agent_steps: u64,
    /// Held-out episodes in which each policy is judged.
    pub episodes: u64,
    /// Joint transitions for each gradient step of MADDPG.
    pub every: f64,
}

impl Default for StudySettings {
    fn default() -> Self {
        Self { seeds: 5, agent_steps: 1_500_000, episodes: 1000, every: 100.0 }
    }
}

impl StudySettings {
    /// What differs from those of a cell that is done, if anything: its number of seeds does not matter to it.
    fn differ_from(&self, done: &Self) -> Option<String> {
        let settings = [
            ("--agent-steps", self.agent_steps.to_string(), done.agent_steps.to_string()),
            ("--episodes", self.episodes.to_string(), done.episodes.to_string()),
            ("--every", self.every.to_string(), done.every.to_string()),
        ];
        let differ = settings.iter().filter(|(_, expected, got)| expected != got);
        let each: Vec<_> = differ.map(|(flag, expected, got)| format!("{flag} {expected}, got {got}")).collect();
        let each = each.join("; ");
        (!each.is_empty()).then(|| format!("expected a training with {each}: use the same flags, or another --out"))
    }
}

/// An algorithm as it is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Variant {
    /// PPO.
    Ppo,
    /// MADDPG with batches of 1024 and uniform replay.
    Maddpg,
    /// The same with proportional priorities.
    Proportional,
    /// The same with priorities by rank.
    Rank,
    /// Batches of 64, as many gradient steps.
    #[serde(rename = "batch-64", alias = "batch64")]
    Batch64,
    /// Batches of 64, as many samples: 16 times the gradient steps.
    #[serde(rename = "batch-64-samples", alias = "batch64-samples")]
    Batch64Samples,
    /// Batches of 1024, one collector thread and two learner threads.
    Asynchronous,
}

impl Variant {
    /// All, in the order of the table.
    pub const ALL: [Self; 7] = [
        Self::Ppo,
        Self::Maddpg,
        Self::Proportional,
        Self::Rank,
        Self::Batch64,
        Self::Batch64Samples,
        Self::Asynchronous,
    ];

    /// Its name in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ppo => "ppo",
            Self::Maddpg => "maddpg",
            Self::Proportional => "proportional",
            Self::Rank => "rank",
            Self::Batch64 => "batch-64",
            Self::Batch64Samples => "batch-64-samples",
            Self::Asynchronous => "asynchronous",
        }
    }

    fn algorithm(self, study: &StudySettings, seed: u64) -> Algorithm {
        let StudySettings { agent_steps, every, .. } = *study;
        let usual = MaddpgSettings { agent_steps, every, seed, ..MaddpgSettings::default() };
        Algorithm::Maddpg(match self {
            Self::Ppo => return Algorithm::Ppo(PpoSettings { agent_steps, seed, ..PpoSettings::default() }),
            Self::Maddpg => usual,
            Self::Proportional => MaddpgSettings { replay: Replay::Proportional, ..usual },
            Self::Rank => MaddpgSettings { replay: Replay::Rank, ..usual },
            Self::Batch64 => MaddpgSettings { batch: 64, ..usual },
            Self::Batch64Samples => MaddpgSettings { batch: 64, every: every * 64.0 / 1024.0, ..usual },
            Self::Asynchronous => MaddpgSettings { learners: 2, ..usual },
        })
    }
}

/// One training of the study.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// The algorithm.
    pub variant: Variant,
    /// What is rewarded.
    pub reward: Reward,
    /// Background cars at a time.
    pub cars: usize,
    /// Random seed.
    pub seed: u64,
}

/// A point of a learning curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Agent-steps so far.
    pub agent_steps: u64,
    /// Seconds so far.
    pub seconds: f64,
    /// Mean undiscounted sum of rewards of the episodes since the last point.
    pub reward: f64,
    /// Share of their agents that reached their goals.
    pub completion: f64,
}

/// What a cell came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellResult {
    /// Which.
    pub cell: Cell,
    /// What it was a part of.
    pub study: StudySettings,
    /// Agent-steps.
    pub agent_steps: u64,
    /// Gradient steps.
    pub gradient_steps: u64,
    /// Seconds of training.
    pub seconds: f64,
    /// Seconds until all four agents first reached their goals in 80 % of the last hundred episodes.
    pub seconds_to_80: Option<f64>,
    /// While it learnt.
    pub curve: Vec<Point>,
    /// Without traffic, over [`FEW`] episodes and over many, on the benchmark's missions.
    pub without: [Evaluation; 2],
    /// With traffic, likewise.
    pub with: [Evaluation; 2],
    /// Over many episodes with random missions, with as much traffic as it learnt in: by this it is compared. Without traffic the
    /// benchmark's episodes are all alike, and so is what a policy does in them.
    pub random: Evaluation,
}

/// What is learnt: a reward, and an amount of traffic.
pub const TASKS: [(Reward, usize); 4] =
    [(Reward::Smarts, 0), (Reward::Corrected, 0), (Reward::Smarts, CARS), (Reward::Corrected, CARS)];

/// All cells of some tasks, those of the first seed first, so that a study that is stopped is balanced. A task that is
/// named twice counts once: the same run would be taken for another seed's.
pub fn plan(study: &StudySettings, tasks: &[(Reward, usize)]) -> Vec<Cell> {
    let once = tasks.iter().enumerate().filter(|(i, task)| !tasks[..*i].contains(task));
    let once: Vec<_> = once.map(|(_, task)| *task).collect();
    let mut cells = Vec::new();
    for seed in 0..study.seeds {
        for &(reward, cars) in &once {
            cells.extend(Variant::ALL.map(|variant| Cell { variant, reward, cars, seed }));
        }
    }
    cells
}

impl Cell {
    /// Its folder's name.
    pub fn name(&self) -> String {
        let reward = if self.reward == Reward::Smarts { "smarts" } else { "corrected" };
        format!("{}-{reward}-{}-{}", self.variant.name(), self.cars, self.seed)
    }

    fn result_in(&self, out: &Path) -> PathBuf {
        out.join("cells").join(self.name()).join(RESULT)
    }

    /// Whether it is done.
    pub fn is_done(&self, out: &Path) -> bool {
        self.result_in(out).exists()
    }

    /// What it came to, if it is done.
    ///
    /// # Errors
    /// [`MarlError`], if its result cannot be read, or if it was done with other settings.
    pub fn done(&self, study: &StudySettings, out: &Path) -> Result<Option<CellResult>, MarlError> {
        let path = self.result_in(out);
        if !path.exists() {
            return Ok(None);
        }
        let wrong = |why: String| MarlError::File { path: path.clone(), why };
        let text = fs::read_to_string(&path).map_err(MarlError::io("read", &path))?;
        let done: CellResult = serde_json::from_str(&text).map_err(|why| wrong(why.to_string()))?;
        match study.differ_from(&done.study) {
            None => Ok(Some(done)),
            Some(why) => Err(wrong(why)),
        }
    }

    /// Trains and judges it in its folder, if that is not done. None if it `is_stopped`, which is asked within updates,
    /// too; `told` is shown the share that is done after each.
    ///
    /// # Errors
    /// [`MarlError`], also for a cell that was done with other settings, or that another process is training.
    pub fn run(
        &self,
        study: &StudySettings,
        out: &Path,
        wall: impl Fn() -> f64,
        is_stopped: impl Fn() -> bool,
        mut told: impl FnMut(f64),
    ) -> Result<Option<CellResult>, MarlError> {
        let folder = out.join("cells").join(self.name());
        let path = folder.join(RESULT);
        let wrong = |why: String| MarlError::File { path: path.clone(), why };
        if let Some(done) = self.done(study, out)? {
            return Ok(Some(done));
        }
        // Held until the result is written, so that whoever comes next finds it.
        let lock = training::hold(&folder)?;
        if let Some(done) = self.done(study, out)? {
            return Ok(Some(done));
        }
        empty(&folder).map_err(MarlError::io("empty", &folder))?;
        let (reward, cars) = (self.reward, self.cars);
        let intersection = Settings { reward, cars, sight: Sight::Routes, ..Settings::default() };
        let algorithm = self.variant.algorithm(study, self.seed);
        let settings = TrainingSettings { world: World { intersection, mixed: true }, algorithm };
        let (mut curve, began) = (Vec::new(), Instant::now());
        let mut training = Training::held(&folder, lock, settings)?;
        let outcome = training.run(wall, is_stopped, |update, _, done| {
            if update.episodes > 0 {
                curve.push(Point {
                    agent_steps: update.agent_steps,
                    seconds: began.elapsed().as_secs_f64(),
                    reward: update.reward,
                    completion: update.completion_rate,
                });
            }
            told(done);
        })?;
        let (Some(last), true) = (outcome.last, outcome.finished) else { return Ok(None) };
        let mut policy = Policy::load(&outcome.policy)?;
        let mut judge = |missions, cars, episodes| {
            let settings = Settings { missions, cars, ..intersection };
            evaluate(settings, HELD_OUT..HELD_OUT + episodes, AT_ONCE, |a: &[_], b: &mut [_]| policy.act(a, b))
        };
        let result = CellResult {
            cell: *self,
            study: *study,
            agent_steps: last.agent_steps,
            gradient_steps: last.gradient_steps,
            seconds: outcome.seconds,
            seconds_to_80: outcome.seconds_to_80,
            curve,
            without: [judge(Missions::Benchmark, 0, FEW)?, judge(Missions::Benchmark, 0, study.episodes)?],
            with: [judge(Missions::Benchmark, CARS, FEW)?, judge(Missions::Benchmark, CARS, study.episodes)?],
            random: judge(Missions::Random, cars, study.episodes)?,
        };
        let text = serde_json::to_string(&result).map_err(|why| wrong(why.to_string()))?;
        files::write(&path, text.as_bytes()).map_err(MarlError::io("write", &path))?;
        Ok(Some(result))
    }
}

/// Removes what an interrupted training left.
fn empty(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variants_have_the_same_name_in_json_as_in_tables() {
        for variant in Variant::ALL {
            assert_eq!(serde_json::to_value(variant).unwrap(), variant.name());
        }
        let before: [Variant; 2] = serde_json::from_str(r#"["batch64", "batch64-samples"]"#).unwrap();
        assert_eq!(before, [Variant::Batch64, Variant::Batch64Samples], "as earlier versions wrote it");
    }

    #[test]
    fn a_cell_is_trained_by_one_process_at_a_time_and_what_was_left_there_is_gone() {
        crate::nn::runtime::set_threads(1);
        let folder = tempfile::tempdir().unwrap();
        let study = StudySettings { seeds: 1, agent_steps: 2000, episodes: 2, every: 100.0 };
        let cell = Cell { variant: Variant::Ppo, reward: Reward::Corrected, cars: 0, seed: 0 };
        let own = folder.path().join("cells").join(cell.name());
        let held = training::hold(&own).unwrap();
        fs::write(own.join("log.csv"), "left\n").unwrap();
        let run = || cell.run(&study, folder.path(), || 0.0, || false, |_| ());
        assert!(run().unwrap_err().to_string().contains("another lapwing is writing into this folder"));
        assert_eq!(fs::read_to_string(own.join("log.csv")).unwrap(), "left\n");
        drop(held);
        assert!(run().unwrap().is_some());
        assert!(fs::read_to_string(own.join("log.csv")).unwrap().starts_with("update,"));
    }

    #[test]
    fn a_cell_that_is_done_is_kept_and_one_of_another_study_is_refused() {
        crate::nn::runtime::set_threads(1);
        let folder = tempfile::tempdir().unwrap();
        let study = StudySettings { seeds: 1, agent_steps: 2000, episodes: 2, every: 100.0 };
        let cell = Cell { variant: Variant::Ppo, reward: Reward::Corrected, cars: 0, seed: 0 };
        let all = plan(&study, &TASKS);
        assert!(all.contains(&cell) && all.len() == 28);
        let mut updates = 0;
        let mut run = |study: &StudySettings| cell.run(study, folder.path(), || 0.0, || false, |_| updates += 1);
        let first = run(&study).unwrap().unwrap();
        let second = run(&StudySettings { seeds: 3, ..study }).unwrap().unwrap();
        assert_eq!((first.agent_steps, first.random), (second.agent_steps, second.random));
        let other = run(&StudySettings { agent_steps: 3000, ..study }).unwrap_err().to_string();
        let expected = ": expected a training with --agent-steps 3000, got 2000: use the same flags, or another --out";
        assert!(other.ends_with(expected), "{other}");
        let other = run(&StudySettings { episodes: 5, every: 2.5, ..study }).unwrap_err().to_string();
        assert!(other.contains("with --episodes 5, got 2; --every 2.5, got 100: "), "{other}");
        assert_eq!(updates, 1);
    }

    #[test]
    fn a_task_that_is_named_twice_is_planned_once() {
        let study = StudySettings { seeds: 2, ..StudySettings::default() };
        let cells = plan(&study, &[TASKS[1], TASKS[0], TASKS[1], TASKS[1]]);
        assert_eq!(cells, plan(&study, &[TASKS[1], TASKS[0]]));
        assert_eq!(cells.len(), 28);
    }
}
