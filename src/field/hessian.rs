//! Gaussian smoothing and Hessian responses of a field.

use super::LumenBuffers;
use crate::compute::{Buf, Plan};
use crate::kernels::{gauss_axis, hessian as kernel};
use crate::lumen::bricks::BRICK;

/// Function of the Hessian's eigenvalues l1 ≤ l2 ≤ l3 that is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Response {
    /// All three eigenvalues, ascending: three values a voxel.
    Eigenvalues,
    /// Ridge strength max(0, -l2): curvature across the ridge in the direction where it is weaker.
    Ridge,
    /// Tube strength √(l1·l2) where l2 < 0, else 0.
    Tubeness,
}

/// Appends a Gaussian of `sigma_mm` in all three directions, truncated at 4 σ.
///
/// With `repeat` the field fills a volume of that many voxels, whose edge repeats; without, values
/// beyond the bricks count as 0.
pub fn smooth(
    plan: &mut Plan<'_>,
    lumen: &LumenBuffers,
    field: Buf<f32>,
    sigma_mm: f64,
    repeat: Option<glam::UVec3>,
) -> Buf<f32> {
    let mut f = field;
    for axis in 0..3u32 {
        let sigma_vox = sigma_mm / lumen.spacing_mm[axis as usize];
        let weights = gauss_axis::gaussian_weights(sigma_vox);
        let radius = weights.len() as u32 - 1;
        if radius == 0 {
            continue;
        }
        let weight = plan.upload_owned("gaussian weights", &weights);
        let g = plan.undefined::<f32>("smoothed", lumen.field_len());
        // Far enough out, yet clear of overflow when the radius is added.
        let (low, high) =
            repeat.map_or((i32::MIN / 2, i32::MAX / 2), |dims| (0, dims[axis as usize] as i32 - 1));
        let bindings =
            gauss_axis::Bindings { near: lumen.near, corner: lumen.corner, weight, f, g };
        let params = gauss_axis::Params { slots: lumen.slots, axis, radius, low, high };
        plan.launch(&gauss_axis::KERNEL, bindings, params, lumen.slots as usize * 64, lumen.items);
        f = g;
    }
    f
}

/// Appends the Hessian response of a (smoothed) field at inside voxels; 0 elsewhere. Returns as
/// many buffers, in order, as are needed so that none holds more than `most_bytes`.
///
/// Derivatives are central differences, field unit / mm². With `dark` the ridges are dark instead
/// of bright.
pub fn hessian(
    plan: &mut Plan<'_>,
    lumen: &LumenBuffers,
    f: Buf<f32>,
    response: Response,
    dark: bool,
    most_bytes: u64,
) -> Vec<Buf<f32>> {
    let (kind, components) = match response {
        Response::Eigenvalues => (0, 3),
        Response::Ridge => (1, 1),
        Response::Tubeness => (2, 1),
    };
    let slot_bytes = (BRICK * components * size_of::<f32>()) as u64;
    let at_once = u32::try_from((most_bytes / slot_bytes).max(1)).unwrap_or(u32::MAX);
    let mut out = Vec::new();
    for first in (0..lumen.slots).step_by(at_once as usize) {
        let slots = at_once.min(lumen.slots - first);
        let voxels = slots as usize * BRICK;
        let response = plan.undefined::<f32>("hessian response", voxels * components);
        let params = kernel::Params {
            spacing_mm: lumen.spacing_mm.as_vec3().to_array(),
            sign: if dark { -1.0 } else { 1.0 },
            first,
            slots,
            kind,
            ..Default::default()
        };
        let bindings = kernel::Bindings { near: lumen.near, inside: lumen.inside, f, response };
        // Of the lumen's voxels each buffer has its share of slots.
        let items = lumen.items * slots as usize / lumen.slots as usize;
        plan.launch(&kernel::KERNEL, bindings, params, slots as usize * 64, items);
        out.push(response);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compute::{Array, run_cpu};
    use crate::lumen::{BitVolume, Lumen};
    use crate::volume::Grid;

    #[test]
    fn a_response_in_several_buffers_is_the_one_in_a_single_buffer() {
        let grid = Grid::axis_aligned([40, 33, 29], [0.8, 0.8, 1.5]);
        let mut mask = BitVolume::new(grid.dims);
        for v in (0..grid.len()).map(|i| grid.voxel(i)) {
            if v.as_dvec3().distance(glam::DVec3::new(19.0, 16.0, 14.0)) < 12.5 {
                mask.set(v.x, v.y, v.z);
            }
        }
        let lumen = Lumen::of_volume(grid, &mask);
        let run = |response, most_bytes| {
            let mut plan = Plan::new();
            let b = LumenBuffers::new(&mut plan, &lumen);
            let d = crate::field::distance(&mut plan, &b);
            let parts = hessian(&mut plan, &b, d, response, false, most_bytes);
            parts.iter().for_each(|p| plan.download(*p));
            let mut out = run_cpu(&plan);
            let n = parts.len();
            (n, Array::joined(parts.into_iter().map(|p| out.take(p)).collect()).to_vec())
        };
        for response in [Response::Eigenvalues, Response::Ridge] {
            let (one, whole) = run(response, u64::MAX);
            assert!(one == 1 && whole.iter().any(|v| *v > 0.1));
            // Seven bricks of three values, or 21 of one, and a bit that holds none.
            let (several, same) = run(response, 7 * 512 * 12 + 100);
            assert!(several >= 3 && same == whole, "{several}");
            // Less than a brick needs is taken as a brick.
            assert_eq!(run(response, 0).1, whole);
        }
    }
}
