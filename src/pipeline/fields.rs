//! Fields of a lumen on a device: one plan a chain, no read-back inside it.

use std::time::Instant;

use glam::UVec3;

use super::{Clock, PipelineError};
use crate::compute::{Array, Plan};
use crate::device::Device;
use crate::field::{self, Candidate, LumenBuffers, Response};
use crate::lumen::{BitVolume, Lumen};
use crate::volume::{Grid, Volume};

/// What the centerline needs.
pub struct Fields {
    /// Exact distance, mm.
    pub distance: Array<f32>,
    /// The same after a Gaussian of one (smallest) voxel.
    pub smooth: Array<f32>,
    /// Ridge candidates, in element order.
    pub candidates: Vec<Candidate>,
}

/// Largest smoothed slope of a medial point in default mode (ALGORITHMS, stage e).
const GATE: f32 = 0.7;

/// Exact distance alone.
///
/// # Errors
/// The device's.
pub fn distance_field(
    device: &mut Device,
    lumen: &Lumen,
    clock: &mut Clock,
) -> Result<Array<f32>, PipelineError> {
    let start = Instant::now();
    let mut plan = Plan::new();
    let buffers = LumenBuffers::new(&mut plan, lumen);
    let d = field::distance(&mut plan, &buffers);
    plan.download(d);
    let mut out = device.run(&plan)?;
    clock.plan("distance", device.name(), start, (lumen.inside_voxels(), "voxels"), &out);
    Ok(out.take(d))
}

/// Distance, smoothing, ridge marking, compaction and eigen-analysis in one submission.
///
/// # Errors
/// The device's.
pub fn fields(
    device: &mut Device,
    lumen: &Lumen,
    gated: bool,
    clock: &mut Clock,
) -> Result<Fields, PipelineError> {
    let gate = if gated { GATE } else { f32::INFINITY };
    // A ridge is a curve or a sheet: far fewer voxels than the lumen. Where the guess is too
    // small the counter says by how much, and the chain runs again.
    let mut capacity = (lumen.inside_voxels() as usize / 8).clamp(1024, 1 << 20);
    loop {
        let start = Instant::now();
        let mut plan = Plan::new();
        let buffers = LumenBuffers::new(&mut plan, lumen);
        let d = field::distance(&mut plan, &buffers);
        let f = field::smooth(&mut plan, &buffers, d, buffers.spacing_mm.min_element(), None);
        let ridge = field::ridge(&mut plan, &buffers, d, f, gate, capacity);
        plan.download(d);
        plan.download(f);
        let mut out = device.run(&plan)?;
        match ridge.read(&out) {
            Ok(candidates) => {
                let items = (lumen.inside_voxels(), "voxels");
                clock.plan("distance, ridge", device.name(), start, items, &out);
                return Ok(Fields { distance: out.take(d), smooth: out.take(f), candidates });
            }
            Err(total) => capacity = total,
        }
    }
}

/// A whole volume as a lumen of bricks, with its real values as a field: for the Hessian of grey
/// values.
pub fn volume_as_bricks(volume: &Volume) -> (Lumen, Vec<f32>) {
    let grid: Grid = volume.grid;
    let mut all = BitVolume::new(grid.dims);
    for z in 0..grid.dims.z {
        for y in 0..grid.dims.y {
            all.set_run((0, grid.dims.x - 1), y, z);
        }
    }
    let lumen = Lumen::new(grid, &all);
    let field = values_in(&lumen, volume);
    (lumen, field)
}

/// Real values of a volume in a lumen's bricks; 0 outside the volume.
fn values_in(lumen: &Lumen, volume: &Volume) -> Vec<f32> {
    use crate::volume::Sample as _;
    use rayon::prelude::*;
    let grid = volume.grid;
    let dims = grid.dims.as_ivec3();
    let mut field = vec![0f32; lumen.bricks.field_len()];
    crate::volume::with_samples!(&volume.samples, |samples| {
        field.par_chunks_exact_mut(512).zip(lumen.bricks.corners()).for_each(|(out, c)| {
            let (x0, x1) = (c[0].max(0), (c[0] + 8).min(dims.x));
            for (r, row) in out.chunks_exact_mut(8).enumerate() {
                let (y, z) = (c[1] + (r as i32 & 7), c[2] + (r as i32 >> 3));
                if x0 < x1 && (0..dims.y).contains(&y) && (0..dims.z).contains(&z) {
                    let from = grid.index(UVec3::new(x0 as u32, y as u32, z as u32));
                    let n = (x1 - x0) as usize;
                    let row = &mut row[(x0 - c[0]) as usize..][..n];
                    for (out, v) in row.iter_mut().zip(&samples[from..from + n]) {
                        *out = volume.rescale.real(v.to_f64()) as f32;
                    }
                }
            }
        });
    });
    field
}

/// A Hessian response over a lumen.
///
/// * `grey`: values to analyse; `None` takes the exact distance.
/// * `dims`: the volume's size when the bricks fill it, so that its edge repeats.
///
/// # Errors
/// The device's.
pub fn hessian_field(
    device: &mut Device,
    lumen: &Lumen,
    grey: Option<&[f32]>,
    (sigma_mm, response, dark): (f64, Response, bool),
    dims: Option<UVec3>,
    clock: &mut Clock,
) -> Result<Array<f32>, PipelineError> {
    let start = Instant::now();
    let mut plan = Plan::new();
    let buffers = LumenBuffers::new(&mut plan, lumen);
    let field = match grey {
        Some(values) => plan.upload("grey values", values),
        None => field::distance(&mut plan, &buffers),
    };
    let f = field::smooth(&mut plan, &buffers, field, sigma_mm, dims);
    let most = device.max_buffer_bytes();
    let parts = field::hessian(&mut plan, &buffers, f, response, dark, most);
    parts.iter().for_each(|part| plan.download(*part));
    let mut out = device.run(&plan)?;
    clock.plan("hessian", device.name(), start, (lumen.inside_voxels(), "voxels"), &out);
    Ok(Array::joined(parts.into_iter().map(|part| out.take(part)).collect()))
}
