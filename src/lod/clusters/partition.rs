//! Face adjacency, and partitioning: faces into clusters, clusters into groups.

use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::median_split::{self, KeyedPoint};
use crate::geometry::morton_code;
use crate::mesh::halfedge::by_lower_vertex;

/// Stands for "no face".
pub const NO_FACE: u32 = u32::MAX;

/// Target number of clusters in a group.
pub const GROUP_SIZE: usize = 8;
const MIN_GROUP: usize = 4;
const MAX_GROUP: usize = 12;

/// Half-edge connectivity: for each face, the face across each of its edges (from corner k to
/// corner k + 1), [`NO_FACE`] on a boundary or where more than two faces meet. Accepts any triangle
/// soup.
pub fn face_neighbors(faces: &[[u32; 3]], vertices: usize) -> Vec<[u32; 3]> {
    let (start, half) = by_lower_vertex(faces, vertices);
    let mut out = vec![[NO_FACE; 3]; faces.len()];
    for v in 0..vertices {
        let mut row = &half[start[v] as usize..start[v + 1] as usize];
        while let [first, rest @ ..] = row {
            row = rest;
            let mut others = rest.iter().filter(|o| o.0 == first.0);
            if let (Some(second), None) = (others.next(), others.next()) {
                // Of three and more half-edges, the last two reach this point too.
                let before = &half[start[v] as usize..start[v + 1] as usize - rest.len() - 1];
                if !before.iter().any(|o| o.0 == first.0) {
                    out[first.1 as usize / 4][first.1 as usize % 4] = second.1 / 4;
                    out[second.1 as usize / 4][second.1 as usize % 4] = first.1 / 4;
                }
            }
        }
    }
    out
}

/// Splits items recursively at medians of the longest side of their box, into nearly equal parts of
/// at most `most`. Returns the size of each part, in the order in which the parts then stand in
/// `items`.
pub fn split_at_medians(items: &mut [KeyedPoint], most: usize) -> Vec<usize> {
    let parts = items.len().div_ceil(most);
    if parts <= 1 {
        return vec![items.len()];
    }
    if items.len() > 4096 {
        crate::task::checkpoint();
    }
    let cut = items.len() * (parts / 2) / parts;
    let (a, b) = median_split::split(items, cut);
    let (mut a, b) = if a.len() > 4096 {
        rayon::join(|| split_at_medians(a, most), || split_at_medians(b, most))
    } else {
        (split_at_medians(a, most), split_at_medians(b, most))
    };
    a.extend(b);
    a
}

/// Smooths cluster borders: moves faces that have two neighbours in one other cluster, and at most
/// one in their own, to that cluster while it has room. Median splits leave such teeth, and islands
/// of one face.
pub fn smooth_borders(
    part: &mut [u32],
    sizes: &mut [usize],
    most: usize,
    face_neighbors: &[[u32; 3]],
) {
    for _ in 0..4 {
        let mut moved = false;
        for f in 0..part.len() {
            let own = part[f];
            let near =
                face_neighbors[f].map(|n| if n == NO_FACE { NO_FACE } else { part[n as usize] });
            let [a, b, c] = near;
            let other = if a == b || a == c {
                a
            } else if b == c {
                b
            } else {
                continue;
            };
            if other != own && other != NO_FACE && sizes[other as usize] < most {
                part[f] = other;
                sizes[own as usize] -= 1;
                sizes[other as usize] += 1;
                moved = true;
            }
        }
        if !moved {
            break;
        }
    }
}

/// Border and position of a cluster, by which clusters are grouped.
pub struct ClusterBorder {
    /// Boundary edges of the cluster: lower vertex in the upper half, higher vertex in the lower.
    pub border: Vec<u64>,
    /// Centre of the bounding sphere, mm.
    pub centre: Vec3,
}

/// Boundary edges of some faces, in the form of [`ClusterBorder::border`].
pub fn border_edges(faces: impl Iterator<Item = [u32; 3]>) -> Vec<u64> {
    let edge = |a: u32, b: u32| u64::from(a.min(b)) << 32 | u64::from(a.max(b));
    let mut all: Vec<u64> =
        faces.flat_map(|[a, b, c]| [edge(a, b), edge(b, c), edge(c, a)]).collect();
    all.sort_unstable();
    all.chunk_by(|a, b| a == b).filter(|c| c.len() == 1).map(|c| c[0]).collect()
}

/// Partitions clusters greedily into groups of about [`GROUP_SIZE`] that share much border. A group
/// grows by the cluster that has the largest share of its border in common with it. Boundaries of
/// earlier groups, locked until then, have the densest edges, so they most likely come to lie
/// inside the new groups.
pub fn group_clusters(clusters: &[ClusterBorder]) -> Vec<Vec<u32>> {
    let n = clusters.len();
    let mut edges: Vec<(u64, u32)> = clusters
        .par_iter()
        .enumerate()
        .flat_map_iter(|(i, c)| c.border.iter().map(move |e| (*e, i as u32)))
        .collect();
    edges.par_sort_unstable();
    let mut pairs: Vec<(u32, u32)> = Vec::new();
    for c in edges.chunk_by(|a, b| a.0 == b.0).filter(|c| c.len() == 2) {
        pairs.extend([(c[0].1, c[1].1), (c[1].1, c[0].1)]);
    }
    pairs.par_sort_unstable();
    let mut adjacency: Vec<Vec<(u32, u32)>> = vec![Vec::new(); n];
    for c in pairs.chunk_by(|a, b| a == b).filter(|c| c[0].0 != c[0].1) {
        adjacency[c[0].0 as usize].push((c[0].1, c.len() as u32));
    }
    let order = morton_order(clusters);
    let mut group_of = vec![NO_FACE; n];
    let mut groups: Vec<Vec<u32>> = Vec::new();
    // Number of edges that each cluster shares with the growing group.
    let mut common = vec![0u32; n];
    for &seed in &order {
        if group_of[seed as usize] != NO_FACE {
            continue;
        }
        let id = groups.len() as u32;
        let mut own = vec![seed];
        let mut rim: Vec<u32> = Vec::new();
        group_of[seed as usize] = id;
        while own.len() < GROUP_SIZE {
            for &(w, edges) in &adjacency[own[own.len() - 1] as usize] {
                if group_of[w as usize] == NO_FACE {
                    if common[w as usize] == 0 {
                        rim.push(w);
                    }
                    common[w as usize] += edges;
                }
            }
            let share = |w: u32| {
                f64::from(common[w as usize]) / clusters[w as usize].border.len().max(1) as f64
            };
            let best = rim
                .iter()
                .copied()
                .enumerate()
                .max_by(|a, b| share(a.1).total_cmp(&share(b.1)).then(b.1.cmp(&a.1)));
            let Some((at, w)) = best else { break };
            rim.swap_remove(at);
            common[w as usize] = 0;
            group_of[w as usize] = id;
            own.push(w);
        }
        rim.iter().for_each(|w| common[*w as usize] = 0);
        groups.push(own);
    }
    merge_small_groups(&mut groups, &mut group_of, &adjacency, &order);
    groups
}

/// Merges small groups into the neighbour that shares most border, or else into the previous group
/// on the Z-order curve.
fn merge_small_groups(
    groups: &mut Vec<Vec<u32>>,
    group_of: &mut [u32],
    adjacency: &[Vec<(u32, u32)>],
    order: &[u32],
) {
    let fits = |a: &[u32], b: &[u32]| a.len() + b.len() <= MAX_GROUP;
    for g in 0..groups.len() {
        if groups[g].len() >= MIN_GROUP {
            continue;
        }
        let mut shared: Vec<(u32, u32)> = groups[g]
            .iter()
            .flat_map(|c| &adjacency[*c as usize])
            .map(|(w, edges)| (group_of[*w as usize], *edges))
            .filter(|(h, _)| *h != g as u32 && fits(&groups[g], &groups[*h as usize]))
            .collect();
        shared.sort_unstable();
        let sums = shared.chunk_by(|a, b| a.0 == b.0);
        let sums = sums.map(|c| (c.iter().map(|e| e.1).sum::<u32>(), u32::MAX - c[0].0));
        if let Some((_, h)) = sums.max() {
            merge_groups(groups, group_of, g, (u32::MAX - h) as usize);
        }
    }
    // Groups without neighbours: islands.
    let mut last: Option<usize> = None;
    for &c in order {
        let g = group_of[c as usize] as usize;
        if groups[g].len() >= MIN_GROUP || last == Some(g) {
            continue;
        }
        match last {
            Some(h) if fits(&groups[g], &groups[h]) => merge_groups(groups, group_of, g, h),
            _ => last = Some(g),
        }
    }
    groups.retain(|g| !g.is_empty());
}

fn merge_groups(groups: &mut [Vec<u32>], group_of: &mut [u32], from: usize, to: usize) {
    let moved = std::mem::take(&mut groups[from]);
    moved.iter().for_each(|c| group_of[*c as usize] = to as u32);
    groups[to].extend(moved);
}

/// Clusters along a Z-order (Morton) curve; ties by id.
fn morton_order(clusters: &[ClusterBorder]) -> Vec<u32> {
    let (lo, hi) = clusters
        .iter()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, c| (b.0.min(c.centre), b.1.max(c.centre)));
    let code = morton_code(lo, hi);
    let mut order: Vec<(u32, u32)> =
        clusters.iter().zip(0..).map(|(c, i)| (code(c.centre), i)).collect();
    order.sort_unstable();
    order.into_iter().map(|o| o.1).collect()
}
