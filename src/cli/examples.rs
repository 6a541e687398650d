//! Examples behind the help of each verb. Tests parse them all, and look for the files of this repository that they name.

pub(super) const LAPWING: &str = "\
Examples:
  lapwing drive --track lake --speed 20   # a lap in the headless simulator
  lapwing serve                           # drive the Unity simulator
  lapwing score recordings/lake.mcap      # how good was this run?

lapwing VERB --help shows a verb's flags and examples. The documentation: docs/README.md";

#[cfg(feature = "simulator")]
pub(super) const DRIVE: &str = "\
Examples:
  lapwing drive                                           # the shipped model, one lap, at 9 mph
  lapwing drive --track jungle --laps 3 --speed 15 --model models/cps.safetensors
  lapwing drive --track random:7 --conditions rain=0.5,haze=0.3 --seed 4
  lapwing drive --pilot expert --video lap.mp4 --map lap.svg
  lapwing drive --min-completion 100 --max-collisions 0   # exit status 3 below a threshold";

#[cfg(feature = "bridge")]
pub(super) const SERVE: &str = "\
Examples:
  lapwing serve                    # then start the simulator in Autonomous Mode
  lapwing serve --speed 20 --model models/cps.safetensors
  lapwing serve --takeover latch   # stay off after a takeover until you press Enter
  lapwing serve --bind 0.0.0.0     # other machines may connect; the page then wants its token";

#[cfg(feature = "simulator")]
pub(super) const SIMULATE: &str = "\
Examples:
  lapwing simulate --connect 127.0.0.1:4567   # test your own bridge or drive.py
  lapwing simulate --connect 127.0.0.1:4567 --track jungle --seed 3";

#[cfg(feature = "simulator")]
pub(super) const RECORD: &str = "\
Examples:
  lapwing record --track lake --laps 3 --out data/lake";

#[cfg(all(feature = "networks", feature = "simulator"))]
pub(super) const TRAIN: &str = "\
Examples:
  lapwing train --data data/lake --out runs/mine
  lapwing train --data data/lake data/jungle@2 --network resnet18 --epochs 5 --out runs/resnet
  lapwing train --resume --out runs/mine";

#[cfg(feature = "networks")]
pub(super) const EVALUATE: &str = "\
Examples:
  lapwing evaluate models/cps.safetensors --data recordings/lake.mcap --plot error.svg
  lapwing evaluate runs/mine/model.safetensors --data data/lake --rows held-out   # once trained";

#[cfg(feature = "networks")]
pub(super) const EXPLAIN: &str = "\
Examples:
  lapwing explain recordings/lake.mcap --frame 40 --out explained.png";

#[cfg(feature = "networks")]
pub(super) const MODEL: &str = "\
Examples:
  lapwing model check models/cps.safetensors   # what goes in and out, and what looks wrong
  lapwing model rename weights.safetensors --network pilotnet --out net.safetensors";

#[cfg(feature = "networks")]
pub(super) const MODEL_CHECK: &str = "\
Examples:
  lapwing model check   # the built-in PilotNet
  lapwing model check models/cps.safetensors --json";

#[cfg(feature = "networks")]
pub(super) const MODEL_RENAME: &str = "\
Examples:
  lapwing model rename weights.safetensors --network pilotnet --out net.safetensors

weights.safetensors is what safetensors.torch.save_file writes of your network's state_dict.";

#[cfg(feature = "networks")]
pub(super) const REPLAY: &str = "\
Examples:
  lapwing replay recordings/lake.mcap
  lapwing replay recordings/lake.mcap --golden recordings/lake.golden
  lapwing replay recordings/lake.mcap --closed-loop";

#[cfg(feature = "simulator")]
pub(super) const LOCATE: &str = "\
Examples:
  lapwing locate recordings/lake.mcap --csv lane.csv --plot offset.svg";

#[cfg(feature = "simulator")]
pub(super) const SCORE: &str = "\
Examples:
  lapwing score recordings/lake.mcap
  lapwing score recordings --json > baseline.json
  lapwing score recordings --against baseline.json --junit report.xml --html report.html
  lapwing score recordings --markdown=summary.md
  lapwing score --explain   # each figure: JSON key, unit, formula, source";

pub(super) const BRAKE: &str = "\
Examples:
  lapwing brake label recordings/lake.mcap --out labels";

pub(super) const BRAKE_LABEL: &str = "\
Examples:
  lapwing brake label recordings/lake.mcap
  lapwing brake label recordings/lake.mcap --out labels --plot braking.svg";

#[cfg(feature = "simulator")]
pub(super) const BRAKE_RECORD: &str = "\
Examples:
  lapwing brake record --out data/brake   # three hours of driving
  lapwing brake record --out data/brake-held-out --hours 8.3 --part held-out   # only what networks are judged by";

#[cfg(feature = "simulator")]
pub(super) const BRAKE_TRIAL: &str = "\
Examples:
  lapwing brake trial --brake-model models/brake.safetensors --out runs/trial
  lapwing brake trial --cases ccrs,parked --layers plain --speeds 20 --seeds 2 --laps 1   # short";

#[cfg(feature = "networks")]
pub(super) const BRAKE_TRAIN: &str = "\
Examples:
  lapwing brake train --recipe models/brake-first.toml --data data/brake \\
      --out runs/brake-first.safetensors
  lapwing brake train --recipe models/brake.toml --data data/brake --out runs/brake.safetensors

data/brake is what lapwing brake record --out data/brake writes.";

#[cfg(feature = "networks")]
pub(super) const BRAKE_EVALUATE: &str = "\
Examples:
  lapwing brake evaluate models/brake.safetensors --data data/brake --plot braking.svg

data/brake is what lapwing brake record --out data/brake writes.";

#[cfg(feature = "simulator")]
pub(super) const MARL: &str = "\
Examples:
  lapwing marl watch
  lapwing marl evaluate --json";

#[cfg(all(feature = "networks", feature = "simulator"))]
pub(super) const MARL_TRAIN: &str = "\
Examples:
  lapwing marl train --out runs/ppo
  lapwing marl train --recipe models/intersection-ppo.toml --out runs/intersection-ppo
  lapwing marl train --algorithm maddpg --batch 64 --every 3 --observation routes \\
      --out runs/maddpg";

#[cfg(all(feature = "networks", feature = "simulator"))]
pub(super) const MARL_STUDY: &str = "\
Examples:
  lapwing marl study --out runs/study   # hours on one core
  lapwing marl study --tasks corrected --seeds 3 --out runs/small-study";

#[cfg(feature = "simulator")]
pub(super) const MARL_WATCH: &str = "\
Examples:
  lapwing marl watch
  lapwing marl watch --cars 12 --missions random --policy models/intersection-ppo.safetensors
  lapwing marl watch --seed 3 --video crossing.mp4";

#[cfg(feature = "simulator")]
pub(super) const MARL_EVALUATE: &str = "\
Examples:
  lapwing marl evaluate
  lapwing marl evaluate --episodes 200 --cars 12 \\
      --policy models/intersection-ppo.safetensors --json";

#[cfg(all(feature = "networks", feature = "simulator"))]
pub(super) const SUITE: &str = "\
Examples:
  lapwing suite suite.toml --out suite
  lapwing suite suite.toml --out suite --shard 2/8

docs/how-to/suite.md has a suite.toml to begin with.";

#[cfg(all(feature = "networks", feature = "simulator"))]
pub(super) const MERGE: &str = "\
Examples:
  lapwing merge part-1 part-2 --out suite";

#[cfg(feature = "networks")]
pub(super) const DATASET: &str = "\
Examples:
  lapwing dataset inspect recordings/lake.mcap --sheet sheet.png --plot steering.svg
  lapwing dataset convert recordings/lake.mcap data/run
  lapwing dataset split data/run --out-train data/train --out-validation data/validation";

#[cfg(feature = "networks")]
pub(super) const DATASET_INSPECT: &str = "\
Examples:
  lapwing dataset inspect recordings/lake.mcap --sheet sheet.png --plot steering.svg
  lapwing dataset inspect recordings/lake.mcap --json";

#[cfg(feature = "networks")]
pub(super) const DATASET_CONVERT: &str = "\
Examples:
  lapwing dataset convert recordings/lake.mcap data/run   # a run to driving_log.csv and IMG/
  lapwing dataset convert data/run run.mcap               # and back";

#[cfg(feature = "networks")]
pub(super) const DATASET_SPLIT: &str = "\
Examples:
  lapwing dataset split data/run --out-train data/train --out-validation data/validation
  lapwing dataset split data/run --block 100 --every 10 \\
      --out-train data/train --out-validation data/validation";

#[cfg(feature = "networks")]
pub(super) const DATASET_PREVIEW: &str = "\
Examples:
  lapwing dataset preview recordings/lake.mcap --out augmented.png
  lapwing dataset preview recordings/lake.mcap --recipe models/cps.toml \\
      --seed 3 --out augmented.png";

#[cfg(feature = "bridge")]
pub(super) const DOCTOR: &str = "\
Examples:
  lapwing doctor
  lapwing doctor --model models/cps.safetensors --json";

pub(super) const CONFIG: &str = "\
Examples:
  lapwing config   # all settings, and where each comes from
  lapwing config --json";

pub(super) const COMPLETIONS: &str = "\
Examples:
  lapwing completions bash > ~/.local/share/bash-completion/completions/lapwing
  lapwing completions zsh > ~/.zfunc/_lapwing   # with fpath+=~/.zfunc before compinit in ~/.zshrc
  lapwing completions fish > ~/.config/fish/completions/lapwing.fish";

pub(super) const MAN: &str = "\
Examples:
  lapwing man | man -l -
  lapwing man --out ~/.local/share/man/man1";
