//! Small bridges of lumen through thin walls, found by growth that keeps the topology.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::IVec3;

use crate::geometry::DisjointSets;
use crate::lumen::{BitVolume, Bricks, Neighborhood, pieces};

/// Labels of voxels that the front has not reached, and of those left over as a bridge.
const OUT: u32 = 0;
const LEFT: u32 = u32::MAX;

/// Cuts bridges out of a mask: the narrowest sections of tunnels in `zone`, where they are small.
///
/// From the mask outside the zone a front grows over the mask, deepest voxel first, by voxels that
/// close no loop: about such a voxel there is one component of background, and the components of
/// mask beside it belong to different pieces. Voxels that cannot be reached form sheets across the
/// tunnels.
///
/// * `depth`: function of a voxel's element that is lower for deeper voxels.
/// * `max_voxels`: largest number of voxels of a narrowest section.
pub(super) fn cut_bridges(
    mask: &mut BitVolume,
    zone: &BitVolume,
    bricks: &Bricks,
    depth: impl Fn(usize) -> i32,
    max_voxels: usize,
) {
    let around = Neighborhood::tables();
    let mut label = vec![OUT; bricks.field_len()];
    let mut outer = mask.clone();
    outer.remove(zone);
    // Labels of one piece are one set; 0 is none.
    let mut sets = DisjointSets::new(1);
    let mut begin = |voxels: &mut dyn Iterator<Item = usize>, label: &mut [u32]| {
        let own = sets.push();
        voxels.for_each(|e| label[e] = own);
    };
    let at = |v: glam::UVec3| bricks.element(v.as_ivec3());
    for piece in pieces(&outer, 1) {
        begin(&mut piece.voxels().filter_map(at), &mut label);
    }
    // A pool without gas begins at its deepest voxel.
    for piece in pieces(mask, 1) {
        let own = || piece.voxels().filter_map(at);
        if own().all(|e| label[e] == OUT) {
            begin(&mut own().min_by_key(|e| (depth(*e), *e)).into_iter(), &mut label);
        }
    }
    let mut front = BinaryHeap::new();
    let mut inner = mask.clone();
    inner.keep(zone);
    let is_inner = |e: usize| inner.get(bricks.voxel(e));
    let mut is_queued = vec![false; label.len()];
    let sides = [IVec3::X, IVec3::Y, IVec3::Z];
    for e in inner.voxels().filter_map(at).filter(|e| label[*e] == OUT) {
        let beside = |d: IVec3| bricks.step(e, d).is_some_and(|n| label[n] != OUT);
        if sides.iter().any(|d| beside(*d) || beside(-*d)) {
            is_queued[e] = true;
            front.push(Reverse((depth(e), e)));
        }
    }
    let mut steps = 0usize;
    while let Some(Reverse((_, e))) = front.pop() {
        steps += 1;
        if steps.is_multiple_of(1 << 14) {
            crate::task::checkpoint();
        }
        is_queued[e] = false;
        let near: [Option<usize>; 27] =
            std::array::from_fn(|bit| bricks.step(e, Neighborhood::offset(bit as u32)));
        let is_in = |n: &Option<usize>| n.is_some_and(|n| label[n] != OUT);
        let set = (0..27).filter(|bit| is_in(&near[*bit])).fold(0u32, |m, bit| m | 1 << bit);
        let (parts, count) = around.parts_beside(set);
        let mut roots: [u32; 6] = [0; 6];
        for (root, part) in roots.iter_mut().zip(&parts[..count]) {
            *root = near[*part as usize].map_or(0, |n| sets.root(label[n]));
        }
        let roots = &mut roots[..count];
        roots.sort_unstable();
        if count == 0 || roots.windows(2).any(|two| two[0] == two[1]) {
            continue;
        }
        label[e] = roots[0];
        for root in roots.iter() {
            sets.join(*root, roots[0]);
        }
        for n in near.into_iter().flatten() {
            if label[n] == OUT && !is_queued[n] && is_inner(n) {
                is_queued[n] = true;
                front.push(Reverse((depth(n), n)));
            }
        }
    }
    // Sheets that were not reached, joined by sides, edges and corners.
    let mut cut = BitVolume::new(mask.dims());
    for first in inner.voxels().filter_map(at) {
        if label[first] != OUT {
            continue;
        }
        label[first] = LEFT;
        let mut sheet = vec![first];
        let mut next = 0;
        while next < sheet.len() {
            for bit in 0..27 {
                let beside = bricks.step(sheet[next], Neighborhood::offset(bit));
                if let Some(n) = beside.filter(|n| label[*n] == OUT && is_inner(*n)) {
                    label[n] = LEFT;
                    sheet.push(n);
                }
            }
            next += 1;
        }
        if sheet.len() <= max_voxels {
            sheet.iter().map(|e| bricks.voxel(*e).as_uvec3()).for_each(|v| cut.set(v.x, v.y, v.z));
        }
    }
    mask.remove(&cut);
}
