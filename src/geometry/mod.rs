//! Types that rooms hand to each other (triangle mesh, vertex as drawn, centerline, camera pose),
//! and the queries on them that more than one room needs (nearest point on a mesh).

mod bvh;
mod camera;
mod centerline;
pub mod median_split;
mod mesh;
mod point_triangle;
#[cfg(test)]
pub mod shapes;
mod vertex;

pub use bvh::{ClosestPoint, TriangleBvh};
pub use camera::{Lens, Pose};
pub use centerline::{
    Attachment, AttachmentError, Branch, Centerline, CenterlineEdge, CenterlineGraph,
    CenterlineNode, CenterlinePoint, NodeKind,
};
pub use mesh::{Mesh, MeshPoint};
pub use point_triangle::nearest_on_triangle;
pub use vertex::Vertex;
