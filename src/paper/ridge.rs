//! Ridge candidates of the distance map, with their eigen-analysis, as one chain.

use glam::Vec3;

use super::kernels::ridge_measure::STRIDE;
use super::kernels::{compact_count, compact_scatter, prefix_sum, ridge_mark, ridge_measure};
use crate::centerline::Viewpoint;
use crate::compute::{Buf, Outputs, Plan};
use crate::field::LumenBuffers;

/// A point of the distance map's ridge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RidgePoint {
    /// Field element of the point's voxel.
    pub element: usize,
    /// Offset of the ridge point from the voxel's centre, along the index axes, mm.
    pub offset_mm: Vec3,
    /// Exact distance at the voxel, mm.
    pub distance_mm: f32,
    /// Unit direction of the ridge, along the index axes (sign free).
    pub axis: Vec3,
    /// Length of the smoothed map's gradient.
    pub gradient: f32,
    /// Eigenvalues across the axis, ascending, 1/mm.
    pub across: [f32; 2],
}

/// Buffers of the ridge chain.
#[derive(Clone, Copy)]
pub struct RidgePoints {
    sums: Buf<u32>,
    list: Buf<u32>,
    measure: Buf<f32>,
    slots: usize,
}

/// Appends marking, compaction and measuring of ridge candidates.
///
/// * `smoothed`: the distance map after a Gaussian of one voxel.
/// * `capacity`: room for candidates; [`RidgePoints::read`] reports if it was too small.
///
/// The test is the paper's (section 3.1) as `shaders/lib/ridge.wgsl` reads it.
pub fn ridge(
    plan: &mut Plan<'_>,
    lumen: &LumenBuffers,
    distance: Buf<f32>,
    smoothed: Buf<f32>,
    capacity: usize,
) -> RidgePoints {
    let slots = lumen.slots as usize;
    let spacing_mm = lumen.spacing_mm.as_vec3().to_array();
    let marked = plan.undefined::<u32>("ridge bits", slots * 16);
    let count = plan.undefined::<u32>("ridge counts", slots);
    let sums = plan.undefined::<u32>("ridge sums", slots + 1);
    let list = plan.zeroed::<u32>("ridge list", capacity);
    let measure = plan.zeroed::<f32>("ridge measures", capacity * STRIDE);

    let bindings =
        ridge_mark::Bindings { near: lumen.near, inside: lumen.inside, f: smoothed, marked };
    let params = ridge_mark::Params { spacing_mm, slots: lumen.slots };
    plan.launch(&ridge_mark::KERNEL, bindings, params, lumen.field_len(), lumen.items);

    let bindings = compact_count::Bindings { marked, count };
    let params = compact_count::Params { slots: lumen.slots };
    plan.launch(&compact_count::KERNEL, bindings, params, slots, slots);

    let bindings = prefix_sum::Bindings { count, sum: sums };
    let params = prefix_sum::Params { len: lumen.slots };
    plan.launch(&prefix_sum::KERNEL, bindings, params, prefix_sum::THREADS, slots);

    let bindings = compact_scatter::Bindings { marked, sum: sums, list };
    let params = compact_scatter::Params { slots: lumen.slots, capacity: capacity as u32 };
    plan.launch(&compact_scatter::KERNEL, bindings, params, slots, slots);

    let bindings = ridge_measure::Bindings {
        near: lumen.near,
        f: smoothed,
        d: distance,
        total: sums,
        list,
        measure,
    };
    let params = ridge_measure::Params {
        spacing_mm,
        slots: lumen.slots,
        capacity: capacity as u32,
        ..Default::default()
    };
    plan.launch(&ridge_measure::KERNEL, bindings, params, capacity, capacity);

    plan.download(sums);
    plan.download(list);
    plan.download(measure);
    RidgePoints { sums, list, measure, slots }
}

impl RidgePoints {
    /// The candidates in element order.
    ///
    /// # Errors
    /// The number there were, when `capacity` was smaller.
    pub fn read(&self, out: &Outputs) -> Result<Vec<RidgePoint>, usize> {
        let total = out.get(self.sums)[self.slots] as usize;
        if total > self.list.len() {
            return Err(total);
        }
        let measure = out.get(self.measure).chunks_exact(STRIDE);
        Ok(out.get(self.list)[..total]
            .iter()
            .zip(measure)
            .map(|(&e, m)| RidgePoint {
                element: e as usize,
                offset_mm: Vec3::from_slice(m),
                distance_mm: m[3],
                axis: Vec3::from_slice(&m[4..]),
                gradient: m[7],
                across: [m[8], m[9]],
            })
            .collect())
    }
}

impl RidgePoint {
    /// Returns the viewpoint at the ridge point, with the reach of the paper's Eq. 5: k·d, where k is
    /// λ1/λ2 within [1, 3].
    pub fn viewpoint(&self) -> Viewpoint {
        let [l1, l2] = self.across.map(f64::from);
        let k = if l2.abs() < 1e-12 { 3.0 } else { (l1 / l2).clamp(1.0, 3.0) };
        Viewpoint { element: self.element, reach_mm: k * f64::from(self.distance_mm) }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::compute::run_cpu;
    use crate::field::{distance, smooth};
    use crate::lumen::{BitVolume, Lumen};
    use crate::volume::Grid;

    fn lumen(dims: [u32; 3], spacing: [f64; 3], f: impl Fn(DVec3) -> bool) -> Lumen {
        let grid = Grid::axis_aligned(dims, spacing);
        let mut mask = BitVolume::new(grid.dims);
        for v in (0..grid.len()).map(|i| grid.voxel(i)) {
            if f(v.as_dvec3() * grid.spacing_mm) {
                mask.set(v.x, v.y, v.z);
            }
        }
        Lumen::of_volume(grid, &mask)
    }

    fn found(lumen: &Lumen, capacity: usize) -> Result<Vec<RidgePoint>, usize> {
        let mut plan = Plan::new();
        let b = LumenBuffers::new(&mut plan, lumen);
        let d = distance(&mut plan, &b);
        let f = smooth(&mut plan, &b, d, lumen.grid.spacing_mm.min_element(), None);
        let r = ridge(&mut plan, &b, d, f, capacity);
        r.read(&run_cpu(&plan))
    }

    #[test]
    fn the_medial_ridge_of_an_oblique_tube_is_its_axis_and_nothing_else() {
        let (c, t) = (DVec3::new(20.3, 20.2, 30.0), DVec3::new(0.3, 0.2, 1.0).normalize());
        let axis = |p: DVec3| {
            let q = p - c;
            (q - t * q.dot(t), q.dot(t))
        };
        let l = lumen([41, 41, 61], [1.0; 3], |p| {
            let (r, s) = axis(p);
            r.length() < 7.0 && s.abs() < 24.0
        });
        // Near the wall are ridges too, on slopes; a medial point has hardly any.
        let found = found(&l, 100_000).unwrap();
        let at = |c: &RidgePoint| l.bricks.voxel(c.element).as_dvec3() + c.offset_mm.as_dvec3();
        let medial = found.iter().filter(|c| c.gradient < 0.5);
        let core: Vec<_> = medial.map(|c| axis(at(c))).filter(|(_, s)| s.abs() < 15.0).collect();
        assert!(core.len() >= 28, "{}", core.len());
        let worst = core.iter().map(|(r, _)| r.length()).fold(0.0, f64::max);
        assert!(worst < 0.6, "{worst}");
        assert!(found.len() > 3 * core.len(), "{} of {}", core.len(), found.len());
    }

    #[test]
    fn an_overflowing_candidate_list_reports_its_full_count() {
        let l = lumen([31, 31, 41], [1.0; 3], |p| {
            (p.truncate() - glam::DVec2::splat(15.0)).length() < 6.0
        });
        let all = found(&l, 100_000).unwrap().len();
        assert!(all > 10);
        assert_eq!(found(&l, 3).unwrap_err(), all);
    }
}
