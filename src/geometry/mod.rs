//! Types that rooms hand to each other (triangle mesh, vertex as drawn, centerline, camera, bounds),
//! and the queries on them that more than one room needs (nearest point on a mesh, view frustum).

mod bounds;
mod bvh;
mod camera;
mod cell_bits;
mod centerline;
mod centerline_distances;
mod centerline_places;
mod cross_section;
mod cube;
mod disjoint_sets;
mod exterior;
mod hierarchical_z;
pub mod median_split;
mod mesh;
mod morton;
mod point_triangle;
mod rows;
#[cfg(test)]
pub mod shapes;
mod tracts;
mod tree;
mod vertex;
mod view_frustum;

pub use bounds::{Cone, Sphere};
pub use bvh::{ClosestPoint, Subtree, TriangleBvh};
pub use camera::{Camera, Lens, Pose};
pub use centerline::{
    Attachment, AttachmentError, Branch, Centerline, CenterlineEdge, CenterlineGraph,
    CenterlineNode, CenterlinePoint, NodeKind,
};
pub use centerline_distances::CenterlineDistances;
pub use centerline_places::{CenterlinePlace, CenterlinePlaces, MAX_ASTRAY};
pub use cross_section::{CrossSection, cross_section};
pub use cube::cube_faces;
pub use disjoint_sets::DisjointSets;
pub use exterior::ExteriorGrid;
pub use hierarchical_z::{DepthMargin, HierarchicalZ};
pub use mesh::{Mesh, MeshPoint};
pub use morton::morton_code;
pub use point_triangle::{nearest_on_segment, nearest_on_triangle, point_triangle_distance};
pub use rows::in_rows;
pub use tracts::{Tract, Tracts};
pub use tree::TreeSummary;
pub use vertex::Vertex;
pub use view_frustum::{ProjectedBounds, ViewFrustum};
