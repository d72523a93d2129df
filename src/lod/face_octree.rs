//! Octree of a mesh's faces, by which the part of a whole mesh that a camera can see is drawn.
//!
//! Faces are drawn in the order of the tree, so that each cell is one range of the index buffer. A
//! camera draws the cells that are inside its view frustum, do not face away and are not occluded;
//! of a closed wall those hold no visible face.

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use super::octree::{Item, Octree, OctreeNode};
use super::{DrawnWall, HierarchicalZ, OcclusionTest, ViewFrustum, VisibleWall};
use crate::geometry::{Camera, Mesh};

/// Most faces of a leaf. Fewer are culled more tightly, but each range of faces is a draw.
const LEAF_FACES: usize = 64;

/// Octree of a mesh's faces.
#[derive(Debug)]
pub struct FaceOctree {
    tree: Octree,
}

impl FaceOctree {
    /// Builds the octree of a mesh, whose faces must have vertices.
    pub fn new(mesh: &Mesh) -> Self {
        let corners = |f: u32| mesh.faces[f as usize].map(|v| mesh.positions[v as usize]);
        let triangle = |f| Item::triangle(corners(f));
        Self { tree: Octree::from_fn(mesh.faces.len(), LEAF_FACES, triangle) }
    }

    /// Returns the number of faces.
    pub fn face_count(&self) -> usize {
        self.tree.items.len()
    }

    /// Returns the vertices of the faces, three a face, in the order of the tree.
    ///
    /// * `faces`: those of the mesh that the tree was built of.
    pub fn indices(&self, faces: &[[u32; 3]]) -> Vec<u32> {
        self.tree.items.par_iter().flat_map_iter(|f| faces[*f as usize]).collect()
    }

    /// Builds the octree of faces with these bounds.
    pub fn of_items(faces: usize, item: impl Fn(u32) -> Item + Sync) -> Self {
        Self { tree: Octree::from_fn(faces, LEAF_FACES, item) }
    }

    /// Returns the faces in the order of the tree.
    pub fn faces(&self) -> &[u32] {
        &self.tree.items
    }

    /// Returns the nodes of the tree.
    pub(super) fn nodes(&self) -> &[OctreeNode] {
        &self.tree.nodes
    }

    /// Returns the children of a node of the tree.
    pub(super) fn children(&self, node: usize) -> Range<usize> {
        self.tree.children(node)
    }

    /// Calls `leaf` with each leaf that may be seen, in the order of the tree.
    ///
    /// * `depths`: depths behind which a closed wall hides, seen from inside it. Cells of back faces
    ///   and occluded cells are left out then.
    pub(super) fn visible_leaves(
        &self,
        frustum: &ViewFrustum,
        depths: Option<&HierarchicalZ>,
        leaf: impl FnMut(usize, &OctreeNode),
    ) {
        let eye = frustum.position();
        let is_seen = |n: &OctreeNode| {
            let (lo, hi) = (n.lo.as_dvec3(), n.hi.as_dvec3());
            let (centre, half) = (0.5 * (lo + hi), 0.5 * (hi - lo));
            let hidden = |depths: &HierarchicalZ| {
                frustum.is_backfacing(&n.sphere, &n.cone) || depths.hides(centre - eye, half)
            };
            frustum.intersects_box(centre - eye, half) && !depths.is_some_and(hidden)
        };
        self.tree.traverse(is_seen, leaf);
    }
}

/// The whole wall, less what a camera cannot see of it.
#[derive(Clone, Debug)]
pub struct CulledWall {
    /// Octree of the faces, in whose order they are on the device.
    pub octree: Arc<FaceOctree>,
    /// Occlusion test of a closed wall, where eyes are inside it; else back faces are drawn.
    pub closed: Option<Arc<OcclusionTest>>,
}

impl DrawnWall for CulledWall {
    fn visible(&self, camera: &Camera) -> VisibleWall {
        let frustum = ViewFrustum::new(camera);
        let depths = self.closed.as_ref().map(|test| test.depths(&frustum));
        let mut seen = VisibleWall::default();
        self.octree.visible_leaves(&frustum, depths.as_ref(), |_, n| {
            seen.add_faces(n.first..n.first + n.count);
        });
        seen
    }

    fn shows_backs(&self) -> bool {
        self.closed.is_none()
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::geometry::shapes::torus;
    use crate::geometry::{Lens, Pose, TriangleBvh};
    use crate::lod::{DrawnRange, occlusion_grid};

    #[test]
    fn a_ray_from_the_eye_meets_no_face_that_is_left_out() {
        let mesh = torus(400, 120);
        let octree = Arc::new(FaceOctree::new(&mesh));
        let indices = octree.indices(&mesh.faces);
        let face_of = |i: u32| [0, 1, 2].map(|k| indices[3 * i as usize + k]);
        let closed = Some(Arc::new(OcclusionTest::of_wall(occlusion_grid(&mesh))));
        let wall = CulledWall { octree, closed };
        let tree = TriangleBvh::new(&mesh);
        let mut seed = 9u64;
        let mut noise = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 40) as f32 / (1u64 << 23) as f32 - 1.0
        };
        let lens = Lens { fov_y_rad: 1.2, aspect: 1.5, near_mm: 0.01 };
        let (mut met, mut drawn) = (0, 0);
        for _ in 0..40 {
            let eye = Vec3::new(10.0 + 2.0 * noise(), 0.0, 2.0 * noise());
            let gaze = Vec3::new(noise(), noise(), noise());
            let camera =
                Camera { pose: Pose::looking(eye, eye + gaze, Vec3::Z), lens, height_px: 100 };
            let ranges = wall.visible(&camera).ranges;
            let end = |r: &DrawnRange| r.first_index + r.indices;
            assert!(ranges.is_sorted_by(|a, b| end(a) < b.first_index), "{ranges:?}");
            let faces: Vec<[u32; 3]> =
                ranges.iter().flat_map(|r| r.first_index / 3..end(r) / 3).map(face_of).collect();
            drawn += faces.len();
            let seen = TriangleBvh::new(&Mesh { faces, ..mesh.clone() });
            for _ in 0..200 {
                let y = (0.5 * lens.fov_y_rad).tan() * noise();
                let x = (0.5 * lens.fov_y_rad).tan() * lens.aspect * noise();
                let way = camera.pose.rotation * Vec3::new(x, y, -1.0).normalize();
                let Some(hit) = tree.first_hit(eye.as_dvec3(), 30.0 * way.as_dvec3()) else {
                    continue;
                };
                met += 1;
                assert!(seen.distance(hit, 1.0) < 1e-5, "{hit} from {eye}");
            }
        }
        assert!(met > 7_500, "{met}");
        assert!(drawn < 40 * mesh.faces.len() / 6, "{drawn}");
    }

    #[test]
    fn a_mesh_without_faces_has_nothing_to_see() {
        let octree = FaceOctree::new(&Mesh::default());
        let lens = Lens { fov_y_rad: 1.0, aspect: 1.0, near_mm: 0.1 };
        let pose = Pose::looking(Vec3::ZERO, Vec3::X, Vec3::Z);
        let camera = Camera { pose, lens, height_px: 9 };
        assert!(octree.indices(&[]).is_empty());
        let wall = CulledWall { octree: Arc::new(octree), closed: None };
        assert!(wall.visible(&camera).ranges.is_empty());
    }
}
