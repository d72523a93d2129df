//! Branches of a tube, followed by a front that moves away from it layer by layer (after
//! Schlathölter et al. 2002, doi:10.1117/12.467061): a vessel keeps its cross section or divides; a
//! front that widens has entered a heart chamber, a kidney, a vein or bone, and is taken back.

use glam::IVec3;

use super::SIDES;
use super::numbers::of_airway::branches::*;
use crate::lumen::BitVolume;
use crate::lumen::bricks::near_offset;
use crate::volume::Grid;

/// Tube whose surface fronts start from, with the limits of their areas.
pub(super) struct Mouths<'a> {
    pub tube: &'a BitVolume,
    /// The index axis along the tube, and its first and last slice.
    pub along: (usize, u32, u32),
    /// Greatest total area of the fronts of a side branch, and of the continuation beyond an end of
    /// the tube, mm².
    pub side_mm2: f64,
    pub end_mm2: f64,
}

/// Branches followed from a tube.
pub(super) struct ArteryBranches {
    /// The branches, without the tube.
    pub mask: BitVolume,
    /// Number of branches taken back because their fronts grew too large.
    pub taken_back: usize,
}

/// A part of a branch without forks.
struct Stretch {
    /// Index of the mouth where its branch began.
    root: usize,
    parent: Option<usize>,
    children: usize,
    /// The round of its first layer.
    first_round: usize,
    layers: Vec<Vec<IVec3>>,
}

/// Branch that began at a mouth, with all it divides into.
struct Root {
    /// Greatest total area of its fronts, mm².
    limit_mm2: f64,
    /// Total area of its fronts in each round, mm².
    areas_mm2: Vec<f64>,
    is_open: bool,
}

/// Follows all branches of a tube inside a mask.
pub(super) fn follow(grid: &Grid, allowed: &BitVolume, mouths: &Mouths) -> ArteryBranches {
    let mean_step_mm = grid.voxel_mm3().cbrt();
    let area_mm2 = |layer: &[IVec3]| layer.len() as f64 * mean_step_mm.powi(2) / LAYER_FACTOR;
    let mut seen = mouths.tube.clone();
    let mut parts: Vec<Stretch> = Vec::new();
    let mut roots: Vec<Root> = Vec::new();
    let tube: Vec<IVec3> = mouths.tube.voxels().map(|v| v.as_ivec3()).collect();
    let (axis, first, last) = mouths.along;
    for layer in components(next_layer(&tube, allowed, &mut seen)) {
        let beyond = |v: &&IVec3| v[axis] < first as i32 || v[axis] > last as i32;
        let at_end = 2 * layer.iter().filter(beyond).count() > layer.len();
        let limit_mm2 = if at_end { mouths.end_mm2 } else { mouths.side_mm2 };
        let root = roots.len();
        roots.push(Root { limit_mm2, areas_mm2: Vec::new(), is_open: true });
        parts.push(Stretch {
            root,
            parent: None,
            children: 0,
            first_round: 0,
            layers: vec![layer],
        });
    }
    let mut active: Vec<usize> = (0..parts.len()).collect();
    let mut taken_back = 0;
    for round in 0.. {
        crate::task::checkpoint();
        for root in &mut roots {
            root.areas_mm2.push(0.0);
        }
        for part in active.iter().map(|at| &parts[*at]) {
            roots[part.root].areas_mm2[round] += part.layers.last().map_or(0.0, |l| area_mm2(l));
        }
        for (at, root) in roots.iter_mut().enumerate().filter(|(_, root)| root.is_open) {
            if round + 1 == FIRST_LAYERS.end {
                let mut areas = root.areas_mm2[FIRST_LAYERS].to_vec();
                areas.sort_by(f64::total_cmp);
                let own = (MAX_GROWTH * areas[areas.len() / 2]).max(MIN_LIMIT_MM2);
                root.limit_mm2 = root.limit_mm2.min(own);
            }
            if root.areas_mm2[round] > root.limit_mm2 {
                root.is_open = false;
                taken_back += 1;
                // Back to the round where the fronts had half of that area.
                let half = 0.5 * root.limit_mm2;
                let end = root.areas_mm2.iter().rposition(|a| *a <= half).unwrap_or(0);
                for part in parts.iter_mut().filter(|part| part.root == at) {
                    part.layers.truncate(end.saturating_sub(part.first_round));
                }
            }
        }
        active.retain(|at| roots[parts[*at].root].is_open);
        let mut next = Vec::new();
        for at in active {
            let Some(front) = parts[at].layers.last() else { continue };
            let mut layers = components(next_layer(front, allowed, &mut seen));
            if layers.len() == 1 {
                parts[at].layers.extend(layers.pop());
                next.push(at);
                continue;
            }
            for layer in layers {
                let root = parts[at].root;
                parts[at].children += 1;
                next.push(parts.len());
                parts.push(Stretch {
                    root,
                    parent: Some(at),
                    children: 0,
                    first_round: round + 1,
                    layers: vec![layer],
                });
            }
        }
        active = next;
        if active.is_empty() {
            break;
        }
    }
    let mut mask = BitVolume::new(grid.dims);
    // Short stretches without children are removed, ends first.
    for at in (0..parts.len()).rev() {
        let length_mm = parts[at].layers.len() as f64 * mean_step_mm;
        if parts[at].children == 0 && length_mm < MIN_MM {
            parts[at].layers.clear();
            if let Some(parent) = parts[at].parent {
                parts[parent].children -= 1;
            }
        }
    }
    for v in parts.iter().flat_map(|part| part.layers.iter().flatten()).map(|v| v.as_uvec3()) {
        mask.set(v.x, v.y, v.z);
    }
    ArteryBranches { mask, taken_back }
}

/// Returns the voxels of a mask that share a side with a layer and were not seen before.
fn next_layer(layer: &[IVec3], allowed: &BitVolume, seen: &mut BitVolume) -> Vec<IVec3> {
    let mut out = Vec::new();
    for v in layer.iter().flat_map(|v| SIDES.map(|side| *v + side)) {
        if allowed.get(v) && !seen.get(v) {
            let at = v.as_uvec3();
            seen.set(at.x, at.y, at.z);
            out.push(v);
        }
    }
    out
}

/// The 26-connected components of a layer, in the order of their first voxels.
fn components(layer: Vec<IVec3>) -> Vec<Vec<IVec3>> {
    let index: std::collections::HashMap<IVec3, usize> =
        layer.iter().enumerate().map(|(i, v)| (*v, i)).collect();
    let mut seen = vec![false; layer.len()];
    let mut out = Vec::new();
    for start in 0..layer.len() {
        if std::mem::replace(&mut seen[start], true) {
            continue;
        }
        let mut part = vec![layer[start]];
        let mut next = 0;
        while let Some(at) = part.get(next).copied() {
            next += 1;
            for n in 0..27 {
                let v = at + near_offset(n);
                if let Some(i) = index.get(&v)
                    && !std::mem::replace(&mut seen[*i], true)
                {
                    part.push(v);
                }
            }
        }
        out.push(part);
    }
    out
}
