//! What a wall needs to be drawn beside its shape: a normal and a curvature at each vertex.

use glam::{Vec2, Vec3};

use crate::geometry::{Mesh, Vertex};

/// A mesh's vertices as they are drawn, and what the light needs to know.
#[derive(Clone, Debug, Default)]
pub struct Shading {
    /// One for each vertex of the mesh; `w` is k / (1 + |k|) with k the mean curvature times the
    /// mean radius, plus a half: 0 on a plain tube, positive on ridges.
    pub vertices: Vec<Vertex>,
    /// Radius of the long tube with this volume and area, mm.
    pub mean_radius_mm: f32,
}

/// Vertices as drawn, with the mesh's own normals or, where it has none, the mean of its faces'.
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
    // Zero on a plain tube of that radius (one curvature is -1/r, the other 0); folds of any
    // sharpness stay apart.
    let relief = |v: usize| {
        let k = mean_radius_mm * curvature[v] + 0.5;
        k / (1.0 + k.abs())
    };
    let at = |v: usize| Vertex::new(mesh.positions[v], normals[v], relief(v));
    Shading { vertices: (0..vertices).map(at).collect(), mean_radius_mm }
}

/// Radius of the long tube with this volume and area: 2 V / A. Open or tiny meshes fall back to a
/// share of their size.
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

/// Mean normal curvature at each vertex, 1/mm, positive where the wall stands into the lumen;
/// smoothed over about a fifth of `radius_mm`, so that folds show and voxels do not.
fn curvature(mesh: &Mesh, normals: &[Vec3], radius_mm: f32) -> Vec<f32> {
    let edges = || mesh.faces.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    let edges = || edges().map(|(a, b)| (a as usize, b as usize));
    let mut sum = vec![Vec2::ZERO; mesh.positions.len()];
    let mut squares = 0.0;
    for (a, b) in edges() {
        let along = mesh.positions[b] - mesh.positions[a];
        let length2 = along.length_squared();
        if length2 > 0.0 {
            squares += f64::from(length2);
            let k = Vec2::new((normals[b] - normals[a]).dot(along) / length2, 1.0);
            sum[a] += k;
            sum[b] += k;
        }
    }
    let mean = |s: &Vec2| s.x / s.y.max(1.0);
    let mut k: Vec<f32> = sum.iter().map(mean).collect();
    // A round of averaging spreads by about one edge, rounds add in squares.
    let edge2 = squares / (3 * mesh.faces.len()).max(1) as f64;
    let reach = 0.2 * f64::from(radius_mm);
    let rounds = (reach * reach / edge2.max(1e-12)).ceil().clamp(2.0, 12.0) as usize;
    for _ in 0..rounds {
        sum.iter_mut().zip(&k).for_each(|(s, k)| *s = Vec2::new(*k, 1.0));
        for (a, b) in edges() {
            sum[a] += Vec2::new(k[b], 1.0);
            sum[b] += Vec2::new(k[a], 1.0);
        }
        k.iter_mut().zip(&sum).for_each(|(k, s)| *k = mean(s));
    }
    k
}
