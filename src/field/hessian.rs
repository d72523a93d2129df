//! Gaussian smoothing and Hessian responses of a field.

use super::LumenBuffers;
use crate::compute::{Buf, Plan};
use crate::kernels::{gauss_axis, hessian as kernel};

/// What to make of the Hessian's eigenvalues l1 ≤ l2 ≤ l3.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Response {
    /// All three, ascending: three values a voxel.
    Eigenvalues,
    /// max(0, -l2): how fast the field falls across its weaker direction.
    Ridge,
    /// √(l1·l2) where l2 < 0, else 0.
    Tubeness,
}

/// Appends a Gaussian of `sigma_mm` in all three directions, truncated at 4 σ.
///
/// With `repeat` the field fills a volume of that many voxels, whose edge repeats; without, what
/// lies beyond the bricks counts as 0.
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
        let g = plan.zeroed::<f32>("smoothed", lumen.field_len());
        // Far enough out, yet clear of overflow when the radius is added.
        let (low, high) =
            repeat.map_or((i32::MIN / 2, i32::MAX / 2), |dims| (0, dims[axis as usize] as i32 - 1));
        let bindings =
            gauss_axis::Bindings { near: lumen.near, corner: lumen.corner, weight, f, g };
        let params = gauss_axis::Params { slots: lumen.slots, axis, radius, low, high };
        plan.launch(&gauss_axis::KERNEL, bindings, params, lumen.field_len(), lumen.items);
        f = g;
    }
    f
}

/// Appends the Hessian response of a (smoothed) field at inside voxels; 0 elsewhere.
///
/// Derivatives are central differences, field unit / mm². `dark` looks for dark ridges instead of
/// bright ones.
pub fn hessian(
    plan: &mut Plan<'_>,
    lumen: &LumenBuffers,
    f: Buf<f32>,
    response: Response,
    dark: bool,
) -> Buf<f32> {
    let (kind, components) = match response {
        Response::Eigenvalues => (0, 3),
        Response::Ridge => (1, 1),
        Response::Tubeness => (2, 1),
    };
    let out = plan.zeroed::<f32>("hessian response", lumen.field_len() * components);
    let params = kernel::Params {
        spacing_mm: lumen.spacing_mm.as_vec3().to_array(),
        sign: if dark { -1.0 } else { 1.0 },
        slots: lumen.slots,
        kind,
        ..Default::default()
    };
    let bindings = kernel::Bindings { near: lumen.near, inside: lumen.inside, f, response: out };
    plan.launch(&kernel::KERNEL, bindings, params, lumen.field_len(), lumen.items);
    out
}
