//! Launches over bricks.

use crate::compute::{Buf, DeviceCopy, Plan};
use crate::kernels::blur_axis;
use crate::lumen::Bricks;
use crate::volume::Grid;

/// Buffers and sizes that all launches over some bricks have in common.
pub(super) struct BrickLaunches {
    pub near: Buf<u32>,
    pub corner: Buf<i32>,
    pub slots: u32,
    edge: [i32; 3],
}

/// Copies of the tables of bricks on a device.
#[derive(Default)]
pub(super) struct BrickCopies {
    near: DeviceCopy,
    corner: DeviceCopy,
}

impl BrickLaunches {
    /// * `copies`: those of the tables of `bricks`.
    pub fn new<'p>(
        plan: &mut Plan<'p>,
        bricks: &'p Bricks,
        copies: &'p BrickCopies,
        grid: &Grid,
    ) -> Self {
        let (near, corner) = (bricks.near(), bricks.corners());
        Self {
            near: plan.upload_kept("near", bytemuck::cast_slice(near), &copies.near),
            corner: plan.upload_kept("corner", bytemuck::cast_slice(corner), &copies.corner),
            slots: bricks.len() as u32,
            edge: (grid.dims.as_ivec3() - 1).to_array(),
        }
    }

    /// Appends a Gaussian along the three axes. `spare` and `to` are overwritten.
    pub fn blur<'p>(
        &self,
        plan: &mut Plan<'p>,
        weights: &'p [Vec<i32>; 3],
        from: Buf<i32>,
        spare: [Buf<i32>; 2],
        to: Buf<i32>,
        missing: i32,
    ) {
        let n = from.len();
        let way = [(from, spare[0]), (spare[0], spare[1]), (spare[1], to)];
        for (axis, (f, g)) in way.into_iter().enumerate() {
            let weight = plan.upload("weights of a Gaussian", &weights[axis]);
            let params = blur_axis::Params {
                slots: self.slots,
                axis: axis as u32,
                radius: weights[axis].len() as i32 - 1,
                low: 0,
                high: self.edge[axis],
                missing,
            };
            let bindings =
                blur_axis::Bindings { near: self.near, corner: self.corner, weight, f, g };
            plan.launch(&blur_axis::KERNEL, bindings, params, n / 8, n);
        }
    }
}
