//! Exact anisotropic Euclidean distance to the nearest external voxel centre.

use super::LumenBuffers;
use crate::compute::{Buf, Plan};
use crate::kernels::{edt_axis, edt_rows};

/// Appends the exact distance transform.
///
/// Returns a field in mm: distance from an inside voxel's centre to the nearest external voxel's
/// centre, outside the volume being external; 0 at external voxels. On isotropic grids the squared
/// distance in voxels is an integer and exact up to 2^24.
///
/// Separable passes after Meijster 2000, doi:10.1007/0-306-47025-X_36, restricted to the runs of
/// the lumen: time is proportional to the lumen, not its box.
pub fn distance(plan: &mut Plan<'_>, lumen: &LumenBuffers) -> Buf<f32> {
    let h = lumen.spacing_mm.as_vec3();
    // Isotropic grids are measured in voxels and scaled at the end, which keeps squares integral.
    let isotropic =
        lumen.spacing_mm.x == lumen.spacing_mm.y && lumen.spacing_mm.y == lumen.spacing_mm.z;
    let step2 = if isotropic { glam::Vec3::ONE } else { h * h };
    let scale = if isotropic { h.x } else { 1.0 };
    let (slots, n, near) = (lumen.slots, lumen.field_len(), lumen.near);

    let rows = plan.undefined::<f32>("distance² along x", n);
    let bindings = edt_rows::Bindings { near, inside: lumen.inside, square: rows };
    let params = edt_rows::Params { slots, step2: step2.x };
    // A thread a row of eight voxels, here as along y and z.
    let threads = slots as usize * 64;
    plan.launch(&edt_rows::KERNEL, bindings, params, threads, lumen.items);

    let mut f = rows;
    for (axis, finish) in [(1u32, 0u32), (2, 1)] {
        let g =
            plan.undefined::<f32>(if finish == 1 { "distance" } else { "distance² in x, y" }, n);
        let step2 = step2[axis as usize];
        let params = edt_axis::Params { slots, axis, step2, finish, scale };
        plan.launch(
            &edt_axis::KERNEL,
            edt_axis::Bindings { near, f, g },
            params,
            threads,
            lumen.items,
        );
        f = g;
    }
    f
}

#[cfg(test)]
mod tests {
    use glam::{IVec3, UVec3};

    use super::*;
    use crate::compute::run_cpu;
    use crate::lumen::{BitVolume, Lumen};
    use crate::volume::Grid;

    #[test]
    fn distance_equals_brute_force_on_random_masks() {
        for (seed, spacing) in [(1u64, [1.0; 3]), (2, [0.7, 0.7, 2.5]), (3, [10.0, 1.0, 1.0])] {
            let grid = Grid::axis_aligned([21, 13, 17], spacing);
            let inside = |v: UVec3| {
                let q = v.as_u64vec3();
                let n = q.x.wrapping_mul(0x9e3779b97f4a7c15)
                    ^ q.y.wrapping_mul(0xc2b2ae3d27d4eb4f)
                    ^ q.z.wrapping_mul(0x165667b19e3779f9)
                    ^ seed;
                n.wrapping_mul(0x9e3779b97f4a7c15) >> 60 != 0
            };
            let mut mask = BitVolume::new(grid.dims);
            for v in (0..grid.len()).map(|i| grid.voxel(i)).filter(|v| inside(*v)) {
                mask.set(v.x, v.y, v.z);
            }
            let l = Lumen::of_volume(grid, &mask);
            let mut plan = Plan::new();
            let b = LumenBuffers::new(&mut plan, &l);
            let d = distance(&mut plan, &b);
            plan.download(d);
            let out = run_cpu(&plan);
            let d = out.get(d);
            let h = l.grid.spacing_mm;
            let mut outside = Vec::new();
            for z in -1..18 {
                for y in -1..14 {
                    for x in -1..22 {
                        let v = IVec3::new(x, y, z);
                        if !l.holds(v) {
                            outside.push(v.as_dvec3() * h);
                        }
                    }
                }
            }
            for e in l.elements(&l.inside) {
                let p = l.bricks.voxel(e).as_dvec3() * h;
                let want =
                    outside.iter().map(|q| q.distance_squared(p)).fold(f64::MAX, f64::min).sqrt();
                assert!((f64::from(d[e]) - want).abs() <= 1e-6 * want, "{p} {} {want}", d[e]);
            }
        }
    }
}
