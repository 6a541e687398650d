//! A braking network from its file, as a guard.

use std::{
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::Duration,
};

use tch::Tensor;

use super::episodes::Reader;
use crate::nn::{
    NnError,
    braking::{BrakingArchitecture, BrakingCheckpoint, BrakingError, BrakingNetwork, HZ, NO_SPEED, Seen},
};
use lapwing_core::{
    control::{BrakeLimits, Warned},
    guard::{Guard, GuardError, GuardModel, Watched},
    perception::Frame,
    recording::LONGEST_GAP,
    units::MPS_PER_KMH,
};

/// It looks this often, as it learnt …
const APART: Duration = Duration::from_nanos((1e9 / HZ) as u64);
/// … and takes a frame that is due within this time: a world that steps 50 times a second tells the times of 15 frames
/// a second up to 13.3 ms early.
const EARLY: Duration = Duration::from_nanos((0.22e9 / HZ) as u64);

/// Why a file and a threshold make no guard.
#[derive(Debug, thiserror::Error)]
pub enum BrakingModelError {
    /// The file.
    #[error("{0}{help}", help = help(.0))]
    File(#[from] BrakingError),
    /// The network never answers more than 1, so its guard would never brake.
    #[error("{}: expected a threshold of at most 1, as a {network} network says no more, got {got}", path.display())]
    Threshold {
        /// The file.
        path: PathBuf,
        /// The network.
        network: &'static str,
        /// The threshold.
        got: f64,
    },
}

/// What may be wrong with the file.
fn help(error: &BrakingError) -> &'static str {
    match error {
        BrakingError::Content { .. } => ": a braking network is a .safetensors file of lapwing brake train",
        _ => "",
    }
}

/// A braking network in memory, whose weights any number of guards share. Several threads may use it.
#[derive(Debug)]
pub struct BrakingModel {
    name: String,
    sha256: String,
    limits: BrakeLimits,
    training: String,
    result: String,
    /// That from which all others are made, behind a lock because a tensor's handle belongs to one thread at a time.
    prototype: Mutex<(BrakingNetwork, Reader)>,
}

impl BrakingModel {
    /// Reads a checkpoint. `threshold` replaces the value from which on its guards brake.
    ///
    /// The network answers a few times before this returns, so that the first frame is as fast as any.
    ///
    /// # Errors
    /// [`BrakingModelError`].
    pub fn load(path: &Path, threshold: Option<f64>) -> Result<Self, BrakingModelError> {
        let BrakingCheckpoint { metadata, network, sha256 } = BrakingCheckpoint::load(path)?;
        let architecture = network.architecture();
        // The paper's network is trained towards 1, and may say more.
        if let Some(got) = threshold.filter(|got| *got > 1.0 && architecture != BrakingArchitecture::Stacked) {
            let (path, network) = (path.to_owned(), architecture.name());
            return Err(BrakingModelError::Threshold { path, network, got });
        }
        let wrong = |source: NnError| BrakingError::Content { path: path.to_owned(), source };
        let reader = Reader::new(metadata.preprocess.clone()).map_err(|source| wrong(source.into()))?;
        let name = format!("{} ({})", architecture.name(), path.display());
        let limits = threshold.map_or(metadata.limits, |fires| BrakeLimits {
            fires,
            // As far apart as the file has them, by their ratio.
            releases: fires * metadata.limits.releases / metadata.limits.fires,
        });
        let [_, height, width] = architecture.preprocess().shape().map(|n| n as i64);
        let warm_up = || {
            let (blank, mut seen) = (Tensor::f_zeros([1, height, width], tch::kind::FLOAT_CPU)?, Seen::default());
            (0..25).try_for_each(|_| network.answer(&blank, 0.0, &mut seen).map(drop))
        };
        warm_up().map_err(wrong)?;
        let (training, result) = (metadata.training, metadata.result);
        Ok(Self { name, sha256, limits, training, result, prototype: Mutex::new((network, reader)) })
    }

    /// Its network, with the same weights.
    pub fn network(&self) -> BrakingNetwork {
        self.prototype.lock().unwrap_or_else(PoisonError::into_inner).0.share()
    }

    /// Between which values its guards brake and rest.
    pub fn limits(&self) -> BrakeLimits {
        self.limits
    }

    /// How it was trained and on what, as its file says.
    pub fn training(&self) -> &str {
        &self.training
    }

    /// How good it was found to be, as its file says.
    pub fn result(&self) -> &str {
        &self.result
    }
}

impl GuardModel for BrakingModel {
    fn name(&self) -> &str {
        &self.name
    }

    fn sha256(&self) -> Option<&str> {
        Some(&self.sha256)
    }

    fn guard(&self) -> Box<dyn Guard> {
        let prototype = self.prototype.lock().unwrap_or_else(PoisonError::into_inner);
        Box::new(NetworkGuard {
            name: prototype.0.architecture().name(),
            limits: self.limits,
            network: prototype.0.share(),
            reader: prototype.1.clone(),
            seen: Seen::default(),
            warned: Warned::default(),
            last: None,
            due: Duration::ZERO,
        })
    }
}

/// A network that watches over one car.
struct NetworkGuard {
    name: &'static str,
    limits: BrakeLimits,
    network: BrakingNetwork,
    reader: Reader,
    seen: Seen,
    warned: Warned,
    /// When a frame came last, and when it looks next.
    last: Option<Duration>,
    due: Duration,
}

impl NetworkGuard {
    fn forget(&mut self) {
        self.seen.clear();
        self.warned = Warned::default();
    }

    fn look(&mut self, frame: &Frame, speed_kmh: f64) -> Result<Option<f64>, GuardError> {
        let failed = |error: NnError| GuardError::Network(Box::new(error));
        let [_, height, width] = self.network.architecture().preprocess().shape().map(|n| n as i64);
        let pixels = self.reader.see(frame)?;
        let frame =
            Tensor::f_from_slice(pixels).and_then(|t| t.f_view([1, height, width])).map_err(|e| failed(e.into()))?;
        let said = self.network.answer(&frame, speed_kmh, &mut self.seen).map_err(failed)?;
        match said.map(|said| self.warned.value(said.due, said.blocked, self.limits)) {
            Some(value) if !value.is_finite() => Err(GuardError::NotFinite(value)),
            value => Ok(value),
        }
    }
}

impl Guard for NetworkGuard {
    fn name(&self) -> &str {
        self.name
    }

    fn limits(&self) -> BrakeLimits {
        self.limits
    }

    fn watch(&mut self, now: &Watched<'_>) -> Result<Option<f64>, GuardError> {
        let last = self.last.replace(now.at);
        let is_new = last.is_none_or(|last| now.at < last || now.at - last > LONGEST_GAP);
        if is_new {
            self.forget();
        } else if now.at + EARLY < self.due {
            // Frames come faster than those that it learnt from: it looks at as many a second.
            return Ok(None);
        }
        self.due = if is_new { now.at + APART } else { (self.due + APART).max(now.at + APART / 2) };
        let speed_kmh = now.speed.metres_per_second().get() / MPS_PER_KMH;
        self.look(now.frame, if speed_kmh.is_finite() { speed_kmh } else { NO_SPEED })
    }

    fn reset(&mut self) {
        self.forget();
        self.last = None; // and so the next frame is due
    }
}

#[cfg(test)]
mod tests {
    use tch::{Device, nn::VarStore};

    use super::*;
    use crate::{
        braking::{
            SpeedFailure, episodes,
            episodes::{
                Drive,
                tests::{shipped_run, shipped_runs},
            },
        },
        nn::{
            Precision,
            braking::{BrakingMetadata, save_braking},
            in_variable_store,
        },
    };
    use lapwing_core::{
        config::ControlSettings,
        driver::Driver,
        pilot::ConstantPilot,
        protocol::{CameraImage, Observation, Sight},
        recording::{EventRecord, Picture, Recording},
        units::{Mph, Steering},
    };

    fn model(threshold: Option<f64>) -> (tempfile::TempDir, BrakingModel) {
        changed(threshold, BrakeLimits { fires: 0.5, releases: 0.2 }, |_| {})
    }

    /// A model of random weights, changed.
    fn changed(
        threshold: Option<f64>,
        limits: BrakeLimits,
        change: impl Fn(&BrakingNetwork),
    ) -> (tempfile::TempDir, BrakingModel) {
        tch::manual_seed(5);
        let store = VarStore::new(Device::Cpu);
        let architecture = BrakingArchitecture::Live;
        let network = BrakingNetwork::build(architecture, &mut in_variable_store(store.root())).unwrap();
        tch::no_grad(|| change(&network));
        let (training, result) = ("none".to_owned(), "none".to_owned());
        let metadata = BrakingMetadata { preprocess: architecture.preprocess(), limits, training, result };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("brake.safetensors");
        save_braking(&path, &metadata, &network, Precision::F32).unwrap();
        let model = BrakingModel::load(&path, threshold).unwrap();
        (dir, model)
    }

    /// At which of so many frames at a rate it has something to say.
    fn says(guard: &mut dyn Guard, hz: f64, frames: u32, from: Duration) -> Vec<u32> {
        let frame = Frame::new(320, 160, vec![90; 320 * 160 * 3]).unwrap();
        let mut at = |i: &u32| {
            let at = from + Duration::from_secs_f64(f64::from(*i) / hz);
            let now =
                Watched { at, frame: &frame, speed: Mph::new(20.0).unwrap(), time_to_collision_s: None, gap_m: None };
            guard.watch(&now).unwrap().is_some()
        };
        (0..frames).filter(|i| at(i)).collect()
    }

    #[test]
    fn it_speaks_from_the_twentieth_frame_on_and_again_after_a_gap_or_a_reset() {
        let (_dir, model) = model(None);
        let mut guard = model.guard();
        assert_eq!(says(&mut *guard, 15.0, 22, Duration::ZERO), [19, 20, 21]);
        assert_eq!(says(&mut *guard, 15.0, 20, Duration::from_secs(10)), [19], "the gap is forgotten");
        guard.reset();
        assert_eq!(says(&mut *guard, 15.0, 19, Duration::from_secs(11)), [0; 0]);
    }

    #[test]
    fn of_faster_frames_it_looks_at_as_many_as_it_learnt_from() {
        let (_dir, model) = model(None);
        assert_eq!(says(&mut *model.guard(), 60.0, 85, Duration::ZERO), [76, 80, 84]);
    }

    #[test]
    fn of_frames_whose_time_is_told_in_steps_of_20_ms_it_looks_at_each() {
        let (_dir, model) = model(None);
        let mut guard = model.guard();
        let frame = Frame::new(320, 160, vec![90; 320 * 160 * 3]).unwrap();
        let mut says = |i: u64| {
            let at = Duration::from_millis(i * 50 / 15 * 20);
            let now =
                Watched { at, frame: &frame, speed: Mph::new(20.0).unwrap(), time_to_collision_s: None, gap_m: None };
            guard.watch(&now).unwrap().is_some()
        };
        assert!((0..60).all(|i| says(i) == (i >= 19)));
    }

    /// Brings what a network of random weights says of a drive, once it drives, to a mean of nought and a deviation of two, before
    /// the sigmoid: so it says everything, and often something else.
    fn enliven(network: &BrakingNetwork, drive: &Drive) {
        let said = &episodes(network, std::slice::from_ref(drive), SpeedFailure::NONE, |_| {}).unwrap()[0];
        let scale = |values: &[f64]| {
            let logits: Vec<f64> = values[60..].iter().map(|value| (value / (1.0 - value)).ln()).collect();
            let mean = logits.iter().sum::<f64>() / logits.len() as f64;
            let variance = logits.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / logits.len() as f64;
            [2.0 / variance.sqrt(), mean]
        };
        for (row, [factor, mean]) in [scale(&said.values), scale(&said.blocked)].into_iter().enumerate() {
            for (name, tensor) in network.tensors() {
                let mut part = match name.as_str() {
                    "fc2.weight" | "fc2.bias" => tensor.narrow(0, row as i64, 1),
                    _ => continue,
                };
                if name == "fc2.bias" {
                    let _ = part.g_sub_scalar_(mean);
                }
                let _ = part.g_mul_scalar_(factor);
            }
        }
    }

    #[test]
    fn in_a_drive_it_brakes_where_the_evaluation_says_that_it_would() {
        let limits = BrakeLimits { fires: 0.6, releases: 0.45 };
        let drive = shipped_run();
        let (_dir, model) = changed(None, limits, |network| enliven(network, &drive));
        let judged = episodes(&model.network(), &[drive], SpeedFailure::NONE, |_| {}).unwrap();
        let said = judged[0].activations(limits);

        let pilot = Box::new(ConstantPilot::new(Steering::ZERO));
        let mut driver =
            Driver::new(pilot, &ControlSettings::default(), std::time::Instant::now).guarded(Some(model.guard()));
        let (mut began, mut ended) = (vec![], 0);
        for (i, moment) in Recording::open(shipped_runs().join("lake.mcap")).unwrap().map(Result::unwrap).enumerate() {
            let Some(Picture::Jpeg(jpeg)) = &moment.pictures[0] else { panic!("a run has pictures") };
            let telemetry = lapwing_core::protocol::Telemetry {
                image: CameraImage::Jpeg(jpeg.clone()),
                ..moment.telemetry.clone()
            };
            let (_, trace) = driver.drive(&Observation { at: moment.at, sight: Sight::Telemetry(telemetry) });
            began.extend(trace.events.iter().filter(|e| matches!(e, EventRecord::GuardBrakes { .. })).map(|_| i));
            ended += trace.events.iter().filter(|e| matches!(e, EventRecord::GuardReleases { .. })).count();
            assert_eq!(trace.brake_due.is_some(), judged[0].values[i].is_finite(), "moment {i}");
        }
        assert_eq!(began, said);
        assert!(began.len() >= 2 && ended >= 2, "{began:?} {ended} {:?}", judged[0].values);
    }

    #[test]
    fn a_threshold_that_the_network_can_never_reach_is_refused() {
        let (dir, _) = model(Some(1.0));
        let error = BrakingModel::load(&dir.path().join("brake.safetensors"), Some(2.0)).unwrap_err().to_string();
        let expected = "expected a threshold of at most 1, as a brake-live network says no more, got 2";
        assert!(error.ends_with(expected), "{error}");
    }

    #[test]
    fn a_file_that_holds_no_braking_network_is_refused_with_what_holds_one() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("brake.toml");
        std::fs::write(&path, "network = \"brake-live\"\n").unwrap();
        let error = BrakingModel::load(&path, None).unwrap_err().to_string();
        assert!(error.ends_with("a braking network is a .safetensors file of lapwing brake train"), "{error}");
    }

    #[test]
    fn a_threshold_of_ones_own_keeps_the_ratio_of_the_limits() {
        let (_dir, model) = model(Some(0.8));
        let BrakeLimits { fires, releases } = model.limits();
        assert!((fires - 0.8).abs() < 1e-12 && (releases - 0.32).abs() < 1e-12, "{fires} {releases}");
    }
}
