//! A mesh as the device draws it.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

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
    let curvature = curvature(mesh, normals);
    // A quarter of curvature times radius: a fold four times as sharp as the wall is full scale.
    let scale = 0.25 * mean_radius_mm;
    let at = |v: usize| Vertex::new(mesh.positions[v], normals[v], scale * curvature[v]);
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

/// Mean normal curvature at each vertex, 1/mm, over the edges around it and smoothed once over
/// the same edges; positive where the wall stands into the lumen.
fn curvature(mesh: &Mesh, normals: &[Vec3]) -> Vec<f32> {
    let edges = || mesh.faces.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    let mut sum = vec![(0.0f32, 0.0f32); mesh.positions.len()];
    for (a, b) in edges().map(|(a, b)| (a as usize, b as usize)) {
        let along = mesh.positions[b] - mesh.positions[a];
        let length2 = along.length_squared();
        if length2 > 0.0 {
            let k = (normals[b] - normals[a]).dot(along) / length2;
            for v in [a, b] {
                sum[v].0 += k;
                sum[v].1 += 1.0;
            }
        }
    }
    let raw: Vec<f32> = sum.iter().map(|(k, n)| k / n.max(1.0)).collect();
    let mut smooth: Vec<Vec4> = raw.iter().map(|k| Vec4::new(2.0 * k, 2.0, 0.0, 0.0)).collect();
    for (a, b) in edges().map(|(a, b)| (a as usize, b as usize)) {
        smooth[a] += Vec4::new(raw[b], 1.0, 0.0, 0.0);
        smooth[b] += Vec4::new(raw[a], 1.0, 0.0, 0.0);
    }
    smooth.iter().map(|s| s.x / s.y).collect()
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
