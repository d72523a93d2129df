//! Thin bronchi beyond the threshold of the tree: leak control at every branch.
//!
//! Partial volume makes a bronchus of a voxel or two brighter than the threshold at which the widest
//! hole in some wall leaks. So the threshold is raised on, and what is new is judged piece by piece:
//! a small piece is a bronchus and joins the tree; a large one is lung, and the mouth through which
//! it was reached is closed for good. Explosion control branch by branch goes back to Tschirren et
//! al. 2005 (doi:10.1109/TMI.2005.857654); constants are ours.

use glam::{IVec3, UVec3};

use super::SIDES;
use super::values::LEAST_HU;
use crate::lumen::BitVolume;
use crate::volume::Volume;

/// How far the threshold is raised, HU, and by how much at a time.
const RISE_HU: f64 = 160.0;
const STEP_HU: f64 = 8.0;
/// Largest piece that joins at one threshold, ml.
const MOST_PIECE_ML: f64 = 0.25;
/// Pieces that stay smaller than this are no branch but roughness, ml.
const LEAST_PIECE_ML: f64 = 0.01;
/// Most that may be added, as a share of the tree: beyond it this is lung, found bit by bit.
const MOST_ADDED: f64 = 0.5;

/// What was added to a tree.
pub(super) struct Added {
    /// The tree with its thin bronchi.
    pub mask: BitVolume,
    /// How many connected pieces, and their volume.
    pub pieces: usize,
    pub ml: f64,
    /// Voxels where it would have leaked.
    pub leaks: usize,
}

/// Adds thin bronchi to a tree that was grown up to a threshold. The rim of the tree, a voxel wide,
/// stays outside except where a bronchus passes it: its partial volume would join everything.
/// Nothing where more than half of the tree's volume would be added.
pub(super) fn grow(volume: &Volume, tree: &BitVolume, threshold: f64) -> Option<Added> {
    let voxel_ml = volume.grid.voxel_mm3() / 1000.0;
    let mut growth = Growth {
        volume,
        rim: rim(tree),
        tree: tree.clone(),
        closed: BitVolume::new(volume.grid.dims),
        front: Vec::new(),
        most: (MOST_PIECE_ML / voxel_ml).max(1.0) as usize,
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
    let least = LEAST_PIECE_ML / voxel_ml;
    let (mut mask, mut pieces, mut ml) = (tree.clone(), 0, 0.0);
    for piece in pieces_of(&added).iter().filter(|p| p.len() as f64 >= least) {
        piece.iter().for_each(|v| mask.set(v.x as u32, v.y as u32, v.z as u32));
        pieces += 1;
        ml += piece.len() as f64 * voxel_ml;
    }
    let fits = ml <= MOST_ADDED * tree.count() as f64 * voxel_ml;
    fits.then_some(Added { mask, pieces, ml, leaks: growth.leaks })
}

/// A tree while the threshold is raised.
struct Growth<'a> {
    volume: &'a Volume,
    tree: BitVolume,
    /// Voxels beside the tree as it was.
    rim: BitVolume,
    /// Mouths of leaks.
    closed: BitVolume,
    /// Voxels that new pieces may start beside: the rim, and what was added.
    front: Vec<IVec3>,
    /// Voxels of the largest piece.
    most: usize,
    leaks: usize,
}

impl Growth<'_> {
    /// Whether a voxel has a value of air or of a thin bronchus.
    fn is_dark(&self, v: IVec3, level: f64) -> bool {
        let within = self.volume.grid.contains(v);
        within
            && (LEAST_HU..=level).contains(&self.volume.real(self.volume.grid.index(v.as_uvec3())))
    }

    /// Whether a voxel may belong to a new piece.
    fn is_new(&self, v: IVec3, level: f64) -> bool {
        self.is_dark(v, level) && !self.tree.get(v) && !self.rim.get(v) && !self.closed.get(v)
    }

    /// Takes the small pieces in that a threshold adds, and closes the mouths of the large ones.
    fn raise(&mut self, level: f64) {
        let mut seen = BitVolume::new(self.volume.grid.dims);
        let mut large = BitVolume::new(self.volume.grid.dims);
        let mut joined: Vec<Vec<IVec3>> = Vec::new();
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
                    match self.piece(v, level, &mut seen, &large) {
                        Ok(piece) => joined.push(piece),
                        Err(part) => part.iter().for_each(|v| set(&mut large, *v)),
                    }
                }
                if large.get(v) {
                    set(&mut self.closed, v);
                    self.leaks += 1;
                }
            }
        }
        for v in joined.into_iter().flatten() {
            set(&mut self.tree, v);
            self.front.push(v);
            // The way through the rim, which is beside the tree.
            for r in SIDES.map(|side| v + side) {
                if self.rim.get(r) && self.is_dark(r, level) {
                    set(&mut self.tree, r);
                }
            }
        }
    }

    /// The piece of a voxel, or as much of one as shows that it is large.
    fn piece(
        &self,
        start: IVec3,
        level: f64,
        seen: &mut BitVolume,
        large: &BitVolume,
    ) -> Result<Vec<IVec3>, Vec<IVec3>> {
        let mut piece = vec![start];
        let mut next = 0;
        set(seen, start);
        let mut is_large = false;
        while let Some(at) = piece.get(next).copied().filter(|_| !is_large) {
            next += 1;
            for v in SIDES.map(|side| at + side) {
                if large.get(v) {
                    is_large = true;
                } else if self.is_new(v, level) && !seen.get(v) {
                    set(seen, v);
                    piece.push(v);
                }
            }
            is_large |= piece.len() > self.most;
        }
        if is_large { Err(piece) } else { Ok(piece) }
    }
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
