//! One file a kernel: its bindings (generated from the shader of the same name), its CPU twin and
//! its test cases. [`ALL`] lists them.

mod blocks;
pub mod blur_axis;
pub mod compact_count;
pub mod compact_scatter;
pub mod copy;
pub mod edt_axis;
pub mod edt_rows;
pub mod fair;
pub mod gauss_axis;
pub mod hessian;
pub mod least_axis;
pub mod prefix_sum;
pub mod relax_average;
pub mod relax_coefficients;
pub mod relax_guard;
pub mod relax_step;
pub mod ridge_grow;
pub mod ridge_mark;
pub mod ridge_measure;
pub mod scale_bands;
pub mod scale_pool;
pub mod scale_restore;
pub mod scale_step;
pub mod visibility;
pub mod wall_correct;
pub mod wall_level;
pub mod wall_peak;
pub mod wall_sides;

use glam::UVec3;

use crate::compute::{Buf, Case, Kernel, Plan};
use crate::lumen::bricks::{NONE, near_index};
use crate::lumen::{BitVolume, Lumen};
use crate::volume::Grid;

/// Host side of every shader, written by the build script from naga's reflection.
#[allow(missing_docs, dead_code, clippy::all)]
pub mod host {
    include!(concat!(env!("OUT_DIR"), "/kernels.rs"));
}

/// All kernels.
pub static ALL: &[&Kernel] = &[
    &edt_rows::KERNEL,
    &edt_axis::KERNEL,
    &gauss_axis::KERNEL,
    &blur_axis::KERNEL,
    &least_axis::KERNEL,
    &ridge_grow::KERNEL,
    &wall_peak::KERNEL,
    &wall_level::KERNEL,
    &wall_sides::KERNEL,
    &wall_correct::KERNEL,
    &ridge_mark::KERNEL,
    &compact_count::KERNEL,
    &prefix_sum::KERNEL,
    &compact_scatter::KERNEL,
    &ridge_measure::KERNEL,
    &hessian::KERNEL,
    &visibility::KERNEL,
    &fair::KERNEL,
    &scale_step::KERNEL,
    &scale_bands::KERNEL,
    &scale_pool::KERNEL,
    &scale_restore::KERNEL,
    &relax_coefficients::KERNEL,
    &relax_step::KERNEL,
    &relax_average::KERNEL,
    &relax_guard::KERNEL,
    &copy::KERNEL,
];

/// Returns the neighbouring slot of `slot` along an axis, from the flat neighbour table kernels
/// bind.
#[inline]
fn neighbour(near: &[u32], slot: usize, axis: usize, up: bool) -> Option<usize> {
    const AT: [[usize; 2]; 3] = [
        [near_index(-1, 0, 0), near_index(1, 0, 0)],
        [near_index(0, -1, 0), near_index(0, 1, 0)],
        [near_index(0, 0, -1), near_index(0, 0, 1)],
    ];
    match near[slot * 27 + AT[axis][usize::from(up)]] {
        NONE => None,
        s => Some(s as usize),
    }
}

/// Returns small lumens that every brick kernel is tested on.
fn test_lumens() -> Vec<(&'static str, Lumen)> {
    let of = |dims: [u32; 3], spacing: [f64; 3], inside: &dyn Fn(UVec3) -> bool| {
        let grid = Grid::axis_aligned(dims, spacing);
        let mut mask = BitVolume::new(grid.dims);
        for v in (0..grid.len()).map(|i| grid.voxel(i)).filter(|v| inside(*v)) {
            mask.set(v.x, v.y, v.z);
        }
        Lumen::new(grid, &mask)
    };
    let tube = |v: UVec3| {
        let p = v.as_dvec3() - glam::DVec3::new(15.3, 14.2, 0.0);
        let bend = 4.0 * (v.z as f64 * 0.2).sin();
        ((p.x - bend).powi(2) + p.y.powi(2)).sqrt() < 7.5 && v.z > 2 && v.z < 37
    };
    let speckle = |v: UVec3| (v.x * 73 + v.y * 179 + v.z * 283 + v.x * v.y * 7) % 5 < 3;
    vec![
        ("empty", of([5, 5, 5], [1.0; 3], &|_| false)),
        ("one voxel", of([1, 1, 1], [1.0; 3], &|_| true)),
        ("odd size, anisotropic tube", of([31, 29, 41], [0.7, 0.7, 2.5], &tube)),
        ("isotropic tube", of([31, 29, 41], [1.0; 3], &tube)),
        ("all inside", of([20, 17, 9], [1.0, 2.0, 0.5], &|_| true)),
        ("speckle", of([19, 23, 11], [1.0; 3], &speckle)),
    ]
}

/// Returns a smooth bump over a test lumen, similar to a distance map, as input of the ridge
/// kernels' cases.
fn smooth_distance(lumen: &Lumen) -> Vec<f32> {
    let near: Vec<u32> = lumen.bricks.near().iter().flatten().copied().collect();
    let mut f = crate::lumen::bricks::bit_field(&lumen.inside);
    // A few rounds of diffusion of the mask: cheap, and curved everywhere inside.
    for _ in 0..6 {
        let old = f.clone();
        for (e, f) in f.iter_mut().enumerate() {
            let (slot, l) = (e / 512, e % 512);
            let mut sum = 0.0;
            for (axis, stride) in [(0, 1), (1, 8), (2, 64)] {
                let q = l / stride % 8;
                for up in [false, true] {
                    let edge = if up { 7 } else { 0 };
                    let at = if q != edge {
                        Some(slot).map(|s| s * 512 + if up { l + stride } else { l - stride })
                    } else {
                        neighbour(&near, slot, axis, up)
                            .map(|s| s * 512 + if up { l - 7 * stride } else { l + 7 * stride })
                    };
                    sum += at.map_or(0.0, |a| old[a]);
                }
            }
            *f = 0.25 * old[e] + 0.125 * sum;
        }
    }
    f.iter_mut().for_each(|f| *f *= 6.0);
    f
}

/// Returns values of a blurred wall about a test lumen, 0 to 4096, with noise, as input of the wall
/// kernels' cases.
fn edge_values(lumen: &Lumen) -> Vec<i32> {
    let smooth = smooth_distance(lumen);
    let noise = |i: usize| (i * 7919 % 301) as i32 - 150;
    smooth.iter().enumerate().map(|(i, f)| 4096 - (f / 6.0 * 4096.0) as i32 + noise(i)).collect()
}

/// Returns one case a test lumen; `build` appends the launches.
fn cases_on_bricks(build: impl Fn(&mut Plan<'static>, &Lumen, Buf<u32>, Buf<u32>)) -> Vec<Case> {
    test_lumens()
        .into_iter()
        .map(|(name, lumen)| {
            let mut plan = Plan::new();
            let flat: Vec<u32> = lumen.bricks.near().iter().flatten().copied().collect();
            let near = plan.upload_owned("near", &flat);
            let inside =
                plan.upload_owned("inside", bytemuck::cast_slice::<u64, u32>(&lumen.inside));
            build(&mut plan, &lumen, near, inside);
            Case { name, plan }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compute::run_cpu;

    #[test]
    fn every_kernel_has_cases_that_run_on_the_cpu() {
        for k in ALL {
            let cases = (k.cases)();
            assert!(cases.len() >= 4, "{} has {} cases", k.name(), cases.len());
            for case in &cases {
                assert!(!case.plan.downloads().is_empty(), "{}/{}", k.name(), case.name);
                run_cpu(&case.plan);
            }
        }
    }
}
