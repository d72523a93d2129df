//! Reading the volumes of a session.

use std::sync::Arc;

use glam::DVec3;

use super::report::hash_of;
use super::settings::{Source, VolumeSource};
use super::{Clock, InputReport, Session, SessionError, present, refuse_above};
use crate::formats::{FormatError, InputInfo, ReadOptions, inspect, read_mesh, read_volume, shown};
use crate::lumen::{IntensitySelection, enclosing_grid, voxelized};
use crate::volume::{Grid, Rescale, SampleType, Samples, Volume, with_samples};

/// The volume the lumen is chosen from.
pub(super) struct Loaded {
    pub volume: Arc<Volume>,
    /// The image a label map was drawn on, as its header says; its voxels were not read.
    pub image: Option<InputReport>,
    /// The label map as it was read, where it had to be resampled.
    pub resampled: Option<InputReport>,
    /// Whether it is a label map given as such.
    pub is_mask: bool,
}

/// Inputs as the report describes them.
pub(super) struct Inputs {
    pub input: Option<InputReport>,
    pub mask: Option<InputReport>,
}

impl Loaded {
    /// Values or labels inside; `None` where neither settings nor volume say.
    pub fn selection(&self, chosen: Option<&IntensitySelection>) -> Option<IntensitySelection> {
        let is_labels = || self.is_mask || is_label_map(&self.volume);
        chosen.cloned().or_else(|| is_labels().then(|| IntensitySelection::Labels(Vec::new())))
    }
}

impl Session {
    pub(super) fn run_volume(&self, clock: &mut Clock) -> Result<Loaded, SessionError> {
        let read = || self.load();
        let voxels = |l: &Result<Loaded, _>| l.as_ref().map_or(0, |l| l.volume.grid.len() as u64);
        clock.time("read", "voxels", read, voxels)
    }

    pub(super) fn run_value_range(
        &self,
        clock: &mut Clock,
    ) -> Result<Option<(f64, f64)>, SessionError> {
        let volume = Arc::clone(&present(&self.slots.loaded).volume);
        let voxels = volume.grid.len() as u64;
        Ok(clock.time("value range", "voxels", || volume.range(), |_| voxels))
    }

    pub(super) fn run_identity(&self, _: &mut Clock) -> Result<String, SessionError> {
        Ok(hash_of(&present(&self.slots.loaded).volume))
    }

    pub(super) fn run_inputs(&self, _: &mut Clock) -> Result<Inputs, SessionError> {
        let (loaded, identity) = (present(&self.slots.loaded), present(&self.slots.identity));
        let own = || InputReport::with_hash(&loaded.volume, String::clone(&identity));
        let own = loaded.resampled.clone().unwrap_or_else(own);
        Ok(match loaded.is_mask {
            true => Inputs { input: loaded.image.clone(), mask: Some(own) },
            false => Inputs { input: Some(own), mask: None },
        })
    }

    /// The series or segments of an input from which one has to be chosen, where an error says so,
    /// and whether that input is the mask.
    pub fn contents(&self, error: &SessionError) -> Option<(InputInfo, bool)> {
        let SessionError::Format(error) = error else { return None };
        let (file, is_segments) = match error {
            FormatError::Series { file, .. } => (file, false),
            FormatError::Segments { file, .. } => (file, true),
            _ => return None,
        };
        let sources = match &self.source {
            Source::Image(image) => [Some((image, false)), None],
            Source::Mask { mask, image } => {
                [Some((mask, true)), image.as_ref().map(|i| (i, false))]
            }
        };
        sources.into_iter().flatten().find_map(|(source, is_mask)| {
            let VolumeSource::File { path, options } = source else { return None };
            let mut all = ReadOptions { segments: Vec::new(), ..options.clone() };
            if !is_segments {
                all.series = None;
            }
            (path == file).then(|| Some((inspect(path, &all).ok()?, is_mask)))?
        })
    }

    fn load(&self) -> Result<Loaded, SessionError> {
        let limit = self.settings.max_memory_mb;
        match &self.source {
            Source::Image(source) => {
                let volume = read_orthogonal_volume(source, limit)?;
                Ok(Loaded { volume, image: None, resampled: None, is_mask: false })
            }
            Source::Mask { mask, image } => {
                let volume = read_orthogonal_volume(mask, limit)?;
                let image = image.as_ref().map(geometry).transpose()?;
                let mut loaded = Loaded { volume, image: None, resampled: None, is_mask: true };
                if let Some((grid, report)) = image {
                    loaded.image = Some(report);
                    if !same_grid(&grid, &loaded.volume.grid) {
                        match is_part(&loaded.volume.grid, &grid) {
                            true => tracing::info!("the mask covers a part of the input's grid"),
                            false => tracing::warn!(
                                "the mask lies on another grid: resampled to the input's, nearest \
                                 label"
                            ),
                        }
                        loaded.resampled = Some(InputReport::of(&loaded.volume));
                        loaded.volume = Arc::new(resampled(&loaded.volume, grid));
                    }
                }
                Ok(loaded)
            }
        }
    }
}

/// Reads a volume after checking its size against a limit.
///
/// # Errors
/// As [`read_volume`]; [`SessionError::Memory`].
pub fn read_any_volume(
    source: &VolumeSource,
    max_memory_mb: Option<u64>,
) -> Result<Arc<Volume>, SessionError> {
    Ok(match source {
        VolumeSource::Memory(volume) => Arc::clone(volume),
        VolumeSource::File { path, options } => Arc::new(read_file(path, options, max_memory_mb)?),
    })
}

/// Reads a volume on which distances are computed: its axes must be orthogonal.
///
/// # Errors
/// As [`read_any_volume`]; [`SessionError::ShearedGrid`].
pub fn read_orthogonal_volume(
    source: &VolumeSource,
    max_memory_mb: Option<u64>,
) -> Result<Arc<Volume>, SessionError> {
    let volume = read_any_volume(source, max_memory_mb)?;
    check_axes(&volume.grid, source)?;
    Ok(volume)
}

fn read_file(
    path: &std::path::Path,
    options: &ReadOptions,
    max_memory_mb: Option<u64>,
) -> Result<Volume, SessionError> {
    if max_memory_mb.is_some() && !is_mesh(path) {
        let info = inspect(path, options)?;
        if let Some(image) = info.image {
            let bytes = image.bytes() + image.reading_bytes;
            refuse_above(max_memory_mb, bytes, "the volume alone")?;
        }
    }
    let volume = match is_mesh(path) {
        true => read_enclosed(path, options.mesh_spacing_mm, max_memory_mb)?,
        false => read_volume(path, options)?,
    };
    let d = volume.grid.dims;
    tracing::info!("read {} x {} x {} voxels", d.x, d.y, d.z);
    Ok(volume)
}

/// Whether a file is a surface by its name.
fn is_mesh(path: &std::path::Path) -> bool {
    let name = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    name.is_some_and(|e| ["ply", "stl", "obj", "vtp", "glb"].contains(&e.as_str()))
}

/// Label map of the voxels that a closed surface encloses.
fn read_enclosed(
    path: &std::path::Path,
    spacing_mm: Option<f64>,
    max_memory_mb: Option<u64>,
) -> Result<Volume, SessionError> {
    let (mesh, warnings) = read_mesh(path, None)?;
    warnings.iter().for_each(|line| tracing::warn!("{line}"));
    let refused = |why| SessionError::Enclosed { name: shown(path), why };
    let grid = enclosing_grid(&mesh, spacing_mm).map_err(refused)?;
    // A bit and a label a voxel; places and edges of the mesh.
    let voxels = grid.len() as u64;
    let faces = mesh.faces.len() as u64;
    let bytes = voxels + voxels / 8 + 24 * mesh.positions.len() as u64 + 60 * faces;
    refuse_above(max_memory_mb, bytes, "the voxels that the mesh encloses")?;
    let mask = voxelized(&mesh, &grid).map_err(refused)?;
    drop(mesh);
    let mut labels = vec![0u8; grid.len()];
    mask.voxels().for_each(|v| labels[grid.index(v)] = 1);
    Ok(Volume::new(grid, labels.into()))
}

fn check_axes(grid: &Grid, source: &VolumeSource) -> Result<(), SessionError> {
    if grid.is_orthogonal() {
        return Ok(());
    }
    Err(SessionError::ShearedGrid { name: source.name() })
}

/// Grid and description of an image whose voxels are not needed.
fn geometry(source: &VolumeSource) -> Result<(Grid, InputReport), SessionError> {
    let (grid, report) = match source {
        VolumeSource::Memory(volume) => (volume.grid, InputReport::of(volume)),
        VolumeSource::File { path, options } => {
            let info = inspect(path, options)?;
            match info.image.and_then(|image| Some((image.grid().ok()?, image))) {
                Some((grid, image)) => {
                    let report = InputReport::of_header(&grid, image.sample_type);
                    (grid, report.of_acquisition(info.acquisition.as_ref()))
                }
                // A format whose header does not say enough is read.
                None => {
                    let volume = read_volume(path, options)?;
                    (volume.grid, InputReport::of(&volume))
                }
            }
        }
    };
    check_axes(&grid, source)?;
    Ok((grid, report))
}

/// Labels of `mask` at the voxel centres of `grid`, nearest; 0 beyond the mask.
fn resampled(mask: &Volume, grid: Grid) -> Volume {
    fn pick<T: Copy + Default>(from: &[T], mask: &Grid, grid: &Grid) -> Vec<T> {
        let map = mask.voxel_from_world() * grid.world_from_voxel();
        let step = map.transform_vector3(DVec3::X);
        let mut out = Vec::with_capacity(grid.len());
        for k in 0..grid.dims.z {
            crate::task::checkpoint();
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
    Volume { rescale: mask.rescale, padding: mask.padding, ..Volume::new(grid, samples) }
}

fn same_grid(g: &Grid, h: &Grid) -> bool {
    let corner = g.dims.as_dvec3();
    let off = |p: DVec3| {
        (g.world_from_voxel().transform_point3(p) - h.world_from_voxel().transform_point3(p))
            .length()
    };
    g.dims == h.dims && off(DVec3::ZERO).max(off(corner)) < 0.01 * g.spacing_mm.min_element()
}

/// Whether the voxels of a grid are voxels of another, as those of a cropped volume are.
fn is_part(part: &Grid, whole: &Grid) -> bool {
    let map = whole.voxel_from_world() * part.world_from_voxel();
    let is_voxel = |v: DVec3| {
        let at = map.transform_point3(v);
        (at - at.round()).abs().max_element() < 0.01 && whole.contains(at.round().as_ivec3())
    };
    let turned = map.matrix3 - glam::DMat3::IDENTITY;
    let last = (part.dims - 1).as_dvec3();
    turned.to_cols_array().iter().all(|x| x.abs() < 0.01) && is_voxel(DVec3::ZERO) && is_voxel(last)
}

/// Most distinct values of a volume that is taken for a label map without being told.
const LABELS: usize = 32;

fn is_label_map(volume: &Volume) -> bool {
    if !volume.samples.sample_type().is_integer() || volume.rescale != Rescale::IDENTITY {
        return false;
    }
    let mut seen: Vec<i64> = Vec::new();
    let bytes = volume.samples.sample_type() == SampleType::U8;
    for i in 0..volume.samples.len() {
        if i % (1 << 20) == 0 {
            crate::task::checkpoint();
        }
        let v = volume.samples.get(i) as i64;
        if !seen.contains(&v) {
            // Labels are small and not negative; the many values of an image show at once.
            if v < 0 || (!bytes && v > 10_000) || seen.len() == LABELS {
                return false;
            }
            seen.push(v);
        }
    }
    true
}
