//! Trilinear samples of a brick field in local coordinates.
//!
//! Local coordinates are millimetres along the index axes: voxel times spacing. They differ from
//! patient space by a rigid motion (and a mirror on left-handed grids), so lengths are true.

use glam::{DVec3, IVec3};

use crate::lumen::Lumen;

/// A field with its lumen.
#[derive(Clone, Copy)]
pub struct Sampler<'a> {
    /// Where the voxels are.
    pub lumen: &'a Lumen,
    /// Values in slot order, 0 beyond the bricks.
    pub field: &'a [f32],
}

impl Sampler<'_> {
    /// Value at a voxel.
    #[inline]
    pub fn voxel(&self, v: IVec3) -> f64 {
        self.lumen.bricks.element(v).map_or(0.0, |e| f64::from(self.field[e]))
    }

    /// Trilinear value at a local point, mm.
    pub fn at(&self, p_mm: DVec3) -> f64 {
        let q = p_mm / self.lumen.grid.spacing_mm;
        let base = q.floor();
        let t = q - base;
        let b = base.as_ivec3();
        let corner = match self.lumen.bricks.element(b) {
            Some(e) => e,
            None => return self.slow(b, t),
        };
        let mut sum = 0.0;
        for k in 0..8 {
            let d = IVec3::new(k & 1, k >> 1 & 1, k >> 2);
            if let Some(e) = self.lumen.bricks.step(corner, d) {
                sum += weight(t, d) * f64::from(self.field[e]);
            }
        }
        sum
    }

    fn slow(&self, b: IVec3, t: DVec3) -> f64 {
        (0..8)
            .map(|k| IVec3::new(k & 1, k >> 1 & 1, k >> 2))
            .map(|d| weight(t, d) * self.voxel(b + d))
            .sum()
    }
}

#[inline]
fn weight(t: DVec3, d: IVec3) -> f64 {
    let side = |t: f64, d: i32| if d == 0 { 1.0 - t } else { t };
    side(t.x, d.x) * side(t.y, d.y) * side(t.z, d.z)
}
