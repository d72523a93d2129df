//! The quadtrees of patches over a base mesh, with half-edge connectivity across their levels.
//!
//! A node is a patch: a triangle of a base face split `depth` times. Its corner children keep their
//! corner of it in the same place, child 3 is the middle one, turned round. Half-edge e of node n,
//! from its corner e to e + 1, has the number 3 n + e; its twin belongs to a node of the same depth
//! or, where there is none, to the one above that. The forest is balanced: no leaf is more than one
//! level from a leaf across its sides.

use super::base_mesh::BaseMesh;
use super::template::GridPoint;

/// Stands for "no node" and "no half-edge".
pub const NONE: u32 = u32::MAX;
/// Largest depth of a node.
pub const MAX_DEPTH: u32 = 8;
/// Steps of the grid of a base face: points of the deepest patches of 1-to-4 splits (16 steps) have
/// whole coordinates, and those of other shapes in a base face (9 and 48 steps).
pub const FACE_STEPS: u32 = (9 * 16) << MAX_DEPTH;

/// A patch of the forest.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchNode {
    /// Base face.
    pub face: u32,
    /// Corners on the grid of the face with [`FACE_STEPS`].
    pub corners: [GridPoint; 3],
    /// The node that was split into this one; [`NONE`] for a base face.
    pub parent: u32,
    /// First of four children; [`NONE`] for a leaf.
    pub children: u32,
    /// Splits from the base face.
    pub depth: u32,
    /// Twins of its half-edges; [`NONE`] on a boundary.
    pub twins: [u32; 3],
}

impl PatchNode {
    /// Coordinates, on the grid of the face, of a point of the patch that has `steps` along a side.
    pub fn place(&self, p: GridPoint, steps: u32) -> GridPoint {
        [0, 1, 2].map(|k| (0..3).map(|c| p[c] * self.corners[c][k]).sum::<u32>() / steps)
    }
}

/// All nodes: first one for each base face, a parent before its children.
#[derive(Clone, Debug, Default)]
pub struct PatchForest {
    pub nodes: Vec<PatchNode>,
}

impl PatchForest {
    /// One node for each face of the base.
    pub fn new(base: &BaseMesh) -> Self {
        let n = FACE_STEPS;
        let corners = [[n, 0, 0], [0, n, 0], [0, 0, n]];
        let root = |face: u32| {
            let twins = [0, 1, 2].map(|e| base.twin(face, e).map_or(NONE, |(g, k)| 3 * g + k));
            PatchNode { face, corners, parent: NONE, children: NONE, depth: 0, twins }
        };
        Self { nodes: (0..base.faces.len() as u32).map(root).collect() }
    }

    pub fn node(&self, id: u32) -> &PatchNode {
        &self.nodes[id as usize]
    }

    /// Children of a node; none for a leaf.
    pub fn children(&self, id: u32) -> std::ops::Range<u32> {
        let first = self.node(id).children;
        if first == NONE { 0..0 } else { first..first + 4 }
    }

    /// Whether a node can be split.
    pub fn can_split(&self, id: u32) -> bool {
        let n = self.node(id);
        n.children == NONE && n.depth < MAX_DEPTH
    }

    /// Splits a leaf, and leaves beside it where the forest would lose its balance. Returns the
    /// nodes that were split, in order.
    pub fn split(&mut self, id: u32) -> Vec<u32> {
        let mut done = Vec::new();
        let mut open = vec![id];
        while let Some(&id) = open.last() {
            if self.node(id).children != NONE {
                open.pop();
                continue;
            }
            let depth = self.node(id).depth;
            let twins = self.node(id).twins.into_iter().filter(|t| *t != NONE);
            let above: Vec<u32> =
                twins.map(|t| t / 3).filter(|m| self.node(*m).depth < depth).collect();
            if above.is_empty() {
                self.split_leaf(id);
                done.push(id);
            }
            open.extend(above);
        }
        done
    }

    fn split_leaf(&mut self, id: u32) {
        let first = self.nodes.len() as u32;
        let PatchNode { face, corners: [a, b, c], depth, twins, .. } = self.node(id).clone();
        let middle = |p: GridPoint, q: GridPoint| [0, 1, 2].map(|k| (p[k] + q[k]) / 2);
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        for corners in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]] {
            let depth = depth + 1;
            let node = PatchNode { face, corners, parent: id, children: NONE, depth, twins };
            self.nodes.push(node);
        }
        self.nodes[id as usize].children = first;
        for e in 0..3u32 {
            // The middle child's side e is the inner one of corner child e + 2.
            self.join(3 * (first + 3) + e, 3 * (first + (e + 2) % 3) + e);
            let halves = [first + e, first + (e + 1) % 3].map(|child| 3 * child + e);
            let twin = twins[e as usize];
            let beyond = if twin == NONE { NONE } else { self.node(twin / 3).children };
            for (half, corner) in halves.into_iter().zip([(twin % 3 + 1) % 3, twin % 3]) {
                if beyond == NONE {
                    self.nodes[half as usize / 3].twins[e as usize] = twin;
                } else {
                    self.join(half, 3 * (beyond + corner) + twin % 3);
                }
            }
        }
    }

    fn join(&mut self, h: u32, g: u32) {
        self.nodes[h as usize / 3].twins[h as usize % 3] = g;
        self.nodes[g as usize / 3].twins[g as usize % 3] = h;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tetrahedron.
    fn base() -> BaseMesh {
        BaseMesh::new(vec![[0, 1, 2], [2, 1, 3], [3, 0, 2], [0, 3, 1]], 4)
    }

    /// A point of a face as weights of the base's vertices.
    fn point(base: &BaseMesh, n: &PatchNode, corner: usize) -> Vec<(u32, u32)> {
        let weights = base.faces[n.face as usize].into_iter().zip(n.corners[corner]);
        let mut all: Vec<_> = weights.filter(|w| w.1 > 0).collect();
        all.sort_unstable();
        all
    }

    #[test]
    fn twins_share_their_ends_and_leaves_differ_by_at_most_one_level() {
        let base = base();
        let mut forest = PatchForest::new(&base);
        // Towards one corner, then anywhere.
        let mut seed = 5u64;
        for i in 0..300 {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let any = (seed >> 33) as u32 % forest.nodes.len() as u32;
            let last = forest.nodes.len() as u32 - 4;
            let id = if i < 7 { last.max(i) } else { any };
            if forest.can_split(id) {
                forest.split(id);
            }
        }
        let deepest = forest.nodes.iter().map(|n| n.depth).max();
        assert!(deepest > Some(4), "{deepest:?}");
        for n in &forest.nodes {
            for e in 0..3 {
                let (m, k) = (&forest.nodes[n.twins[e] as usize / 3], n.twins[e] as usize % 3);
                assert!(m.depth == n.depth || m.depth + 1 == n.depth);
                if m.depth == n.depth {
                    let own = [e, (e + 1) % 3].map(|c| point(&base, n, c));
                    let other = [(k + 1) % 3, k].map(|c| point(&base, m, c));
                    assert_eq!(own, other);
                    assert_eq!(forest.nodes[m.twins[k] as usize / 3], *n);
                } else {
                    assert_eq!(m.children, NONE, "a twin above is a leaf");
                }
            }
        }
    }
}
