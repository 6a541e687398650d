//! Who drives the agents.

use crate::cli::{DriverFlags, DriverKind, IntersectionFlags};
#[cfg(feature = "networks")]
use lapwing_learn::{marl::Policy, nn::runtime};
use lapwing_sim::intersection::{AGENTS, Action, Environment, Reward, Settings, scripted};

/// Drives all agents of many intersections.
pub(super) enum Drivers {
    /// By a script.
    Scripted,
    /// By the same action all the time.
    Constant(Action),
    /// By what was learnt.
    #[cfg(feature = "networks")]
    Policy(Box<Policy>),
}

impl Drivers {
    pub(super) fn new(flags: &DriverFlags) -> anyhow::Result<Self> {
        #[cfg(feature = "networks")]
        if let Some(path) = &flags.policy {
            // More threads cost more than they bring for so small a network.
            runtime::set_threads(1);
            return Ok(Self::Policy(Box::new(Policy::load(path)?)));
        }
        Ok(match flags.driver {
            DriverKind::Scripted => Self::Scripted,
            DriverKind::KeepLane => Self::Constant(Action::KeepLane),
            DriverKind::Idle => Self::Constant(Action::SlowDown),
        })
    }

    /// The intersection of the flags, as these drivers see it. Rewards are the benchmark's.
    pub(super) fn settings(&self, flags: IntersectionFlags) -> Settings {
        let learning = match self {
            #[cfg(feature = "networks")]
            Self::Policy(policy) => policy.settings(),
            _ => Settings::default(),
        };
        flags.settings(Settings { reward: Reward::Smarts, ..learning })
    }

    /// What they do now.
    pub(super) fn act(&mut self, environments: &[Environment], actions: &mut [[Action; AGENTS]]) -> anyhow::Result<()> {
        match self {
            Self::Scripted => {
                for (environment, actions) in environments.iter().zip(actions) {
                    *actions = std::array::from_fn(|i| scripted::act(environment, i));
                }
            }
            Self::Constant(action) => actions.fill([*action; AGENTS]),
            #[cfg(feature = "networks")]
            Self::Policy(policy) => policy.act(environments, actions)?,
        }
        Ok(())
    }
}
