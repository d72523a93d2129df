//! Errors of meshes.

use glam::Vec3;

/// Reasons why a mesh is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// The mesh has no faces.
    #[error("the mesh has no faces")]
    Empty,
    /// A list of the wrong length.
    #[error("the mesh has {found} {what}; {wanted} wanted")]
    Length {
        /// Kind of the list's entries.
        what: &'static str,
        /// Number of entries found.
        found: usize,
        /// Number of entries expected.
        wanted: usize,
    },
    /// More faces or vertices than ids can count.
    #[error("the mesh has {faces} faces and {vertices} vertices; {limit} of each are possible")]
    TooLarge {
        /// Number of faces.
        faces: usize,
        /// Number of vertices.
        vertices: usize,
        /// Largest number of either.
        limit: usize,
    },
    /// A coordinate or normal that is not finite.
    #[error("the {what} of vertex {vertex} is not finite: {value}")]
    NotFinite {
        /// Kind of the value: position or normal.
        what: &'static str,
        /// Index of the vertex.
        vertex: usize,
        /// Value that is not finite.
        value: Vec3,
    },
    /// A face with a vertex index out of range.
    #[error("face {face} names vertex {vertex}; there are {vertices}")]
    Index {
        /// Index of the face.
        face: usize,
        /// Vertex index that is out of range.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// A face that names a vertex twice.
    #[error("face {face} names a vertex twice")]
    Degenerate {
        /// Index of the face.
        face: usize,
    },
    /// More than two faces at an edge.
    #[error("more than two faces meet at the edge from {} to {}", .edge[0], .edge[1])]
    NonManifoldEdge {
        /// Ends of the edge, mm.
        edge: [Vec3; 2],
    },
    /// Two neighbouring faces of opposite orientation.
    #[error("the two faces at the edge from {} to {} look to different sides", .edge[0], .edge[1])]
    Misoriented {
        /// Ends of the edge, mm.
        edge: [Vec3; 2],
    },
    /// More than one fan of faces at a vertex.
    #[error("separate fans of faces touch in vertex {vertex} at {position}")]
    NonManifoldVertex {
        /// Index of the vertex.
        vertex: u32,
        /// Position of the vertex, mm.
        position: Vec3,
    },
    /// A surface that cannot be oriented.
    #[error("the surface is one-sided: no orientation agrees at the edge from {} to {}", .edge[0], .edge[1])]
    OneSided {
        /// Ends of the edge, mm.
        edge: [Vec3; 2],
    },
    /// A half-edge structure that contradicts itself.
    #[error("half-edge {half_edge}: {what}")]
    Broken {
        /// Index of the half-edge.
        half_edge: u32,
        /// Invariant that is violated.
        what: &'static str,
    },
    /// A vertex of a half-edge structure that contradicts its half-edges.
    #[error("vertex {vertex}: {what}")]
    BrokenVertex {
        /// Index of the vertex.
        vertex: u32,
        /// Invariant that is violated.
        what: &'static str,
    },
}
