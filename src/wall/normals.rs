//! Normals of the wall from the field's gradient.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::compute::{Buf, Plan};
use crate::field::{LumenBuffers, Sampler, smooth};
use crate::geometry::Mesh;
use crate::lumen::Lumen;

/// Standard deviation of the Gaussian that is applied before the gradient, in least spacings.
const SIGMA: f64 = 0.7;

/// Appends the smoothing of a field of offsets, 0 beyond the lumen's bricks.
///
/// * `field`: offsets minus the largest, so that voxels without a brick are far outside.
pub fn smoothed_field<'p>(plan: &mut Plan<'p>, lumen: &'p Lumen, field: &'p [f32]) -> Buf<f32> {
    let buffers = LumenBuffers::new(plan, lumen);
    let f = plan.upload("wall field", field);
    smooth(plan, &buffers, f, SIGMA * lumen.grid.spacing_mm.min_element(), None)
}

/// Returns unit normals at a mesh's vertices, into the lumen, from a smoothed field; the mesh's own
/// face normals where the field is flat.
pub fn field_normals(lumen: &Lumen, smoothed: &[f32], mesh: &Mesh, faces: &[Vec3]) -> Vec<Vec3> {
    let f = Sampler { lumen, field: smoothed };
    let grid = &lumen.grid;
    let (h, to_voxel) = (grid.spacing_mm, grid.voxel_from_world());
    let reach = 0.5 * h;
    mesh.positions
        .par_iter()
        .zip(faces)
        .with_min_len(1024)
        .map(|(p, face)| {
            let v = to_voxel.transform_point3(p.as_dvec3()) * h;
            let along = |axis: usize| {
                let mut d = DVec3::ZERO;
                d[axis] = reach[axis];
                (f.at(v + d) - f.at(v - d)) / (2.0 * reach[axis])
            };
            let g = DVec3::new(along(0), along(1), along(2));
            let n = (grid.direction * -g).as_vec3().try_normalize().unwrap_or(*face);
            // A thin sheet's two faces share one smoothed field: it may be flat or turned there.
            if n.dot(*face) > 0.0 { n } else { *face }
        })
        .collect()
}
