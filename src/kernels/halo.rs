//! A brick of a field with the voxels about it.

use crate::lumen::bricks::{BRICK, NONE, near_index};

/// A brick of a field with a rim of one voxel: 10³ values, absent bricks 0.
pub struct Halo([f32; 1000]);

impl Halo {
    /// Reads around brick `slot` of field `f`, by the flat table of neighbours.
    pub fn gather(near: &[u32], f: &[f32], slot: usize) -> Self {
        let mut out = [0.0; 1000];
        let near = &near[slot * 27..][..27];
        let split = |q: i32| (q >> 3, (q & 7) as usize);
        for z in -1..9 {
            let (dz, lz) = split(z);
            for y in -1..9 {
                let (dy, ly) = split(y);
                let row = ((z + 1) * 100 + (y + 1) * 10) as usize;
                let line = 64 * lz + 8 * ly;
                let at = |dx: i32| near[near_index(dx, dy, dz)];
                if at(-1) != NONE {
                    out[row] = f[at(-1) as usize * BRICK + line + 7];
                }
                if at(0) != NONE {
                    out[row + 1..row + 9].copy_from_slice(&f[at(0) as usize * BRICK + line..][..8]);
                }
                if at(1) != NONE {
                    out[row + 9] = f[at(1) as usize * BRICK + line];
                }
            }
        }
        Self(out)
    }

    /// Place of a brick-local voxel.
    #[inline]
    pub fn centre(local: usize) -> usize {
        (local & 7) + 1 + 10 * ((local >> 3 & 7) + 1) + 100 * ((local >> 6) + 1)
    }

    /// The rows of ten around a row of eight (y + 8 z), by y then z from below to above.
    #[inline]
    pub fn rows(&self, row: usize) -> [&[f32; 10]; 9] {
        let first = 10 * (row & 7) + 100 * (row >> 3);
        std::array::from_fn(|n| {
            let at = first + 10 * (n % 3) + 100 * (n / 3);
            self.0[at..at + 10].try_into().expect("ten values")
        })
    }

    /// The values, x fastest.
    #[inline]
    pub fn values(&self) -> &[f32; 1000] {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use glam::IVec3;

    use super::*;
    use crate::lumen::{BitVolume, Lumen};
    use crate::volume::Grid;

    #[test]
    fn a_halo_holds_the_brick_and_its_rim() {
        let grid = Grid::axis_aligned([31, 29, 41], [1.0; 3]);
        let mut mask = BitVolume::new(grid.dims);
        for v in (0..grid.len()).filter(|i| i % 5 < 3).map(|i| grid.voxel(i)) {
            mask.set(v.x, v.y, v.z);
        }
        let lumen = Lumen::of_volume(grid, &mask);
        let near: Vec<u32> = lumen.bricks.near().iter().flatten().copied().collect();
        let f: Vec<f32> = (0..lumen.bricks.field_len())
            .map(|e| {
                let v = lumen.bricks.voxel(e);
                (v.x + 100 * v.y + 10_000 * v.z) as f32
            })
            .collect();
        let slot = lumen.bricks.len() / 2;
        let halo = Halo::gather(&near, &f, slot);
        for local in [0, 7, 511, 100] {
            let v = lumen.bricks.voxel(slot * BRICK + local);
            for d in [IVec3::ZERO, IVec3::X, IVec3::new(-1, 1, -1)] {
                let c = Halo::centre(local) as i32 + d.x + 10 * d.y + 100 * d.z;
                let want = lumen.bricks.element(v + d).map_or(0.0, |e| f[e]);
                assert_eq!(halo.values()[c as usize], want);
            }
        }
    }
}
