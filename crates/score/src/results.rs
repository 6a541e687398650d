//! Drives and replays as one JSON object, whoever drove and wherever: what `drive`, `simulate` and `replay` print with
//! `--json`.

use serde::Serialize;

use crate::score::Scorecard;
use lapwing_core::replay::{GoldenComparison, ReplayReport};

/// A scored drive. Its keys are, in this order: those of who drove where, those of the [`Scorecard`], those of how it was
/// driven, and `missed`.
#[derive(Debug, Serialize)]
pub struct ScoredDrive<'a, Who, How> {
    /// Who drove where: [`Simulated`], [`Bridged`], [`Along`].
    #[serde(flatten)]
    pub who: Who,
    /// The judgement.
    #[serde(flatten)]
    pub card: &'a Scorecard,
    /// How it was driven: [`InProcess`], [`AlongRows`], or `()` if that is not known here.
    #[serde(flatten)]
    pub how: How,
    /// The thresholds that it missed, in words.
    pub missed: &'a [String],
}

/// A pilot in a simulated world.
#[derive(Debug, Serialize)]
pub struct Simulated<'a> {
    /// Its name.
    pub pilot: &'a str,
    /// The seed of everything random in the world.
    pub seed: u64,
}

/// Whoever answers a simulated world, a bridge for example.
#[derive(Debug, Serialize)]
pub struct Bridged<'a> {
    /// Its name.
    pub driver: &'a str,
    /// The seed of everything random in the world.
    pub seed: u64,
}

/// A pilot along a recording.
#[derive(Debug, Serialize)]
pub struct Along<'a> {
    /// Its name.
    pub pilot: &'a str,
    /// The recording.
    pub source: &'a str,
    /// Where it is put back: at the edge of the `road`, or after a number of `metres`.
    pub limit: &'a str,
    /// That number; with `road` it holds where the road is not known.
    pub limit_m: f64,
    /// How the drive goes on after an intervention: `dave2`, `rally-estonia`.
    pub protocol: &'a str,
}

/// A drive in one process, as fast as it goes.
#[derive(Debug, Serialize)]
pub struct InProcess<'a> {
    /// Frames shown to the driver.
    pub frames: u64,
    /// SHA-256 over all frames and commands: equal where two drives were the same.
    pub fingerprint: &'a str,
    /// Simulated seconds per second of real time.
    pub times_real_time: f64,
    /// What recordings showed of the road, if the pilot saw their pictures.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seen: Option<Seen>,
    /// The run's file, if one was recorded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
}

/// What recordings showed of a road to a pilot that drove there.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Seen {
    /// Moments with pictures whose places are known.
    pub moments: usize,
    /// The share of the road along which there are some.
    pub covered: f64,
    /// Pictures that the pilot saw of recordings …
    pub recorded: u32,
    /// … and those that were drawn, as none that was recorded near enough could be used.
    pub drawn: u32,
    /// How far from where they were seen the recorded ones had been taken: the mean, in metres; null, like the two below, if
    /// there are none.
    pub apart_m: Option<f64>,
    /// Share of the rows that PilotNet sees which no recorded camera showed and which was filled in: the mean over the
    /// recorded pictures …
    pub filled_mean: Option<f64>,
    /// … and the most of one.
    pub filled_most: Option<f64>,
}

/// A drive along the rows of a recording.
#[derive(Debug, Serialize)]
pub struct AlongRows<'a> {
    /// Frames shown to the driver.
    pub frames: u64,
    /// Frames among them that no network saw; the card counts bad frames only if a pilot drove at all.
    pub unseen_frames: u64,
    /// Rows with a picture in the recording.
    pub rows_read: usize,
    /// Rows among them in which the recorded car stands.
    pub rows_standing: usize,
    /// Intervals in which the recorded car's places in its lane showed how it turned.
    pub turned_by_lane: usize,
    /// Intervals in which the pictures showed how the recorded car turned.
    pub turned_by_pictures: usize,
    /// Intervals in which its steering was used instead.
    pub turned_by_steering: usize,
    /// How many times as far both cars turned as the simulator's would for the same steering.
    pub gearing: f64,
    /// Pictures that were taken in another lap of the recording than the one that is driven along, as its camera was nearer.
    pub of_another_lap: u32,
    /// How far from where they were seen the pictures had been taken: the mean, in metres.
    pub apart_m: f64,
    /// Share of the rows that PilotNet sees which no recorded camera showed and which was filled in: the mean over the
    /// pictures …
    pub filled_mean: f64,
    /// … and the most of one.
    pub filled_most: f64,
    /// SHA-256 over all frames and commands.
    pub fingerprint: &'a str,
    /// Seconds driven per second of real time.
    pub times_real_time: f64,
    /// The run's file, if one was recorded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
}

/// An open-loop replay: its report, the scorecard's figures of steering, and, if asked for, how it agrees with a stored
/// one.
#[derive(Debug, Serialize)]
pub struct Replayed<'a> {
    /// The answers, and how fast they came.
    #[serde(flatten)]
    pub report: &'a ReplayReport,
    /// Its score.
    pub card: Scorecard,
    /// The comparison with a stored replay.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub golden: Option<GoldenComparison>,
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeSet, time::Duration};

    use super::*;
    use crate::score::Scorer;

    /// The keys that an object in this JSON has twice.
    fn twice(result: &impl Serialize) -> Vec<String> {
        let text = serde_json::to_string_pretty(result).unwrap();
        let (mut open, mut twice): (Vec<BTreeSet<String>>, _) = (vec![], vec![]);
        for line in text.lines().map(str::trim_start) {
            let key = line.strip_prefix('"').and_then(|line| line.split_once("\": "));
            if let (Some((key, _)), Some(keys)) = (key, open.last_mut()) {
                twice.extend((!keys.insert(key.to_owned())).then(|| key.to_owned()));
            }
            if line.ends_with(['{', '[']) {
                open.push(BTreeSet::new());
            }
            if line.starts_with(['}', ']']) {
                open.pop();
            }
        }
        twice
    }

    #[test]
    fn no_result_has_a_key_twice() {
        let (card, missed) = (Scorer::default().finish(), ["a".to_owned()]);
        let (frames, fingerprint, times_real_time, run) = (3, "ff", 2.0, Some("r.mcap".to_owned()));
        let (apart_m, filled_mean, filled_most) = (Some(0.0), Some(0.0), Some(0.0));
        let seen = Seen { moments: 1, covered: 1.0, recorded: 1, drawn: 0, apart_m, filled_mean, filled_most };
        let how = InProcess { frames, fingerprint, times_real_time, seen: Some(seen), run: run.clone() };
        let who = Simulated { pilot: "p", seed: 1 };
        assert_eq!(twice(&ScoredDrive { who, card: &card, how, missed: &missed }), [""; 0]);
        let who = Bridged { driver: "d", seed: 1 };
        assert_eq!(twice(&ScoredDrive { who, card: &card, how: (), missed: &missed }), [""; 0]);
        let how = AlongRows {
            frames,
            unseen_frames: 0,
            rows_read: 3,
            rows_standing: 0,
            turned_by_lane: 0,
            turned_by_pictures: 3,
            turned_by_steering: 0,
            gearing: 1.0,
            of_another_lap: 0,
            apart_m: 0.0,
            filled_mean: 0.0,
            filled_most: 0.0,
            fingerprint,
            times_real_time,
            run,
        };
        let who = Along { pilot: "p", source: "s", limit: "metres", limit_m: 1.0, protocol: "dave2" };
        assert_eq!(twice(&ScoredDrive { who, card: &card, how, missed: &missed }), [""; 0]);
        let report = ReplayReport::new(("s".into(), "d".into()), &[], (0, None), (&[], Duration::ZERO));
        assert_eq!(twice(&Replayed { report: &report, card, golden: None }), [""; 0]);
        assert_eq!(twice(&[Both { frames, how: Frames { frames } }]), ["frames"], "they are found");
    }

    #[derive(Serialize)]
    struct Frames {
        frames: u64,
    }

    #[derive(Serialize)]
    struct Both {
        frames: u64,
        #[serde(flatten)]
        how: Frames,
    }

    #[test]
    fn keys_stand_in_the_order_of_who_what_it_was_worth_and_how() {
        let (card, missed) = (Scorer::default().finish(), ["a".to_owned()]);
        let how = InProcess { frames: 3, fingerprint: "ff", times_real_time: 2.0, seen: None, run: None };
        let drive = ScoredDrive { who: Simulated { pilot: "p", seed: 1 }, card: &card, how, missed: &missed };
        let json = serde_json::to_string(&drive).unwrap();
        assert!(json.starts_with(r#"{"pilot":"p","seed":1,"schema":"#), "{json}");
        assert!(json.ends_with(r#","frames":3,"fingerprint":"ff","times_real_time":2.0,"missed":["a"]}"#), "{json}");
        let bare = ScoredDrive { who: Bridged { driver: "d", seed: 1 }, card: &card, how: (), missed: &[] };
        assert!(serde_json::to_string(&bare).unwrap().ends_with(r#","missed":[]}"#));
    }
}
