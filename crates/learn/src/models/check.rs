//! What a model answers to a whole recording, and what looks wrong in it.

use std::{fmt, path::Path, time::Duration};

use serde::Serialize;

use super::{
    LoadedModel,
    shown::{Shown, ShownError},
};
use lapwing_core::{
    perception::{Frame, ImageError, decode_jpeg},
    pilot::{PilotError, View},
    recording::{Recording, RecordingError},
    stats::Agreement,
};

/// The stock simulator's telemetries come this far apart: 15 a second.
const FRAME_MS: f64 = 1000.0 / 15.0;
/// Answers beyond this are not normalised steering: full lock is 1, and some overshoot is usual.
const FARTHEST: f64 = 1.5;
/// Answers that deviate less than this from their mean do not come from the picture.
const STILL: f64 = 1e-3;
/// Nor do those that deviate by less than this share of what was steered.
const LITTLE: f64 = 0.1;
/// Below this correlation with the recorded steering, a network sees something other than it was trained on. On recordings/lake.mcap
/// the shipped PilotNet has 0.92; given RGB for YUV 0.51, BGR 0.33 (2026-11-28). A human's strokes have little to do with the
/// picture: on the real lake it has 0.57.
const UNLIKE: f64 = 0.5;
/// Above this ratio of the mean squared error to the variance of the recorded steering, always answering the mean would be far
/// better. The shipped PilotNet has 0.6; given RGB 8.5, BGR 19; on the real lake 0.7.
const WORSE_THAN_BLIND: f64 = 2.0;
/// Recorded steering that deviates less than this from its mean says too little for that.
const VARIES: f64 = 0.02;
/// What to look at where answers do not fit.
const COMPARE: &str = "compare colour (bgr for rgb? rgb for yuv?), crop, filter and scale with the lines of its own drive.py, and \
                       layout with how it was exported";
/// An answer that is this much to one side on the whole, which no road here is.
const LEANING: f64 = 0.1;

/// Why a recording cannot be shown to a model.
#[derive(Debug, thiserror::Error)]
pub enum CheckError {
    /// The recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A picture of it.
    #[error("{recording}: moment {row}: {why}")]
    Picture {
        /// The recording.
        recording: String,
        /// Which moment.
        row: usize,
        /// Why it cannot be read.
        why: std::io::Error,
    },
    /// A picture that is none.
    #[error("{recording}: moment {row}: {why}")]
    Image {
        /// The recording.
        recording: String,
        /// Which moment.
        row: usize,
        /// What is wrong with it.
        why: ImageError,
    },
    /// A recording without pictures.
    #[error("{0}: expected moments with a picture and what was steered, got none")]
    Empty(String),
    /// The model answers one of them wrongly.
    #[error("moment {row}: {why}")]
    Pilot {
        /// Which moment.
        row: usize,
        /// What it answers.
        why: PilotError,
    },
    /// A picture cannot be kept.
    #[error(transparent)]
    Shown(#[from] ShownError),
}

/// What a model is and does. Its [`Display`](fmt::Display) is for people.
#[derive(Debug, Clone, Serialize)]
pub struct Checked {
    /// Kind and file.
    pub model: String,
    /// Of the file.
    pub sha256: String,
    /// What goes in: (1, C, H, W) or (1, H, W, C).
    pub input: [usize; 4],
    /// What each number that comes out is.
    pub outputs: Vec<String>,
    /// Numbers that were trained; absent for a network made elsewhere, which does not tell them apart from others.
    pub parameters: Option<usize>,
    /// What it answers to the recording.
    pub answers: Answered,
    /// What looks wrong, and what to do; empty if nothing does.
    pub troubles: Vec<String>,
}

/// What a model answers to a recording.
#[derive(Debug, Clone, Serialize)]
pub struct Answered {
    /// The recording.
    pub recording: String,
    /// Least, mean and greatest steering.
    pub range: [f64; 3],
    /// Their standard deviation.
    pub deviation: f64,
    /// How well they agree with what was steered then.
    pub agreement: Option<Agreement>,
    /// The standard deviation of what was steered then.
    pub recorded_deviation: f64,
    /// Median and 99th percentile of the time from a picture to an answer, in milliseconds, without decoding.
    pub latency_ms: [f64; 2],
}

/// Shows a recording to a model, picture by picture, as while driving. The first ones, and the answers to
/// them, are kept in the folder `pictures`, see [`shown`](super::shown).
///
/// # Errors
/// [`CheckError`].
pub fn check(model: &LoadedModel, recording: &Path, pictures: Option<&Path>) -> Result<Checked, CheckError> {
    let name = recording.display().to_string();
    let mut shown = pictures.map(Shown::new).transpose()?;
    let (mut pilot, mut frame) = (model.pilot(), Frame::default());
    let (mut pairs, mut times) = (vec![], vec![]);
    for moment in Recording::open(recording)?.seen() {
        let moment = moment?;
        let (Some(picture), Some(steered)) = (&moment.pictures[0], moment.steering()) else { continue };
        let row = moment.row;
        let bytes = picture.read().map_err(|why| CheckError::Picture { recording: name.clone(), row, why })?;
        decode_jpeg(&bytes, &mut frame).map_err(|why| CheckError::Image { recording: name.clone(), row, why })?;
        let view = View { speed: moment.telemetry.speed, ..View::of(&frame) };
        let answer = pilot.steer(&view).map_err(|why| CheckError::Pilot { row, why })?;
        if let Some(shown) = &mut shown {
            shown.keep(row, &frame, answer.steering)?;
        }
        pairs.push((answer.steering, steered.get()));
        times.push(answer.preprocess + answer.forward);
    }
    if pairs.is_empty() {
        return Err(CheckError::Empty(name));
    }
    if let Some(shown) = shown {
        shown.finish()?;
    }
    let answers = answered(name, &pairs, times);
    let parameters = model.network().map(|network| {
        let trained = |(_, tensor): &(String, tch::Tensor)| tensor.numel();
        let running = |name: &str| name.contains(".running_");
        network.tensors().iter().filter(|(name, _)| !running(name)).map(trained).sum()
    });
    Ok(Checked {
        model: model.name().to_owned(),
        sha256: model.sha256().to_owned(),
        input: model.preprocess().tensor_shape(),
        outputs: model.outputs().to_vec(),
        parameters,
        troubles: troubles(&answers),
        answers,
    })
}

fn answered(recording: String, pairs: &[(f64, f64)], mut times: Vec<Duration>) -> Answered {
    let n = pairs.len() as f64;
    let steering = || pairs.iter().map(|(answer, _)| *answer);
    let spread = |numbers: &dyn Fn(&(f64, f64)) -> f64| {
        let mean = pairs.iter().map(numbers).sum::<f64>() / n;
        (mean, (pairs.iter().map(|pair| (numbers(pair) - mean).powi(2)).sum::<f64>() / n).sqrt())
    };
    let ((mean, deviation), (_, recorded_deviation)) = (spread(&|pair| pair.0), spread(&|pair| pair.1));
    times.sort_unstable();
    let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize].as_secs_f64() * 1e3;
    Answered {
        recording,
        range: [steering().fold(f64::INFINITY, f64::min), mean, steering().fold(f64::NEG_INFINITY, f64::max)],
        deviation,
        agreement: Agreement::of(pairs.iter().copied()),
        recorded_deviation,
        latency_ms: [at(0.5), at(0.99)],
    }
}

/// What looks wrong. One cause often shows in several ways: the first that explains the others is the last that is looked for.
fn troubles(answers: &Answered) -> Vec<String> {
    let Answered { range: [least, mean, most], deviation, agreement, recorded_deviation, latency_ms, .. } = answers;
    let [_, p99] = latency_ms;
    let mut troubles = vec![];
    if *p99 > FRAME_MS {
        troubles.push(format!(
            "one answer in a hundred takes more than {p99:.0} ms, and the simulator sends a picture every {FRAME_MS:.0} ms: try \
             --threads, or a smaller network"
        ));
    }
    let farthest = most.max(-least);
    let hardly = *recorded_deviation > VARIES && *deviation < LITTLE * recorded_deviation;
    if *deviation < STILL || hardly {
        troubles.push(format!(
            "the answers hardly change from picture to picture (deviation {deviation:.5}): the network is not trained, or scale \
             is not what it was trained with: try \"none\" if it normalises itself, \"x/127.5-1\" or \"x/255\" if it does not"
        ));
        return troubles;
    }
    if farthest > FARTHEST {
        troubles.push(format!(
            "the answers reach {farthest:.2}, but steering goes from -1 to 1 (25 degrees): a network that was trained on degrees \
             or radians needs a last layer that divides by 25, or by 0.436; otherwise scale is not what it was trained with"
        ));
    }
    let far_off = agreement.map_or(0.0, |agreement| agreement.mse / recorded_deviation.powi(2));
    match agreement.and_then(|agreement| agreement.r) {
        Some(r) if r < -UNLIKE => troubles.push(format!(
            "it steers to the other side (correlation {r:.2} with what was steered): negate its output"
        )),
        Some(r) if r < UNLIKE => troubles.push(format!(
            "its answers have little to do with what was steered (correlation {r:.2}), which is normal only if the driver used a keyboard: {COMPARE}"
        )),
        _ if mean.abs() > LEANING && farthest <= FARTHEST => troubles.push(format!(
            "it steers {mean:+.2} on the whole, to one side: was the data balanced, and the side cameras' correction right?"
        )),
        Some(_) if *recorded_deviation > VARIES && far_off > WORSE_THAN_BLIND && farthest <= FARTHEST => {
            troubles.push(format!(
                "its squared error is {far_off:.1} times that of always answering the mean of the recorded steering: {COMPARE}"
            ));
        }
        _ => {}
    }
    troubles
}

impl fmt::Display for Checked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { model, input, outputs, parameters, answers, troubles, .. } = self;
        let Answered { recording, range, deviation, agreement, recorded_deviation, latency_ms: [p50, p99] } = answers;
        let [least, mean, most] = range;
        writeln!(f, "model       {model}")?;
        writeln!(f, "input       {input:?} f32")?;
        writeln!(f, "outputs     {}", outputs.join(", "))?;
        if let Some(parameters) = parameters {
            writeln!(f, "parameters  {parameters}")?;
        }
        writeln!(f, "shown       {recording}")?;
        writeln!(f, "steering    {least:+.3} to {most:+.3}, mean {mean:+.3}, deviation {deviation:.3}")?;
        if let Some(Agreement { frames, mae, r, .. }) = agreement {
            let r = r.map_or("not measurable, nothing varies".into(), |r| format!("{r:.3}"));
            writeln!(
                f,
                "recorded    deviation {recorded_deviation:.3}; {mae:.3} off on average, correlation {r}, over {frames} pictures"
            )?;
        }
        writeln!(f, "latency     {p50:.2} ms, {p99:.2} ms in one of a hundred, from picture to answer")?;
        if troubles.is_empty() {
            return f.write_str("nothing looks wrong");
        }
        f.write_str(&troubles.iter().map(|trouble| format!("trouble     {trouble}")).collect::<Vec<_>>().join("\n"))
    }
}

#[cfg(test)]
mod tests {
    use std::{sync::LazyLock, time::Instant};

    use super::*;

    /// A clock that stands still: how fast this machine is just then is no matter.
    fn stood() -> Instant {
        static THEN: LazyLock<Instant> = LazyLock::new(Instant::now);
        *THEN
    }

    fn lake() -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../recordings/lake.mcap")
    }

    #[test]
    fn nothing_looks_wrong_with_the_shipped_model() {
        let checked = check(&super::super::built_in(stood).unwrap(), &lake(), None).unwrap();
        assert_eq!(checked.troubles, [""; 0]);
        assert_eq!((checked.input, checked.parameters), ([1, 3, 66, 200], Some(252_219)));
        let agreement = checked.answers.agreement.unwrap();
        assert!(agreement.r.unwrap() > 0.8, "{agreement:?}");
        assert!(checked.to_string().ends_with("nothing looks wrong"));
    }

    fn told(pairs: &[(f64, f64)], ms: u64) -> Vec<String> {
        troubles(&answered("run".into(), pairs, vec![Duration::from_millis(ms); pairs.len()]))
    }

    #[test]
    fn each_trouble_is_told_with_what_to_do() {
        let steered = |i: usize| 0.3 * (i as f64 / 3.0).sin();
        let pairs =
            |answer: fn(f64, usize) -> f64| (0..60).map(|i| (answer(steered(i), i), steered(i))).collect::<Vec<_>>();
        let one = |pairs: &[(f64, f64)], part: &str| {
            let told = told(pairs, 1);
            assert!(told.len() == 1 && told[0].contains(part), "{told:?}");
        };
        assert_eq!(told(&pairs(|s, _| s), 1), [""; 0]);
        one(&pairs(|_, _| 0.2), "hardly change");
        one(&pairs(|s, _| 25.0 * s), "the answers reach 7.50");
        one(&pairs(|s, _| -s), "negate its output");
        one(&pairs(|_, i| 0.3 * (i as f64 * 1.7).cos()), "little to do with");
        one(&pairs(|s, _| s + 0.2), "to one side");
        one(&pairs(|s, _| 4.0 * s), "always answering the mean");
        assert_eq!(told(&pairs(|s, _| 4.0 * s).iter().map(|(a, _)| (0.03 * a, 0.0)).collect::<Vec<_>>(), 1), [""; 0]);
        assert!(told(&pairs(|s, _| s), 80)[0].contains("takes more than 80 ms"));
    }
}
