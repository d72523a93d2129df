//! The place on a mesh nearest to a point.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::OnMesh;
use super::placed::{self, Placed};
use crate::geometry::Mesh;

/// Triangles of a leaf.
const LEAF: usize = 4;
/// Triangles below which a subtree is built by one thread.
const ALONE: usize = 1 << 14;

/// The nearest place found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// Face and weights.
    pub at: OnMesh,
    /// Where that is, mm.
    pub point: DVec3,
    /// How far, mm.
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

    /// Squared distance to a point, mm²; 0 inside.
    #[inline]
    fn distance2(&self, p: DVec3) -> f64 {
        let d = (self.lo.as_dvec3() - p).max(p - self.hi.as_dvec3()).max(DVec3::ZERO);
        d.length_squared()
    }
}

/// Boxes in a tree over the triangles of a mesh, halved at the median of the longest side. Nodes
/// stand in the order of a walk, left part first, so that a node needs no more than its box: the
/// number of triangles below it says where its right part is. 24 bytes a node, half a node a face,
/// and 40 bytes a face.
pub struct Nearest {
    nodes: Vec<Bounds>,
    /// Corners, in the order of the leaves.
    triangles: Vec<[Vec3; 3]>,
    /// Face id of each triangle.
    faces: Vec<u32>,
}

/// Nodes of a subtree of `n` triangles.
fn nodes(n: usize) -> usize {
    2 * n.div_ceil(LEAF).max(1) - 1
}

/// Triangles in the left part of a subtree of `n`: whole leaves, half of them.
fn left(n: usize) -> usize {
    n.div_ceil(LEAF).div_ceil(2) * LEAF
}

impl Nearest {
    /// Builds the tree, O(F log F). The mesh's coordinates are finite and its indices in range;
    /// triangles without area are welcome.
    pub fn new(mesh: &Mesh) -> Self {
        let corners = |f: u32| mesh.faces[f as usize].map(|v| mesh.positions[v as usize]);
        let centre = |f: u32| Placed::new(corners(f).iter().sum(), f);
        let mut items: Vec<Placed> =
            (0..mesh.faces.len() as u32).into_par_iter().with_min_len(8192).map(centre).collect();
        let mut tree = vec![Bounds::NOTHING; if items.is_empty() { 0 } else { nodes(items.len()) }];
        if !items.is_empty() {
            build(&mut items, &mut tree, &|f| {
                let [a, b, c] = corners(f);
                Bounds { lo: a.min(b).min(c), hi: a.max(b).max(c) }
            });
        }
        let faces: Vec<u32> = items.iter().map(Placed::id).collect();
        let triangles = faces.par_iter().with_min_len(8192).map(|f| corners(*f)).collect();
        Self { nodes: tree, triangles, faces }
    }

    /// The place nearest to `p`, `None` on a mesh without faces. Of places equally near, the one on
    /// the face met first, which depends on nothing but the mesh and `p`.
    pub fn closest(&self, p: DVec3) -> Option<Closest> {
        self.closest_within(p, f64::INFINITY)
    }

    /// The place nearest to `p` if it is nearer than `limit_mm`.
    pub fn closest_within(&self, p: DVec3, limit_mm: f64) -> Option<Closest> {
        if self.faces.is_empty() {
            return None;
        }
        let mut best = (limit_mm * limit_mm, usize::MAX, DVec3::ZERO);
        // Node, its first triangle, how many, and how far its box is. Halving 2³⁰ faces is 28
        // levels deep, each of which leaves one part for later.
        let mut open = [(0usize, 0usize, 0usize, 0f64); 32];
        open[0] = (0, 0, self.faces.len(), self.nodes[0].distance2(p));
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (node, first, n, far2) = open[depth];
            if far2 >= best.0 {
                continue;
            }
            if n <= LEAF {
                for (i, t) in self.triangles[first..first + n].iter().enumerate() {
                    let (d2, weights) = nearest_on_triangle(p, t.map(|c| c.as_dvec3()));
                    if d2 < best.0 {
                        best = (d2, first + i, weights);
                    }
                }
                continue;
            }
            let m = left(n);
            let near = (node + 1, first, m, self.nodes[node + 1].distance2(p));
            let right = node + 1 + nodes(m);
            let far = (right, first + m, n - m, self.nodes[right].distance2(p));
            let (near, far) = if near.3 <= far.3 { (near, far) } else { (far, near) };
            open[depth] = far;
            open[depth + 1] = near;
            depth += 2;
        }
        let (d2, i, weights) = best;
        let t = self.triangles.get(i)?.map(|c| c.as_dvec3());
        let point = t[0] * weights.x + t[1] * weights.y + t[2] * weights.z;
        let at = OnMesh { face: self.faces[i], weights: weights.to_array() };
        Some(Closest { at, point, distance_mm: d2.sqrt() })
    }
}

/// Orders `items` into leaves and fills in the boxes.
fn build(items: &mut [Placed], tree: &mut [Bounds], bounds: &(impl Fn(u32) -> Bounds + Sync)) {
    let n = items.len();
    if n <= LEAF {
        tree[0] = items.iter().fold(Bounds::NOTHING, |b, i| b.join(bounds(i.id())));
        return;
    }
    let m = left(n);
    let (near, far) = placed::part(items, m);
    let (top, rest) = tree.split_at_mut(1);
    let (near_tree, far_tree) = rest.split_at_mut(nodes(m));
    if n > ALONE {
        rayon::join(|| build(near, near_tree, bounds), || build(far, far_tree, bounds));
    } else {
        build(near, near_tree, bounds);
        build(far, far_tree, bounds);
    }
    top[0] = near_tree[0].join(far_tree[0]);
}

/// Squared distance from `p` to a triangle and the weights of the nearest place, by the regions
/// of its corners and edges (Ericson 2005, Real-Time Collision Detection, 5.1.5). A triangle
/// without area answers with a place on one of its edges.
fn nearest_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> (f64, DVec3) {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let longest2 = ab.length_squared().max(ac.length_squared());
    if ab.cross(ac).length_squared() <= 1e-24 * longest2 * longest2 {
        return nearest_on_sides(p, [a, b, c]);
    }
    let weights = 'found: {
        let (d1, d2) = (ab.dot(ap), ac.dot(ap));
        if d1 <= 0.0 && d2 <= 0.0 {
            break 'found DVec3::X;
        }
        let bp = p - b;
        let (d3, d4) = (ab.dot(bp), ac.dot(bp));
        if d3 >= 0.0 && d4 <= d3 {
            break 'found DVec3::Y;
        }
        let cp = p - c;
        let (d5, d6) = (ab.dot(cp), ac.dot(cp));
        if d6 >= 0.0 && d5 <= d6 {
            break 'found DVec3::Z;
        }
        let vc = d1 * d4 - d3 * d2;
        if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            let t = d1 / (d1 - d3);
            break 'found DVec3::new(1.0 - t, t, 0.0);
        }
        let vb = d5 * d2 - d1 * d6;
        if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            let t = d2 / (d2 - d6);
            break 'found DVec3::new(1.0 - t, 0.0, t);
        }
        let va = d3 * d6 - d5 * d4;
        if va <= 0.0 && d4 >= d3 && d5 >= d6 {
            let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
            break 'found DVec3::new(0.0, 1.0 - t, t);
        }
        let sum = va + vb + vc;
        DVec3::new(va / sum, vb / sum, vc / sum)
    };
    let on = a * weights.x + b * weights.y + c * weights.z;
    (p.distance_squared(on), weights)
}

/// The same for a triangle without area: the nearest place on its sides.
fn nearest_on_sides(p: DVec3, corners: [DVec3; 3]) -> (f64, DVec3) {
    let mut best = (f64::INFINITY, DVec3::X);
    for i in 0..3 {
        let j = (i + 1) % 3;
        let (a, along) = (corners[i], corners[j] - corners[i]);
        let length2 = along.length_squared();
        let t = if length2 > 0.0 { (along.dot(p - a) / length2).clamp(0.0, 1.0) } else { 0.0 };
        let d2 = p.distance_squared(a + t * along);
        if d2 < best.0 {
            best = (d2, DVec3::AXES[i] * (1.0 - t) + DVec3::AXES[j] * t);
        }
    }
    best
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
    fn the_tree_finds_what_a_search_through_all_triangles_finds() {
        let mut seed = 7;
        for faces in [1, 2, 4, 5, 9, 64, 333] {
            let mesh = soup(faces, &mut seed);
            let tree = Nearest::new(&mesh);
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
            }
        }
    }

    #[test]
    fn no_point_of_a_fine_lattice_on_the_triangle_is_nearer() {
        let mut seed = 3;
        for _ in 0..300 {
            let t = [point(&mut seed), point(&mut seed), point(&mut seed)];
            let p = 2.0 * point(&mut seed);
            let got = nearest_on_triangle(p, t).0;
            for i in 0..=20 {
                for j in 0..=20 - i {
                    let (u, v) = (f64::from(i) / 20.0, f64::from(j) / 20.0);
                    let q = t[0] * (1.0 - u - v) + t[1] * u + t[2] * v;
                    assert!(got <= p.distance_squared(q) + 1e-12);
                }
            }
        }
    }

    #[test]
    fn triangles_shrunk_to_a_line_or_a_point_answer_with_finite_weights() {
        let (a, b) = (DVec3::ZERO, DVec3::X);
        for t in [[a, a, a], [a, b, b], [a, a, b], [a, b, a], [a, b, 0.5 * b], [a, 0.5 * b, b]] {
            let (d2, w) = nearest_on_triangle(DVec3::new(0.25, 2.0, 0.0), t);
            assert!(w.is_finite() && (4.0..4.1).contains(&d2), "{t:?}: {d2} {w}");
        }
    }

    #[test]
    fn a_mesh_without_faces_has_no_nearest_place() {
        assert_eq!(Nearest::new(&Mesh::default()).closest(DVec3::ZERO), None);
    }
}
