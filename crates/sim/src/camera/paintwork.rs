//! The colours of the cars that carry the cameras, one of each theme, and how the sun changes them: see `bonnet`.

/// A surface: its colour in grey levels, and the share of that which a sun straight ahead at the horizon adds.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sheet {
    pub(super) colour: [f32; 3],
    pub(super) ahead: f32,
}

const fn sheet(colour: [f32; 3], ahead: f32) -> Sheet {
    Sheet { colour, ahead }
}

/// The surfaces of one theme's car.
#[derive(Debug)]
pub(super) struct Paintwork {
    /// Where the bonnet's sun stands, in degrees clockwise from the one that lights the ground: each fits its own pictures.
    pub(super) turned_deg: f32,
    /// The lip at the far edge.
    pub(super) lip: Sheet,
    pub(super) hood: Sheet,
    pub(super) front: Sheet,
    /// The bright edge above the upper gap.
    pub(super) brink: Sheet,
    /// The upper gap, what is between the gaps, and the lower one.
    pub(super) gap: Sheet,
    pub(super) rim: Sheet,
    pub(super) sill: Sheet,
    pub(super) lower_gap: Sheet,
    pub(super) glass: Sheet,
    /// What the side cameras see: the fender, what a sun from the side adds to it, and the lamp.
    pub(super) fender: Sheet,
    pub(super) fender_aside: f32,
    pub(super) lamp: Sheet,
}

pub(super) const LAKE: Paintwork = Paintwork {
    turned_deg: 9.5,
    lip: sheet([132.0, 127.0, 107.0], -0.28),
    hood: sheet([164.0, 155.0, 130.0], 0.285),
    front: sheet([138.0, 125.0, 100.0], -0.24),
    brink: sheet([142.0, 132.0, 110.0], 0.25),
    gap: sheet([90.0, 82.0, 67.0], -1.38),
    rim: sheet([160.0, 155.0, 136.0], 0.4),
    sill: sheet([149.0, 146.0, 128.0], -0.25),
    lower_gap: sheet([117.0, 116.0, 98.0], -0.85),
    glass: sheet([165.0, 168.0, 151.0], 0.31),
    fender: sheet([143.0, 132.0, 107.0], 0.51),
    fender_aside: 0.38,
    lamp: sheet([246.0, 246.0, 232.0], 0.06),
};

pub(super) const JUNGLE: Paintwork = Paintwork {
    turned_deg: -3.0,
    lip: sheet([111.0, 111.0, 107.0], -0.29),
    hood: sheet([137.0, 135.0, 126.0], 0.19),
    front: sheet([100.0, 96.0, 83.0], -0.27),
    brink: sheet([106.0, 102.0, 95.0], 0.15),
    gap: sheet([58.0, 56.0, 52.0], -1.55),
    rim: sheet([155.0, 155.0, 154.0], 0.27),
    sill: sheet([143.0, 143.0, 144.0], -0.23),
    lower_gap: sheet([100.0, 103.0, 105.0], -0.84),
    glass: sheet([166.0, 173.0, 178.0], 0.2),
    fender: sheet([106.0, 102.0, 90.0], 0.4),
    fender_aside: 0.27,
    lamp: sheet([205.0, 204.0, 200.0], 0.2),
};

pub(super) const MOUNTAIN: Paintwork = Paintwork {
    turned_deg: -22.0,
    lip: sheet([102.0, 102.0, 104.0], -0.17),
    hood: sheet([119.0, 120.0, 122.0], 0.26),
    front: sheet([94.0, 94.0, 94.0], -0.13),
    brink: sheet([99.0, 99.0, 101.0], 0.22),
    gap: sheet([53.0, 54.0, 57.0], -1.4),
    rim: sheet([136.0, 137.0, 140.0], 0.34),
    sill: sheet([119.0, 120.0, 125.0], -0.16),
    lower_gap: sheet([86.0, 87.0, 92.0], -0.7),
    glass: sheet([138.0, 141.0, 148.0], 0.28),
    fender: sheet([99.0, 99.0, 99.0], 0.46),
    fender_aside: 0.2,
    lamp: sheet([190.0, 190.0, 188.0], 0.25),
};
