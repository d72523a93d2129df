//! Vertices of a wall as drawn: position, normal and curvature tint.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::{Adjacency, heat};
use crate::geometry::{Mesh, Vertex};

/// Least number of vertices of a parallel task.
const MIN_LEN: usize = 4096;
/// Largest number of averaging rounds: enough for edges of a 64th of the smoothing radius.
const MAX_ROUNDS: f64 = 4096.0;
/// Largest error of the truncated series in any mode.
const CUT: f64 = 1.0 / 15.0;

/// Vertices of a mesh as drawn, and the radius that the light is scaled by.
#[derive(Clone, Debug, Default)]
pub struct Shading {
    /// Vertices, one for each of the mesh's; `w` is the curvature tint: k / (1 + |k|), where k is
    /// the mean curvature times the mean radius, plus a half; 0 on a plain tube, positive on
    /// ridges.
    pub vertices: Vec<Vertex>,
    /// Radius of the long tube with the mesh's ratio of volume to area, mm.
    pub mean_radius_mm: f32,
}

/// Returns the vertices as drawn, with the mesh's own normals or, where it has none, area-weighted
/// means of its faces'.
///
/// # Panics
/// If a face names a vertex that is not there.
pub fn shading(mesh: &Mesh) -> Shading {
    let vertices = mesh.positions.len();
    let given = mesh.normals.len() == vertices;
    let own = if given { Vec::new() } else { normals(mesh) };
    let normals = if given { &mesh.normals } else { &own };
    let mean_radius_mm = mean_radius(mesh);
    let curvature = curvature(mesh, normals, mean_radius_mm);
    // Zero on a plain tube of that radius (principal curvatures -1/r and 0); strictly monotonic, so
    // that sharper folds remain distinguishable.
    let curvature_tint = |v: usize| {
        let k = mean_radius_mm * curvature[v] + 0.5;
        k / (1.0 + k.abs())
    };
    let at = |v: usize| Vertex::new(mesh.positions[v], normals[v], curvature_tint(v));
    Shading { vertices: (0..vertices).map(at).collect(), mean_radius_mm }
}

/// Returns the radius, mm, of the long tube with this volume and area, 2 V / A; for open or tiny
/// meshes a share of their size.
fn mean_radius(mesh: &Mesh) -> f32 {
    let r = (2.0 * mesh.volume_mm3().abs() / mesh.area_mm2()) as f32;
    let size = mesh.bounds().map_or(1.0, |(lo, hi)| (hi - lo).length());
    if r.is_finite() && r > 1e-3 * size { r } else { (0.05 * size).max(1e-3) }
}

fn normals(mesh: &Mesh) -> Vec<Vec3> {
    let mut sum = vec![Vec3::ZERO; mesh.positions.len()];
    for &f in &mesh.faces {
        let n = mesh.face_cross(f);
        f.iter().for_each(|v| sum[*v as usize] += n);
    }
    sum.iter().map(|n| n.try_normalize().unwrap_or(Vec3::Z)).collect()
}

/// Computes the mean normal curvature at each vertex, 1/mm, positive where the wall protrudes into
/// the lumen; smoothed over about a fifth of `radius_mm`, so that folds show and voxels do not.
///
/// Numerator and denominator are weighted by squared edge length and smoothed separately: the
/// rotation of the normal along a very short edge is noise, and its quotient would outweigh a whole
/// fold.
fn curvature(mesh: &Mesh, normals: &[Vec3], radius_mm: f32) -> Vec<f32> {
    let (adjacency, _) = Adjacency::of(mesh);
    // Sums over edges of normal difference dot edge vector, and of squared lengths.
    let at = |v: usize| {
        let edge = |&w: &u32| (mesh.positions[w as usize] - mesh.positions[v], normals[w as usize]);
        adjacency.row(v).iter().map(edge).fold(Vec2::ZERO, |s, (along, n)| {
            s + Vec2::new((n - normals[v]).dot(along), along.length_squared())
        })
    };
    crate::task::checkpoint();
    let sums = gather(mesh.positions.len(), at);
    crate::task::checkpoint();
    let all: f64 = sums.iter().map(|s| f64::from(s.y)).sum();
    let edge2 = all / adjacency.near.len().max(1) as f64;
    // A round of averaging has a standard deviation of about one edge; variances add.
    let reach = 0.2 * f64::from(radius_mm);
    let rounds = (reach * reach / edge2.max(1e-12)).clamp(2.0, MAX_ROUNDS);
    let sums = diffuse(&adjacency, sums, rounds);
    sums.into_iter().map(|s| if s.y > 0.0 { s.x / s.y } else { 0.0 }).collect()
}

/// Returns values at vertices after `rounds` of averaging with the neighbours, up to a common
/// factor near 1. They are computed by a Chebyshev series whose length grows with the square root
/// of `rounds`.
fn diffuse(adjacency: &Adjacency, values: Vec<Vec2>, rounds: f64) -> Vec<Vec2> {
    let mean = |of: &[Vec2], v: usize| {
        let near = adjacency.row(v);
        let sum: Vec2 = near.iter().map(|w| of[*w as usize]).sum();
        (of[v] + 2.0 * sum) / (1.0 + 2.0 * near.len() as f32)
    };
    let series = heat::series(rounds, heat::terms(rounds, CUT));
    // Chebyshev polynomials of two degrees, applied to the values.
    let mut now = gather(values.len(), |v| mean(&values, v));
    let of = |k: usize| series[k] as f32;
    let mut out = gather(values.len(), |v| of(0) * values[v] + of(1) * now[v]);
    let mut last = values;
    for k in 2..series.len() {
        crate::task::checkpoint();
        last.par_iter_mut().zip(&mut out).enumerate().with_min_len(MIN_LEN).for_each(
            |(v, (l, o))| {
                *l = 2.0 * mean(&now, v) - *l;
                *o += of(k) * *l;
            },
        );
        std::mem::swap(&mut last, &mut now);
    }
    out
}

fn gather(count: usize, of: impl Fn(usize) -> Vec2 + Send + Sync) -> Vec<Vec2> {
    (0..count).into_par_iter().with_min_len(MIN_LEN).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::shapes::sphere;

    /// Largest error of the curvature tint on a sphere: curvature −1/R at a mean radius of 2 R / 3.
    fn tint_error(mesh: &Mesh) -> f32 {
        let off = |v: &Vertex| (v.w() + 1.0 / 7.0).abs();
        shading(mesh).vertices.iter().map(off).fold(0.0, f32::max)
    }

    #[test]
    fn curvature_tint_of_a_sphere_does_not_depend_on_face_size() {
        for n in [8, 40, 120] {
            let off = tint_error(&sphere(5.0, n));
            assert!(off < 0.01, "{n}: off by {off}");
        }
    }

    #[test]
    fn slivers_with_noisy_normals_do_not_disturb_the_curvature_tint() {
        let mut mesh = sphere(5.0, 40);
        // Every 37th vertex nearly falls upon a neighbour, and their normals differ.
        for i in (0..mesh.faces.len()).step_by(74) {
            let [a, b, _] = mesh.faces[i].map(|v| v as usize);
            let along = mesh.positions[a] - mesh.positions[b];
            mesh.positions[a] = mesh.positions[b] + 1e-3 * along;
            mesh.normals[a] = (mesh.normals[b] + 0.02 * along.normalize()).normalize();
        }
        let off = tint_error(&mesh);
        assert!(off < 0.05, "off by {off}");
    }

    #[test]
    fn normal_noise_disturbs_the_curvature_tint_less_on_finer_meshes() {
        let spread = |n: u32| {
            let mut mesh = sphere(5.0, n);
            let mut seed = 1u32;
            let mut random = || {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (seed >> 8) as f32 / (1 << 24) as f32 - 0.5
            };
            for n in &mut mesh.normals {
                *n = (*n + 0.02 * Vec3::new(random(), random(), random())).normalize();
            }
            tint_error(&mesh)
        };
        let (coarse, fine) = (spread(30), spread(120));
        assert!(fine < coarse, "{coarse}, with faces a quarter as long {fine}");
    }
}
