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
/// Thickness of the shell next to the wall in which bridges are cut, voxels.
const SHELL_VOXELS: f64 = 2.0;

/// Largest offset of the field; also that of voxels beyond its bricks. Offsets count [`OFFSET`] to a
/// mean spacing.
const MAX_OFFSET: i32 = 3072;
/// Least distance of a voxel centre from the wall, as an offset.
const MIN_OFFSET: i32 = 20;
/// Offset of a voxel that the field puts inside, but that is not in the final lumen.
const REMOVED_OFFSET: i32 = 512;
/// Edge of a voxel beyond all bricks: half a voxel outside, in the scale of the blur.
const OUTSIDE_EDGE: i32 = 512 * 64;

/// Returns the voxels of a lumen next to its wall. Holes in folds and contacts between bronchi lie
/// there.
fn wall_shell(mask: &BitVolume) -> BitVolume {
    let mut shell = mask.clone();
    shell.remove(&eroded(mask, DVec3::ONE, SHELL_VOXELS));
    shell
}

impl WallProfile<'_> {
    /// Appends the shift of curved edges and the rounding of closed ends. Returns the corrected offsets,
    /// which are downloaded.
    pub fn correct<'p>(&'p self, plan: &mut Plan<'p>) -> Buf<i32> {
        let input = &self.input;
        let slots = input.bricks.len() as u32;
        let elements = input.bricks.field_len();
        let shape = BrickLaunches::new(plan, &input.bricks, &input.brick_copies, &input.grid);

        // 1. Split the level into offsets that agree with the mask, edges, filled and closed voxels.
        let inside = plan.upload("inside", bytemuck::cast_slice::<u64, u32>(&self.inside));
        let level = plan.upload_kept("levels", &self.level, &input.level_copy);
        let [offset, edge, filled, closed] = ["offsets", "edge", "filled", "closed"]
            .map(|name| plan.undefined::<i32>(name, elements));
        let near = shape.near;
        let bindings = wall_sides::Bindings { near, inside, level, offset, edge, filled, closed };
        let params = wall_sides::Params { slots };
        plan.launch(&wall_sides::KERNEL, bindings, params, elements, elements);

        // 2. Smooth edges, filled and closed voxels.
        let spare = [0, 1].map(|_| plan.undefined::<i32>("spare", elements));
        let weights = &input.weights;
        shape.blur(plan, &weights.curvature, edge, spare, edge, OUTSIDE_EDGE);
        shape.blur(plan, &weights.filled, filled, spare, filled, 0);
        shape.blur(plan, &weights.closed, closed, spare, closed, 0);

        // 3. Correct. An edge of curvature k, blurred by s, moves by s² k / 2 (van Vliet & Verbeek 1994).
        // Fixed-point scales are those of the shader. In a colon folds are thinner than the blur and the
        // law does not hold.
        let (mean_spacing, min_spacing) =
            (input.mean_spacing(), input.grid.spacing_mm.min_element());
        let sigma = self.sigma_mm;
        let shift = match input.tissue {
            Tissue::Colon => 0.0,
            _ => 0.5 * sigma * sigma / (min_spacing * mean_spacing) * OFFSET,
        };
        let params = wall_correct::Params {
            slope: input.ratio(OFFSET),
            slots,
            shift: shift.round().min(32768.0) as i32,
            most: (4096.0 * min_spacing / sigma).round() as i32,
            rise: (1024.0 * mean_spacing / min_spacing).round() as i32,
            ..bytemuck::Zeroable::zeroed()
        };
        let moved = plan.undefined::<i32>("moved offsets", elements);
        let bindings = wall_correct::Bindings { near, offset, edge, filled, closed, moved };
        plan.launch(&wall_correct::KERNEL, bindings, params, elements, elements);
        plan.download(moved);
        moved
    }

    /// Selects the final lumen, cuts thin bridges in it, and copies the wall field to its bricks.
    ///
    /// * `moved`: downloaded result of [`Self::correct`].
    ///
    /// # Errors
    /// [`WallError::Empty`] if no voxel is left.
    pub fn finish(self, moved: &[i32]) -> Result<(Lumen, WallField), WallError> {
        let Self { input, mark, level, mask, sigma_mm, .. } = self;
        let bricks = &input.bricks;

        // 1. Select the lumen.
        let lumen_at = |e: usize| mark[e] & wall_peak::JOINED != 0 && moved[e] < 0;
        let mut mask = select::lumen(bricks, &mask, lumen_at).ok_or(WallError::Empty)?;

        // 2. Cut bridges in the shell next to the wall, and beside tagged fluid.
        let max_voxels = match input.tissue {
            Tissue::Airway => Some(MAX_CONTACT_VOXELS),
            Tissue::Colon => Some(MAX_HOLE_VOXELS),
            Tissue::Vessel | Tissue::Unknown => None,
        };
        if let Some(max_voxels) = max_voxels {
            let mut zone = wall_shell(&mask);
            if let Some(fluid) = input.zone {
                zone.add(fluid);
            }
            cut_bridges(&mut mask, &zone, bricks, |e| moved[e], max_voxels);
        }
        let lumen = Lumen::new(input.grid, &mask);
        let stats = stats(&input, sigma_mm, &lumen, &mark, &level);

        // 3. Copy evidence and offsets to the bricks of the lumen, which are not those of the input.
        let scale = (input.mean_spacing() / OFFSET) as f32;
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
                let own = slot * BRICK + local;
                let computed = element(own).map_or(MAX_OFFSET, |from| moved[from]);
                // The sign must agree with the final mask.
                let offset = if lumen.is_inside(own) {
                    computed.min(-MIN_OFFSET)
                } else if computed <= 0 {
                    REMOVED_OFFSET
                } else {
                    computed.max(MIN_OFFSET)
                };
                *out = offset as f32 * scale;
            }
        });
        Ok((lumen, WallField { offset_mm, evidence, stats }))
    }
}
