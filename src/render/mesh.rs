//! A mesh as the device draws it.

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};

use super::RenderError;
use crate::geometry::Mesh;

/// Twenty bytes a vertex, whatever is drawn.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(super) struct Vertex {
    pub position: [f32; 3],
    /// Unit normal and one more number, as fractions of 32767.
    pub normal: [i16; 4],
}

impl Vertex {
    pub fn new(position: Vec3, normal: Vec3, w: f32) -> Self {
        let fraction = |v: f32| (v.clamp(-1.0, 1.0) * 32767.0).round() as i16;
        let n = normal.extend(w);
        Self { position: position.to_array(), normal: n.to_array().map(fraction) }
    }
}

/// Vertices, indices, and what the light needs to know.
pub(super) struct Prepared {
    pub vertices: Vec<Vertex>,
    pub indices: Vec<u32>,
    pub bounds: Option<(Vec3, Vec3)>,
    pub mean_radius_mm: f32,
}

/// Brings a mesh into the form that is drawn; caps are left out on request.
pub(super) fn prepare(mesh: &Mesh, skip_caps: bool) -> Result<Prepared, RenderError> {
    let vertices = mesh.positions.len();
    for (face, f) in mesh.faces.iter().enumerate() {
        if let Some(&vertex) = f.iter().find(|v| **v as usize >= vertices) {
            return Err(RenderError::BadFace { face, vertex, vertices });
        }
    }
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
    let shown = |i: usize| !(skip_caps && mesh.caps.get(i).copied().unwrap_or(false));
    Ok(Prepared {
        vertices: (0..vertices).map(at).collect(),
        indices: (0..mesh.faces.len()).filter(|i| shown(*i)).flat_map(|i| mesh.faces[i]).collect(),
        bounds: mesh.bounds(),
        mean_radius_mm,
    })
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_face_past_the_last_vertex_is_an_error() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO; 3],
            faces: vec![[0, 1, 2], [0, 1, 3]],
            ..Default::default()
        };
        let e = prepare(&mesh, false).err().expect("an error");
        assert!(matches!(e, RenderError::BadFace { face: 1, vertex: 3, vertices: 3 }));
    }

    #[test]
    fn caps_are_left_out_only_on_request() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            faces: vec![[0, 1, 2], [0, 2, 1]],
            caps: vec![false, true],
            ..Default::default()
        };
        assert_eq!(prepare(&mesh, false).unwrap().indices.len(), 6);
        assert_eq!(prepare(&mesh, true).unwrap().indices, [0, 1, 2]);
    }
}
