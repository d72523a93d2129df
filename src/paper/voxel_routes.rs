//! Shortest routes over the voxels of the lumen, by which the paper's path bridges what no ray joins.
//!
//! A route goes from voxel to neighbouring voxel. A diagonal step is legal only when every voxel of
//! the block it spans is inside: the straight segment then stays inside the surface, which separates
//! inside voxels that share only an edge or a corner. Lengths are integers, so that what is settled
//! when is fixed (Dijkstra 1959, doi:10.1007/BF01386390).

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::IVec3;

use crate::lumen::Lumen;
use crate::lumen::bricks::{near_index, near_offset};

/// No distance.
pub const NOWHERE: u32 = u32::MAX;

/// Number of the offset that goes nowhere.
const STAY: usize = 13;

/// Shortest routes from one voxel to all others.
pub struct VoxelRoutes {
    /// Length by field element, in [`VoxelRoutes::unit_mm`]; [`NOWHERE`] where there is no route.
    pub length: Vec<u32>,
    /// Unit of the lengths, mm: a sixty-fourth of the shortest spacing.
    pub unit_mm: f64,
    /// Element from which each was reached; its own at the source.
    parent: Vec<u32>,
}

/// Legal steps from an element: number of the offset, and where it leads.
fn steps(lumen: &Lumen, element: usize) -> impl Iterator<Item = (usize, usize)> {
    let inside = |n: usize| {
        let to = lumen.bricks.step(element, near_offset(n));
        to.filter(|e| lumen.is_inside(*e))
    };
    let around: [Option<usize>; 27] = std::array::from_fn(inside);
    (0..27).filter(|n| *n != STAY).filter_map(move |n| {
        let corner = |k: i32| near_offset(n) * IVec3::new(k & 1, k >> 1 & 1, k >> 2);
        let held = |d: IVec3| around[near_index(d.x, d.y, d.z)].is_some();
        let free = (0..8).all(|k| held(corner(k)));
        around[n].filter(|_| free).map(|to| (n, to))
    })
}

impl VoxelRoutes {
    /// Routes from a field element.
    pub fn from(lumen: &Lumen, source: usize) -> Self {
        let h = lumen.grid.spacing_mm;
        let unit_mm = h.min_element() / 64.0;
        let step = |n: usize| ((near_offset(n).as_dvec3() * h).length() / unit_mm).round() as u32;
        let lengths: [u32; 27] = std::array::from_fn(step);
        let mut length = vec![NOWHERE; lumen.bricks.field_len()];
        let mut parent: Vec<u32> = (0..length.len() as u32).collect();
        length[source] = 0;
        let mut open = BinaryHeap::from([Reverse((0, source))]);
        while let Some(Reverse((at, from))) = open.pop() {
            if at > length[from] {
                continue; // reached sooner since
            }
            crate::task::checkpoint();
            for (n, to) in steps(lumen, from) {
                let there = at.saturating_add(lengths[n]);
                if there < length[to] {
                    (length[to], parent[to]) = (there, from as u32);
                    open.push(Reverse((there, to)));
                }
            }
        }
        Self { length, unit_mm, parent }
    }

    /// Elements from the source to another, both included; empty when there is no route.
    pub fn to(&self, element: usize) -> Vec<usize> {
        let mut path = Vec::new();
        if self.length[element] == NOWHERE {
            return path;
        }
        let mut at = element;
        path.push(at);
        while self.parent[at] as usize != at {
            at = self.parent[at] as usize;
            path.push(at);
        }
        path.reverse();
        path
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lumen::BitVolume;
    use crate::volume::Grid;
    use glam::UVec3;

    #[test]
    fn steps_are_those_whose_whole_block_is_inside() {
        let grid = Grid::axis_aligned([19, 21, 13], [1.0; 3]);
        let mut bits = BitVolume::new(grid.dims);
        let deep = |v: UVec3| v.y >= 9 && v.x > 1 && v.z > 1;
        let rough = |v: UVec3| !(v.x * 7 + v.y * 13 + v.z * 29 + v.x * v.z).is_multiple_of(4);
        for v in (0..grid.len()).map(|i| grid.voxel(i)).filter(|v| deep(*v) || rough(*v)) {
            bits.set(v.x, v.y, v.z);
        }
        let l = Lumen::of_volume(grid, &bits);
        let mut free = 0;
        for e in l.elements(&l.inside) {
            let v = l.bricks.voxel(e);
            let got: Vec<_> = steps(&l, e).map(|(_, to)| l.bricks.voxel(to)).collect();
            let block = |d: IVec3, k: i32| IVec3::new(k & 1, k >> 1 & 1, k >> 2) * d;
            let want: Vec<_> = (0..27)
                .map(near_offset)
                .filter(|d| *d != IVec3::ZERO && (0..8).all(|k| l.holds(v + block(*d, k))))
                .map(|d| v + d)
                .collect();
            assert_eq!(got, want);
            free += usize::from(got.len() == 26);
        }
        assert!(free > 500, "{free}");
    }

    #[test]
    fn a_route_is_as_long_as_its_legal_steps() {
        // Wide rooms with a pillar, a rough wall and a second part nothing leads to.
        let grid = Grid::axis_aligned([26, 23, 15], [0.8, 0.8, 1.25]);
        let mut bits = BitVolume::new(grid.dims);
        for v in (0..grid.len()).map(|i| grid.voxel(i)) {
            let rough = (v.x * 7 + v.y * 13 + v.z * 29 + v.x * v.z) % 5 != 0;
            let pillar = (v.x / 3, v.y / 3) == (3, 3);
            if !pillar && v.x != 20 && (v.y < 17 || rough) {
                bits.set(v.x, v.y, v.z);
            }
        }
        let l = Lumen::of_volume(grid, &bits);
        let source = l.bricks.element(IVec3::new(1, 1, 7)).unwrap();
        let routes = VoxelRoutes::from(&l, source);
        let length = |a: usize, b: usize| {
            let (n, _) = steps(&l, a).find(|s| s.1 == b).expect("a legal step");
            ((near_offset(n).as_dvec3() * l.grid.spacing_mm).length() / routes.unit_mm).round()
        };
        let mut lost = 0;
        for e in l.elements(&l.inside) {
            let path = routes.to(e);
            let Some(first) = path.first() else {
                assert!(l.bricks.voxel(e).x > 20);
                lost += 1;
                continue;
            };
            let sum: f64 = path.windows(2).map(|w| length(w[0], w[1])).sum();
            assert_eq!((*first, sum), (source, f64::from(routes.length[e])));
        }
        assert!(lost > 0);
    }
}
