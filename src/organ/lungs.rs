//! Lungs above the organs of the belly: their position, and gas that is joined to them.

use glam::{DVec3, UVec3};

use super::numbers::of_airway::lungs::*;
use super::{SIDES, head_foot_axis};
use crate::lumen::{BitVolume, Piece, eroded, pieces};
use crate::volume::{Grid, Volume};

/// Position of the lungs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lungs {
    /// Lowest point (nearest the feet), LPS z, mm.
    pub lowest_mm: f64,
    /// Middle between left and right, LPS x, mm.
    pub middle_mm: f64,
}

impl Lungs {
    /// Takes large pieces of gas for the lungs.
    pub fn of(grid: &Grid, gas: &[Piece]) -> Option<Self> {
        let to_world = grid.world_from_voxel();
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for piece in gas.iter().filter(|p| p.component.volume_ml(grid) > MIN_LUNG_ML) {
            for &((a, b), y, z) in &piece.runs {
                for x in [a, b] {
                    let at = to_world.transform_point3(UVec3::new(x, y, z).as_dvec3());
                    (low, high) = (low.min(at), high.max(at));
                }
            }
        }
        low.is_finite().then_some(Self { lowest_mm: low.z, middle_mm: 0.5 * (low.x + high.x) })
    }
}

/// The part of a component of gas that is lung, if it has one: across a diaphragm that is thinner
/// than a slice, mixed values join a lung to the gas under it.
///
/// An erosion by the longest voxel side opens such bridges; each voxel belongs to the core to which
/// the way inside the component is shortest. A part is lung if the scan's first or last slice cuts
/// it, and its mean, rim apart, lies well above that of the part with the least.
pub(super) fn lung_of(volume: &Volume, gas: &BitVolume) -> Option<BitVolume> {
    let grid = &volume.grid;
    let cores = eroded(gas, grid.spacing_mm, grid.spacing_mm.max_element());
    let least = (MIN_CORE_ML * 1000.0 / grid.voxel_mm3()).ceil() as u64;
    let mut cores = pieces(&cores, least);
    cores.truncate(MAX_CORES);
    if cores.len() < 2 {
        return None;
    }
    let parts = Parts::around(&cores, gas)?;
    let without_rim = eroded(gas, DVec3::ONE, 1.0);
    let mut sums = vec![(0.0, 0u64); cores.len()];
    for v in without_rim.voxels() {
        if let Some(part) = parts.of(v) {
            let (sum, count) = &mut sums[part];
            *sum += volume.real(grid.index(v));
            *count += 1;
        }
    }
    let means: Vec<f64> = sums.iter().map(|(sum, count)| sum / *count as f64).collect();
    let least = means.iter().copied().fold(f64::INFINITY, f64::min);

    let through = head_foot_axis(grid);
    let mut is_lung = vec![false; cores.len()];
    for v in gas.voxels().filter(|v| v[through] == 0 || v[through] + 1 == grid.dims[through]) {
        if let Some(part) = parts.of(v) {
            is_lung[part] = means[part] > least + ABOVE_GAS_HU;
        }
    }
    let mut lung = BitVolume::new(grid.dims);
    for v in gas.voxels().filter(|v| parts.of(*v).is_some_and(|part| is_lung[part])) {
        lung.set(v.x, v.y, v.z);
    }
    (!lung.is_empty()).then_some(lung)
}

/// Partition of a mask by the nearest core.
struct Parts {
    low: UVec3,
    size: UVec3,
    /// Label of each voxel of the mask's box: 0, or one more than the number of its core.
    labels: Vec<u8>,
}

impl Parts {
    /// Grows all cores by one 6-connected layer after another until they fill the mask. Where two
    /// meet in a layer, the larger one has the voxel.
    fn around(cores: &[Piece], mask: &BitVolume) -> Option<Self> {
        let (low, high) = mask.bounds()?;
        let size = high - low + 1;
        let voxels = size.x as usize * size.y as usize * size.z as usize;
        let mut parts = Self { low, size, labels: vec![0; voxels] };
        let mut layer = Vec::new();
        for (core, label) in cores.iter().zip(1..) {
            for v in core.voxels() {
                let at = parts.index(v);
                parts.labels[at] = label;
                layer.push(v);
            }
        }
        while !layer.is_empty() {
            crate::task::checkpoint();
            let mut next = Vec::new();
            for v in layer {
                let label = parts.labels[parts.index(v)];
                for way in SIDES {
                    let near = v.as_ivec3() + way;
                    if mask.get(near) {
                        let at = parts.index(near.as_uvec3());
                        if parts.labels[at] == 0 {
                            parts.labels[at] = label;
                            next.push(near.as_uvec3());
                        }
                    }
                }
            }
            layer = next;
        }
        Some(parts)
    }

    /// Returns the number of the core to which a voxel of the mask belongs.
    fn of(&self, v: UVec3) -> Option<usize> {
        usize::from(self.labels[self.index(v)]).checked_sub(1)
    }

    fn index(&self, v: UVec3) -> usize {
        let at = v - self.low;
        (at.z as usize * self.size.y as usize + at.y as usize) * self.size.x as usize
            + at.x as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two balls of gas with a bridge a voxel wide, the upper one cut by the last slice if wanted.
    fn balls(upper_hu: i16, height: u32) -> (Volume, BitVolume) {
        let grid = Grid::axis_aligned([40, 40, height], [2.0; 3]);
        let mut gas = BitVolume::new(grid.dims);
        let values: Vec<i16> = (0..grid.len())
            .map(|i| {
                let v = grid.voxel(i);
                let near = |z: i32| (v.as_ivec3() - glam::IVec3::new(20, 20, z)).length_squared();
                let (lower, upper) = (near(15) <= 144, near(40) <= 144);
                let is_bridge = v.x == 20 && v.y == 20 && (15..40).contains(&v.z);
                if lower || upper || is_bridge {
                    gas.set(v.x, v.y, v.z);
                }
                match () {
                    () if lower => -1000,
                    () if upper => upper_hu,
                    () if is_bridge => -850,
                    () => 40,
                }
            })
            .collect();
        (Volume::new(grid, values.into()), gas)
    }

    #[test]
    fn a_lung_is_parted_from_gas_that_a_thin_bridge_joins_it_to() {
        let (volume, gas) = balls(-930, 48);
        let lung = lung_of(&volume, &gas).expect("a lung");
        assert!(lung.at(20, 20, 40) && !lung.at(20, 20, 15));
        // To the voxel, but for the bridge.
        let upper = gas.voxels().filter(|v| v.z > 27).count() as i64;
        assert!((lung.count() as i64 - upper).abs() <= 2);
    }

    #[test]
    fn segments_of_the_same_gas_and_pockets_inside_the_scan_are_no_lung() {
        for (hu, height) in [(-990, 48), (-930, 60)] {
            let (volume, gas) = balls(hu, height);
            assert!(lung_of(&volume, &gas).is_none(), "{hu} HU, {height} slices");
        }
    }
}
