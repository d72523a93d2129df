//! A brick with voxels around it, copied into one dense block, for the twins of kernels that read
//! neighbours.

use crate::lumen::bricks::{BRICK, NONE, near_index};

/// Returns the element of the voxel at `p` (components −8 to 15) of a brick, by the flat table of
/// neighbours.
#[inline]
pub(super) fn element(near: &[u32], slot: usize, p: [i32; 3]) -> Option<usize> {
    let over = p.map(|c| c >> 3);
    let slot = if over == [0; 3] {
        slot
    } else {
        match near[slot * 27 + near_index(over[0], over[1], over[2])] {
            NONE => return None,
            s => s as usize,
        }
    };
    Some(slot * BRICK + ((p[0] & 7) + 8 * (p[1] & 7) + 64 * (p[2] & 7)) as usize)
}

/// The values of a brick and of `halo` voxels on each side, x fastest.
#[derive(Clone)]
pub(super) struct BrickBlock {
    halo: i32,
    side: usize,
    values: Vec<i32>,
}

impl BrickBlock {
    pub(super) fn new(halo: i32) -> Self {
        let side = (8 + 2 * halo) as usize;
        Self { halo, side, values: vec![0; side * side * side] }
    }

    /// Reads around a brick; voxels of absent bricks are `missing`.
    pub(super) fn fill(&mut self, near: &[u32], slot: usize, f: &[i32], missing: i32) {
        let halo = self.halo;
        let mut rows = self.values.chunks_exact_mut(self.side);
        for z in -halo..8 + halo {
            for y in -halo..8 + halo {
                let Some(row) = rows.next() else { return };
                let (low, rest) = row.split_at_mut(halo as usize);
                let (middle, high) = rest.split_at_mut(8);
                let part =
                    |x: i32, from: usize, to: &mut [i32]| match element(near, slot, [x, y, z]) {
                        Some(e) => {
                            let start = e - (x & 7) as usize + from;
                            to.copy_from_slice(&f[start..start + to.len()]);
                        }
                        None => to.fill(missing),
                    };
                part(-8, 8 - halo as usize, low);
                part(0, 0, middle);
                part(8, 0, high);
            }
        }
    }

    /// Returns the index of the voxel at `p` (components −halo to 7 + halo).
    #[inline]
    pub(super) fn index(&self, p: [i32; 3]) -> usize {
        let [x, y, z] = p.map(|c| (c + self.halo) as usize);
        x + self.side * (y + self.side * z)
    }

    /// Returns the step of the index along each axis.
    pub(super) fn strides(&self) -> [usize; 3] {
        [1, self.side, self.side * self.side]
    }

    pub(super) fn values(&self) -> &[i32] {
        &self.values
    }

    pub(super) fn values_mut(&mut self) -> &mut [i32] {
        &mut self.values
    }
}

/// Returns the position of an element within its brick.
#[inline]
pub(super) fn place(local: usize) -> [i32; 3] {
    [(local & 7) as i32, (local >> 3 & 7) as i32, (local >> 6) as i32]
}

/// Returns the bit of an element, of words of 32.
#[inline]
pub(super) fn bit(words: &[u32], element: usize) -> bool {
    words[element >> 5] >> (element & 31) & 1 != 0
}

/// Returns the number of bits by which a vector is shifted right so that its components are below
/// 2¹⁴ in size, as in `shaders/lib/wall.wgsl`.
#[inline]
pub(super) fn excess_bits(v: [i32; 3]) -> u32 {
    let most = v.iter().fold(1, |most, c| most | c.unsigned_abs());
    (31 - most.leading_zeros()).saturating_sub(13)
}

/// Returns the length of a vector whose components are below 2¹⁴ in size, rounded down.
#[inline]
pub(super) fn length_of(v: [i32; 3]) -> i32 {
    let square: u32 = v.iter().map(|c| (c * c) as u32).sum();
    square.isqrt() as i32
}
