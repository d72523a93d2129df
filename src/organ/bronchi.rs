//! Thin bronchi beyond the threshold of the tree: leak control at every branch.
//!
//! Partial volume makes a bronchus of a voxel or two brighter than the threshold at which the
//! widest hole in some wall leaks. So the threshold is raised further, and each new piece is judged
//! by itself: a small piece is a bronchus and joins the tree; a large one is lung, and the mouth
//! through which it was reached is closed for good. A branch can lie right behind such a mouth,
//! beyond a narrow place (mucus, a stenosis, partial volume): air that this or a lower threshold
//! separates from lung, and that has a wall about it. It joins the tree with the way to it.
//! Explosion control branch by branch goes back to Tschirren et al. 2005
//! (doi:10.1109/TMI.2005.857654); constants are ours.

use glam::{IVec3, UVec3};

use super::SIDES;
use super::numbers::of_airway::bronchi::*;
use super::values::MIN_HU;
use super::walled::walled;
use crate::lumen::BitVolume;
use crate::volume::Volume;

/// Tree with the bronchi added to it.
pub(super) struct Added {
    /// The tree with its thin bronchi.
    pub mask: BitVolume,
    /// Number of thin bronchi added, as connected pieces, and their volume, ml.
    pub pieces: usize,
    pub ml: f64,
    /// Number of branches added behind a narrow place, and their volume, ml.
    pub branches: usize,
    pub branches_ml: f64,
    /// Number of voxels where it would have leaked.
    pub leaks: usize,
}

/// Adds thin bronchi to a tree that was grown up to a threshold. The rim of the tree, a voxel wide,
/// stays outside except where a bronchus passes it: its partial volume would join everything.
/// `None` where more than half of the tree's volume would be added.
pub(super) fn grow(volume: &Volume, tree: &BitVolume, threshold: f64) -> Option<Added> {
    let voxel_ml = volume.grid.voxel_mm3() / 1000.0;
    let mut growth = Growth {
        volume,
        rim: rim(tree),
        tree: tree.clone(),
        closed: BitVolume::new(volume.grid.dims),
        front: Vec::new(),
        branches: BitVolume::new(volume.grid.dims),
        threshold,
        refused: vec![BitVolume::new(volume.grid.dims); FALLS],
        most: (MAX_PIECE_ML / voxel_ml).max(1.0) as usize,
        most_branch: (MAX_BRANCH_ML / voxel_ml) as usize,
        leaks: 0,
    };
    growth.front.extend(growth.rim.voxels().map(|v| v.as_ivec3()));
    let mut level = threshold + STEP_HU;
    while level <= threshold + RISE_HU {
        crate::task::checkpoint();
        growth.raise(level);
        level += STEP_HU;
    }
    let mut added = growth.tree;
    added.remove(tree);
    added.remove(&growth.branches);
    let least = MIN_PIECE_ML / voxel_ml;
    let (mut mask, mut pieces, mut ml) = (tree.clone(), 0, 0.0);
    mask.add(&growth.branches);
    let branches = pieces_of(&growth.branches);
    let branches_ml = growth.branches.count() as f64 * voxel_ml;
    for piece in pieces_of(&added).iter().filter(|p| p.len() as f64 >= least) {
        piece.iter().for_each(|v| mask.set(v.x as u32, v.y as u32, v.z as u32));
        pieces += 1;
        ml += piece.len() as f64 * voxel_ml;
    }
    let fits = ml <= MAX_ADDED * (tree.count() as f64 * voxel_ml + branches_ml);
    // A piece that was left out may have held the way to a branch.
    let mask = crate::lumen::pieces(&mask, 1).first()?.mask(mask.dims());
    fits.then_some(Added {
        mask,
        pieces,
        ml,
        branches: branches.len(),
        branches_ml,
        leaks: growth.leaks,
    })
}

/// A tree while the threshold is raised.
struct Growth<'a> {
    volume: &'a Volume,
    tree: BitVolume,
    /// Voxels that share a side with the tree as it was, or with a branch added since.
    rim: BitVolume,
    /// Voxels at the mouths of leaks.
    closed: BitVolume,
    /// Voxels beside which new pieces may start: the rim, and the voxels added.
    front: Vec<IVec3>,
    /// Branches behind narrow places, with the ways to them.
    branches: BitVolume,
    /// Threshold of the tree, HU.
    threshold: f64,
    /// Air that is no branch, at the tree's threshold and at each lower one that is tried.
    refused: Vec<BitVolume>,
    /// Largest number of voxels of a piece, and of a branch.
    most: usize,
    most_branch: usize,
    leaks: usize,
}

impl Growth<'_> {
    /// Whether a voxel has a value of air or of a thin bronchus.
    fn is_dark(&self, v: IVec3, level: f64) -> bool {
        let within = self.volume.grid.contains(v);
        within && (MIN_HU..=level).contains(&self.volume.real(self.volume.grid.index(v.as_uvec3())))
    }

    /// Whether a voxel may belong to a new piece.
    fn is_new(&self, v: IVec3, level: f64) -> bool {
        self.is_dark(v, level) && !self.tree.get(v) && !self.rim.get(v) && !self.closed.get(v)
    }

    /// Takes the small pieces in that a threshold adds, and closes the mouths of the large ones.
    fn raise(&mut self, level: f64) {
        let mut seen = BitVolume::new(self.volume.grid.dims);
        let mut large = BitVolume::new(self.volume.grid.dims);
        let (mut joined, mut branches) = (Vec::new(), Vec::new());
        for at in 0..self.front.len() {
            let from = self.front[at];
            // The rim is passed only where it is dark; what was added is.
            if self.rim.get(from) && !self.is_dark(from, level) {
                continue;
            }
            for v in SIDES.map(|side| from + side) {
                if !self.is_new(v, level) {
                    continue;
                }
                if !seen.get(v) {
                    let piece = self.piece(v, level, &mut seen, &large);
                    if piece.is_large {
                        piece.voxels.iter().for_each(|v| set(&mut large, *v));
                        branches.extend(self.branch(&piece).map(|branch| (from, branch)));
                    } else {
                        joined.extend(piece.voxels);
                    }
                }
                if large.get(v) {
                    set(&mut self.closed, v);
                    self.leaks += 1;
                }
            }
        }
        for v in joined {
            set(&mut self.tree, v);
            self.front.push(v);
            // The way through the rim, which is beside the tree.
            for r in SIDES.map(|side| v + side) {
                if self.rim.get(r) && self.is_dark(r, level) {
                    set(&mut self.tree, r);
                }
            }
        }
        for (from, branch) in branches {
            self.join(from, &branch);
        }
    }

    /// Takes in a branch and gives it a rim of its own.
    fn join(&mut self, from: IVec3, branch: &[IVec3]) {
        let mut mask = BitVolume::new(self.volume.grid.dims);
        branch.iter().chain([&from]).for_each(|v| set(&mut mask, *v));
        self.tree.add(&mask);
        self.branches.add(&mask);
        let mut rim = rim(&mask);
        rim.remove(&self.tree);
        self.front.extend(rim.voxels().map(|v| v.as_ivec3()));
        self.rim.add(&rim);
    }

    /// The piece of a voxel, or as much of one as shows that it is large.
    fn piece(&self, start: IVec3, level: f64, seen: &mut BitVolume, large: &BitVolume) -> NewPiece {
        let mut piece = NewPiece { voxels: vec![start], before: vec![0], is_large: false };
        let mut next = 0;
        set(seen, start);
        while let Some(at) = piece.voxels.get(next).copied().filter(|_| !piece.is_large) {
            for v in SIDES.map(|side| at + side) {
                if large.get(v) {
                    piece.is_large = true;
                } else if self.is_new(v, level) && !seen.get(v) {
                    set(seen, v);
                    piece.voxels.push(v);
                    piece.before.push(next);
                }
            }
            next += 1;
            piece.is_large |= piece.voxels.len() > self.most;
        }
        piece
    }

    /// The branch behind a mouth with the way to it: at the highest threshold, from that of the tree
    /// down, that parts it from lung.
    fn branch(&mut self, mouth: &NewPiece) -> Option<Vec<IVec3>> {
        (0..self.refused.len()).find_map(|fall| self.branch_at(mouth, fall))
    }

    /// Finds the branch behind a mouth at the `fall`-th threshold below that of the tree.
    fn branch_at(&mut self, mouth: &NewPiece, fall: usize) -> Option<Vec<IVec3>> {
        let level = self.threshold - FALL_HU * fall as f64;
        for (entry, start) in mouth.voxels.iter().enumerate() {
            let is_air = |v: IVec3| self.is_dark(v, level) && !self.tree.get(v);
            if self.refused[fall].get(*start) || !is_air(*start) {
                continue;
            }
            let mut seen = std::collections::HashSet::from([*start]);
            let mut air = vec![*start];
            let mut next = 0;
            let mut is_lung = false;
            while let Some(at) = air.get(next).copied().filter(|_| !is_lung) {
                next += 1;
                for v in SIDES.map(|side| at + side).into_iter().filter(|v| is_air(*v)) {
                    is_lung |= self.refused[fall].get(v);
                    if seen.insert(v) {
                        air.push(v);
                    }
                }
                is_lung |= air.len() > self.most_branch;
            }
            let part = air.iter().map(|v| v.as_uvec3());
            let is_branch = !is_lung
                && air.len() > self.most
                && walled(self.volume, part, |v| seen.contains(&v)) >= MIN_WALLED;
            if !is_branch {
                air.iter().for_each(|v| set(&mut self.refused[fall], *v));
                continue;
            }
            let mut at = entry;
            while at > 0 {
                at = mouth.before[at];
                air.push(mouth.voxels[at]);
            }
            return Some(air);
        }
        None
    }
}

/// A 6-connected piece that is not of the tree, from where it was met on.
struct NewPiece {
    voxels: Vec<IVec3>,
    /// Index in `voxels` of each voxel's predecessor on the way from the first.
    before: Vec<usize>,
    /// Whether it is larger than a thin bronchus; then these are not all its voxels.
    is_large: bool,
}

fn set(mask: &mut BitVolume, v: IVec3) {
    let UVec3 { x, y, z } = v.as_uvec3();
    mask.set(x, y, z);
}

/// Voxels outside a mask that share a side with it.
fn rim(mask: &BitVolume) -> BitVolume {
    let mut rim = BitVolume::new(mask.dims());
    let dims = mask.dims().as_ivec3();
    for v in mask.voxels() {
        for n in SIDES.map(|side| v.as_ivec3() + side) {
            if n.cmpge(IVec3::ZERO).all() && n.cmplt(dims).all() && !mask.get(n) {
                set(&mut rim, n);
            }
        }
    }
    rim
}

/// The 6-connected pieces of a mask.
fn pieces_of(mask: &BitVolume) -> Vec<Vec<IVec3>> {
    let mut seen = BitVolume::new(mask.dims());
    let mut out = Vec::new();
    for start in mask.voxels().map(|v| v.as_ivec3()) {
        if seen.get(start) {
            continue;
        }
        let mut piece = vec![start];
        set(&mut seen, start);
        let mut next = 0;
        while let Some(at) = piece.get(next).copied() {
            next += 1;
            for v in SIDES.map(|side| at + side) {
                if mask.get(v) && !seen.get(v) {
                    set(&mut seen, v);
                    piece.push(v);
                }
            }
        }
        out.push(piece);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Grid;

    /// A tube of air along x in lung, and a branch of it whose values rise along y. A second branch
    /// like it opens into darker lung.
    fn branches() -> (Volume, BitVolume) {
        let grid = Grid::axis_aligned([60, 50, 20], [0.7; 3]);
        let mut tree = BitVolume::new(grid.dims);
        let mut values = vec![-700i16; grid.len()];
        for (i, value) in values.iter_mut().enumerate() {
            let v = grid.voxel(i).as_ivec3();
            let (y, z) = (v.y - 10, v.z - 10);
            if y * y + z * z <= 16 {
                *value = -1000;
                set(&mut tree, v);
            } else if y * y + z * z <= 36 {
                *value = 0;
            }
            let is_branch = |x: i32| (v.x == x || v.x == x + 1) && (v.z == 10 || v.z == 11);
            if y > 3 && (is_branch(15) || is_branch(40)) && v.y < 40 {
                *value = (-905 + 2 * v.y) as i16;
            }
            if v.x > 30 && v.y > 30 {
                *value = -870;
            }
        }
        (Volume::new(grid, values.into()), tree)
    }

    #[test]
    fn a_thin_branch_joins_the_tree_and_one_that_opens_into_lung_is_closed() {
        let (volume, tree) = branches();
        let added = grow(&volume, &tree, -900.0).unwrap();
        assert!((15..40).all(|y| added.mask.get(IVec3::new(15, y, 10))), "the branch to its end");
        assert!(added.mask.get(IVec3::new(40, 20, 10)), "the other before the lung");
        assert!(!added.mask.get(IVec3::new(40, 45, 15)) && !added.mask.get(IVec3::new(35, 35, 3)));
        assert!(added.leaks > 0 && added.pieces == 2, "{} {}", added.leaks, added.pieces);
        assert!(added.ml < 0.25, "{}", added.ml);
        assert_eq!(pieces_of(&added.mask).len(), 1, "all is joined");
    }

    #[test]
    fn a_tree_in_dark_lung_gains_nothing() {
        let (volume, tree) = branches();
        let mut lung = volume.clone();
        if let crate::volume::Samples::I16(values) = &mut lung.samples {
            values.iter_mut().filter(|v| **v == -700 || **v == 0).for_each(|v| *v = -880);
        }
        let added = grow(&lung, &tree, -900.0).unwrap();
        assert_eq!(added.mask.count(), tree.count());
    }
}
