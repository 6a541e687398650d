//! What a braking network learns from: windows of an episode and their targets, drawn and balanced.

use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use tch::{Kind, Tensor};

use super::{
    BrakingRecipe,
    episodes::{BrakingDataError, Drive, Reader},
};
use crate::nn::braking::{BrakingArchitecture, FRAMES, HZ, NO_SPEED};
use lapwing_score::emergency::LabelRule;

/// A window begins every so many frames.
pub(super) const STRIDE: usize = 15;

/// The live network's windows are so many frames longer: it answers every second frame of a stride, and sees each once.
const MORE: usize = 14;

/// A car slower than this stands, in km/h: 1 mph.
const STANDING_KMH: f32 = 1.6;
/// A pedal held less than this is let go.
const LET_GO: f64 = 0.05;
/// A label lasts at most so long, in seconds, however long the pedal is held.
const LONGEST_S: f64 = 4.0;
/// Shares of a window's speeds that are unknown, as the paper's table II has them.
pub(super) const FAILURES: [f64; 3] = [0.5, 0.8, 1.0];

/// A window: which drive, and from which frame.
pub(super) type Window = (usize, usize);

/// A batch for the network.
pub(super) struct Batch {
    /// (B, T, H, W) f32, 0 to 255.
    pub frames: Tensor,
    /// (B, T) km/h.
    pub speeds: Tensor,
    /// (B, N) what the answers should be.
    pub targets: Tensor,
    /// (B, N) how much each matters.
    pub weights: Tensor,
}

/// How many frames a training window has.
pub(super) fn length(architecture: BrakingArchitecture) -> usize {
    match architecture {
        BrakingArchitecture::Stacked => FRAMES,
        BrakingArchitecture::Live => FRAMES + MORE,
    }
}

/// At which frames of a drive the network should say 1.
pub(super) fn targets(drive: &Drive, recipe: &BrakingRecipe) -> Vec<bool> {
    let rule = LabelRule::default();
    let mut targets = drive.due.clone();
    let early = (recipe.lead * drive.story.reaction_s * HZ).round() as usize;
    for &onset in &drive.onsets {
        let first = onset.saturating_sub(rule.lead);
        let mut end = (first + rule.length).min(targets.len());
        if recipe.hold {
            let longest = (first + (LONGEST_S * HZ) as usize).min(targets.len());
            let brakes = |i: &usize| drive.pedal[*i] >= LET_GO && drive.speed_kmh[*i] >= STANDING_KMH;
            // The label begins before the foot, so that the pedal is looked at after it.
            end = (end..longest).find(|i| !brakes(i)).unwrap_or(longest.max(end));
        }
        targets[first.saturating_sub(early)..end].fill(true);
    }
    targets
}

/// The windows of all drives, the standing apart from the moving.
pub(super) struct Windows {
    pub standing: Vec<Window>,
    pub moving: Vec<Window>,
}

impl Windows {
    pub(super) fn of(drives: &[Drive], length: usize) -> Self {
        let (mut standing, mut moving) = (vec![], vec![]);
        for (d, drive) in drives.iter().enumerate() {
            for from in (0..(drive.frames() + 1).saturating_sub(length)).step_by(STRIDE) {
                let stands = drive.speed_kmh[from + length - 1] < STANDING_KMH;
                if stands { &mut standing } else { &mut moving }.push((d, from));
            }
        }
        Self { standing, moving }
    }

    pub(super) fn len(&self) -> usize {
        self.standing.len() + self.moving.len()
    }
}

/// Draws windows: of each kind all before any again.
pub(super) struct Draw {
    standing: Deck,
    moving: Deck,
    share: f64,
    random: ChaCha8Rng,
}

struct Deck {
    cards: Vec<Window>,
    next: usize,
}

impl Deck {
    fn draw(&mut self, random: &mut ChaCha8Rng) -> Option<Window> {
        if self.next == 0 {
            self.cards.shuffle(random);
        }
        let card = self.cards.get(self.next).copied();
        self.next = (self.next + 1) % self.cards.len().max(1);
        card
    }
}

impl Draw {
    pub(super) fn new(windows: Windows, share: f64, seed: u64) -> Self {
        let deck = |cards| Deck { cards, next: 0 };
        let Windows { standing, moving } = windows;
        Self { standing: deck(standing), moving: deck(moving), share, random: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// The next window, and whether it is of a standing car.
    fn next(&mut self) -> Option<(Window, bool)> {
        let stands = self.random.random::<f64>() < self.share;
        let Self { standing, moving, random, .. } = self;
        let (wanted, other) = if stands { (standing, moving) } else { (moving, standing) };
        match wanted.draw(random) {
            Some(window) => Some((window, stands)),
            // None of that kind.
            None => other.draw(random).map(|window| (window, !stands)),
        }
    }

    /// A batch to learn from.
    pub(super) fn batch(
        &mut self,
        drives: &[Drive],
        targets: &[Vec<bool>],
        recipe: &BrakingRecipe,
        reader: &mut Reader,
    ) -> Result<Option<Batch>, BrakingDataError> {
        let length = length(recipe.network);
        let mut drawn = Vec::with_capacity(recipe.batch);
        for _ in 0..recipe.batch {
            let Some(((d, from), stands)) = self.next() else { return Ok(None) };
            // The live network answers every second frame; which of the two, the draw says.
            let late = usize::from(
                recipe.network == BrakingArchitecture::Live
                    && from + length < drives[d].frames()
                    && self.random.random::<bool>(),
            );
            let unknown = if self.random.random::<f64>() < recipe.speed_dropout {
                FAILURES[self.random.random_range(0..FAILURES.len())]
            } else {
                0.0
            };
            let kind = if stands { 0.5 / recipe.standing } else { 0.5 / (1.0 - recipe.standing) };
            drawn.push(Drawn { window: (d, from + late), unknown, weight: kind });
        }
        let mut batch = batch(&drawn, drives, targets, recipe, reader, &mut self.random)?;
        if self.random.random::<f64>() < recipe.flip {
            batch.frames = batch.frames.flip([3]);
        }
        if recipe.shift_px > 0 {
            let (across, down) = (recipe.shift_px, (recipe.shift_px + 1) / 2);
            let [height, width] = [batch.frames.size()[2], batch.frames.size()[3]];
            let wider = batch.frames.replication_pad2d([across, across, down, down]);
            let (right, below) = (self.random.random_range(0..=2 * across), self.random.random_range(0..=2 * down));
            batch.frames = wider.narrow(3, right, width).narrow(2, below, height).contiguous();
        }
        Ok(Some(batch))
    }
}

/// A window as it is shown.
pub(super) struct Drawn {
    pub window: Window,
    /// Share of its speeds that are unknown.
    pub unknown: f64,
    pub weight: f64,
}

/// The batch of these windows.
pub(super) fn batch(
    drawn: &[Drawn],
    drives: &[Drive],
    targets: &[Vec<bool>],
    recipe: &BrakingRecipe,
    reader: &mut Reader,
    random: &mut ChaCha8Rng,
) -> Result<Batch, BrakingDataError> {
    let (length, count) = (length(recipe.network), drawn.len() as i64);
    let (mut pixels, mut speeds, mut wanted, mut weights) = (vec![], vec![], vec![], vec![]);
    for &Drawn { window: (d, from), unknown, weight } in drawn {
        let drive = &drives[d];
        drive.pictures(from, length, reader, &mut pixels)?;
        speeds.extend(failing(&drive.speed_kmh[from..from + length], unknown, random));
        for end in (from + FRAMES - 1..from + length).step_by(2) {
            let due = targets[d][end];
            wanted.push(f32::from(u8::from(due)));
            weights.push((weight * if due { recipe.due_weight } else { 1.0 }) as f32);
        }
    }
    let [_, height, width] = recipe.network.preprocess().shape().map(|n| n as i64);
    let frames = Tensor::from_data_size(&pixels, &[count, length as i64, height, width], Kind::Uint8);
    let rows = |values: &[f32]| Tensor::from_slice(values).view([count, -1]);
    Ok(Batch {
        frames: frames.to_kind(Kind::Float),
        speeds: rows(&speeds),
        targets: rows(&wanted),
        weights: rows(&weights),
    })
}

/// The speeds, of which this share is not known.
pub(super) fn failing(speeds: &[f32], share: f64, random: &mut ChaCha8Rng) -> Vec<f32> {
    let one = |speed: &f32| if share > 0.0 && random.random::<f64>() < share { NO_SPEED as f32 } else { *speed };
    speeds.iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::braking::{Part, Story};

    /// 20 s: drives at 30 km/h, is braked hard from frame 150 on, and stands from 170 on.
    fn drive() -> Drive {
        let story = Story {
            name: "made".into(),
            part: Part::Train,
            scenario: "ccrs".into(),
            hazard: true,
            layer: "plain".into(),
            reaction_s: 1.0,
        };
        let speed = |i: i32| if i < 150 { 30.0 } else { (30.0 - 1.5 * (i - 150) as f32).max(0.0) };
        let pedal = (0..300).map(|i| f64::from(u8::from((150..200).contains(&i)))).collect();
        Drive::made(story, (0..300).map(speed).collect(), pedal, 50 * 160, 7)
    }

    fn recipe(more: &str) -> BrakingRecipe {
        BrakingRecipe::read(&format!("network = \"brake-live\"\nbatch = 8\n{more}")).unwrap()
    }

    fn ends(set: &[bool]) -> (usize, usize) {
        (set.iter().position(|t| *t).unwrap(), set.iter().rposition(|t| *t).unwrap())
    }

    #[test]
    fn a_target_is_the_papers_label_unless_it_begins_earlier_or_lasts_as_long_as_the_brake() {
        let drive = drive();
        assert_eq!(ends(&targets(&drive, &recipe(""))), ends(&drive.due));
        assert_eq!(ends(&drive.due), (147, 156));
        assert_eq!(ends(&targets(&drive, &recipe("lead = 1.0"))), (132, 156));
        assert_eq!(ends(&targets(&drive, &recipe("lead = 0.4\nhold = true"))), (141, 168));
    }

    #[test]
    fn windows_begin_every_stride_and_standing_ones_are_apart() {
        let windows = Windows::of(&[drive()], length(BrakingArchitecture::Live));
        assert_eq!(windows.len(), (300 - 34) / 15 + 1);
        // The first to end at frame 169 or later begins at 136.
        assert_eq!((windows.standing[0], windows.moving.last()), ((0, 150), Some(&(0, 135))));
        assert_eq!(Windows::of(&[drive()], 301).len(), 0);
    }

    #[test]
    fn standing_and_moving_windows_weigh_the_same_whatever_their_share() {
        let drives = [drive()];
        let recipe = recipe("standing = 0.2\nspeed_dropout = 1.0\nshift_px = 3");
        let targets: Vec<_> = drives.iter().map(|drive| targets(drive, &recipe)).collect();
        let mut draw = Draw::new(Windows::of(&drives, length(recipe.network)), recipe.standing, 3);
        let mut reader = Reader::new(recipe.network.preprocess()).unwrap();
        let (mut standing, mut moving, mut unknown) = (0.0, 0.0, 0.0);
        for _ in 0..200 {
            let batch = draw.batch(&drives, &targets, &recipe, &mut reader).unwrap().unwrap();
            assert_eq!((batch.frames.size(), batch.targets.size()), (vec![8, 34, 50, 160], vec![8, 8]));
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
}
