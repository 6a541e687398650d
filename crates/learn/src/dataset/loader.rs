//! Loads samples as batches of numbers, ahead of the training.

mod worker;

use std::{
    collections::BTreeMap,
    mem,
    ops::Deref,
    sync::{
        Arc, Mutex, OnceLock,
        atomic::{AtomicUsize, Ordering},
        mpsc::{Receiver, Sender, channel},
    },
    thread,
};

use half::bf16;

use self::worker::{LoadPlan, Worker};
use super::{
    Augmentation, CameraPosition, DatasetError, Label, Samples,
    strip::{Strip, StripCut},
};
use lapwing_core::perception::{Preprocess, Preprocessor};

/// A network's inputs, and their form.
#[derive(Debug, Clone, PartialEq)]
pub struct Inputs {
    /// From a picture to (C, H, W).
    pub preprocess: Preprocess,
    /// Pictures in a sequence, T; 1 for networks that look at one.
    pub frames: usize,
    /// Whether numbers have 16 bits, rounded to the nearest, instead of 32.
    pub bf16: bool,
    /// Whether memory holds pixel by pixel, (H, W, C), instead of channel by channel.
    pub channels_last: bool,
}

impl Inputs {
    /// 32 bits, channel by channel, as pilots use.
    pub fn plain(preprocess: Preprocess, frames: usize) -> Self {
        Self { preprocess, frames, bf16: false, channels_last: false }
    }
}

/// The numbers of a batch of pictures.
#[derive(Debug, Clone, PartialEq)]
pub enum Numbers {
    /// Of 32 bits.
    F32(Vec<f32>),
    /// Of 16 bits.
    Bf16(Vec<bf16>),
}

/// The memory of a batch's pictures; when it is dropped, another batch reuses it. Allocating ten megabytes costs as
/// much as writing to them.
#[derive(Debug)]
pub struct Frames {
    numbers: Numbers,
    spare: Arc<Mutex<Vec<Numbers>>>,
}

impl Frames {
    /// Memory for `count` numbers of unspecified value.
    fn take(spare: &Arc<Mutex<Vec<Numbers>>>, bf16: bool, count: usize) -> Self {
        let numbers = match (spare.lock().ok().and_then(|mut spare| spare.pop()), bf16) {
            (Some(Numbers::F32(mut all)), false) => {
                all.resize(count, 0.0);
                Numbers::F32(all)
            }
            (Some(Numbers::Bf16(mut all)), true) => {
                all.resize(count, bf16::ZERO);
                Numbers::Bf16(all)
            }
            (_, false) => Numbers::F32(vec![0.0; count]),
            (_, true) => Numbers::Bf16(vec![bf16::ZERO; count]),
        };
        Self { numbers, spare: Arc::clone(spare) }
    }
}

impl Deref for Frames {
    type Target = Numbers;

    fn deref(&self) -> &Numbers {
        &self.numbers
    }
}

impl Drop for Frames {
    fn drop(&mut self) {
        let numbers = mem::replace(&mut self.numbers, Numbers::F32(vec![]));
        if let Ok(mut spare) = self.spare.lock() {
            spare.push(numbers);
        }
    }
}

/// Samples ready for a network.
#[derive(Debug)]
pub struct Batch {
    /// (B, T, C, H, W), flat; (B, T, H, W, C) if channels are last.
    pub frames: Frames,
    /// B.
    pub size: usize,
    /// (B), after augmentation.
    pub steering: Vec<f32>,
    /// (B), -1 to 1.
    pub acceleration: Vec<f32>,
    /// (B), metres that the camera is to the right of its lane's middle; not a number where that is not known.
    pub offset_m: Vec<f32>,
    /// (B), degrees clockwise from the lane's direction, likewise.
    pub heading_deg: Vec<f32>,
    /// (B).
    pub speed_mph: Vec<f32>,
    /// (B), which samples these are.
    pub samples: Vec<u32>,
}

impl Batch {
    /// (B), what is to be learnt.
    pub fn labels(&self, label: Label) -> &[f32] {
        match label {
            Label::Steering => &self.steering,
            Label::Acceleration => &self.acceleration,
            Label::OffsetM => &self.offset_m,
            Label::HeadingDeg => &self.heading_deg,
        }
    }
}

/// Decoded pictures at the network's input size, with the rows that shifts bring in, kept as long as there is room. For
/// PilotNet a picture takes 39 KiB, or 60 KiB with Lu's shifts of 20 pixels.
///
/// A cache belongs to one kind of inputs and one reach of shifts; entries made for others are not used.
#[derive(Debug)]
pub struct Cache {
    /// Number of the first slot of each source; a row has a slot for each camera.
    first: Vec<usize>,
    slots: Vec<OnceLock<Strip>>,
    room: AtomicUsize,
    /// Memory of finished batches.
    spare: Arc<Mutex<Vec<Numbers>>>,
}

impl Cache {
    /// Room for `bytes` of the pictures of these samples; 0 keeps none.
    pub fn new(samples: &Samples, bytes: usize) -> Arc<Self> {
        let mut first = vec![];
        let mut count = 0;
        for source in &samples.sources {
            first.push(count);
            count += source.rows.len() * CameraPosition::ALL.len();
        }
        let slots = if bytes == 0 { 0 } else { count };
        Arc::new(Self {
            first,
            slots: (0..slots).map(|_| OnceLock::new()).collect(),
            room: bytes.into(),
            spare: Arc::default(),
        })
    }

    fn slot(&self, source: u32, row: usize, camera: CameraPosition) -> Option<&OnceLock<Strip>> {
        self.slots.get(self.first[source as usize] + row * CameraPosition::ALL.len() + camera as usize)
    }

    /// Reserves this many bytes; returns whether there was room.
    fn take(&self, bytes: usize) -> bool {
        self.room.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |room| room.checked_sub(bytes)).is_ok()
    }
}

/// An iterator over the batches of an epoch, made on threads of its own.
///
/// Order and augmentation depend only on `order`, the seed and the epoch, whatever the number of threads.
pub struct Loader {
    /// Numbers of batches for the threads to make, `None` once there are no more.
    orders: Option<Sender<usize>>,
    receiver: Receiver<(usize, Result<Batch, DatasetError>)>,
    early: BTreeMap<usize, Result<Batch, DatasetError>>,
    /// The batch to yield next, the one to order next, and the one after the last.
    next: usize,
    ordered: usize,
    batches: usize,
    workers: Workers,
}

/// The threads that make batches, and when they work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Workers {
    /// How many threads; at least one.
    pub threads: usize,
    /// Whether they work while the network does: right if it computes on another device. On the same processor it is
    /// faster to alternate, a batch for each thread at a time: libtorch's threads wait for each other at every
    /// operation, and a delayed one delays all.
    pub beside: bool,
}

impl Workers {
    /// A thread for each processor; alongside the network, or in turn with it.
    pub fn all(beside: bool) -> Self {
        Self { threads: thread::available_parallelism().map_or(1, usize::from), beside }
    }
}

impl Loader {
    /// Starts at batch `from` of the epoch; the batches before it are skipped. The last one may be smaller.
    ///
    /// # Errors
    /// [`DatasetError::Preprocess`] for invalid preprocessing, [`DatasetError::Setting`] for augmentations or memory pixel by
    /// pixel where it takes steps that leave no room for them ([`Preprocess::is_plain`]), [`DatasetError::Thread`] if the system cannot start
    /// threads.
    #[expect(clippy::too_many_arguments, reason = "one call, and each is another thing")]
    pub fn start(
        samples: Arc<Samples>,
        cache: Arc<Cache>,
        inputs: Inputs,
        augmentation: Augmentation,
        order: Vec<u32>,
        batch: usize,
        (seed, epoch, from): (u64, u64, usize),
        workers: Workers,
    ) -> Result<Self, DatasetError> {
        let batches = order.len().div_ceil(batch);
        let preprocessor = Preprocessor::new(inputs.preprocess.clone())
            .map_err(|why| DatasetError::Preprocess { picture: "the network's preprocessing".into(), why })?;
        if !inputs.preprocess.is_plain() && (augmentation != Augmentation::none() || inputs.channels_last) {
            let (name, expected) =
                ("augment", "none for a network with the steps of OpenCV or Pillow in its preprocessing");
            return Err(DatasetError::Setting { name, expected, got: "some".into() });
        }
        if augmentation.late > 0.0 && samples.sources.iter().any(|source| source.places.is_empty()) {
            let (name, expected) = ("augment.late", "0 unless it was asked where the car was (Samples::place)");
            return Err(DatasetError::Setting { name, expected, got: augmentation.late.to_string() });
        }
        let reach_px = if augmentation.translate > 0.0 { augmentation.translate_y_px } else { 0 };
        let cut = StripCut { preprocess: inputs.preprocess.clone(), reach_px };
        let plan = Arc::new(LoadPlan { samples, cache, inputs, cut, augmentation, order, batch, seed, epoch });
        let (orders, ordered) = channel();
        let ordered = Arc::new(Mutex::new(ordered));
        let (sender, receiver) = channel();
        for _ in 0..workers.threads.max(1) {
            let (plan, ordered, sender) = (Arc::clone(&plan), Arc::clone(&ordered), sender.clone());
            let worker = Worker::new(preprocessor.clone());
            thread::Builder::new()
                .spawn(move || worker.run(&plan, &ordered, &sender))
                .map_err(|why| DatasetError::Thread { what: why.to_string() })?;
        }
        let orders = Some(orders);
        let mut loader = Self { orders, receiver, early: BTreeMap::new(), next: from, ordered: from, batches, workers };
        loader.order();
        Ok(loader)
    }

    /// Batches of the whole epoch.
    pub fn batches(&self) -> usize {
        self.batches
    }

    /// Orders batches: enough for each thread never to be idle, or one for each once all are used up.
    fn order(&mut self) {
        let threads = self.workers.threads.max(1);
        let until = match self.workers.beside {
            true => self.next + AHEAD * threads,
            false if self.next == self.ordered => self.next + threads,
            false => self.ordered,
        };
        while self.ordered < until.min(self.batches)
            && let Some(orders) = &self.orders
            && orders.send(self.ordered).is_ok()
        {
            self.ordered += 1;
        }
        if self.ordered >= self.batches {
            self.orders = None; // the threads may end
        }
    }
}

/// Batches that each thread is ahead of a network on another device.
const AHEAD: usize = 2;

impl Iterator for Loader {
    type Item = Result<Batch, DatasetError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.next >= self.batches {
            return None;
        }
        self.order();
        // In turn means that no thread works while the network does.
        let wanted = if self.workers.beside { 1 } else { self.ordered - self.next };
        while self.early.len() < wanted || !self.early.contains_key(&self.next) {
            let Ok((number, batch)) = self.receiver.recv() else {
                self.next = self.batches;
                return Some(Err(DatasetError::Thread { what: "all have ended too early".into() }));
            };
            self.early.insert(number, batch);
        }
        let batch = self.early.remove(&self.next);
        self.next += 1;
        batch
    }
}
