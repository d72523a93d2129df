//! Bricks of 8³ voxels covering the lumen and a one-voxel rim. Every field is an array in slot
//! order: voxel `local = x + 8 y + 64 z` of slot `s` is element `512 s + local`.

use glam::{IVec3, UVec3};
use rayon::prelude::*;

use super::BitVolume;

/// Voxels along a brick's side.
pub const SIDE: i32 = 8;
/// Voxels of a brick.
pub const BRICK: usize = 512;
/// Slot number where there is no brick.
pub const NONE: u32 = u32::MAX;

/// Table of the bricks in use. Slots are numbered in z, y, x order of the bricks' positions.
#[derive(Clone, Debug)]
pub struct Bricks {
    /// Brick coordinates of the table's first entry; the rim may lie outside the volume.
    origin: IVec3,
    table_dims: UVec3,
    table: Vec<u32>,
    corners: Vec<[i32; 3]>,
    near: Vec<[u32; 27]>,
}

/// Place of a neighbour in `near`: offsets are -1, 0 or 1.
#[inline]
pub const fn near_index(dx: i32, dy: i32, dz: i32) -> usize {
    ((dx + 1) + 3 * (dy + 1) + 9 * (dz + 1)) as usize
}

/// Offset of one of the 27 neighbours, by its place in `near`.
#[inline]
pub const fn near_offset(n: usize) -> IVec3 {
    let n = n as i32;
    IVec3::new(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1)
}

impl Bricks {
    /// Bricks that hold the voxels of a mask, and their 26-neighbours.
    pub fn about(mask: &BitVolume) -> Self {
        of_mask(mask, mask.bounds(), IVec3::ZERO).0
    }
    /// Number of bricks.
    pub fn len(&self) -> usize {
        self.corners.len()
    }
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.corners.is_empty()
    }
    /// Voxels of all bricks: the length of a field.
    pub fn field_len(&self) -> usize {
        self.len() * BRICK
    }
    /// First voxel of each brick; may be negative.
    pub fn corners(&self) -> &[[i32; 3]] {
        &self.corners
    }
    /// Slots of the 27 bricks around each one ([`near_index`]), [`NONE`] where there is none.
    pub fn near(&self) -> &[[u32; 27]] {
        &self.near
    }
    /// Slot of the brick that holds a voxel.
    #[inline]
    pub fn slot_of(&self, v: IVec3) -> Option<usize> {
        let b: IVec3 = (v >> 3i32) - self.origin;
        if b.cmplt(IVec3::ZERO).any() || b.cmpge(self.table_dims.as_ivec3()).any() {
            return None;
        }
        let d = self.table_dims;
        let s =
            self.table[b.x as usize + d.x as usize * (b.y as usize + d.y as usize * b.z as usize)];
        (s != NONE).then_some(s as usize)
    }
    /// Element of a field that belongs to a voxel.
    #[inline]
    pub fn element(&self, v: IVec3) -> Option<usize> {
        self.slot_of(v).map(|s| s * BRICK + local(v))
    }
    /// Voxel of a field's element.
    #[inline]
    pub fn voxel(&self, element: usize) -> IVec3 {
        let l = (element % BRICK) as i32;
        IVec3::from(self.corners[element / BRICK]) + IVec3::new(l & 7, l >> 3 & 7, l >> 6)
    }
    /// The table for ray walks on a device: first brick, dimensions, slots (x fastest).
    pub fn table(&self) -> (IVec3, UVec3, &[u32]) {
        (self.origin, self.table_dims, &self.table)
    }
    /// Element of the neighbour `d` (components -1, 0, 1) of an element, through the slot's own
    /// neighbours: no table look-up inside a brick.
    #[inline]
    pub fn step(&self, element: usize, d: IVec3) -> Option<usize> {
        let l = (element % BRICK) as i32;
        let p = IVec3::new(l & 7, l >> 3 & 7, l >> 6) + d;
        let over: IVec3 = p >> 3i32;
        let slot = element / BRICK;
        let slot = if over == IVec3::ZERO {
            slot
        } else {
            match self.near[slot][near_index(over.x, over.y, over.z)] {
                NONE => return None,
                s => s as usize,
            }
        };
        Some(slot * BRICK + local(p))
    }
}

/// Element of a voxel inside its brick.
#[inline]
pub fn local(v: IVec3) -> usize {
    ((v.x & 7) + 8 * (v.y & 7) + 64 * (v.z & 7)) as usize
}

/// Bits as a field of zeros and ones.
pub fn bit_field(bits: &[u64]) -> Vec<f32> {
    bits.iter().flat_map(|w| (0..64).map(move |i| (w >> i & 1) as f32)).collect()
}

/// Bricks of a mask and its bits in slot order (eight words a slot, one a z-layer; bit x + 8 y).
///
/// * `bounds`: the mask's own.
/// * `corner`: voxel of the mask that is voxel (0, 0, 0) of the bricks.
pub(super) fn of_mask(
    mask: &BitVolume,
    bounds: Option<(UVec3, UVec3)>,
    corner: IVec3,
) -> (Bricks, Vec<u64>) {
    let Some((lo, hi)) = bounds else {
        let empty = Bricks {
            origin: IVec3::ZERO,
            table_dims: UVec3::ZERO,
            table: Vec::new(),
            corners: Vec::new(),
            near: Vec::new(),
        };
        return (empty, Vec::new());
    };
    let (first, last): (IVec3, IVec3) =
        ((lo.as_ivec3() - corner) >> 3i32, (hi.as_ivec3() - corner) >> 3i32);
    // One brick of margin all around holds any rim.
    let origin: IVec3 = first - 1;
    let table_dims = (last + 2 - origin).as_uvec3();
    let d = table_dims.as_usizevec3();
    let index = |b: IVec3| {
        let b = (b - origin).as_usizevec3();
        b.x + d.x * (b.y + d.y * b.z)
    };
    // Bits of the bricks that hold some, in scan order of the table.
    let filled: Vec<(IVec3, [u64; 8])> = (first.z..last.z + 1)
        .into_par_iter()
        .map(|bz| {
            let mut layer = Vec::new();
            for by in first.y..=last.y {
                filled_of(mask, corner, (first.x, last.x), (by, bz), &mut layer);
            }
            layer
        })
        .flatten_iter()
        .collect();
    let mut table = vec![NONE; d.x * d.y * d.z];
    for (i, (b, _)) in filled.iter().enumerate() {
        table[index(*b)] = i as u32;
    }
    // A brick exists when it holds a bit or a neighbour of one.
    const RIM: u32 = NONE - 1;
    for (b, bits) in &filled {
        for (n, at) in reached(bits).enumerate() {
            if at {
                let to = *b + near_offset(n);
                let t = &mut table[index(to)];
                if *t == NONE {
                    *t = RIM;
                }
            }
        }
    }
    let mut corners = Vec::with_capacity(filled.len() * 2);
    let mut inside = Vec::with_capacity(filled.len() * 16);
    for (i, t) in table.iter_mut().enumerate() {
        if *t == NONE {
            continue;
        }
        let bits = if *t == RIM { [0; 8] } else { filled[*t as usize].1 };
        *t = corners.len() as u32;
        let b =
            origin + IVec3::new((i % d.x) as i32, (i / d.x % d.y) as i32, (i / d.x / d.y) as i32);
        corners.push((b * SIDE).to_array());
        inside.extend_from_slice(&bits);
    }
    let mut bricks = Bricks { origin, table_dims, table, corners, near: Vec::new() };
    bricks.near = (0..bricks.len())
        .into_par_iter()
        .with_min_len(256)
        .map(|s| {
            let c = IVec3::from(bricks.corners[s]);
            std::array::from_fn(|n| {
                let to = c + SIDE * near_offset(n);
                bricks.slot_of(to).map_or(NONE, |s| s as u32)
            })
        })
        .collect();
    (bricks, inside)
}

/// Returns the bricks within one brick of every voxel at most `reach_vox` voxels from a mask,
/// clipped to the volume, for computations that read the mask's surroundings.
pub fn surrounding_bricks(mask: &BitVolume, reach_vox: f64) -> Bricks {
    let near = super::dilated(mask, glam::DVec3::ONE, reach_vox);
    let bounds = near.bounds();
    let (bricks, inside) = of_mask(&near, bounds, IVec3::ZERO);
    // A voxel in the middle of a brick stands for it, and calls for no other.
    let last: IVec3 = (mask.dims().as_ivec3() - 1) >> 3i32;
    let mut coarse = BitVolume::new((last + 1).as_uvec3());
    for (slot, c) in bricks.corners().iter().enumerate() {
        if inside[8 * slot..][..8].iter().any(|w| *w != 0) {
            let b: UVec3 = (IVec3::from(*c) >> 3i32).as_uvec3();
            coarse.set(b.x, b.y, b.z);
        }
    }
    let coarse = super::dilated(&coarse, glam::DVec3::ONE, 1.8);
    let mut marks = BitVolume::new(mask.dims());
    for b in coarse.voxels() {
        let v = (b * 8 + 3).min(mask.dims() - 1);
        marks.set(v.x, v.y, v.z);
    }
    let bounds = marks.bounds();
    of_mask(&marks, bounds, IVec3::ZERO).0
}

/// The bits of a mask in bricks: eight words a slot, as [`super::Lumen::inside`].
pub fn bits_in(bricks: &Bricks, mask: &BitVolume) -> Vec<u64> {
    let dims = mask.dims().as_ivec3();
    let mut out = vec![0u64; 8 * bricks.len()];
    out.par_chunks_exact_mut(8).zip(bricks.corners()).with_min_len(64).for_each(|(words, c)| {
        if !(0..dims.x).contains(&c[0]) {
            return;
        }
        for (z, word) in words.iter_mut().enumerate() {
            for y in 0..8 {
                let (row, slice) = (c[1] + y, c[2] + z as i32);
                if (0..dims.y).contains(&row) && (0..dims.z).contains(&slice) {
                    let row = mask.row(row as u32, slice as u32);
                    *word |= (row[c[0] as usize >> 6] >> (c[0] & 63) & 255) << (8 * y);
                }
            }
        }
    });
    out
}

/// Appends the bricks with bits of one row of bricks along x, ascending.
///
/// * `first`, `last`: places of the row's bricks along x; `by`, `bz`: the row's place.
fn filled_of(
    mask: &BitVolume,
    corner: IVec3,
    (first, last): (i32, i32),
    (by, bz): (i32, i32),
    out: &mut Vec<(IVec3, [u64; 8])>,
) {
    let dims = mask.dims().as_ivec3();
    let rows: [&[u64]; 64] = std::array::from_fn(|l| {
        let (y, z) = (corner.y + 8 * by + (l as i32 & 7), corner.z + 8 * bz + (l as i32 >> 3));
        let is_row = (0..dims.y).contains(&y) && (0..dims.z).contains(&z);
        if is_row { mask.row(y as u32, z as u32) } else { &[] }
    });
    // Eight bricks at a time are a word of each row, which may begin within one of the mask's.
    for b in (first..=last).step_by(8) {
        let x = corner.x + 8 * b;
        let words = rows.map(|row| word_at(row, x));
        let any = words.iter().fold(0, |any, w| any | w);
        for k in (0..8).filter(|k| any >> (8 * k) & 255 != 0) {
            let bits = std::array::from_fn(|z| {
                (0..8).fold(0, |layer, y| layer | (words[8 * z + y] >> (8 * k) & 255) << (8 * y))
            });
            out.push((IVec3::new(b + k, by, bz), bits));
        }
    }
}

/// Returns the 64 bits of a row from a voxel on, which may lie before the row.
fn word_at(row: &[u64], x: i32) -> u64 {
    let word = |i: i32| usize::try_from(i).ok().and_then(|i| row.get(i)).copied().unwrap_or(0);
    let (low, shift) = (x >> 6, x & 63);
    match shift {
        0 => word(low),
        _ => word(low) >> shift | word(low + 1) << (64 - shift),
    }
}

/// For each of the 27 directions, whether some bit of the brick has a 26-neighbour there.
fn reached(bits: &[u64; 8]) -> impl Iterator<Item = bool> + '_ {
    const X: [u64; 3] = [0x0101_0101_0101_0101, !0, 0x8080_8080_8080_8080];
    const Y: [u64; 3] = [0xff, !0, 0xff << 56];
    let all = bits.iter().fold(0, |a, b| a | b);
    let layers = [bits[0], all, bits[7]];
    (0..27).map(move |n| layers[n / 9] & Y[n / 3 % 3] & X[n % 3] != 0)
}
