//! The cut that a camera requires: which patches are drawn, and how fine.
//!
//! Fineness counts [`MORPH_STEPS`] = 32 steps per level. At fineness 32 (l - 1) + a the base face has
//! level l, and its newest vertices have moved a / 32 of the way from the edge that they split. With
//! 1-to-4 splits, a patch of depth d is drawn at levels d + 2 and d + 3. For coarser levels its parent
//! is drawn; a base face has no parent and is drawn at levels 0 and 1 too. Neighbours differ by at most
//! one level (a restricted subdivision). A side belongs to the largest patch at it and takes the largest
//! fineness of all patches at it, so that they all place the same points on it.
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
    /// An ancestor is drawn instead.
    UnderDrawn,
    /// Drawn, with its fineness.
    Drawn(Fineness),
    /// Descendants are drawn instead.
    Split,
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
            states: vec![NodeState::UnderDrawn; nodes],
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

    /// Chooses the drawn patches. Base faces that the octree finds out of sight stay at level 0.
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

    /// Fineness of level 0 of a patch: `depth` levels above the base face.
    pub fn origin(&self, id: u32) -> Fineness {
        self.surface.forest.node(id).depth as Fineness * STEP
    }

    /// Largest fineness at which a patch can be drawn.
    fn max_fineness(&self, id: u32) -> Fineness {
        self.origin(id) + self.surface.shape().finest() as Fineness * STEP
    }

    /// Smallest fineness at which a patch can be drawn.
    pub fn min_fineness(&self, id: u32) -> Fineness {
        let depth = self.surface.forest.node(id).depth;
        (depth + lowest_level(depth)) as Fineness * STEP
    }

    /// Chooses the drawn patches in the subtree of a node.
    fn refine(&mut self, id: u32, criterion: &Criterion) {
        let surface = self.surface;
        let bounds = &surface.bounds[id as usize];

        // 1. A patch that the camera cannot see is drawn as coarsely as possible.
        self.states[id as usize] = NodeState::Drawn(self.min_fineness(id));
        self.is_seen[id as usize] = criterion.is_visible(bounds);
        if !self.is_seen[id as usize] {
            return;
        }

        // 2. The patch itself is drawn if it can be fine enough, or if it has no children.
        let children = surface.forest.children(id);
        let finest = self.max_fineness(id);
        let limit = match surface.finest.get(id as usize) {
            Some(level) if children.is_empty() => self.origin(id) + *level as Fineness * STEP,
            _ => finest,
        };
        let vertices = surface.patches().vertices_of(id);
        let lowest = lowest_level(surface.forest.node(id).depth);
        let required = criterion.required(bounds, vertices, lowest);
        if required.is_some() || children.is_empty() {
            let fineness = required.map_or(finest, |from_origin| self.origin(id) + from_origin);
            self.states[id as usize] = NodeState::Drawn(fineness.min(limit));
            return;
        }

        // 3. Otherwise descendants are drawn.
        for child in children.clone() {
            self.refine(child, criterion);
        }

        // 4. The coarsest level of the children has the triangles of this patch's finest level. If no
        // child needs more, this patch is drawn.
        let is_coarsest = |child: u32| self.states[child as usize] == NodeState::Drawn(finest);
        if children.clone().all(is_coarsest) {
            for child in children {
                self.states[child as usize] = NodeState::UnderDrawn;
            }
            self.states[id as usize] = NodeState::Drawn(finest);
        } else {
            self.states[id as usize] = NodeState::Split;
        }
    }

    /// Returns the drawn patch across a side of a drawn patch, and the number of the shared side there.
    /// Returns `None` on a boundary, and if smaller patches are drawn across.
    pub fn across(&self, id: u32, side: usize) -> Option<(u32, usize)> {
        let forest = &self.surface.forest;
        let twin = forest.node(id).twins[side];
        if twin == NONE {
            return None;
        }
        let (mut other, other_side) = (twin / 3, twin as usize % 3);
        loop {
            match self.states[other as usize] {
                NodeState::Drawn(_) => return Some((other, other_side)),
                NodeState::Split => return None,
                // Corner children lie on the sides of their parent with the same numbers.
                NodeState::UnderDrawn => other = forest.node(other).parent,
            }
        }
    }

    pub fn fineness(&self, id: u32) -> Fineness {
        match self.states[id as usize] {
            NodeState::Drawn(q) => q,
            _ => 0,
        }
    }

    /// Raises patches until no patch is more than one level coarser than a neighbour. Starts with the
    /// finest.
    pub fn balance(&mut self) {
        let mut buckets: Vec<Vec<u32>> = Vec::new();
        for id in 0..self.states.len() as u32 {
            if let NodeState::Drawn(fineness) = self.states[id as usize]
                && fineness > STEP
            {
                push(&mut buckets, id, fineness);
            }
        }
        // A raise never reaches the fineness of the patch that asked for it, so a bucket is complete
        // when its turn comes.
        for fineness in (STEP + 1..buckets.len() as Fineness).rev() {
            for id in std::mem::take(&mut buckets[usize::from(fineness)]) {
                // Others were raised or split since.
                if self.states[id as usize] == NodeState::Drawn(fineness) {
                    for side in 0..3 {
                        let raised = |other, to| push(&mut buckets, other, to);
                        self.raise_across(id, side, fineness - STEP, raised);
                    }
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
            if need <= self.max_fineness(m) {
                self.states[m as usize] = NodeState::Drawn(need);
                raised(m, need);
                return;
            }
            self.states[m as usize] = NodeState::Split;
            for c in self.surface.forest.children(m) {
                let least = self.min_fineness(c);
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
        // 1. Each patch raises the side across, if an equal or larger patch lies there. Two small patches
        // may raise the side of a large one. The coarsest patches raise no side.
        for id in nodes {
            let own = self.fineness(*id);
            if own == 0 {
                continue;
            }
            for side in 0..3 {
                if let Some((other, other_side)) = self.across(*id, side) {
                    let shared = &mut self.sides[other as usize][other_side];
                    *shared = own.max(*shared);
                }
            }
        }
        // 2. Each patch takes over the fineness of the side across.
        for id in nodes {
            for side in 0..3 {
                if let Some((other, other_side)) = self.across(*id, side) {
                    let there = self.sides[other as usize][other_side];
                    let shared = &mut self.sides[*id as usize][side];
                    *shared = there.max(*shared);
                }
            }
        }
    }

    /// Patches to draw of a balanced cut.
    pub fn drawn_patches(&mut self) -> Vec<DrawnPatch> {
        let nodes = self.nodes();
        self.settle_sides(&nodes);
        nodes.into_iter().map(|id| self.drawn_patch(id)).collect()
    }

    fn drawn_patch(&self, id: u32) -> DrawnPatch {
        let origin = self.origin(id);
        let own = u32::from(self.fineness(id) - origin);
        let sides = self.sides[id as usize].map(|fineness| u32::from(fineness - origin));
        let level = own.div_ceil(MORPH_STEPS);
        // A bit for each side that is split once more.
        let mut split_sides = 0;
        for (side, fineness) in sides.iter().enumerate() {
            if fineness.div_ceil(MORPH_STEPS) > level {
                split_sides |= 1 << side;
            }
        }
        let template = self.surface.shape().template(level, split_sides);
        DrawnPatch {
            patch: id,
            first_index: template.first,
            triangles: template.triangles,
            morph: own | sides[0] << 8 | sides[1] << 16 | sides[2] << 24,
            is_seen: self.is_seen[id as usize],
        }
    }
}

/// Adds a patch to those of its fineness.
fn push(buckets: &mut Vec<Vec<u32>>, id: u32, fineness: Fineness) {
    if buckets.len() <= usize::from(fineness) {
        buckets.resize_with(usize::from(fineness) + 1, Vec::new);
    }
    buckets[usize::from(fineness)].push(id);
}
