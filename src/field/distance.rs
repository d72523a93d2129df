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

    let rows = plan.zeroed::<f32>("distance² along x", n);
    let bindings = edt_rows::Bindings { near, inside: lumen.inside, square: rows };
    let params = edt_rows::Params { slots, step2: step2.x };
    plan.launch(&edt_rows::KERNEL, bindings, params, slots as usize * 64, lumen.items);

    let mut f = rows;
    for (axis, finish) in [(1u32, 0u32), (2, 1)] {
        let g = plan.zeroed::<f32>(if finish == 1 { "distance" } else { "distance² in x, y" }, n);
        let step2 = step2[axis as usize];
        let params = edt_axis::Params { slots, axis, step2, finish, scale };
        plan.launch(&edt_axis::KERNEL, edt_axis::Bindings { near, f, g }, params, n, lumen.items);
        f = g;
    }
    f
}
