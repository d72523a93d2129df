//! What can be wrong with a mesh to be clustered, or with clusters read back.

/// Why there are no clusters.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ClusterError {
    /// More than ids can count.
    #[error("{count} {what} are too many: {limit} at most")]
    TooMany {
        /// Faces or vertices.
        what: &'static str,
        /// How many there are.
        count: usize,
        /// How many there may be.
        limit: usize,
    },
    /// Vertices to be drawn that are not those of the mesh.
    #[error("{found} vertices to draw for a mesh of {wanted}")]
    Vertices {
        /// Given.
        found: usize,
        /// In the mesh.
        wanted: usize,
    },
    /// A face that names a vertex that is not there.
    #[error("face {face} names vertex {vertex} of {vertices}")]
    Face {
        /// Which face.
        face: usize,
        /// The vertex it names.
        vertex: u32,
        /// Vertices there are.
        vertices: usize,
    },
    /// A position that is no number, or so far off that its square is none.
    #[error("vertex {vertex} has no place")]
    Place {
        /// Which vertex.
        vertex: usize,
    },
    /// Bytes that do not hold clusters of this version.
    #[error("not a cluster file of this version")]
    Kind,
    /// Clusters of another mesh.
    #[error("the clusters belong to another mesh")]
    OtherMesh,
    /// Bytes that end too soon or too late.
    #[error("{found} bytes of clusters where {wanted} should be")]
    Length {
        /// Bytes there are.
        found: usize,
        /// Bytes that the counts ask for.
        wanted: u64,
    },
    /// Bytes that are not those written.
    #[error("the clusters are damaged: their checksum differs")]
    Checksum,
    /// Content that contradicts itself.
    #[error("{what} {at} of the clusters contradicts the others")]
    Broken {
        /// Cluster or group.
        what: &'static str,
        /// Its id.
        at: usize,
    },
}
