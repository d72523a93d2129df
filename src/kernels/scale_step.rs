//! CPU twin and cases of `scale_step`: one step of a Chebyshev series of heat flow.

use glam::Vec3;
use rayon::prelude::*;

pub use super::host::scale_step::{Bindings, Params};
use super::host::scale_step::{SHADER, open};
use super::scale_pool::{Ring, ring};
use crate::compute::{Case, CpuArgs, Kernel, Plan, Tolerance};

/// See `shaders/scale_step.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-5, rel: 0.0 },
    cases,
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let vertices = p.vertices as usize;
    let at = |v: usize| Vec3::from_slice(&s.now[3 * v..]);
    let chunk = 4096;
    // The chunk is worked once for the recurrence, then once for each time that gains from it.
    let gains = s.level.chunks_exact_mut((3 * vertices).max(1)).zip([
        p.part[0],
        p.part[1],
        p.part[2],
        p.part[3],
        p.last_part,
    ]);
    let mut rows: Vec<Vec<(f32, &mut [f32])>> = Vec::new();
    rows.resize_with(vertices.div_ceil(chunk), Vec::new);
    for (level, part) in gains.filter(|(_, part)| *part != 0.0) {
        for (row, level) in rows.iter_mut().zip(level.chunks_mut(3 * chunk)) {
            row.push((part, level));
        }
    }
    s.next.par_chunks_mut(3 * chunk).zip(rows).enumerate().for_each(|(c, (next, levels))| {
        for (i, next) in next.chunks_exact_mut(3).enumerate() {
            let v = c * chunk + i;
            let own = at(v);
            let edges = s.start[v] as usize..s.start[v + 1] as usize;
            let near = s.near[edges.clone()].iter().zip(&s.weight[edges]);
            let sum = near.fold(own, |sum, (j, w)| sum + *w * (at(*j as usize) - own));
            let x = p.turn * sum - p.keep * Vec3::from_slice(next);
            next.copy_from_slice(&x.to_array());
        }
        for (part, level) in levels {
            level.iter_mut().zip(&*next).for_each(|(l, x)| *l += part * x);
        }
    });
}

fn cases() -> Vec<Case> {
    let case = |name, g: Ring| {
        let vertices = g.start.len() - 1;
        let mut plan = Plan::new();
        let start = plan.upload_owned("start", &g.start);
        let near = plan.upload_owned("near", &g.near);
        let weight = plan.upload_owned("weight", &g.weight);
        let values: Vec<f32> = (0..3 * vertices).map(|i| (i as f32 * 0.37).sin()).collect();
        let mut now = plan.zeroed::<f32>("now", 3 * vertices);
        let mut next = plan.upload_owned("next", &values);
        let level = plan.zeroed::<f32>("level", 15 * vertices);
        for (turn, keep) in [(0.0, -1.0), (1.0, 0.0), (2.0, 1.0), (2.0, 1.0)] {
            let params = Params {
                part: [0.4, 0.0, 0.2, -0.1],
                last_part: 0.05,
                turn,
                keep,
                vertices: vertices as u32,
            };
            let bindings = Bindings { start, near, weight, now, next, level };
            plan.launch(&KERNEL, bindings, params, vertices, vertices);
            std::mem::swap(&mut now, &mut next);
        }
        plan.download(now);
        plan.download(level);
        Case { name, plan }
    };
    vec![
        case("empty", ring(0)),
        case("one vertex", ring(1)),
        case("ring of 65", ring(65)),
        case("ring of 5000", ring(5000)),
    ]
}
