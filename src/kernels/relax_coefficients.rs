//! CPU twin of `relax_coefficients`: the quadratic form of the relaxed wall.

use glam::Vec3;
use rayon::prelude::*;

pub use super::host::relax_coefficients::{Bindings, Params};
use super::host::relax_coefficients::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};

/// See `shaders/relax_coefficients.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 2e-5, rel: 0.0 },
};

/// Number of vertices of a parallel task.
const CHUNK: usize = 2048;
/// Flag of a grid edge whose outside voxel is the lower one: see `shaders/lib/grid_edge.wgsl`.
pub const OUTSIDE_IS_LOWER: u32 = 1 << 24;
/// Flag of a vertex that may not move.
pub const FIXED: u32 = 1 << 25;

/// Returns the axis of a grid edge: the one along which twice the middle is odd.
#[inline]
pub fn edge_axis(code: u32) -> usize {
    if code & 1 != 0 {
        0
    } else if code & 1 << 8 != 0 {
        1
    } else {
        2
    }
}

#[inline]
fn middle_difference(a: u32, b: u32) -> Vec3 {
    let at = |k: u32| f32::from((a >> k).wrapping_sub(b >> k) as u8 as i8);
    Vec3::new(at(0), at(8), at(16))
}

#[inline]
fn outward(code: u32, along: Vec3) -> f32 {
    let x = along[edge_axis(code)];
    if code & OUTSIDE_IS_LOWER != 0 { -x } else { x }
}

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let vertices = p.vertices as usize;
    let axes = [p.axis_x, p.axis_y, p.axis_z];
    let [x, y, z] = axes.map(|a| Vec3::from_slice(&a));
    let size = Vec3::from_array(axes.map(|a| a[3]));
    let limits = [p.limit_x, p.limit_y, p.limit_z];
    let (normal, _) = s.normal.as_chunks::<3>();
    let load = |v: usize| Vec3::from_array(normal[v]);
    // The stretch of the couplings that belongs to each chunk of vertices.
    let mut rest = &mut *s.coupling;
    let rows: Vec<&mut [f32]> = (0..vertices.div_ceil(CHUNK))
        .map(|c| {
            let end = (c * CHUNK + CHUNK).min(vertices);
            let len = s.start[end] - s.start[c * CHUNK];
            let (row, later) = std::mem::take(&mut rest).split_at_mut(len as usize);
            rest = later;
            row
        })
        .collect();
    let out = s.bound[..vertices].par_chunks_mut(CHUNK).zip(s.bend.par_chunks_mut(CHUNK));
    out.zip(rows).enumerate().for_each(|(chunk, ((bound, bend), row))| {
        crate::task::checkpoint();
        let first = s.start[chunk * CHUNK] as usize;
        for (i, (bound, bend)) in bound.iter_mut().zip(bend).enumerate() {
            let v = chunk * CHUNK + i;
            let (own, n) = (s.edge[v], load(v));
            let (begin, end) = (s.start[v] as usize, s.start[v + 1] as usize);
            let coupling = &mut row[begin - first..end - first];
            let (mut diagonal, mut offset) = (p.stiffness, 0.0f32);
            let (mut turn, mut reach) = (0.0f32, 0.0f32);
            for (c, &j) in coupling.iter_mut().zip(&s.near[begin..end]) {
                let (other, m) = (s.edge[j as usize], load(j as usize));
                let d = 0.5 * middle_difference(own, other);
                let apart = (d * size).length_squared();
                let sum = n + m;
                let squared = sum.length_squared();
                *c = 0.0;
                if (1e-6..16.0).contains(&squared) && apart > 0.0 {
                    let u = sum / squared.sqrt();
                    let along = Vec3::new(u.dot(x), u.dot(y), u.dot(z));
                    let q = outward(own, along);
                    diagonal += q * q / apart;
                    offset += q * d.dot(along) / apart;
                    *c = q * outward(other, along) / apart;
                    turn += (n - m).length_squared();
                    reach += apart;
                }
            }
            let half = 0.5 / diagonal;
            coupling.iter_mut().for_each(|c| *c *= half);
            let most = if own & FIXED != 0 { 0.0 } else { limits[edge_axis(own)] };
            *bound = [half * offset, most];
            *bend = if reach > 0.0 { (turn / reach).sqrt() } else { 0.0 };
        }
    });
}
