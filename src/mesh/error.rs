//! What can be wrong with a mesh.

use glam::Vec3;

/// Why a mesh is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// Nothing to work on.
    #[error("the mesh has no faces")]
    Empty,
    /// A list that does not fit the others.
    #[error("the mesh has {found} {what}; {wanted} wanted")]
    Length {
        /// What is listed.
        what: &'static str,
        /// Entries found.
        found: usize,
        /// Entries wanted.
        wanted: usize,
    },
    /// More than ids can count.
    #[error("the mesh has {faces} faces and {vertices} vertices; {limit} of each are possible")]
    TooLarge {
        /// Faces found.
        faces: usize,
        /// Vertices found.
        vertices: usize,
        /// The limit of both.
        limit: usize,
    },
    /// A coordinate or normal that is no number.
    #[error("the {what} of vertex {vertex} is not finite: {value}")]
    NotFinite {
        /// Position or normal.
        what: &'static str,
        /// Which vertex.
        vertex: usize,
        /// Its value.
        value: Vec3,
    },
    /// A face that names a vertex that is not there.
    #[error("face {face} names vertex {vertex}; there are {vertices}")]
    Index {
        /// Which face.
        face: usize,
        /// The vertex it names.
        vertex: u32,
        /// How many there are.
        vertices: usize,
    },
    /// A face that names a vertex twice.
    #[error("face {face} names a vertex twice")]
    Degenerate {
        /// Which face.
        face: usize,
    },
    /// More than two faces at an edge.
    #[error("more than two faces meet at the edge from {} to {}", .edge[0], .edge[1])]
    NonManifoldEdge {
        /// Its ends, mm.
        edge: [Vec3; 2],
    },
    /// Two faces that look to different sides.
    #[error("the two faces at the edge from {} to {} look to different sides", .edge[0], .edge[1])]
    Misoriented {
        /// Its ends, mm.
        edge: [Vec3; 2],
    },
    /// More than one fan of faces at a vertex.
    #[error("separate fans of faces touch in vertex {vertex} at {position}")]
    NonManifoldVertex {
        /// Which vertex.
        vertex: u32,
        /// Where it is, mm.
        position: Vec3,
    },
    /// A surface with one side.
    #[error("the surface is one-sided: no orientation agrees at the edge from {} to {}", .edge[0], .edge[1])]
    OneSided {
        /// Its ends, mm.
        edge: [Vec3; 2],
    },
    /// A half-edge structure that contradicts itself.
    #[error("half-edge {half_edge}: {what}")]
    Broken {
        /// Which half-edge.
        half_edge: u32,
        /// What does not hold.
        what: &'static str,
    },
    /// A vertex of a half-edge structure that contradicts its half-edges.
    #[error("vertex {vertex}: {what}")]
    BrokenVertex {
        /// Which vertex.
        vertex: u32,
        /// What does not hold.
        what: &'static str,
    },
}
