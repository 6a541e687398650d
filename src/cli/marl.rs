//! The verbs around many agents at an intersection.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

use super::examples;
#[cfg(feature = "networks")]
use super::parse::{above_zero, count, not_negative};
use lapwing_sim::intersection::{CARS, Missions, Settings};

/// `lapwing marl`
#[derive(Debug, Args)]
pub struct Marl {
    #[command(subcommand)]
    pub verb: MarlVerb,
}

/// What to do with the agents.
#[derive(Debug, Subcommand)]
pub enum MarlVerb {
    /// Let the agents learn to drive
    #[cfg(feature = "networks")]
    #[command(after_help = examples::MARL_TRAIN)]
    Train(MarlTrain),
    /// Compare PPO and MADDPG, with several seeds, and say which claims about them hold
    #[cfg(feature = "networks")]
    #[command(after_help = examples::MARL_STUDY)]
    Study(MarlStudy),
    /// Watch an episode from above, in the terminal or as a film
    #[command(after_help = examples::MARL_WATCH)]
    Watch(MarlWatch),
    /// Measure collision and completion rates and the reward (SMARTS') over held-out episodes
    #[command(after_help = examples::MARL_EVALUATE)]
    Evaluate(MarlEvaluate),
}

/// Which intersection; shared by all its verbs.
#[derive(Debug, Clone, Copy, Args)]
pub struct IntersectionFlags {
    /// Where the agents begin and go
    #[arg(long, value_enum, default_value_t)]
    pub missions: MissionsKind,
    /// Background cars at a time, at most 12
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=CARS as i64))]
    pub cars: u8,
}

impl IntersectionFlags {
    /// The settings that they mean; what concerns learning is as in others.
    pub fn settings(self, learning: Settings) -> Settings {
        let missions = match self.missions {
            MissionsKind::Benchmark => Missions::Benchmark,
            MissionsKind::Random => Missions::Random,
        };
        Settings { missions, cars: usize::from(self.cars), ..learning }
    }
}

/// Where the agents begin and go.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum MissionsKind {
    /// The four of SMARTS' benchmark, the same in each episode
    #[default]
    Benchmark,
    /// New ones in each episode, one from each arm
    Random,
}

/// Who drives the agents; shared by the verbs in which they do not learn.
#[derive(Debug, Args)]
pub struct DriverFlags {
    /// Who drives
    #[arg(long, value_enum, default_value_t)]
    pub driver: DriverKind,
    /// Let a policy drive, as lapwing marl train writes it: policy.safetensors
    #[cfg(feature = "networks")]
    #[arg(long, value_name = "FILE", conflicts_with = "driver")]
    pub policy: Option<PathBuf>,
}

/// Who drives the agents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum DriverKind {
    /// A script that sees everything and knows the rules
    #[default]
    Scripted,
    /// Straight on at 15 m/s, whatever happens
    KeepLane,
    /// Brake to a standstill
    Idle,
}

/// `lapwing marl watch`
#[derive(Debug, Args)]
pub struct MarlWatch {
    #[command(flatten)]
    pub intersection: IntersectionFlags,
    /// Which episode
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub drivers: DriverFlags,
    /// Write a film instead: FILE.mp4, FILE.gif, FILE.png or FILE.jpg (numbered pictures:
    /// FILE_00001.png), or a folder for such pictures
    #[arg(long, value_name = "FILE")]
    pub video: Option<PathBuf>,
}

/// `lapwing marl evaluate`
#[derive(Debug, Args)]
pub struct MarlEvaluate {
    #[command(flatten)]
    pub intersection: IntersectionFlags,
    /// Number of episodes
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub episodes: u64,
    /// Random seed: another one gives other held-out episodes
    #[arg(long, default_value_t = 0)]
    pub seed: u32,
    #[command(flatten)]
    pub drivers: DriverFlags,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing marl train`
#[cfg(feature = "networks")]
#[derive(Debug, Args)]
pub struct MarlTrain {
    #[command(flatten)]
    pub intersection: IntersectionFlags,
    /// Folder for the policy, its log and its resume state
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Resume the training in that folder, with its settings; only --agent-steps can be raised
    #[arg(long, conflicts_with_all = ["missions", "cars", "algorithm", "mixed", "reward", "axes", "observation", "critic", "intersections", "hidden", "learning_rate", "actor_rate", "entropy", "entropy_end", "gamma", "gamma_end", "batch", "replay", "every", "memory", "learners", "collectors", "recipe", "seed"])]
    pub resume: bool,
    /// Follow a recipe, such as models/intersection-ppo.toml, in place of all other flags but --seed
    #[arg(long, value_name = "FILE", conflicts_with_all = ["missions", "cars", "algorithm", "mixed", "reward", "axes", "observation", "critic", "agent_steps", "intersections", "hidden", "learning_rate", "actor_rate", "entropy", "entropy_end", "gamma", "gamma_end", "batch", "replay", "every", "memory", "learners", "collectors"])]
    pub recipe: Option<PathBuf>,
    /// How the agents learn
    #[arg(long, value_enum, default_value_t)]
    pub algorithm: AlgorithmKind,
    /// Half of the intersections have the benchmark's missions, the others random ones; half have no traffic
    #[arg(long, conflicts_with = "missions")]
    pub mixed: bool,
    /// What is rewarded
    #[arg(long, value_enum, default_value_t)]
    pub reward: RewardKind,
    /// The axes on which the agents see
    #[arg(long, value_enum, default_value_t)]
    pub axes: AxesKind,
    /// What the agents see
    #[arg(long, value_enum, default_value_t)]
    pub observation: ObservationKind,
    /// What PPO's critic sees: its agent's view, or the whole situation, too (MAPPO) [default: own]
    #[arg(long, value_enum)]
    pub critic: Option<CriticKind>,
    /// Agent-steps to learn from [default: 3000000, or those of the resumed training]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub agent_steps: Option<u64>,
    /// Intersections side by side [default: 64, MADDPG 16]
    #[arg(long, value_name = "N")]
    pub intersections: Option<usize>,
    /// Units in each of the two hidden layers [default: 64]
    #[arg(long, value_name = "N")]
    pub hidden: Option<usize>,
    /// Learning rate of PPO at the start, and of MADDPG's critic [default: 0.001]
    #[arg(long, value_parser = above_zero)]
    pub learning_rate: Option<f64>,
    /// Learning rate of MADDPG's actor [default: 0.001]
    #[arg(long, value_parser = above_zero)]
    pub actor_rate: Option<f64>,
    /// PPO's entropy weight at the start [default: 0.01]
    #[arg(long, value_parser = not_negative)]
    pub entropy: Option<f64>,
    /// PPO's entropy weight at the end of the training [default: as at the start]
    #[arg(long, value_parser = not_negative)]
    pub entropy_end: Option<f64>,
    /// Discount per step [default: 0.99, MADDPG 0.95]
    #[arg(long, value_parser = not_negative)]
    pub gamma: Option<f64>,
    /// PPO's discount at the end of the training [default: as at the start]
    #[arg(long, value_parser = not_negative)]
    pub gamma_end: Option<f64>,
    /// Agent-steps in PPO's minibatches, joint transitions in MADDPG's batches [default: 1024]
    #[arg(long, value_name = "N")]
    pub batch: Option<usize>,
    /// How MADDPG draws from its memory [default: uniform]
    #[arg(long, value_enum)]
    pub replay: Option<ReplayKind>,
    /// Joint transitions that MADDPG collects for each gradient step [default: 100]
    #[arg(long, value_name = "N", value_parser = above_zero)]
    pub every: Option<f64>,
    /// Joint transitions that MADDPG remembers [default: 1000000]
    #[arg(long, value_name = "N")]
    pub memory: Option<usize>,
    /// MADDPG's learner threads beside a collector thread; 0: one thread does both in turn, with the same result each time
    /// [default: 0]
    #[arg(long, value_name = "N")]
    pub learners: Option<u16>,
    /// PPO's collector threads, which share the intersections, 32 to a thread or more; the policy is the same with any number
    /// [default: 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64))]
    pub collectors: Option<u16>,
    /// Random seed [default: 0, or the recipe's]
    #[arg(long)]
    pub seed: Option<u64>,
    /// Threads of libtorch; another number changes the last bits of the policy
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: u16,
    /// Print the outcome as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing marl study`
#[cfg(feature = "networks")]
#[derive(Debug, Args)]
pub struct MarlStudy {
    /// Folder for the trainings, study.json, study.csv, the curves and study.html; what is already done there is kept
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Number of random seeds for each training
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=100))]
    pub seeds: u64,
    /// Agent-steps of each training
    #[arg(long, value_name = "N", default_value_t = 1_500_000, value_parser = clap::value_parser!(u64).range(1..))]
    pub agent_steps: u64,
    /// Held-out episodes on which each policy is measured
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(10..=1_000_000))]
    pub episodes: u64,
    /// Joint transitions that MADDPG collects for each gradient step
    #[arg(long, value_name = "N", default_value_t = 100.0, value_parser = above_zero)]
    pub every: f64,
    /// What to train on: a reward, and how much traffic; half of the intersections never have any [default: all four]
    #[arg(long, value_enum, value_delimiter = ',')]
    pub tasks: Vec<TaskKind>,
    /// Stop after this many more trainings; the same command continues later
    #[arg(long, value_name = "N", value_parser = count)]
    pub most: Option<u32>,
    /// Trainings side by side, each on one core; if cores are short, the seconds in the table are too many
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=256))]
    pub jobs: u16,
    /// Run this training alone, named as its folder in cells/, and leave the table as it is
    #[arg(long, value_name = "CELL", conflicts_with_all = ["most", "jobs", "json"])]
    pub only: Option<String>,
    /// End it as Ctrl-C does once standard input ends: how a study holds the trainings beside one another
    #[arg(long, hide = true, requires = "only")]
    pub held: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// A reward, and an amount of traffic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum TaskKind {
    /// SMARTS' reward, no traffic
    Smarts,
    /// The corrected reward, no traffic
    Corrected,
    /// SMARTS' reward, 12 background cars
    SmartsTraffic,
    /// The corrected reward, 12 background cars
    CorrectedTraffic,
}

/// How agents learn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum AlgorithmKind {
    /// Proximal policy optimisation, on policy
    #[default]
    Ppo,
    /// Multi-agent deep deterministic policy gradient, from a replay memory
    Maddpg,
}

/// How rows are drawn from a replay memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum ReplayKind {
    /// All equally often
    #[default]
    Uniform,
    /// In proportion to their errors
    Proportional,
    /// By the rank of their errors
    Rank,
}

/// What is rewarded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum RewardKind {
    /// As SMARTS' benchmark does, which pays for standing still
    Smarts,
    /// The goal, the way there, crashes, and time
    #[default]
    Corrected,
}

/// The axes on which the agents see.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum AxesKind {
    /// East and north, as SMARTS' benchmark has them
    #[default]
    World,
    /// To the car's right and ahead of it
    Car,
}

/// What the agents see.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum ObservationKind {
    /// As in SMARTS' benchmark: the nearest car in each of eight sectors, three frames
    #[default]
    Sectors,
    /// The cars in its lanes, and those whose paths conflict with its own
    Routes,
}

/// What the critic sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum CriticKind {
    /// What its agent sees
    #[default]
    Own,
    /// The whole situation, too
    Central,
}
