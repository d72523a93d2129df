//! CPU twin and cases of `scale_step`: one step of a Chebyshev series of heat flow.

use glam::Vec4;
use rayon::prelude::*;

pub use super::host::scale_step::{Bindings, Params};
use super::host::scale_step::{SHADER, open};
use super::scale_pool::{WeightedRing, ring};
use crate::compute::{Case, CpuArgs, Kernel, Plan, Tolerance};

/// See `shaders/scale_step.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-5, rel: 0.0 },
    cases,
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

fn cases() -> Vec<Case> {
    let case = |name, g: WeightedRing| {
        let vertices = g.start.len() - 1;
        let mut plan = Plan::new();
        let start = plan.upload_owned("start", &g.start);
        let near = plan.upload_owned("near", &g.near);
        let weight = plan.upload_owned("weight", &g.weight);
        let at = |v: usize| Vec4::new(0.37, 0.61, 0.83, 0.0) * v as f32;
        let values: Vec<[f32; 4]> = (0..vertices).map(|v| at(v).to_array().map(f32::sin)).collect();
        let mut now = plan.zeroed::<[f32; 4]>("now", vertices);
        let mut next = plan.upload_owned("next", &values);
        let level = plan.zeroed::<[f32; 4]>("level", 5 * vertices);
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
