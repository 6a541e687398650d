//! Loads samples as batches of numbers, ahead of the training.

use std::{
    any::Any,
    collections::BTreeMap,
    mem,
    ops::{Deref, Range},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc, Mutex, OnceLock,
        atomic::{AtomicUsize, Ordering},
        mpsc::{Receiver, Sender, channel},
    },
    thread,
};

use half::bf16;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::{
    Augmentation, AugmentationDraw, CameraPosition, DatasetError, Samples,
    strip::{Strip, StripCut},
};
use lapwing_core::perception::{Frame, Preprocess, Preprocessor, decode_jpeg};

/// What a network takes, and in what form.
#[derive(Debug, Clone, PartialEq)]
pub struct Inputs {
    /// From a picture to (C, H, W).
    pub preprocess: Preprocess,
    /// Pictures in a sequence, T; 1 for networks that look at one.
    pub frames: usize,
    /// Numbers of 16 bits, rounded to the nearest, in the place of 32.
    pub bf16: bool,
    /// Pixel by pixel in memory, (H, W, C), in the place of channel by channel.
    pub channels_last: bool,
}

impl Inputs {
    /// 32 bits, channel by channel: as a pilot has it.
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

/// The memory of a batch's pictures: when it is dropped, another batch takes it over. Fresh memory of ten megabytes
/// costs as much as what is written to it.
#[derive(Debug)]
pub struct Frames {
    numbers: Numbers,
    spare: Arc<Mutex<Vec<Numbers>>>,
}

impl Frames {
    /// Memory for so many numbers, which may be anything.
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

/// So many samples, ready for a network.
#[derive(Debug)]
pub struct Batch {
    /// (B, T, C, H, W), flat; (B, T, H, W, C) where pixels lie channels last.
    pub frames: Frames,
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

/// Decoded pictures at the size that the network takes, with the rows that shifts bring in, kept as long as there is
/// room. For PilotNet a picture takes 39 KiB, 60 KiB where it is shifted by Lu's 20 pixels.
///
/// A cache belongs to one kind of inputs and one reach of shifts; what was kept for others is not used.
#[derive(Debug)]
pub struct Cache {
    /// Number of the first slot of each source; a row has one for each camera.
    first: Vec<usize>,
    slots: Vec<OnceLock<Strip>>,
    room: AtomicUsize,
    /// Memory of batches that are used up.
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

    /// Whether there was room for so much more.
    fn take(&self, bytes: usize) -> bool {
        self.room.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |room| room.checked_sub(bytes)).is_ok()
    }
}

/// An iterator over the batches of an epoch, made on threads of its own.
///
/// Order and augmentation follow from `order`, the seed and the epoch alone, whatever the number of threads.
pub struct Loader {
    /// Numbers of batches for the threads to make, `None` once there are no more.
    orders: Option<Sender<usize>>,
    receiver: Receiver<(usize, Result<Batch, DatasetError>)>,
    early: BTreeMap<usize, Result<Batch, DatasetError>>,
    /// The batch that is given out next, the one that is ordered next, and the one after the last.
    next: usize,
    ordered: usize,
    batches: usize,
    workers: Workers,
}

/// Who makes batches, and when.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Workers {
    /// How many threads; at least one.
    pub threads: usize,
    /// Whether they work on while the network does: right where it computes on another device. On the same processor
    /// they are better at their best in turn, a batch for each thread at a time: libtorch's threads wait for each other
    /// at every operation, and one that is held up holds up all.
    pub beside: bool,
}

impl Workers {
    /// A thread for each processor; beside the network, or in turn with it.
    pub fn all(beside: bool) -> Self {
        Self { threads: thread::available_parallelism().map_or(1, usize::from), beside }
    }
}

/// What the threads share.
struct LoadPlan {
    samples: Arc<Samples>,
    cache: Arc<Cache>,
    inputs: Inputs,
    cut: StripCut,
    augmentation: Augmentation,
    order: Vec<u32>,
    batch: usize,
    seed: u64,
    epoch: u64,
}

impl Loader {
    /// Starts at batch `from` of the epoch; the batches before it are passed over. The last one may be smaller.
    ///
    /// # Errors
    /// [`DatasetError::Preprocess`] for a preprocessing that cannot be, [`DatasetError::Thread`] where the system has no
    /// threads to give.
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

    /// Has batches made: so many for each thread that it is never without, or one for each once all are used up.
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
        // In turn means that nobody works on once the network does.
        let wanted = if self.workers.beside { 1 } else { self.ordered - self.next };
        while self.early.len() < wanted || !self.early.contains_key(&self.next) {
            let Ok((number, batch)) = self.receiver.recv() else {
                self.next = self.batches;
                return Some(Err(DatasetError::Thread { what: "all have ended before their time".into() }));
            };
            self.early.insert(number, batch);
        }
        let batch = self.early.remove(&self.next);
        self.next += 1;
        batch
    }
}

/// The scratch memory of one thread.
struct Worker {
    preprocessor: Preprocessor,
    decoded: Frame,
    strip: Strip,
    /// Red, green and blue of one row.
    row: [Vec<f32>; 3],
    /// The network's channels of one row.
    channels: Vec<Vec<f32>>,
}

impl Worker {
    fn new(preprocessor: Preprocessor) -> Self {
        let [channels, _, width] = preprocessor.preprocess().shape();
        Self {
            preprocessor,
            decoded: Frame::default(),
            strip: Strip::default(),
            row: Default::default(),
            channels: vec![vec![0.0; width]; channels],
        }
    }

    fn run(
        mut self,
        plan: &LoadPlan,
        orders: &Mutex<Receiver<usize>>,
        sender: &Sender<(usize, Result<Batch, DatasetError>)>,
    ) {
        loop {
            // Only held while waiting, where nothing panics.
            let Ok(Ok(number)) = orders.lock().map(|orders| orders.recv()) else { return };
            let from = number * plan.batch;
            let range = from..(from + plan.batch).min(plan.order.len());
            // Whoever waits for this batch is told, and not left to wait.
            let batch = catch_unwind(AssertUnwindSafe(|| self.batch(plan, range)))
                .unwrap_or_else(|panic| Err(DatasetError::Thread { what: said(&*panic) }));
            if sender.send((number, batch)).is_err() {
                return; // nobody wants more
            }
        }
    }

    fn batch(&mut self, plan: &LoadPlan, range: Range<usize>) -> Result<Batch, DatasetError> {
        let size = range.len();
        let (mut steering, mut acceleration, mut speed_mph) =
            (Vec::with_capacity(size), Vec::with_capacity(size), Vec::with_capacity(size));
        let numbers: usize = plan.inputs.preprocess.shape().iter().product();
        let count = size * plan.inputs.frames * numbers;
        let mut frames = Frames::take(&plan.cache.spare, plan.inputs.bf16, count);
        let samples = plan.order[range.clone()].to_vec();
        for (i, place) in range.enumerate() {
            let sample = &plan.samples.samples[plan.order[place] as usize];
            let mut random = ChaCha8Rng::seed_from_u64(plan.seed ^ 0xa0_6d3e_17e5);
            random.set_stream(plan.epoch);
            random.set_word_pos(place as u128 * 64);
            let change = plan.augmentation.draw(&mut random);
            let source = &plan.samples.sources[sample.source as usize];
            let mut scale = 1.0;
            for (t, row) in source.sequence(sample.row as usize, plan.inputs.frames).enumerate() {
                let at = (i * plan.inputs.frames + t) * numbers;
                let (out, picture) = (at..at + numbers, (sample.source, row, sample.camera));
                scale = match &mut frames.numbers {
                    Numbers::F32(all) => self.picture(plan, picture, &change, &mut all[out], |x| x),
                    Numbers::Bf16(all) => self.picture(plan, picture, &change, &mut all[out], rounded),
                }?;
            }
            steering.push(change.steering(sample.steering, scale) as f32);
            acceleration.push(sample.acceleration as f32);
            speed_mph.push(sample.speed.get() as f32);
        }
        Ok(Batch { frames, size, steering, acceleration, speed_mph, samples })
    }

    /// Makes the numbers of a picture, and says how many recorded pixels across one of the network's is.
    fn picture<T>(
        &mut self,
        plan: &LoadPlan,
        (source, row, camera): (u32, usize, CameraPosition),
        change: &AugmentationDraw,
        out: &mut [T],
        number: impl Fn(f32) -> T,
    ) -> Result<f64, DatasetError> {
        let Some(picture) = &plan.samples.sources[source as usize].rows[row].pictures[camera as usize] else {
            let why = format!("row {row} has no picture of the camera {camera:?}, but rows after it have");
            return Err(DatasetError::Picture { picture: "a sequence".into(), why });
        };
        let slot = plan.cache.slot(source, row, camera);
        let strip = match slot.and_then(OnceLock::get) {
            Some(strip) if strip.is_of(&plan.cut) => strip,
            _ => {
                let bytes = super::read(picture)?;
                decode_jpeg(&bytes, &mut self.decoded)
                    .map_err(|why| DatasetError::Image { picture: picture.to_string(), why })?;
                self.strip = Strip::cut(&plan.cut, &mut self.preprocessor, &self.decoded)
                    .map_err(|why| DatasetError::Preprocess { picture: picture.to_string(), why })?;
                if let Some(slot) = slot
                    && plan.cache.take(self.strip.bytes())
                {
                    // Another thread may have come first, or other inputs before; then this copy is dropped.
                    if slot.set(self.strip.clone()).is_err() {
                        plan.cache.room.fetch_add(self.strip.bytes(), Ordering::Relaxed);
                    }
                }
                &self.strip
            }
        };
        let (preprocessor, channels) = (&self.preprocessor, &mut self.channels);
        let (width, plane) = (strip.width(), strip.width() * strip.height());
        change.apply(strip, &mut self.row, |y, rgb| {
            for (channel, row) in channels.iter_mut().enumerate() {
                preprocessor.channel(channel, rgb, row);
            }
            if plan.inputs.channels_last {
                let out = &mut out[y * width * channels.len()..][..width * channels.len()];
                // The usual three are written in one go.
                if let [a, b, c] = &channels[..] {
                    for (((out, a), b), c) in out.chunks_exact_mut(3).zip(a).zip(b).zip(c) {
                        [out[0], out[1], out[2]] = [number(*a), number(*b), number(*c)];
                    }
                } else {
                    for (c, row) in channels.iter().enumerate() {
                        out.iter_mut().skip(c).step_by(channels.len()).zip(row).for_each(|(to, x)| *to = number(*x));
                    }
                }
            } else {
                for (c, row) in channels.iter().enumerate() {
                    let out = &mut out[c * plane + y * width..][..width];
                    out.iter_mut().zip(row).for_each(|(to, x)| *to = number(*x));
                }
            }
        });
        Ok(strip.scale().0)
    }
}

/// To the nearest number of 16 bits, ties to even; `x` is finite.
fn rounded(x: f32) -> bf16 {
    let bits = x.to_bits();
    bf16::from_bits(((bits + 0x7fff + (bits >> 16 & 1)) >> 16) as u16)
}

/// The words of a panic.
fn said(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("no words").to_owned()
}
