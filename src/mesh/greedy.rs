//! The cheapest legal collapse, again and again.

use glam::DVec3;
use rayon::prelude::*;

use super::halfedge::{face, next, prev};
use super::heap::{Entry, Heap};
use super::quadric::Quadric;
use super::star::Star;
use super::start::{Freedom, PARCEL, freedoms, on_rim, quadrics};
use super::{Collapse, HalfEdges, Recorder, SimplifyOptions, Stopped};
use crate::geometry::Mesh;

/// When to end.
pub struct Stop {
    /// At so many faces.
    pub faces: usize,
    /// Before a collapse that errs more, mm.
    pub max_error_mm: Option<f64>,
}

/// Where a vertex is and what it costs there.
#[derive(Clone, Copy)]
struct Place {
    at: DVec3,
    /// Its own quadric there.
    cost: f64,
}

/// A mesh on its way down. Positions are centred and scaled to a box of side 1.
pub struct Greedy {
    /// What is left.
    pub edges: HalfEdges,
    /// Collapses made.
    pub collapses: usize,
    /// Largest error of a collapse made, mm.
    pub error_mm: f64,
    faces: usize,
    mm: f64,
    places: Vec<Place>,
    quadrics: Vec<Quadric>,
    freedom: Vec<Freedom>,
    heap: Heap,
    /// The last turn in which a vertex was in the ring of the vertex at hand.
    seen: Vec<u32>,
    turn: u32,
    star: Star,
    /// Cost of each neighbour of the star as a target, none where it is out of the question.
    costs: Vec<Option<f64>>,
    rings: Rings,
}

/// A star as a recorder wants it.
#[derive(Default)]
struct Rings {
    ring: Vec<u32>,
    faces: Vec<u32>,
}

impl Greedy {
    /// Takes a mesh over. O(V + F).
    pub fn new(mesh: &Mesh, mut edges: HalfEdges, options: &SimplifyOptions<'_>) -> Self {
        for (f, cap) in mesh.caps.iter().enumerate() {
            edges.set_mark(f as u32, u32::from(*cap));
        }
        let (lo, hi) = mesh.bounds().unwrap_or_default();
        let (lo, hi) = (lo.as_dvec3(), hi.as_dvec3());
        let centre = 0.5 * (lo + hi);
        let side = (hi - lo).max_element();
        let mm = if side > 0.0 { side } else { 1.0 };
        let place = |p: &glam::Vec3| Place { at: (p.as_dvec3() - centre) / mm, cost: 0.0 };
        let places: Vec<Place> =
            mesh.positions.par_iter().with_min_len(PARCEL).map(place).collect();
        let at = |v: u32| places[v as usize].at;
        let quadrics = quadrics(mesh, &edges, &at, options.metric);
        let freedom = freedoms(&edges, options.locked);
        let vertices = edges.vertex_count();
        let mut this = Self {
            faces: mesh.faces.len(),
            collapses: 0,
            error_mm: 0.0,
            mm,
            places,
            quadrics,
            freedom,
            heap: Heap::new(&[]),
            seen: vec![0; vertices],
            turn: 0,
            star: Star::default(),
            costs: Vec::new(),
            rings: Rings::default(),
            edges,
        };
        if this.faces > options.faces {
            let costs: Vec<Option<f64>> = (0..vertices as u32)
                .into_par_iter()
                .with_min_len(PARCEL)
                .map(|v| this.cheapest(v))
                .collect();
            this.heap = Heap::new(&costs);
        }
        this
    }

    /// Collapses until `stop` says so or nothing can go.
    pub fn run(
        &mut self,
        stop: &Stop,
        recorder: &mut dyn Recorder,
        position: &dyn Fn(u32) -> DVec3,
    ) -> Stopped {
        let mut too_far = false;
        while self.faces > stop.faces {
            let Some(top) = self.heap.first() else {
                return if too_far { Stopped::MaxError } else { Stopped::NoLegalCollapse };
            };
            self.look_at(top.vertex);
            loop {
                let Some((k, cost)) = self.next_target() else {
                    self.heap.pop();
                    break;
                };
                if (Entry { cost: cost.to_bits(), vertex: top.vertex }) > top {
                    // Dearer than it seemed: others may come first now.
                    self.heap.set(top.vertex, cost);
                    break;
                }
                let error_mm = self.error_mm(k, cost);
                let near = stop.max_error_mm.is_none_or(|most| error_mm <= most);
                if self.is_legal(k) {
                    if near && self.agreed(k, recorder, position) {
                        self.collapse(k, cost);
                        self.error_mm = self.error_mm.max(error_mm);
                        break;
                    }
                    too_far |= !near;
                }
                self.costs[k] = None;
            }
        }
        Stopped::Reached
    }

    /// Cost of the cheapest target of `v`, legal or not.
    fn cheapest(&self, v: u32) -> Option<f64> {
        let freedom = self.freedom[v as usize];
        if freedom == Freedom::Locked {
            return None;
        }
        let q = &self.quadrics[v as usize];
        let mut least = f64::INFINITY;
        let mut last = 0;
        for h in self.edges.around(v) {
            if freedom == Freedom::Free || on_rim(&self.edges, h) {
                least = least.min(self.cost(q, self.edges.target(h)));
            }
            last = h;
        }
        if self.edges.on_boundary(v) {
            least = least.min(self.cost(q, self.edges.origin(prev(last))));
        }
        (least < f64::INFINITY).then_some(least)
    }

    /// Cost of a vertex with quadric `q` at `to`.
    #[inline]
    fn cost(&self, q: &Quadric, to: u32) -> f64 {
        let to = &self.places[to as usize];
        q.at(to.at) + to.cost
    }

    /// Fills star and costs for `v`, and marks its ring as seen.
    fn look_at(&mut self, v: u32) {
        let places = &self.places;
        self.star.gather(&self.edges, v, |w| places[w as usize].at);
        self.turn += 1;
        for w in &self.star.ring {
            self.seen[*w as usize] = self.turn;
        }
        let rim = self.freedom[v as usize] == Freedom::Rim;
        self.costs.clear();
        let q = &self.quadrics[v as usize];
        for (i, (w, at)) in self.star.ring.iter().zip(&self.star.at).enumerate() {
            let along = !rim || self.star.leaving.get(i).is_none_or(|h| on_rim(&self.edges, *h));
            self.costs.push(along.then(|| q.at(*at) + self.places[*w as usize].cost));
        }
    }

    /// The cheapest target left, by cost and then by id.
    fn next_target(&self) -> Option<(usize, f64)> {
        let ring = &self.star.ring;
        let mut best: Option<(usize, f64)> = None;
        for (i, cost) in self.costs.iter().enumerate() {
            if let Some(c) = *cost {
                if best.is_none_or(|(j, b)| c < b || c == b && ring[i] < ring[j]) {
                    best = Some((i, c));
                }
            }
        }
        best
    }

    /// Root mean square distance of the target to the planes of both, mm.
    fn error_mm(&self, k: usize, cost: f64) -> f64 {
        let weight = |v: u32| self.quadrics[v as usize].weight;
        let sum = weight(self.star.centre) + weight(self.star.ring[k]);
        if sum > 0.0 { (cost / sum).sqrt() * self.mm } else { 0.0 }
    }

    fn is_legal(&self, k: usize) -> bool {
        let from = self.places[self.star.centre as usize].at;
        let in_ring = |v: u32| self.seen[v as usize] == self.turn;
        self.star.keeps_shape(k, from)
            && self.star.keeps_kind(&self.edges, k, in_ring)
            && (self.freedom[self.star.centre as usize] == Freedom::Free || self.keeps_cap(k))
    }

    /// Whether no cap, and no wall between caps, loses its last face.
    fn keeps_cap(&self, k: usize) -> bool {
        let to = self.star.ring[k];
        self.star.leaving.iter().all(|&h| {
            let goes = self.edges.target(h) == to || self.edges.origin(prev(h)) == to;
            let sides = [h, next(h), prev(h)];
            !goes || sides.iter().any(|h| !on_rim(&self.edges, *h))
        })
    }

    /// Asks the recorder.
    fn agreed(
        &mut self,
        k: usize,
        recorder: &mut dyn Recorder,
        position: &dyn Fn(u32) -> DVec3,
    ) -> bool {
        let (star, rings) = (&self.star, &mut self.rings);
        // A ring without ends begins at the target.
        let turn = if star.open { 0 } else { k };
        let rotated = |list: &[u32], into: &mut Vec<u32>, of: fn(u32) -> u32| {
            into.clear();
            into.extend(list[turn..].iter().chain(&list[..turn]).map(|v| of(*v)));
        };
        rotated(&star.ring, &mut rings.ring, |v| v);
        rotated(&star.leaving, &mut rings.faces, face);
        let collapse = Collapse {
            from: star.centre,
            to: star.ring[k],
            ring: &rings.ring,
            faces: &rings.faces,
            boundary: star.open,
        };
        recorder.record(&collapse, position)
    }

    /// Collapses the star onto `ring[k]` and brings the costs around up to date.
    fn collapse(&mut self, k: usize, cost: f64) {
        let (from, to) = (self.star.centre, self.star.ring[k]);
        let n = self.star.ring.len();
        self.heap.pop();
        self.edges.collapse(from, to, &self.star.leaving);
        self.faces -= if self.star.open { 1 } else { 2 };
        self.collapses += 1;
        let q = self.quadrics[from as usize];
        self.quadrics[to as usize] += q;
        self.places[to as usize].cost = cost;
        // Neighbours that are new to the target may find it cheaper than what they had. All other
        // costs have only grown: what the heap has is a lower bound.
        for i in 0..n {
            let w = self.star.ring[i];
            let beside = i.abs_diff(k) == 1 || !self.star.open && i.abs_diff(k) == n - 1;
            if i == k || beside || self.freedom[w as usize] != Freedom::Free {
                continue;
            }
            let cost = self.cost(&self.quadrics[w as usize], to);
            if self.heap.cost(w).is_some_and(|old| cost.to_bits() < old) {
                self.heap.set(w, cost);
            }
        }
        // The target's own, and those of neighbours for which nothing was legal.
        let mut h = self.edges.out(to);
        let first = h;
        if let Some(cost) = self.cheapest(to) {
            self.heap.set(to, cost);
        }
        loop {
            self.wake(self.edges.target(h));
            let p = prev(h);
            h = self.edges.pair(p);
            if h == super::halfedge::NONE {
                self.wake(self.edges.origin(p));
                break;
            }
            if h == first {
                break;
            }
        }
    }

    /// Puts a vertex back into the heap if it is not there.
    fn wake(&mut self, v: u32) {
        if self.freedom[v as usize] != Freedom::Locked && self.heap.cost(v).is_none() {
            if let Some(cost) = self.cheapest(v) {
                self.heap.set(v, cost);
            }
        }
    }
}
