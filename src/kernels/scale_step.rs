//! CPU twin of `scale_step`: one step of a Chebyshev series of heat flow.

use glam::Vec4;
use rayon::prelude::*;

pub use super::host::scale_step::{Bindings, Params};
use super::host::scale_step::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};

/// See `shaders/scale_step.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-5, rel: 0.0 },
};

/// Coefficient of a term of the series, and the slice of a level that it is added to.
type Gain<'a> = (f32, &'a mut [[f32; 4]]);

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let vertices = p.vertices as usize;
    let chunk = 1024;
    let parts = [p.part[0], p.part[1], p.part[2], p.part[3], p.last_part];
    let gaining = s.level.chunks_exact_mut(vertices.max(1)).zip(parts);
    let mut rows: Vec<Vec<Gain<'_>>> = Vec::new();
    rows.resize_with(vertices.div_ceil(chunk), Vec::new);
    for (level, part) in gaining.filter(|(_, part)| *part != 0.0) {
        for (row, level) in rows.iter_mut().zip(level.chunks_mut(chunk)) {
            row.push((part, level));
        }
    }
    s.next.par_chunks_mut(chunk).zip(rows).enumerate().with_min_len(4).for_each(
        |(c, (next, levels))| {
            crate::task::checkpoint();
            for (i, next) in next.iter_mut().enumerate() {
                let v = c * chunk + i;
                let edges = s.start[v] as usize..s.start[v + 1] as usize;
                let (mut sum, mut rest) = (Vec4::ZERO, 1.0);
                for (j, w) in s.near[edges.clone()].iter().zip(&s.weight[edges]) {
                    sum += *w * Vec4::from_array(s.now[*j as usize]);
                    rest -= *w;
                }
                let own = Vec4::from_array(s.now[v]);
                let before = Vec4::from_array(*next);
                *next = (p.turn * (sum + rest * own) - p.keep * before).to_array();
            }
            for (part, level) in levels {
                let (to, from) = (level.as_flattened_mut(), next.as_flattened());
                to.iter_mut().zip(from).for_each(|(l, x)| *l += part * x);
            }
        },
    );
}
