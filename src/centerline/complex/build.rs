//! Nodes, contacts, runs and corners of a lumen, cell by cell.

use glam::IVec3;
use rayon::prelude::*;

use super::cell::{self, LOW, SIDE, STEP, components, voxels};
use super::{CellComplex, Contact, Corner, EdgeRun, Node};
use crate::lumen::Lumen;
use crate::lumen::bricks::{BRICK, NONE, near_index};
use crate::task::checkpoint;

/// Cells of a brick.
const CELLS: usize = 8;
/// The two axes beside each one.
const ACROSS: [[usize; 2]; 3] = [[1, 2], [0, 2], [0, 1]];

/// Lists of all cells, joined, with where each cell's (or cell's and axis') begins.
struct Lists<T> {
    all: Vec<T>,
    start: Vec<u32>,
}

impl<T: Send> Lists<T> {
    /// Makes the lists of `per_brick` cells or cells and axes of each brick, on all threads.
    fn new(
        bricks: usize,
        per_brick: usize,
        make: impl Fn(usize, usize, &mut Vec<T>) + Sync,
    ) -> Self {
        /// Bricks that are done at a time.
        const GROUP: usize = 64;
        let groups: Vec<(Vec<T>, Vec<u32>)> = (0..bricks.div_ceil(GROUP))
            .into_par_iter()
            .map(|g| {
                checkpoint();
                let (mut all, mut counts) = (Vec::new(), Vec::new());
                for slot in g * GROUP..((g + 1) * GROUP).min(bricks) {
                    for i in 0..per_brick {
                        let before = all.len();
                        make(slot, i, &mut all);
                        counts.push((all.len() - before) as u32);
                    }
                }
                (all, counts)
            })
            .collect();
        let mut start = Vec::with_capacity(bricks * per_brick + 1);
        let mut at = 0;
        start.push(0);
        for count in groups.iter().flat_map(|g| &g.1) {
            at += count;
            start.push(at);
        }
        let mut all = Vec::with_capacity(at as usize);
        groups.into_iter().for_each(|g| all.extend(g.0));
        Self { all, start }
    }

    /// Places of one list in all.
    #[inline]
    fn of(&self, i: usize) -> std::ops::Range<usize> {
        self.start[i] as usize..self.start[i + 1] as usize
    }

    /// Index of the entry of list `i` that `holds`, which must be there.
    #[inline]
    fn find(&self, i: usize, holds: impl Fn(&T) -> bool) -> u32 {
        let of = self.of(i);
        // Most lists have one entry.
        let at = if of.len() == 1 {
            0
        } else {
            self.all[of.clone()].iter().position(holds).unwrap_or(0)
        };
        (of.start + at) as u32
    }
}

/// The lumen's cells and the distance in them.
struct Cells<'a> {
    lumen: &'a Lumen,
    distance: &'a [f32],
    /// Inside voxels of each.
    bits: Vec<u64>,
    /// Root of the depth of a distance of 1 mm: 2 / h.
    scale: f32,
}

/// Inside voxels of a cell of a brick.
fn bits_of(lumen: &Lumen, cell: usize) -> u64 {
    let (slot, place) = (cell / CELLS, cell % CELLS);
    let (x, y, z) = (place & 1, place >> 1 & 1, place >> 2);
    let mut out = 0;
    for layer in 0..SIDE {
        let word = lumen.inside[slot * 8 + SIDE * z + layer] >> (32 * y + SIDE * x);
        // Rows of eight bits, of which the low four are the cell's.
        let rows = word & 0x0f | word >> 4 & 0xf0 | word >> 8 & 0xf00 | word >> 12 & 0xf000;
        out |= rows << (16 * layer);
    }
    out
}

impl Cells<'_> {
    #[inline]
    fn inside(&self, cell: usize) -> u64 {
        self.bits[cell]
    }

    /// Field element of a cell's voxel.
    #[inline]
    fn element(&self, cell: usize, bit: u32) -> usize {
        let (slot, place) = (cell / CELLS, cell % CELLS);
        let bit = bit as usize;
        let x = SIDE * (place & 1) + (bit & 3);
        let y = SIDE * (place >> 1 & 1) + (bit >> 2 & 3);
        let z = SIDE * (place >> 2) + (bit >> 4);
        slot * BRICK + x + 8 * y + 64 * z
    }

    /// The cell `step` away (components -1, 0, 1), if it is in a brick.
    #[inline]
    fn near(&self, cell: usize, step: [i32; 3]) -> Option<usize> {
        let place = (cell % CELLS) as i32;
        let at = IVec3::new(place & 1, place >> 1 & 1, place >> 2) + IVec3::from(step);
        let over: IVec3 = at >> 1i32;
        let slot = match self.lumen.bricks.near()[cell / CELLS][near_index(over.x, over.y, over.z)]
        {
            NONE => return None,
            s => s as usize,
        };
        Some(CELLS * slot + ((at.x & 1) + 2 * (at.y & 1) + 4 * (at.z & 1)) as usize)
    }

    #[inline]
    fn depth(&self, cell: usize, bit: u32) -> f32 {
        self.distance[self.element(cell, bit)]
    }

    #[inline]
    fn key(&self, d: f32) -> u32 {
        let root = d * self.scale;
        (root * root).round() as u32
    }

    fn nodes(&self, cell: usize, out: &mut Vec<Node>) {
        for voxels in components(self.inside(cell)) {
            let (bit, d) = greatest(cell::voxels(voxels).map(|b| (b, self.depth(cell, b))));
            let deepest = self.element(cell, bit) as u32;
            out.push(Node { voxels, cell: cell as u32, deepest, key: self.key(d) });
        }
    }

    /// Contacts of a cell with the next one along an axis.
    fn contacts(&self, nodes: &Lists<Node>, cell: usize, axis: usize, out: &mut Vec<Contact>) {
        let Some(next) = self.near(cell, unit(axis, 1)).filter(|c| !nodes.of(*c).is_empty()) else {
            return;
        };
        let up = 3 * STEP[axis];
        let shared = self.inside(cell) >> up & self.inside(next) & LOW[axis];
        for mask in components(shared) {
            let pair = |b: u32| self.depth(cell, b + up).min(self.depth(next, b));
            let (bit, d) = greatest(voxels(mask).map(|b| (b, pair(b))));
            out.push(Contact {
                nodes: [
                    nodes.find(cell, |n| n.voxels >> (bit + up) & 1 != 0),
                    nodes.find(next, |n| n.voxels >> bit & 1 != 0),
                ],
                mask,
                axis: axis as u8,
                deepest: [self.element(cell, bit + up), self.element(next, bit)].map(|e| e as u32),
                key: self.key(d),
            });
        }
    }

    /// Runs of the edge along `axis` at the low corner of a cell: where it meets the cells before it
    /// along the two other axes.
    fn runs(&self, contacts: &Lists<Contact>, cell: usize, axis: usize, out: &mut Vec<EdgeRun>) {
        let own = self.inside(cell);
        if own == 0 {
            return;
        }
        let [i, j] = ACROSS[axis];
        let back = |k: usize| unit(k, -1);
        let both = {
            let mut s = back(i);
            s[j] = -1;
            s
        };
        let [Some(ci), Some(cj), Some(cij)] = [back(i), back(j), both].map(|s| self.near(cell, s))
        else {
            return;
        };
        // The voxel of each cell beside the edge, at place 0 along it.
        let (up_i, up_j) = (3 * STEP[i], 3 * STEP[j]);
        let beside = [(cell, 0), (ci, up_i), (cj, up_j), (cij, up_i + up_j)];
        let places =
            beside.iter().fold(0b1111, |m, (c, bit)| m & line(self.inside(*c), *bit, axis));
        let mut left = places;
        while left != 0 {
            let first = left.trailing_zeros();
            let length = (left >> first).trailing_ones();
            let run = ((1u32 << length) - 1) << first;
            left &= !run;
            let square = |t: u32| {
                let d = beside.map(|(c, bit)| self.depth(c, bit + t * STEP[axis]));
                d.into_iter().fold(f32::INFINITY, f32::min)
            };
            let (_, d) = greatest((first..first + length).map(|t| (t, square(t))));
            let at = first * STEP[axis];
            let find = |low: usize, axis: usize, bit: u32| {
                contacts.find(3 * low + axis, |c| c.mask >> bit & 1 != 0)
            };
            out.push(EdgeRun {
                contacts: [
                    find(ci, i, at),
                    find(cij, i, at + up_j),
                    find(cj, j, at),
                    find(cij, j, at + up_i),
                ],
                places: run as u8,
                key: self.key(d),
            });
        }
    }

    /// The corner at the low side of a cell along all axes.
    fn corner(&self, runs: &Lists<EdgeRun>, cell: usize, out: &mut Vec<Corner>) {
        if self.inside(cell) & 1 == 0 {
            return;
        }
        let mut least = f32::INFINITY;
        for n in 0..8u32 {
            let step = [0, 1, 2].map(|k| -((n >> k & 1) as i32));
            let bit = (0..3).map(|k| 3 * STEP[k] * (n >> k & 1)).sum::<u32>();
            match self.near(cell, step) {
                Some(c) if self.inside(c) >> bit & 1 != 0 => least = least.min(self.depth(c, bit)),
                _ => return,
            }
        }
        let run = |c: usize, axis: usize, place: u8| {
            runs.find(3 * c + axis, |r| r.places >> place & 1 != 0)
        };
        let mut all = [0; 6];
        for axis in 0..3 {
            let Some(before) = self.near(cell, unit(axis, -1)) else { return };
            (all[2 * axis], all[2 * axis + 1]) = (run(before, axis, 3), run(cell, axis, 0));
        }
        out.push(Corner { runs: all, key: self.key(least) });
    }
}

/// A step along an axis.
fn unit(axis: usize, step: i32) -> [i32; 3] {
    let mut out = [0; 3];
    out[axis] = step;
    out
}

/// Bits of the four voxels along an axis from the one at `bit` of place 0 on.
#[inline]
fn line(set: u64, bit: u32, axis: usize) -> u32 {
    let set = set >> bit;
    (0..4).fold(0, |m, t| m | ((set >> (t * STEP[axis]) & 1) as u32) << t)
}

/// The entry with the greatest depth, of several the first.
#[inline]
fn greatest(all: impl Iterator<Item = (u32, f32)>) -> (u32, f32) {
    all.fold((0, -1.0), |best, next| if next.1 > best.1 { next } else { best })
}

impl CellComplex {
    /// The complex of a lumen's cells of 4³ voxels. `distance`: exact distance to the wall, mm, in
    /// slot order.
    pub(super) fn of_cells(lumen: &Lumen, distance: &[f32]) -> Self {
        let h = lumen.grid.spacing_mm.min_element();
        let bricks = lumen.bricks.len();
        let bits = (0..CELLS * bricks).into_par_iter().with_min_len(4096);
        let bits = bits.map(|cell| bits_of(lumen, cell)).collect();
        let cells = Cells { lumen, distance, bits, scale: (2.0 / h) as f32 };
        let nodes = Lists::new(bricks, CELLS, |s, i, out| cells.nodes(CELLS * s + i, out));
        let contacts = Lists::new(bricks, 3 * CELLS, |s, i, out| {
            cells.contacts(&nodes, CELLS * s + i / 3, i % 3, out);
        });
        let runs = Lists::new(bricks, 3 * CELLS, |s, i, out| {
            cells.runs(&contacts, CELLS * s + i / 3, i % 3, out);
        });
        let corners = Lists::new(bricks, CELLS, |s, i, out| {
            cells.corner(&runs, CELLS * s + i, out);
        });
        Self {
            nodes: nodes.all,
            contacts: contacts.all,
            runs: runs.all,
            corners: corners.all,
            node_of: Vec::new(),
        }
    }
}
