//! Samples of one patch, and how far its levels are from the original.
//!
//! The error of a level is the larger of two measured distances: from the vertices of the original
//! that the parameterization puts in the patch to the nearest of the level's triangles about the
//! same place, and from the centres and the middles of the edges of the level's triangles to the
//! nearest point of the original.
//! A tenth is added for what lies between these points.

use glam::{DVec3, Vec3};

use super::base_mesh::BaseMesh;
use super::forest::{FACE_STEPS, PatchNode};
use super::original::Original;
use super::scheme::Scheme;
use super::template::{GridPoint, LEVELS, PatchShape, SPLITS};
use crate::fault;
use crate::geometry::{Cone, Sphere, Vertex, point_triangle_distance};
use crate::lod::octree::{Item, bounding_cone};

/// Safety factor for deviations between the measured points.
const BETWEEN: f64 = 1.1;

/// Bounds of a patch, by which a camera judges it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchBounds {
    /// Two-sided distance to the original by level, mm, not less than that of any finer level;
    /// infinite for levels that are not drawn.
    pub error_mm: [f32; LEVELS],
    /// Root mean square of the angle between the normals of the original's vertices and the
    /// interpolated ones there, by level, radians.
    pub angle_rad: [f32; LEVELS],
    /// Longest edge of each level, mm.
    pub edge_mm: [f32; LEVELS],
    /// Bounding sphere of the patch at every level and of the original there.
    pub sphere: Sphere,
    /// Half extent of a box about the centre of the sphere around the same, mm.
    pub half: Vec3,
    /// Cone that contains the normals of the triangles of every level.
    pub cone: Cone,
}

/// A vertex of the original, and its barycentric coordinates in a patch.
#[derive(Clone, Copy, Debug)]
pub struct OriginalPoint {
    pub weights: [f64; 3],
    pub vertex: Vertex,
}

impl OriginalPoint {
    /// The child of the patch that it lies in, and the point there.
    pub fn in_child(&self) -> (u32, Self) {
        let (child, weights) = in_child(self.weights);
        (child, Self { weights, ..*self })
    }
}

/// The child of a triangle split 1-to-4 in which a point with barycentric weights lies, and its
/// weights there. Child 3 is the middle one, turned round.
pub fn in_child(w: [f64; 3]) -> (u32, [f64; 3]) {
    let double = |c: usize| [0, 1, 2].map(|k| 2.0 * w[k] - f64::from(u8::from(k == c)));
    match w.iter().position(|w| *w >= 0.5) {
        Some(c) => (c as u32, double(c)),
        None => (3, w.map(|w| 1.0 - 2.0 * w)),
    }
}

/// Lowest level at which a patch is drawn: below, the one above it is.
pub fn lowest_level(depth: u32) -> u32 {
    if depth == 0 { 0 } else { SPLITS - 1 }
}

/// Sampler of the original: points on corners and edges of the base give the same bits for every
/// face.
pub struct PatchSampler<'a> {
    base: &'a BaseMesh,
    original: &'a dyn Original,
    shape: &'static PatchShape,
    /// First face and corner at each vertex.
    corners: Vec<(u32, usize)>,
}

impl<'a> PatchSampler<'a> {
    pub fn new(base: &'a BaseMesh, original: &'a dyn Original, scheme: Scheme) -> Self {
        let mut corners = vec![(u32::MAX, 0); base.vertices];
        for (f, face) in base.faces.iter().enumerate().rev() {
            for (c, v) in face.iter().enumerate() {
                corners[*v as usize] = (f as u32, c);
            }
        }
        Self { base, original, shape: PatchShape::of(scheme), corners }
    }

    pub fn shape(&self) -> &'static PatchShape {
        self.shape
    }

    /// The original at a grid point of a face: the same bits from every face that it lies in.
    fn at(&self, face: u32, g: GridPoint) -> Vertex {
        let n = FACE_STEPS;
        let (mut f, mut p) = (face, g);
        if let Some(c) = g.iter().position(|c| *c == n) {
            let own = self.corners[self.base.faces[face as usize][c] as usize];
            (f, p) = (own.0, [0; 3]);
            p[own.1] = n;
        } else if let Some(zero) = g.iter().position(|c| *c == 0) {
            let e = (zero + 1) % 3;
            let id = self.base.face_edges[face as usize][e];
            let edge = self.base.edges[id as usize >> 1];
            let along = if id & 1 == 0 { g[(e + 1) % 3] } else { g[e] };
            let c = edge.corner as usize;
            (f, p) = (edge.faces[0], [0; 3]);
            (p[c], p[(c + 1) % 3]) = (n - along, along);
        }
        self.original.at(f, p.map(|c| f64::from(c) / f64::from(n)))
    }

    /// Takes the samples of a patch.
    pub fn samples(&self, node: &PatchNode) -> Vec<Vertex> {
        let steps = self.shape.steps;
        let points = self.shape.points.iter();
        points.map(|p| self.at(node.face, node.place(p.at, steps))).collect()
    }

    /// Measures a patch with these samples; `inside` are the vertices of the original in it.
    pub fn measure(&self, depth: u32, samples: &[Vertex], inside: &[OriginalPoint]) -> PatchBounds {
        let positions: Vec<Vec3> = samples.iter().map(Vertex::position).collect();
        let mut error_mm = [f32::INFINITY; LEVELS];
        let (mut angle_rad, mut edge_mm) = ([0.0; LEVELS], [0.0; LEVELS]);
        for level in lowest_level(depth)..=self.shape.finest() {
            let cells = cells(self.shape, level, samples);
            let mut error = BETWEEN * self.distance(level, &cells, samples, inside);
            if fault::hit(fault::Point::ErrorBound) {
                error *= 0.125;
            }
            let l = level as usize;
            // Rounded up.
            error_mm[l] = (error * (1.0 + 1e-6)) as f32;
            angle_rad[l] = angle(&cells, inside) as f32;
            edge_mm[l] = cells.iter().map(Cell::longest_mm).fold(0.0, f64::max) as f32;
        }
        let lo = positions.iter().fold(Vec3::INFINITY, |a, p| a.min(*p));
        let hi = positions.iter().fold(Vec3::NEG_INFINITY, |a, p| a.max(*p));
        let centre = 0.5 * (lo + hi);
        let reach = positions.iter().map(|p| p.distance(centre)).fold(0.0, f32::max);
        let finest_mm = error_mm[self.shape.finest() as usize];
        let sphere = Sphere { centre, radius: reach * (1.0 + 1e-6) + finest_mm };
        let half = 0.5 * (hi - lo) * (1.0 + 1e-6) + finest_mm;
        let cone = cone(self.shape, lowest_level(depth), &positions);
        PatchBounds { error_mm, angle_rad, edge_mm, sphere, half, cone }
    }

    fn distance(
        &self,
        level: u32,
        cells: &[Cell],
        samples: &[Vertex],
        inside: &[OriginalPoint],
    ) -> f64 {
        let to_level = |p: &OriginalPoint| {
            let x = p.vertex.position().as_dvec3();
            let about = cells.iter().filter(|c| c.is_about(p));
            about.map(|c| point_triangle_distance(x, c.corners)).fold(f64::INFINITY, f64::min)
        };
        let there = inside.iter().map(to_level).fold(0.0, f64::max);
        self.farthest(level, cells, samples, there)
    }

    /// The largest distance of the level's triangles from the original, at their centres and at the
    /// middles of their edges, or `least` if none is larger.
    fn farthest(&self, level: u32, cells: &[Cell], samples: &[Vertex], least: f64) -> f64 {
        let mut worst = least;
        for cell in cells {
            let [p, q, r] = cell.corners;
            worst = worst.max(self.original.distance_mm((p + q + r) / 3.0));
        }
        let at = |i: u32| samples[i as usize].position().as_dvec3();
        for edge in self.shape.edges(level) {
            let middle = 0.5 * (at(edge.ends[0]) + at(edge.ends[1]));
            // Samples of the original are most often near enough.
            let known = edge.middle.filter(|_| self.original.is_sampled()).map(at);
            if known.is_none_or(|x| x.distance(middle) > worst) {
                worst = worst.max(self.original.distance_mm(middle));
            }
        }
        worst
    }
}

/// A triangle of a level.
struct Cell {
    /// Barycentric coordinates of its corners in the patch.
    grid: [DVec3; 3],
    corners: [DVec3; 3],
    normals: [DVec3; 3],
}

/// Places are about a triangle up to this many times the distance of its corners from its centre,
/// by coordinate: so it is for 1.4 times the side of triangles on a grid.
const ABOUT: f64 = 2.1;

impl Cell {
    /// Whether the place of a point is in the triangle or in one that touches it.
    fn is_about(&self, p: &OriginalPoint) -> bool {
        let at = DVec3::from(p.weights).clamp(DVec3::ZERO, DVec3::ONE);
        let centre = self.grid.iter().sum::<DVec3>() / 3.0;
        let away = |p: DVec3| (p - centre).abs().max_element();
        away(at) < ABOUT * self.grid.map(away).into_iter().fold(0.0, f64::max)
    }

    fn longest_mm(&self) -> f64 {
        let [p, q, r] = self.corners;
        p.distance(q).max(q.distance(r)).max(r.distance(p))
    }

    /// The interpolated normal, of any length, at the place of a point, if that is in the triangle.
    fn normal_at(&self, p: &OriginalPoint) -> Option<DVec3> {
        let at = DVec3::from(p.weights);
        let [a, b, c] = self.grid;
        let area = |p: DVec3, q: DVec3| {
            (p.truncate() - at.truncate()).perp_dot(q.truncate() - at.truncate())
        };
        let weights = [area(b, c), area(c, a), area(a, b)];
        let least = -1e-9 * weights.iter().sum::<f64>();
        let is_inside = weights.iter().all(|w| *w >= least);
        is_inside.then(|| self.normals.iter().zip(weights).map(|(n, w)| *n * w).sum())
    }
}

fn cells(shape: &PatchShape, level: u32, samples: &[Vertex]) -> Vec<Cell> {
    let steps = f64::from(shape.steps);
    let one = |t: [usize; 3]| Cell {
        grid: t.map(|i| DVec3::from(shape.points[i].at.map(f64::from)) / steps),
        corners: t.map(|i| samples[i].position().as_dvec3()),
        normals: t.map(|i| samples[i].normal().as_dvec3()),
    };
    shape.faces(shape.template(level, 0)).map(one).collect()
}

/// Root mean square angle of normals at the vertices of the original.
fn angle(cells: &[Cell], inside: &[OriginalPoint]) -> f64 {
    let square = |p: &OriginalPoint| {
        let normal = cells.iter().find_map(|c| c.normal_at(p))?;
        let own = p.vertex.normal().as_dvec3();
        Some(normal.cross(own).length().atan2(normal.dot(own)).powi(2))
    };
    let sum: f64 = inside.iter().filter_map(square).sum();
    (sum / inside.len().max(1) as f64).sqrt()
}

/// Cone of the triangles of all templates from a level on. Those of geomorphs have their corners
/// between these samples; their normals are not included.
fn cone(shape: &PatchShape, lowest: u32, positions: &[Vec3]) -> Cone {
    let mut cones = Vec::new();
    for (level, sides) in (lowest..=shape.finest()).flat_map(|l| [(l, 0), (l, 7)]) {
        for t in shape.faces(shape.template(level, sides)) {
            let cone = Item::triangle(t.map(|i| positions[i])).cone;
            // Degenerate triangles have no normal and are not visible.
            if cone.sine < 1.0 {
                cones.push(cone);
            }
        }
    }
    bounding_cone(cones.iter().copied())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_keeps_its_place_in_the_child_that_contains_it() {
        let mut seed = 9u64;
        let mut noise = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 40) as f64 / (1u64 << 24) as f64
        };
        let corners = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let middle = |p: [f64; 3], q: [f64; 3]| [0, 1, 2].map(|k| 0.5 * (p[k] + q[k]));
        let [a, b, c] = corners;
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        let children = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]];
        for _ in 0..1000 {
            let (u, v) = (noise(), noise());
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let weights = [u, v, 1.0 - u - v];
            let (child, p) = OriginalPoint { weights, vertex: Vertex::default() }.in_child();
            assert!(p.weights.iter().all(|w| *w >= -1e-12));
            for k in 0..3 {
                let own = &children[child as usize];
                let sum: f64 = (0..3).map(|c| p.weights[c] * own[c][k]).sum();
                assert!((sum - weights[k]).abs() < 1e-12);
            }
        }
    }
}
