//! CPU twin and cases of `edt_axis`: squared distance, y and z passes.

use rayon::prelude::*;

pub use super::host::edt_axis::{Bindings, Params};
use super::host::edt_axis::{SHADER, open};
use super::{cases_on_bricks, neighbour};
use crate::compute::{Case, CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::{BRICK, bit_field};

/// See `shaders/edt_axis.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "voxels",
    tolerance: Tolerance { abs: 0.0, rel: 5e-7 },
    cases,
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let axis = p.axis as usize;
    // Eight x-neighbours make one lane group; `rows` of them lie along the axis in a brick.
    let (along, across) = if axis == 1 { (8, 64) } else { (64, 8) };
    let row = |slot: usize, at: usize| -> &[f32; 8] {
        s.f[slot * BRICK + at..][..8].try_into().expect("eight lanes")
    };
    s.g.par_chunks_exact_mut(BRICK).enumerate().with_min_len(8).for_each(|(slot, out)| {
        for line in (0..8).map(|i| i * across) {
            for at in 0..8usize {
                let mut best = *row(slot, line + at * along);
                let (mut up, mut down) = (Some(slot), Some(slot));
                let mut k = 1usize;
                loop {
                    let far = p.step2 * (k as f32) * (k as f32);
                    let worst = best.iter().fold(0.0f32, |a, &b| a.max(b));
                    if far >= worst {
                        break;
                    }
                    let (high, low) = (at + k, at.wrapping_sub(k));
                    if high & 7 == 0 {
                        up = up.and_then(|s_| neighbour(s.near, s_, axis, true));
                    }
                    if low & 7 == 7 {
                        down = down.and_then(|s_| neighbour(s.near, s_, axis, false));
                    }
                    if up.is_none() && down.is_none() {
                        break;
                    }
                    if let Some(u) = up {
                        let f = row(u, line + (high & 7) * along);
                        for (b, f) in best.iter_mut().zip(f) {
                            *b = b.min(f + far);
                        }
                    }
                    if let Some(d) = down {
                        let f = row(d, line + (low & 7) * along);
                        for (b, f) in best.iter_mut().zip(f) {
                            *b = b.min(f + far);
                        }
                    }
                    k += 1;
                }
                if p.finish != 0 {
                    best = best.map(|b| p.scale * b.sqrt());
                }
                out[line + at * along..][..8].copy_from_slice(&best);
            }
        }
    });
}

fn cases() -> Vec<Case> {
    cases_on_bricks(|plan, lumen, near, _| {
        let slots = lumen.bricks.len();
        let spacing = lumen.grid.spacing_mm.as_vec3();
        // A first pass whose values vary: the bits times a small pattern.
        let bits = bit_field(&lumen.inside);
        let f: Vec<f32> =
            bits.iter().enumerate().map(|(i, &b)| b * (1 + i * 7 % 13) as f32).collect();
        let f = plan.upload_owned("f", &f);
        for (axis, finish) in [(1u32, 0u32), (2, 1)] {
            let g = plan.zeroed::<f32>("g", lumen.bricks.field_len());
            let step2 = spacing[axis as usize].powi(2);
            let params = Params { slots: slots as u32, axis, step2, finish, scale: 0.5 };
            let bindings = Bindings { near, f, g };
            plan.launch(&KERNEL, bindings, params, slots * BRICK, slots * BRICK);
            plan.download(g);
        }
    })
}
