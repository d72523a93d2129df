//! 6-connected components of a bit volume, and its closed cavities, by union of x-runs. The cost
//! follows the rows of the box and the number of runs, not the voxels.

use std::collections::BTreeMap;

use glam::UVec3;

use super::body::BodyHull;
use super::{BitVolume, bits::Run};
use crate::geometry::DisjointSets;
use crate::volume::Grid;

/// Size and position of a connected component.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Component {
    /// Number of voxels.
    pub voxels: u64,
    /// First voxel of the component in z, y, x order.
    pub first: UVec3,
}

impl Component {
    /// Volume, ml.
    pub fn volume_ml(&self, grid: &Grid) -> f64 {
        self.voxels as f64 * grid.voxel_mm3() / 1000.0
    }
}

/// Runs of a box of rows, joined to components.
pub(super) struct RunSet {
    lo: UVec3,
    /// Rows of a slice of the box.
    pub rows_y: u32,
    /// First run of each row, and the end.
    row_start: Vec<u32>,
    pub runs: Vec<Run>,
    /// Runs of one component are one set.
    pub sets: DisjointSets,
}

impl RunSet {
    pub fn of(bits: &BitVolume, lo: UVec3, hi: UVec3, background: bool) -> Self {
        let rows_y = hi.y - lo.y + 1;
        let mut set = Self {
            lo,
            rows_y,
            row_start: vec![0],
            runs: Vec::new(),
            sets: DisjointSets::default(),
        };
        for z in lo.z..=hi.z {
            for y in lo.y..=hi.y {
                if background {
                    let mut x = lo.x;
                    for (a, b) in bits.runs(y, z) {
                        if a > x {
                            set.runs.push((x, a - 1));
                        }
                        x = b + 1;
                    }
                    if x <= hi.x {
                        set.runs.push((x, hi.x));
                    }
                } else {
                    set.runs.extend(bits.runs(y, z));
                }
                set.row_start.push(set.runs.len() as u32);
            }
        }
        set.sets = DisjointSets::new(set.runs.len());
        set.join();
        set
    }

    /// Runs of a row.
    pub fn row(&self, r: usize) -> std::ops::Range<usize> {
        self.row_start[r] as usize..self.row_start[r + 1] as usize
    }

    fn join(&mut self) {
        let rows = self.row_start.len() - 1;
        for r in 0..rows {
            if !(r as u32).is_multiple_of(self.rows_y) {
                self.join_rows(r - 1, r);
            }
            if r as u32 >= self.rows_y {
                self.join_rows(r - self.rows_y as usize, r);
            }
        }
    }

    fn join_rows(&mut self, a: usize, b: usize) {
        let (ra, rb) = (self.row(a), self.row(b));
        let (mut i, mut j) = (ra.start, rb.start);
        while i < ra.end && j < rb.end {
            let ((a0, a1), (b0, b1)) = (self.runs[i], self.runs[j]);
            if a0 <= b1 && b0 <= a1 {
                self.sets.join(i as u32, j as u32);
            }
            if a1 < b1 { i += 1 } else { j += 1 }
        }
    }

    /// Rows of the box: number, y and z.
    pub fn rows(&self) -> impl Iterator<Item = (usize, u32, u32)> + use<> {
        let (lo, rows_y) = (self.lo, self.rows_y);
        (0..self.row_start.len() - 1)
            .map(move |r| (r, lo.y + r as u32 % rows_y, lo.z + r as u32 / rows_y))
    }
}

/// Mask split into its 6-connected components.
pub(super) struct Split {
    /// Voxels of the components kept.
    pub kept: BitVolume,
    /// The largest component kept; `None` where all lie outside the body.
    pub largest: Option<Component>,
    /// Components in the body that are not kept, largest first.
    pub others: Vec<Component>,
    /// Components outside the body, largest first.
    pub outside: Vec<Component>,
}

/// The 6-component of a mask that holds a voxel; nothing where that is not set.
pub(super) fn containing(bits: &BitVolume, voxel: UVec3) -> BitVolume {
    let mut out = BitVolume::new(bits.dims());
    let Some((lo, hi)) = bits.bounds().filter(|_| bits.get(voxel.as_ivec3())) else { return out };
    let mut set = RunSet::of(bits, lo, hi, false);
    let row = set.row(((voxel.y - lo.y) + set.rows_y * (voxel.z - lo.z)) as usize);
    let holds = |i: &usize| set.runs[*i].0 <= voxel.x && voxel.x <= set.runs[*i].1;
    let own = row.clone().find(holds).map(|i| set.sets.root(i as u32));
    for (r, y, z) in set.rows() {
        for i in set.row(r) {
            if Some(set.sets.root(i as u32)) == own {
                out.set_run(set.runs[i], y, z);
            }
        }
    }
    out
}

/// The largest 6-component of a mask.
pub(super) fn largest(bits: &BitVolume) -> Option<BitVolume> {
    split(bits, None, false).map(|split| split.kept)
}

/// Takes a mask apart and keeps its largest 6-component, or all of them, but none that lies outside
/// the body: that touches a side face of the volume and of which less than half lies in the body's
/// hull. Equal sizes go by first voxel. `None` for an empty mask.
///
/// * `body`: without it nothing lies outside.
pub(super) fn split(bits: &BitVolume, body: Option<&BodyHull>, all: bool) -> Option<Split> {
    let (lo, hi) = bits.bounds()?;
    let mut set = RunSet::of(bits, lo, hi, false);
    let mut sizes = vec![0u64; set.runs.len()];
    let mut firsts = vec![UVec3::ZERO; set.runs.len()];
    // Of those that touch a side: voxels in the body.
    let mut sides = BTreeMap::new();
    for (r, y, z) in set.rows() {
        for i in set.row(r) {
            let root = set.sets.root(i as u32) as usize;
            if root == i {
                firsts[i] = UVec3::new(set.runs[i].0, y, z);
            }
            sizes[root] += u64::from(set.runs[i].1 - set.runs[i].0 + 1);
            if body.is_some_and(|body| body.touches_side(set.runs[i], y, z)) {
                sides.insert(root, 0u64);
            }
        }
    }
    if let Some(body) = body.filter(|_| !sides.is_empty()) {
        for (r, y, z) in set.rows() {
            for i in set.row(r) {
                let root = set.sets.root(i as u32) as usize;
                if let Some(held) = sides.get_mut(&root) {
                    *held += body.count(set.runs[i], y, z);
                }
            }
        }
    }
    let is_outside = |i: usize| sides.get(&i).is_some_and(|held| 2 * held < sizes[i]);
    let roots = || (0..sizes.len()).filter(|&i| sizes[i] > 0);
    let kept = roots().filter(|&i| !is_outside(i)).max_by_key(|&i| (sizes[i], usize::MAX - i));
    let keeps = |i: usize| Some(i) == kept || all && !is_outside(i);
    let mut out = BitVolume::new(bits.dims());
    for (r, y, z) in set.rows() {
        for i in set.row(r) {
            if keeps(set.sets.root(i as u32) as usize) {
                out.set_run(set.runs[i], y, z);
            }
        }
    }
    let component = |i: usize| Component { voxels: sizes[i], first: firsts[i] };
    let sorted = |of: &dyn Fn(usize) -> bool| {
        let mut list: Vec<_> = roots().filter(|&i| of(i)).map(component).collect();
        list.sort_by_key(|c| (std::cmp::Reverse(c.voxels), c.first.z, c.first.y, c.first.x));
        list
    };
    Some(Split {
        kept: out,
        largest: kept.map(component),
        others: sorted(&|i| !is_outside(i) && !keeps(i)),
        outside: sorted(&is_outside),
    })
}

/// A 6-connected component as runs of voxels.
#[derive(Clone, Debug)]
pub struct Piece {
    /// Number of voxels and first voxel.
    pub component: Component,
    /// Runs of the component's voxels (x range, y, z), in z, y, x order.
    pub runs: Vec<(Run, u32, u32)>,
}

impl Piece {
    /// Returns the component as a mask of a grid of `dims` voxels.
    pub fn mask(&self, dims: UVec3) -> BitVolume {
        let mut out = BitVolume::new(dims);
        self.runs.iter().for_each(|&(run, y, z)| out.set_run(run, y, z));
        out
    }

    /// Voxels of the component, in z, y, x order.
    pub fn voxels(&self) -> impl Iterator<Item = UVec3> + '_ {
        self.runs.iter().flat_map(|&((a, b), y, z)| (a..=b).map(move |x| UVec3::new(x, y, z)))
    }

    /// Bounding box of the component, inclusive corners.
    pub fn bounds(&self) -> (UVec3, UVec3) {
        self.runs.iter().fold((UVec3::MAX, UVec3::ZERO), |(lo, hi), &((a, b), y, z)| {
            (lo.min(UVec3::new(a, y, z)), hi.max(UVec3::new(b, y, z)))
        })
    }
}

/// The 6-components of a mask that have this many voxels or more, largest first; of equal sizes the
/// one with the first voxel.
pub fn pieces(bits: &BitVolume, least_voxels: u64) -> Vec<Piece> {
    let Some((lo, hi)) = bits.bounds() else { return Vec::new() };
    let mut set = RunSet::of(bits, lo, hi, false);
    let mut sizes = vec![0u64; set.runs.len()];
    for i in 0..set.runs.len() {
        let root = set.sets.root(i as u32) as usize;
        sizes[root] += u64::from(set.runs[i].1 - set.runs[i].0 + 1);
    }
    let mut number = BTreeMap::new();
    let mut out: Vec<Piece> = Vec::new();
    for (r, y, z) in set.rows() {
        for i in set.row(r) {
            let root = set.sets.root(i as u32) as usize;
            if sizes[root] < least_voxels.max(1) {
                continue;
            }
            let run = set.runs[i];
            let at = *number.entry(root).or_insert_with(|| {
                let component = Component { voxels: sizes[root], first: UVec3::new(run.0, y, z) };
                out.push(Piece { component, runs: Vec::new() });
                out.len() - 1
            });
            out[at].runs.push((run, y, z));
        }
    }
    out.sort_by_key(|p| std::cmp::Reverse(p.component.voxels));
    out
}

/// Fills closed cavities: 6-components of the background that do not reach the outside of the
/// grid. Returns how many voxels and cavities were filled.
pub fn fill_cavities(bits: &mut BitVolume) -> (u64, usize) {
    let Some((lo, hi)) = bits.bounds() else { return (0, 0) };
    let mut set = RunSet::of(bits, lo, hi, true);
    // Background that reaches the box reaches the outside: nothing of the mask lies beyond it.
    let mut open = vec![false; set.runs.len()];
    for (r, y, z) in set.rows() {
        let edge = y == lo.y || y == hi.y || z == lo.z || z == hi.z;
        for i in set.row(r) {
            let (a, b) = set.runs[i];
            if edge || a == lo.x || b == hi.x {
                let root = set.sets.root(i as u32) as usize;
                open[root] = true;
            }
        }
    }
    let (mut voxels, mut cavities) = (0, 0);
    for (r, y, z) in set.rows() {
        for i in set.row(r) {
            let root = set.sets.root(i as u32) as usize;
            if !open[root] {
                let (a, b) = set.runs[i];
                bits.set_run((a, b), y, z);
                voxels += u64::from(b - a + 1);
                cavities += usize::from(root == i);
            }
        }
    }
    (voxels, cavities)
}
