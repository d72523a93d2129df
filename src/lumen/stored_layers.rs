//! Fields of a lumen as dense volumes, in the order in which the file stores its voxels.

use glam::{IVec3, UVec3};

use super::Lumen;
use super::bricks::{BRICK, SIDE};

/// Writer of layers of eight slices along the slowest axis of the file.
pub(super) struct StoredLayers<'a> {
    lumen: &'a Lumen,
    /// Size of the file's volume.
    dims: UVec3,
    /// Place of voxel (0, 0, 0) of the lumen's grid in the file, and the steps along its axes.
    first: i64,
    step: [i64; 3],
    /// The lumen's axis that the file stores slowest.
    slow: usize,
    /// Place along the file's slowest axis of voxel 0 of the lumen's grid, and the step along it.
    slow_first: i32,
    slow_step: i32,
}

impl<'a> StoredLayers<'a> {
    pub fn new(lumen: &'a Lumen) -> Self {
        let dims = lumen.stored_grid().dims;
        let strides = [1, i64::from(dims.x), i64::from(dims.x) * i64::from(dims.y)];
        let place = |v: IVec3| -> i64 {
            let stored = lumen.stored_voxel(v);
            (0..3).map(|k| i64::from(stored[k]) * strides[k]).sum()
        };
        let first = place(IVec3::ZERO);
        let step = IVec3::AXES.map(|axis| place(axis) - first);
        let along = |v: IVec3| lumen.stored_voxel(v).z;
        let slow_first = along(IVec3::ZERO);
        let slow_steps = IVec3::AXES.map(|axis| along(axis) - slow_first);
        let slow = (0..3).find(|k| slow_steps[*k] != 0).unwrap_or(2);
        Self { lumen, dims, first, step, slow, slow_first, slow_step: slow_steps[slow] }
    }

    /// Voxels of eight slices.
    pub fn layer_len(&self) -> usize {
        8 * self.dims.x as usize * self.dims.y as usize
    }

    /// Fills up to eight slices from the bricks that lie in them.
    pub fn fill<T: Copy>(&self, layer: usize, field: &[T], out: &mut [T]) {
        self.each(layer, out.len(), |from, to| out[to] = field[from]);
    }

    /// Calls `each` for every voxel of a brick within the first `len` voxels of a layer, with its
    /// element in the field and its place in the layer.
    pub fn each(&self, layer: usize, len: usize, mut each: impl FnMut(usize, usize)) {
        let slices = (len / (self.layer_len() / 8)) as i32;
        let from = 8 * layer as i32;
        // Bounds of the layer, and of the volume, in voxels of the lumen's grid.
        let [a, b] = [from, from + slices - 1].map(|z| (z - self.slow_first) * self.slow_step);
        let volume = self.lumen.volume_grid();
        let mut low = self.lumen.own_voxel(IVec3::ZERO);
        let mut end = low + volume.dims.as_ivec3();
        (low[self.slow], end[self.slow]) = (a.min(b), a.max(b) + 1);
        let start = self.first - layer as i64 * self.layer_len() as i64;
        for (slot, corner) in self.lumen.bricks.corners().iter().enumerate() {
            let corner = IVec3::from(*corner);
            let (lo, hi) = (low.max(corner), end.min(corner + SIDE));
            for z in lo.z..hi.z {
                for y in lo.y..hi.y {
                    let p = IVec3::new(lo.x, y, z);
                    let local = p - corner;
                    let element = slot * BRICK + (local.x + 8 * local.y + 64 * local.z) as usize;
                    let row: i64 = (0..3).map(|k| i64::from(p[k]) * self.step[k]).sum();
                    for x in 0..(hi.x - lo.x).max(0) {
                        let to = start + row + i64::from(x) * self.step[0];
                        each(element + x as usize, to as usize);
                    }
                }
            }
        }
    }
}
