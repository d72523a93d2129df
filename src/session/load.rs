//! Reading the volumes of a session.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use glam::DVec3;

use super::memory::in_parts_bytes;
use super::report::hash_of;
use super::settings::{Reading, Settings, Source, VolumeSource};
use super::{Clock, InputReport, Session, SessionError, locked, present, put, refuse_above};
use crate::formats::{
    FormatError, InputInfo, ReadOptions, VolumeParts, inspect, is_mesh, read_mesh, read_volume,
    shown,
};
use crate::lumen::{BitVolume, IntensitySelection, enclosing_grid, select_in_parts, voxelized};
use crate::volume::{Grid, Rescale, SampleType, Samples, Volume, with_samples};

/// Bytes of samples above which a volume is read in parts, where that is possible.
pub const IN_PARTS_ABOVE: u64 = 1 << 30;

/// A volume in memory, one that is read in parts, or a header whose samples were dropped.
pub(super) enum InputVolume {
    Whole(Arc<Volume>),
    Parts(Box<InputParts>),
    /// A volume whose samples were dropped once no stage read them any more.
    Released(Box<(Grid, InputReport)>),
}

/// A volume that is read in parts, after the first time from end to end.
pub(super) struct InputParts {
    pub parts: VolumeParts,
    /// BLAKE3 of the samples, as of the whole volume.
    pub hash: String,
    /// Voxels in a selection, until the core is chosen among them.
    selected: Mutex<Option<(IntensitySelection, BitVolume)>>,
}

impl InputVolume {
    /// The volume in memory.
    pub fn whole(&self) -> Option<&Arc<Volume>> {
        match self {
            Self::Whole(volume) => Some(volume),
            Self::Parts(_) | Self::Released(_) => None,
        }
    }

    /// Grid of the whole volume.
    pub fn grid(&self) -> &Grid {
        match self {
            Self::Whole(volume) => &volume.grid,
            Self::Parts(input) => input.parts.grid(),
            Self::Released(left) => &left.0,
        }
    }

    /// Describes the volume, without a hash of its samples.
    fn report(&self) -> InputReport {
        match self {
            Self::Whole(volume) => InputReport::without_hash(volume),
            Self::Parts(input) => {
                let sample_type = input.parts.sample_type().name().to_owned();
                InputReport::of_header(input.parts.grid(), sample_type)
            }
            Self::Released(left) => left.1.clone(),
        }
    }

    /// Bytes of samples in memory.
    pub fn bytes(&self) -> u64 {
        self.whole().map_or(0, |volume| volume.samples.bytes().len() as u64)
    }
}

impl InputParts {
    /// Reads a volume from end to end: its hash, and the voxels in a selection.
    fn read(parts: VolumeParts, selection: IntensitySelection) -> Result<Self, FormatError> {
        parts.warn();
        let mut hash = blake3::Hasher::new();
        let selected = select_in_parts(&parts, &selection, |samples| {
            hash.update(samples.bytes());
        })?;
        let (hash, selected) = (hash.finalize().to_hex().to_string(), Some((selection, selected)));
        Ok(Self { parts, hash, selected: Mutex::new(selected) })
    }

    /// The voxels in a selection: those found when it was read, or read again.
    pub fn select(&self, selection: &IntensitySelection) -> Result<BitVolume, FormatError> {
        match locked(&self.selected).take() {
            Some((own, selected)) if own == *selection => Ok(selected),
            _ => select_in_parts(&self.parts, selection, |_| ()),
        }
    }
}

/// The volume the lumen is chosen from.
pub(super) struct Loaded {
    pub volume: InputVolume,
    /// The image a label map was drawn on, as its header says; its voxels were not read.
    pub image: Option<InputReport>,
    /// The label map as it was read, where it had to be resampled.
    pub resampled: Option<InputReport>,
    /// Whether it is a label map given as such.
    pub is_mask: bool,
    /// Whether core and wall read no more samples.
    samples_done: AtomicBool,
}

/// Inputs as the report describes them.
pub(super) struct Inputs {
    pub input: Option<InputReport>,
    pub mask: Option<InputReport>,
}

impl Loaded {
    fn new(volume: InputVolume, image: Option<InputReport>, is_mask: bool) -> Self {
        Self { volume, image, resampled: None, is_mask, samples_done: AtomicBool::new(false) }
    }

    /// Values or labels inside; `None` where neither settings nor volume say.
    pub fn selection(&self, chosen: Option<&IntensitySelection>) -> Option<IntensitySelection> {
        let is_labels = || self.is_mask || self.volume.whole().is_some_and(|v| is_label_map(v));
        chosen.cloned().or_else(|| is_labels().then(|| IntensitySelection::Labels(Vec::new())))
    }
}

impl Session {
    pub(super) fn run_volume(&self, clock: &mut Clock) -> Result<Loaded, SessionError> {
        let read = || self.load();
        let voxels = |l: &Result<Loaded, _>| l.as_ref().map_or(0, |l| l.volume.grid().len() as u64);
        clock.time("read", "voxels", read, voxels)
    }

    pub(super) fn run_value_range(
        &self,
        clock: &mut Clock,
    ) -> Result<Option<(f64, f64)>, SessionError> {
        let volume = self.whole(&present(&self.slots.loaded))?;
        let voxels = volume.grid.len() as u64;
        Ok(clock.time("value range", "voxels", || volume.range(), |_| voxels))
    }

    pub(super) fn run_identity(&self, _: &mut Clock) -> Result<String, SessionError> {
        let loaded = present(&self.slots.loaded);
        Ok(match &loaded.volume {
            InputVolume::Parts(input) => input.hash.clone(),
            _ => hash_of(&*self.whole(&loaded)?),
        })
    }

    pub(super) fn run_inputs(&self, _: &mut Clock) -> Result<Inputs, SessionError> {
        let (loaded, identity) = (present(&self.slots.loaded), present(&self.slots.identity));
        let hash = || Some(String::clone(&identity));
        let own = || InputReport { hash: hash(), ..loaded.volume.report() };
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
        if let Some(loaded) = self.load_in_parts()? {
            return Ok(loaded);
        }
        let limit = self.settings.max_memory_mb;
        match &self.source {
            Source::Image(source) => {
                let volume = read_orthogonal_volume(source, limit)?;
                let volume = InputVolume::Whole(canonical(volume));
                Ok(Loaded::new(volume, None, false))
            }
            Source::Mask { mask, image } => {
                let mut volume = canonical(read_orthogonal_volume(mask, limit)?);
                let image = image.as_ref().map(geometry).transpose()?;
                let image = image.map(|(grid, report)| (grid.canonical(), report));
                let mut resampled = None;
                if let Some((grid, _)) = &image
                    && !same_grid(grid, &volume.grid)
                {
                    match is_part(&volume.grid, grid) {
                        true => tracing::info!("the mask covers a part of the input's grid"),
                        false => tracing::warn!(
                            "the mask lies on another grid: resampled to the input's, nearest label"
                        ),
                    }
                    resampled = Some(InputReport::of(&volume));
                    volume = Arc::new(resample(&volume, *grid));
                } else if let Some((grid, _)) = &image {
                    // Files are written as the image is stored.
                    Arc::make_mut(&mut volume).grid.order = grid.order;
                }
                let (image, volume) = (image.map(|i| i.1), InputVolume::Whole(volume));
                Ok(Loaded { resampled, ..Loaded::new(volume, image, true) })
            }
        }
    }

    /// Reads a volume in parts; `None` where the settings or the file do not let it be, or it is
    /// small.
    fn load_in_parts(&self) -> Result<Option<Loaded>, SessionError> {
        let (source, is_mask) = match &self.source {
            Source::Image(image) => (image, false),
            Source::Mask { mask, image: None } => (mask, true),
            Source::Mask { .. } => return Ok(None),
        };
        let VolumeSource::File { path, options } = source else { return Ok(None) };
        let Settings { reading, lumen, max_memory_mb, .. } = &self.settings;
        let labels = || is_mask.then(|| IntensitySelection::Labels(Vec::new()));
        let selection = lumen.select.clone().or_else(labels);
        let is_plain = lumen.organ.is_none() && !lumen.leak_control && !is_mesh(path);
        let (Some(selection), true) = (selection, is_plain && !self.keep_volume) else {
            return Ok(None);
        };
        if *reading == Reading::Whole {
            return Ok(None);
        }
        let Some(parts) = VolumeParts::open(path, options)? else { return Ok(None) };
        let bytes = parts.bytes();
        let is_beyond = |mb: u64| bytes + parts.grid().len() as u64 / 8 > mb * 1_000_000;
        let is_large = bytes > IN_PARTS_ABOVE || max_memory_mb.is_some_and(is_beyond);
        if *reading == Reading::Auto && !is_large {
            return Ok(None);
        }
        check_axes(parts.grid(), source)?;
        refuse_above(*max_memory_mb, in_parts_bytes(&parts), "reading the volume in parts")?;
        let parts = parts.canonical();
        let d = parts.grid().dims;
        tracing::info!("reading {} x {} x {} voxels in parts", d.x, d.y, d.z);
        let volume = InputVolume::Parts(Box::new(InputParts::read(parts, selection)?));
        Ok(Some(Loaded::new(volume, None, is_mask)))
    }

    /// The whole volume, of one that is read in parts or whose samples were released too.
    pub(super) fn whole(&self, loaded: &Loaded) -> Result<Arc<Volume>, SessionError> {
        match (&loaded.volume, &self.source) {
            (InputVolume::Whole(volume), _) => Ok(Arc::clone(volume)),
            (InputVolume::Released(_), _) => self.whole(&self.load()?),
            (_, Source::Image(source) | Source::Mask { mask: source, .. }) => {
                Ok(canonical(read_any_volume(source, self.settings.max_memory_mb)?))
            }
        }
    }

    /// The volume with its samples, which are read again where they were released.
    pub(super) fn with_samples(&self) -> Result<Arc<Loaded>, SessionError> {
        let loaded = present(&self.slots.loaded);
        if !matches!(loaded.volume, InputVolume::Released(_)) {
            return Ok(loaded);
        }
        put(&self.slots.loaded, self.load()?);
        Ok(present(&self.slots.loaded))
    }

    /// Takes note that neither core nor wall read more samples, and drops them unless they are
    /// hashed or kept. Returns the bytes that stay in memory.
    pub(super) fn end_samples(&self) -> u64 {
        present(&self.slots.loaded).samples_done.store(true, Ordering::Relaxed);
        self.release_volume();
        present(&self.slots.loaded).volume.bytes()
    }

    /// Drops the samples of a file's volume if neither core nor wall read more of them; what
    /// describes the volume stays.
    pub(super) fn release_samples(&self) {
        let mut slot = locked(&self.slots.loaded);
        let Some(loaded) = &*slot else { return };
        let (Source::Image(source) | Source::Mask { mask: source, .. }) = &self.source;
        let is_whole = loaded.volume.whole().is_some();
        let is_file = matches!(source, VolumeSource::File { .. });
        if !loaded.samples_done.load(Ordering::Relaxed) || !is_whole || !is_file {
            return;
        }
        let left = (*loaded.volume.grid(), loaded.volume.report());
        let volume = InputVolume::Released(Box::new(left));
        let resampled = loaded.resampled.clone();
        let image = loaded.image.clone();
        *slot = Some(Arc::new(Loaded { resampled, ..Loaded::new(volume, image, loaded.is_mask) }));
    }
}

/// The volume with the axes nearest to left, posterior and superior.
pub(super) fn canonical(volume: Arc<Volume>) -> Arc<Volume> {
    if volume.grid.canonical().order.is_identity() {
        return volume;
    }
    // What nobody else holds is turned where it is.
    Arc::new(Arc::unwrap_or_clone(volume).canonical())
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

/// Data that take memory where a volume is read whole, and what would take less.
const WHOLE: &str = "the volume alone; where a range of values or labels chooses the lumen, without \
                     an organ or leak control, OME-Zarr and uncompressed files are read in parts";

fn read_file(
    path: &std::path::Path,
    options: &ReadOptions,
    max_memory_mb: Option<u64>,
) -> Result<Volume, SessionError> {
    if max_memory_mb.is_some() && !is_mesh(path) {
        let info = inspect(path, options)?;
        if let Some(image) = info.image {
            let bytes = image.bytes() + image.reading_bytes;
            refuse_above(max_memory_mb, bytes, WHOLE)?;
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
fn resample(mask: &Volume, grid: Grid) -> Volume {
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
