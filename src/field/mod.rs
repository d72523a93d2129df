//! Fields over the lumen's bricks: exact distance, Gaussian smoothing, Hessian responses, and
//! trilinear samples of a field ([`Sampler`]). Each stage appends launches to a [`Plan`]; a whole
//! chain is one plan.

mod distance;
mod hessian;
mod sampler;

pub use distance::distance;
pub use hessian::{Response, hessian, smooth};
pub use sampler::Sampler;

use crate::compute::{Buf, Plan};
use crate::lumen::Lumen;
use crate::lumen::bricks::BRICK;

/// Buffers of the lumen in a plan. Borrowed: nothing is copied on the CPU.
#[derive(Clone, Copy)]
pub struct LumenBuffers {
    /// Neighbouring slots of each brick, 27 a brick.
    pub near: Buf<u32>,
    /// First voxel of each brick, three a brick.
    pub corner: Buf<i32>,
    /// Inside bits, 16 words a brick.
    pub inside: Buf<u32>,
    /// Number of bricks.
    pub slots: u32,
    /// Voxel spacing, mm.
    pub spacing_mm: glam::DVec3,
    /// Number of inside voxels, which rates are counted in.
    pub items: usize,
}

impl LumenBuffers {
    /// Uploads a lumen.
    pub fn new<'a>(plan: &mut Plan<'a>, lumen: &'a Lumen) -> Self {
        let bricks = &lumen.bricks;
        Self {
            near: plan.upload("near", bytemuck::cast_slice(bricks.near())),
            corner: plan.upload("corner", bytemuck::cast_slice(bricks.corners())),
            inside: plan.upload("inside", bytemuck::cast_slice(&lumen.inside)),
            slots: bricks.len() as u32,
            spacing_mm: lumen.grid.spacing_mm,
            items: lumen.inside_voxels() as usize,
        }
    }

    /// Returns the number of elements of a field.
    pub fn field_len(&self) -> usize {
        self.slots as usize * BRICK
    }
}
