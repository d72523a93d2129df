//! Faces of a wall that views see, by frustum, facing and ray tests on the triangle hierarchy.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::LARGE_FACE_MM2;
use crate::geometry::{Camera, Lens, Mesh, Pose, Subtree, TriangleBvh};
use crate::lod::{DepthMargin, ExteriorGrid, HierarchicalZ, ViewFrustum};
use crate::task::checkpoint;

/// Most triangles of the subtrees that threads take. Fixed, so that the work is divided the same
/// way whatever the number of threads.
const PORTION: usize = 2048;
/// Least number of triangles of a subtree that is tested for occlusion by the exterior.
const WALKED_TO: usize = 64;
/// Most rays that are traced together.
const LANES: usize = TriangleBvh::LANES;
/// Index that stands for no triangle.
const NONE: u32 = u32::MAX;

/// Faces of a wall that views have seen so far. Views may be added at any time; the result depends
/// on the set of them alone, not on their order, on how they were added or on the number of
/// threads.
pub struct CoverageMap<'a> {
    wall: &'a Mesh,
    tree: &'a TriangleBvh,
    exterior: Option<&'a ExteriorGrid>,
    /// Area of each face, mm²; a face of area 0 hides others and is never seen.
    areas: Vec<f32>,
    portions: Vec<Portion>,
    /// Whether each face was seen.
    seen: Vec<bool>,
    /// Area of the wall, mm², summed as the seen area of each portion is.
    area_mm2: f64,
}

impl<'a> CoverageMap<'a> {
    /// Creates the map of a wall of which nothing was seen yet.
    ///
    /// * `wall`: mesh in LPS mm, as for [`coverage`](super::coverage).
    /// * `tree`: hierarchy of the wall's triangles.
    /// * `exterior`: exterior of the wall, where it is closed. Saves time; the result does not
    ///   depend on it.
    pub fn new(wall: &'a Mesh, tree: &'a TriangleBvh, exterior: Option<&'a ExteriorGrid>) -> Self {
        let areas: Vec<f32> = (0..wall.faces.len()).map(|f| wall_area_mm2(wall, f)).collect();
        let portions: Vec<Portion> =
            portions(tree).into_iter().map(|s| Portion::new(tree, s, &areas)).collect();
        let area_of = |p: &Portion| -> f64 {
            p.subtree.triangles().map(|t| f64::from(areas[tree.face(t) as usize])).sum()
        };
        let area_mm2 = portions.iter().map(area_of).sum();
        let seen = vec![false; areas.len()];
        Self { wall, tree, exterior, areas, portions, seen, area_mm2 }
    }

    /// Returns the wall.
    pub fn wall(&self) -> &'a Mesh {
        self.wall
    }

    /// Adds the faces that views see: pose and lens of each.
    pub fn add(&mut self, views: &[(Pose, Lens)]) {
        let (tree, exterior) = (self.tree, self.exterior);
        let sight = |(pose, lens): &(Pose, Lens)| {
            checkpoint();
            Sight::new(*pose, *lens, exterior)
        };
        let views: Vec<Sight> = views.par_iter().map(sight).collect();
        self.portions.par_iter_mut().for_each(|portion| {
            for i in portion.nearest_first(tree, &views) {
                checkpoint();
                portion.look_below(tree, portion.subtree, &views[i]);
            }
        });
        // A few views change little of the wall.
        for portion in self.portions.iter_mut().filter(|p| p.has_changed) {
            (portion.has_changed, portion.seen_mm2) = (false, 0.0);
            for (i, place) in portion.subtree.triangles().enumerate() {
                let face = tree.face(place) as usize;
                self.seen[face] = portion.is_seen(i);
                if self.seen[face] {
                    portion.seen_mm2 += f64::from(self.areas[face]);
                }
            }
        }
    }

    /// Returns one flag a face of the wall: whether it was seen.
    pub fn seen(&self) -> &[bool] {
        &self.seen
    }

    /// Returns the share of the wall's area that was seen, 0 to 1; 0 of a wall without area.
    pub fn fraction(&self) -> f64 {
        let sum: f64 = self.portions.iter().map(|p| p.seen_mm2).sum();
        if self.area_mm2 > 0.0 { sum / self.area_mm2 } else { 0.0 }
    }

    /// Returns the wall and the area of each face that counts as wall, mm²; frees the rest.
    pub(super) fn into_areas(self) -> (&'a Mesh, Vec<f32>) {
        (self.wall, self.areas)
    }
}

/// Computes the area of a face that counts as wall, mm²; 0 for caps and where a vertex is not
/// finite.
fn wall_area_mm2(wall: &Mesh, face: usize) -> f32 {
    let [a, b, c] = wall.faces[face].map(|v| wall.positions[v as usize].as_dvec3());
    let area = (0.5 * (b - a).cross(c - a).length()) as f32;
    let cap = wall.caps.get(face).copied().unwrap_or(false);
    if cap || !area.is_finite() { 0.0 } else { area }
}

/// Returns subtrees of at most [`PORTION`] triangles that hold all of them, in the triangles'
/// order.
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

/// Returns the centre and half extent of a subtree's box, relative to an eye.
fn box_about(tree: &TriangleBvh, s: Subtree, eye: DVec3) -> (DVec3, DVec3) {
    let (lo, hi) = tree.bounds(s);
    let (lo, hi) = (lo.as_dvec3(), hi.as_dvec3());
    (0.5 * (lo + hi) - eye, 0.5 * (hi - lo))
}

/// One view.
struct Sight {
    eye: DVec3,
    frustum: ViewFrustum,
    /// Depths behind which the wall hides, where they are known and the eye is inside.
    depths: Option<HierarchicalZ>,
}

impl Sight {
    fn new(pose: Pose, lens: Lens, exterior: Option<&ExteriorGrid>) -> Self {
        let eye = pose.position_mm.as_dvec3();
        let frustum = ViewFrustum::new(&Camera { pose, lens, height_px: 1 });
        let exterior = exterior.filter(|e| e.is_interior(eye));
        let depths = exterior.map(|e| HierarchicalZ::new(&frustum, e, DepthMargin::default()));
        Self { eye, frustum, depths }
    }
}

/// One subtree and the samples of it that were seen so far.
struct Portion {
    subtree: Subtree,
    /// Samples seen, a bit each, of every triangle of the subtree.
    samples: Vec<u8>,
    /// Samples of each triangle: 0 where it does not count, 1 or 3.
    sample_counts: Vec<u8>,
    /// Nodes of the subtree whose triangles are all seen.
    done: Vec<bool>,
    /// Triangle that hid each triangle last, which it most often does from nearby eyes too.
    occluders: Vec<u32>,
    /// Triangle that hid a sample last, which most often hides neighbouring ones too.
    occluder: u32,
    /// Whether samples were seen since the flags of the faces were set.
    has_changed: bool,
    /// Area of the faces seen, mm².
    seen_mm2: f64,
}

impl Portion {
    fn new(tree: &TriangleBvh, subtree: Subtree, areas: &[f32]) -> Self {
        let sample_count = |face: u32| match areas[face as usize] {
            a if a > LARGE_FACE_MM2 => 3,
            a if a > 0.0 => 1,
            _ => 0,
        };
        let faces = subtree.triangles().map(|place| tree.face(place));
        Self {
            subtree,
            samples: vec![0; subtree.count],
            sample_counts: faces.map(sample_count).collect(),
            done: vec![false; subtree.nodes()],
            occluders: vec![NONE; subtree.count],
            occluder: NONE,
            has_changed: false,
            seen_mm2: 0.0,
        }
    }

    /// Returns indices of views, nearest to the subtree first: they see most of it, and faces
    /// already seen are not tested again.
    fn nearest_first(&self, tree: &TriangleBvh, views: &[Sight]) -> Vec<usize> {
        let distance2 = |view: &Sight| {
            let (centre, half) = box_about(tree, self.subtree, view.eye);
            (centre.abs() - half).max(DVec3::ZERO).length_squared()
        };
        let mut order: Vec<(f64, usize)> = views.iter().map(distance2).zip(0..).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        order.into_iter().map(|o| o.1).collect()
    }

    fn is_seen(&self, i: usize) -> bool {
        2 * self.samples[i].count_ones() > u32::from(self.sample_counts[i])
    }

    /// Adds the samples that one view sees of a subtree.
    fn look_below(&mut self, tree: &TriangleBvh, s: Subtree, view: &Sight) {
        let node = s.node - self.subtree.node;
        if self.done[node] {
            return;
        }
        let (centre, half) = box_about(tree, s, view.eye);
        if !view.frustum.intersects_box(centre, half) {
            return;
        }
        // Below that a walk takes longer than what it saves.
        if s.count >= WALKED_TO
            && view.depths.as_ref().is_some_and(|depths| depths.hides(centre, half))
        {
            return;
        }
        if s.is_leaf() {
            let first = s.first - self.subtree.first;
            let all = first..first + s.count;
            self.look_at(tree, all.clone(), view);
            self.done[node] = all.clone().all(|i| self.sample_counts[i] == 0 || self.is_seen(i));
            return;
        }
        let halves = s.children();
        halves.iter().for_each(|half| self.look_below(tree, *half, view));
        self.done[node] = halves.iter().all(|half| self.done[half.node - self.subtree.node]);
    }

    /// Adds the samples that one view sees of some triangles of a leaf.
    fn look_at(&mut self, tree: &TriangleBvh, triangles: Range<usize>, view: &Sight) {
        let mut rays: [(usize, u8, DVec3); LANES] = [(0, 0, DVec3::ZERO); LANES];
        let mut waiting = 0;
        for i in triangles {
            let count = self.sample_counts[i];
            if count == 0 || self.is_seen(i) {
                continue;
            }
            let triangle = self.subtree.first + i;
            let [a, b, c] = tree.corners_about(triangle, view.eye);
            // The right-hand normal points into the lumen; the eye is the origin here.
            if (b - a).cross(c - a).dot(a) >= 0.0 {
                continue;
            }
            let unseen = !self.samples[i];
            for k in (0..count).filter(|k| unseen >> k & 1 != 0) {
                let sample = match (count, k) {
                    (1, _) => (a + b + c) / 3.0,
                    (_, 0) => (4.0 * a + b + c) / 6.0,
                    (_, 1) => (a + 4.0 * b + c) / 6.0,
                    _ => (a + b + 4.0 * c) / 6.0,
                };
                if !view.frustum.contains(sample) {
                    continue;
                }
                let hides = |t: u32| {
                    t != NONE && t as usize != triangle && tree.meets(t as usize, view.eye, sample)
                };
                if hides(self.occluders[i]) {
                    continue;
                }
                if hides(self.occluder) {
                    self.occluders[i] = self.occluder;
                    continue;
                }
                rays[waiting] = (i, k, sample);
                waiting += 1;
                if waiting == LANES {
                    self.trace(tree, &rays, view.eye);
                    waiting = 0;
                }
            }
        }
        self.trace(tree, &rays[..waiting], view.eye);
    }

    /// Adds those samples that nothing hides from an eye.
    fn trace(&mut self, tree: &TriangleBvh, rays: &[(usize, u8, DVec3)], eye: DVec3) {
        if rays.is_empty() {
            return;
        }
        let mut segments = [(DVec3::ZERO, 0); LANES];
        for (segment, (i, _, sample)) in segments.iter_mut().zip(rays) {
            *segment = (*sample, self.subtree.first + i);
        }
        let found = tree.occluders(eye, &segments[..rays.len()]);
        for ((i, k, _), found) in rays.iter().zip(found) {
            match found {
                Some(t) => {
                    self.occluder = t as u32;
                    self.occluders[*i] = t as u32;
                }
                None => {
                    self.samples[*i] |= 1 << k;
                    self.has_changed = true;
                }
            }
        }
    }
}
