//! Which faces of a wall views see: frustum, facing and ray tests on the triangle hierarchy.

use glam::DVec3;
use rayon::prelude::*;

use super::{LARGE_FACE_MM2, closed::is_closed};
use crate::geometry::{ExteriorGrid, Lens, Mesh, Pose, Subtree, TriangleBvh};
use crate::task::checkpoint;

/// Triangles of the subtrees that threads take. Fixed, so that the work is cut the same way
/// whatever the number of threads.
const PORTION: usize = 2048;
/// Subtrees of fewer triangles are not asked whether cells outside hide them.
const WALKED_TO: usize = 64;
/// Grid cells a face, about, and most cells.
const CELLS_PER_FACE: f64 = 1.0;
const MAX_CELLS: usize = 1 << 25;
/// No triangle.
const NONE: u32 = u32::MAX;

/// Faces that the forward views see, and those that forward or backward views see.
///
/// * `areas`: mm², one a face; a face of area 0 hides others and is never seen.
pub(super) fn seen_faces(
    wall: &Mesh,
    areas: &[f64],
    forward: &[(Pose, Lens)],
    backward: &[(Pose, Lens)],
) -> (Vec<bool>, Vec<bool>) {
    let (tree, exterior) = rayon::join(|| TriangleBvh::new(wall), || exterior(wall));
    let frusta = |views: &[(Pose, Lens)]| -> Vec<Frustum<'_>> {
        let exterior = exterior.as_ref();
        views.iter().map(|(pose, lens)| Frustum::new(*pose, *lens, exterior)).collect()
    };
    let (forward, backward) = (frusta(forward), frusta(backward));
    let portions: Vec<(Subtree, [Vec<bool>; 2])> = portions(&tree)
        .into_par_iter()
        .map(|subtree| {
            let mut portion = Portion::new(&tree, subtree, areas);
            let both = [&forward, &backward].map(|frusta| {
                portion.nearest_first(frusta).into_iter().map(|i| &frusta[i]).for_each(|frustum| {
                    checkpoint();
                    portion.look_below(subtree, frustum);
                });
                portion.seen()
            });
            (subtree, both)
        })
        .collect();
    let mut one_way = vec![false; wall.faces.len()];
    let mut both_ways = one_way.clone();
    for (subtree, [one, both]) in &portions {
        for (i, place) in subtree.triangles().enumerate() {
            let face = tree.face(place) as usize;
            (one_way[face], both_ways[face]) = (one[i], both[i]);
        }
    }
    (one_way, both_ways)
}

/// Cells outside the wall; `None` of a wall that is not closed, or that has a vertex that is not
/// finite: what is outside is not known then.
fn exterior(wall: &Mesh) -> Option<ExteriorGrid> {
    let known = wall.positions.iter().all(|p| p.is_finite()) && is_closed(wall);
    let cells = CELLS_PER_FACE * wall.faces.len() as f64;
    known.then(|| ExteriorGrid::new(wall, (cells as usize).clamp(64, MAX_CELLS)))
}

/// Subtrees of at most [`PORTION`] triangles that hold all of them, in the triangles' order.
fn portions(tree: &TriangleBvh) -> Vec<Subtree> {
    let mut open = vec![tree.root()];
    let mut out = Vec::new();
    while let Some(s) = open.pop() {
        if s.count > PORTION {
            let [left, right] = s.children();
            open.extend([right, left]);
        } else if s.count > 0 {
            out.push(s);
        }
    }
    out
}

/// Centre and half extent of a subtree's box, relative to an eye.
fn box_about(tree: &TriangleBvh, s: Subtree, eye: DVec3) -> (DVec3, DVec3) {
    let (lo, hi) = tree.bounds(s);
    let (lo, hi) = (lo.as_dvec3(), hi.as_dvec3());
    (0.5 * (lo + hi) - eye, 0.5 * (hi - lo))
}

/// What one view can see: planes in front of which it lies, from the eye.
struct Frustum<'a> {
    eye: DVec3,
    /// Cells outside the wall, where they are known and the eye is inside.
    exterior: Option<&'a ExteriorGrid>,
    /// Inward normals of the four sides; all planes pass through the eye.
    sides: [DVec3; 4],
    forward: DVec3,
    near_mm: f64,
}

impl<'a> Frustum<'a> {
    fn new(pose: Pose, lens: Lens, exterior: Option<&'a ExteriorGrid>) -> Self {
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
            exterior: exterior.filter(|e| e.is_interior(eye)),
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

/// One subtree and what was seen of it so far.
struct Portion<'a> {
    tree: &'a TriangleBvh,
    subtree: Subtree,
    /// Samples seen, a bit each, of every triangle of the subtree.
    samples: Vec<u8>,
    /// Samples of each triangle: 0 where it does not count, 1 or 3.
    sample_counts: Vec<u8>,
    /// Nodes of the subtree whose triangles are all seen.
    done: Vec<bool>,
    /// The triangle that hid each triangle last: from eyes close by it still does, most often.
    occluders: Vec<u32>,
    /// The triangle that hid a sample last: it hides neighbouring ones as well, most often.
    occluder: u32,
}

impl<'a> Portion<'a> {
    fn new(tree: &'a TriangleBvh, subtree: Subtree, areas: &[f64]) -> Self {
        let sample_count = |face: u32| match areas[face as usize] {
            a if a > LARGE_FACE_MM2 => 3,
            a if a > 0.0 => 1,
            _ => 0,
        };
        let faces = subtree.triangles().map(|place| tree.face(place));
        Self {
            tree,
            subtree,
            samples: vec![0; subtree.count],
            sample_counts: faces.map(sample_count).collect(),
            done: vec![false; subtree.nodes()],
            occluders: vec![NONE; subtree.count],
            occluder: NONE,
        }
    }

    /// Indices of views, nearest to the subtree first: they see most of it, and what is seen is not
    /// looked at again.
    fn nearest_first(&self, frusta: &[Frustum<'_>]) -> Vec<usize> {
        let distance2 = |f: &Frustum<'_>| {
            let (centre, half) = box_about(self.tree, self.subtree, f.eye);
            (centre.abs() - half).max(DVec3::ZERO).length_squared()
        };
        let mut order: Vec<(f64, usize)> = frusta.iter().map(distance2).zip(0..).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        order.into_iter().map(|o| o.1).collect()
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
        let (centre, half) = box_about(self.tree, s, frustum.eye);
        if frustum.misses(centre, half) {
            return;
        }
        // Below that a walk takes longer than what it saves.
        if s.count >= WALKED_TO
            && frustum.exterior.is_some_and(|e| {
                e.hides(frustum.eye, frustum.eye + centre, half.max_element(), 0.0)
            })
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
        let halves = s.children();
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
            let hides = |t: u32| {
                t != NONE
                    && t as usize != triangle
                    && self.tree.meets(t as usize, frustum.eye, sample)
            };
            if hides(self.occluders[i]) {
                continue;
            }
            if hides(self.occluder) {
                self.occluders[i] = self.occluder;
                continue;
            }
            match self.tree.occluder(frustum.eye, sample, triangle) {
                Some(t) => {
                    self.occluder = t as u32;
                    self.occluders[i] = t as u32;
                }
                None => self.samples[i] |= 1 << k,
            }
        }
    }
}
