//! Simplification by edge contraction as published, the reference for [`super::simplify`].

use glam::DVec3;

use super::super::halfedge::{NONE, next, prev};
use super::super::heap::Heap;
use super::super::quadric::Quadric;
use super::super::star::Star;
use super::super::vertex_quadrics::quadrics;
use super::super::{HalfEdges, MeshError, Metric};
use crate::geometry::Mesh;

/// A 3 × 3 matrix whose determinant is less than this by its trace cubed is taken for singular.
const SINGULAR: f64 = 1e-9;

/// Simplifies a manifold mesh to this many faces after Garland and Heckbert 1997
/// (doi:10.1145/258734.258849): the cheapest edge contracts to the minimum of the sum of the
/// quadrics of its ends, found by a 3 × 3 solve, or to the best of its ends and its midpoint where
/// the matrix is singular. One heap entry an edge; planes are weighted by area. Positions in mm,
/// result without normals and caps.
///
/// Departures: no pairs that are not edges, so that the topology is kept; a contraction that turns
/// a face by 90° or more is not made (the published check for inversion).
///
/// # Errors
/// What [`HalfEdges::new`] refuses.
pub fn contract(mesh: &Mesh, faces: usize) -> Result<Mesh, MeshError> {
    let edges = HalfEdges::new(mesh)?;
    let (lo, hi) = mesh.bounds().unwrap_or_default();
    let centre = 0.5 * (lo + hi).as_dvec3();
    let at: Vec<DVec3> = mesh.positions.iter().map(|p| p.as_dvec3() - centre).collect();
    let all: Vec<u32> = (0..at.len() as u32).collect();
    let quadrics = quadrics(mesh, &edges, &|v| at[v as usize], (Metric::Qem, 0.0), &all);
    let mut this = Contract { heap: Heap::new(&[]), star: Star::default(), edges, at, quadrics };
    let costs: Vec<Option<f64>> = (0..4 * this.edges.face_count() as u32)
        .map(|h| (h & 3 < 3 && this.key(h) == h).then(|| this.best(h).0))
        .collect();
    this.heap = Heap::new(&costs);
    let mut left = mesh.faces.len();
    while left > faces {
        let Some(top) = this.heap.first().filter(|e| f64::from_bits(e.cost) < f64::INFINITY) else {
            break;
        };
        left -= this.contract(top.vertex);
    }
    Ok(this.compact(centre))
}

/// State of the contraction. An edge is named by the lower of its half-edges.
struct Contract {
    edges: HalfEdges,
    at: Vec<DVec3>,
    quadrics: Vec<Quadric>,
    heap: Heap,
    star: Star,
}

impl Contract {
    /// Name of the edge of `h`; `NONE` is above all.
    fn key(&self, h: u32) -> u32 {
        h.min(self.edges.pair(h))
    }

    /// Returns the cost of contracting the edge of `h`, and the position of the merged vertex.
    fn best(&self, h: u32) -> (f64, DVec3) {
        let ends = [self.edges.origin(h), self.edges.target(h)].map(|v| v as usize);
        let [a, b] = ends.map(|v| self.at[v]);
        let mut q = self.quadrics[ends[0]];
        q += self.quadrics[ends[1]];
        let middle = 0.5 * (a + b);
        let (slope, m) = q.slope(middle);
        let trace = m.x_axis.x + m.y_axis.y + m.z_axis.z;
        if m.determinant() > SINGULAR * trace * trace * trace {
            let p = middle - m.inverse() * slope;
            return (q.at(p), p);
        }
        let costs = [a, b, middle].map(|p| (q.at(p), p));
        costs.into_iter().min_by(|x, y| x.0.total_cmp(&y.0)).unwrap_or((q.at(a), a))
    }

    /// Contracts an edge, if that is legal, and returns the number of faces removed. Otherwise the
    /// edge's cost is infinite until something around it changes.
    fn contract(&mut self, h: u32) -> usize {
        let (_, p) = self.best(h);
        self.heap.set(h, f64::INFINITY);
        let (mut from, mut to) = (self.edges.origin(h), self.edges.target(h));
        if self.edges.on_boundary(from) {
            (from, to) = (to, from);
        }
        let at = &self.at;
        self.star.gather(&self.edges, from, |v| at[v as usize]);
        let Some(k) = self.star.ring.iter().position(|v| *v == to) else { return 0 };
        let ring = &self.star.ring;
        if !self.star.keeps_topology(&self.edges, k, |v| ring.contains(&v))
            || !self.keeps_sides(from, to, p)
            || !self.keeps_sides(to, from, p)
        {
            return 0;
        }
        // Two edges of each removed face become one, under the lower name.
        let mut gone = 0;
        for i in 0..self.star.leaving.len() {
            let h = self.star.leaving[i];
            let sides = if self.edges.target(h) == to {
                [next(h), prev(h)]
            } else if self.edges.origin(prev(h)) == to {
                [h, next(h)]
            } else {
                continue;
            };
            gone += 1;
            let outer = sides.map(|s| self.edges.pair(s));
            let name = outer[0].min(outer[1]);
            for old in sides.map(|s| self.key(s)).into_iter().filter(|k| *k != name) {
                self.heap.set(old, f64::INFINITY);
            }
        }
        self.edges.collapse(from, to, &self.star.leaving);
        let q = self.quadrics[from as usize];
        self.quadrics[to as usize] += q;
        self.at[to as usize] = p;
        self.renew(to);
        gone
    }

    /// Whether no face around `v`, but those with `other`, turns to its other side when `v` goes
    /// to `p`.
    fn keeps_sides(&self, v: u32, other: u32, p: DVec3) -> bool {
        let old = self.at[v as usize];
        self.edges.around(v).all(|h| {
            let (a, b) = (self.edges.target(h), self.edges.origin(prev(h)));
            let [x, y] = [a, b].map(|w| self.at[w as usize]);
            let (was, is) = ((x - old).cross(y - old), (x - p).cross(y - p));
            a == other || b == other || was == DVec3::ZERO || was.dot(is) > 0.0
        })
    }

    /// Brings the cost of every edge around `v` up to date.
    fn renew(&mut self, v: u32) {
        let first = self.edges.out(v);
        let mut h = first;
        loop {
            let (key, cost) = (self.key(h), self.best(h).0);
            self.heap.set(key, cost);
            let p = prev(h);
            h = self.edges.pair(p);
            if h == NONE {
                // The last edge of an open fan has no half-edge that leaves.
                let cost = self.best(p).0;
                self.heap.set(p, cost);
            }
            if h == NONE || h == first {
                break;
            }
        }
    }

    /// Returns the remaining mesh.
    fn compact(&self, centre: DVec3) -> Mesh {
        let mut new = vec![NONE; self.at.len()];
        let mut mesh = Mesh::default();
        for v in (0..self.at.len()).filter(|v| self.edges.out(*v as u32) != NONE) {
            new[v] = mesh.positions.len() as u32;
            mesh.positions.push((self.at[v] + centre).as_vec3());
        }
        let faces = (0..self.edges.face_count() as u32).filter_map(|f| self.edges.face(f));
        mesh.faces = faces.map(|f| f.map(|v| new[v as usize])).collect();
        mesh
    }
}
