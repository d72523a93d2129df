//! Rows of the paper's chain in the table of stages.

use std::sync::Arc;
use std::time::Instant;

use super::centering::visible;
use super::fields::distance_and_smooth;
use super::{Centered, Clock, Fields, Session, SessionError, present};
use crate::centerline::{Viewpoint, clearance_mm, measure_radius};
use crate::compute::Plan;
use crate::field::LumenBuffers;
use crate::paper::{RidgePoint, paper_path, ridge};

impl Session {
    /// Distance and smoothing with ridge marking, compaction and eigen-analysis, in one plan.
    pub(super) fn run_ridge_fields(&self, clock: &mut Clock) -> Result<Fields, SessionError> {
        let (lumen, device) = (present(&self.slots.lumen), present(&self.slots.device));
        let (lumen, mut device) = (&lumen.lumen, device.lock());
        // A ridge is a curve or a sheet: far fewer voxels than the lumen. Where the guess is too
        // small the counter says by how much, and the chain runs again.
        let mut capacity = (lumen.inside_voxels() as usize / 8).clamp(1024, 1 << 20);
        loop {
            let start = Instant::now();
            let mut plan = Plan::new();
            let buffers = LumenBuffers::new(&mut plan, lumen);
            let (d, f) = distance_and_smooth(&mut plan, &buffers);
            let points = ridge(&mut plan, &buffers, d, f, capacity);
            let mut out = device.run(&plan)?;
            match points.read(&out) {
                Ok(ridge) => {
                    let items = (lumen.inside_voxels(), "voxels");
                    clock.record_plan("distance, ridge", device.name(), start, items, &out);
                    let distance = Arc::new(out.take(d));
                    return Ok(Fields { distance, smooth: out.take(f), ridge });
                }
                Err(total) => capacity = total,
            }
        }
    }

    /// The paper's chain: ridge points in index order, boundary voxels block, kept points joined by
    /// Dijkstra.
    pub(super) fn run_paper_centerline(&self, clock: &mut Clock) -> Result<Centered, SessionError> {
        let (lumen, fields) = (present(&self.slots.lumen), present(&self.slots.fields));
        let (lumen, device) = (&lumen.lumen, present(&self.slots.device));
        let options = self.route_options()?;
        let viewpoints: Vec<Viewpoint> = fields.ridge.iter().map(RidgePoint::viewpoint).collect();
        let internal: Vec<u64> =
            lumen.inside.iter().zip(&lumen.boundary).map(|(i, b)| i & !b).collect();
        let (kept, unseen) = visible(&mut device.lock(), lumen, &viewpoints, &internal, clock)?;
        let kept: Vec<Viewpoint> = kept.iter().map(|r| viewpoints[*r as usize]).collect();
        let work = || paper_path(lumen, &kept, &fields.distance, options);
        let mut line = clock.time("paper path", "kept points", work, |_| kept.len() as u64)?;
        let tree = present(&self.slots.triangle_tree);
        measure_radius(&mut line, &tree, lumen.grid.spacing_mm.max_element());
        Ok(Centered {
            min_clearance_mm: clearance_mm(&line, &tree),
            rerouted: 0,
            outside_mm: Vec::new(),
            beyond_mm: [None; 2],
            junctions: Vec::new(),
            line,
            proof: None,
            candidates: viewpoints.len(),
            on_ridge: true,
            kept: kept.len(),
            added: 0,
            unseen,
            unreachable: 0,
            loops: Vec::new(),
            ends: None,
        })
    }
}
