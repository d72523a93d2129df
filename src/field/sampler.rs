//! Trilinear samples of a brick field in local coordinates.
//!
//! Local coordinates are millimetres along the index axes: voxel times spacing. They differ from
//! patient space by a rigid motion (and a mirror on left-handed grids), so lengths are true.

use glam::{DVec3, IVec3};

use crate::lumen::Lumen;

/// A field with its lumen.
#[derive(Clone, Copy)]
pub struct Sampler<'a> {
    /// Lumen whose bricks hold the field.
    pub lumen: &'a Lumen,
    /// Values of the field in slot order; it is 0 beyond the bricks.
    pub field: &'a [f32],
}

impl Sampler<'_> {
    /// Returns the value at a voxel.
    #[inline]
    pub fn voxel(&self, v: IVec3) -> f64 {
        self.lumen.bricks.element(v).map_or(0.0, |e| f64::from(self.field[e]))
    }

    /// Returns the trilinear value at a local point, mm.
    pub fn at(&self, p_mm: DVec3) -> f64 {
        let q = p_mm / self.lumen.grid.spacing_mm;
        let (b, t) = parted(q);
        let corner = match self.lumen.bricks.element(b) {
            Some(e) => e,
            None => return self.slow(b, t),
        };
        const CORNERS: [IVec3; 8] = {
            let mut out = [IVec3::ZERO; 8];
            let mut k = 0;
            while k < 8 {
                out[k] = IVec3::new(k as i32 & 1, k as i32 >> 1 & 1, k as i32 >> 2);
                k += 1;
            }
            out
        };
        if (b & 7).cmplt(IVec3::splat(7)).all() {
            // All eight in one brick: most samples.
            let field = &self.field[corner..][..74];
            let along_x = |at: usize| {
                let [a, b] = [field[at], field[at + 1]].map(f64::from);
                a + (b - a) * t.x
            };
            let along_y = |at: usize| {
                let [a, b] = [along_x(at), along_x(at + 8)];
                a + (b - a) * t.y
            };
            let [a, b] = [along_y(0), along_y(64)];
            return a + (b - a) * t.z;
        }
        let mut sum = 0.0;
        for d in CORNERS {
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

/// Splits coordinates into the voxel below and the fraction. Not by `floor`, which not every x86-64
/// has an instruction for: as a function it took a fifth of a sample.
#[inline]
fn parted(q: DVec3) -> (IVec3, DVec3) {
    let cut = q.as_ivec3();
    let above = q.cmplt(cut.as_dvec3());
    let b = cut - IVec3::new(above.x.into(), above.y.into(), above.z.into());
    (b, q - b.as_dvec3())
}

#[inline]
fn weight(t: DVec3, d: IVec3) -> f64 {
    let side = |t: f64, d: i32| if d == 0 { 1.0 - t } else { t };
    side(t.x, d.x) * side(t.y, d.y) * side(t.z, d.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_of_sample_points_equal_floor() {
        for x in [-3.0, -2.75, -1.0, -1e-300, -0.0, 0.0, 0.25, 1.0, 6.999_999, 7.0, 1e6 + 0.5] {
            let q = DVec3::new(x, -x, x - 0.5);
            let (b, t) = parted(q);
            assert_eq!((b, t), (q.floor().as_ivec3(), q - q.floor()));
        }
    }
}
