//! The voxel graph of the lumen.
//!
//! Nodes are inside voxels, numbered as the elements of a field. A diagonal step is legal only when
//! every voxel of the block it spans is inside: the straight segment then stays inside the
//! surface, which separates inside voxels that share only an edge or a corner.

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use crate::lumen::Lumen;
use crate::lumen::bricks::{BRICK, NONE, SIDE, near_index};

/// Inside voxels as nodes, with their legal steps. A node is the voxel's field element.
pub struct Graph<'a> {
    lumen: &'a Lumen,
    /// One bit for each of the 27 offsets that is a legal step, by element; 0 outside.
    legal: Vec<u32>,
}

/// Number of the zero offset.
pub(super) const STAY: usize = 13;
/// Bits of all steps: all are legal where the voxel's whole neighbourhood is inside.
pub(super) const FREE: u32 = ((1 << 27) - 1) & !(1 << STAY);

/// Offset of one of the 27 neighbours.
#[inline]
pub const fn offset(n: usize) -> IVec3 {
    let n = n as i32;
    IVec3::new(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1)
}

/// Number of one of the 27 offsets.
#[inline]
pub(super) const fn number(d: IVec3) -> usize {
    near_index(d.x, d.y, d.z)
}

/// For every offset, the bits of all voxels of the block it spans.
const BLOCK: [u32; 27] = {
    let mut out = [0u32; 27];
    let mut n = 0;
    while n < 27 {
        let d = offset(n);
        let mut k = 0;
        while k < 8 {
            let x = if k & 1 != 0 { d.x } else { 0 };
            let y = if k & 2 != 0 { d.y } else { 0 };
            let z = if k & 4 != 0 { d.z } else { 0 };
            out[n] |= 1 << near_index(x, y, z);
            k += 1;
        }
        n += 1;
    }
    out
};

/// Target of a step along one axis, by position in the brick (0 to 7) and direction (-1, 0, 1):
/// offset of the brick (-1, 0, 1) and position in it.
const ALONG: [[(i8, u8); 3]; 8] = {
    let mut out = [[(0, 0); 3]; 8];
    let mut p = 0;
    while p < 8 {
        let mut d = 0;
        while d < 3 {
            let to = p as i32 + d as i32 - 1;
            out[p][d] = ((to >> 3) as i8, (to & 7) as u8);
            d += 1;
        }
        p += 1;
    }
    out
};

/// Change of an element's index with each offset, within a brick.
const DELTA: [i32; 27] = {
    let mut out = [0; 27];
    let mut n = 0;
    while n < 27 {
        let d = offset(n);
        out[n] = d.x + SIDE * d.y + SIDE * SIDE * d.z;
        n += 1;
    }
    out
};

/// Whether no step from a place of a brick leaves it.
#[inline]
fn deep_in_brick(node: u32) -> bool {
    let l = node as usize % BRICK;
    let inner = |p: usize| p.wrapping_sub(1) < 6;
    inner(l & 7) & inner(l >> 3 & 7) & inner(l >> 6)
}

impl<'a> Graph<'a> {
    /// The graph of a lumen.
    pub fn new(lumen: &'a Lumen) -> Self {
        let mut legal = vec![0u32; lumen.bricks.field_len()];
        legal
            .par_chunks_exact_mut(BRICK)
            .enumerate()
            .with_min_len(64)
            .for_each(|(slot, out)| legal_steps(lumen, slot, out));
        Self { lumen, legal }
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.lumen.inside_voxels() as usize
    }
    /// Whether the lumen is empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// The lumen.
    pub fn lumen(&self) -> &'a Lumen {
        self.lumen
    }
    /// All nodes, ascending.
    pub fn nodes(&self) -> impl Iterator<Item = u32> + '_ {
        self.lumen.elements(&self.lumen.inside).map(|e| e as u32)
    }
    /// Voxel of a node.
    pub fn voxel(&self, node: u32) -> IVec3 {
        self.lumen.bricks.voxel(node as usize)
    }
    /// Node of a voxel, if it is inside.
    pub fn node_at(&self, v: IVec3) -> Option<u32> {
        let e = self.lumen.bricks.element(v)?;
        self.lumen.is_inside(e).then_some(e as u32)
    }
    /// Bits of the legal steps of a node.
    #[inline]
    pub(super) fn legal(&self, node: u32) -> u32 {
        self.legal[node as usize]
    }
    /// Node that a legal step leads to.
    #[inline]
    pub(super) fn step(&self, node: u32, n: usize) -> u32 {
        let (slot, l) = (node as usize / BRICK, node as usize % BRICK);
        let (x, y, z) = (l & 7, l >> 3 & 7, l >> 6);
        let ((ox, x), (oy, y), (oz, z)) = (ALONG[x][n % 3], ALONG[y][n / 3 % 3], ALONG[z][n / 9]);
        let place = u32::from(x) + 8 * u32::from(y) + 64 * u32::from(z);
        let over = near_index(i32::from(ox), i32::from(oy), i32::from(oz));
        self.lumen.bricks.near()[slot][over] * BRICK as u32 + place
    }
    /// Returns [`Graph::step`] for one node, faster for several steps: most nodes have all of them
    /// in one brick.
    #[inline]
    pub(super) fn leads(&self, node: u32) -> impl Fn(usize) -> u32 + '_ {
        let deep = deep_in_brick(node);
        move |n| if deep { node.wrapping_add_signed(DELTA[n]) } else { self.step(node, n) }
    }
    /// Legal steps of a node: offset number and node.
    #[inline]
    pub fn steps(&self, node: u32) -> impl Iterator<Item = (usize, u32)> + '_ {
        let mut bits = self.legal(node);
        let leads = self.leads(node);
        std::iter::from_fn(move || {
            (bits != 0).then(|| {
                let n = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                (n, leads(n))
            })
        })
    }

    /// Length of each of the 27 steps, mm.
    pub fn step_lengths_mm(&self) -> [f64; 27] {
        let h: DVec3 = self.lumen.grid.spacing_mm;
        std::array::from_fn(|n| (offset(n).as_dvec3() * h).length())
    }
}

/// Legal steps of a brick's voxels, layer by layer: 64 voxels at a time where all of them agree.
fn legal_steps(lumen: &Lumen, slot: usize, out: &mut [u32]) {
    for (z, out) in out.chunks_exact_mut(64).enumerate() {
        let inside = lumen.inside[slot * SIDE as usize + z];
        if inside == 0 {
            continue; // zeroed already
        }
        let around = surroundings(lumen, slot, z as i32);
        let mut left = inside;
        let free = around.iter().fold(!0, |a, b| a & b);
        while left != 0 {
            let i = left.trailing_zeros();
            left &= left - 1;
            out[i as usize] = if free >> i & 1 != 0 {
                FREE
            } else {
                let held = (0..27).fold(0, |m, n| m | ((around[n] >> i & 1) as u32) << n);
                let legal = |n: usize| u32::from(BLOCK[n] & !held == 0) << n;
                (0..27).fold(0, |m, n| m | legal(n)) & FREE
            };
        }
    }
}

/// Inside bits of a brick's layer, moved by each of the 27 offsets: bit v of word n tells whether
/// voxel v + offset(n) is inside.
fn surroundings(lumen: &Lumen, slot: usize, z: i32) -> [u64; 27] {
    const LOW: u64 = 0x0101_0101_0101_0101;
    let near = &lumen.bricks.near()[slot];
    let mut out = [0; 27];
    for dz in 0..3 {
        let z = z + dz - 1;
        let layer = |dx: i32, dy: i32| match near[near_index(dx, dy, z >> 3)] {
            NONE => 0,
            s => lumen.inside[s as usize * SIDE as usize + (z & 7) as usize],
        };
        // Columns of bricks at x - 1, x, x + 1, each moved by the three offsets in y.
        let columns: [[u64; 3]; 3] = std::array::from_fn(|x| {
            let [low, here, high] = [-1, 0, 1].map(|dy| layer(x as i32 - 1, dy));
            [here << 8 | low >> 56, here, here >> 8 | high << 56]
        });
        for dy in 0..3 {
            let [low, here, high] = [0, 1, 2].map(|x| columns[x][dy]);
            let at = &mut out[3 * dy + 9 * dz as usize..][..3];
            at[0] = here << 1 & !LOW | low >> 7 & LOW;
            at[1] = here;
            at[2] = here >> 1 & !(LOW << 7) | high << 7 & LOW << 7;
        }
    }
    out
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
        let l = Lumen::new(grid, &bits);
        let g = Graph::new(&l);
        assert_eq!(g.nodes().count(), g.len());
        let mut free = 0;
        for node in g.nodes() {
            let v = g.voxel(node);
            assert_eq!(g.node_at(v), Some(node));
            let got: Vec<_> = g.steps(node).map(|(_, to)| g.voxel(to)).collect();
            let want: Vec<_> = (0..27)
                .filter(|&n| n != STAY)
                .map(offset)
                .filter(|d| {
                    (0..8).all(|k| {
                        let part = IVec3::new(k & 1, k >> 1 & 1, k >> 2) * *d;
                        l.holds(v + part)
                    })
                })
                .map(|d| v + d)
                .collect();
            assert_eq!(got, want);
            free += usize::from(g.legal(node) == FREE);
        }
        assert!(free > 500, "{free}");
    }
}
