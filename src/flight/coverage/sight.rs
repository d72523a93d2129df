//! Which faces of a wall views see: frustum, facing and ray tests on a tree of boxes.

use glam::{DVec3, Vec3, Vec3A};
use rayon::prelude::*;

use super::LARGE_FACE_MM2;
use super::exterior::Exterior;
use crate::geometry::{Lens, Mesh, Pose};

/// Triangles of a leaf.
const LEAF: usize = 4;
/// Triangles of the subtrees that threads take. Fixed, so that the work is cut the same way
/// whatever the number of threads.
const PORTION: usize = 2048;
/// Subtrees of fewer triangles are not asked whether cells outside hide them.
const WALKED_TO: usize = 64;
/// A segment from the eye ends this share short of the sample: coincident faces do not hide each
/// other.
const SEGMENT_END: f64 = 1.0 - 1e-6;
/// Barycentric slack of a triangle's edges, so that no segment passes between two faces.
const EDGE_SLACK: f64 = 1e-9;
/// Share by which a box's far end is put off: more than three roundings of single numbers.
const SLAB_SLACK: f32 = 1e-6;

/// Faces that the forward views see, and those that forward or backward views see.
///
/// * `areas`: mm², one a face; a face of area 0 hides others and is never seen.
pub(super) fn seen_faces(
    wall: &Mesh,
    areas: &[f64],
    forward: &[(Pose, Lens)],
    backward: &[(Pose, Lens)],
) -> (Vec<bool>, Vec<bool>) {
    let (tree, exterior) = rayon::join(|| Tree::new(wall), || Exterior::new(wall));
    let frusta = |views: &[(Pose, Lens)]| -> Vec<Frustum<'_>> {
        let exterior = exterior.as_ref();
        views.iter().map(|(pose, lens)| Frustum::new(*pose, *lens, exterior)).collect()
    };
    let (forward, backward) = (frusta(forward), frusta(backward));
    let portions: Vec<(Subtree, [Vec<bool>; 2])> = tree
        .portions()
        .into_par_iter()
        .map(|subtree| {
            let mut portion = Portion::new(&tree, subtree, areas);
            let both = [&forward, &backward].map(|frusta| {
                frusta.iter().for_each(|frustum| portion.look_below(subtree, frustum));
                portion.seen()
            });
            (subtree, both)
        })
        .collect();
    let mut one_way = vec![false; wall.faces.len()];
    let mut both_ways = one_way.clone();
    for (subtree, [one, both]) in &portions {
        for (i, f) in tree.faces[subtree.first..][..subtree.count].iter().enumerate() {
            one_way[*f as usize] = one[i];
            both_ways[*f as usize] = both[i];
        }
    }
    (one_way, both_ways)
}

/// What one view can see: planes in front of which it lies, from the eye.
struct Frustum<'a> {
    eye: DVec3,
    /// Cells outside the wall, where they are known and the eye is inside.
    exterior: Option<&'a Exterior>,
    /// Inward normals of the four sides; all planes pass through the eye.
    sides: [DVec3; 4],
    forward: DVec3,
    near_mm: f64,
}

impl<'a> Frustum<'a> {
    fn new(pose: Pose, lens: Lens, exterior: Option<&'a Exterior>) -> Self {
        let eye = pose.position_mm.as_dvec3();
        let rotation = pose.rotation.as_dquat().normalize();
        let y = (0.5 * f64::from(lens.fov_y_rad)).tan();
        let x = y * f64::from(lens.aspect);
        // The camera looks along -z: a place is inside where |x| <= -z tan and |y| <= -z tan.
        let sides = [
            DVec3::new(1.0, 0.0, -x),
            DVec3::new(-1.0, 0.0, -x),
            DVec3::new(0.0, 1.0, -y),
            DVec3::new(0.0, -1.0, -y),
        ];
        Self {
            eye,
            exterior: exterior.filter(|e| e.holds(eye)),
            sides: sides.map(|n| rotation * n),
            forward: rotation * DVec3::NEG_Z,
            near_mm: f64::from(lens.near_mm),
        }
    }

    /// Whether a place, relative to the eye, is inside.
    fn contains(&self, p: DVec3) -> bool {
        self.forward.dot(p) >= self.near_mm && self.sides.iter().all(|n| n.dot(p) >= 0.0)
    }

    /// Whether a box, relative to the eye, lies outside one of the planes.
    fn misses(&self, centre: DVec3, half: DVec3) -> bool {
        let reach = |n: DVec3| n.dot(centre) + n.abs().dot(half);
        reach(self.forward) < self.near_mm || self.sides.iter().any(|n| reach(*n) < 0.0)
    }
}

/// A box by its corners.
#[derive(Clone, Copy)]
struct Bounds {
    lo: Vec3,
    hi: Vec3,
}

impl Bounds {
    const EMPTY: Self = Self { lo: Vec3::INFINITY, hi: Vec3::NEG_INFINITY };

    /// Centre and half extent, relative to an eye.
    fn about(&self, eye: DVec3) -> (DVec3, DVec3) {
        let (lo, hi) = (self.lo.as_dvec3(), self.hi.as_dvec3());
        (0.5 * (lo + hi) - eye, 0.5 * (hi - lo))
    }

    /// Where on a segment the box begins, in lengths of the segment; infinite where they do not
    /// meet before its end. Single precision, with slack enough that it never parts what meets.
    #[inline]
    fn enter(&self, from: Vec3A, inverse: Vec3A) -> f32 {
        let a = (Vec3A::from(self.lo) - from) * inverse;
        let b = (Vec3A::from(self.hi) - from) * inverse;
        let near = a.min(b).max_element().max(0.0);
        let far = a.max(b).min_element() * (1.0 + SLAB_SLACK);
        if near <= far.min(1.0) { near } else { f32::INFINITY }
    }
}

/// A node of the tree with the triangles below it: `count` from `first` on.
#[derive(Clone, Copy)]
struct Subtree {
    node: usize,
    first: usize,
    count: usize,
}

impl Subtree {
    /// Nodes of a subtree of `count` triangles.
    fn nodes(count: usize) -> usize {
        2 * count.div_ceil(LEAF).max(1) - 1
    }

    /// The two halves: whole leaves, as many on either side.
    fn halves(self) -> [Self; 2] {
        let left = self.count.div_ceil(LEAF).div_ceil(2) * LEAF;
        let right = self.node + 1 + Self::nodes(left);
        [
            Self { node: self.node + 1, first: self.first, count: left },
            Self { node: right, first: self.first + left, count: self.count - left },
        ]
    }

    fn is_leaf(self) -> bool {
        self.count <= LEAF
    }
}

/// Boxes over the triangles of a wall, halved at the median of the longest side; nodes in the order
/// of a walk, left part first.
struct Tree {
    nodes: Vec<Bounds>,
    /// Corners, in the order of the leaves.
    triangles: Vec<[Vec3; 3]>,
    /// Face of each triangle.
    faces: Vec<u32>,
}

impl Tree {
    /// Leaves out faces with a vertex that is not finite.
    fn new(wall: &Mesh) -> Self {
        let corners = |f: u32| wall.faces[f as usize].map(|v| wall.positions[v as usize]);
        let mut items: Vec<(Vec3, u32)> = (0..wall.faces.len() as u32)
            .map(|f| (corners(f).iter().sum::<Vec3>() / 3.0, f))
            .filter(|(centre, _)| centre.is_finite())
            .collect();
        let mut nodes = vec![Bounds::EMPTY; Subtree::nodes(items.len())];
        let all = Subtree { node: 0, first: 0, count: items.len() };
        build(&mut items, &mut nodes, all, &|f| {
            let [a, b, c] = corners(f);
            Bounds { lo: a.min(b).min(c), hi: a.max(b).max(c) }
        });
        let faces: Vec<u32> = items.iter().map(|i| i.1).collect();
        Self { nodes, triangles: faces.iter().map(|f| corners(*f)).collect(), faces }
    }

    /// Subtrees of at most [`PORTION`] triangles that hold all of them, in the triangles' order.
    fn portions(&self) -> Vec<Subtree> {
        let mut open = vec![Subtree { node: 0, first: 0, count: self.faces.len() }];
        let mut out = Vec::new();
        while let Some(s) = open.pop() {
            if s.count <= PORTION {
                out.push(s);
            } else {
                let [left, right] = s.halves();
                open.extend([right, left]);
            }
        }
        out
    }

    /// A triangle's corners relative to a place.
    fn corners_about(&self, triangle: usize, from: DVec3) -> [DVec3; 3] {
        self.triangles[triangle].map(|p| p.as_dvec3() - from)
    }

    /// A triangle that meets the segment from an eye to a sample, not `own`: the first one found
    /// from the eye on.
    fn hit(&self, eye: DVec3, along: DVec3, own: usize) -> Option<usize> {
        // Eyes are single numbers. A component of 0 would give NaN in planes through the eye.
        let from = eye.as_vec3a();
        let inverse = along.map(|d| if d.abs() < 1e-30 { 1e30 } else { 1.0 / d }).as_vec3a();
        let mut open = [Subtree { node: 0, first: 0, count: 0 }; 64];
        open[0].count = self.faces.len();
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let s = open[depth];
            if s.is_leaf() {
                let mut all = s.first..s.first + s.count;
                let found = all.find(|t| *t != own && self.meets(*t, eye, along));
                if found.is_some() {
                    return found;
                }
                continue;
            }
            let [left, right] = s.halves();
            let enter = |s: Subtree| self.nodes[s.node].enter(from, inverse);
            let (a, b) = (enter(left), enter(right));
            let ((near, first), (far, second)) =
                if a <= b { ((left, a), (right, b)) } else { ((right, b), (left, a)) };
            for (s, enter) in [(far, second), (near, first)] {
                if enter.is_finite() {
                    open[depth] = s;
                    depth += 1;
                }
            }
        }
        None
    }

    /// Whether a triangle meets the segment from an eye along `along` before its end (Möller and
    /// Trumbore 1997, Fast, minimum storage ray-triangle intersection,
    /// doi:10.1080/10867651.1997.10487468).
    fn meets(&self, triangle: usize, eye: DVec3, along: DVec3) -> bool {
        let [a, b, c] = self.corners_about(triangle, eye);
        let (e, f) = (b - a, c - a);
        let p = along.cross(f);
        let det = e.dot(p);
        if det == 0.0 {
            return false;
        }
        let u = -a.dot(p) / det;
        let q = -a.cross(e);
        let v = along.dot(q) / det;
        let t = f.dot(q) / det;
        u >= -EDGE_SLACK
            && v >= -EDGE_SLACK
            && u + v <= 1.0 + EDGE_SLACK
            && t > 0.0
            && t < SEGMENT_END
    }
}

/// Orders `items` into leaves and fills in the boxes.
fn build(
    items: &mut [(Vec3, u32)],
    nodes: &mut [Bounds],
    subtree: Subtree,
    bounds: &(impl Fn(u32) -> Bounds + Sync),
) {
    let join = |a: Bounds, b: Bounds| Bounds { lo: a.lo.min(b.lo), hi: a.hi.max(b.hi) };
    if subtree.is_leaf() {
        nodes[0] = items.iter().fold(Bounds::EMPTY, |all, i| join(all, bounds(i.1)));
        return;
    }
    let (lo, hi) = items
        .iter()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), i| (lo.min(i.0), hi.max(i.0)));
    let axis = (hi - lo).max_position();
    let [left, right] = subtree.halves();
    items.select_nth_unstable_by(left.count, |a, b| {
        a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1))
    });
    let (top, rest) = nodes.split_at_mut(1);
    let (left_nodes, right_nodes) = rest.split_at_mut(Subtree::nodes(left.count));
    let (left_items, right_items) = items.split_at_mut(left.count);
    rayon::join(
        || build(left_items, left_nodes, left, bounds),
        || build(right_items, right_nodes, right, bounds),
    );
    top[0] = join(left_nodes[0], right_nodes[0]);
}

/// One subtree and what was seen of it so far.
struct Portion<'a> {
    tree: &'a Tree,
    subtree: Subtree,
    /// Samples seen, a bit each, of every triangle of the subtree.
    samples: Vec<u8>,
    /// Samples of each triangle: 0 where it does not count, 1 or 3.
    sample_counts: Vec<u8>,
    /// Nodes of the subtree whose triangles are all seen.
    done: Vec<bool>,
    /// The triangle that hid a sample last: it hides neighbouring ones as well, most often.
    occluder: Option<usize>,
}

impl<'a> Portion<'a> {
    fn new(tree: &'a Tree, subtree: Subtree, areas: &[f64]) -> Self {
        let sample_count = |face: &u32| match areas[*face as usize] {
            a if a > LARGE_FACE_MM2 => 3,
            a if a > 0.0 => 1,
            _ => 0,
        };
        let faces = &tree.faces[subtree.first..][..subtree.count];
        Self {
            tree,
            subtree,
            samples: vec![0; subtree.count],
            sample_counts: faces.iter().map(sample_count).collect(),
            done: vec![false; Subtree::nodes(subtree.count)],
            occluder: None,
        }
    }

    fn is_seen(&self, i: usize) -> bool {
        2 * self.samples[i].count_ones() > u32::from(self.sample_counts[i])
    }

    fn seen(&self) -> Vec<bool> {
        (0..self.samples.len()).map(|i| self.is_seen(i)).collect()
    }

    /// Adds what one view sees of a subtree.
    fn look_below(&mut self, s: Subtree, frustum: &Frustum<'_>) {
        let node = s.node - self.subtree.node;
        if self.done[node] {
            return;
        }
        let (centre, half) = self.tree.nodes[s.node].about(frustum.eye);
        if frustum.misses(centre, half) {
            return;
        }
        // Below that a walk takes longer than what it saves.
        if s.count >= WALKED_TO
            && frustum.exterior.is_some_and(|e| e.hides(frustum.eye, centre, half))
        {
            return;
        }
        if s.is_leaf() {
            let first = s.first - self.subtree.first;
            let all = first..first + s.count;
            all.clone().for_each(|i| self.look_at(i, frustum));
            self.done[node] = all.clone().all(|i| self.sample_counts[i] == 0 || self.is_seen(i));
            return;
        }
        let halves = s.halves();
        halves.iter().for_each(|half| self.look_below(*half, frustum));
        self.done[node] = halves.iter().all(|half| self.done[half.node - self.subtree.node]);
    }

    fn look_at(&mut self, i: usize, frustum: &Frustum<'_>) {
        let count = self.sample_counts[i];
        if count == 0 || self.is_seen(i) {
            return;
        }
        let triangle = self.subtree.first + i;
        let [a, b, c] = self.tree.corners_about(triangle, frustum.eye);
        // The right-hand normal points into the lumen; the eye is the origin here.
        if (b - a).cross(c - a).dot(a) >= 0.0 {
            return;
        }
        let unseen = !self.samples[i];
        for k in (0..count).filter(|k| unseen >> k & 1 != 0) {
            let sample = match (count, k) {
                (1, _) => (a + b + c) / 3.0,
                (_, 0) => (4.0 * a + b + c) / 6.0,
                (_, 1) => (a + 4.0 * b + c) / 6.0,
                _ => (a + b + 4.0 * c) / 6.0,
            };
            if !frustum.contains(sample) {
                continue;
            }
            let hides = |t: usize| t != triangle && self.tree.meets(t, frustum.eye, sample);
            if self.occluder.is_some_and(hides) {
                continue;
            }
            match self.tree.hit(frustum.eye, sample, triangle) {
                Some(t) => self.occluder = Some(t),
                None => self.samples[i] |= 1 << k,
            }
        }
    }
}
