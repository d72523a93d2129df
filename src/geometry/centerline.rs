//! A centerline: branches of points with radius, and their attachments.

use glam::DVec3;
use serde::Serialize;

use super::tree::label_generations;

/// A point of a centerline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CenterlinePoint {
    /// Position, LPS mm.
    pub position_mm: DVec3,
    /// Distance to the wall (maximum inscribed sphere), mm.
    pub radius_mm: f64,
    /// Arc length from the root, mm.
    pub abscissa_mm: f64,
}

/// A point of a branch that another branch is attached to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Attachment {
    /// Index of the branch.
    pub branch: usize,
    /// Index of the point on that branch.
    pub point: usize,
}

/// One branch. Its end points repeat the points that they are attached to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Branch {
    /// Point of an earlier branch that the first point repeats; `None` of a root.
    pub start: Option<Attachment>,
    /// Point that the last point repeats, where the branch closes a loop; `None` of a free tip.
    pub end: Option<Attachment>,
    /// Points from the start to the end.
    pub points: Vec<CenterlinePoint>,
}

impl Branch {
    /// Returns the index of the branch that this one leaves.
    pub fn parent(&self) -> Option<usize> {
        self.start.map(|s| s.branch)
    }
}

/// A graph of branches; `branches[0]` is the root, parents come before children. Without loops it
/// is a tree.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Centerline {
    /// The branches. A single path has one.
    pub branches: Vec<Branch>,
}

/// An invalid attachment of a branch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("branch {branch} is attached to point {} of branch {}, which {}", .to.point, .to.branch, if *.later { "does not come before it" } else { "is not there" })]
pub struct AttachmentError {
    /// Index of the branch.
    pub branch: usize,
    /// Attachment that is invalid.
    pub to: Attachment,
    /// Whether the point exists, but on a branch that does not come before, as it must for a start.
    pub later: bool,
}

impl Centerline {
    /// Returns the branches with a tip of their own: no other branch leaves their last point.
    pub fn tips(&self) -> impl Iterator<Item = usize> {
        (0..self.branches.len()).filter(|b| {
            let point = self.branches[*b].points.len().saturating_sub(1);
            let end = Attachment { branch: *b, point };
            !self.branches.iter().any(|child| child.start == Some(end))
        })
    }

    /// Returns the number of points of all branches.
    pub fn point_count(&self) -> usize {
        self.branches.iter().map(|b| b.points.len()).sum()
    }

    /// Returns the summed length of all branches, mm.
    pub fn length_mm(&self) -> f64 {
        self.branches.iter().map(|b| length_mm(&b.points)).sum()
    }

    /// Returns the branches that leave no other: the path or trunk, one for each piece of the
    /// lumen, in the order in which they follow each other.
    pub fn pieces(&self) -> impl Iterator<Item = &Branch> {
        self.branches.iter().filter(|b| b.start.is_none())
    }

    /// Returns the branch at whose last point path or trunk end: the last one of several pieces.
    pub fn last_of_trunk(&self) -> Option<&Branch> {
        let is_path = self.branches.iter().all(|b| b.start.is_none());
        if is_path { self.branches.last() } else { self.branches.first() }
    }

    /// Checks that all attachments are points of the centerline, those of starts on earlier
    /// branches.
    ///
    /// # Errors
    /// [`AttachmentError`] names the first invalid one.
    pub fn check_attachments(&self) -> Result<(), AttachmentError> {
        for (branch, b) in self.branches.iter().enumerate() {
            for to in b.start.iter().chain(&b.end).copied() {
                let is_point =
                    self.branches.get(to.branch).is_some_and(|b| to.point < b.points.len());
                let later = b.start == Some(to) && to.branch >= branch;
                if !is_point || later {
                    return Err(AttachmentError { branch, to, later: is_point });
                }
            }
        }
        Ok(())
    }

    /// Returns the polyline from the root to the end of `branch`, attachment points once.
    ///
    /// # Panics
    /// Where [`Centerline::check_attachments`] has an error.
    pub fn path_to(&self, branch: usize) -> Vec<CenterlinePoint> {
        let b = &self.branches[branch];
        let Some(start) = b.start else { return b.points.clone() };
        let mut path = self.path_to(start.branch);
        // The parent's points are the last ones of its path.
        let after = self.branches[start.branch].points.len() - 1 - start.point;
        path.truncate(path.len() - after);
        let gap = path.last().zip(b.points.first());
        let same = gap.is_some_and(|(p, q)| p.position_mm.distance_squared(q.position_mm) < 1e-12);
        let skip = usize::from(same);
        path.extend_from_slice(&b.points[skip..]);
        path
    }

    /// Converts the centerline to nodes and the edges between them: branches are cut where others
    /// are attached.
    ///
    /// # Panics
    /// Where [`Centerline::check_attachments`] has an error.
    pub fn graph(&self) -> CenterlineGraph {
        GraphBuilder::default().build(self)
    }
}

fn length_mm(points: &[CenterlinePoint]) -> f64 {
    points.windows(2).map(|w| w[0].position_mm.distance(w[1].position_mm)).sum()
}

/// Kind of a node of a centerline graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum NodeKind {
    /// End of one edge.
    End,
    /// Meeting of several edges.
    Junction,
    /// Only node of a ring.
    Loop,
}

/// A node of a centerline graph.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CenterlineNode {
    /// Index of the node.
    pub id: usize,
    /// Position, LPS mm.
    pub position_mm: [f64; 3],
    /// Kind of the node.
    pub kind: NodeKind,
    /// Number of edge ends that meet at the node; a ring counts twice.
    pub degree: usize,
}

/// An edge of a centerline graph.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CenterlineEdge {
    /// Index of the edge.
    pub id: usize,
    /// Index of the node at the first point.
    pub from: usize,
    /// Index of the node at the last point.
    pub to: usize,
    /// Points of the edge: x, y, z (LPS mm) and radius (mm).
    pub points: Vec<[f64; 4]>,
    /// Length of the edge, mm.
    pub length_mm: f64,
    /// Smallest radius of the edge's points, mm.
    pub min_radius_mm: f64,
    /// Mean radius of the edge's points, mm.
    pub mean_radius_mm: f64,
    /// Number of bifurcations on the shortest path to the edge from a root: 0 at a root.
    pub generation: usize,
}

/// A centerline as nodes and edges; serialises as `intima.graph/1`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CenterlineGraph {
    /// Name and version of the format.
    pub schema: &'static str,
    /// Coordinate system of all positions.
    pub space: &'static str,
    /// Indices of the nodes at which branches that leave no other start.
    pub roots: Vec<usize>,
    /// Nodes, in the order of the branches they lie on.
    pub nodes: Vec<CenterlineNode>,
    /// Edges, in the order of their branches.
    pub edges: Vec<CenterlineEdge>,
}

impl CenterlineGraph {
    /// Returns the number of independent loops: edges less nodes, and one for each connected part.
    pub fn loops(&self) -> usize {
        let mut part: Vec<usize> = (0..self.nodes.len()).collect();
        let mut parts = part.len();
        for e in &self.edges {
            let (a, b) = (part[e.from], part[e.to]);
            if a != b {
                parts -= 1;
                part.iter_mut().filter(|p| **p == b).for_each(|p| *p = a);
            }
        }
        self.edges.len() + parts - self.nodes.len()
    }
}

/// Nodes in order of index, each by its place on a branch.
#[derive(Default)]
struct GraphBuilder {
    places: Vec<Attachment>,
}

impl GraphBuilder {
    fn build(mut self, line: &Centerline) -> CenterlineGraph {
        let branches = &line.branches;
        let mut cuts: Vec<Vec<usize>> =
            branches.iter().map(|b| vec![0, b.points.len().saturating_sub(1)]).collect();
        for to in branches.iter().flat_map(|b| b.start.iter().chain(&b.end)) {
            cuts[to.branch].push(to.point);
        }
        let mut edges: Vec<CenterlineEdge> = Vec::new();
        let mut roots: Vec<usize> = Vec::new();
        for (branch, b) in branches.iter().enumerate() {
            let cuts = &mut cuts[branch];
            cuts.sort_unstable();
            cuts.dedup();
            for w in cuts.windows(2) {
                let [from, to] =
                    [w[0], w[1]].map(|point| self.node(line, Attachment { branch, point }));
                if b.start.is_none() && w[0] == 0 {
                    roots.push(from);
                }
                let points = &b.points[w[0]..=w[1]];
                let radii = points.iter().map(|p| p.radius_mm);
                edges.push(CenterlineEdge {
                    id: edges.len(),
                    from,
                    to,
                    points: points
                        .iter()
                        .map(|p| p.position_mm.extend(p.radius_mm).into())
                        .collect(),
                    length_mm: length_mm(points),
                    min_radius_mm: radii.clone().fold(f64::INFINITY, f64::min),
                    mean_radius_mm: radii.sum::<f64>() / points.len() as f64,
                    generation: 0,
                });
            }
        }
        let mut degree = vec![0; self.places.len()];
        edges.iter().for_each(|e| [e.from, e.to].iter().for_each(|n| degree[*n] += 1));
        label_generations(&mut edges, &degree, &roots);
        let is_ring = |id: usize| edges.iter().any(|e| e.from == id && e.to == id);
        let node = |(id, at): (usize, &Attachment)| CenterlineNode {
            id,
            position_mm: branches[at.branch].points[at.point].position_mm.to_array(),
            kind: match degree[id] {
                1 => NodeKind::End,
                2 if is_ring(id) => NodeKind::Loop,
                _ => NodeKind::Junction,
            },
            degree: degree[id],
        };
        let nodes = self.places.iter().enumerate().map(node).collect();
        CenterlineGraph { schema: "intima.graph/1", space: "LPS", roots, nodes, edges }
    }

    /// Returns the node of a place; an attached end is the same place as the point it is attached
    /// to.
    fn node(&mut self, line: &Centerline, mut at: Attachment) -> usize {
        // No chain of attachments is longer than there are branch ends, unless it goes in circles.
        for _ in 0..2 * line.branches.len() {
            let b = &line.branches[at.branch];
            let is_last = at.point + 1 == b.points.len();
            match (at.point, b.start, b.end) {
                (0, Some(to), _) => at = to,
                (_, _, Some(to)) if is_last && to != at => at = to,
                _ => break,
            }
        }
        self.places.iter().position(|p| *p == at).unwrap_or_else(|| {
            self.places.push(at);
            self.places.len() - 1
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(all: &[[f64; 2]]) -> Vec<CenterlinePoint> {
        let point = |[x, y]: &[f64; 2]| CenterlinePoint {
            position_mm: DVec3::new(*x, *y, 0.0),
            radius_mm: 2.0 - 0.1 * y,
            abscissa_mm: x.abs() + y.abs(),
        };
        all.iter().map(point).collect()
    }

    fn at(branch: usize, point: usize) -> Option<Attachment> {
        Some(Attachment { branch, point })
    }

    /// A root of four points, a branch from its second one, and one from that branch's second.
    fn tree() -> Centerline {
        let root = points(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]]);
        let side = points(&[[1.0, 0.0], [1.0, 1.0], [1.0, 3.0]]);
        let twig = points(&[[1.0, 1.0], [4.0, 1.0]]);
        Centerline {
            branches: vec![
                Branch { points: root, ..Branch::default() },
                Branch { start: at(0, 1), end: None, points: side },
                Branch { start: at(1, 1), end: None, points: twig },
            ],
        }
    }

    #[test]
    fn a_tree_is_cut_at_its_junctions() {
        let graph = tree().graph();
        let ends: Vec<_> = graph.edges.iter().map(|e| (e.from, e.to, e.generation)).collect();
        assert_eq!(ends, [(0, 1, 0), (1, 2, 1), (1, 3, 1), (3, 4, 2), (3, 5, 2)]);
        let kinds: Vec<_> = graph.nodes.iter().map(|n| (n.kind, n.degree)).collect();
        use NodeKind::{End, Junction};
        let (end, fork) = ((End, 1), (Junction, 3));
        assert_eq!(kinds, [end, fork, end, fork, end, end]);
        let lengths: Vec<f64> = graph.edges.iter().map(|e| e.length_mm).collect();
        assert_eq!(lengths, [1.0, 2.0, 1.0, 2.0, 3.0]);
        assert_eq!(graph.nodes[3].position_mm, [1.0, 1.0, 0.0]);
        let side = &graph.edges[3];
        assert!(
            (side.min_radius_mm - 1.7).abs() < 1e-12 && (side.mean_radius_mm - 1.8).abs() < 1e-12
        );
        assert_eq!(graph.loops(), 0);
        let json = serde_json::to_value(&graph).unwrap();
        assert_eq!(json["schema"], "intima.graph/1");
        assert_eq!(json["nodes"][1]["kind"], "junction");
        assert_eq!(json["edges"][0]["points"][1], serde_json::json!([1.0, 0.0, 0.0, 2.0]));
    }

    #[test]
    fn a_path_to_a_tip_has_every_attachment_once() {
        let x = |path: Vec<CenterlinePoint>| -> Vec<[f64; 2]> {
            path.iter().map(|p| [p.position_mm.x, p.position_mm.y]).collect()
        };
        let line = tree();
        assert_eq!(x(line.path_to(1)), [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 3.0]]);
        assert_eq!(x(line.path_to(2)), [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [4.0, 1.0]]);
    }

    #[test]
    fn branches_that_meet_again_are_a_loop() {
        let mut line = tree();
        // The last branch comes back to the root's third point.
        let met = line.branches[0].points[2];
        line.branches[2].points.push(met);
        line.branches[2].end = at(0, 2);
        line.check_attachments().unwrap();
        let graph = line.graph();
        assert_eq!((graph.loops(), graph.nodes.len(), graph.edges.len()), (1, 6, 6));
        let degrees: usize = graph.nodes.iter().map(|n| n.degree).sum();
        assert_eq!(degrees, 2 * graph.edges.len());
    }

    #[test]
    fn a_ring_has_one_node() {
        let ring = points(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.0]]);
        let line =
            Centerline { branches: vec![Branch { start: None, end: at(0, 0), points: ring }] };
        line.check_attachments().unwrap();
        let graph = line.graph();
        assert_eq!((graph.nodes.len(), graph.edges.len(), graph.loops()), (1, 1, 1));
        assert_eq!((graph.nodes[0].kind, graph.nodes[0].degree), (NodeKind::Loop, 2));
    }

    #[test]
    fn attachments_to_points_that_are_not_there_are_named() {
        let said = |change: fn(&mut Centerline)| {
            let mut line = tree();
            change(&mut line);
            line.check_attachments().unwrap_err().to_string()
        };
        let missing = said(|l| l.branches[1].start = at(0, 4));
        assert_eq!(missing, "branch 1 is attached to point 4 of branch 0, which is not there");
        let later = said(|l| l.branches[1].start = at(2, 0));
        assert!(later.ends_with("does not come before it"), "{later}");
        assert!(said(|l| l.branches[2].end = at(3, 0)).ends_with("is not there"));
    }
}
