//! A wall as the device draws it.

use std::sync::Arc;

use glam::Vec3;

use super::RenderError;
use crate::geometry::Mesh;
use crate::lod::refined::RefinedWall;
use crate::lod::vds::{ResidentPatches, SubdividedWall};
use crate::lod::{CulledWall, DrawnWall};
use crate::surface::{Shading, shading};

/// A wall in the form that is drawn: vertices, indices, the sizes the light depends on, and what a
/// camera sees of it. Making it takes most of the time of putting a mesh on the device, and needs no
/// device.
#[derive(Debug)]
pub struct PreparedMesh {
    pub(super) vertices: WallVertices,
    pub(super) indices: Vec<u32>,
    pub(super) bounds: Option<(Vec3, Vec3)>,
    pub(super) mean_radius_mm: f32,
    /// Part of it that a camera sees; all of it where `None`.
    pub(super) drawn: Option<Arc<dyn DrawnWall>>,
    /// The wall whose faces are refined, of such a wall.
    pub(super) refined: Option<Arc<RefinedWall>>,
}

/// Vertices of a wall.
#[derive(Debug)]
pub(super) enum WallVertices {
    /// Vertices of a mesh.
    Mesh(Arc<Shading>),
    /// Vertices of patches, which are moved as a patch gets finer.
    Patches(Arc<ResidentPatches>),
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

    /// Takes a mesh that was shaded before, with the octree of all its faces: inside views leave out
    /// what their camera cannot see.
    ///
    /// # Errors
    /// [`RenderError::BadFace`].
    ///
    /// # Panics
    /// If the octree is of another number of faces.
    pub fn culled(
        mesh: &Mesh,
        shading: Arc<Shading>,
        wall: Arc<CulledWall>,
    ) -> Result<Self, RenderError> {
        check_faces(mesh)?;
        let whole = prepare_shaded(mesh, shading, false);
        Ok(Self { indices: ordered(&wall, &mesh.faces), drawn: Some(wall), ..whole })
    }

    /// Takes a subdivided wall.
    ///
    /// * `mean_radius_mm`: mean radius of the organ, for the light (see [`crate::surface::shading`]).
    pub fn subdivided(wall: Arc<SubdividedWall>, mean_radius_mm: f32) -> Self {
        let patches = Arc::clone(wall.surface().patches());
        Self {
            indices: patches.indices().to_vec(),
            vertices: WallVertices::Patches(patches),
            bounds: None,
            mean_radius_mm,
            drawn: Some(wall),
            refined: None,
        }
    }

    /// Takes a wall whose faces are refined near the eye.
    pub fn refined(wall: Arc<RefinedWall>) -> Self {
        let shading = Arc::clone(wall.shading());
        let bounds = shading.vertices.iter().map(|v| (v.position(), v.position()));
        Self {
            indices: wall.faces().as_flattened().to_vec(),
            bounds: bounds.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))),
            mean_radius_mm: shading.mean_radius_mm,
            vertices: WallVertices::Mesh(shading),
            drawn: Some(Arc::clone(&wall) as Arc<dyn DrawnWall>),
            refined: Some(wall),
        }
    }

    /// Returns the vertices of a mesh.
    ///
    /// # Panics
    /// If it is a wall of patches.
    pub(super) fn shading(&self) -> &Arc<Shading> {
        match &self.vertices {
            WallVertices::Mesh(shading) => shading,
            WallVertices::Patches(_) => panic!("a mesh, not patches"),
        }
    }
}

/// The vertices of a wall's faces in the order in which they are drawn.
pub(super) fn ordered(wall: &CulledWall, faces: &[[u32; 3]]) -> Vec<u32> {
    assert_eq!(wall.octree.face_count(), faces.len(), "the faces of the mesh");
    wall.octree.indices(faces)
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
    let mean_radius_mm = shading.mean_radius_mm;
    let (vertices, bounds) = (WallVertices::Mesh(shading), mesh.bounds());
    PreparedMesh { vertices, indices, bounds, mean_radius_mm, drawn: None, refined: None }
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
