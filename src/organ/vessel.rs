//! Vessels: the brightest tree of an angiogram, or what contrast medium fills in a CT.

use glam::{DVec3, IVec3, UVec3};

use super::depth::Depth;
use super::gates::Gates;
use super::values::{between, quantile, sorted};
use super::{FoundOrgan, Organ, OrganError, Segment};
use crate::lumen::{BitVolume, IntensitySelection, Piece, dilated, eroded, opened, pieces};
use crate::volume::Volume;

/// A volume with values below this is a CT in HU with air in it.
const CT_HU: f64 = -500.0;
/// Least number of slices along each axis: less shows no tree.
const LEAST_SIDE: u32 = 12;
/// Most of a volume that vessels fill.
const MOST_SHARE: f64 = 0.1;
/// Least length in radii of the widest place.
const LEAST_RADII: f64 = 8.0;
/// Least share of its voxels that are not on its surface: below it the vessels are a voxel wide, and
/// what joins them is chance.
const LEAST_INNER: f64 = 0.1;
/// Least length, mm: a pool of tagged fluid is shorter.
const LEAST_MM: f64 = 60.0;
/// Fewest values of an image; what has less is a label map.
const LEAST_VALUES: usize = 16;
/// What surrounds a vessel, voxels.
const AROUND_VOXELS: (f64, f64) = (2.5, 5.0);
/// Of a background that was removed this share of the peak is left at most.
const ZEROED: f64 = 0.1;
/// Half of a volume's values lie this near to zero, in parts of the peak, where noise or the ringing
/// of resampling came after its background was set to zero.
const NEAR_ZERO: f64 = 0.02;
/// Bins of a histogram.
const BINS: usize = 1024;

pub(super) fn find(volume: &Volume) -> Result<FoundOrgan, OrganError> {
    let mut gates = Gates::new(Organ::Vessel);
    let dims = volume.grid.dims;
    gates.at_least(
        "slices along the shortest axis",
        f64::from(dims.min_element()),
        f64::from(LEAST_SIDE),
        24.0,
    )?;
    let Some((low, high)) = volume.range().filter(|(low, high)| low < high) else {
        return Err(gates.refuse("all voxels have the same value"));
    };
    if low < CT_HU {
        return contrast_filled(volume, gates);
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
    let (seed, _) = shape(volume, &tree, &mask, &mut gates)?;
    Ok(FoundOrgan {
        organ: Organ::Vessel,
        mask,
        selection: IntensitySelection::Range { lo: threshold, hi: f64::INFINITY },
        threshold,
        segments: vec![Segment { seed, volume_ml }],
        confidence: gates.confidence,
        reasons: gates.reasons,
    })
}

/// Deepest voxel and radius of a tree, which is long for its width and a small part of the volume.
fn shape(
    volume: &Volume,
    tree: &Piece,
    mask: &BitVolume,
    gates: &mut Gates,
) -> Result<(UVec3, f64), OrganError> {
    let grid = &volume.grid;
    let part = tree.component.voxels as f64 / grid.len() as f64;
    gates.at_most("share of the volume that is bright", part, MOST_SHARE, 0.04)?;
    let (seed, radius_mm) = Depth::of(*grid, mask).deepest();
    let (lo, hi) = tree.bounds();
    let length_mm = ((hi - lo).as_dvec3() * grid.spacing_mm).length();
    let radii = length_mm / radius_mm.max(1e-9);
    gates.at_least("extent in mm", length_mm, LEAST_MM, 150.0)?;
    gates.at_least("extent in radii of the widest place", radii, LEAST_RADII, 16.0)?;
    let inner = eroded(mask, DVec3::ONE, 1.0).count() as f64 / mask.count().max(1) as f64;
    gates.at_least("share of voxels off the surface", inner, LEAST_INNER, 0.4)?;
    Ok((seed, radius_mm))
}

fn largest_above(volume: &Volume, threshold: f64) -> Option<Piece> {
    pieces(&between(volume, threshold, f64::INFINITY), 1).into_iter().next()
}

/// Half way between the vessels and what surrounds them; a quarter where the background was zeroed
/// by whoever made the volume, as what is left of it is vessel.
fn of_angiogram(
    volume: &Volume,
    low: f64,
    high: f64,
    gates: &mut Gates,
) -> Result<f64, OrganError> {
    let grid = &volume.grid;
    let bins = histogram(volume, low, high);
    let values = bins.iter().filter(|n| **n > 0).count();
    if values < LEAST_VALUES {
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

/// How often values occur between two ends.
fn histogram(volume: &Volume, low: f64, high: f64) -> Vec<u64> {
    let mut bins = vec![0u64; BINS];
    let scale = (BINS as f64 - 1.0) / (high - low);
    for i in 0..volume.grid.len() {
        let v = volume.real(i);
        // Neither padding, which may lie beyond the ends, nor what is no number.
        if (low..=high).contains(&v) {
            bins[((v - low) * scale).round() as usize] += 1;
        }
    }
    bins
}

/// The bin up to which a share of the values lies.
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

/// Values of contrast medium in blood, HU.
const BLOOD_HU: (f64, f64) = (150.0, 700.0);
/// Largest standard deviation of 3³ voxels within blood, HU: bone is coarser.
const MOST_SPREAD_HU: f64 = 40.0;
/// Least volume, ml.
const LEAST_ML: f64 = 3.0;
/// Highest value of gas, HU: less than most of a lung has.
const GAS_HU: f64 = -900.0;
/// Most of a region's face on any side that has gas before it: fluid in bowel lies below gas.
const MOST_GAS: f64 = 0.25;
/// Gas this near counts, voxels: in between lie mixed values.
const GAS_VOXELS: i32 = 5;

/// What contrast medium fills in a CT: smooth, bright, long, and away from gas.
fn contrast_filled(volume: &Volume, mut gates: Gates) -> Result<FoundOrgan, OrganError> {
    let grid = &volume.grid;
    let (lo, hi) = BLOOD_HU;
    let mut even = between(volume, lo, hi);
    let uneven: Vec<UVec3> =
        even.voxels().filter(|v| spread(volume, *v) > MOST_SPREAD_HU).collect();
    let mut rough = BitVolume::new(grid.dims);
    uneven.iter().for_each(|v| rough.set(v.x, v.y, v.z));
    even.remove(&rough);
    let even = opened(&even, DVec3::ONE, 1.0);
    let gas = between(volume, f64::NEG_INFINITY, GAS_HU);
    let ml = grid.voxel_mm3() / 1000.0;
    let all = pieces(&even, 1);
    let largest = all.first().map_or(0.0, |p| p.component.voxels as f64 * ml);
    let large: Vec<&Piece> =
        all.iter().take_while(|p| p.component.voxels as f64 * ml >= LEAST_ML).collect();
    let (free, below_gas): (Vec<&Piece>, Vec<&Piece>) = large.into_iter().partition(|p| {
        let mask = p.mask(grid.dims);
        let sides = [IVec3::X, IVec3::Y, IVec3::Z].into_iter().flat_map(|way| [way, -way]);
        sides.into_iter().all(|way| gas_before(p, &mask, &gas, way) <= MOST_GAS)
    });
    let pools_ml = below_gas.iter().map(|p| p.component.voxels as f64 * ml).sum::<f64>();
    let free = free.first();
    let Some(core) = free else {
        return Err(gates.refuse(format!(
            "no even, bright region ({lo} to {hi} HU) of {LEAST_ML} ml away from gas; \
             the largest has {largest:.1} ml"
        )));
    };
    let core_ml = core.component.voxels as f64 * ml;
    gates.at_least("ml of contrast medium", core_ml, LEAST_ML, 20.0)?;
    // Where bowel is full of contrast medium, what lies by itself is bowel too.
    gates.at_most("bright fluid below gas, in parts of that", pools_ml / core_ml, 1.0, 0.2)?;
    let mask = core.mask(grid.dims);
    let (seed, _) = shape(volume, core, &mask, &mut gates)?;
    let values = sorted(volume, core.voxels());
    let peak = quantile(&values, 0.5);
    let mut around = dilated(&mask, DVec3::ONE, AROUND_VOXELS.1);
    around.remove(&dilated(&mask, DVec3::ONE, AROUND_VOXELS.0));
    let background = quantile(&sorted(volume, around.voxels()), 0.5);
    let threshold = 0.5 * (peak + background);
    gates.note(format!("blood {peak:.0} HU, around it {background:.0}"));
    // Blood and its rim; bone that touches is cut off by staying near the even core.
    let mut grown = dilated(&mask, DVec3::ONE, 2.0);
    grown.keep(&between(volume, threshold, hi.max(peak + 200.0)));
    grown.add(&mask);
    let tree = pieces(&grown, 1).into_iter().next();
    let volume_ml = tree.as_ref().map_or(0.0, |t| t.component.volume_ml(grid));
    gates.note(format!("threshold {threshold:.0}: {volume_ml:.1} ml"));
    Ok(FoundOrgan {
        organ: Organ::Vessel,
        mask: tree.map_or(grown, |t| t.mask(grid.dims)),
        selection: IntensitySelection::Range { lo: threshold, hi: f64::INFINITY },
        threshold,
        segments: vec![Segment { seed, volume_ml }],
        confidence: gates.confidence,
        reasons: gates.reasons,
    })
}

/// Share of a region's face on a side that has gas before it.
fn gas_before(region: &Piece, mask: &BitVolume, gas: &BitVolume, way: IVec3) -> f64 {
    let (mut face, mut met) = (0u64, 0u64);
    for v in region.voxels().map(|v| v.as_ivec3()).filter(|v| !mask.get(v + way)) {
        face += 1;
        met += u64::from((1..=GAS_VOXELS).any(|k| gas.get(v + k * way)));
    }
    met as f64 / face.max(1) as f64
}

/// Standard deviation of the 3³ voxels about one.
fn spread(volume: &Volume, v: UVec3) -> f64 {
    let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for k in 0..27 {
        let w = v.as_ivec3() + IVec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1);
        if volume.grid.contains(w) {
            let x = volume.real(volume.grid.index(w.as_uvec3()));
            (n, sum, squares) = (n + 1.0, sum + x, squares + x * x);
        }
    }
    (squares / n - (sum / n).powi(2)).max(0.0).sqrt()
}
