//! What a network says over whole episodes, with and without speed.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tch::{Kind, Tensor};

use super::{
    BrakingTrainError,
    episodes::{Drive, Reader},
    windows::failing,
};
use crate::nn::braking::{BrakingArchitecture, BrakingNetwork, FRAMES};
use lapwing_score::emergency::Episode;

/// Frames that go through the live network together; longer drives are cut, with an overlap.
const AT_ONCE: usize = 160;

/// How many of the speeds are not known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedFailure {
    /// Share of the frames, 0 to 1.
    pub share: f64,
    /// Draws which.
    pub seed: u64,
}

impl SpeedFailure {
    /// All speeds are known.
    pub const NONE: Self = Self { share: 0.0, seed: 0 };
}

/// The drives with how much the network says a brake to be due at each frame, one after the other; `told` is told of each.
///
/// # Errors
/// [`BrakingTrainError`].
pub fn episodes(
    network: &BrakingNetwork,
    drives: &[Drive],
    failure: SpeedFailure,
    mut told: impl FnMut(usize),
) -> Result<Vec<Episode>, BrakingTrainError> {
    let mut random = ChaCha8Rng::seed_from_u64(failure.seed);
    let mut reader = Reader::new(network.architecture().preprocess()).map_err(crate::nn::NnError::from)?;
    let mut episode = |(i, drive): (usize, &Drive)| {
        let speeds = failing(&drive.speed_kmh, failure.share, &mut random);
        let values = tch::no_grad(|| values(network, drive, &speeds, &mut reader))?;
        told(i + 1);
        Ok(Episode {
            name: drive.story.name.clone(),
            at_s: drive.at_s.clone(),
            due: drive.due.clone(),
            onsets: drive.onsets.clone(),
            values,
            impact_s: drive.impact_s,
        })
    };
    drives.iter().enumerate().map(&mut episode).collect()
}

/// What the network says at each frame; NaN at the first 19.
fn values(
    network: &BrakingNetwork,
    drive: &Drive,
    speeds: &[f32],
    reader: &mut Reader,
) -> Result<Vec<f64>, BrakingTrainError> {
    let mut values = vec![f64::NAN; drive.frames()];
    let [_, height, width] = network.architecture().preprocess().shape().map(|n| n as i64);
    // The live network answers every second frame of a piece, so there are pieces for both.
    let (phases, step) = match network.architecture() {
        BrakingArchitecture::Live => (2, 2),
        BrakingArchitecture::Stacked => (1, 1),
    };
    for phase in 0..phases {
        let mut from = phase;
        while from + FRAMES <= drive.frames() {
            let most = if step == 1 { FRAMES } else { AT_ONCE };
            let length = (drive.frames() - from).min(most);
            let length = FRAMES + (length - FRAMES) / 2 * 2;
            let mut pixels = vec![];
            drive.pictures(from, length, reader, &mut pixels)?;
            let frames = Tensor::f_from_data_size(&pixels, &[1, length as i64, height, width], Kind::Uint8)?;
            let speeds = Tensor::f_from_slice(&speeds[from..from + length])?.f_view([1, -1])?;
            let answers = network.forward(&frames.f_to_kind(Kind::Float)?, &speeds, false)?.due;
            let answers = Vec::<f64>::try_from(&answers.f_view([-1])?.f_to_kind(Kind::Double)?)?;
            for (end, answer) in (from + FRAMES - 1..).step_by(2).zip(&answers) {
                values[end] = *answer;
            }
            from += answers.len() * step;
        }
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use tch::{Device, nn::VarStore};

    use super::*;
    use crate::{
        braking::{Part, Story},
        nn::{braking::Seen, in_variable_store},
    };

    #[test]
    fn over_a_whole_drive_the_network_says_at_each_frame_what_it_says_live() {
        tch::manual_seed(2);
        let store = VarStore::new(Device::Cpu);
        let network = BrakingNetwork::build(BrakingArchitecture::Live, &mut in_variable_store(store.root())).unwrap();
        let story = Story {
            name: "made".into(),
            part: Part::Train,
            scenario: String::new(),
            hazard: false,
            layer: String::new(),
            reaction_s: 1.0,
        };
        let speeds: Vec<f32> = (0..401).map(|i| (i % 40) as f32).collect();
        let drive = Drive::made(story, speeds.clone(), vec![0.0; 401], 64 * 240, 9);
        let [episode] = &episodes(&network, std::slice::from_ref(&drive), SpeedFailure::NONE, |_| {}).unwrap()[..]
        else {
            panic!("one drive is one episode")
        };
        let frame = Tensor::full([1, 64, 240], 9.0, (Kind::Float, Device::Cpu));
        let mut seen = Seen::default();
        for (i, speed) in speeds.iter().enumerate() {
            let live = network.answer(&frame, f64::from(*speed), &mut seen).unwrap();
            assert_eq!(live.is_some(), i >= 19);
            assert_eq!(live.is_some(), episode.values[i].is_finite(), "frame {i}");
            if let Some(live) = live {
                assert!((live.due - episode.values[i]).abs() < 1e-4, "frame {i}: {live:?} {}", episode.values[i]);
            }
        }
    }
}
