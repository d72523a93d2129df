//! Vessels: the brightest tree of an angiogram, or the aorta and its branches in a CT.

use glam::{DVec3, IVec3, UVec3};

use super::arteries;
use super::depth::Depth;
use super::gates::Gates;
use super::numbers::of_vessel::vessel::*;
pub(super) use super::numbers::of_vessel::vessel::{CT_HU, MAX_ML, SURE_ML};
use super::values::{between, quantile, sorted};
use super::{FoundOrgan, Organ, OrganError, SIDES, Segment};
use crate::lumen::{BitVolume, IntensitySelection, Piece, dilated, eroded, pieces};
use crate::volume::Volume;

/// Inner and outer radius of the shell that surrounds a vessel, voxels.
const AROUND_VOXELS: (f64, f64) = (2.5, 5.0);

pub(super) fn find(volume: &Volume) -> Result<FoundOrgan, OrganError> {
    let mut gates = Gates::new(Organ::Vessel);
    let dims = volume.grid.dims;
    gates.at_least(
        "slices along the shortest axis",
        f64::from(dims.min_element()),
        f64::from(MIN_SIDE),
        24.0,
    )?;
    let Some((low, high)) = volume.range().filter(|(low, high)| low < high) else {
        return Err(gates.refuse("all voxels have the same value"));
    };
    if low < CT_HU {
        return arteries::find(volume, &gates);
    }
    let threshold = of_angiogram(volume, low, high, &mut gates)?;
    grown(volume, threshold, gates)
}

/// The largest component above a threshold, if it is a tree.
fn grown(volume: &Volume, threshold: f64, mut gates: Gates) -> Result<FoundOrgan, OrganError> {
    let Some(tree) = largest_above(volume, threshold) else {
        return Err(gates.refuse(format!("no voxel of {threshold:.0} or more")));
    };
    let grid = &volume.grid;
    let mask = tree.mask(grid.dims);
    let volume_ml = tree.component.volume_ml(grid);
    gates.note(format!("threshold {threshold:.0}: {volume_ml:.2} ml"));
    let alike = flat_share(volume, &mask);
    gates.at_most("share of inner voxels that equal all neighbours", alike, MAX_FLAT, 0.5)?;
    gates.at_most("vessels, ml", volume_ml, MAX_ML, SURE_ML)?;
    let (seed, _) = shape(volume, &tree, &mask, &mut gates)?;
    Ok(FoundOrgan {
        root: None,
        organ: Organ::Vessel,
        mask,
        core: None,
        fluid: None,
        selection: IntensitySelection::Range { lo: threshold, hi: f64::INFINITY },
        threshold,
        segments: vec![Segment { seed, volume_ml }],
        confidence: gates.confidence,
        reasons: gates.reasons,
    })
}

/// Share of the voxels off a mask's surface that have the same value as all six neighbours.
fn flat_share(volume: &Volume, mask: &BitVolume) -> f64 {
    let inner = eroded(mask, DVec3::ONE, 1.0);
    let value = |v: IVec3| volume.real(volume.grid.index(v.as_uvec3()));
    let is_flat = |v: &IVec3| {
        let near = SIDES.map(|side| *v + side);
        near.into_iter().all(|w| !volume.grid.contains(w) || value(w) == value(*v))
    };
    let flat = inner.voxels().map(|v| v.as_ivec3()).filter(is_flat).count();
    flat as f64 / inner.count().max(1) as f64
}

/// Deepest voxel and radius of a tree, which is long for its width and a small part of the volume.
pub(super) fn shape(
    volume: &Volume,
    tree: &Piece,
    mask: &BitVolume,
    gates: &mut Gates,
) -> Result<(UVec3, f64), OrganError> {
    let grid = &volume.grid;
    let part = tree.component.voxels as f64 / grid.len() as f64;
    gates.at_most("share of the volume that is bright", part, MAX_SHARE, 0.04)?;
    let (seed, radius_mm) = Depth::of(*grid, mask).deepest();
    let (lo, hi) = tree.bounds();
    let length_mm = ((hi - lo).as_dvec3() * grid.spacing_mm).length();
    let radii = length_mm / radius_mm.max(1e-9);
    gates.at_least("extent, mm", length_mm, MIN_MM, 150.0)?;
    gates.at_least("extent in radii of the widest place", radii, MIN_RADII, 16.0)?;
    let inner = eroded(mask, DVec3::ONE, 1.0).count() as f64 / mask.count().max(1) as f64;
    gates.at_least("share of voxels off the surface", inner, MIN_INNER, 0.4)?;
    Ok((seed, radius_mm))
}

fn largest_above(volume: &Volume, threshold: f64) -> Option<Piece> {
    pieces(&between(volume, threshold, f64::INFINITY), 1).into_iter().next()
}

/// Returns the threshold: half way between the vessels and their surroundings, or a quarter of the
/// way where the background was set to zero by whoever made the volume, as all that remains is
/// vessel.
fn of_angiogram(
    volume: &Volume,
    low: f64,
    high: f64,
    gates: &mut Gates,
) -> Result<f64, OrganError> {
    let grid = &volume.grid;
    let bins = histogram(volume, low, high);
    let values = bins.iter().filter(|n| **n > 0).count();
    if values < MIN_VALUES {
        return Err(gates.refuse(format!("only {values} values: a label map, not an image")));
    }
    let start = low + (high - low) * otsu(&bins) as f64 / (BINS as f64 - 1.0);
    let Some(bright) = largest_above(volume, start) else {
        return Err(gates.refuse("no bright voxels"));
    };
    let mask = bright.mask(grid.dims);
    let mut around = dilated(&mask, DVec3::ONE, AROUND_VOXELS.1);
    around.remove(&dilated(&mask, DVec3::ONE, AROUND_VOXELS.0));
    let background = quantile(&sorted(volume, around.voxels()), 0.5);
    let depth = Depth::of(*grid, &mask);
    let peak = quantile(&sorted(volume, depth.ridge()), 0.9);
    let median = low + (high - low) * bin_at(&bins, 0.5) as f64 / (BINS as f64 - 1.0);
    let floor = if low < 0.0 && median.abs() < NEAR_ZERO * peak { 0.0 } else { low };
    let is_zeroed = background - floor < ZEROED * (peak - floor);
    let part = if is_zeroed { 0.25 } else { 0.5 };
    gates.note(format!(
        "bright from {start:.0} (Otsu); along its ridge {peak:.0}, around it {background:.0}{}",
        if is_zeroed { ", background removed" } else { "" }
    ));
    Ok(background + part * (peak - background))
}

/// Counts the values between two ends in [`BINS`] bins.
fn histogram(volume: &Volume, low: f64, high: f64) -> Vec<u64> {
    let mut bins = vec![0u64; BINS];
    let scale = (BINS as f64 - 1.0) / (high - low);
    for i in 0..volume.grid.len() {
        let v = volume.real(i);
        // Neither padding, which may lie beyond the ends, nor NaN.
        if (low..=high).contains(&v) {
            bins[((v - low) * scale).round() as usize] += 1;
        }
    }
    bins
}

/// Returns the bin below or in which a share of the values lies.
fn bin_at(bins: &[u64], share: f64) -> usize {
    let wanted = share * bins.iter().sum::<u64>() as f64;
    let up_to = bins.iter().scan(0, |sum, n| {
        *sum += n;
        Some(*sum as f64)
    });
    up_to.take_while(|sum| *sum < wanted).count()
}

/// First bin of the upper class by Otsu's threshold (1979, doi:10.1109/TSMC.1979.4310076).
fn otsu(bins: &[u64]) -> usize {
    let count: u64 = bins.iter().sum();
    let total: f64 = bins.iter().enumerate().map(|(i, n)| i as f64 * *n as f64).sum();
    let (mut below, mut sum) = (0u64, 0.0);
    let mut best = (0.0, 0);
    for (i, n) in bins.iter().enumerate() {
        below += n;
        sum += i as f64 * *n as f64;
        let above = count - below;
        if below == 0 || above == 0 {
            continue;
        }
        let off = sum / below as f64 - (total - sum) / above as f64;
        let between = below as f64 * above as f64 * off * off;
        if between > best.0 {
            best = (between, i + 1);
        }
    }
    best.1
}
