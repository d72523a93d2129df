//! Two-sided distance bound of each level of a base face to the original.
//!
//! Let M_ℓ be the surface at level ℓ and M_L the finest. M_L is mapped onto M_ℓ sample by sample: a
//! corner of a triangle S of M_ℓ stays, a sample on a side of S goes to the nearest point of that
//! side, one inside S to the nearest point of S, and between samples the map is linear. S is
//! convex, so the small triangles over S map into S; sides map to sides and corners to corners, so
//! the map has degree one and covers every point of S. No point moves further than the sample that
//! moves furthest. That distance therefore bounds the Hausdorff distance of M_ℓ and M_L, face by
//! face; it is too large where the parameterization displaces an edge sideways within the surface.
//!
//! The original is mapped onto M_L in the same way, and measured at its vertices and at the
//! midpoint of every edge of M_L. Where else it bends, at crossings of its edges with those of M_L,
//! is not measured: a tenth is added for that (up to 0.03 % was missing in tests). This is the one
//! place where the bound is not rigorous.

use rayon::prelude::*;

use super::base_mesh::BaseMesh;
use super::original::Original;
use super::samples::{SampleGrid, SurfaceSamples, triangles};
use crate::geometry::{nearest_on_segment, point_triangle_distance};

/// Computes, for each face, bounds of levels 0 to L against M_L (0 for L itself), mm.
fn to_finest(base: &BaseMesh, samples: &SurfaceSamples) -> Vec<Vec<f64>> {
    let depth = samples.depth();
    let one = |f: u32| -> Vec<f64> {
        let at = |g: SampleGrid| samples.position(base, f, g).as_dvec3();
        let of_level = |l: u32| {
            let m = 1u32 << (depth - l);
            let mut worst: f64 = 0.0;
            for t in triangles(1 << l) {
                let place = |p: SampleGrid| -> SampleGrid {
                    [0, 1, 2].map(|k| (0..3).map(|c| p[c] * t[c][k]).sum())
                };
                let corners = [[m, 0, 0], [0, m, 0], [0, 0, m]].map(|p| at(place(p)));
                for i in 0..=m {
                    for j in 0..=m - i {
                        let p = [i, j, m - i - j];
                        let x = at(place(p));
                        let moved = match p.iter().filter(|c| **c == 0).count() {
                            2 => continue,
                            1 => {
                                let zero = p.iter().position(|c| *c == 0).unwrap_or(0);
                                let (a, b) = (corners[(zero + 1) % 3], corners[(zero + 2) % 3]);
                                x.distance(nearest_on_segment(x, a, b))
                            }
                            _ => point_triangle_distance(x, corners),
                        };
                        worst = worst.max(moved);
                    }
                }
            }
            worst
        };
        (0..=depth).map(of_level).collect()
    };
    (0..base.faces.len() as u32).into_par_iter().map(one).collect()
}

/// Computes, for each face, the measured distance between M_L and the original, mm.
fn finest(base: &BaseMesh, samples: &SurfaceSamples, original: &dyn Original) -> Vec<f64> {
    let n = 1u32 << samples.depth();
    let at = |f: u32, g: SampleGrid| samples.position(base, f, g).as_dvec3();
    let midpoints = |f: u32| -> f64 {
        let mut worst: f64 = 0.0;
        // Upright triangles have each inner edge once, and each outer one.
        for t in triangles(n).filter(|t| t[0][0] > t[1][0]) {
            for (p, q) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                let middle = [0, 1, 2].map(|k| f64::from(p[k] + q[k]) / f64::from(2 * n));
                let x = original.at(f, middle).position().as_dvec3();
                worst = worst.max(x.distance(nearest_on_segment(x, at(f, p), at(f, q))));
            }
        }
        worst
    };
    let faces = base.faces.len() as u32;
    let mut worst: Vec<f64> = (0..faces).into_par_iter().map(midpoints).collect();
    let corners: Vec<(u32, f64)> = (0..original.vertices())
        .into_par_iter()
        .filter_map(|v| {
            let (f, weights, x) = original.vertex(v).filter(|(f, ..)| *f < faces)?;
            let small = cell(weights, n).map(|g| at(f, g));
            Some((f, point_triangle_distance(x.as_dvec3(), small)))
        })
        .collect();
    for (f, e) in corners {
        let w = &mut worst[f as usize];
        *w = w.max(e);
    }
    worst
}

/// The triangle of a grid with n steps a side that contains the given barycentric weights.
fn cell(weights: [f64; 3], n: u32) -> [SampleGrid; 3] {
    let scaled = weights.map(|w| w.clamp(0.0, 1.0) * f64::from(n));
    let low = scaled.map(|s| (s.floor() as u32).min(n));
    let add = |by: [SampleGrid; 3]| by.map(|u| [0, 1, 2].map(|k| low[k] + u[k]));
    match n.saturating_sub(low.iter().sum()) {
        0 => {
            // A grid point, up to rounding: any incident triangle will do.
            let c = low.iter().position(|l| *l > 0).unwrap_or(0);
            let mut t = add([[1, 0, 0], [0, 1, 0], [0, 0, 1]]);
            t.iter_mut().for_each(|g| g[c] -= 1);
            t
        }
        1 => add([[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        _ => add([[0, 1, 1], [1, 0, 1], [1, 1, 0]]),
    }
}

/// Safety factor for deviations between the measured points of the finest level.
const BETWEEN: f64 = 1.1;

/// Computes, for each face, the two-sided distance bound of levels 0 to L to the original, mm. It
/// never grows with the level.
pub fn bounds(base: &BaseMesh, samples: &SurfaceSamples, original: &dyn Original) -> Vec<Vec<f32>> {
    let own = finest(base, samples, original);
    let mut all = to_finest(base, samples);
    all.iter_mut()
        .zip(own)
        .map(|(levels, own)| {
            let mut worst: f64 = 0.0;
            for e in levels.iter_mut().rev() {
                worst = worst.max(*e);
                *e = worst + BETWEEN * own;
            }
            // Rounded up.
            levels.iter().map(|e| (e * (1.0 + 1e-6)) as f32).collect()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn the_grid_triangle_of_weights_contains_them() {
        let mut seed = 9u64;
        let mut noise = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 40) as f64 / (1u64 << 24) as f64
        };
        for n in [1u32, 2, 8] {
            for i in 0..2000 {
                let (mut a, mut b) = (noise(), noise());
                if i % 3 == 0 {
                    (a, b) = ((a * 8.0).floor() / 8.0, (b * 8.0).floor() / 8.0);
                }
                if a + b > 1.0 {
                    (a, b) = (1.0 - a, 1.0 - b);
                }
                let w = [a, b, 1.0 - a - b];
                let t = cell(w, n);
                let flat = |g: SampleGrid| DVec3::new(f64::from(g[0]), f64::from(g[1]), 0.0);
                assert!(t.iter().all(|g| g.iter().sum::<u32>() == n));
                let p = DVec3::new(a, b, 0.0) * f64::from(n);
                assert!(point_triangle_distance(p, t.map(flat)) < 1e-9, "{w:?} of {n}: {t:?}");
            }
        }
    }
}
