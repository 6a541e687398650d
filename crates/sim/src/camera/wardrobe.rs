//! The colours of what drives and walks, in three wardrobes: the plain one, that to learn from, and that which is held out.

use crate::scene::Looks;

pub(super) type Colour = [u8; 3];

const CARS: [Colour; 6] = [[186, 40, 36], [50, 80, 150], [212, 212, 208], [60, 62, 66], [206, 166, 52], [58, 112, 74]];
const CLOTHES: [Colour; 5] = [[170, 50, 44], [56, 84, 140], [196, 180, 60], [80, 128, 84], [122, 84, 136]];
const TROUSERS: [Colour; 3] = [[48, 52, 66], [84, 72, 58], [36, 36, 38]];
const SKIN: Colour = [206, 162, 132];

/// The colours of a wardrobe: cars, clothes, trousers, skin, hair.
pub(super) struct Wardrobe {
    pub(super) cars: &'static [Colour],
    pub(super) clothes: &'static [Colour],
    pub(super) trousers: &'static [Colour],
    pub(super) skin: &'static [Colour],
    pub(super) hair: &'static [Colour],
}

const PLAIN: Wardrobe =
    Wardrobe { cars: &CARS, clothes: &CLOTHES, trousers: &TROUSERS, skin: &[SKIN], hair: &[[52, 40, 30]] };

const LEARNT: Wardrobe = Wardrobe {
    cars: &[
        [186, 40, 36],
        [50, 80, 150],
        [212, 212, 208],
        [60, 62, 66],
        [206, 166, 52],
        [58, 112, 74],
        [22, 24, 28],
        [140, 146, 152],
        [96, 40, 48],
        [232, 232, 232],
        [96, 128, 160],
        [168, 24, 60],
        [24, 44, 92],
        [120, 92, 60],
        [186, 190, 150],
        [250, 214, 60],
        [80, 150, 110],
        [190, 120, 120],
        [36, 60, 44],
        [130, 120, 112],
    ],
    clothes: &[
        [170, 50, 44],
        [56, 84, 140],
        [196, 180, 60],
        [80, 128, 84],
        [122, 84, 136],
        [30, 32, 40],
        [226, 226, 220],
        [120, 120, 124],
        [176, 112, 64],
        [60, 100, 190],
        [230, 200, 150],
        [104, 30, 40],
        [140, 200, 150],
        [250, 230, 90],
        [70, 70, 74],
        [190, 150, 190],
        [26, 66, 60],
        [150, 140, 110],
    ],
    trousers: &[
        [48, 52, 66],
        [84, 72, 58],
        [36, 36, 38],
        [110, 118, 136],
        [190, 180, 160],
        [24, 30, 60],
        [100, 52, 44],
        [92, 96, 92],
    ],
    skin: &[SKIN, [150, 104, 78], [228, 190, 164], [116, 80, 60], [206, 160, 128]],
    hair: &[[52, 40, 30], [24, 20, 18], [150, 116, 66], [196, 170, 120], [72, 68, 66]],
};

const HELD_OUT: Wardrobe = Wardrobe {
    cars: &[
        [214, 104, 36],
        [44, 132, 140],
        [170, 156, 128],
        [118, 68, 132],
        [156, 190, 204],
        [74, 58, 44],
        [110, 130, 60],
    ],
    clothes: &[[220, 112, 40], [40, 140, 140], [206, 120, 150], [146, 170, 70], [90, 60, 44], [170, 190, 214]],
    trousers: &[[64, 84, 60], [130, 104, 84], [70, 40, 48], [160, 156, 146]],
    skin: &[[96, 66, 50], [188, 140, 104], [240, 208, 186]],
    hair: &[[90, 44, 28], [120, 118, 116], [14, 12, 12]],
};

impl Wardrobe {
    pub(super) fn of(look: u32) -> &'static Self {
        match Looks::of(look) {
            Looks::Plain => &PLAIN,
            Looks::Learnt => &LEARNT,
            Looks::HeldOut => &HELD_OUT,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_colour_of_the_wardrobe_to_learn_from_is_in_the_one_that_is_held_out() {
        let of = |wardrobe: &Wardrobe| {
            let Wardrobe { cars, clothes, trousers, skin, hair } = *wardrobe;
            [cars, clothes, trousers, skin, hair]
        };
        for (learnt, held_out) in of(&LEARNT).into_iter().zip(of(&HELD_OUT)) {
            for (a, b) in learnt.iter().flat_map(|a| held_out.iter().map(move |b| (a, b))) {
                let apart: u32 = a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
                assert!(apart >= 24, "{a:?} and {b:?} are {apart} apart");
            }
        }
    }
}
