//! The look of a landscape: light, sky, and the colours of ground, road and car.
//!
//! Colours are means of real frames (`recordings/lake`, `jungle`, `mountain` of the stock simulator), chosen by eye
//! where nothing could be averaged.

use super::{
    noise::{mix3, step},
    paintwork::{self, Paintwork},
    section::{Band, Pattern, Section},
};
use crate::track::{Side, Theme};

/// Colour in grey levels, red first.
pub(super) type GreyLevels = [f32; 3];

/// Light, sky and colours of one theme.
#[derive(Debug, Clone)]
pub(super) struct ThemeLook {
    pub(super) sun_height_deg: f64,
    pub(super) sun_azimuth_deg: f64,
    /// Light in the shade, as a share of full light on flat ground, by colour.
    pub(super) shade: GreyLevels,
    /// The sky at the horizon, 11 degrees above it, and 22.
    pub(super) sky: [GreyLevels; 3],
    pub(super) fog: GreyLevels,
    /// Share of fog after 100 m.
    pub(super) fog_100m: f32,
    pub(super) bonnet: &'static Paintwork,
    /// The colour that the road approaches with distance: it shines at a flat angle.
    pub(super) sheen: GreyLevels,
    pub(super) rock: GreyLevels,
    pub(super) water: Option<GreyLevels>,
    /// Whether trees and hills throw shadows on the road: in real frames of the lake none do.
    pub(super) shadows: bool,
    /// Steepest rise of the ground beside a road, metres a metre.
    pub(super) steepest: f32,
}

impl ThemeLook {
    pub(super) fn of(theme: Theme) -> Self {
        match theme {
            Theme::Lake => Self {
                sun_height_deg: 38.0,
                sun_azimuth_deg: 80.0,
                shade: [0.42, 0.50, 0.60],
                sky: [[208.0, 224.0, 238.0], [146.0, 177.0, 218.0], [108.0, 136.0, 178.0]],
                fog: [150.0, 176.0, 205.0],
                fog_100m: 0.13,
                bonnet: &paintwork::LAKE,
                sheen: [224.0, 217.0, 184.0],
                rock: [190.0, 180.0, 150.0],
                water: Some([146.0, 176.0, 208.0]),
                shadows: false,
                steepest: 0.9,
            },
            Theme::Jungle => Self {
                // Of all, the sun at which drawn roads are light and dark where the real ones are.
                sun_height_deg: 50.0,
                sun_azimuth_deg: 160.0,
                shade: [0.30, 0.33, 0.42],
                sky: [[136.0, 160.0, 199.0], [117.0, 143.0, 182.0], [103.0, 129.0, 169.0]],
                fog: [104.0, 120.0, 128.0],
                fog_100m: 0.05,
                bonnet: &paintwork::JUNGLE,
                sheen: [172.0, 171.0, 168.0],
                rock: [82.0, 86.0, 66.0],
                water: None,
                shadows: true,
                steepest: 6.0,
            },
            Theme::Mountain => Self {
                // From where the real shadows come, but higher: our walls stand elsewhere, and long shadows fall wrong.
                sun_height_deg: 46.0,
                sun_azimuth_deg: 88.0,
                shade: [0.34, 0.36, 0.42],
                sky: [[196.0, 222.0, 240.0], [114.0, 150.0, 206.0], [84.0, 114.0, 174.0]],
                fog: [120.0, 132.0, 150.0],
                fog_100m: 0.04,
                bonnet: &paintwork::MOUNTAIN,
                sheen: [112.0, 109.0, 114.0],
                rock: [58.0, 60.0, 66.0],
                water: None,
                shadows: true,
                steepest: 6.0,
            },
        }
    }
}

/// Kinds of the cross-sections that [`sections`] makes.
pub(super) mod kind {
    pub(in super::super) const PLAIN: u8 = 0;
    pub(in super::super) const KERB: u8 = 1;
    pub(in super::super) const DIRT: u8 = 2;
    pub(in super::super) const PAVED: u8 = 3;
}

/// Which of the cross-sections that [`sections`] makes one side of a road has.
pub(super) fn section(kind: u8, side: Side) -> u8 {
    2 * kind + u8::from(side == Side::Right)
}

/// How bright the asphalt of the real mountain's road is, as a share of its mean, at each tenth of a metre from the middle outwards,
/// first to the left: it is worn along the same lines everywhere. From the pictures of a whole drive, unrolled onto the road.
const WORN: [[f32; 40]; 2] = [
    [
        1.03, 0.99, 0.95, 0.92, 0.90, 0.85, 0.82, 0.80, 0.81, 0.83, 0.84, 0.85, 0.87, 0.89, 0.90, 0.92, 0.91, 0.90,
        0.92, 0.92, 0.92, 0.91, 0.87, 0.84, 0.90, 1.01, 1.09, 1.11, 1.07, 1.06, 1.06, 1.05, 1.04, 1.03, 1.02, 1.01,
        1.02, 1.02, 1.02, 1.02,
    ],
    [
        1.09, 1.16, 1.19, 1.19, 1.16, 1.10, 1.07, 1.04, 1.01, 1.01, 1.00, 0.98, 0.97, 0.97, 0.96, 0.96, 1.00, 1.03,
        1.06, 1.10, 1.12, 1.10, 1.07, 0.99, 0.93, 0.99, 1.08, 1.14, 1.13, 1.10, 1.10, 1.10, 1.08, 1.06, 1.04, 1.02,
        1.01, 1.01, 1.02, 1.02,
    ],
];
/// The half width of that road, in metres. On a road of another width, wear is stretched.
const WORN_HALF_M: f32 = 5.3;
/// The sheen pales it: differences are drawn this many times as large, so that 6 m away they look as measured.
const WORN_TIMES: f32 = 1.5;

/// The bands of worn asphalt.
fn worn(asphalt: GreyLevels, half: f32, side: Side) -> impl Iterator<Item = Band> {
    let tenth = 0.1 * half / WORN_HALF_M;
    let shares = WORN[usize::from(side == Side::Right)];
    shares.into_iter().zip(0u8..).map(move |(share, i)| {
        let colour = asphalt.map(|level| level * (1.0 + WORN_TIMES * (share - 1.0)));
        Band::plain(f32::from(i) * tenth, f32::from(i + 1) * tenth, colour, 1.0)
    })
}

/// Colours of the lake's bank beside the road.
const BANK: GreyLevels = [214.0, 207.0, 180.0];
const YELLOW: GreyLevels = [184.0, 162.0, 72.0];

/// The cross-sections of a theme's road, in the order of [`kind`], each for the left side, then for the right. Lines and verge stand
/// out from the asphalt so many times as much as usual.
pub(super) fn sections(theme: Theme, half: f32, standing_out: f32) -> Vec<Section> {
    let far = 20.0;
    let lay = |texture: u8, pattern: Pattern, bands: &[Band]| {
        let bands: Vec<Band> = bands.iter().map(|band| band.standing_out(bands[0].colour, standing_out)).collect();
        Section::new(texture, pattern, &bands)
    };
    match theme {
        Theme::Lake => {
            // Lines and verge as far from the road's edge, and of the colours, that `real_or_drawn` in `tools/` measures.
            let asphalt = [97.0, 101.0, 90.0];
            let road = [
                Band::plain(0.0, far, asphalt, 1.0),
                Band::plain(half - 1.2, far, [104.0, 105.0, 93.0], 1.0),
                Band::plain(half + 0.30, half + 0.52, [92.0, 86.0, 66.0], 0.3),
                Band::plain(half + 0.02, half + 0.18, YELLOW, 0.3),
                Band::plain(half + 0.52, half + 0.64, YELLOW, 0.3),
                Band::plain(half + 0.64, half + 1.65, [132.0, 128.0, 109.0], 0.4),
                Band::plain(half + 1.65, half + 2.6, BANK, 0.12),
                Band::plain(half + 2.6, far, [200.0, 197.0, 174.0], 0.12),
            ];
            let red = [216.0, 106.0, 92.0];
            let white = [238.0, 222.0, 204.0];
            let kerb = Band { from: half + 0.55, to: half + 1.6, colour: white, other: red, rough: 0.1, pattern: 1.0 };
            let mut kerbed = road.to_vec();
            kerbed[4] = kerb;
            kerbed[5] = Band::plain(half + 1.6, half + 1.65, BANK, 0.1);
            let dirt = [
                Band::plain(0.0, far, asphalt, 1.0),
                Band::plain(half + 0.2, half + 1.65, [150.0, 122.0, 88.0], 0.35),
                Band::plain(half + 1.65, far, [200.0, 156.0, 100.0], 0.2),
            ];
            let paved = [Band::plain(0.0, far, [179.0, 158.0, 138.0], 1.0)];
            let bars = Pattern::Bars { period: 0.64, share: 0.5 };
            let kinds = [
                lay(0, Pattern::Plain, &road),
                lay(0, bars, &kerbed),
                lay(0, Pattern::Plain, &dirt),
                lay(1, Pattern::Plain, &paved),
            ];
            kinds.into_iter().flat_map(|alike| [alike.clone(), alike]).collect()
        }
        Theme::Jungle => {
            let asphalt = [137.0, 136.0, 133.0];
            let white = [226.0, 226.0, 222.0];
            let dash = Band { from: 0.0, to: 0.08, colour: asphalt, other: white, rough: 0.4, pattern: 1.0 };
            let road = [
                Band::plain(0.0, far, asphalt, 1.0),
                dash,
                Band::plain(half - 0.22, half - 0.08, white, 0.3),
                Band::plain(half - 0.02, far, [110.0, 118.0, 80.0], 0.6),
            ];
            let dashes = Pattern::Bars { period: 9.0, share: 0.34 };
            vec![lay(0, dashes, &road); 8]
        }
        Theme::Mountain => {
            let asphalt = [68.0, 66.0, 69.0];
            let leaf = [202.0, 152.0, 64.0];
            let leaves = |from: f32, to: f32, share: f32| Band {
                from,
                to,
                colour: [80.0, 74.0, 68.0],
                other: leaf,
                rough: 0.7,
                pattern: share,
            };
            // The real road, unrolled and averaged over a thousand pictures: leaves from 0.7 m inside the edge on, most of
            // them on a yellow line; then dead ones, and from 0.6 m outside it concrete.
            let edge = [
                leaves(half - 0.8, half - 0.45, 0.3),
                leaves(half - 0.45, half + 0.3, 0.9),
                Band::plain(half - 0.16, half - 0.02, [150.0, 130.0, 92.0], 0.5),
                Band { colour: [66.0, 60.0, 54.0], ..leaves(half + 0.3, half + 0.6, 0.3) },
                Band::plain(half + 0.6, far, [42.0, 42.0, 46.0], 0.5),
            ];
            let road = |side: Side| {
                let bands: Vec<_> = [Band::plain(0.0, far, asphalt, 1.0)]
                    .into_iter()
                    .chain(worn(asphalt, half, side))
                    .chain(edge)
                    .collect();
                lay(0, Pattern::Flecks, &bands)
            };
            let sides = [road(Side::Left), road(Side::Right)];
            (0..4).flat_map(|_| sides.clone()).collect()
        }
    }
}

/// The properties of a place of open ground that decide its colour.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spot {
    /// Noise over tens of metres and over a few, 0 to 1.
    pub(super) wide: f32,
    pub(super) fine: f32,
    /// Metres above the road nearby.
    pub(super) above_m: f32,
    /// Metres climbed a metre.
    pub(super) slope: f32,
    /// Metres from the nearest road's edge.
    pub(super) from_edge_m: f32,
    /// Whether the road there runs through open dirt.
    pub(super) dirt: bool,
    /// Metres above the water.
    pub(super) dry_m: f32,
}

/// The colour of open ground in full light.
pub(super) fn ground(theme: Theme, rock: GreyLevels, p: Spot) -> GreyLevels {
    let Spot { wide, fine, .. } = p;
    match theme {
        Theme::Lake => {
            let grass = mix3([204.0, 190.0, 92.0], [164.0, 160.0, 76.0], step(0.4, 0.62, fine));
            let sand = mix3([196.0, 146.0, 84.0], [214.0, 178.0, 118.0], fine);
            let bare = step(0.52, 0.6, wide).max(if p.dirt { step(26.0, 18.0, p.from_edge_m) } else { 0.0 });
            let shore = step(0.9, 0.2, p.dry_m);
            let flat = mix3(mix3(grass, sand, bare), [150.0, 126.0, 84.0], shore);
            mix3(flat, mix3(rock, [222.0, 206.0, 160.0], wide), step(0.30, 0.55, p.slope + 0.3 * (fine - 0.5)))
        }
        Theme::Jungle => {
            let grass = mix3([128.0, 138.0, 86.0], [92.0, 101.0, 62.0], step(0.35, 0.65, fine));
            // Woods, dark from afar, begin a few metres from the road.
            let wood = mix3([70.0, 78.0, 46.0], [46.0, 54.0, 34.0], step(0.35, 0.65, fine));
            let grass = mix3(grass, wood, 0.85 * step(4.0, 14.0, p.from_edge_m));
            let rock = mix3(rock, [100.0, 104.0, 76.0], step(0.3, 0.7, fine));
            mix3(grass, rock, step(0.45, 0.9, p.slope + 0.4 * (wide - 0.5)))
        }
        Theme::Mountain => {
            let grass = mix3([104.0, 76.0, 34.0], [58.0, 44.0, 22.0], step(0.35, 0.62, fine));
            let rock = mix3(rock, [38.0, 40.0, 46.0], step(0.3, 0.7, fine));
            mix3(
                grass,
                rock,
                step(0.5, 0.9, p.slope + 0.8 * (wide - 0.5)).max(step(0.56, 0.62, wide) * step(2.0, 5.0, p.above_m)),
            )
        }
    }
}
