//! Clusters as bytes, so that a mesh seen before need not be clustered again.

use crate::geometry::{Mesh, Vertex};

/// Hash of everything that a build depends on.
pub fn key(mesh: &Mesh, vertices: &[Vertex]) -> [u8; 32] {
    let mut hash = blake3::Hasher::new();
    hash.update(&(vertices.len() as u64).to_le_bytes());
    hash.update(bytemuck::cast_slice(vertices));
    hash.update(bytemuck::cast_slice(&mesh.faces));
    *hash.finalize().as_bytes()
}
