//! The cheapest legal collapse, again and again.

use std::mem::take;

use glam::DVec3;
use rayon::prelude::*;

use super::halfedge::{NONE, face, next, prev};
use super::heap::{Entry, Heap};
use super::quadric::Quadric;
use super::relocate::better_place;
use super::star::Star;
use super::start::{Freedom, PARCEL, freedoms, on_rim, quadrics};
use super::{Collapse, HalfEdges, Metric, Recorder, SimplifyOptions, Stopped};
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
    moves: bool,
    centre: DVec3,
    places: Vec<Place>,
    /// Normals that faces are held against; none where only quadrics count.
    normals: Vec<glam::Vec3>,
    quadrics: Vec<Quadric>,
    freedom: Vec<Freedom>,
    heap: Heap,
    /// The last turn in which a vertex was in the ring of the vertex at hand.
    seen: Vec<u32>,
    turn: u32,
    star: Star,
    /// Neighbours of the star that it may go to, cheapest first.
    targets: Vec<Target>,
    rings: Rings,
}

/// A neighbour that a vertex may go to.
struct Target {
    /// By the quadrics alone.
    cost: f64,
    id: u32,
    /// Its place in the ring.
    k: usize,
}

/// The target chosen.
struct Best {
    k: usize,
    /// By the quadrics alone.
    cost: f64,
    /// With what the faces deviate.
    dear: f64,
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
            moves: options.relocate,
            centre,
            places,
            normals: match options.metric {
                Metric::NormalQem => mesh.normals.clone(),
                Metric::Qem | Metric::Paper => Vec::new(),
            },
            quadrics,
            freedom,
            heap: Heap::new(&[]),
            seen: vec![0; vertices],
            turn: 0,
            star: Star::default(),
            targets: Vec::new(),
            rings: Rings::default(),
            edges,
        };
        if this.faces > options.faces {
            let costs: Vec<Option<f64>> = (0..vertices as u32)
                .into_par_iter()
                .with_min_len(PARCEL)
                .map_init(Default::default, |(star, targets), v| this.first_cost(v, star, targets))
                .collect();
            this.heap = Heap::new(&costs);
        }
        this
    }

    /// Collapses until `stop` says so or nothing can go.
    pub fn run(&mut self, stop: &Stop, recorder: &mut dyn Recorder) -> Stopped {
        let mut too_far = false;
        while self.faces > stop.faces {
            let Some(top) = self.heap.first() else {
                return if too_far { Stopped::MaxError } else { Stopped::NoLegalCollapse };
            };
            self.look_at(top.vertex);
            loop {
                let Some(Best { k, dear, cost }) = self.best_target(stop, &mut too_far) else {
                    self.heap.pop();
                    break;
                };
                if (Entry { cost: dear.to_bits(), vertex: top.vertex }) > top {
                    // Dearer than it seemed: others may come first now.
                    self.heap.set(top.vertex, dear);
                    break;
                }
                if self.is_legal(k) && self.agreed(k, recorder) {
                    self.error_mm = self.error_mm.max(self.error_mm_at(k, cost));
                    self.collapse(k, cost);
                    break;
                }
                self.targets.retain(|t| t.k != k);
            }
        }
        Stopped::Reached
    }

    /// Where a vertex is, mm.
    pub fn position(&self, v: u32) -> DVec3 {
        self.places[v as usize].at * self.mm + self.centre
    }

    /// Whether a vertex is free to move.
    pub fn may_move(&self, v: u32) -> bool {
        self.freedom[v as usize] == Freedom::Free
    }

    /// Moves `v` to where its quadric is less, if it may move.
    fn relocate(&mut self, v: u32) {
        if !self.may_move(v) {
            return;
        }
        let (places, q) = (&self.places, &self.quadrics[v as usize]);
        if let Some(at) = better_place(&self.edges, v, q, |w| places[w as usize].at) {
            self.places[v as usize] = Place { at, cost: q.at(at) };
        }
    }

    /// Moves all vertices that took others over once more, now that nothing changes around them.
    pub fn relocate_all(&mut self) {
        for v in 0..self.edges.vertex_count() as u32 {
            // One that stands for itself alone costs nothing where it is.
            if self.edges.out(v) != NONE && self.places[v as usize].cost > 0.0 {
                self.relocate(v);
            }
        }
    }

    /// Cost of the cheapest target of `v`, legal or not, without what its faces deviate: less than
    /// it will cost.
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

    /// Cost of the cheapest target of `v` with what its faces deviate, before anything went. Asked
    /// for in the order of vertices and by many threads, which is cheaper than in that of the heap:
    /// most of a look is waiting for memory.
    fn first_cost(&self, v: u32, star: &mut Star, targets: &mut Vec<Target>) -> Option<f64> {
        if self.exact() || self.freedom[v as usize] == Freedom::Locked {
            return self.cheapest(v);
        }
        self.gather(v, star, targets);
        let mut best = f64::INFINITY;
        for t in targets.iter() {
            if t.cost >= best {
                break;
            }
            best = star.deviation(t.k, best - t.cost).map_or(best, |d| best.min(t.cost + d));
        }
        (best < f64::INFINITY).then_some(best)
    }

    /// Fills star and targets for `v`, and marks its ring as seen.
    fn look_at(&mut self, v: u32) {
        let (mut star, mut targets) = (take(&mut self.star), take(&mut self.targets));
        self.gather(v, &mut star, &mut targets);
        (self.star, self.targets) = (star, targets);
        self.turn += 1;
        for w in &self.star.ring {
            self.seen[*w as usize] = self.turn;
        }
    }

    /// Fills star and targets for `v`.
    #[inline]
    fn gather(&self, v: u32, star: &mut Star, targets: &mut Vec<Target>) {
        star.gather(&self.edges, v, |w| self.places[w as usize].at, &self.normals);
        let rim = self.freedom[v as usize] == Freedom::Rim;
        targets.clear();
        let q = &self.quadrics[v as usize];
        for (k, (w, at)) in star.ring.iter().zip(&star.at).enumerate() {
            if !rim || star.leaving.get(k).is_none_or(|h| on_rim(&self.edges, *h)) {
                let cost = q.at(*at) + self.places[*w as usize].cost;
                targets.push(Target { cost, id: *w, k });
            }
        }
        targets.sort_unstable_by(|a, b| a.cost.total_cmp(&b.cost).then(a.id.cmp(&b.id)));
    }

    /// The target that costs least, with what its faces deviate, by cost, then by id; faces keep
    /// their shape, but whether it is legal is looked at last, for that is dear.
    fn best_target(&self, stop: &Stop, too_far: &mut bool) -> Option<Best> {
        let mut best: Option<Best> = None;
        for &Target { cost, k, .. } in &self.targets {
            let limit = best.as_ref().map_or(f64::INFINITY, |b| b.dear - cost);
            if limit <= 0.0 {
                break;
            }
            let Some(deviation) = self.star.deviation(k, limit) else { continue };
            if stop.max_error_mm.is_some_and(|most| self.error_mm_at(k, cost) > most) {
                *too_far = true;
                continue;
            }
            best = Some(Best { k, cost, dear: cost + deviation });
        }
        best
    }

    /// Root mean square distance of the target to the planes of both, mm.
    fn error_mm_at(&self, k: usize, cost: f64) -> f64 {
        let weight = |v: u32| self.quadrics[v as usize].weight;
        let sum = weight(self.star.centre) + weight(self.star.ring[k]);
        if sum > 0.0 { (cost / sum).sqrt() * self.mm } else { 0.0 }
    }

    /// Whether the mesh stays of its kind.
    fn is_legal(&self, k: usize) -> bool {
        let in_ring = |v: u32| self.seen[v as usize] == self.turn;
        self.star.keeps_kind(&self.edges, k, in_ring)
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
    fn agreed(&mut self, k: usize, recorder: &mut dyn Recorder) -> bool {
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
        let (places, mm, centre) = (&self.places, self.mm, self.centre);
        recorder.record(&collapse, &|v| places[v as usize].at * mm + centre)
    }

    /// Collapses the star onto `ring[k]` and brings the costs around up to date.
    fn collapse(&mut self, k: usize, cost: f64) {
        let (from, to) = (self.star.centre, self.star.ring[k]);
        self.heap.pop();
        self.edges.collapse(from, to, &self.star.leaving);
        self.faces -= if self.star.open { 1 } else { 2 };
        self.collapses += 1;
        let q = self.quadrics[from as usize];
        self.quadrics[to as usize] += q;
        self.places[to as usize].cost = cost;
        if self.moves {
            self.relocate(to);
        }
        if let Some(cost) = self.cheapest(to) {
            // Where faces count, what was known before is the better lower bound.
            let known = self.heap.cost(to).map_or(0.0, f64::from_bits);
            self.heap.set(to, if self.exact() { cost } else { cost.max(known) });
        }
        let first = self.edges.out(to);
        let mut h = first;
        loop {
            self.offer(self.edges.target(h), to, h);
            let p = prev(h);
            h = self.edges.pair(p);
            if h == NONE {
                self.offer(self.edges.origin(p), to, p);
                break;
            }
            if h == first {
                break;
            }
        }
    }

    /// Whether a cost is one of quadrics alone, known exactly before a star is looked at.
    fn exact(&self) -> bool {
        self.normals.is_empty()
    }

    /// Tells a neighbour of a target that has changed, along edge `h`. One for which nothing was
    /// legal gets another chance. For the others the target may be nearer now than what they had,
    /// if it is new to them or has moved; all else has only become dearer, so that what the heap
    /// has stays a lower bound. Where faces count too, quadrics alone say less than the heap
    /// already knows: those neighbours are met when their old cost comes up. Telling them at once
    /// costs a third more time, and gains nothing that could be measured.
    #[inline]
    fn offer(&mut self, v: u32, to: u32, h: u32) {
        let freedom = self.freedom[v as usize];
        let cost = match self.heap.cost(v) {
            _ if freedom == Freedom::Locked => None,
            None => self.cheapest(v),
            Some(old) if self.exact() && (freedom == Freedom::Free || on_rim(&self.edges, h)) => {
                Some(self.cost(&self.quadrics[v as usize], to)).filter(|c| c.to_bits() < old)
            }
            Some(_) => None,
        };
        if let Some(cost) = cost {
            self.heap.set(v, cost);
        }
    }
}
