//! Depth of a mask's voxels: their distance to the background.

use glam::{IVec3, UVec3};

use crate::compute::{Array, Plan, run_cpu};
use crate::field::{self, LumenBuffers};
use crate::lumen::bricks::near_offset;
use crate::lumen::{BitVolume, Lumen};
use crate::volume::Grid;

/// Exact distance of every voxel of a mask to the nearest voxel outside it, mm.
pub(super) struct Depth {
    pub lumen: Lumen,
    mm: Array<f32>,
}

impl Depth {
    pub fn of(grid: Grid, mask: &BitVolume) -> Self {
        let lumen = Lumen::new(grid, mask);
        let mut plan = Plan::new();
        let buffers = LumenBuffers::new(&mut plan, &lumen);
        let distance = field::distance(&mut plan, &buffers);
        plan.download(distance);
        let mm = run_cpu(&plan).take(distance);
        Self { lumen, mm }
    }

    pub fn at(&self, v: IVec3) -> f32 {
        self.lumen.bricks.element(self.lumen.own_voxel(v)).map_or(0.0, |e| self.mm[e])
    }

    fn volume_voxel(&self, element: usize) -> IVec3 {
        self.lumen.volume_voxel(self.lumen.bricks.voxel(element))
    }

    /// The deepest voxel, of equal ones the first, and its depth in mm.
    pub fn deepest(&self) -> (UVec3, f64) {
        let elements = self.lumen.elements(&self.lumen.inside);
        let deepest =
            elements.max_by(|a, b| self.mm[*a].total_cmp(&self.mm[*b]).then_with(|| b.cmp(a)));
        deepest.map_or((UVec3::ZERO, 0.0), |e| {
            (self.volume_voxel(e).as_uvec3(), f64::from(self.mm[e]))
        })
    }

    /// Voxels no neighbour of which lies deeper: the ridge, roughly.
    pub fn ridge(&self) -> impl Iterator<Item = UVec3> + '_ {
        self.lumen.elements(&self.lumen.inside).filter_map(|e| {
            let v = self.volume_voxel(e);
            let own = self.mm[e];
            let around = (0..27).map(|n| v + near_offset(n));
            around.into_iter().all(|w| self.at(w) <= own).then(|| v.as_uvec3())
        })
    }
}
