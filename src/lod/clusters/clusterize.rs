//! Splits faces into clusters that fit a page.

use glam::Vec3;
use rayon::prelude::*;

use super::cluster_builder::{ClusterBuilder, Correspondence, FaceParts};
use super::partition;
use crate::geometry::Mesh;
use crate::geometry::median_split::KeyedPoint;
use crate::lod::{PAGE_TRIANGLES, PAGE_VERTICES};

/// Faces of a cluster before borders are smoothed. Two thirds of a page: smaller clusters need
/// finer levels only where they are near, and less of them lies outside the frustum.
const TARGET_FACES: usize = 60;
/// Most faces of a cluster after borders are smoothed.
const MAX_FACES: usize = 64;
// The bit mask of [`Correspondence`] has one bit a triangle.
const _: () = assert!(MAX_FACES <= PAGE_TRIANGLES && MAX_FACES <= 64);

/// Clusters of the faces of the original.
pub fn finest_clusters(mesh: &Mesh, face_neighbors: &[[u32; 3]]) -> Vec<ClusterBuilder> {
    let centre = |f: u32| {
        let [a, b, c] = mesh.faces[f as usize].map(|v| mesh.positions[v as usize]);
        (a + b + c) / 3.0
    };
    let (mut ids, parts) = clusterize(&mesh.faces, face_neighbors, &centre);
    let own = split_by_sizes(&mut ids, parts);
    own.into_par_iter()
        .map(|ids| {
            crate::task::checkpoint();
            ids.sort_unstable();
            let faces: Vec<[u32; 3]> = ids.iter().map(|f| mesh.faces[*f as usize]).collect();
            let whole_faces =
                (0..).zip(ids.iter()).map(|(t, face)| Correspondence::on(*face, t)).collect();
            ClusterBuilder {
                whole_faces,
                to_original_mm: vec![0.0; faces.len()],
                ..cluster_builder(&faces)
            }
        })
        .collect()
}

/// A cluster of at most [`PAGE_TRIANGLES`] faces, without correspondences.
pub fn cluster_builder(faces: &[[u32; 3]]) -> ClusterBuilder {
    let vertices = vertices_of(faces.iter().copied());
    let place = |v: u32| vertices.binary_search(&v).unwrap_or(0) as u8;
    let triangles = faces.iter().map(|f| f.map(place)).collect();
    ClusterBuilder {
        triangles,
        vertices,
        whole_faces: Vec::new(),
        parts: FaceParts::default(),
        to_original_mm: Vec::new(),
        error: 0.0,
    }
}

/// Distinct vertices, ascending.
fn vertices_of(faces: impl Iterator<Item = [u32; 3]>) -> Vec<u32> {
    let mut all: Vec<u32> = faces.flatten().collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Splits a slice into consecutive parts of the given sizes.
fn split_by_sizes(all: &mut [u32], sizes: impl IntoIterator<Item = usize>) -> Vec<&mut [u32]> {
    let mut rest = all;
    let part = |n| rest.split_off_mut(..n).unwrap_or_default();
    sizes.into_iter().map(part).collect()
}

/// Sorts faces into clusters that fit a page. Returns face ids cluster after cluster, ascending in
/// each, and the size of each cluster.
pub fn clusterize(
    faces: &[[u32; 3]],
    face_neighbors: &[[u32; 3]],
    centre: &(impl Fn(u32) -> Vec3 + Sync),
) -> (Vec<u32>, Vec<usize>) {
    let all = (0..faces.len() as u32).into_par_iter().with_min_len(8192);
    let mut placed: Vec<KeyedPoint> = all.map(|f| KeyedPoint::new(centre(f), f)).collect();
    let mut sizes = partition::split_at_medians(&mut placed, TARGET_FACES);
    let mut part = vec![0u32; faces.len()];
    let mut first = 0;
    for (n, id) in sizes.iter().zip(0..) {
        placed[first..first + n].iter().for_each(|f| part[f.id() as usize] = id);
        first += n;
    }
    let mut order: Vec<u32> = placed.iter().map(KeyedPoint::id).collect();
    partition::smooth_borders(&mut part, &mut sizes, MAX_FACES, face_neighbors);
    let mut next = vec![0; sizes.len()];
    for i in 1..sizes.len() {
        next[i] = next[i - 1] + sizes[i - 1];
    }
    for (f, p) in (0..).zip(&part) {
        order[next[*p as usize]] = f;
        next[*p as usize] += 1;
    }
    let parts = split_by_sizes(&mut order, sizes.into_iter().filter(|n| *n > 0));
    let fit = parts.into_par_iter().map(|own| {
        crate::task::checkpoint();
        // Unconnected triangles have more vertices than faces.
        if vertices_of(own.iter().map(|f| faces[*f as usize])).len() > PAGE_VERTICES {
            let mut placed: Vec<_> = own.iter().map(|f| KeyedPoint::new(centre(*f), *f)).collect();
            let sizes = partition::split_at_medians(&mut placed, PAGE_VERTICES / 3);
            own.iter_mut().zip(placed).for_each(|(f, p)| *f = p.id());
            sizes
        } else {
            vec![own.len()]
        }
    });
    let fit: Vec<Vec<usize>> = fit.collect();
    let fit = fit.concat();
    (order, fit)
}
