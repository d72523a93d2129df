//! Reading volumes for commands.

use std::path::Path;

use glam::DVec3;

use super::CliError;
use super::global::Global;
use crate::formats::{ReadOptions, inspect, read_volume};
use crate::pipeline::refuse_above;
use crate::volume::{Grid, Samples, Volume, with_samples};

/// Reads a volume, after checking its size against `--max-memory`.
pub fn read_checked(
    path: &Path,
    series: Option<&str>,
    global: &Global,
) -> Result<Volume, CliError> {
    let options = ReadOptions { series: series.map(str::to_owned) };
    if global.max_memory.is_some() {
        let info = inspect(path, &options)?;
        if let Some(image) = info.image {
            let voxels: u64 = image.dims.iter().map(|d| u64::from(*d)).product();
            refuse_above(global.max_memory, voxels, "the volume alone")?;
        }
    }
    let volume = read_volume(path, &options)?;
    let d = volume.grid.dims;
    tracing::info!("read {} x {} x {} voxels", d.x, d.y, d.z);
    if !volume.grid.is_orthogonal() {
        return Err(CliError::Input(format!(
            "{}: the grid's axes are not orthogonal (sheared); distances would be wrong",
            path.display()
        )));
    }
    Ok(volume)
}

/// Labels of `mask` at the voxel centres of `grid`, nearest; 0 beyond the mask.
pub fn resampled(mask: &Volume, grid: Grid) -> Volume {
    fn pick<T: Copy + Default>(from: &[T], mask: &Grid, grid: &Grid) -> Vec<T> {
        let map = mask.voxel_from_world() * grid.world_from_voxel();
        let step = map.transform_vector3(DVec3::X);
        let mut out = Vec::with_capacity(grid.len());
        for k in 0..grid.dims.z {
            for j in 0..grid.dims.y {
                let row = map.transform_point3(DVec3::new(0.0, f64::from(j), f64::from(k)));
                out.extend((0..grid.dims.x).map(|i| {
                    let v = (row + step * f64::from(i)).round().as_ivec3();
                    if mask.contains(v) { from[mask.index(v.as_uvec3())] } else { T::default() }
                }));
            }
        }
        out
    }
    let samples: Samples = with_samples!(&mask.samples, |s| pick(s, &mask.grid, &grid).into());
    Volume { grid, samples, rescale: mask.rescale }
}
