//! Errors of clustering a mesh and of reading clusters back.

/// Why a mesh cannot be clustered or a cluster file cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ClusterError {
    /// More faces or vertices than ids can count.
    #[error("{count} {what} are too many: {limit} at most")]
    TooMany {
        /// Faces or vertices.
        what: &'static str,
        /// How many there are.
        count: usize,
        /// How many there may be.
        limit: usize,
    },
    /// The number of vertices as drawn is not that of the mesh.
    #[error("{found} vertices to draw for a mesh of {wanted}")]
    Vertices {
        /// Given.
        found: usize,
        /// In the mesh.
        wanted: usize,
    },
    /// A face with a vertex index out of range.
    #[error("face {face} names vertex {vertex} of {vertices}")]
    Face {
        /// Which face.
        face: usize,
        /// The vertex it names.
        vertex: u32,
        /// Vertices there are.
        vertices: usize,
    },
    /// A position that is not finite or larger than 1e9 mm.
    #[error("vertex {vertex} has no place")]
    Place {
        /// Which vertex.
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
        /// Bytes there are.
        found: usize,
        /// Bytes that the counts ask for.
        wanted: u64,
    },
    /// The checksum does not match the content.
    #[error("the clusters are damaged: their checksum differs")]
    Checksum,
    /// Inconsistent content.
    #[error("{what} {at} of the clusters contradicts the others")]
    Broken {
        /// Cluster or group.
        what: &'static str,
        /// Its id.
        at: usize,
    },
}
