//! The paper's own path: kept points joined by Dijkstra where one sees the other.
//!
//! The paper is W. Li et al. 2004, Three-dimensional interactive virtual endoscopy.

use glam::{DVec3, IVec3};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::VoxelRoutes;
use crate::centerline::{CenterlineError, Ends, RouteOptions, Viewpoint, arc_lengths};
use crate::field::Sampler;
use crate::geometry::{Branch, Centerline, CenterlinePoint};
use crate::kernels::visibility::sees;
use crate::lumen::Lumen;

/// Joins kept points into one path (paper, section 3.2): points see each other when their spheres
/// touch and the ray between them is free; edges weigh their length. Parts that no ray joins are
/// bridged through the voxel graph by the shortest route.
///
/// * `kept`: points that survived the visibility test.
/// * `distance`: exact distance, mm.
/// * `options`: the path runs between the kept points nearest to the given ends; an end that is not
///   given is the kept point farthest from the other one along the path, and without any the two
///   farthest apart are the ends.
///
/// # Errors
/// [`CenterlineError::PaperTree`] if a tree is asked for, [`CenterlineError::OutsideLumen`] for a
/// given end, [`CenterlineError::Empty`] without points, [`CenterlineError::Unreachable`] if even
/// the voxel graph does not join them.
pub fn paper_path(
    lumen: &Lumen,
    kept: &[Viewpoint],
    distance: &[f32],
    options: RouteOptions,
) -> Result<Centerline, CenterlineError> {
    if options.tree {
        return Err(CenterlineError::PaperTree);
    }
    if kept.is_empty() {
        return Err(CenterlineError::Empty);
    }
    let h = lumen.grid.spacing_mm;
    let points: Vec<IVec3> = kept.iter().map(|v| lumen.bricks.voxel(v.element)).collect();
    let mut net = RidgeNet { lumen, kept, points, bridges: Vec::new() };
    let (from, to) = net.ends(options.ends)?;
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
    Ok(Centerline { branches: vec![Branch { points, ..Branch::default() }] })
}

struct RidgeNet<'a> {
    lumen: &'a Lumen,
    kept: &'a [Viewpoint],
    points: Vec<IVec3>,
    /// Voxel routes between points no ray joins.
    bridges: Vec<(usize, usize, Vec<IVec3>)>,
}

impl RidgeNet<'_> {
    fn length(&self, a: usize, b: usize) -> f64 {
        ((self.points[a] - self.points[b]).as_dvec3() * self.lumen.grid.spacing_mm).length()
    }

    fn joined(&self, a: usize, b: usize) -> bool {
        let near: &[u32] = bytemuck::cast_slice(self.lumen.bricks.near());
        let open: &[u32] = bytemuck::cast_slice(&self.lumen.inside);
        self.length(a, b) <= self.kept[a].reach_mm + self.kept[b].reach_mm
            && sees(near, open, self.kept[b].element, self.points[b] - self.points[a])
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
            crate::task::checkpoint();
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

    /// The kept points at the ends of the path: those nearest to given ends, else by a double sweep.
    fn ends(&mut self, ends: Ends) -> Result<(usize, usize), CenterlineError> {
        let from = ends.from.map(|p| self.nearest("start", p)).transpose()?;
        let to = ends.to.map(|p| self.nearest("end", p)).transpose()?;
        let from_first = self.join_parts()?;
        let far =
            |cost: &[u64]| (0..cost.len()).max_by_key(|&i| (cost[i], Reverse(i))).unwrap_or(0);
        Ok(match (from, to) {
            (Some(a), Some(b)) => (a, b),
            (Some(a), None) => (a, far(&self.search(a).0)),
            (None, Some(b)) => (far(&self.search(b).0), b),
            (None, None) => {
                let a = far(&from_first);
                (a, far(&self.search(a).0))
            }
        })
    }

    /// The kept point nearest to a place in the lumen (LPS mm), the first of equally near ones.
    fn nearest(&self, which: &'static str, at: DVec3) -> Result<usize, CenterlineError> {
        let grid = &self.lumen.grid;
        let v = grid.voxel_from_world().transform_point3(at);
        let off = |p: IVec3| ((p.as_dvec3() - v) * grid.spacing_mm).length();
        let is_near = v.is_finite() && v.abs().max_element() < 1e6;
        if !(is_near && self.lumen.holds(v.round().as_ivec3())) {
            let inside = self.lumen.elements(&self.lumen.inside);
            let nearest_mm =
                inside.map(|e| off(self.lumen.bricks.voxel(e))).fold(f64::MAX, f64::min);
            return Err(CenterlineError::OutsideLumen { which, at, nearest_mm });
        }
        let order = |a: &usize, b: &usize| off(self.points[*a]).total_cmp(&off(self.points[*b]));
        Ok((0..self.points.len()).min_by(order).unwrap_or(0))
    }

    /// Joins every part to the first point's by voxel routes. Returns the cost from that point.
    fn join_parts(&mut self) -> Result<Vec<u64>, CenterlineError> {
        loop {
            let (cost, _) = self.search(0);
            let Some(lost) = cost.iter().position(|c| *c == u64::MAX) else { return Ok(cost) };
            let element = |i: usize| self.kept[i].element;
            let routes = VoxelRoutes::from(self.lumen, element(lost));
            let reached = (0..cost.len())
                .filter(|&i| cost[i] != u64::MAX)
                .min_by_key(|&i| (routes.length[element(i)], i))
                .ok_or(CenterlineError::Unreachable)?;
            let route = routes.to(element(reached));
            if route.is_empty() {
                return Err(CenterlineError::Unreachable);
            }
            let route = route.into_iter().map(|e| self.lumen.bricks.voxel(e)).collect();
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lumen::BitVolume;
    use crate::volume::Grid;

    /// A square channel along x with kept points on its axis, 4 voxels apart, that see 2.5 mm far:
    /// each is joined to the next ones alone.
    fn channel() -> (Lumen, Vec<Viewpoint>, Vec<f32>) {
        let grid = Grid::axis_aligned([50, 9, 9], [1.0; 3]);
        let mut bits = BitVolume::new(grid.dims);
        for v in (0..grid.len()).map(|i| grid.voxel(i)) {
            if (1..49).contains(&v.x) && v.y.abs_diff(4) <= 3 && v.z.abs_diff(4) <= 3 {
                bits.set(v.x, v.y, v.z);
            }
        }
        let lumen = Lumen::of_volume(grid, &bits);
        let element = |x| lumen.bricks.element(IVec3::new(x, 4, 4)).unwrap();
        let kept =
            (0..12).map(|k| Viewpoint { element: element(3 + 4 * k), reach_mm: 2.5 }).collect();
        let distance = vec![4.0; lumen.bricks.field_len()];
        (lumen, kept, distance)
    }

    fn xs(ends: Ends) -> Result<Vec<f64>, CenterlineError> {
        let (lumen, kept, distance) = channel();
        let options = RouteOptions { ends, ..RouteOptions::default() };
        let line = paper_path(&lumen, &kept, &distance, options)?;
        Ok(line.branches[0].points.iter().map(|p| p.position_mm.x).collect())
    }

    #[test]
    fn the_papers_path_runs_between_the_kept_points_nearest_to_given_ends() {
        let at = |x: f64| Some(DVec3::new(x, 5.0, 3.0));
        assert_eq!(
            xs(Ends { from: at(30.4), to: at(10.1) }).unwrap(),
            [31., 27., 23., 19., 15., 11.]
        );
        // One given end: the other is the farthest point along the path.
        let from = xs(Ends { from: at(30.4), to: None }).unwrap();
        assert_eq!((from[0], *from.last().unwrap()), (31.0, 3.0));
        let to = xs(Ends { from: None, to: at(10.1) }).unwrap();
        assert_eq!((to[0], *to.last().unwrap()), (47.0, 11.0));
        let all = xs(Ends::default()).unwrap();
        assert_eq!((all[0], *all.last().unwrap(), all.len()), (47.0, 3.0, 12));
    }

    #[test]
    fn the_papers_path_refuses_a_tree_and_ends_outside_the_lumen() {
        let (lumen, kept, distance) = channel();
        let tree = RouteOptions { tree: true, ..Default::default() };
        let refused = paper_path(&lumen, &kept, &distance, tree).unwrap_err();
        assert_eq!(refused, CenterlineError::PaperTree);
        let outside = Ends { from: None, to: Some(DVec3::new(20.0, 10.0, 4.0)) };
        match xs(outside).unwrap_err() {
            CenterlineError::OutsideLumen { which: "end", nearest_mm, .. } => {
                assert!((nearest_mm - 3.0).abs() < 1e-12, "{nearest_mm}");
            }
            e => panic!("{e}"),
        }
        let none = RouteOptions::default();
        assert_eq!(paper_path(&lumen, &[], &distance, none).unwrap_err(), CenterlineError::Empty);
    }
}
