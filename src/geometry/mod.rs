//! What rooms hand to each other: a plain triangle mesh, a vertex as drawn, a
//! centerline, a camera pose.

mod camera;
mod centerline;
mod mesh;
#[cfg(test)]
pub mod shapes;
mod vertex;

pub use camera::{Lens, Pose};
pub use centerline::{Branch, Centerline, CenterlinePoint};
pub use mesh::Mesh;
pub use vertex::Vertex;
