//! Small plans for every kernel, by family: what shader and twin must agree on.

mod distance;
mod normals;
mod relax;
mod ridge;
mod wall;

use glam::{DVec3, IVec3, UVec3};
use intima::compute::{Buf, Kernel, Plan};
use intima::lumen::bricks::bit_field;
use intima::lumen::{BitVolume, Lumen};
use intima::session::kernels;
use intima::volume::Grid;

/// A named plan; its downloads are what devices must agree on.
pub struct Case {
    /// What is special about it.
    pub name: &'static str,
    /// The work.
    pub plan: Plan<'static>,
}

/// Every kernel with its cases.
pub fn all() -> impl Iterator<Item = (&'static Kernel, Vec<Case>)> {
    kernels().map(|k| (k, of(k.name())))
}

/// Cases of a kernel.
pub fn of(kernel: &str) -> Vec<Case> {
    match kernel {
        "edt_rows" => distance::edt_rows(),
        "edt_axis" => distance::edt_axis(),
        "gauss_axis" => distance::gauss_axis(),
        "hessian" => distance::hessian(),
        "visibility" => distance::visibility(),
        "blur_axis" => wall::blur_axis(),
        "least_axis" => wall::least_axis(),
        "ridge_grow" => wall::ridge_grow(),
        "wall_peak" => wall::wall_peak(),
        "wall_level" => wall::wall_level(),
        "wall_sides" => wall::wall_sides(),
        "wall_correct" => wall::wall_correct(),
        "ridge_mark" => ridge::ridge_mark(),
        "ridge_measure" => ridge::ridge_measure(),
        "compact_count" => ridge::compact_count(),
        "compact_scatter" => ridge::compact_scatter(),
        "prefix_sum" => ridge::prefix_sum(),
        "fair" => normals::fair(),
        "scale_step" => normals::scale_step(),
        "scale_bands" => normals::scale_bands(),
        "scale_pool" => normals::scale_pool(),
        "scale_restore" => normals::scale_restore(),
        "relax_coefficients" => relax::relax_coefficients(),
        "relax_step" => relax::relax_step(),
        "relax_average" => relax::relax_average(),
        "relax_guard" => relax::relax_guard(),
        "copy" => relax::copy(),
        _ => panic!("no cases of {kernel}"),
    }
}

fn lumen_of(dims: [u32; 3], spacing: [f64; 3], inside: &dyn Fn(UVec3) -> bool) -> Lumen {
    let grid = Grid::axis_aligned(dims, spacing);
    let mut mask = BitVolume::new(grid.dims);
    for v in (0..grid.len()).map(|i| grid.voxel(i)).filter(|v| inside(*v)) {
        mask.set(v.x, v.y, v.z);
    }
    Lumen::of_volume(grid, &mask)
}

/// Small lumens every brick kernel must survive.
pub fn lumens() -> Vec<(&'static str, Lumen)> {
    let of = lumen_of;
    let tube = |v: UVec3| {
        let p = v.as_dvec3() - DVec3::new(15.3, 14.2, 0.0);
        let bend = 4.0 * (v.z as f64 * 0.2).sin();
        ((p.x - bend).powi(2) + p.y.powi(2)).sqrt() < 7.5 && v.z > 2 && v.z < 37
    };
    let speckle = |v: UVec3| (v.x * 73 + v.y * 179 + v.z * 283 + v.x * v.y * 7) % 5 < 3;
    // One along each axis, which meet.
    let bars = |v: UVec3| {
        let beside = |a: u32| u32::from((36..39).contains(&a));
        beside(v.x) + beside(v.y) + beside(v.z) >= 2
    };
    vec![
        ("empty", of([5, 5, 5], [1.0; 3], &|_| false)),
        ("one voxel", of([1, 1, 1], [1.0; 3], &|_| true)),
        ("odd size, anisotropic tube", of([31, 29, 41], [0.7, 0.7, 2.5], &tube)),
        ("isotropic tube", of([31, 29, 41], [1.0; 3], &tube)),
        ("all inside", of([20, 17, 9], [1.0, 2.0, 0.5], &|_| true)),
        ("speckle", of([19, 23, 11], [1.0; 3], &speckle)),
        ("bars of 76 voxels", of([76; 3], [1.0; 3], &bars)),
    ]
}

/// A smooth bump over a test lumen, distance-like: what the ridge kernels are fed in their cases.
fn smooth_distance(lumen: &Lumen) -> Vec<f32> {
    let mut f = bit_field(&lumen.inside);
    // A few rounds of diffusion of the mask: cheap, and curved everywhere inside.
    for _ in 0..6 {
        let old = f.clone();
        for (e, f) in f.iter_mut().enumerate() {
            let steps = IVec3::AXES.into_iter().flat_map(|axis| [-axis, axis]);
            let near = steps.filter_map(|d| lumen.bricks.step(e, d));
            *f = 0.25 * old[e] + 0.125 * near.map(|n| old[n]).sum::<f32>();
        }
    }
    f.iter_mut().for_each(|f| *f *= 6.0);
    f
}

/// Values of a blurred wall about a test lumen, 0 to 4096, with noise: for the wall's kernels.
fn edge_values(lumen: &Lumen) -> Vec<i32> {
    let smooth = smooth_distance(lumen);
    let noise = |i: usize| (i * 7919 % 301) as i32 - 150;
    smooth.iter().enumerate().map(|(i, f)| 4096 - (f / 6.0 * 4096.0) as i32 + noise(i)).collect()
}

/// One case a test lumen; `build` appends the launches.
fn on_bricks(build: impl Fn(&mut Plan<'static>, &Lumen, Buf<u32>, Buf<u32>)) -> Vec<Case> {
    lumens()
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
