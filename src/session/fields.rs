//! Fields of a lumen on a device: one plan a chain, no read-back inside it.

use std::sync::Arc;
use std::time::Instant;

use glam::UVec3;

use super::{Clock, Session, SessionError, locked, present};
use crate::compute::{Array, Buf, Plan};
use crate::device::Device;
use crate::field::{self, LumenBuffers, Response};
use crate::lumen::{BitVolume, Lumen};
use crate::paper::RidgePoint;
use crate::task::catch_cancelled;
use crate::volume::{Grid, Volume};

/// Fields that the centerline needs, in slot order of the lumen.
pub struct Fields {
    /// Exact distance, mm.
    pub distance: Arc<Array<f32>>,
    /// Distance after a Gaussian of one (smallest) voxel, mm.
    pub smooth: Array<f32>,
    /// Ridge points of the paper's method, in element order, where the settings ask for them.
    pub ridge: Vec<RidgePoint>,
}

/// Exact distance alone.
///
/// # Errors
/// The device's.
pub(super) fn distance_field(
    device: &mut Device,
    lumen: &Lumen,
    clock: &mut Clock,
) -> Result<Array<f32>, SessionError> {
    let start = Instant::now();
    let mut plan = Plan::new();
    let buffers = LumenBuffers::new(&mut plan, lumen);
    let d = field::distance(&mut plan, &buffers);
    plan.download(d);
    let mut out = device.run(&plan)?;
    clock.record_plan("distance", device.name(), start, (lumen.inside_voxels(), "voxels"), &out);
    Ok(out.take(d))
}

/// Appends the exact distance and its smoothing, both to be read back.
pub(super) fn distance_and_smooth(
    plan: &mut Plan<'_>,
    buffers: &LumenBuffers,
) -> (Buf<f32>, Buf<f32>) {
    let d = field::distance(plan, buffers);
    let f = field::smooth(plan, buffers, d, buffers.spacing_mm.min_element(), None);
    plan.download(d);
    plan.download(f);
    (d, f)
}

/// A whole volume as a lumen of bricks, with its real values as a field: for the Hessian of grey
/// values.
pub(super) fn volume_as_bricks(volume: &Volume) -> (Lumen, Vec<f32>) {
    let grid: Grid = volume.grid;
    let mut all = BitVolume::new(grid.dims);
    for z in 0..grid.dims.z {
        for y in 0..grid.dims.y {
            all.set_run((0, grid.dims.x - 1), y, z);
        }
    }
    let lumen = Lumen::of_volume(grid, &all);
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

/// Settings of a Hessian analysis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HessianSettings {
    /// Sigma of the Gaussian before the derivatives, mm.
    pub sigma_mm: f64,
    /// Response computed from the eigenvalues.
    pub response: Response,
    /// Whether dark ridges are wanted instead of bright ones.
    pub dark: bool,
}

impl Session {
    pub(super) fn run_distance(&self, clock: &mut Clock) -> Result<Arc<Array<f32>>, SessionError> {
        if let Some(fields) = &*locked(&self.slots.fields) {
            return Ok(Arc::clone(&fields.distance));
        }
        let (lumen, device) = (present(&self.slots.lumen), present(&self.slots.device));
        let distance = distance_field(&mut device.lock(), &lumen.lumen, clock)?;
        Ok(Arc::new(distance))
    }

    pub(super) fn run_fields(&self, clock: &mut Clock) -> Result<Fields, SessionError> {
        let (lumen, device) = (present(&self.slots.lumen), present(&self.slots.device));
        let (lumen, mut device) = (&lumen.lumen, device.lock());
        let start = Instant::now();
        let mut plan = Plan::new();
        let buffers = LumenBuffers::new(&mut plan, lumen);
        let (d, f) = distance_and_smooth(&mut plan, &buffers);
        let mut out = device.run(&plan)?;
        let items = (lumen.inside_voxels(), "voxels");
        clock.record_plan("distance, smooth", device.name(), start, items, &out);
        let distance = Arc::new(out.take(d));
        Ok(Fields { distance, smooth: out.take(f), ridge: Vec::new() })
    }

    /// Hessian eigen-analysis of the distance field over the lumen, in its slot order: one value
    /// an element, or three eigenvalues in ascending order.
    ///
    /// # Errors
    /// What choosing the lumen fails with, and the device's.
    pub fn distance_hessian(&self, s: HessianSettings) -> Result<Array<f32>, SessionError> {
        let segmented = self.lumen()?;
        let device = self.device()?;
        let mut clock = self.clock().fork();
        let field = self.pool.install(|| {
            catch_cancelled(|| {
                let mut device = device.lock();
                hessian_field(&mut device, &segmented.lumen, None, s, None, &mut clock)
            })
        });
        self.clock().merge(clock);
        field.unwrap_or(Err(SessionError::Cancelled))
    }
}

/// Hessian eigen-analysis of all grey values of a volume. Bricks cover the whole volume and its
/// edge repeats; the lumen returned holds their places.
pub struct GreyHessian {
    /// Bricks that cover the volume.
    pub bricks: Lumen,
    values: Vec<f32>,
    dims: UVec3,
}

/// Prepares the Hessian of grey values: copies the volume into bricks.
pub fn grey_hessian(volume: &Volume) -> GreyHessian {
    let (bricks, values) = volume_as_bricks(volume);
    GreyHessian { bricks, values, dims: volume.grid.dims }
}

impl GreyHessian {
    /// The response, in slot order of [`GreyHessian::bricks`].
    ///
    /// # Errors
    /// The device's.
    pub fn response(
        &self,
        device: &mut Device,
        settings: HessianSettings,
        clock: &mut Clock,
    ) -> Result<Array<f32>, SessionError> {
        let grey = Some(self.values.as_slice());
        hessian_field(device, &self.bricks, grey, settings, Some(self.dims), clock)
    }
}

/// A Hessian response over a lumen.
///
/// * `grey`: values to analyse; `None` takes the exact distance.
/// * `dims`: the volume's size when the bricks fill it, so that its edge repeats.
///
/// # Errors
/// The device's.
pub(super) fn hessian_field(
    device: &mut Device,
    lumen: &Lumen,
    grey: Option<&[f32]>,
    HessianSettings { sigma_mm, response, dark }: HessianSettings,
    dims: Option<UVec3>,
    clock: &mut Clock,
) -> Result<Array<f32>, SessionError> {
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
    clock.record_plan("hessian", device.name(), start, (lumen.inside_voxels(), "voxels"), &out);
    Ok(Array::joined(parts.into_iter().map(|part| out.take(part)).collect()))
}
