//! CPU twin of `hessian`: eigenvalues or a response over a whole field.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::halo::Halo;
pub use super::host::hessian::{Bindings, Params};
use super::host::hessian::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/hessian.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "voxels", tolerance: Tolerance { abs: 2e-4, rel: 2e-4 } };

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let stride = if p.kind == 0 { 3 } else { 1 };
    let arch = Arch::new();
    s.response.par_chunks_exact_mut(BRICK * stride).enumerate().with_min_len(4).for_each(
        |(at, out)| {
            crate::task::checkpoint();
            let slot = at + p.first as usize;
            let inside: &[u8] = bytemuck::cast_slice(&s.inside[slot * 16..][..16]);
            if inside.iter().all(|w| *w == 0) {
                out.fill(0.0);
                return;
            }
            let halo = Halo::gather(s.near, s.f, slot);
            for (row, out) in out.chunks_exact_mut(8 * stride).enumerate() {
                let inside = inside[row];
                if inside == 0 {
                    out.fill(0.0);
                    continue;
                }
                let keep = |i: usize, v: f32| if inside >> i & 1 != 0 { v } else { 0.0 };
                let work = LaneRow { halo: &halo, row, spacing_mm: p.spacing_mm, sign: p.sign };
                let [low, mid, high] = arch.dispatch(work);
                match p.kind {
                    0 => {
                        for (i, out) in out.chunks_exact_mut(3).enumerate() {
                            out.copy_from_slice(&[low[i], mid[i], high[i]].map(|v| keep(i, v)));
                        }
                    }
                    1 => {
                        for (i, out) in out.iter_mut().enumerate() {
                            *out = keep(i, (-mid[i]).max(0.0));
                        }
                    }
                    _ => {
                        for (i, out) in out.iter_mut().enumerate() {
                            let t = if mid[i] < 0.0 { (low[i] * mid[i]).sqrt() } else { 0.0 };
                            *out = keep(i, t);
                        }
                    }
                }
            }
        },
    );
}

/// A row of a brick, processed in SIMD lanes as wide as the processor has: for that all of the code
/// must be inlined.
struct LaneRow<'a> {
    halo: &'a Halo,
    row: usize,
    spacing_mm: [f32; 3],
    sign: f32,
}

impl WithSimd for LaneRow<'_> {
    type Output = [[f32; 8]; 3];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        row_values(self.halo, self.row, self.spacing_mm, self.sign)
    }
}

/// Returns the eigenvalues of the eight Hessians of a row of a brick: smallest, middle and largest
/// of each.
#[inline(always)]
fn row_values(halo: &Halo, row: usize, [hx, hy, hz]: [f32; 3], sign: f32) -> [[f32; 8]; 3] {
    // The rows around it by (y, z), each with its two neighbours along x.
    let [dd, cd, ud, dc, cc, uc, du, cu, uu] = halo.rows(row);
    let (xx, yy, zz) = (sign / (hx * hx), sign / (hy * hy), sign / (hz * hz));
    let (xy, xz, yz) = (sign / (4.0 * hx * hy), sign / (4.0 * hx * hz), sign / (4.0 * hy * hz));
    let mut out = [[0.0; 8]; 3];
    for i in 0..8 {
        let twice = 2.0 * cc[i + 1];
        let m = [
            (cc[i + 2] - twice + cc[i]) * xx,
            (uc[i + 1] - twice + dc[i + 1]) * yy,
            (cu[i + 1] - twice + cd[i + 1]) * zz,
        ];
        let o = [
            (uc[i + 2] - dc[i + 2] - uc[i] + dc[i]) * xy,
            (cu[i + 2] - cd[i + 2] - cu[i] + cd[i]) * xz,
            (uu[i + 1] - ud[i + 1] - du[i + 1] + dd[i + 1]) * yz,
        ];
        [out[0][i], out[1][i], out[2][i]] = eigenvalues(m, o);
    }
    out
}

/// Returns the eigenvalues, ascending, of the symmetric matrix of diagonal `m` and off-diagonal `o`
/// (xy, xz, yz), by the cubic's closed form, within a few units in the last place of the largest,
/// double roots too. As `shaders/lib/eigenvalues.wgsl`, but without a branch, so that a row of
/// voxels runs in lanes: the largest root is a polynomial in the cosine of half the cubic's angle,
/// the smallest in its sine, and the smaller of these two comes from a residual, not from the other.
#[inline(always)]
pub(crate) fn eigenvalues(m: [f32; 3], o: [f32; 3]) -> [f32; 3] {
    let q = (m[0] + m[1] + m[2]) / 3.0;
    let [x, y, z] = m.map(|v| v - q);
    let off = o[0] * o[0] + o[1] * o[1] + o[2] * o[2];
    let p = ((x * x + y * y + z * z + 2.0 * off) / 6.0).sqrt();
    // Divisions take longest: one here, and none by spacings in a row.
    let inverse = 1.0 / p;
    let (x, y, z) = (x * inverse, y * inverse, z * inverse);
    let [a, b, c] = o.map(|v| v * inverse);
    let det = x * (y * z - c * c) - a * (a * z - c * b) + b * (a * c - y * b);
    let cosine = (0.5 * det).clamp(-1.0, 1.0);
    let (aa, bb, cc) = (a * a, b * b, c * c);
    // B², less its parts along the identity and B.
    let across = [
        x * x + (aa + bb) - 2.0 - cosine * x,
        y * y + (aa + cc) - 2.0 - cosine * y,
        z * z + (bb + cc) - 2.0 - cosine * z,
    ];
    let apart = [
        b * c - a * z - cosine * a, //
        a * c - b * y - cosine * b,
        a * b - c * x - cosine * c,
    ];
    let square = |[i, j, k]: [f32; 3]| i * i + j * j + k * k;
    let sine = ((square(across) + 2.0 * square(apart)) / 6.0).sqrt();
    let large = (0.5 + 0.5 * cosine.abs()).sqrt();
    let small = (0.5 * sine / large).min(large);
    let (for_high, for_low) = if cosine >= 0.0 { (large, small) } else { (small, large) };
    let high = q + 2.0 * p * third(for_high);
    let low = q - 2.0 * p * third(for_low);
    let mid = (3.0 * q - high - low).max(low).min(high);
    let multiple = p <= 1e-6 * q.abs() || p < 1e-30;
    [low, mid, high].map(|v| if multiple { q } else { v })
}

/// Returns cos(2/3 acos s) for s in [0, 1], within 1e-7: Chebyshev interpolation of degree 8.
#[inline(always)]
fn third(s: f32) -> f32 {
    const C: [f32; 9] = [
        0.5,
        0.577_349_66,
        -0.111_094_49,
        0.053_279_35,
        -0.031_925_414,
        0.019_600_32,
        -0.010_237_508,
        0.003_654_119_6,
        -0.000_626_045_34,
    ];
    C.iter().rev().fold(0.0, |sum, c| sum * s + c)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eigenvalues by Smith's angles, in f64.
    fn by_angles(m: [f32; 3], o: [f32; 3]) -> [f64; 3] {
        let (m, o) = (m.map(f64::from), o.map(f64::from));
        let q = m.iter().sum::<f64>() / 3.0;
        let [x, y, z] = m.map(|v| v - q);
        let [a, b, c] = o;
        let p = ((x * x + y * y + z * z + 2.0 * (a * a + b * b + c * c)) / 6.0).sqrt();
        let det = x * (y * z - c * c) - a * (a * z - c * b) + b * (a * c - y * b);
        let angle = (0.5 * det / p.powi(3)).clamp(-1.0, 1.0).acos() / 3.0;
        let third = std::f64::consts::TAU / 3.0;
        [1.0, -1.0, 0.0].map(|turn| q + 2.0 * p * (angle + turn * third).cos())
    }

    #[test]
    fn the_polynomial_cosine_is_within_two_ulps() {
        for i in 0..=10_000 {
            let s = i as f32 / 10_000.0;
            let want = (f64::from(s).acos() * 2.0 / 3.0).cos();
            assert!((f64::from(third(s)) - want).abs() < 1.2e-7, "{s}");
        }
    }

    #[test]
    fn eigenvalues_keep_the_invariants_of_their_matrix_and_their_order() {
        let mut at = 1u32;
        let mut next = || {
            at = at.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (at >> 8) as f32 / 8_388_608.0 - 1.0
        };
        for _ in 0..10_000 {
            let m: [f32; 3] = std::array::from_fn(|_| next());
            let o: [f32; 3] = std::array::from_fn(|_| next());
            let [low, mid, high] = eigenvalues(m, o);
            let want = by_angles(m, o);
            let apart = [low, mid, high].into_iter().zip(want).map(|(v, w)| f64::from(v) - w);
            assert!(apart.into_iter().all(|d| d.abs() < 3e-6), "{m:?} {o:?} {want:?}");
            assert!(low <= mid && mid <= high);
            // The three invariants of a matrix: trace, sum of squares, determinant.
            let trace = low + mid + high - (m[0] + m[1] + m[2]);
            let squares = |v: [f32; 3]| v.map(|v| f64::from(v).powi(2)).iter().sum::<f64>();
            let square = squares([low, mid, high]) - squares(m) - 2.0 * squares(o);
            let [m, o] = [m, o].map(|v| v.map(f64::from));
            let matrix = glam::DMat3::from_cols_array(&[
                m[0], o[0], o[1], o[0], m[1], o[2], o[1], o[2], m[2],
            ]);
            let product = f64::from(low) * f64::from(mid) * f64::from(high);
            let determinant = product - matrix.determinant();
            assert!(trace.abs() < 2e-6 && square.abs() < 2e-5, "{trace} {square}");
            assert!(determinant.abs() < 2e-5, "{determinant}");
        }
    }

    /// The determinant alone would be off by its last bit, and a double root by the root of that:
    /// other drivers round the determinant in another way.
    #[test]
    fn double_eigenvalues_do_not_hang_on_the_last_bit_of_the_determinant() {
        let mut at = 7u32;
        let mut next = || {
            at = at.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (at >> 8) as f64 / 8_388_608.0 - 1.0
        };
        let mut worst = 0.0f64;
        for _ in 0..20_000 {
            let v = glam::DVec3::new(next(), next(), next());
            if v.length() < 0.1 {
                continue;
            }
            // λ v vᵀ + μ I: a single eigenvalue μ + λ and a double one μ.
            let (v, single, double) = (v.normalize(), next().signum(), 0.3 * next());
            let m = [v.x, v.y, v.z].map(|c| (single * c * c + double) as f32);
            let o = [v.x * v.y, v.x * v.z, v.y * v.z].map(|c| (single * c) as f32);
            let mut want = [double, double, double + single];
            want.sort_by(f64::total_cmp);
            for (got, want) in eigenvalues(m, o).into_iter().zip(want) {
                worst = worst.max((f64::from(got) - want).abs());
            }
        }
        assert!(worst < 1e-6, "{worst:e}");
    }

    #[test]
    fn multiples_of_the_identity_and_zero_are_their_own_eigenvalues() {
        for v in [0.0, -3.0, 1e-20] {
            assert_eq!(eigenvalues([v; 3], [0.0; 3]), [v; 3]);
        }
        assert!(eigenvalues([f32::NAN; 3], [0.0; 3])[0].is_nan());
    }
}
