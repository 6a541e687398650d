//! What a braking network learns from: windows of an episode, drawn and balanced, and changed as long as the truth stays.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use tch::{Device, Kind, TchError, Tensor};

use super::{
    BrakingRecipe,
    episodes::{BrakingDataError, Drive, Reader},
    targets::{STANDING_KMH, Wanted},
    told::{Telling, Told},
};
use crate::nn::braking::{BrakingArchitecture, FRAMES, NO_SPEED, live};

/// A window begins every so many frames.
pub(super) const STRIDE: usize = 15;

/// The live network's windows are so many frames longer: it answers every second of them, and sees each once.
const MORE: usize = 44;

/// A window is of an emergency if a brake is due by this much in it.
const DUE: f32 = 0.2;
/// Shares of a window's speeds that are unknown, as the paper's table II has them.
pub(super) const FAILURES: [f64; 3] = [0.5, 0.8, 1.0];
/// Pictures become darker or lighter by up to this exponent.
const GAMMA: f64 = 1.5;

/// A window in which nothing matters is no division by nought.
pub(super) const LEAST_WEIGHT: f64 = 1e-6;

/// A window: which drive, and from which frame.
pub(super) type Window = (usize, usize);

/// A batch for the network, of B windows of T frames, N answers and S frames that are seen.
pub(super) struct Batch {
    /// (B, T, H, W), 0 to 255, as bytes until the batch is [`on`](Self::on) the network's device.
    pub frames: Tensor,
    /// (B, T) km/h.
    pub speeds: Tensor,
    /// (B, N) how much a brake is due, and how much each matters.
    pub due: Tensor,
    pub weights: Tensor,
    /// (B, N) whether something is close ahead.
    pub blocked: Tensor,
    /// What is told of the S frames by themselves.
    pub told: Told,
}

impl Batch {
    /// The same batch on a device, with pixels as f32.
    pub(super) fn on(self, device: Device) -> Result<Self, TchError> {
        Ok(Self {
            frames: self.frames.f_to_device(device)?.f_to_kind(Kind::Float)?,
            speeds: self.speeds.f_to_device(device)?,
            due: self.due.f_to_device(device)?,
            weights: self.weights.f_to_device(device)?,
            blocked: self.blocked.f_to_device(device)?,
            told: self.told.on(device)?,
        })
    }
}

/// How many frames a training window has.
pub(super) fn length(architecture: BrakingArchitecture) -> usize {
    match architecture {
        BrakingArchitecture::Stacked => FRAMES,
        BrakingArchitecture::Live => FRAMES + MORE,
    }
}

/// The windows of all drives, those apart whose share is set: of a standing car, or of an emergency.
pub(super) struct Windows {
    pub apart: Vec<Window>,
    pub others: Vec<Window>,
}

impl Windows {
    pub(super) fn of(drives: &[Drive], wanted: &[Vec<Wanted>], recipe: &BrakingRecipe) -> Self {
        let (mut apart, mut others) = (vec![], vec![]);
        let length = length(recipe.network);
        for (d, drive) in drives.iter().enumerate() {
            for from in (0..(drive.frames() + 1).saturating_sub(length)).step_by(STRIDE) {
                let is_apart = match recipe.emergencies {
                    Some(_) => wanted[d][from + FRAMES - 1..from + length].iter().any(|wanted| wanted.due >= DUE),
                    None => drive.speed_kmh[from + length - 1] < STANDING_KMH,
                };
                if is_apart { &mut apart } else { &mut others }.push((d, from));
            }
        }
        Self { apart, others }
    }

    pub(super) fn len(&self) -> usize {
        self.apart.len() + self.others.len()
    }

    /// How much a window matters: standing and moving ones the same in all, whatever their share; others as they come.
    pub(super) fn weights(recipe: &BrakingRecipe, share: f64) -> [f64; 2] {
        if recipe.emergencies.is_some() { [1.0; 2] } else { [0.5 / share, 0.5 / (1.0 - share)] }
    }
}

/// Draws windows.
///
/// Of several that are drawn, the one is taken of which the network knew least when it saw it last, and any that it has not
/// seen before those: most of what is harmless is soon known (online hard example mining: Shrivastava, Gupta and Girshick,
/// 2016).
pub(super) struct Draw {
    windows: [Vec<Window>; 2],
    /// What the network got wrong in each.
    pub losses: [Vec<f32>; 2],
    share: f64,
    rivals: usize,
    random: ChaCha8Rng,
}

/// A window of a draw: which of the two kinds, and which of these.
pub(super) type Card = (usize, usize);

impl Draw {
    pub(super) fn new(windows: Windows, recipe: &BrakingRecipe) -> Self {
        let Windows { apart, others } = windows;
        let unseen = |windows: &Vec<Window>| vec![f32::INFINITY; windows.len()];
        Self {
            losses: [unseen(&apart), unseen(&others)],
            windows: [apart, others],
            share: recipe.emergencies.unwrap_or(recipe.standing),
            rivals: recipe.rivals,
            random: ChaCha8Rng::seed_from_u64(recipe.seed),
        }
    }

    /// Draws by another part of the seed's numbers from here on.
    pub(super) fn begin(&mut self, epoch: usize) {
        self.random.set_stream(epoch as u64);
        self.random.set_word_pos(0);
    }

    /// Sets what the network gets wrong in each window of this length, from its error at each frame of a drive and how much that
    /// matters.
    pub(super) fn judge(&mut self, length: usize, error: impl Fn(usize, usize) -> [f64; 2]) {
        for (windows, losses) in self.windows.iter().zip(&mut self.losses) {
            for ((drive, from), loss) in windows.iter().zip(losses) {
                let frames = (from + FRAMES - 1..from + length).step_by(2);
                let [sum, weight] = frames
                    .map(|frame| error(*drive, frame))
                    .fold([0.0; 2], |[sum, all], [error, weight]| [sum + error * weight, all + weight]);
                *loss = (sum / weight.max(LEAST_WEIGHT)) as f32;
            }
        }
    }

    /// What the network got wrong in these.
    pub(super) fn learnt(&mut self, cards: &[Card], losses: &[f32]) {
        for ((kind, i), loss) in cards.iter().zip(losses) {
            self.losses[*kind][*i] = *loss;
        }
    }

    fn next(&mut self) -> Option<Card> {
        let Self { windows, losses, share, rivals, random } = self;
        let wanted = usize::from(random.random::<f64>() >= *share);
        let kind = if windows[wanted].is_empty() { 1 - wanted } else { wanted };
        let count = windows[kind].len();
        if count == 0 {
            return None;
        }
        let drawn: Vec<usize> = (0..*rivals).map(|_| random.random_range(0..count)).collect();
        let worst = drawn.into_iter().max_by(|a, b| losses[kind][*a].total_cmp(&losses[kind][*b]))?;
        Some((kind, worst))
    }

    /// A batch to learn from, and of which windows.
    pub(super) fn batch(
        &mut self,
        drives: &[Drive],
        wanted: &[Vec<Wanted>],
        recipe: &BrakingRecipe,
        reader: &Reader,
    ) -> Result<Option<(Batch, Vec<Card>)>, BrakingDataError> {
        let (length, weights) = (length(recipe.network), Windows::weights(recipe, self.share));
        let (mut drawn, mut cards) = (vec![], vec![]);
        for _ in 0..recipe.batch {
            let Some((kind, i)) = self.next() else { return Ok(None) };
            let (d, from) = self.windows[kind][i];
            let random = &mut self.random;
            // The live network answers every second frame; which of the two, the draw says.
            let late = usize::from(
                recipe.network != BrakingArchitecture::Stacked
                    && from + length < drives[d].frames()
                    && random.random::<bool>(),
            );
            let unknown = if random.random::<f64>() < recipe.speed_dropout {
                FAILURES[random.random_range(0..FAILURES.len())]
            } else {
                0.0
            };
            let change = Some(Change::draw(recipe, random));
            drawn.push(Drawn { window: (d, from + late), unknown, weight: weights[kind], change });
            cards.push((kind, i));
        }
        Ok(Some((batch(&drawn, drives, wanted, recipe, reader, &mut self.random)?, cards)))
    }
}

/// How the pictures of a window are changed.
pub(super) struct Change {
    pub(super) mirrored: bool,
    pub(super) right: i64,
    down: i64,
    shades: [u8; 256],
}

impl Change {
    fn draw(recipe: &BrakingRecipe, random: &mut ChaCha8Rng) -> Self {
        let (across, down) = (recipe.shift_px, (recipe.shift_px + 1) / 2);
        let mirrored = random.random::<f64>() < recipe.flip;
        let gamma =
            if random.random::<f64>() < recipe.shade { GAMMA.powf(2.0 * random.random::<f64>() - 1.0) } else { 1.0 };
        let shade = |i: usize| (255.0 * (i as f64 / 255.0).powf(gamma)).round() as u8;
        Self {
            mirrored,
            right: random.random_range(-across..=across),
            down: random.random_range(-down..=down),
            shades: std::array::from_fn(shade),
        }
    }

    /// Writes a picture of this height and width to `out`; beyond the picture, its edge pixels are repeated.
    fn apply(&self, picture: &[u8], [height, width]: [usize; 2], out: &mut [u8]) {
        let clamped = |i: i64, count: usize| i.clamp(0, count as i64 - 1) as usize;
        for (y, out) in (0..).zip(out.chunks_exact_mut(width)) {
            let row = &picture[clamped(y - self.down, height) * width..][..width];
            let changed = (0..).map(|x| self.shades[usize::from(row[clamped(x - self.right, width)])]);
            if self.mirrored {
                out.iter_mut().rev().zip(changed).for_each(|(out, shade)| *out = shade);
            } else {
                out.iter_mut().zip(changed).for_each(|(out, shade)| *out = shade);
            }
        }
    }
}

/// A window as it is shown.
pub(super) struct Drawn {
    pub window: Window,
    /// Share of its speeds that are unknown.
    pub unknown: f64,
    pub weight: f64,
    pub change: Option<Change>,
}

/// The batch of these windows.
pub(super) fn batch(
    drawn: &[Drawn],
    drives: &[Drive],
    wanted: &[Vec<Wanted>],
    recipe: &BrakingRecipe,
    reader: &Reader,
    random: &mut ChaCha8Rng,
) -> Result<Batch, BrakingDataError> {
    let (length, count) = (length(recipe.network), drawn.len() as i64);
    let [_, height, width] = recipe.network.preprocess().shape();
    // Decoding and changing pictures is a large part of the work.
    let (pixels, clip) = (height * width, length * height * width);
    let mut frames = vec![0; drawn.len() * clip];
    let begun = || (reader.clone(), Vec::with_capacity(clip));
    frames.par_chunks_exact_mut(clip).zip(drawn).try_for_each_init(begun, |(reader, read), (out, drawn)| {
        let Drawn { window: (d, from), change, .. } = drawn;
        read.clear();
        drives[*d].pictures(*from, length, reader, read)?;
        match change {
            None => out.copy_from_slice(read),
            Some(change) => {
                let pictures = out.chunks_exact_mut(pixels).zip(read.chunks_exact(pixels));
                pictures.for_each(|(out, picture)| change.apply(picture, [height, width], out));
            }
        }
        Ok::<_, BrakingDataError>(())
    })?;
    let (mut speeds, mut due, mut weights, mut blocked) = (vec![], vec![], vec![], vec![]);
    let mut telling = Telling::default();
    for Drawn { window: (d, from), unknown, weight, change } in drawn {
        let (drive, wanted) = (&drives[*d], &wanted[*d][*from..from + length]);
        speeds.extend(failing(&drive.speed_kmh[*from..from + length], *unknown, random));
        for wanted in wanted[FRAMES - 1..].iter().step_by(2) {
            due.push(wanted.due);
            weights.push(*weight as f32 * wanted.weight);
            blocked.push(wanted.blocked);
        }
        for i in (live::LAG as usize..length).step_by(live::STEP as usize) {
            telling.add(drive, &wanted[i], from + i, change.as_ref());
        }
    }
    let size = [count, length as i64, height as i64, width as i64];
    let rows = |values: &[f32]| Tensor::from_slice(values).view([count, -1]);
    Ok(Batch {
        frames: Tensor::from_data_size(&frames, &size, Kind::Uint8),
        speeds: rows(&speeds),
        due: rows(&due),
        weights: rows(&weights),
        blocked: rows(&blocked),
        told: telling.told(drawn.len()),
    })
}

/// The speeds, of which this share is not known.
pub(super) fn failing(speeds: &[f32], share: f64, random: &mut ChaCha8Rng) -> Vec<f32> {
    let one = |speed: &f32| if share > 0.0 && random.random::<f64>() < share { NO_SPEED as f32 } else { *speed };
    speeds.iter().map(one).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::braking::{Part, Story, targets::wanted};

    /// 20 s: drives at 30 km/h, is braked hard from frame 150 on, and stands from 170 on.
    pub(in crate::braking) fn drive() -> Drive {
        seen(80 * 320)
    }

    /// The same in pictures of so many pixels.
    pub(in crate::braking) fn seen(pixels: usize) -> Drive {
        let story = Story {
            name: "made".into(),
            part: Part::Train,
            scenario: "ccrs".into(),
            hazard: true,
            layer: "plain".into(),
            reaction_s: 1.0,
            track: None,
            frames: None,
        };
        let speed = |i: i32| if i < 150 { 30.0 } else { (30.0 - 1.5 * (i - 150) as f32).max(0.0) };
        let pedal = (0..300).map(|i| f64::from(u8::from((150..200).contains(&i)))).collect();
        Drive::made(story, (0..300).map(speed).collect(), pedal, pixels, 7)
    }

    pub(in crate::braking) fn recipe(more: &str) -> BrakingRecipe {
        BrakingRecipe::read(&format!("network = \"brake-live\"\nbatch = 8\n{more}")).unwrap()
    }

    #[test]
    fn windows_begin_every_stride_and_standing_ones_or_emergencies_are_apart() {
        let drives = [drive()];
        let windows = |more: &str| {
            let recipe = recipe(more);
            Windows::of(&drives, &[wanted(&drives[0], &recipe)], &recipe)
        };
        let standing = windows("");
        assert_eq!(standing.len(), (300 - 64) / 15 + 1);
        // The first to end at frame 169 or later begins at 106.
        assert_eq!((standing.apart[0], standing.others.last()), ((0, 120), Some(&(0, 105))));
        // Labelled from 147 to 156; it answers from its twentieth frame on.
        let emergencies = windows("emergencies = 0.5");
        assert_eq!((emergencies.apart[0], emergencies.apart.last()), ((0, 90), Some(&(0, 135))));
    }

    #[test]
    fn standing_and_moving_windows_weigh_the_same_whatever_their_share() {
        let drives = [drive()];
        let recipe = recipe("standing = 0.2\nspeed_dropout = 1.0\nshift_px = 3");
        let wanted: Vec<_> = drives.iter().map(|drive| wanted(drive, &recipe)).collect();
        let mut draw = Draw::new(Windows::of(&drives, &wanted, &recipe), &recipe);
        let reader = Reader::new(recipe.network.preprocess()).unwrap();
        let (mut standing, mut moving, mut unknown) = (0.0, 0.0, 0.0);
        for _ in 0..200 {
            let (batch, _) = draw.batch(&drives, &wanted, &recipe, &reader).unwrap().unwrap();
            assert_eq!((batch.frames.size(), batch.due.size()), (vec![8, 64, 80, 320], vec![8, 23]));
            assert_eq!((batch.told.near.size(), batch.told.seen.size()), (vec![8, 31, 2], vec![8, 31, 1]));
            for i in 0..8 {
                let weight = batch.weights.double_value(&[i, 0]);
                if weight > 1.0 { standing += weight } else { moving += weight }
            }
            unknown += batch.speeds.eq(NO_SPEED).to_kind(Kind::Float).mean(Kind::Float).double_value(&[]) / 200.0;
        }
        let share: f64 = standing / (standing + moving);
        assert!((share - 0.5).abs() < 0.05, "{share}");
        assert!((unknown - 2.3 / 3.0).abs() < 0.05, "{unknown}");
    }

    #[test]
    fn of_rivals_the_one_that_is_known_least_is_drawn_and_unseen_ones_first() {
        let drives = [drive()];
        let recipe = recipe("emergencies = 0.5\nrivals = 12");
        let wanted = [wanted(&drives[0], &recipe)];
        let mut draw = Draw::new(Windows::of(&drives, &wanted, &recipe), &recipe);
        let others = draw.windows[1].len();
        draw.learnt(&(0..others).map(|i| (1, i)).collect::<Vec<_>>(), &vec![0.1; others]);
        draw.learnt(&[(1, 3)], &[0.9]);
        let drawn: Vec<Card> = (0..400).filter_map(|_| draw.next()).filter(|(kind, _)| *kind == 1).collect();
        let share = drawn.iter().filter(|(_, i)| *i == 3).count() as f64 / drawn.len() as f64;
        assert!(drawn.len() > 150 && share > 0.5, "{share} of {}", drawn.len());
    }

    #[test]
    fn a_changed_picture_is_mirrored_after_it_is_moved_and_goes_on_beyond_its_edges() {
        let plain = Change { mirrored: false, right: 1, down: 0, shades: std::array::from_fn(|i| i as u8) };
        let changed = |change: &Change| {
            let mut out = [0; 6];
            change.apply(&[1, 2, 3, 4, 5, 6], [2, 3], &mut out);
            out
        };
        assert_eq!(changed(&plain), [1, 1, 2, 4, 4, 5]);
        assert_eq!(changed(&Change { mirrored: true, ..plain }), [2, 1, 1, 5, 4, 4]);
        let darker = Change { mirrored: false, right: 0, down: 1, shades: std::array::from_fn(|i| i as u8 / 2) };
        assert_eq!(changed(&darker), [0, 1, 1, 0, 1, 1]);
    }
}
