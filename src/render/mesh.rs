//! A mesh as the device draws it.

use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;

use super::RenderError;
use crate::geometry::{Camera, Mesh};
use crate::lod::{FaceOctree, OcclusionTest};
use crate::surface::{Shading, shading};
use crate::vk::IndexedRange;

/// A mesh in the form that is drawn: vertices, indices, and the sizes the light depends on. Making
/// it takes most of the time of putting a mesh on the device, and needs no device.
#[derive(Debug)]
pub struct PreparedMesh {
    pub(super) shading: Arc<Shading>,
    pub(super) indices: Vec<u32>,
    pub(super) bounds: Option<(Vec3, Vec3)>,
    /// Culling in whose order the faces are.
    pub(super) culling: Option<Culling>,
}

/// Culling of the faces of a mesh that a camera cannot see.
#[derive(Clone, Debug)]
pub struct Culling {
    /// Octree of the faces, in whose order they are on the device.
    pub octree: Arc<FaceOctree>,
    /// Occlusion of a closed wall by itself, where eyes are inside one; else back faces are drawn.
    pub closed: Option<Arc<OcclusionTest>>,
}

impl Culling {
    /// Returns the vertices of the faces, three a face, in the order of the octree.
    pub(super) fn indices(&self, faces: &[[u32; 3]]) -> Vec<u32> {
        assert_eq!(self.octree.face_count(), faces.len(), "the faces of the mesh");
        self.octree.indices(faces)
    }

    /// Returns the index ranges that `camera` can see, and their number of triangles.
    pub(super) fn visible_ranges(&self, camera: &Camera) -> (Vec<IndexedRange>, u64) {
        let ranges = self.octree.visible(camera, self.closed.as_deref());
        let triangles = ranges.iter().map(|r| r.len() as u64 / 3).sum();
        let range = |r: Range<u32>| IndexedRange {
            first_index: r.start,
            indices: r.end - r.start,
            first_vertex: 0,
            instance: 0,
        };
        (ranges.into_iter().map(range).collect(), triangles)
    }
}

impl PreparedMesh {
    /// Shades a mesh ([`crate::surface::shading`]).
    ///
    /// # Errors
    /// [`RenderError::BadFace`].
    pub fn new(mesh: &Mesh) -> Result<Self, RenderError> {
        prepare(mesh, false)
    }

    /// Shades a mesh as [`PreparedMesh::new`] and leaves out its caps.
    ///
    /// # Errors
    /// [`RenderError::BadFace`].
    pub fn without_caps(mesh: &Mesh) -> Result<Self, RenderError> {
        prepare(mesh, true)
    }

    /// Takes a mesh that was shaded before.
    ///
    /// # Errors
    /// [`RenderError::BadFace`].
    pub fn shaded(mesh: &Mesh, shading: Arc<Shading>) -> Result<Self, RenderError> {
        check_faces(mesh)?;
        Ok(prepare_shaded(mesh, shading, false))
    }

    /// Takes a mesh that was shaded before, with a culling of all its faces: inside views leave out
    /// what their camera cannot see.
    ///
    /// # Errors
    /// [`RenderError::BadFace`].
    ///
    /// # Panics
    /// If the culling is of another number of faces.
    pub fn culled(
        mesh: &Mesh,
        shading: Arc<Shading>,
        culling: Culling,
    ) -> Result<Self, RenderError> {
        check_faces(mesh)?;
        Ok(Self {
            shading,
            indices: culling.indices(&mesh.faces),
            bounds: mesh.bounds(),
            culling: Some(culling),
        })
    }
}

/// Brings a mesh into the form that is drawn; caps are left out on request.
pub(super) fn prepare(mesh: &Mesh, skip_caps: bool) -> Result<PreparedMesh, RenderError> {
    check_faces(mesh)?;
    Ok(prepare_shaded(mesh, Arc::new(shading(mesh)), skip_caps))
}

fn check_faces(mesh: &Mesh) -> Result<(), RenderError> {
    let vertices = mesh.positions.len();
    for (face, f) in mesh.faces.iter().enumerate() {
        if let Some(&vertex) = f.iter().find(|v| **v as usize >= vertices) {
            return Err(RenderError::BadFace { face, vertex, vertices });
        }
    }
    Ok(())
}

/// Brings a mesh whose vertices were shaded before into the form that is drawn.
fn prepare_shaded(mesh: &Mesh, shading: Arc<Shading>, skip_caps: bool) -> PreparedMesh {
    let shown = |i: usize| !(skip_caps && mesh.caps.get(i).copied().unwrap_or(false));
    let mut indices = Vec::with_capacity(3 * mesh.faces.len());
    indices.extend((0..mesh.faces.len()).filter(|i| shown(*i)).flat_map(|i| mesh.faces[i]));
    PreparedMesh { shading, indices, bounds: mesh.bounds(), culling: None }
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
        let e = prepare(&mesh, false).expect_err("an error");
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
