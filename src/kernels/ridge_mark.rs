//! CPU twin of `ridge_mark`, and the ridge test at one voxel that it shares with `ridge_measure`.
//! Formulas as in `shaders/lib/ridge.wgsl`; f64 where it costs nothing.

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::hessian::eigenvalues;
pub use super::host::ridge_mark::{Bindings, Params};
use super::host::ridge_mark::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::{BRICK, NONE, near_index};

/// See `shaders/ridge_mark.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "voxels", tolerance: Tolerance::EXACT };

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

    /// Returns the index in the block of a voxel of the brick.
    #[inline]
    pub fn centre(local: usize) -> usize {
        (local & 7) + 1 + 10 * ((local >> 3 & 7) + 1) + 100 * ((local >> 6) + 1)
    }

    /// Whether the field rises by more than `rate` a mm towards some neighbour.
    fn climbs(&self, local: usize, h: Vec3, rate: f32) -> bool {
        let c = Self::centre(local);
        let at_wall = self.0[c] < 1.5 * h.max_element() && rate < 1.0;
        let limit = if at_wall { 0.4 } else { rate };
        (0..27i32).filter(|n| *n != 13).any(|n| {
            let step = IVec3::new(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1);
            let q = (c as i32 + step.x + 10 * step.y + 100 * step.z) as usize;
            self.0[q] - self.0[c] > limit * (step.as_vec3() * h).length()
        })
    }

    /// Returns the rows of ten around a row of eight (y + 8 z), by y then z, both ascending.
    #[inline]
    pub fn rows(&self, row: usize) -> [&[f32; 10]; 9] {
        let first = 10 * (row & 7) + 100 * (row >> 3);
        std::array::from_fn(|n| {
            let at = first + 10 * (n % 3) + 100 * (n / 3);
            self.0[at..at + 10].try_into().expect("ten values")
        })
    }

    /// Returns the gradient at an index of the block.
    #[inline]
    pub fn gradient(&self, c: usize, h: Vec3) -> Vec3 {
        let f = &self.0;
        Vec3::new(f[c + 1] - f[c - 1], f[c + 10] - f[c - 10], f[c + 100] - f[c - 100]) / (2.0 * h)
    }

    /// Returns the diagonal (xx, yy, zz) and off-diagonal (xy, xz, yz) of the Hessian at an index
    /// of the block.
    #[inline]
    pub fn hessian(&self, c: usize, h: Vec3) -> (Vec3, Vec3) {
        let f = &self.0;
        let up = Vec3::new(f[c + 1], f[c + 10], f[c + 100]);
        let down = Vec3::new(f[c - 1], f[c - 10], f[c - 100]);
        let m = (up - 2.0 * f[c] + down) / (h * h);
        let cross = |i: usize, j: usize| f[c + i + j] - f[c + i - j] - f[c + j - i] + f[c - i - j];
        let o = Vec3::new(
            cross(1, 10) / (4.0 * h.x * h.y),
            cross(1, 100) / (4.0 * h.x * h.z),
            cross(10, 100) / (4.0 * h.y * h.z),
        );
        (m, o)
    }
}

/// Returns the eigenvalues (ascending) of a symmetric matrix, and the eigenvector of the largest
/// unless the matrix is a multiple of the identity. As `shaders/lib/eigen.wgsl`.
pub fn eigen(m: Vec3, o: Vec3) -> (Vec3, Option<Vec3>) {
    let values = Vec3::from(eigenvalues(m.into(), o.into()));
    let high = values.z;
    if values.x == high {
        return (values, None);
    }
    let r0 = Vec3::new(m.x - high, o.x, o.y);
    let r1 = Vec3::new(o.x, m.y - high, o.z);
    let r2 = Vec3::new(o.y, o.z, m.z - high);
    let longest = [r0.cross(r1), r0.cross(r2), r1.cross(r2)]
        .into_iter()
        .reduce(|a, b| if b.length_squared() > a.length_squared() { b } else { a })
        .filter(|v| v.length_squared() >= 1e-36);
    (values, longest.map(|v| v / v.length()))
}

/// Result of the ridge test at a voxel.
#[derive(Clone, Copy, Debug, Default)]
pub struct Ridge {
    /// Whether the voxel is a ridge candidate.
    pub accepted: bool,
    /// Offset from the voxel's centre to the ridge.
    pub offset_mm: Vec3,
    /// Length of the gradient.
    pub gradient: f32,
    /// Eigenvalues: the two across the axis, and the largest.
    pub values: Vec3,
    /// Unit direction of the ridge.
    pub axis: Vec3,
}

/// The ridge test at a voxel of a brick; `gate` is the largest gradient of a medial point.
#[inline]
pub fn ridge(halo: &Halo, local: usize, h: Vec3, gate: f32) -> Ridge {
    let c = Halo::centre(local);
    let g = halo.gradient(c, h);
    let mut out = Ridge { gradient: g.length(), ..Default::default() };
    if out.gradient > gate {
        return out; // most voxels of a distance map end here
    }
    let (m, o) = halo.hessian(c, h);
    let (values, axis) = eigen(m, o);
    out.values = values;
    out.axis = axis.unwrap_or(Vec3::Z);
    match axis {
        None => out.offset_mm = -g / values.x,
        Some(v) => {
            let a = if v.x.abs() > 0.57735 {
                Vec3::new(-v.z, 0.0, v.x)
            } else {
                Vec3::new(0.0, -v.z, v.y)
            };
            let a = a.normalize();
            let b = v.cross(a);
            let times = |u: Vec3| {
                Vec3::new(
                    m.x * u.x + o.x * u.y + o.y * u.z,
                    o.x * u.x + m.y * u.y + o.z * u.z,
                    o.y * u.x + o.z * u.y + m.z * u.z,
                )
            };
            let (ha, hb) = (times(a), times(b));
            let (kaa, kab, kbb) = (a.dot(ha), a.dot(hb), b.dot(hb));
            let half = 0.5 * (kaa + kbb);
            let root = (0.25 * (kaa - kbb) * (kaa - kbb) + kab * kab).max(0.0).sqrt();
            out.values = Vec3::new(half - root, half + root, values.z);
            let det = kaa * kbb - kab * kab;
            let (ga, gb) = (a.dot(g), b.dot(g));
            out.offset_mm = -(a * (kbb * ga - kab * gb) + b * (kaa * gb - kab * ga)) / det;
        }
    }
    let falls = out.values.y < -1e-4 / h.min_element();
    out.accepted = falls && out.offset_mm.abs().cmple(0.6 * h).all();
    out
}

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let h = Vec3::from(p.spacing_mm);
    s.marked.par_chunks_exact_mut(16).enumerate().with_min_len(8).for_each(|(slot, marked)| {
        crate::task::checkpoint();
        let inside = &s.inside[slot * 16..][..16];
        if inside.iter().all(|w| *w == 0) {
            return;
        }
        let halo = Halo::gather(s.near, s.f, slot);
        let mut exact = None;
        for (w, (&bits, marked)) in inside.iter().zip(marked).enumerate() {
            let mut rest = bits;
            while rest != 0 {
                let i = rest.trailing_zeros();
                rest &= rest - 1;
                let local = w * 32 + i as usize;
                if ridge(&halo, local, h, p.gate).accepted {
                    // Few voxels get here; their bricks fetch the exact distances once.
                    let exact = exact.get_or_insert_with(|| Halo::gather(s.near, s.d, slot));
                    if !exact.climbs(local, h, p.climb) {
                        *marked |= 1 << i;
                    }
                }
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lumen::{BitVolume, Lumen};
    use crate::volume::Grid;

    #[test]
    fn eigenvalues_of_known_matrices() {
        let (l, v) = eigen(Vec3::new(1.0, -2.0, 5.0), Vec3::ZERO);
        assert!((l - Vec3::new(-2.0, 1.0, 5.0)).length() < 1e-5);
        assert!(v.unwrap().z.abs() > 0.9999);
        // [[2,1,0],[1,2,0],[0,0,-1]]: -1, 1, 3 along (1,1,0).
        let (l, v) = eigen(Vec3::new(2.0, 2.0, -1.0), Vec3::new(1.0, 0.0, 0.0));
        assert!((l - Vec3::new(-1.0, 1.0, 3.0)).length() < 1e-5);
        let v = v.unwrap();
        assert!((v.x - v.y).abs() < 1e-5 && v.z.abs() < 1e-5);
        assert!(eigen(Vec3::splat(-3.0), Vec3::ZERO).1.is_none());
    }

    #[test]
    fn a_halo_holds_the_brick_and_its_rim() {
        let grid = Grid::axis_aligned([31, 29, 41], [1.0; 3]);
        let mut mask = BitVolume::new(grid.dims);
        for v in (0..grid.len()).filter(|i| i % 5 < 3).map(|i| grid.voxel(i)) {
            mask.set(v.x, v.y, v.z);
        }
        let lumen = Lumen::new(grid, &mask);
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
                assert_eq!(halo.0[c as usize], want);
            }
        }
    }
}
