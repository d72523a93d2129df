//! Serialized clusters: round trip and corruption.

use std::sync::Arc;

use super::super::{ClusterError, ClusterLod, Clusters, DEFAULT_SHADING_RAD, Group};
use super::{build, camera, noise, ring, settle};
use crate::lod::PageCache;
use crate::surface::shading;

#[test]
fn serialized_clusters_round_trip_for_their_own_mesh_only() {
    let mesh = ring(60, 20);
    let vertices = shading(&mesh).vertices;
    let clusters = build(&mesh);
    assert!(clusters.groups().len() > 3);
    let bytes = clusters.to_bytes();
    assert!(Clusters::from_bytes(&bytes, &mesh, &vertices).unwrap() == clusters);
    let mut other = mesh.clone();
    other.positions[7].x += 1e-3;
    let err = Clusters::from_bytes(&bytes, &other, &vertices).unwrap_err();
    assert_eq!(err, ClusterError::OtherMesh);
}

#[test]
fn subtree_bounds_below_those_of_children_are_refused() {
    let mesh = ring(60, 20);
    let vertices = shading(&mesh).vertices;
    let clusters = build(&mesh);
    assert!(clusters.groups().len() > 3);
    let last = clusters.groups.len() - 1;
    for lower in [
        |g: &mut Group| g.subtree_angle_rad = 0.0,
        |g: &mut Group| g.subtree_turn_mm = 0.0,
        |g: &mut Group| g.edge_mm = 0.0,
    ] {
        let mut bad = clusters.clone();
        lower(&mut bad.groups[last]);
        let read = Clusters::from_bytes(&bad.to_bytes(), &mesh, &vertices);
        assert_eq!(read.unwrap_err(), ClusterError::Broken { what: "group", at: last });
    }
}

#[test]
fn corrupted_cluster_files_are_refused_or_usable() {
    let mesh = ring(60, 20);
    let vertices = shading(&mesh).vertices;
    let bytes = build(&mesh).to_bytes();
    let read = |b: &[u8]| Clusters::from_bytes(b, &mesh, &vertices);
    for n in (0..bytes.len()).step_by(997) {
        assert!(read(&bytes[..n]).is_err());
    }
    let mut huge = bytes.clone();
    huge[44..52].copy_from_slice(&u64::MAX.to_le_bytes());
    assert!(matches!(read(&huge), Err(ClusterError::Length { .. })));
    let mut bad = bytes.clone();
    bad[200] ^= 1;
    assert_eq!(read(&bad).unwrap_err(), ClusterError::Checksum);
    // With a valid checksum: whatever is accepted can be used.
    let (mut refused, seed) = (0, &mut 21);
    for k in 0..400 {
        let mut bad = bytes.clone();
        let content = bad.len() - 32;
        let at = 92 + (noise(seed) * (content - 92) as f32) as usize;
        bad[at.min(content - 1)] ^= 1 << (k % 8);
        let hash = blake3::hash(&bad[..content]);
        bad[content..].copy_from_slice(hash.as_bytes());
        match read(&bad) {
            Err(_) => refused += 1,
            Ok(c) => {
                let mut lod = ClusterLod::new(Arc::new(c), DEFAULT_SHADING_RAD);
                settle(&mut lod, &camera(0.1), 0.5, &mut PageCache::new(4000, 4000, 1));
            }
        }
    }
    assert!(refused > 20, "{refused}");
}
