//! What one call of `lapwing marl study` did, and how fast.

use std::time::Duration;

use serde::Serialize;

use lapwing_core::words::count;

/// What a call did itself: trainings that were done before it do not count.
#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct ThisCall {
    /// Trainings that it finished.
    trainings: usize,
    /// Agent-steps of these.
    agent_steps: u64,
    /// Trainings side by side.
    jobs: u16,
    /// How long it took, judging included.
    seconds: f64,
    /// Over all jobs. None if it finished nothing, or was stopped: trainings that were stopped took time, but their
    /// agent-steps are not known.
    agent_steps_per_s: Option<f64>,
}

impl ThisCall {
    /// `finished` holds the agent-steps of each training that it finished.
    pub(super) fn of(finished: &[u64], jobs: u16, took: Duration, was_stopped: bool) -> Self {
        let (agent_steps, seconds) = (finished.iter().sum::<u64>(), took.as_secs_f64());
        let is_known = !finished.is_empty() && !was_stopped;
        let agent_steps_per_s = is_known.then(|| agent_steps as f64 / seconds.max(1e-9));
        Self { trainings: finished.len(), agent_steps, jobs, seconds, agent_steps_per_s }
    }

    /// In a sentence, or two; `who` is the call.
    pub(super) fn told(&self, who: &str) -> String {
        let Self { trainings, agent_steps, jobs, seconds, agent_steps_per_s } = *self;
        let (trained, jobs) = (count(trainings, "training"), count(jobs, "job"));
        let did = format!("{who} finished {trained} ({agent_steps} agent-steps) in {seconds:.1} s with {jobs}");
        match agent_steps_per_s {
            Some(pace) => format!("{did}, judging included: {pace:.0} agent-steps/s over all jobs."),
            None if trainings == 0 => format!("{who} finished no training in {seconds:.1} s."),
            None => format!("{did}. It was stopped, so its agent-steps/s are not known."),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_counts_what_it_finished_over_all_jobs_and_tells_no_pace_where_trainings_were_stopped() {
        let told = |finished: &[u64], was_stopped| {
            ThisCall::of(finished, 2, Duration::from_secs(50), was_stopped).told("This call")
        };
        let whole = "This call finished 2 trainings (3000 agent-steps) in 50.0 s with 2 jobs";
        assert_eq!(told(&[1000, 2000], false), format!("{whole}, judging included: 60 agent-steps/s over all jobs."));
        assert_eq!(told(&[1000, 2000], true), format!("{whole}. It was stopped, so its agent-steps/s are not known."));
        for was_stopped in [false, true] {
            assert_eq!(told(&[], was_stopped), "This call finished no training in 50.0 s.");
        }
    }
}
