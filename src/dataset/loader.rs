//! From samples to batches of numbers, ahead of whoever learns from them.

use std::{
    collections::BTreeMap,
    sync::{
        Arc, OnceLock,
        atomic::{AtomicUsize, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread,
};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::{Augmentation, Camera, Change, DatasetError, Samples};
use crate::perception::{Crop, Frame, Preprocess, Preprocessor, decode_jpeg};

/// What a network takes.
#[derive(Debug, Clone, PartialEq)]
pub struct Inputs {
    /// From a picture to (C, H, W).
    pub preprocess: Preprocess,
    /// Pictures in a sequence, T; 1 for networks that look at one.
    pub frames: usize,
}

/// So many samples, ready for a network.
#[derive(Debug)]
pub struct Batch {
    /// (B, T, C, H, W), flat.
    pub frames: Vec<f32>,
    /// B.
    pub size: usize,
    /// (B), after augmentation.
    pub steering: Vec<f32>,
    /// (B), -1 to 1.
    pub acceleration: Vec<f32>,
    /// (B).
    pub speed_mph: Vec<f32>,
    /// (B), which samples these are.
    pub samples: Vec<u32>,
}

/// Decoded pictures, kept as long as there is room. A picture of 320x160 takes 150 KiB.
#[derive(Debug)]
pub struct Cache {
    /// Number of the first slot of each source; a row has one for each camera.
    first: Vec<usize>,
    slots: Vec<OnceLock<Frame>>,
    room: AtomicUsize,
}

impl Cache {
    /// Room for `bytes` of the pictures of these samples; 0 keeps none.
    pub fn new(samples: &Samples, bytes: usize) -> Arc<Self> {
        let mut first = vec![];
        let mut count = 0;
        for source in &samples.sources {
            first.push(count);
            count += source.rows.len() * Camera::ALL.len();
        }
        let slots = if bytes == 0 { 0 } else { count };
        Arc::new(Self { first, slots: (0..slots).map(|_| OnceLock::new()).collect(), room: bytes.into() })
    }

    fn slot(&self, source: u32, row: usize, camera: Camera) -> Option<&OnceLock<Frame>> {
        self.slots.get(self.first[source as usize] + row * Camera::ALL.len() + camera as usize)
    }

    /// Whether there was room for so much more.
    fn take(&self, bytes: usize) -> bool {
        self.room.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |room| room.checked_sub(bytes)).is_ok()
    }
}

/// An iterator over the batches of an epoch, made on threads of its own.
///
/// Order and augmentation follow from `order`, the seed and the epoch alone, whatever the number of threads.
pub struct Loader {
    receiver: Receiver<(usize, Result<Batch, DatasetError>)>,
    early: BTreeMap<usize, Result<Batch, DatasetError>>,
    next: usize,
    batches: usize,
}

/// What the threads share.
struct Plan {
    samples: Arc<Samples>,
    cache: Arc<Cache>,
    inputs: Inputs,
    augmentation: Augmentation,
    order: Vec<u32>,
    batch: usize,
    seed: u64,
    epoch: u64,
    next: AtomicUsize,
}

impl Loader {
    /// Starts at batch `from` of the epoch; the batches before it are passed over. The last one may be smaller.
    #[expect(clippy::too_many_arguments, reason = "one call, and each is another thing")]
    pub fn start(
        samples: Arc<Samples>,
        cache: Arc<Cache>,
        inputs: Inputs,
        augmentation: Augmentation,
        order: Vec<u32>,
        batch: usize,
        (seed, epoch, from): (u64, u64, usize),
        threads: usize,
    ) -> Result<Self, DatasetError> {
        let batches = order.len().div_ceil(batch);
        let preprocessor = preprocessor(&inputs.preprocess)?;
        let plan = Plan { samples, cache, inputs, augmentation, order, batch, seed, epoch, next: from.into() };
        let plan = Arc::new(plan);
        let (sender, receiver) = sync_channel(threads.max(1));
        for _ in 0..threads.max(1) {
            let (plan, sender) = (Arc::clone(&plan), sender.clone());
            let worker = Worker::new(preprocessor.clone());
            thread::spawn(move || worker.run(&plan, &sender));
        }
        Ok(Self { receiver, early: BTreeMap::new(), next: from, batches })
    }

    /// Batches of the whole epoch.
    pub fn batches(&self) -> usize {
        self.batches
    }
}

impl Iterator for Loader {
    type Item = Result<Batch, DatasetError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.next < self.batches {
            if let Some(batch) = self.early.remove(&self.next) {
                self.next += 1;
                return Some(batch);
            }
            // The threads go on until all batches are made; that they are gone before means that one has panicked.
            let (number, batch) = self.receiver.recv().ok()?;
            self.early.insert(number, batch);
        }
        None
    }
}

/// The preprocessing of what an augmentation has already cropped.
fn preprocessor(preprocess: &Preprocess) -> Result<Preprocessor, DatasetError> {
    Preprocessor::new(Preprocess { crop: None, ..preprocess.clone() })
        .map_err(|why| DatasetError::Preprocess { picture: "the network's preprocessing".into(), why })
}

/// The scratch memory of one thread.
struct Worker {
    preprocessor: Preprocessor,
    decoded: Frame,
    changed: Frame,
    input: Vec<f32>,
}

impl Worker {
    fn new(preprocessor: Preprocessor) -> Self {
        Self { preprocessor, decoded: Frame::default(), changed: Frame::default(), input: Vec::new() }
    }

    fn run(mut self, plan: &Plan, sender: &SyncSender<(usize, Result<Batch, DatasetError>)>) {
        loop {
            let number = plan.next.fetch_add(1, Ordering::Relaxed);
            let from = number * plan.batch;
            if from >= plan.order.len() {
                return;
            }
            let until = (from + plan.batch).min(plan.order.len());
            let batch = self.batch(plan, from, until);
            if sender.send((number, batch)).is_err() {
                return; // nobody wants more
            }
        }
    }

    fn batch(&mut self, plan: &Plan, from: usize, until: usize) -> Result<Batch, DatasetError> {
        let size = until - from;
        let numbers: usize = plan.inputs.preprocess.shape().iter().product();
        let (steering, acceleration, speed_mph) =
            (Vec::with_capacity(size), Vec::with_capacity(size), Vec::with_capacity(size));
        let frames = Vec::with_capacity(size * plan.inputs.frames * numbers);
        let samples = plan.order[from..until].to_vec();
        let mut batch = Batch { frames, size, steering, acceleration, speed_mph, samples };
        for place in from..until {
            let sample = &plan.samples.samples[plan.order[place] as usize];
            let mut random = ChaCha8Rng::seed_from_u64(plan.seed ^ 0xa0_6d3e_17e5);
            random.set_stream(plan.epoch);
            random.set_word_pos(place as u128 * 64);
            let change = plan.augmentation.draw(&mut random);
            let source = &plan.samples.sources[sample.source as usize];
            for row in source.sequence(sample.row as usize, plan.inputs.frames) {
                self.picture(plan, sample.source, row, sample.camera, &change)?;
                batch.frames.extend_from_slice(&self.input);
            }
            batch.steering.push(change.steering(sample.steering) as f32);
            batch.acceleration.push(sample.acceleration as f32);
            batch.speed_mph.push(sample.speed.get() as f32);
        }
        Ok(batch)
    }

    /// Makes (C, H, W) of a picture in `self.input`.
    fn picture(
        &mut self,
        plan: &Plan,
        source: u32,
        row: usize,
        camera: Camera,
        change: &Change,
    ) -> Result<(), DatasetError> {
        let Some(picture) = &plan.samples.sources[source as usize].rows[row].pictures[camera as usize] else {
            let why = format!("row {row} has no picture of the camera {camera:?}, but rows after it have");
            return Err(DatasetError::Picture { picture: "a sequence".into(), why });
        };
        let slot = plan.cache.slot(source, row, camera);
        let frame = match slot.and_then(OnceLock::get) {
            Some(frame) => frame,
            None => {
                let bytes = picture.read()?;
                decode_jpeg(&bytes, &mut self.decoded)
                    .map_err(|why| DatasetError::Image { picture: picture.name(), why })?;
                if let Some(slot) = slot
                    && plan.cache.take(self.decoded.rgb().len())
                {
                    // Another thread may have come first; then this copy is dropped.
                    let _ = slot.set(self.decoded.clone());
                }
                &self.decoded
            }
        };
        let crop = plan.inputs.preprocess.crop.unwrap_or(Crop { top: 0, bottom: frame.height() });
        if crop.bottom > frame.height() {
            let why = crate::perception::PreprocessError::CropOutside {
                bottom: crop.bottom,
                width: frame.width(),
                height: frame.height(),
            };
            return Err(DatasetError::Preprocess { picture: picture.name(), why });
        }
        change.apply(frame, crop, &mut self.changed);
        self.preprocessor
            .apply(&self.changed, &mut self.input)
            .map_err(|why| DatasetError::Preprocess { picture: picture.name(), why })
    }
}
