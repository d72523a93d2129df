//! Errors of clustering a mesh and of reading clusters back.

/// Why a mesh cannot be clustered or a cluster file cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ClusterError {
    /// More faces or vertices than ids can count.
    #[error("{count} {what} are too many: {limit} at most")]
    TooMany {
        /// Kind of element: faces or vertices.
        what: &'static str,
        /// Number of elements.
        count: usize,
        /// Largest number allowed.
        limit: usize,
    },
    /// The number of vertices as drawn is not that of the mesh.
    #[error("{found} vertices to draw for a mesh of {wanted}")]
    Vertices {
        /// Number of vertices as drawn.
        found: usize,
        /// Number of vertices of the mesh.
        wanted: usize,
    },
    /// A face with a vertex index out of range.
    #[error("face {face} names vertex {vertex} of {vertices}")]
    Face {
        /// Index of the face.
        face: usize,
        /// Vertex index that is out of range.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// A position that is not finite or larger than 1e9 mm.
    #[error("vertex {vertex} has no place")]
    Place {
        /// Index of the vertex.
        vertex: usize,
    },
    /// Not a cluster file, or one of another version.
    #[error("not a cluster file of this version")]
    Kind,
    /// Clusters that were built from another mesh.
    #[error("the clusters belong to another mesh")]
    OtherMesh,
    /// A file that is shorter or longer than its counts say.
    #[error("{found} bytes of clusters where {wanted} should be")]
    Length {
        /// Length of the file, bytes.
        found: usize,
        /// Length that follows from the counts, bytes.
        wanted: u64,
    },
    /// The checksum does not match the content.
    #[error("the clusters are damaged: their checksum differs")]
    Checksum,
    /// Inconsistent content.
    #[error("{what} {at} of the clusters contradicts the others")]
    Broken {
        /// Kind of element: cluster or group.
        what: &'static str,
        /// Id of the element.
        at: usize,
    },
}
