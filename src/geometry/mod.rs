//! Types that rooms hand to each other (triangle mesh, vertex as drawn, centerline, camera, bounds),
//! and the queries on them that more than one room needs (nearest point on a mesh).

mod bounds;
mod bvh;
mod camera;
mod centerline;
mod cube;
mod disjoint_sets;
pub mod median_split;
mod mesh;
mod morton;
mod point_triangle;
mod rows;
#[cfg(test)]
pub mod shapes;
mod tree;
mod vertex;

pub use bounds::{Cone, Sphere};
pub use bvh::{ClosestPoint, Subtree, TriangleBvh};
pub use camera::{Camera, Lens, Pose};
pub use centerline::{
    Attachment, AttachmentError, Branch, Centerline, CenterlineEdge, CenterlineGraph,
    CenterlineNode, CenterlinePoint, NodeKind,
};
pub use cube::cube_faces;
pub use disjoint_sets::DisjointSets;
pub use mesh::{Mesh, MeshPoint};
pub use morton::morton_code;
pub use point_triangle::{nearest_on_segment, nearest_on_triangle, point_triangle_distance};
pub use rows::in_rows;
pub use tree::TreeSummary;
pub use vertex::Vertex;
