//! The paper's own path: kept points joined by Dijkstra where one sees the other.

use glam::{DVec3, IVec3};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::centre::arc_lengths;
use super::{CenterlineError, Graph, Sampler, Viewer};
use crate::geometry::{Branch, Centerline, CenterlinePoint};
use crate::kernels::visibility::sees;
use crate::lumen::Lumen;

/// Joins kept points into one path (paper, section 3.2): points see each other when their spheres
/// touch and the ray between them is free; edges weigh their length. The two points farthest apart
/// are the ends. Parts that no ray joins are bridged through the voxel graph by the shortest route.
///
/// * `kept`: points that survived the visibility test.
/// * `distance`: exact distance, mm.
///
/// # Errors
/// [`CenterlineError::Empty`] without points, [`CenterlineError::Unreachable`] if even the voxel
/// graph does not join them.
pub fn paper_path(
    lumen: &Lumen,
    kept: &[Viewer],
    distance: &[f32],
) -> Result<Centerline, CenterlineError> {
    if kept.is_empty() {
        return Err(CenterlineError::Empty);
    }
    let h = lumen.grid.spacing_mm;
    let points: Vec<IVec3> = kept.iter().map(|v| lumen.bricks.voxel(v.element)).collect();
    let mut net = Net { lumen, kept, points, bridges: Vec::new() };
    let (from, to) = net.ends()?;
    let path = net.path(from, to).ok_or(CenterlineError::Unreachable)?;
    let d = Sampler { lumen, field: distance };
    let local: Vec<DVec3> = path.iter().map(|p| p.as_dvec3() * h).collect();
    let world = lumen.grid.world_from_voxel();
    let half = 0.5 * h.element_product().cbrt();
    let points = local
        .iter()
        .zip(arc_lengths(&local))
        .map(|(p, s)| CenterlinePoint {
            position_mm: world.transform_point3(*p / h),
            radius_mm: (d.at(*p) - half).max(0.0),
            abscissa_mm: s,
        })
        .collect();
    Ok(Centerline { branches: vec![Branch { parent: None, points }] })
}

struct Net<'a> {
    lumen: &'a Lumen,
    kept: &'a [Viewer],
    points: Vec<IVec3>,
    /// Voxel routes between points no ray joins.
    bridges: Vec<(usize, usize, Vec<IVec3>)>,
}

impl Net<'_> {
    fn length(&self, a: usize, b: usize) -> f64 {
        ((self.points[a] - self.points[b]).as_dvec3() * self.lumen.grid.spacing_mm).length()
    }

    fn joined(&self, a: usize, b: usize) -> bool {
        let near: &[u32] = bytemuck::cast_slice(self.lumen.bricks.near());
        let open: &[u32] = bytemuck::cast_slice(&self.lumen.inside);
        self.length(a, b) <= self.kept[a].reach_mm + self.kept[b].reach_mm
            && sees(near, open, self.kept[a].element, self.points[b] - self.points[a])
    }

    /// Dijkstra from one point; lengths in µm so that the order is total.
    fn search(&self, from: usize) -> (Vec<u64>, Vec<usize>) {
        let n = self.points.len();
        let mut cost = vec![u64::MAX; n];
        let mut parent = vec![usize::MAX; n];
        let mut open = BinaryHeap::from([Reverse((0u64, from))]);
        let mut waiting: Vec<usize> = (0..n).filter(|i| *i != from).collect();
        (cost[from], parent[from]) = (0, from);
        while let Some(Reverse((c, u))) = open.pop() {
            if c > cost[u] {
                continue;
            }
            waiting.retain(|&v| cost[v] > c);
            let um = |mm: f64| (mm * 1000.0).round() as u64;
            // The ray is walked only when it would help.
            let mut reached: Vec<(usize, u64)> = waiting
                .iter()
                .map(|&v| (v, c + um(self.length(u, v))))
                .filter(|&(v, to)| to < cost[v] && self.joined(u, v))
                .collect();
            for (a, b, route) in self.bridges.iter().filter(|(a, b, _)| *a == u || *b == u) {
                let h = self.lumen.grid.spacing_mm;
                let local: Vec<DVec3> = route.iter().map(|p| p.as_dvec3() * h).collect();
                let length = arc_lengths(&local).last().copied().unwrap_or(0.0);
                reached.push((if *a == u { *b } else { *a }, c + um(length)));
            }
            for (v, to) in reached {
                if to < cost[v] {
                    (cost[v], parent[v]) = (to, u);
                    open.push(Reverse((to, v)));
                }
            }
        }
        (cost, parent)
    }

    /// Joins every part to the first by voxel routes, then finds the ends by a double sweep.
    fn ends(&mut self) -> Result<(usize, usize), CenterlineError> {
        let mut graph = None;
        loop {
            let (cost, _) = self.search(0);
            let Some(lost) = cost.iter().position(|c| *c == u64::MAX) else {
                let far = |cost: &[u64]| {
                    (0..cost.len()).max_by_key(|&i| (cost[i], Reverse(i))).unwrap_or(0)
                };
                let a = far(&cost);
                let (cost, _) = self.search(a);
                return Ok((a, far(&cost)));
            };
            let graph = graph.get_or_insert_with(|| Graph::new(self.lumen));
            let node = |i: usize| self.kept[i].element;
            let routes = graph.by_length(&[node(lost) as u32]);
            let reached = (0..cost.len())
                .filter(|&i| cost[i] != u64::MAX)
                .min_by_key(|&i| (routes.cost[node(i)], i))
                .ok_or(CenterlineError::Unreachable)?;
            let route = routes.path_to(graph, node(reached) as u32);
            if route.is_empty() {
                return Err(CenterlineError::Unreachable);
            }
            let route = route.iter().map(|n| graph.voxel(*n)).collect();
            self.bridges.push((lost, reached, route));
        }
    }

    fn path(&self, from: usize, to: usize) -> Option<Vec<IVec3>> {
        let (cost, parent) = self.search(from);
        if cost[to] == u64::MAX {
            return None;
        }
        let mut out = vec![self.points[to]];
        let mut at = to;
        while at != from {
            let up = parent[at];
            let bridge = self.bridges.iter().find(|(a, b, _)| {
                !self.joined(up, at) && ((*a, *b) == (at, up) || (*a, *b) == (up, at))
            });
            if let Some((a, _, route)) = bridge {
                let mut route = route.clone();
                if *a != at {
                    route.reverse();
                }
                out.extend_from_slice(&route[1..route.len() - 1]);
            }
            out.push(self.points[up]);
            at = up;
        }
        out.reverse();
        Some(out)
    }
}
