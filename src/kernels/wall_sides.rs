//! CPU twin and cases of `wall_sides`: offsets whose sign agrees with the mask.

use rayon::prelude::*;

use super::blocks::{bit, element, place};
use super::cases_on_bricks;
pub use super::host::wall_sides::{Bindings, Params};
use super::host::wall_sides::{SHADER, open};
use crate::compute::{Case, CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/wall_sides.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "voxels",
    tolerance: Tolerance { abs: 0.0, rel: 0.0 },
    cases,
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, _, _) = open(args);
    let level = s.level;
    s.offset
        .par_chunks_exact_mut(BRICK)
        .zip(s.edge.par_chunks_exact_mut(BRICK))
        .zip(s.filled.par_chunks_exact_mut(BRICK))
        .zip(s.closed.par_chunks_exact_mut(BRICK))
        .enumerate()
        .with_min_len(8)
        .for_each(|(slot, (((offset, edge), filled), closed))| {
            crate::task::checkpoint();
            for local in 0..BRICK {
                let e = slot * BRICK + local;
                let raw = level[e] << 16 >> 16;
                let inside = bit(s.inside, e);
                let mut at_limit = false;
                let o = if inside {
                    raw.min(-20)
                } else if raw > 0 {
                    raw.max(20)
                } else {
                    let q = place(local);
                    at_limit = (0..6).any(|n| {
                        let mut at = q;
                        at[n / 2] += if n % 2 == 0 { -1 } else { 1 };
                        element(s.near, slot, at).is_some_and(|e| bit(s.inside, e))
                    });
                    512
                };
                offset[local] = o;
                edge[local] = o.clamp(-512, 512) * 64;
                filled[local] = if inside { 32768 } else { 0 };
                closed[local] = if at_limit { 32768 } else { 0 };
            }
        });
}

fn cases() -> Vec<Case> {
    cases_on_bricks(|plan, lumen, near, inside| {
        let slots = lumen.bricks.len();
        let n = lumen.bricks.field_len();
        let levels: Vec<i32> = super::edge_values(lumen)
            .iter()
            .map(|v| (v - 2048).clamp(-3000, 3000) & 0xffff)
            .collect();
        let level = plan.upload_owned("level", &levels);
        let [offset, edge, filled, closed] =
            ["offset", "edge", "filled", "closed"].map(|name| plan.zeroed::<i32>(name, n));
        let bindings = Bindings { near, inside, level, offset, edge, filled, closed };
        plan.launch(
            &KERNEL,
            bindings,
            Params { slots: slots as u32 },
            slots * BRICK,
            slots * BRICK,
        );
        [offset, edge, filled, closed].into_iter().for_each(|b| plan.download(b));
    })
}
