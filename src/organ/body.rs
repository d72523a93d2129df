//! The patient's body in a CT, which separates the patient's gas from the air around him and inside
//! his table, cushions and clothes.
//!
//! Tissue is opened with a ball that the plates of a table do not hold; the largest 6-component of
//! the opening is the core of the body, and tissue near it is its wall. In each slice across the
//! patient, what this wall encloses is the inside.

use glam::UVec3;
use rayon::prelude::*;

use super::head_foot_axis;
use super::numbers::of_every_organ::body::*;
use super::values::between;
use crate::lumen::{BitVolume, closed, dilated, eroded, open_background, pieces};
use crate::volume::Volume;

/// The body of a patient.
pub(super) struct PatientBody {
    /// Everything up to the skin, with the air in it.
    pub inside: BitVolume,
}

impl PatientBody {
    /// The largest body of a volume; `None` where there is no tissue.
    pub fn of(volume: &Volume) -> Option<Self> {
        let grid = &volume.grid;
        let spacing_mm = grid.spacing_mm;
        let across = head_foot_axis(grid);
        let tissue = between(volume, TISSUE_HU, f64::INFINITY);
        let extent_mm = grid.dims.as_dvec3() * spacing_mm;
        let least_mm = (0..3).filter(|axis| *axis != across).map(|axis| extent_mm[axis]);
        let radius_mm = OPENING_MM.min(OPENING_PART * least_mm.fold(f64::INFINITY, f64::min));
        let largest = |mask: &BitVolume| pieces(mask, 1).into_iter().next();
        let core = largest(&eroded(&tissue, spacing_mm, radius_mm))?;
        let mut wall = core.mask(grid.dims);
        for _ in 0..=REACH_RADII {
            crate::task::checkpoint();
            wall = dilated(&wall, spacing_mm, radius_mm);
            wall.keep(&tissue);
        }
        let mut flat_mm = spacing_mm;
        flat_mm[across] = 1e9;
        let mut shut = closed(&wall, flat_mm, GAP_RADII * radius_mm);
        shut.add(&wall);
        Some(Self { inside: enclosed(&shut, across) })
    }
}

/// A wall with the voxels that it encloses in each slice across an axis. Where an edge of the slice
/// cuts the wall more than once, the edge between the cuts counts as wall.
fn enclosed(wall: &BitVolume, across: usize) -> BitVolume {
    let dims = wall.dims();
    let (u, v) = [(1, 2), (0, 2), (0, 1)][across];
    let (nu, nv) = (dims[u] as usize, dims[v] as usize);
    let voxel = |slice: u32, p: usize, q: usize| {
        let mut at = UVec3::ZERO;
        (at[across], at[u], at[v]) = (slice, p as u32, q as u32);
        at
    };
    // Pixels of a slice with a frame of one pixel about it.
    let (width, height) = (nu + 2, nv + 2);
    let slices: Vec<Vec<bool>> = (0..dims[across])
        .into_par_iter()
        .map(|slice| {
            let mut set = vec![false; width * height];
            for q in 0..nv {
                for p in 0..nu {
                    let at = voxel(slice, p, q);
                    set[p + 1 + width * (q + 1)] = wall.at(at.x, at.y, at.z);
                }
            }
            for (edge, frame) in [(1, 0), (nv, nv + 1)] {
                close(&mut set, (1..=nu).map(|p| (p + width * edge, p + width * frame)));
            }
            for (edge, frame) in [(1, 0), (nu, nu + 1)] {
                close(&mut set, (1..=nv).map(|q| (edge + width * q, frame + width * q)));
            }
            open_background(width, height, |i| set[i])
        })
        .collect();
    let mut out = BitVolume::new(dims);
    for (slice, open) in (0..).zip(&slices) {
        for q in 0..nv {
            for p in (0..nu).filter(|p| !open[p + 1 + width * (q + 1)]) {
                let at = voxel(slice, p, q);
                out.set(at.x, at.y, at.z);
            }
        }
    }
    out
}

/// Sets the frame's pixels from the first to the last pixel of an edge that is set.
///
/// * `along`: pixels of the edge, each with that of the frame beside it.
fn close(set: &mut [bool], along: impl Iterator<Item = (usize, usize)> + Clone) {
    let cuts = || along.clone().enumerate().filter(|(_, (edge, _))| set[*edge]).map(|(k, _)| k);
    let (Some(first), Some(last)) = (cuts().min(), cuts().max()) else { return };
    for (_, frame) in along.take(last + 1).skip(first) {
        set[frame] = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Grid;

    /// A body of 80 × 60 mm with a hole of gas, on a hollow table whose upper plate it touches.
    fn on_table(from: u32) -> (Volume, impl Fn(u32, u32) -> UVec3) {
        let grid = Grid::axis_aligned([120 - from, 110, 24], [1.0; 3]);
        let values: Vec<i16> = (0..grid.len())
            .map(|i| {
                let v = (grid.voxel(i) + UVec3::new(from, 0, 0)).as_dvec3();
                let body = ((v.x - 60.0) / 40.0).powi(2) + ((v.y - 35.0) / 30.0).powi(2) < 1.0;
                let gas = (v.x - 50.0).hypot(v.y - 35.0) < 12.0;
                let box_of =
                    |d: f64| (v.x - 60.0).abs() <= 52.0 - d && (v.y - 84.0).abs() <= 20.0 - d;
                let plate = box_of(0.0) && !box_of(3.0);
                if (body && !gas) || plate { 30 } else { -1000 }
            })
            .collect();
        (Volume::new(grid, values.into()), move |x, y| UVec3::new(x - from, y, 12))
    }

    #[test]
    fn the_air_between_a_tables_plates_lies_outside_the_body_that_touches_it() {
        let (volume, at) = on_table(0);
        let body = PatientBody::of(&volume).unwrap();
        let inside = |x, y| body.inside.get(at(x, y).as_ivec3());
        assert!(inside(50, 35) && inside(90, 35) && inside(50, 24), "gas and tissue");
        assert!(!inside(60, 84) && !inside(20, 90) && !inside(100, 75), "the table");
        assert!(!inside(2, 2) && !inside(117, 35), "the room");
    }

    #[test]
    fn gas_that_the_edge_of_the_scan_cuts_stays_inside_and_the_room_does_not() {
        let (volume, at) = on_table(50);
        let body = PatientBody::of(&volume).unwrap();
        let inside = |x, y| body.inside.get(at(x, y).as_ivec3());
        assert!(inside(50, 35) && inside(50, 12) && !inside(50, 2) && !inside(50, 90));
    }

    #[test]
    fn a_volume_without_tissue_has_no_body() {
        let grid = Grid::axis_aligned([20, 20, 20], [1.0; 3]);
        assert!(PatientBody::of(&Volume::new(grid, vec![-1000i16; grid.len()].into())).is_none());
    }
}
