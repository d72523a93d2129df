//! CPU twin of `ridge_mark`, and the ridge test at one voxel that it shares with `ridge_measure`.
//! Formulas as in `shaders/lib/ridge.wgsl`; f64 where it costs nothing.

use glam::Vec3;
use rayon::prelude::*;

use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::kernels::halo::Halo;
use crate::kernels::hessian::eigenvalues;
pub use crate::kernels::host::ridge_mark::{Bindings, Params};
use crate::kernels::host::ridge_mark::{SHADER, open};

/// See `shaders/ridge_mark.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "voxels", tolerance: Tolerance::EXACT };

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

/// Gradient at a place.
#[inline]
fn gradient(halo: &Halo, c: usize, h: Vec3) -> Vec3 {
    let f = halo.values();
    Vec3::new(f[c + 1] - f[c - 1], f[c + 10] - f[c - 10], f[c + 100] - f[c - 100]) / (2.0 * h)
}

/// Diagonal (xx, yy, zz) and rest (xy, xz, yz) of the Hessian at a place.
#[inline]
fn hessian(halo: &Halo, c: usize, h: Vec3) -> (Vec3, Vec3) {
    let f = halo.values();
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

/// The ridge test at a voxel of a brick.
#[inline]
pub fn ridge(halo: &Halo, local: usize, h: Vec3) -> Ridge {
    let c = Halo::centre(local);
    let g = gradient(halo, c, h);
    let mut out = Ridge { gradient: g.length(), ..Default::default() };
    let (m, o) = hessian(halo, c, h);
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
        marked.fill(0);
        let inside = &s.inside[slot * 16..][..16];
        if inside.iter().all(|w| *w == 0) {
            return;
        }
        let halo = Halo::gather(s.near, s.f, slot);
        for (w, (&bits, marked)) in inside.iter().zip(marked).enumerate() {
            let mut rest = bits;
            while rest != 0 {
                let i = rest.trailing_zeros();
                rest &= rest - 1;
                if ridge(&halo, w * 32 + i as usize, h).accepted {
                    *marked |= 1 << i;
                }
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
