//! Values and distances from the wall, in bricks about the wall.

use glam::{DAffine3, IVec3, UVec3, Vec3};
use rayon::prelude::*;

use super::distance::{squared_distances, steps_within};
use crate::geometry::TriangleBvh;
use crate::lumen::bricks::{BRICK, SIDE};
use crate::lumen::{Bricks, GreyValues, Lumen};

/// Words along the side of a tile: those of its brick and one after them, so that every cell that
/// begins in the brick can be read from its tile alone.
pub const TILE_SIDE: usize = SIDE as usize + 1;
const TILE: usize = TILE_SIDE * TILE_SIDE * TILE_SIDE;
/// Entries of the table for a brick without a tile: outside the lumen, and inside it.
pub const ABSENT: [u32; 2] = [u32::MAX, u32::MAX - 1];
/// Most bytes of tiles: a range that each device can bind.
pub const MAX_TILES_BYTES: u64 = 1 << 27;
/// Distance up to which that from the triangles is taken, in the largest voxel sides: outside the lumen
/// as far as the skin and a cell reach, inside as far as a cell. Beyond it, a voxel's nearest voxel on
/// the other side is as good: only the end of the band depends on it.
const EXACT_SIDES: [f64; 2] = [2.2, 1.3];
/// Least step of a ray through skin and lumen, mean voxel sides.
const MIN_STEP_SIDES: f32 = 0.25;
/// Smallest value of a word, and words for each unit of it.
const MIN_VALUE: f32 = -1024.0;
const VALUE_STEPS: f32 = 16.0;
/// Words for each mm of distance, and the word of the wall.
const DISTANCE_STEPS: f32 = 1024.0;
const AT_WALL: f32 = 32768.0;
/// Farthest distance that a word holds, mm.
pub(super) const MAX_REACH_MM: f64 = 31.0;

/// Why there is nothing to see behind a wall.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TissueError {
    /// The lumen comes from a label map alone.
    #[error(
        "a label map has no values behind the wall: give the image that the label map belongs to"
    )]
    NoValues,
    /// The values are not those of a CT.
    #[error("colours behind the wall stand for CT numbers, and this is a {modality} volume")]
    NoCtNumbers {
        /// Modality of the volume.
        modality: String,
    },
    /// The bricks about the wall are too many.
    #[error(
        "{} MB of values and distances lie within {reach_mm} mm behind the wall, more than the {} MB \
         that each device can bind: look less far behind it", .bytes / 1_000_000, MAX_TILES_BYTES / 1_000_000
    )]
    TooLarge {
        /// Bytes of the tiles.
        bytes: u64,
        /// Distance from the wall that they hold, mm.
        reach_mm: u32,
    },
}

/// Bricks within a reach of a lumen's wall.
#[derive(Debug)]
pub struct TissueBricks {
    /// Brick of the first entry of the table, in bricks of the lumen's grid.
    first: IVec3,
    dims: IVec3,
    /// Slot of each brick, x fastest; one of [`ABSENT`] without a slot.
    table: Vec<u32>,
    places: Vec<IVec3>,
    /// Distance from the wall that the bricks hold, mm.
    reach_mm: f64,
}

/// Values of the volume and signed distances from the wall.
#[derive(Debug)]
pub struct TissueField {
    pub(super) bricks: TissueBricks,
    /// [`TILE_SIDE`]³ words a brick, x fastest: the value above [`MIN_VALUE`] in the low half, the
    /// distance from the wall in the high half, negative inside.
    pub(super) words: Vec<u32>,
    pub(super) voxel_from_world: DAffine3,
    /// Sides of a voxel, mm.
    pub(super) spacing_mm: Vec3,
}

impl TissueBricks {
    /// Finds the bricks that hold a voxel within a reach of the wall.
    ///
    /// # Errors
    /// [`TissueError::TooLarge`]; nothing but the table was made then.
    pub fn new(lumen: &Lumen, band_mm: f64) -> Result<Self, TissueError> {
        let spacing = lumen.grid.spacing_mm;
        // A voxel beyond the band on each side: cells need all their corners.
        let reach_mm = (band_mm + 2.0 * spacing.max_element()).min(MAX_REACH_MM);
        let steps = steps_within(spacing, reach_mm);
        let wide = steps.iter().fold(IVec3::ZERO, |wide, step| wide.max(step.abs()));
        let (origin, table_dims, _) = lumen.bricks.table();
        let (first, dims) = (origin - wide, table_dims.as_ivec3() + 2 * wide);
        let mut bricks = Self { first, dims, table: Vec::new(), places: Vec::new(), reach_mm };

        // 1. Bricks of the volume near one with a voxel of the boundary.
        let low = lumen.own_voxel(IVec3::ZERO) >> 3i32;
        let high = lumen.own_voxel(lumen.volume_grid().dims.as_ivec3() - 1) >> 3i32;
        bricks.table = vec![ABSENT[0]; dims.as_usizevec3().element_product()];
        for (slot, corner) in lumen.bricks.corners().iter().enumerate() {
            if lumen.boundary[8 * slot..][..8].iter().any(|layer| *layer != 0) {
                let place = IVec3::from(*corner) >> 3i32;
                let near = steps.iter().map(|step| place + step);
                for near in near.filter(|at| at.cmpge(low).all() && at.cmple(high).all()) {
                    let at = bricks.entry(near).expect("within the wide table");
                    bricks.table[at] = 0;
                }
            }
        }

        // 2. Their slots, and the side of the others.
        for at in 0..bricks.table.len() {
            let (x, y) = (at as i32 % dims.x, at as i32 / dims.x % dims.y);
            let place = first + IVec3::new(x, y, at as i32 / (dims.x * dims.y));
            if bricks.table[at] == 0 {
                bricks.table[at] = bricks.places.len() as u32;
                bricks.places.push(place);
            } else if lumen.holds(SIDE * place) {
                bricks.table[at] = ABSENT[1];
            }
        }
        let bytes = (bricks.places.len() * TILE * 4) as u64;
        match bytes > MAX_TILES_BYTES {
            true => Err(TissueError::TooLarge { bytes, reach_mm: reach_mm as u32 }),
            false => Ok(bricks),
        }
    }

    /// Bytes of memory that making the tissue takes.
    pub fn working_bytes(&self) -> u64 {
        // Two distances, bits of both sides, and the tile.
        (self.places.len() * (BRICK * 8 + 128 + TILE * 4) + self.table.len() * 4) as u64
    }

    /// Place of each brick, in bricks of the lumen's grid.
    pub(super) fn places(&self) -> &[IVec3] {
        &self.places
    }

    fn entry(&self, place: IVec3) -> Option<usize> {
        let at = place - self.first;
        let is_within = at.cmpge(IVec3::ZERO).all() && at.cmplt(self.dims).all();
        is_within.then(|| (at.x + self.dims.x * (at.y + self.dims.y * at.z)) as usize)
    }

    /// Entry of the table for a brick: its slot, or one of [`ABSENT`].
    pub(super) fn word(&self, place: IVec3) -> u32 {
        self.entry(place).map_or(ABSENT[0], |at| self.table[at])
    }

    /// Slot of a brick.
    pub(super) fn slot(&self, place: IVec3) -> Option<usize> {
        let word = self.word(place);
        (!ABSENT.contains(&word)).then_some(word as usize)
    }

    /// Whether a voxel of the lumen's grid lies in one of the bricks.
    pub fn holds(&self, v: IVec3) -> bool {
        self.slot(v >> 3i32).is_some()
    }

    /// The bricks of the volume whose values are read, for a volume that is read in parts.
    pub fn of_volume(&self, lumen: &Lumen) -> Bricks {
        let dims = lumen.volume_grid().dims;
        let mut mask = crate::lumen::BitVolume::new(dims);
        for place in &self.places {
            let corner = lumen.volume_voxel(SIDE * *place);
            let [lo, hi] = [corner, corner + SIDE + 1]
                .map(|v| v.clamp(IVec3::ZERO, dims.as_ivec3()).as_uvec3());
            for z in lo.z..hi.z {
                for y in (lo.y..hi.y).filter(|_| lo.x < hi.x) {
                    mask.set_run((lo.x, hi.x - 1), y, z);
                }
            }
        }
        Bricks::about(&mask)
    }
}

impl TissueField {
    /// Reads values and computes distances.
    ///
    /// * `values`: real values of the volume that the lumen lies in.
    /// * `wall`: triangles of the wall, LPS mm.
    pub fn new(
        lumen: &Lumen,
        bricks: TissueBricks,
        values: GreyValues<'_>,
        wall: &TriangleBvh,
    ) -> Self {
        let offsets = signed_distances(lumen, &bricks, wall);
        let dims = lumen.volume_grid().dims.as_ivec3();
        let value = |v: IVec3| -> f32 {
            let at = lumen.volume_voxel(v);
            let is_there = at.cmpge(IVec3::ZERO).all() && at.cmplt(dims).all();
            // Beyond the volume there is nothing to see.
            if is_there {
                values.real(UVec3::new(at.x as u32, at.y as u32, at.z as u32)) as f32
            } else {
                MIN_VALUE
            }
        };
        let offset = |v: IVec3| -> f32 {
            match bricks.slot(v >> 3i32) {
                Some(slot) => offsets[slot * BRICK + crate::lumen::bricks::local(v)],
                None if lumen.holds(v) => -bricks.reach_mm as f32,
                None => bricks.reach_mm as f32,
            }
        };
        let mut words = vec![0; bricks.places.len() * TILE];
        words.par_chunks_exact_mut(TILE).zip(&bricks.places).for_each(|(words, place)| {
            crate::task::checkpoint();
            for (at, word) in words.iter_mut().enumerate() {
                let v = [at % TILE_SIDE, at / TILE_SIDE % TILE_SIDE, at / TILE_SIDE / TILE_SIDE];
                let v = SIDE * *place + IVec3::from(v.map(|i| i as i32));
                *word = packed(value(v), offset(v));
            }
        });
        Self {
            bricks,
            words,
            voxel_from_world: lumen.grid.voxel_from_world(),
            spacing_mm: lumen.grid.spacing_mm.as_vec3(),
        }
    }

    /// Bytes of values and distances.
    pub fn bytes(&self) -> u64 {
        4 * (self.words.len() + self.bricks.table.len()) as u64
    }

    /// The table for a device: first brick, dimensions, entries (x fastest).
    pub fn table(&self) -> (IVec3, IVec3, &[u32]) {
        (self.bricks.first, self.bricks.dims, &self.bricks.table)
    }

    /// Tiles of all bricks in the order of their slots.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// Transform from LPS mm to voxels of the bricks.
    pub fn voxel_from_world(&self) -> DAffine3 {
        self.voxel_from_world
    }

    /// Mean side of a voxel, mm.
    pub fn mean_side_mm(&self) -> f32 {
        self.spacing_mm.element_product().cbrt()
    }

    /// Least step of a ray through skin and lumen, mm.
    pub fn least_step_mm(&self) -> f32 {
        MIN_STEP_SIDES * self.mean_side_mm()
    }

    /// Distance from the wall that the bricks hold, mm.
    pub fn reach_mm(&self) -> f32 {
        self.bricks.reach_mm as f32
    }
}

/// Returns the distance of each voxel of the bricks from the wall, mm, negative inside the lumen.
fn signed_distances(lumen: &Lumen, bricks: &TissueBricks, wall: &TriangleBvh) -> Vec<f32> {
    let spacing = lumen.grid.spacing_mm;
    let mean = spacing.element_product().cbrt();
    let exact_mm = EXACT_SIDES.map(|sides| (sides * spacing.max_element()) as f32);
    let inside: Vec<[u64; 8]> = bricks
        .places
        .iter()
        .map(|place| match lumen.bricks.slot_of(SIDE * *place) {
            Some(slot) => lumen.inside[8 * slot..][..8].try_into().expect("eight layers"),
            None => [0; 8],
        })
        .collect();
    let outside: Vec<[u64; 8]> = inside.iter().map(|layers| layers.map(|bits| !bits)).collect();
    let reach = bricks.reach_mm as f32;
    let from_lumen = squared_distances(bricks, &inside, spacing, reach);
    let from_outside = squared_distances(bricks, &outside, spacing, reach);

    let world_from_voxel = lumen.grid.world_from_voxel();
    let mut offsets = from_lumen;
    let both = offsets.par_chunks_exact_mut(BRICK).zip(from_outside.par_chunks_exact(BRICK));
    both.zip(&bricks.places).for_each(|((offsets, from_outside), place)| {
        crate::task::checkpoint();
        // From a voxel to the next, the distance grows by a step at most.
        let mut least_mm = f64::INFINITY;
        for (at, (offset, from_outside)) in offsets.iter_mut().zip(from_outside).enumerate() {
            // One of the two is 0.
            let is_inside = *offset == 0.0;
            let to_voxel = offset.max(*from_outside).sqrt();
            let size = if to_voxel <= exact_mm[usize::from(is_inside)] {
                let v = [at % 8, at / 8 % 8, at / 64].map(|i| i as i32);
                let v = SIDE * *place + IVec3::from(v);
                let p = world_from_voxel.transform_point3(v.as_dvec3());
                if v.x & 7 == 0 {
                    least_mm = f64::INFINITY;
                }
                let limit_mm = f64::from(to_voxel).min((least_mm + spacing.x) * 1.000_001);
                least_mm = wall.distance(p, limit_mm);
                least_mm as f32
            } else {
                least_mm = f64::INFINITY;
                // The wall is about half a voxel before the voxel on the other side.
                (to_voxel - 0.5 * mean as f32).min(reach)
            };
            *offset = if is_inside { -size } else { size };
        }
    });
    offsets
}

/// Packs a value and a distance.
fn packed(value: f32, offset_mm: f32) -> u32 {
    let half = |x: f32| x.round().clamp(0.0, 65535.0) as u32;
    half((value - MIN_VALUE) * VALUE_STEPS) | half(offset_mm * DISTANCE_STEPS + AT_WALL) << 16
}

/// The value and the distance of a word.
pub(super) fn unpacked(word: u32) -> (f32, f32) {
    let value = (word & 0xffff) as f32 * (1.0 / VALUE_STEPS) + MIN_VALUE;
    (value, ((word >> 16) as f32 - AT_WALL) * (1.0 / DISTANCE_STEPS))
}
