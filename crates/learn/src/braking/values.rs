//! What a network says over whole episodes, with and without speed.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use tch::{Kind, Tensor};

use super::{
    BrakingTrainError,
    episodes::{Drive, Reader},
    windows::failing,
};
use crate::nn::braking::{BrakingArchitecture, BrakingNetwork, FRAMES};
use lapwing_core::units::{MPS_PER_KMH, MPS_PER_MPH};
use lapwing_score::emergency::Episode;

/// Frames that go through the live network together; longer drives are cut, with an overlap.
const AT_ONCE: usize = 160;
/// Drives that each processor takes before it is told how many are done.
const AT_ONCE_EACH: usize = 8;

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

/// The drives with how much the network says a brake to be due at each frame, on all processors; `told` is told how many are
/// done.
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
    let reader = Reader::new(network.architecture().preprocess()).map_err(crate::nn::NnError::from)?;
    let speeds: Vec<Vec<f32>> =
        drives.iter().map(|drive| failing(&drive.speed_kmh, failure.share, &mut random)).collect();
    let episode = |network: &BrakingNetwork, reader: &mut Reader, (drive, speeds): (&Drive, &Vec<f32>)| {
        let [values, blocked] = tch::no_grad(|| values(network, drive, speeds, reader))?;
        Ok::<_, BrakingTrainError>(Episode {
            name: drive.story.name.clone(),
            at_s: drive.at_s.clone(),
            due: drive.due.clone(),
            onsets: drive.onsets.clone(),
            values,
            blocked,
            // The bridge knows the speed, though the network may not.
            speed_mph: drive.speed_kmh.iter().map(|kmh| f64::from(*kmh) * MPS_PER_KMH / MPS_PER_MPH).collect(),
            impact_s: drive.impact_s,
        })
    };
    // A tensor's handle belongs to one thread at a time: each has its own.
    let mut hands: Vec<(BrakingNetwork, Reader)> =
        (0..rayon::current_num_threads()).map(|_| (network.share(), reader.clone())).collect();
    let (each, mut all) = (AT_ONCE_EACH, Vec::with_capacity(drives.len()));
    for (drives, speeds) in drives.chunks(hands.len() * each).zip(speeds.chunks(hands.len() * each)) {
        let shares = drives.par_chunks(each).zip(speeds.par_chunks(each)).zip(&mut hands);
        let done = shares.map(|((drives, speeds), (network, reader))| {
            drives.iter().zip(speeds).map(|both| episode(network, reader, both)).collect::<Result<Vec<_>, _>>()
        });
        all.extend(done.collect::<Result<Vec<_>, _>>()?.into_iter().flatten());
        told(all.len());
    }
    Ok(all)
}

/// How much the network says a brake to be due at each frame, NaN at the first 19, and whether something is close ahead.
fn values(
    network: &BrakingNetwork,
    drive: &Drive,
    speeds: &[f32],
    reader: &mut Reader,
) -> Result<[Vec<f64>; 2], BrakingTrainError> {
    let (mut values, mut blocked) = (vec![f64::NAN; drive.frames()], vec![0.0; drive.frames()]);
    let [_, height, width] = network.architecture().preprocess().shape().map(|n| n as i64);
    // The live network answers every second frame of a piece, so there are pieces for both.
    let (phases, step) = match network.architecture() {
        BrakingArchitecture::Live => (2, 2),
        BrakingArchitecture::Stacked => (1, 1),
    };
    // The paper's network sees each picture in twenty windows: it is decoded once.
    let (mut pixels, size) = (vec![], (height * width) as usize);
    drive.pictures(0, drive.frames(), reader, &mut pixels)?;
    for phase in 0..phases {
        let mut from = phase;
        while from + FRAMES <= drive.frames() {
            let most = if step == 1 { FRAMES } else { AT_ONCE };
            let length = (drive.frames() - from).min(most);
            let length = FRAMES + (length - FRAMES) / 2 * 2;
            let pixels = &pixels[from * size..(from + length) * size];
            let frames = Tensor::f_from_data_size(pixels, &[1, length as i64, height, width], Kind::Uint8)?;
            let frames = frames.f_to_device(network.device())?;
            let speeds = Tensor::f_from_slice(&speeds[from..from + length])?.f_view([1, -1])?;
            let speeds = speeds.f_to_device(network.device())?;
            let said = network.forward(&frames.f_to_kind(Kind::Float)?, &speeds, false)?;
            let numbers = |x: &Tensor| Vec::<f64>::try_from(&x.f_reshape([-1])?.f_to_kind(Kind::Double)?);
            let due = numbers(&said.due)?;
            let ends = || (from + FRAMES - 1..).step_by(2);
            ends().zip(&due).for_each(|(end, due)| values[end] = *due);
            if let Some(said) = &said.blocked {
                ends().zip(numbers(said)?).for_each(|(end, said)| blocked[end] = said);
            }
            from += due.len() * step;
        }
    }
    Ok([values, blocked])
}

#[cfg(test)]
mod tests {
    use tch::{Device, nn::VarStore};

    use super::*;
    use crate::{
        braking::{Part, Story},
        nn::{braking::Seen, in_variable_store},
    };

    fn says_the_same_live(architecture: BrakingArchitecture, frames: usize) {
        tch::manual_seed(2);
        let store = VarStore::new(Device::Cpu);
        let network = BrakingNetwork::build(architecture, &mut in_variable_store(store.root())).unwrap();
        let story = Story {
            name: "made".into(),
            part: Part::Train,
            scenario: String::new(),
            hazard: false,
            layer: String::new(),
            reaction_s: 1.0,
            track: None,
            frames: None,
        };
        let speeds: Vec<f32> = (0..frames).map(|i| (i % 40) as f32).collect();
        let [_, height, width] = architecture.preprocess().shape();
        let drive = Drive::made(story, speeds.clone(), vec![0.0; frames], height * width, 9);
        let [episode] = &episodes(&network, std::slice::from_ref(&drive), SpeedFailure::NONE, |_| {}).unwrap()[..]
        else {
            panic!("one drive is one episode")
        };
        let (mut seen, mut reader) = (Seen::default(), Reader::new(architecture.preprocess()).unwrap());
        for (i, speed) in speeds.iter().enumerate() {
            let mut pixels = vec![];
            drive.pictures(i, 1, &mut reader, &mut pixels).unwrap();
            let frame = Tensor::from_data_size(&pixels, &[1, height as i64, width as i64], Kind::Uint8);
            let frame = frame.to_kind(Kind::Float);
            let live = network.answer(&frame, f64::from(*speed), &mut seen).unwrap();
            assert_eq!(live.is_some(), i >= 19);
            assert_eq!(live.is_some(), episode.values[i].is_finite(), "frame {i}");
            if let Some(live) = live {
                let (due, blocked) = (episode.values[i], episode.blocked[i]);
                assert!((live.due - due).abs() < 1e-4, "frame {i}: {live:?} {due}");
                assert!((live.blocked - blocked).abs() < 1e-4, "frame {i}: {live:?} {blocked}");
            }
        }
    }

    #[test]
    fn over_a_whole_drive_a_network_says_at_each_frame_what_it_says_live() {
        says_the_same_live(BrakingArchitecture::Live, 401);
        says_the_same_live(BrakingArchitecture::Stacked, 45);
    }
}
