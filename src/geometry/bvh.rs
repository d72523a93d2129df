//! Bounding volume hierarchy over the triangles of a mesh, for the nearest point on it and for
//! intersections with a segment.

mod segment;

use std::ops::Range;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::median_split::{self, KeyedPoint};
use super::{Mesh, MeshPoint, nearest_on_triangle};
use crate::task::checkpoint;

/// Largest number of triangles of a leaf.
const LEAF: usize = 4;
/// Number of triangles below which a subtree is built by one thread.
const ALONE: usize = 1 << 14;
/// Capacity of a search's stack of open subtrees.
const DEPTH: usize = 32;

/// Nearest point on a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosestPoint {
    /// Face and barycentric weights of the point.
    pub at: MeshPoint,
    /// Position of the point, mm.
    pub point: DVec3,
    /// Distance to the point, mm.
    pub distance_mm: f64,
}

/// Box around the triangles of a subtree.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    lo: Vec3,
    hi: Vec3,
}

impl Bounds {
    const NOTHING: Self = Self { lo: Vec3::INFINITY, hi: Vec3::NEG_INFINITY };

    fn join(self, other: Self) -> Self {
        Self { lo: self.lo.min(other.lo), hi: self.hi.max(other.hi) }
    }

    /// Returns the squared distance to a point, mm²; 0 inside.
    #[inline]
    fn distance2(&self, p: DVec3) -> f64 {
        let d = (self.lo.as_dvec3() - p).max(p - self.hi.as_dvec3()).max(DVec3::ZERO);
        d.length_squared()
    }
}

/// Bounding volume hierarchy over the triangles of a mesh, split at the median of the longest side.
/// Nodes are stored depth first, left child first, so that a node is its box alone: the number of
/// triangles below it gives the place of its right child. 24 bytes a node, half a node a face, and
/// 40 bytes a face.
#[derive(Clone, Debug)]
pub struct TriangleBvh {
    nodes: Vec<Bounds>,
    /// Corners, in the order of the leaves.
    triangles: Vec<[Vec3; 3]>,
    /// Face id of each triangle.
    faces: Vec<u32>,
}

/// A node of the tree with the `count` triangles below it, from `first` on, in the order of the
/// leaves.
#[derive(Clone, Copy, Debug)]
pub struct Subtree {
    /// Index of the node.
    pub node: usize,
    /// Place of the node's first triangle in the leaves.
    pub first: usize,
    /// Number of triangles below the node.
    pub count: usize,
}

impl Subtree {
    /// Whether the node has no children.
    pub fn is_leaf(self) -> bool {
        self.count <= LEAF
    }

    /// Returns the number of nodes of the subtree.
    pub fn nodes(self) -> usize {
        nodes(self.count)
    }

    /// Returns the places of the node's triangles in the leaves.
    pub fn triangles(self) -> Range<usize> {
        self.first..self.first + self.count
    }

    /// Returns both children of a node that is not a leaf.
    pub fn children(self) -> [Self; 2] {
        let m = left(self.count);
        [
            Self { node: self.node + 1, first: self.first, count: m },
            Self { node: self.node + 1 + nodes(m), first: self.first + m, count: self.count - m },
        ]
    }
}

/// Returns the number of nodes of a subtree of `n` triangles.
fn nodes(n: usize) -> usize {
    2 * n.div_ceil(LEAF).max(1) - 1
}

/// Returns the number of triangles in the left child of a subtree of `n`: half of its leaves, each
/// full.
fn left(n: usize) -> usize {
    n.div_ceil(LEAF).div_ceil(2) * LEAF
}

impl TriangleBvh {
    /// Builds the tree, O(F log F). Indices must be in range. Triangles with a corner that is not
    /// finite are left out; those without area are not.
    pub fn new(mesh: &Mesh) -> Self {
        let corners = |f: u32| mesh.faces[f as usize].map(|v| mesh.positions[v as usize]);
        let centre = |f: u32| KeyedPoint::new(corners(f).iter().sum(), f);
        let mut items: Vec<KeyedPoint> = (0..mesh.faces.len() as u32)
            .into_par_iter()
            .with_min_len(8192)
            .filter(|f| corners(*f).iter().all(|c| c.is_finite()))
            .map(centre)
            .collect();
        let mut tree = vec![Bounds::NOTHING; if items.is_empty() { 0 } else { nodes(items.len()) }];
        if !items.is_empty() {
            build(&mut items, &mut tree, &|f| {
                let [a, b, c] = corners(f);
                Bounds { lo: a.min(b).min(c), hi: a.max(b).max(c) }
            });
        }
        let faces: Vec<u32> = items.iter().map(KeyedPoint::id).collect();
        let triangles = faces.par_iter().with_min_len(8192).map(|f| corners(*f)).collect();
        Self { nodes: tree, triangles, faces }
    }

    /// Returns the whole tree; without triangles, an empty leaf that has no box.
    pub fn root(&self) -> Subtree {
        Subtree { node: 0, first: 0, count: self.faces.len() }
    }

    /// Returns the smallest and largest corner of the box around the triangles of a subtree.
    pub fn bounds(&self, s: Subtree) -> (Vec3, Vec3) {
        (self.nodes[s.node].lo, self.nodes[s.node].hi)
    }

    /// Returns the corners of a triangle, by its place in the leaves.
    pub fn triangle(&self, place: usize) -> [Vec3; 3] {
        self.triangles[place]
    }

    /// Returns the face of the mesh, by its triangle's place in the leaves.
    pub fn face(&self, place: usize) -> u32 {
        self.faces[place]
    }

    /// Returns the point nearest to `p`, `None` on a mesh without faces. Of points equally near,
    /// the one on the face visited first, which depends on nothing but the mesh and `p`.
    pub fn closest(&self, p: DVec3) -> Option<ClosestPoint> {
        self.closest_within(p, f64::INFINITY)
    }

    /// Returns the distance from a point to the mesh, mm, or `limit_mm` if it is no nearer than that.
    pub fn distance(&self, p: DVec3, limit_mm: f64) -> f64 {
        self.closest_within(p, limit_mm).map_or(limit_mm, |c| c.distance_mm)
    }

    /// Returns the point nearest to `p` if it is nearer than `limit_mm`.
    pub fn closest_within(&self, p: DVec3, limit_mm: f64) -> Option<ClosestPoint> {
        if self.faces.is_empty() {
            return None;
        }
        let mut best = (limit_mm * limit_mm, usize::MAX, DVec3::ZERO);
        // A subtree and the squared distance of its box. Halving 2³⁰ faces is 28 levels deep, each
        // of which leaves one child on the stack.
        let mut open = [(self.root(), 0f64); DEPTH];
        open[0].1 = self.nodes[0].distance2(p);
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (s, far2) = open[depth];
            if far2 >= best.0 {
                continue;
            }
            if s.is_leaf() {
                for i in s.triangles() {
                    let t = self.triangles[i].map(|c| c.as_dvec3());
                    let (d2, weights) = nearest_on_triangle(p, t);
                    if d2 < best.0 {
                        best = (d2, i, weights);
                    }
                }
                continue;
            }
            let [near, far] = s.children().map(|c| (c, self.nodes[c.node].distance2(p)));
            let (near, far) = if near.1 <= far.1 { (near, far) } else { (far, near) };
            open[depth] = far;
            open[depth + 1] = near;
            depth += 2;
        }
        let (d2, i, weights) = best;
        let t = self.triangles.get(i)?.map(|c| c.as_dvec3());
        let point = t[0] * weights.x + t[1] * weights.y + t[2] * weights.z;
        let at = MeshPoint { face: self.faces[i], weights: weights.to_array() };
        Some(ClosestPoint { at, point, distance_mm: d2.sqrt() })
    }
}

/// Orders `items` into leaves and computes the boxes.
fn build(items: &mut [KeyedPoint], tree: &mut [Bounds], bounds: &(impl Fn(u32) -> Bounds + Sync)) {
    let n = items.len();
    if n <= LEAF {
        tree[0] = items.iter().fold(Bounds::NOTHING, |b, i| b.join(bounds(i.id())));
        return;
    }
    let m = left(n);
    let (near, far) = median_split::split(items, m);
    let (top, rest) = tree.split_at_mut(1);
    let (near_tree, far_tree) = rest.split_at_mut(nodes(m));
    if n > ALONE {
        checkpoint();
        rayon::join(|| build(near, near_tree, bounds), || build(far, far_tree, bounds));
    } else {
        build(near, near_tree, bounds);
        build(far, far_tree, bounds);
    }
    top[0] = near_tree[0].join(far_tree[0]);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers from −1 to 1 that look random.
    fn noise(seed: &mut u64) -> f64 {
        *seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (*seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn point(seed: &mut u64) -> DVec3 {
        DVec3::new(noise(seed), noise(seed), noise(seed))
    }

    fn soup(faces: u32, seed: &mut u64) -> Mesh {
        let positions = (0..3 * faces).map(|_| point(seed).as_vec3()).collect();
        let faces = (0..faces).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        Mesh { positions, faces, ..Mesh::default() }
    }

    #[test]
    fn nearest_point_equals_that_of_a_search_through_all_triangles() {
        let mut seed = 7;
        for faces in [1, 2, 4, 5, 9, 64, 333] {
            let mesh = soup(faces, &mut seed);
            let tree = TriangleBvh::new(&mesh);
            for _ in 0..200 {
                let p = 2.0 * point(&mut seed);
                let got = tree.closest(p).unwrap();
                let corners = |f: &[u32; 3]| f.map(|v| mesh.positions[v as usize].as_dvec3());
                let all = mesh.faces.iter().map(|f| nearest_on_triangle(p, corners(f)).0);
                let want = all.fold(f64::INFINITY, f64::min).sqrt();
                assert!((got.distance_mm - want).abs() < 1e-12, "{faces}: {got:?} {want}");
                assert!((got.point.distance(p) - want).abs() < 1e-12);
                let w = got.at.weights;
                assert!(w.iter().all(|w| *w >= 0.0) && (w.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                assert_eq!(tree.closest_within(p, want * 0.999), None);
                assert!((tree.distance(p, 0.5) - want.min(0.5)).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_mesh_without_faces_has_no_nearest_point() {
        let tree = TriangleBvh::new(&Mesh::default());
        assert_eq!((tree.closest(DVec3::ZERO), tree.distance(DVec3::ONE, 3.0)), (None, 3.0));
    }
}
