//! The visibility test: finds the boundary voxels that each candidate sees, and the candidates
//! needed.
//!
//! After the reliable path of He, Hong, Chen and Liang 2001, with an adaptive
//! radius for each point (paper, section 3.2).

use glam::{DVec3, IVec3, UVec3, Vec3};
use rayon::prelude::*;

use crate::compute::{Outputs, Plan};
use crate::field::{LumenBuffers, Sampler};
use crate::geometry::in_rows;
use crate::kernels::visibility as kernel;
use crate::lumen::Lumen;
use crate::lumen::bricks::{BRICK, SIDE, near_offset};

/// A viewpoint of the visibility test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    /// Field element of the viewpoint's voxel.
    pub element: usize,
    /// Range of sight, mm.
    pub reach_mm: f64,
}

/// Number of rays that measure a half-major axis.
const RAYS: usize = 32;

impl Viewpoint {
    /// A viewpoint at an element of the lumen that sees as far as the longest of 32 rays across the
    /// lumen there, plus a voxel's diagonal.
    ///
    /// * `axis`: direction of the lumen, along the index axes.
    /// * `distance`: exact distance, mm.
    pub fn measured(element: usize, axis: Vec3, distance: Sampler<'_>) -> Self {
        crate::task::checkpoint();
        let lumen = distance.lumen;
        let h = lumen.grid.spacing_mm;
        let cap = 6.0 * f64::from(distance.field[element]);
        let p = lumen.bricks.voxel(element).as_dvec3() * h;
        let axis = axis.as_dvec3().try_normalize().unwrap_or(DVec3::Z);
        let (u, v) = axis.any_orthonormal_pair();
        let longest = (0..RAYS)
            .map(|k| {
                let a = std::f64::consts::TAU * k as f64 / RAYS as f64;
                trace(p, u * a.cos() + v * a.sin(), cap, distance)
            })
            .fold(0.0, f64::max);
        Self { element, reach_mm: longest + 3f64.sqrt() * h.max_element() }
    }
}

/// Length of a ray from `p` until the distance falls under half a voxel, at most `cap` mm.
fn trace(p: DVec3, dir: DVec3, cap: f64, distance: Sampler<'_>) -> f64 {
    let least = 0.5 * distance.lumen.grid.spacing_mm.min_element();
    let mut s = 0.0;
    while s < cap {
        let d = distance.at(p + dir * s);
        if d < least {
            return s;
        }
        // The trilinear distance overstates free space by up to √3: step accordingly.
        s += (d / 3f64.sqrt()).max(least);
    }
    cap
}

/// Input arrays of a run of the test, kept while its plan borrows them.
pub struct VisibilityInput {
    seen: Vec<u32>,
    viewer: Vec<u32>,
    reach: Vec<u32>,
    start: Vec<u32>,
    near_viewers: Vec<u32>,
    weight: UVec3,
}

/// Buffers to read after the run.
#[derive(Clone, Copy)]
pub struct Pending {
    first: crate::compute::Buf<u32>,
}

impl VisibilityInput {
    /// Lists, for every brick with boundary voxels, the viewpoints whose ball meets it.
    ///
    /// * `viewpoints`: by rank, the first asked first.
    /// * `seen`: elements of the boundary voxels to be seen, ascending.
    pub fn new(lumen: &Lumen, viewpoints: &[Viewpoint], seen: Vec<u32>) -> Self {
        let h = lumen.grid.spacing_mm;
        // Squared distances in integers: weights are h² over a unit fine enough for the largest
        // ball and coarse enough that nothing overflows 32 bits.
        let widest = viewpoints.iter().map(|v| v.reach_mm).fold(0.0, f64::max);
        let farthest = widest + f64::from(SIDE) * lumen.grid.diagonal_mm() * 2.0;
        let unit =
            (farthest * farthest / f64::from(1u32 << 31)).max(h.min_element().powi(2) / 1024.0);
        let weight = (h * h / unit).round().max(DVec3::ONE).as_uvec3();
        let reach = viewpoints.iter().map(|v| (v.reach_mm.powi(2) / unit) as u32).collect();

        let mut needed = vec![false; lumen.bricks.len()];
        for e in &seen {
            needed[*e as usize / BRICK] = true;
        }
        // Pairs (slot, rank): viewpoints go through the bricks their ball meets.
        let pairs: Vec<(u32, u32)> = viewpoints
            .par_iter()
            .enumerate()
            .with_min_len(16)
            .flat_map_iter(|(rank, v)| {
                crate::task::checkpoint();
                let p = lumen.bricks.voxel(v.element);
                let r = (v.reach_mm / h).ceil().as_ivec3();
                let (lo, hi): (IVec3, IVec3) = ((p - r) >> 3i32, (p + r) >> 3i32);
                let needed = &needed;
                let all = (lo.z..=hi.z).flat_map(move |z| {
                    (lo.y..=hi.y).flat_map(move |y| (lo.x..=hi.x).map(move |x| IVec3::new(x, y, z)))
                });
                all.filter_map(move |b| {
                    let s = lumen.bricks.slot_of(b * SIDE)?;
                    let first = b * SIDE;
                    let close = p.clamp(first, first + SIDE - 1);
                    let gap = ((close - p).as_dvec3() * h).length();
                    (needed[s] && gap <= v.reach_mm).then_some((s as u32, rank as u32))
                })
            })
            .collect();
        let (start, near_viewers) = in_rows(lumen.bricks.len(), || pairs.iter().copied());
        Self {
            seen,
            viewer: viewpoints.iter().map(|v| v.element as u32).collect(),
            reach,
            start,
            near_viewers,
            weight,
        }
    }

    /// Appends the launch. `open`: bits of the voxels a ray may pass.
    pub fn launch<'a>(
        &'a self,
        plan: &mut Plan<'a>,
        lumen: &LumenBuffers,
        open: &'a [u64],
    ) -> Pending {
        let first = plan.undefined::<u32>("first viewer", self.seen.len());
        let bindings = kernel::Bindings {
            near: lumen.near,
            corner: lumen.corner,
            open: plan.upload("open", bytemuck::cast_slice(open)),
            seen: plan.upload("boundary voxels", &self.seen),
            viewer: plan.upload("viewpoints", &self.viewer),
            reach: plan.upload("reach", &self.reach),
            start: plan.upload("viewer lists", &self.start),
            near_viewers: plan.upload("viewpoints near", &self.near_viewers),
            first,
        };
        let boundary = self.seen.len();
        let params = kernel::Params { weight: self.weight.to_array(), boundary: boundary as u32 };
        plan.launch(&kernel::KERNEL, bindings, params, boundary, boundary);
        plan.download(first);
        Pending { first }
    }

    /// Reads which viewpoints are first for some boundary voxel (ranks, ascending) and the elements
    /// of the voxels nobody sees.
    pub fn read(&self, pending: Pending, out: &Outputs) -> (Vec<u32>, Vec<u32>) {
        let first = out.get(pending.first);
        let mut keep = vec![false; self.viewer.len()];
        let mut unseen = Vec::new();
        for (f, s) in first.iter().zip(&self.seen) {
            match keep.get_mut(*f as usize) {
                Some(k) => *k = true,
                None => unseen.push(*s),
            }
        }
        let kept = (0..keep.len() as u32).filter(|r| keep[*r as usize]).collect();
        (kept, unseen)
    }
}

/// Adds viewpoints for boundary voxels nobody saw: for each, the deepest inside voxel near it that
/// sees it, as long as it is not seen by one added before. Voxels without such a viewer stay.
///
/// * `distance`: exact distance, mm.
/// * `limit`: most viewpoints to add.
///
/// Returns the added viewpoints and the elements still unseen.
pub fn add_viewers(
    lumen: &Lumen,
    unseen: &[u32],
    distance: &[f32],
    limit: usize,
) -> (Vec<Viewpoint>, Vec<u32>) {
    let near: &[u32] = bytemuck::cast_slice(lumen.bricks.near());
    let open: &[u32] = bytemuck::cast_slice(&lumen.inside);
    let h = lumen.grid.spacing_mm;
    let mut left: Vec<u32> = unseen.to_vec();
    let mut added = Vec::new();
    let mut hopeless = Vec::new();
    while let Some(&s) = left.first() {
        if added.len() == limit {
            break;
        }
        // Walk uphill from the voxel while it stays in sight.
        let target = lumen.bricks.voxel(s as usize);
        let in_sight = |e: usize| {
            let d = target - lumen.bricks.voxel(e);
            kernel::sees(near, open, s as usize, d)
        };
        let mut at = s as usize;
        loop {
            let up = (0..27)
                .filter(|n| *n != 13)
                .filter_map(|n| lumen.bricks.step(at, near_offset(n)))
                .filter(|&e| lumen.is_inside(e) && distance[e] > distance[at] && in_sight(e))
                .max_by(|&a, &b| distance[a].total_cmp(&distance[b]).then(b.cmp(&a)));
            match up {
                Some(e) => at = e,
                None => break,
            }
        }
        let here = lumen.bricks.voxel(at);
        let reach_mm = (2.0 * f64::from(distance[at]))
            .max(((target - here).as_dvec3() * h).length())
            + 2.0 * lumen.grid.diagonal_mm();
        let before = left.len();
        left.retain(|&e| {
            let d = lumen.bricks.voxel(e as usize) - here;
            (d.as_dvec3() * h).length() > reach_mm || !kernel::sees(near, open, e as usize, d)
        });
        if left.len() == before {
            hopeless.push(s);
            left.retain(|&e| e != s);
        } else {
            added.push(Viewpoint { element: at, reach_mm });
        }
    }
    hopeless.extend(left);
    hopeless.sort_unstable();
    (added, hopeless)
}
