//! Shift of curved edges by blur, round ends, and the final lumen.

use glam::DVec3;
use rayon::prelude::*;

use super::bridges::cut_bridges;
use super::launches::BrickLaunches;
use super::profile::WallProfile;
use super::stats::stats;
use super::{Evidence, OFFSET, Tissue, WallError, WallField, select};
use crate::compute::{Buf, Plan};
use crate::kernels::{wall_correct, wall_peak, wall_sides};
use crate::lumen::bricks::BRICK;
use crate::lumen::{BitVolume, Lumen, eroded};

/// Largest number of voxels of a section that is cut: a hole in a fold, a contact of two bronchi.
const MAX_HOLE_VOXELS: usize = 12;
const MAX_CONTACT_VOXELS: usize = 40;
/// Erosion, voxels, of which thin parts of a lumen keep nothing.
const THIN_VOXELS: f64 = 2.0;

/// Returns the parts of a lumen by its wall, in which neighbouring bronchi may touch and a fold may
/// have a hole.
fn thin_parts(mask: &BitVolume) -> BitVolume {
    let mut thin = mask.clone();
    thin.remove(&eroded(mask, DVec3::ONE, THIN_VOXELS));
    thin
}

impl WallProfile<'_> {
    /// Appends the correction of curved edges and of closed ends.
    pub fn correct<'p>(&'p self, plan: &mut Plan<'p>) -> Buf<i32> {
        let input = &self.input;
        let slots = input.bricks.len() as u32;
        let n = input.bricks.field_len();
        let shape = BrickLaunches::new(plan, &input.bricks, &input.brick_copies, &input.grid);
        let inside = plan.upload("inside", bytemuck::cast_slice::<u64, u32>(&self.inside));
        let level = plan.upload_kept("levels", &self.level, &input.level_copy);
        let [offset, edge, filled, closed] =
            ["offsets", "edge", "filled", "closed"].map(|name| plan.undefined::<i32>(name, n));
        let near = shape.near;
        let bindings = wall_sides::Bindings { near, inside, level, offset, edge, filled, closed };
        plan.launch(&wall_sides::KERNEL, bindings, wall_sides::Params { slots }, n, n);
        let spare = [0, 1].map(|_| plan.undefined::<i32>("spare", n));
        let weights = &input.weights;
        shape.blur(plan, &weights.curvature, edge, spare, edge, 512 * 64);
        shape.blur(plan, &weights.filled, filled, spare, filled, 0);
        shape.blur(plan, &weights.closed, closed, spare, closed, 0);
        let (mean, least) = (input.mean_spacing(), input.grid.spacing_mm.min_element());
        let sigma = self.sigma_mm;
        let is_curved = input.tissue != Tissue::Colon;
        let shift = if is_curved { 0.5 * sigma * sigma / (least * mean) * 1024.0 } else { 0.0 };
        let params = wall_correct::Params {
            slope: input.ratio(1024.0),
            slots,
            shift: shift.round().min(32768.0) as i32,
            most: (4096.0 * least / sigma).round() as i32,
            rise: (1024.0 * mean / least).round() as i32,
            ..bytemuck::Zeroable::zeroed()
        };
        let moved = plan.undefined::<i32>("moved offsets", n);
        let bindings = wall_correct::Bindings { near, offset, edge, filled, closed, moved };
        plan.launch(&wall_correct::KERNEL, bindings, params, n, n);
        plan.download(moved);
        moved
    }

    /// Selects the final lumen and cuts its field out.
    ///
    /// * `fill`: whether to fill closed cavities.
    ///
    /// # Errors
    /// [`WallError::Empty`].
    pub fn finish(self, moved: &[i32]) -> Result<(Lumen, WallField), WallError> {
        let Self { input, mark, level, mask, sigma_mm, .. } = self;
        let bricks = &input.bricks;
        let lumen_at = |e: usize| mark[e] & wall_peak::JOINED != 0 && moved[e] < 0;
        let mut mask = select::lumen(bricks, &mask, lumen_at).ok_or(WallError::Empty)?;
        let most = match input.tissue {
            Tissue::Airway => Some(MAX_CONTACT_VOXELS),
            Tissue::Colon => Some(MAX_HOLE_VOXELS),
            Tissue::Vessel | Tissue::Unknown => None,
        };
        if let Some(most) = most {
            let mut zone = thin_parts(&mask);
            if let Some(fluid) = input.zone {
                zone.add(fluid);
            }
            cut_bridges(&mut mask, &zone, bricks, |e| moved[e], most);
        }
        let lumen = Lumen::new(input.grid, &mask);
        let stats = stats(&input, sigma_mm, &lumen, &mark, &level);
        let scale = (input.mean_spacing() / OFFSET) as f32;
        // The lumen has bricks of its own.
        let element = |own: usize| bricks.element(lumen.volume_voxel(lumen.bricks.voxel(own)));
        let mut offset_mm = vec![0f32; lumen.bricks.field_len()];
        let mut evidence = vec![Evidence::Limit; offset_mm.len()];
        evidence.par_chunks_exact_mut(BRICK).enumerate().for_each(|(slot, out)| {
            for (local, out) in out.iter_mut().enumerate() {
                let Some(from) = element(slot * BRICK + local) else { continue };
                *out = Evidence::new(mark[from], level[from]);
            }
        });
        offset_mm.par_chunks_exact_mut(BRICK).enumerate().for_each(|(slot, out)| {
            for (local, out) in out.iter_mut().enumerate() {
                let inside = lumen.is_inside(slot * BRICK + local);
                let raw = element(slot * BRICK + local).map_or(3072, |from| moved[from]);
                let held = match inside {
                    true => raw.min(-20),
                    false if raw <= 0 => 512,
                    false => raw.max(20),
                };
                *out = held as f32 * scale;
            }
        });
        Ok((lumen, WallField { offset_mm, evidence, stats }))
    }
}
