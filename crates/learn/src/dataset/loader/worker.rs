//! A thread of the loader: from samples to the numbers of a batch.

use std::{
    any::Any,
    ops::Range,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc, Mutex, OnceLock,
        atomic::Ordering,
        mpsc::{Receiver, Sender},
    },
};

use half::bf16;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::{Batch, Cache, Frames, Inputs, Numbers};
use crate::dataset::{
    self, Augmentation, AugmentationDraw, CameraPosition, DatasetError, Label, Samples,
    places::not_stock,
    strip::{Strip, StripCut},
};
use lapwing_core::perception::{Frame, Preprocessor, decode_jpeg};
use lapwing_sim::along::{Glimpse, Warp};

/// What the threads share.
pub(super) struct LoadPlan {
    pub(super) samples: Arc<Samples>,
    pub(super) cache: Arc<Cache>,
    pub(super) inputs: Inputs,
    pub(super) cut: StripCut,
    pub(super) augmentation: Augmentation,
    pub(super) order: Vec<u32>,
    pub(super) batch: usize,
    pub(super) seed: u64,
    pub(super) epoch: u64,
}

/// The scratch memory of one thread.
pub(super) struct Worker {
    preprocessor: Preprocessor,
    decoded: Frame,
    strip: Strip,
    /// Red, green and blue of one row.
    row: [Vec<f32>; 3],
    /// The network's channels of one row.
    channels: Vec<Vec<f32>>,
    /// (C, H, W), of a whole picture.
    numbers: Vec<f32>,
    /// Moves pictures to where the car is later; made when it is first needed.
    warp: Option<Warp>,
    warped: Frame,
}

impl Worker {
    pub(super) fn new(preprocessor: Preprocessor) -> Self {
        let [channels, _, width] = preprocessor.preprocess().shape();
        Self {
            preprocessor,
            decoded: Frame::default(),
            strip: Strip::default(),
            row: Default::default(),
            channels: vec![vec![0.0; width]; channels],
            numbers: vec![],
            warp: None,
            warped: Frame::default(),
        }
    }

    pub(super) fn run(
        mut self,
        plan: &LoadPlan,
        orders: &Mutex<Receiver<usize>>,
        sender: &Sender<(usize, Result<Batch, DatasetError>)>,
    ) {
        loop {
            // Held only while waiting, where nothing panics.
            let Ok(Ok(number)) = orders.lock().map(|orders| orders.recv()) else { return };
            let from = number * plan.batch;
            let range = from..(from + plan.batch).min(plan.order.len());
            // The receiver of this batch gets an error instead of waiting forever.
            let batch = catch_unwind(AssertUnwindSafe(|| self.batch(plan, range)))
                .unwrap_or_else(|panic| Err(DatasetError::Thread { what: said(&*panic) }));
            if sender.send((number, batch)).is_err() {
                return; // the receiver is gone
            }
        }
    }

    fn batch(&mut self, plan: &LoadPlan, range: Range<usize>) -> Result<Batch, DatasetError> {
        let size = range.len();
        let [mut steering, mut acceleration, mut offset_m, mut heading_deg, mut speed_mph] =
            std::array::from_fn(|_| Vec::with_capacity(size));
        let numbers: usize = plan.inputs.preprocess.shape().iter().product();
        let count = size * plan.inputs.frames * numbers;
        let mut frames = Frames::take(&plan.cache.spare, plan.inputs.bf16, count);
        let samples = plan.order[range.clone()].to_vec();
        for (i, place) in range.enumerate() {
            let sample = &plan.samples.samples[plan.order[place] as usize];
            let mut random = ChaCha8Rng::seed_from_u64(plan.seed ^ 0xa0_6d3e_17e5);
            random.set_stream(plan.epoch);
            random.set_word_pos(place as u128 * 64);
            let source = &plan.samples.sources[sample.source as usize];
            let mut change = plan.augmentation.draw(&mut random);
            change.flip &= source.flip;
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
            offset_m.push(sample.label(Label::OffsetM) as f32);
            heading_deg.push(sample.label(Label::HeadingDeg) as f32);
            speed_mph.push(sample.speed.get() as f32);
        }
        Ok(Batch { frames, size, steering, acceleration, offset_m, heading_deg, speed_mph, samples })
    }

    /// Computes the numbers of a picture; returns how many recorded pixels wide one of the network's is.
    fn picture<T>(
        &mut self,
        plan: &LoadPlan,
        (source, row, camera): (u32, usize, CameraPosition),
        change: &AugmentationDraw,
        out: &mut [T],
        number: impl Fn(f32) -> T,
    ) -> Result<f64, DatasetError> {
        let is_plain = plan.inputs.preprocess.is_plain();
        let from = &plan.samples.sources[source as usize];
        let earlier = from.earlier(row, change.late_s);
        let Some(picture) = &from.rows[earlier.map_or(row, |(then, _)| then)].pictures[camera as usize] else {
            let why = format!("row {row} has no picture of the camera {camera:?}, but rows after it have");
            return Err(DatasetError::Picture { picture: "a sequence".into(), why });
        };
        if !is_plain {
            // Steps that no strip can be changed in between: as pilots see it. `Loader::start` let no augmentation pass.
            let bytes = dataset::read(picture)?;
            decode_jpeg(&bytes, &mut self.decoded)
                .map_err(|why| DatasetError::Image { picture: picture.to_string(), why })?;
            self.preprocessor
                .apply(&self.decoded, &mut self.numbers)
                .map_err(|why| DatasetError::Preprocess { picture: picture.to_string(), why })?;
            out.iter_mut().zip(&self.numbers).for_each(|(to, x)| *to = number(*x));
            return Ok(1.0);
        }
        let slot = plan.cache.slot(source, row, camera).filter(|_| earlier.is_none());
        let strip = match slot.and_then(OnceLock::get) {
            Some(strip) if strip.is_of(&plan.cut) => strip,
            _ => {
                let bytes = dataset::read(picture)?;
                decode_jpeg(&bytes, &mut self.decoded)
                    .map_err(|why| DatasetError::Image { picture: picture.to_string(), why })?;
                let frame = match earlier {
                    None => &self.decoded,
                    Some((_, beside)) => {
                        // What a side camera sees is what the centre one would see from a car that far to the side.
                        let glimpse = Glimpse { pictures: [Some(&self.decoded), None, None], beside };
                        let shown = self.warp.get_or_insert_default().render(&[glimpse], &mut self.warped);
                        shown.ok_or_else(|| not_stock(&self.decoded))?;
                        &self.warped
                    }
                };
                self.strip = Strip::cut(&plan.cut, &mut self.preprocessor, frame)
                    .map_err(|why| DatasetError::Preprocess { picture: picture.to_string(), why })?;
                if let Some(slot) = slot
                    && plan.cache.take(self.strip.bytes())
                {
                    // Another thread may have been first, or the slot may hold other inputs; then this copy is dropped.
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

/// The message of a panic.
fn said(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("no words").to_owned()
}
