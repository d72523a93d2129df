//! CPU twin of `wall_correct`: curvature correction and round ends.

use rayon::prelude::*;

use super::blocks::{BrickBlock, excess_bits, length_of, place};
pub use super::host::wall_correct::{Bindings, Params};
use super::host::wall_correct::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/wall_correct.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "voxels", tolerance: Tolerance { abs: 0.0, rel: 0.0 } };

/// Size below which an offset is corrected, 1/1024 of the mean spacing.
const NEAR: i32 = 1024;

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let scratch = || (BrickBlock::new(2), BrickBlock::new(1));
    let bricks = s.moved.par_chunks_exact_mut(BRICK).enumerate().with_min_len(4);
    bricks.for_each_init(scratch, |(edges, offsets), (slot, out)| {
        crate::task::checkpoint();
        let own = &s.offset[slot * BRICK..][..BRICK];
        let curved = p.shift != 0 && own.iter().any(|o| o.abs() < NEAR);
        if curved {
            edges.fill(s.near, slot, s.edge, 32768);
            offsets.fill(s.near, slot, s.offset, 3072);
        }
        for (local, out) in out.iter_mut().enumerate() {
            let mut o = own[local];
            if curved && o.abs() < NEAR {
                o -= shift(edges, offsets, place(local), &p);
            }
            let w = ((s.closed[slot * BRICK + local] * 5) >> 4).min(4096);
            if w > 0 {
                let round = (16384 - s.filled[slot * BRICK + local]) >> 4;
                o += ((round - o) * w) >> 12;
            }
            *out = o.clamp(-3072, 3072);
        }
    });
}

/// Returns the shift of the edge by blur at a voxel, 1/1024 of the mean spacing.
fn shift(edges: &BrickBlock, offsets: &BrickBlock, q: [i32; 3], p: &Params) -> i32 {
    let (values, strides) = (edges.values(), edges.strides());
    let direction = |at: usize, axis: usize| {
        let g: [i32; 3] = std::array::from_fn(|a| {
            (values[at + strides[a]] - values[at - strides[a]]) * p.slope[a]
        });
        let excess = excess_bits(g);
        let g = g.map(|c| c >> excess);
        match length_of(g) {
            0 => 0,
            length => (g[axis] << 12) / length,
        }
    };
    let at = edges.index(q);
    let turn: i32 = (0..3)
        .map(|a| (direction(at + strides[a], a) - direction(at - strides[a], a)) * p.slope[a])
        .sum();
    let curvature = (turn >> 11).clamp(-p.most, p.most);
    let (values, strides) = (offsets.values(), offsets.strides());
    let at = offsets.index(q);
    let g: [i32; 3] =
        std::array::from_fn(|a| (values[at + strides[a]] - values[at - strides[a]]) * p.slope[a]);
    let excess = excess_bits(g);
    let length = length_of(g.map(|c| c >> excess)) << excess;
    let steep = ((length >> 11) * p.rise) >> 10;
    (((curvature * p.shift) >> 12) * steep.clamp(307, 2560)) >> 10
}
