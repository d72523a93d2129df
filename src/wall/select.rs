//! Selection of the lumen's voxels by the sign of the field.

use std::collections::{BTreeSet, HashMap};

use rayon::prelude::*;

use crate::lumen::bricks::BRICK;
use crate::lumen::{BitVolume, Bricks, Piece, Run, fill_cavities, pieces};

/// Least size of a component, as a share of the largest one's voxels.
const MIN_SHARE: f64 = 0.0005;

/// Least size of a further part of a component of the core, as a share of the largest part's
/// voxels. A smaller one is a splinter, such as the root of a side branch that the field closes.
const MIN_SHARE_OF_CORE: f64 = 0.005;

/// Returns the 6-components of `is_lumen` that meet the core, without splinters, cavities filled;
/// `None` where there is none.
pub(super) fn lumen(
    bricks: &Bricks,
    core: &BitVolume,
    is_lumen: impl Fn(usize) -> bool + Sync,
) -> Option<BitVolume> {
    // One byte a row of a brick, which lies within a word of the grid's row.
    let rows: Vec<[u8; 64]> = (0..bricks.len())
        .into_par_iter()
        .with_min_len(16)
        .map(|slot| {
            std::array::from_fn(|row| {
                let at = slot * BRICK + 8 * row;
                (0..8).fold(0, |byte, x| byte | u8::from(is_lumen(at + x)) << x)
            })
        })
        .collect();
    let mut all = BitVolume::new(core.dims());
    for (rows, corner) in rows.iter().zip(bricks.corners()) {
        for (r, byte) in rows.iter().enumerate().filter(|(_, byte)| **byte != 0) {
            let (y, z) = (corner[1] + (r as i32 & 7), corner[2] + (r as i32 >> 3));
            all.set_byte(corner[0], y, z, *byte);
        }
    }
    let found = pieces(&all, 1);
    let least = MIN_SHARE * found.first()?.component.voxels as f64;
    let cores = CorePieces::new(core);
    let mut largest = vec![0u64; cores.count];
    let mut out = BitVolume::new(core.dims());
    // Largest first.
    for piece in found.iter().take_while(|p| p.component.voxels as f64 >= least) {
        let voxels = piece.component.voxels;
        let mut is_wanted = false;
        for core in cores.met_by(piece) {
            is_wanted |= voxels as f64 >= MIN_SHARE_OF_CORE * largest[core] as f64;
            largest[core] = largest[core].max(voxels);
        }
        if is_wanted {
            piece.runs.iter().for_each(|&(run, y, z)| out.set_run(run, y, z));
        }
    }
    fill_cavities(&mut out);
    (!out.is_empty()).then_some(out)
}

/// Components of a core, by the rows of their voxels.
struct CorePieces {
    rows: HashMap<(u32, u32), Vec<(Run, usize)>>,
    count: usize,
}

impl CorePieces {
    fn new(core: &BitVolume) -> Self {
        let all = pieces(core, 1);
        let mut rows: HashMap<_, Vec<_>> = HashMap::new();
        for (i, piece) in all.iter().enumerate() {
            for &(run, y, z) in &piece.runs {
                rows.entry((y, z)).or_default().push((run, i));
            }
        }
        Self { rows, count: all.len() }
    }

    /// Returns the components of the core that share a voxel with a piece, each once.
    fn met_by(&self, piece: &Piece) -> BTreeSet<usize> {
        let mut met = BTreeSet::new();
        for &((a, b), y, z) in &piece.runs {
            let row = self.rows.get(&(y, z)).into_iter().flatten();
            met.extend(row.filter(|((c, d), _)| *c <= b && a <= *d).map(|(_, i)| *i));
        }
        met
    }
}
