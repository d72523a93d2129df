//! Decimation: the cheapest legal half-edge collapse, repeated.

use glam::{DVec3, Vec3};

use super::halfedge::{NONE, face, next, prev};
use super::heap::{Heap, HeapEntry};
use super::input::Input;
use super::quadric::Quadric;
use super::relocate::better_place;
use super::star::Star;
use super::vertex_quadrics::{Freedom, on_rim};
use super::{Collapse, HalfEdges, Log, Metric, StopReason};

/// Conditions that end a decimation.
#[derive(Clone, Copy)]
pub struct Stop {
    /// Number of faces to reach.
    pub faces: usize,
    /// Highest cost of a collapse, as the bits of the number.
    pub most: u64,
    /// Largest error of a collapse, mm.
    pub max_error_mm: Option<f64>,
}

/// Position of a vertex, and the value of its quadric at that point.
#[derive(Clone, Copy)]
pub struct Placement {
    at: DVec3,
    /// Value of the quadric.
    cost: f64,
}

/// The part of the input mesh that a run works on.
pub struct SubMesh {
    /// Input ids of its vertices, ascending.
    pub vertex_ids: Vec<u32>,
    /// Input ids of its faces, ascending.
    pub face_ids: Vec<u32>,
}

/// State of the decimation of a mesh, or of a part of one.
pub struct Decimation {
    /// Connectivity of the remaining mesh.
    pub edges: HalfEdges,
    /// Number of collapses made.
    pub collapses: usize,
    /// Largest error of a collapse made, mm.
    pub error_mm: f64,
    piece: SubMesh,
    faces: usize,
    mm: f64,
    moves: bool,
    places: Vec<Placement>,
    /// Vertex normals that new faces are compared with; empty where only quadrics count.
    normals: Vec<Vec3>,
    quadrics: Vec<Quadric>,
    freedom: Vec<Freedom>,
    heap: Heap,
    /// The target of each vertex that its cost in the heap belongs to; `NONE` where its
    /// neighbourhood has changed since, and that cost is a lower bound.
    choice: Vec<u32>,
    /// The last turn in which a vertex was in the ring of the current star.
    seen: Vec<u32>,
    turn: u32,
    star: Star,
    /// Neighbours that the centre of the star may collapse onto, cheapest first.
    targets: Vec<CollapseTarget>,
    rings: StarBuffers,
}

/// A neighbour that a vertex may collapse onto.
struct CollapseTarget {
    /// Cost by the quadrics alone.
    cost: f64,
    id: u32,
    /// Index of the neighbour in the ring.
    k: usize,
}

/// The cheapest target.
struct Best {
    k: usize,
    /// Cost by the quadrics alone.
    cost: f64,
    /// Cost with the deviation of the faces' normals.
    total: f64,
}

/// Buffers of a star as a recorder receives it.
#[derive(Default)]
struct StarBuffers {
    ring: Vec<u32>,
    faces: Vec<u32>,
    at: Vec<DVec3>,
}

impl Decimation {
    /// Starts with a part of the input. O(V + F).
    pub fn new(input: &Input<'_>, piece: SubMesh, edges: HalfEdges, freedom: Vec<Freedom>) -> Self {
        let ids = &piece.vertex_ids;
        let places = input.of_each(ids, |v| Placement { at: input.at(v), cost: 0.0 });
        let quadrics = input.quadrics(ids);
        Self::with(input, piece, edges, freedom, (places, quadrics), true)
    }

    /// Starts with what other runs left: for each vertex its position and quadric, or `None` for one
    /// that they were not allowed to change.
    pub fn resume(
        input: &Input<'_>,
        piece: SubMesh,
        edges: HalfEdges,
        known: Vec<Option<(Placement, Quadric)>>,
    ) -> Self {
        let ids = &piece.vertex_ids;
        let new: Vec<u32> =
            ids.iter().zip(&known).filter(|(_, k)| k.is_none()).map(|(v, _)| *v).collect();
        let new = input.quadrics(&new);
        let mut new = new.into_iter();
        let begin = |v: u32| Placement { at: input.at(v), cost: 0.0 };
        let know = |(v, known): (&u32, Option<(Placement, Quadric)>)| {
            known.unwrap_or_else(|| (begin(*v), new.next().unwrap_or_default()))
        };
        let state = ids.iter().zip(known).map(know).unzip();
        let freedom = ids.iter().map(|v| input.freedom[*v as usize]).collect();
        Self::with(input, piece, edges, freedom, state, false)
    }

    fn with(
        input: &Input<'_>,
        piece: SubMesh,
        edges: HalfEdges,
        freedom: Vec<Freedom>,
        (places, quadrics): (Vec<Placement>, Vec<Quadric>),
        fresh: bool,
    ) -> Self {
        let vertices = piece.vertex_ids.len();
        let normals = match input.metric {
            Metric::NormalQem if !input.mesh.normals.is_empty() => {
                input.of_each(&piece.vertex_ids, |v| input.mesh.normals[v as usize])
            }
            _ => Vec::new(),
        };
        let mut this = Self {
            edges,
            collapses: 0,
            error_mm: 0.0,
            faces: piece.face_ids.len(),
            piece,
            mm: input.mm,
            moves: input.moves,
            places,
            normals,
            quadrics,
            freedom,
            heap: Heap::new(&[]),
            choice: vec![NONE; vertices],
            seen: vec![0; vertices],
            turn: 0,
            star: Star::default(),
            targets: Vec::new(),
            rings: StarBuffers::default(),
        };
        if fresh {
            this.settle();
        } else {
            let all: Vec<u32> = (0..vertices as u32).collect();
            this.heap = Heap::new(&input.of_each(&all, |v| this.cheapest(v)));
        }
        this
    }

    /// Faces left.
    pub fn faces(&self) -> usize {
        self.faces
    }

    /// Input id of a vertex.
    pub fn vertex_id(&self, v: u32) -> u32 {
        self.piece.vertex_ids[v as usize]
    }

    /// Input id of a face.
    pub fn face_id(&self, f: u32) -> u32 {
        self.piece.face_ids[f as usize]
    }

    /// Input ids of the vertices that belong to other parts too.
    pub fn foreign(&self) -> impl Iterator<Item = u32> + '_ {
        let ids = self.piece.vertex_ids.iter().zip(&self.freedom);
        ids.filter(|(_, f)| **f == Freedom::Foreign).map(|(v, _)| *v)
    }

    /// Costs of the next collapses, as bits, in no order.
    pub fn costs(&self) -> impl Iterator<Item = u64> + '_ {
        self.heap.entries().iter().map(|e| e.cost)
    }

    /// Faces left: input id, and id here.
    pub fn faces_left(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        let all = self.piece.face_ids.iter().zip(0..);
        all.filter(|(_, f)| self.edges.face(*f).is_some()).map(|(id, f)| (*id, f))
    }

    /// Vertices that faces left use.
    pub fn stay(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.edges.vertex_count() as u32).filter(|v| self.edges.out(*v) != NONE)
    }

    /// Vertices left: input id, and position and quadric unless other parts share the vertex.
    pub fn vertices_left(&self) -> impl Iterator<Item = (u32, Option<(Placement, Quadric)>)> + '_ {
        self.stay().map(|v| {
            let id = self.vertex_id(v);
            let v = v as usize;
            let own = self.freedom[v] != Freedom::Foreign;
            (id, own.then(|| (self.places[v], self.quadrics[v])))
        })
    }

    /// Collapses until `stop` is reached or no legal collapse is left.
    pub fn run(&mut self, input: &Input<'_>, stop: &Stop, log: &mut impl Log) -> StopReason {
        let mut too_far = false;
        while self.faces > stop.faces {
            let Some(top) = self.heap.first() else {
                return if too_far { StopReason::MaxError } else { StopReason::NoLegalCollapse };
            };
            if top.cost > stop.most {
                break;
            }
            crate::task::checkpoint();
            self.gather(top.vertex);
            if let Some((k, cost)) = self.chosen().filter(|_| stop.max_error_mm.is_none())
                && self.is_legal(k)
                && self.accepted(k, input, log)
            {
                self.error_mm = self.error_mm.max(self.error_mm_at(k, cost));
                self.collapse(k, cost);
                continue;
            }
            self.weigh();
            loop {
                let best = self.best_target(stop.max_error_mm, &mut too_far);
                let Some(Best { k, total, cost }) = best else {
                    self.heap.pop();
                    break;
                };
                if (HeapEntry { cost: total.to_bits(), vertex: top.vertex }) > top {
                    // Its cost is above its lower bound: others may come first now.
                    self.heap.set(top.vertex, total);
                    self.choice[top.vertex as usize] = self.star.ring[k];
                    break;
                }
                if self.is_legal(k) && self.accepted(k, input, log) {
                    self.error_mm = self.error_mm.max(self.error_mm_at(k, cost));
                    self.collapse(k, cost);
                    break;
                }
                self.targets.retain(|t| t.k != k);
            }
        }
        StopReason::Reached
    }

    /// Position of a vertex, in the units of the run.
    pub fn position(&self, v: u32) -> DVec3 {
        self.places[v as usize].at
    }

    /// Whether a vertex may be relocated.
    pub fn may_move(&self, v: u32) -> bool {
        self.freedom[v as usize] == Freedom::Free
    }

    /// Moves `v` towards the minimum of its quadric, if it may move.
    fn relocate(&mut self, v: u32) {
        if !self.may_move(v) {
            return;
        }
        let (places, q) = (&self.places, &self.quadrics[v as usize]);
        if let Some(at) = better_place(&self.edges, v, q, |w| places[w as usize].at) {
            self.places[v as usize] = Placement { at, cost: q.at(at) };
        }
    }

    /// Relocates all vertices that others collapsed onto once more, now that connectivity is final.
    pub fn relocate_all(&mut self) {
        for v in 0..self.edges.vertex_count() as u32 {
            // One that no other collapsed onto is at the minimum of its quadric.
            if self.edges.out(v) != NONE && self.places[v as usize].cost > 0.0 {
                self.relocate(v);
            }
        }
    }

    /// Cost of the cheapest target of `v`, legal or not, by quadrics alone: a lower bound.
    fn cheapest(&self, v: u32) -> Option<f64> {
        let freedom = self.freedom[v as usize];
        if matches!(freedom, Freedom::Locked | Freedom::Foreign) {
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

    /// Fills the star of `v`, and marks its ring as seen.
    fn gather(&mut self, v: u32) {
        let places = &self.places;
        self.star.gather(&self.edges, v, |w| places[w as usize].at);
        self.turn += 1;
        for w in &self.star.ring {
            self.seen[*w as usize] = self.turn;
        }
    }

    /// The target found for the star earlier, if its neighbourhood has not changed since: its index in
    /// the ring, and its cost by the quadrics alone.
    fn chosen(&self) -> Option<(usize, f64)> {
        let v = self.star.centre as usize;
        let to = self.choice[v];
        let k = self.star.ring.iter().position(|w| *w == to)?;
        Some((k, self.quadrics[v].at(self.star.at[k]) + self.places[to as usize].cost))
    }

    /// Fills the targets of the star.
    fn weigh(&mut self) {
        let v = self.star.centre;
        self.star.measure(self.places[v as usize].at, &self.normals);
        let rim = self.freedom[v as usize] == Freedom::Rim;
        self.targets.clear();
        let q = &self.quadrics[v as usize];
        for (k, (w, at)) in self.star.ring.iter().zip(&self.star.at).enumerate() {
            let open = !rim || self.star.leaving.get(k).is_none_or(|h| on_rim(&self.edges, *h));
            if open && self.freedom[*w as usize] != Freedom::Foreign {
                let cost = q.at(*at) + self.places[*w as usize].cost;
                self.targets.push(CollapseTarget { cost, id: *w, k });
            }
        }
        self.targets.sort_unstable_by(|a, b| a.cost.total_cmp(&b.cost).then(a.id.cmp(&b.id)));
    }

    /// Computes the cost of every vertex in order of id: neighbours are then in the cache, as they are
    /// not in the order of costs.
    fn settle(&mut self) {
        let vertices = self.edges.vertex_count() as u32;
        let cost = |v| {
            if matches!(self.freedom[v as usize], Freedom::Locked | Freedom::Foreign) {
                return None;
            }
            self.gather(v);
            self.weigh();
            let best = self.best_target(None, &mut false)?;
            self.choice[v as usize] = self.star.ring[best.k];
            Some(best.total)
        };
        let costs: Vec<_> = (0..vertices).map(cost).collect();
        self.heap = Heap::new(&costs);
    }

    /// The target of least total cost, then least id, among those that turn or thin no face too much.
    /// Whether it is legal is checked later, as that is expensive.
    fn best_target(&self, max_error_mm: Option<f64>, too_far: &mut bool) -> Option<Best> {
        let mut best: Option<Best> = None;
        for &CollapseTarget { cost, k, .. } in &self.targets {
            let limit = best.as_ref().map_or(f64::INFINITY, |b| b.total - cost);
            if limit <= 0.0 {
                break;
            }
            let Some(deviation) = self.star.deviation(k).filter(|d| *d < limit) else { continue };
            if max_error_mm.is_some_and(|most| self.error_mm_at(k, cost) > most) {
                *too_far = true;
                continue;
            }
            best = Some(Best { k, cost, total: cost + deviation });
        }
        best
    }

    /// Root mean square distance of the target to the planes of both, mm.
    fn error_mm_at(&self, k: usize, cost: f64) -> f64 {
        let weight = |v: u32| self.quadrics[v as usize].weight;
        let sum = weight(self.star.centre) + weight(self.star.ring[k]);
        if sum > 0.0 { (cost / sum).sqrt() * self.mm } else { 0.0 }
    }

    /// Whether the collapse keeps the topology of the mesh.
    fn is_legal(&self, k: usize) -> bool {
        let in_ring = |v: u32| self.seen[v as usize] == self.turn;
        self.star.keeps_topology(&self.edges, k, in_ring)
            && (self.freedom[self.star.centre as usize] == Freedom::Free || self.keeps_cap(k))
    }

    /// Whether no cap, and no strip of wall between caps, loses its last face.
    fn keeps_cap(&self, k: usize) -> bool {
        let to = self.star.ring[k];
        self.star.leaving.iter().all(|&h| {
            let goes = self.edges.target(h) == to || self.edges.origin(prev(h)) == to;
            let sides = [h, next(h), prev(h)];
            !goes || sides.iter().any(|h| !on_rim(&self.edges, *h))
        })
    }

    /// Whether the recorder accepts the collapse.
    fn accepted(&mut self, k: usize, input: &Input<'_>, log: &mut impl Log) -> bool {
        if log.is_noop() {
            return true;
        }
        let (star, rings, piece) = (&self.star, &mut self.rings, &self.piece);
        // A closed ring begins at the target.
        let turn = if star.open { 0 } else { k };
        fn turned<T>(list: &[T], by: usize) -> impl Iterator<Item = &T> {
            list[by..].iter().chain(&list[..by])
        }
        rings.ring.clear();
        rings.ring.extend(turned(&star.ring, turn).map(|v| piece.vertex_ids[*v as usize]));
        rings.faces.clear();
        rings.faces.extend(turned(&star.leaving, turn).map(|h| piece.face_ids[face(*h) as usize]));
        rings.at.clear();
        rings.at.extend(turned(&star.at, turn).map(|at| input.in_mm(*at)));
        log.record(&Collapse {
            from: piece.vertex_ids[star.centre as usize],
            to: piece.vertex_ids[star.ring[k] as usize],
            ring: &rings.ring,
            faces: &rings.faces,
            from_at: input.in_mm(self.places[star.centre as usize].at),
            ring_at: &rings.at,
            boundary: star.open,
        })
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
        self.choice[to as usize] = NONE;
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
            self.update_neighbor(self.edges.target(h), to, h);
            let p = prev(h);
            h = self.edges.pair(p);
            if h == NONE {
                self.update_neighbor(self.edges.origin(p), to, p);
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

    /// Updates the cost of a neighbour `v` of the changed target `to`, along edge `h`. A vertex
    /// without a legal collapse is queued again. For the others `to` may now be the cheapest target;
    /// all other targets have only become more expensive, so that the cost in the heap stays a lower
    /// bound. Where normals count too, the heap already holds a better lower bound than quadrics
    /// give, and the cost is brought up to date when it comes up.
    #[inline]
    fn update_neighbor(&mut self, v: u32, to: u32, h: u32) {
        self.choice[v as usize] = NONE;
        let freedom = self.freedom[v as usize];
        let cost = match self.heap.cost(v) {
            _ if matches!(freedom, Freedom::Locked | Freedom::Foreign) => None,
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
