//! Branches of a tree by generation.

use std::collections::VecDeque;
use std::fmt;

use serde::Serialize;

use super::centerline::{CenterlineEdge, CenterlineGraph, CenterlineNode};

/// Counts of a tree's branches: the stretches between root, bifurcations and tips.
///
/// The generation of a branch is the number of bifurcations on the shortest way to it from the root,
/// as Weibel counts airways (Weibel 1963, Morphometry of the human lung,
/// doi:10.1007/978-3-642-87553-3): trachea 0, main bronchi 1. A node where more than three branches
/// meet is one bifurcation.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TreeSummary {
    /// Number of branches.
    pub branches: usize,
    /// Number of branches with a free tip; the root is not a tip of its branch.
    pub terminal_branches: usize,
    /// Largest generation.
    pub greatest_generation: usize,
    /// Number of branches of each generation, from 0.
    pub generations: Vec<usize>,
    /// Summed length of the branches of each generation, mm.
    pub generation_lengths_mm: Vec<f64>,
    /// Mean radius along the branches of each generation, mm.
    pub generation_radii_mm: Vec<f64>,
    /// Number of loops. A branch on a loop has the least generation that leads to it.
    pub loops: usize,
}

impl fmt::Display for TreeSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let es = if self.branches == 1 { "" } else { "es" };
        write!(
            f,
            "{} branch{es} between bifurcations, {} terminal, generations 0 to {}",
            self.branches, self.terminal_branches, self.greatest_generation
        )
    }
}

impl CenterlineGraph {
    /// Counts branches by generation. Edges that meet at a node of degree 2 are one branch, unless
    /// a root is there.
    pub fn tree(&self) -> TreeSummary {
        let count = self.edges.iter().map(|e| e.generation + 1).max().unwrap_or(0);
        let mut generations = vec![0; count];
        let (mut lengths, mut moments) = (vec![0.0; count], vec![0.0; count]);
        for e in &self.edges {
            generations[e.generation] += 1;
            lengths[e.generation] += e.length_mm;
            moments[e.generation] += e.length_mm * e.mean_radius_mm;
        }
        let mean = |(moment, length): (&f64, &f64)| {
            if *length > 0.0 { moment / length } else { 0.0 }
        };
        let inner = |n: &&CenterlineNode| !self.roots.contains(&n.id);
        // Both edges of a node that is no bifurcation have the same generation.
        for n in self.nodes.iter().filter(inner).filter(|n| n.degree == 2) {
            if let Some(e) = self.edges.iter().find(|e| e.from == n.id || e.to == n.id) {
                generations[e.generation] -= 1;
            }
        }
        TreeSummary {
            branches: generations.iter().sum(),
            terminal_branches: self.nodes.iter().filter(inner).filter(|n| n.degree == 1).count(),
            greatest_generation: generations.len().saturating_sub(1),
            generation_radii_mm: moments.iter().zip(&lengths).map(mean).collect(),
            generation_lengths_mm: lengths,
            generations,
            loops: self.loops(),
        }
    }
}

/// Gives each edge its generation.
///
/// * `degree`: edge ends at each node.
/// * `roots`: nodes that generations are counted from.
pub(super) fn label_generations(edges: &mut [CenterlineEdge], degree: &[usize], roots: &[usize]) {
    let mut at: Vec<Vec<usize>> = vec![Vec::new(); degree.len()];
    for (i, e) in edges.iter_mut().enumerate() {
        e.generation = usize::MAX;
        at[e.from].push(i);
        at[e.to].push(i);
    }
    // Generation of the edges that leave a node.
    let mut leaving = vec![usize::MAX; degree.len()];
    roots.iter().for_each(|r| leaving[*r] = 0);
    let mut open: VecDeque<usize> = roots.iter().copied().collect();
    while let Some(node) = open.pop_front() {
        for i in &at[node] {
            let e = &mut edges[*i];
            e.generation = e.generation.min(leaving[node]);
            let to = if e.from == node { e.to } else { e.from };
            let parts = degree[to] != 2;
            let beyond = leaving[node] + usize::from(parts);
            if beyond < leaving[to] {
                leaving[to] = beyond;
                if parts { open.push_back(to) } else { open.push_front(to) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use crate::geometry::{Attachment, Branch, Centerline, CenterlinePoint};

    fn point(x: f64, y: f64) -> CenterlinePoint {
        CenterlinePoint { position_mm: DVec3::new(x, y, 0.0), radius_mm: 1.0, abscissa_mm: 0.0 }
    }

    fn at(branch: usize, point: usize) -> Option<Attachment> {
        Some(Attachment { branch, point })
    }

    /// A branch of five points, 1 mm apart, from a place or to one.
    fn branch(start: Option<Attachment>, end: Option<Attachment>, y: f64) -> Branch {
        Branch { start, end, points: (0..5).map(|i| point(f64::from(i), y)).collect() }
    }

    /// Branches, terminal ones, generations, loops.
    fn counts(branches: Vec<Branch>) -> (usize, usize, Vec<usize>, usize) {
        let line = Centerline { branches };
        line.check_attachments().unwrap();
        let tree = line.graph().tree();
        assert_eq!(tree.branches, tree.generations.iter().sum::<usize>());
        assert_eq!(tree.greatest_generation + 1, tree.generations.len().max(1));
        (tree.branches, tree.terminal_branches, tree.generations, tree.loops)
    }

    #[test]
    fn generations_count_bifurcations_from_the_root_along_the_trunk_too() {
        // The trunk parts at its points 1 and 3, the branch from 1 parts once more.
        let all = vec![
            branch(None, None, 0.0),
            branch(at(0, 1), None, 1.0),
            branch(at(0, 3), None, 2.0),
            branch(at(1, 2), None, 3.0),
        ];
        let tree = Centerline { branches: all.clone() }.graph().tree();
        // The trunk's first 1 mm; its next 2 mm and 2 mm of the first branch; the rest.
        assert_eq!(tree.generation_lengths_mm, [1.0, 4.0, 11.0]);
        assert_eq!(tree.generation_radii_mm, [1.0; 3]);
        assert_eq!(counts(all), (7, 4, vec![1, 2, 4], 0));
        assert_eq!(counts(vec![branch(None, None, 0.0)]), (1, 1, vec![1], 0));
        assert_eq!(counts(Vec::new()), (0, 0, Vec::new(), 0));
    }

    #[test]
    fn three_ways_from_one_place_are_one_bifurcation() {
        let side = |y| branch(at(0, 2), None, y);
        let all = vec![branch(None, None, 0.0), side(1.0), side(2.0)];
        assert_eq!(counts(all), (4, 3, vec![1, 3], 0));
    }

    #[test]
    fn a_branch_that_goes_on_from_a_tip_is_not_another_one() {
        let all =
            vec![branch(None, None, 0.0), branch(at(0, 4), None, 1.0), branch(at(1, 2), None, 2.0)];
        assert_eq!(counts(all), (3, 2, vec![1, 2], 0));
    }

    #[test]
    fn a_branch_on_a_loop_has_the_least_generation_that_leads_to_it() {
        // From the trunk's first bifurcation two ways lead to its second one.
        let bridge = branch(at(0, 1), at(0, 3), 1.0);
        let all = vec![branch(None, None, 0.0), bridge.clone()];
        assert_eq!(counts(all), (4, 1, vec![1, 2, 1], 1));
        // A tip at the bridge's middle and one behind it.
        let all = vec![branch(None, None, 0.0), bridge, branch(at(1, 2), None, 2.0)];
        assert_eq!(counts(all), (6, 2, vec![1, 2, 3], 1));
        // A ring has no tip.
        assert_eq!(counts(vec![branch(None, at(0, 0), 0.0)]), (1, 0, vec![1], 1));
    }

    #[test]
    fn every_piece_of_a_lumen_has_its_own_root() {
        let all =
            vec![branch(None, None, 0.0), branch(None, None, 1.0), branch(at(1, 2), None, 2.0)];
        assert_eq!(counts(all), (4, 3, vec![2, 2], 0));
        // Two ways from a root in the middle of a tube.
        let all = vec![branch(None, None, 0.0), branch(at(0, 0), None, 1.0)];
        assert_eq!(counts(all), (2, 2, vec![2], 0));
    }
}
