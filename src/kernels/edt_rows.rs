//! CPU twin of `edt_rows`: squared distance along x, from bits.

use rayon::prelude::*;

pub use super::host::edt_rows::{Bindings, Params};
use super::host::edt_rows::{SHADER, open};
use super::neighbour;
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/edt_rows.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "voxels",
    tolerance: Tolerance { abs: 0.0, rel: 2.5e-7 },
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let row_bits =
        |slot: usize, row: usize| s.inside[slot * 16 + (row >> 2)] >> (8 * (row & 3)) & 255;
    // Length of the inside run that goes on past the brick's side, and the table of squares.
    let carry = |slot: usize, row: usize, up: bool| {
        let (mut at, mut run) = (slot, 0);
        while let Some(next) = neighbour(s.near, at, 0, up) {
            let b = row_bits(next, row);
            if b != 255 {
                return run + if up { (!b).trailing_zeros() } else { (!(b << 24)).leading_zeros() };
            }
            run += 8;
            at = next;
        }
        run
    };
    s.square.par_chunks_exact_mut(BRICK).enumerate().with_min_len(16).for_each(|(slot, out)| {
        crate::task::checkpoint();
        for (row, out) in out.chunks_exact_mut(8).enumerate() {
            let bits = row_bits(slot, row);
            if bits == 0 {
                out.fill(0.0);
                continue;
            }
            let mut run = if bits & 1 != 0 { carry(slot, row, false) } else { 0 };
            let mut k = [0u32; 8];
            for (x, k) in k.iter_mut().enumerate() {
                run = if bits >> x & 1 != 0 { run + 1 } else { 0 };
                *k = run;
            }
            let mut run = if bits & 128 != 0 { carry(slot, row, true) } else { 0 };
            for x in (0..8).rev() {
                run = if bits >> x & 1 != 0 { run + 1 } else { 0 };
                let k = k[x].min(run) as f32;
                out[x] = p.step2 * k * k;
            }
        }
    });
}
