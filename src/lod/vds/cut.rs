//! The cut that a camera requires: which patches are drawn, and how fine.
//!
//! Fineness counts [`MORPH_STEPS`] to a level: q = 32 (l - 1) + a is level l of the base face whose
//! newest vertices have moved a / 32 of the way from the edge that they split. A patch of depth d
//! is drawn at levels d + 2 and d + 3, a base face also at 0 and 1; coarser, the patch above it is
//! drawn. Neighbours differ by at most one level (a restricted subdivision): a patch is at most 32
//! coarser than each neighbour. A side has the larger fineness of all patches at it, and is that of
//! the largest of them, so that all see the same points on it.
//!
//! A cut depends on the camera alone. It is found anew in each step, from the octree down.

use super::criterion::{Criterion, Fineness, STEP};
use super::forest::NONE;
use super::measure::lowest_level;
use super::patch::{DrawnPatch, MORPH_STEPS};
use super::surface::SubdivisionSurface;

/// State of a node in a cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NodeState {
    /// Node below one that is drawn.
    Above,
    /// Node that is drawn, and its fineness.
    Drawn(Fineness),
    /// Node above some that are drawn.
    Below,
}

/// A cut while it is found.
pub(super) struct Cut<'a> {
    surface: &'a SubdivisionSurface,
    pub states: Vec<NodeState>,
    /// Whether a node that is drawn may be seen.
    is_seen: Vec<bool>,
    /// Fineness of the sides of nodes that are drawn.
    sides: Vec<[Fineness; 3]>,
}

impl<'a> Cut<'a> {
    /// Starts with nothing drawn.
    pub fn new(surface: &'a SubdivisionSurface) -> Self {
        let nodes = surface.forest.nodes.len();
        Self {
            surface,
            states: vec![NodeState::Above; nodes],
            is_seen: vec![false; nodes],
            sides: vec![[0; 3]; nodes],
        }
    }

    /// The cut that a camera requires.
    pub fn of(surface: &'a SubdivisionSurface, criterion: &Criterion) -> Self {
        let mut cut = Self::new(surface);
        cut.select(criterion);
        cut
    }

    /// Fineness of a corner of a node, from the base.
    pub fn origin(&self, id: u32) -> Fineness {
        self.surface.forest.node(id).depth as Fineness * STEP
    }

    /// Largest fineness of a node that is drawn.
    fn finest(&self, id: u32) -> Fineness {
        self.origin(id) + self.surface.shape().finest() as Fineness * STEP
    }

    /// Least fineness of a node that is drawn.
    pub fn least(&self, id: u32) -> Fineness {
        let depth = self.surface.forest.node(id).depth;
        (depth + lowest_level(depth)) as Fineness * STEP
    }

    /// Decides for a node and all below it.
    fn refine(&mut self, id: u32, criterion: &Criterion) {
        let surface = self.surface;
        let bounds = &surface.bounds[id as usize];
        let least = self.least(id);
        self.states[id as usize] = NodeState::Drawn(least);
        self.is_seen[id as usize] = criterion.is_visible(bounds);
        if !self.is_seen[id as usize] {
            return;
        }
        let depth = surface.forest.node(id).depth;
        let children = surface.forest.children(id);
        let whole = self.finest(id);
        let most = match surface.finest.get(id as usize) {
            Some(level) if children.is_empty() => self.origin(id) + *level as Fineness * STEP,
            _ => whole,
        };
        let vertices = surface.patches().vertices_of(id);
        let required = criterion.required(bounds, vertices, lowest_level(depth));
        if required.is_some() || children.is_empty() {
            let q = required.map_or(whole, |q| self.origin(id) + q);
            self.states[id as usize] = NodeState::Drawn(q.min(most));
            return;
        }
        children.clone().for_each(|c| self.refine(c, criterion));
        // Smaller spheres may say that this level is enough everywhere.
        let is_least = |c: u32| self.states[c as usize] == NodeState::Drawn(whole);
        if children.clone().all(is_least) {
            children.for_each(|c| self.states[c as usize] = NodeState::Above);
            self.states[id as usize] = NodeState::Drawn(whole);
        } else {
            self.states[id as usize] = NodeState::Below;
        }
    }

    /// The node that is drawn across side `e` of a node that is drawn, and which of its sides that
    /// is: of the same depth or less. `None` on a boundary, and where smaller ones are drawn.
    pub fn across(&self, id: u32, e: usize) -> Option<(u32, usize)> {
        let forest = &self.surface.forest;
        let twin = forest.node(id).twins[e];
        if twin == NONE {
            return None;
        }
        let (mut m, side) = (twin / 3, twin as usize % 3);
        loop {
            match self.states[m as usize] {
                NodeState::Drawn(_) => return Some((m, side)),
                NodeState::Below => return None,
                // Corner children lie on the sides of their parent with the same numbers.
                NodeState::Above => m = forest.node(m).parent,
            }
        }
    }

    pub fn fineness(&self, id: u32) -> Fineness {
        match self.states[id as usize] {
            NodeState::Drawn(q) => q,
            _ => 0,
        }
    }

    /// Raises patches that are more than a level coarser than a neighbour, finest first.
    pub fn balance(&mut self) {
        let mut open: Vec<Vec<u32>> = Vec::new();
        let push = |open: &mut Vec<Vec<u32>>, id: u32, q: Fineness| {
            if open.len() <= usize::from(q) {
                open.resize_with(usize::from(q) + 1, Vec::new);
            }
            open[usize::from(q)].push(id);
        };
        for id in 0..self.states.len() as u32 {
            if let NodeState::Drawn(q) = self.states[id as usize]
                && q > STEP
            {
                push(&mut open, id, q);
            }
        }
        for q in (usize::from(STEP) + 1..open.len()).rev() {
            let mut i = 0;
            while i < open[q].len() {
                let id = open[q][i];
                i += 1;
                if self.states[id as usize] != NodeState::Drawn(q as Fineness) {
                    continue;
                }
                let need = q as Fineness - STEP;
                for e in 0..3 {
                    self.raise_across(id, e, need, |m, q| push(&mut open, m, q));
                }
            }
        }
    }

    /// Raises the patch across a side to a fineness, or draws its children instead of it until one
    /// can have that fineness. `raised` is told every patch that changed.
    fn raise_across(
        &mut self,
        id: u32,
        side: usize,
        need: Fineness,
        mut raised: impl FnMut(u32, Fineness),
    ) {
        while let Some((m, _)) = self.across(id, side)
            && self.fineness(m) < need
        {
            if need <= self.finest(m) {
                self.states[m as usize] = NodeState::Drawn(need);
                raised(m, need);
                return;
            }
            self.states[m as usize] = NodeState::Below;
            for c in self.surface.forest.children(m) {
                let least = self.least(c);
                self.states[c as usize] = NodeState::Drawn(least);
                self.is_seen[c as usize] = self.is_seen[m as usize];
                raised(c, least);
            }
        }
    }

    /// Nodes that are drawn, in order.
    fn nodes(&self) -> Vec<u32> {
        let drawn = |id: &u32| matches!(self.states[*id as usize], NodeState::Drawn(_));
        (0..self.states.len() as u32).filter(drawn).collect()
    }

    /// Gives each side the largest fineness of the patches at it.
    fn settle_sides(&mut self, nodes: &[u32]) {
        for id in nodes {
            self.sides[*id as usize] = [self.fineness(*id); 3];
        }
        // First each node raises the sides across, then its own: a side of a large patch has two
        // small ones across it. The coarsest raise no side.
        for id in nodes {
            let own = self.fineness(*id);
            let raising = if own == 0 { 0..0 } else { 0..3 };
            for e in raising {
                if let Some((m, side)) = self.across(*id, e) {
                    let there = &mut self.sides[m as usize][side];
                    *there = own.max(*there);
                }
            }
        }
        for id in nodes {
            for e in 0..3 {
                if let Some((m, side)) = self.across(*id, e) {
                    let q = self.sides[m as usize][side].max(self.sides[*id as usize][e]);
                    self.sides[*id as usize][e] = q;
                }
            }
        }
    }

    /// Patches to draw of a balanced cut.
    pub fn patches(&mut self) -> Vec<DrawnPatch> {
        let nodes = self.nodes();
        self.settle_sides(&nodes);
        nodes.into_iter().map(|id| self.patch(id)).collect()
    }

    fn patch(&self, id: u32) -> DrawnPatch {
        let origin = self.origin(id);
        let own = u32::from(self.fineness(id) - origin);
        let sides = self.sides[id as usize].map(|q| u32::from(q - origin));
        let level = own.div_ceil(MORPH_STEPS);
        let split = |e: usize| u32::from(sides[e].div_ceil(MORPH_STEPS) > level) << e;
        let template = self.surface.shape().template(level, split(0) | split(1) | split(2));
        DrawnPatch {
            patch: id,
            first_index: template.first,
            triangles: template.triangles,
            morph: own | sides[0] << 8 | sides[1] << 16 | sides[2] << 24,
            is_seen: self.is_seen[id as usize],
        }
    }

    fn select(&mut self, criterion: &Criterion) {
        let surface = self.surface;
        self.states[..surface.finest.len()].fill(NodeState::Drawn(0));
        surface.tree.traverse(
            |n| criterion.is_in_sight(0.5 * (n.lo + n.hi), 0.5 * (n.hi - n.lo)),
            |at, _| {
                for f in surface.tree.items_of(at) {
                    self.refine(*f, criterion);
                }
            },
        );
        self.balance();
    }
}
