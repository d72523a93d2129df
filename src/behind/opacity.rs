//! How much light tissue takes, and its colour, by CT number.

/// CT numbers of the first and last row of an [`OpacityTable`].
pub const VALUES: [f32; 2] = [-1024.0, 1536.0];
/// Rows and columns of an [`OpacityTable`].
pub const TABLE_SIDE: usize = 256;

/// Light that tissue of a value takes. Between two stops both numbers change evenly.
#[derive(Clone, Copy)]
struct OpacityStop {
    value: f32,
    /// Share of light taken on a short way, by the way, 1/mm.
    per_mm: f32,
    /// Linear.
    colour: [f32; 3],
}

const LUNG: [f32; 3] = [0.10, 0.14, 0.20];
const FAT: [f32; 3] = [0.46, 0.36, 0.10];
const SOFT: [f32; 3] = [0.62, 0.15, 0.11];
const BLOOD: [f32; 3] = [0.42, 0.16, 0.55];
const BRIGHT: [f32; 3] = [0.72, 0.88, 0.80];

const fn stop(value: f32, per_mm: f32, colour: [f32; 3]) -> OpacityStop {
    OpacityStop { value, per_mm, colour }
}

/// Opacity of the tissue behind a wall.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Opacity {
    /// Behind the wall of a colon: fat is yellow, soft tissue red, tagged stool white.
    Colon,
    /// Behind the wall of an airway: lung is dark, vessels are red, violet with contrast medium,
    /// calcification is white.
    Airway,
    /// Behind the wall of a vessel filled with contrast medium of this value: calcification is white.
    Vessel(f32),
}

impl Opacity {
    /// Thickness of the skin that no ray looks at, in voxels, for the noise of the values.
    ///
    /// In gas the values of every wall pass those of fat. A vessel's pass those of soft tissue, and
    /// calcification in the wall is thin.
    pub fn skin_vox(self, noise: f32) -> f32 {
        match self {
            Self::Colon | Self::Airway => 1.3 + 0.2 * ((noise - 20.0) / 60.0).clamp(0.0, 1.0),
            Self::Vessel(_) => 0.3,
        }
    }

    /// Names of tissues with their colours, sRGB.
    pub fn legend(self) -> Vec<(&'static str, [u8; 3])> {
        let named: &[(&str, [f32; 3])] = match self {
            Self::Colon => &[("tagged", BRIGHT), ("soft tissue", SOFT), ("fat", FAT)],
            Self::Airway => &[
                ("calcified", BRIGHT),
                ("with contrast", BLOOD),
                ("soft tissue", SOFT),
                ("fat", FAT),
            ],
            Self::Vessel(_) => &[("calcified", BRIGHT), ("soft tissue", SOFT), ("fat", FAT)],
        };
        let byte = |c: f32| (255.0 * c.powf(1.0 / 2.2)).round() as u8;
        named.iter().map(|(name, colour)| (*name, colour.map(byte))).collect()
    }

    fn stops(self) -> Vec<OpacityStop> {
        let lung = if self == Self::Airway { 0.02 } else { 0.0 };
        let mut stops = vec![
            stop(-960.0, 0.0, LUNG),
            stop(-900.0, lung, LUNG),
            stop(-600.0, lung, LUNG),
            stop(-250.0, 0.03, FAT),
            stop(-150.0, 0.10, FAT),
            stop(-70.0, 0.10, FAT),
            stop(-30.0, 0.16, [0.56, 0.22, 0.11]),
            stop(20.0, 0.28, SOFT),
            stop(90.0, 0.28, SOFT),
        ];
        stops.extend(match self {
            Self::Colon => {
                [stop(140.0, 0.5, SOFT), stop(200.0, 1.2, BRIGHT), stop(400.0, 1.8, BRIGHT)]
            }
            Self::Airway => {
                [stop(160.0, 0.5, BLOOD), stop(320.0, 0.8, BLOOD), stop(450.0, 1.8, BRIGHT)]
            }
            // Between soft tissue and the lumen every value is a mixture of the two.
            Self::Vessel(lumen) => {
                let clear = (lumen + 60.0).max(150.0);
                [
                    stop(120.0, 0.0, SOFT),
                    stop(clear, 0.0, BRIGHT),
                    stop((clear + 120.0).max(300.0), 1.8, BRIGHT),
                ]
            }
        });
        stops
    }

    /// Extinction (1/mm) and colour of a value.
    fn at(stops: &[OpacityStop], value: f32) -> (f32, [f32; 3]) {
        let after = stops.partition_point(|s| s.value <= value);
        let (Some(before), after) = (after.checked_sub(1).map(|i| stops[i]), stops.get(after))
        else {
            return (0.0, stops[0].colour);
        };
        let Some(after) = after else { return (before.per_mm, before.colour) };
        let share = (value - before.value) / (after.value - before.value);
        let mixed = |a: f32, b: f32| a + share * (b - a);
        let colour = std::array::from_fn(|i| mixed(before.colour[i], after.colour[i]));
        (mixed(before.per_mm, after.per_mm), colour)
    }
}

/// Light that reaches the eye from the piece of a ray between two samples, by both their values: of
/// each entry the colour, times the share of light that the piece takes, and that share.
#[derive(Clone, Debug)]
pub struct OpacityTable {
    /// Length of the piece, mm.
    pub step_mm: f32,
    /// [`TABLE_SIDE`]² entries; the value nearer to the eye varies fastest.
    pub entries: Vec<[f32; 4]>,
}

impl OpacityTable {
    /// Integrates between each two values, in thin slices.
    pub fn new(opacity: Opacity, step_mm: f32) -> Self {
        /// Slices of a piece.
        const SLICES: usize = 24;
        /// Values between two rows at which the opacity is known: kinks lie between rows.
        const FINE: usize = 8;
        let stops = opacity.stops();
        let width = (VALUES[1] - VALUES[0]) / ((TABLE_SIDE - 1) * FINE) as f32;
        let value = |i: usize| Opacity::at(&stops, VALUES[0] + i as f32 * width);
        // Colour, and share of light that a slice takes.
        let slices: Vec<([f32; 3], f32)> = (0..TABLE_SIDE * FINE)
            .map(|i| {
                let (per_mm, colour) = value(i);
                (colour, 1.0 - (-per_mm * step_mm / SLICES as f32).exp())
            })
            .collect();
        let entry = |at: usize| {
            let ends = [at % TABLE_SIDE, at / TABLE_SIDE].map(|row| (row * FINE) as f32);
            let (mut light, mut through) = ([0.0; 3], 1.0);
            for i in 0..SLICES {
                let share = (i as f32 + 0.5) / SLICES as f32;
                let (colour, taken) = slices[(ends[0] + share * (ends[1] - ends[0])) as usize];
                light = std::array::from_fn(|k| light[k] + through * taken * colour[k]);
                through *= 1.0 - taken;
            }
            [light[0], light[1], light[2], 1.0 - through]
        };
        Self { step_mm, entries: (0..TABLE_SIDE * TABLE_SIDE).map(entry).collect() }
    }

    /// The entry for the values at the two ends of a piece.
    pub(super) fn entry(&self, front: f32, back: f32) -> [f32; 4] {
        let row = |value: f32| {
            let at = (value - VALUES[0]) * ((TABLE_SIDE - 1) as f32 / (VALUES[1] - VALUES[0]));
            (at + 0.5).clamp(0.0, (TABLE_SIDE - 1) as f32) as usize
        };
        self.entries[row(front) + TABLE_SIDE * row(back)]
    }
}
