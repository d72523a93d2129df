//! Choosing the core of the lumen, and the lumen from it.
//!
//! The core (threshold, label, organ) decides which lumen is meant. In grey values the wall field
//! decides where its wall is; of label maps and of an exact wall the core is the lumen.

use std::sync::Arc;
use std::time::Instant;

use glam::{IVec3, UVec3};

use super::load::{InputVolume, Loaded, canonical};
use super::memory::{RunSize, estimate_bytes, in_parts_bytes};
use super::settings::{Antialiasing, Lod, Seed, Source, VolumeSource, WallMethod};
use super::{Clock, Session, SessionError, present, read_any_volume, refuse_above};
use crate::compute::Plan;
use crate::device::Device;
use crate::formats::{SegmentDescription, SnomedCode};
use crate::lumen::bricks::BRICK;
use crate::lumen::{
    BitVolume, Component, GreyBricks, GreyValues, IntensitySelection, Lumen, LumenError,
    SegmentationOptions, SegmentationStats, check_seed_in_parts, fill_cavities,
};
use crate::organ::{self, FoundOrgan, Organ, OrganOptions};
use crate::surface::relaxes_by_default;
use crate::volume::{Grid, Volume};
use crate::wall::{CleansedFluid, Tissue, WallField, WallInput, bricks_about};

/// The mask that decides which lumen is meant, and which way a route can take.
pub struct Core {
    /// Voxels of the core, cavities filled.
    pub mask: BitVolume,
    /// Components left out, cavities filled, leaks.
    pub found: SegmentationStats,
    /// The options it was chosen with, the seed as a voxel.
    pub options: SegmentationOptions,
    /// The organ, where one was looked for.
    pub organ: Option<FoundOrgan>,
    /// Notes for the user about the result, a sentence each.
    pub notes: Vec<String>,
}

impl Core {
    /// The voxels that the wall is drawn about: of an organ without mixed ones at its wall.
    pub fn voxels(&self) -> &BitVolume {
        self.organ.as_ref().and_then(|o| o.core.as_ref()).unwrap_or(&self.mask)
    }
}

/// The lumen with what choosing it found.
pub struct Segmented {
    /// Bricks and classes.
    pub lumen: Lumen,
    /// Wall field, where grey values place the wall between voxels.
    pub wall: Option<WallField>,
    /// Method by which the wall is placed; never [`WallMethod::Auto`].
    pub method: WallMethod,
    /// Components left out, cavities filled, leaks.
    pub found: SegmentationStats,
    /// The options it was chosen with, the seed as a voxel.
    pub options: SegmentationOptions,
    /// The organ, where one was looked for.
    pub organ: Option<FoundOrgan>,
    /// Notes for the user about the result, a sentence each.
    pub notes: Vec<String>,
}

impl Segmented {
    /// A voxel from which the surface is tracked: the seed, where one was given. A wall field may
    /// part what the seed's component was; all of its parts have a surface then.
    pub fn track_from(&self) -> Option<IVec3> {
        if self.wall.is_some() {
            return None;
        }
        let seed = self.options.seed.filter(|_| !self.options.all_components)?;
        Some(self.lumen.own_voxel(seed.as_ivec3()))
    }

    /// Returns what the lumen is in a segmentation that is written of it: the organ, or any lumen.
    /// Colours are those of 3D Slicer's anatomy.
    pub fn description(&self) -> SegmentDescription {
        let (name, rgb, value, meaning) = match self.organ.as_ref().map(|o| o.organ) {
            Some(Organ::Airway) => ("Airway", [182, 228, 255], "110726009", "Trachea and bronchus"),
            Some(Organ::Colon) => ("Colon", [204, 168, 143], "71854001", "Colon"),
            Some(Organ::Vessel) => ("Vessel", [206, 110, 84], "59820001", "Blood vessel"),
            None => ("Lumen", [128, 174, 128], "113342003", "Lumen"),
        };
        let kind = SnomedCode { value, meaning };
        SegmentDescription { name, rgb, kind, is_automatic: self.organ.is_some() }
    }
}

impl Session {
    /// Returns the method by which the wall of this lumen is placed.
    fn wall_method(&self, loaded: &Loaded, core: &Core) -> WallMethod {
        let is_grey = matches!(core.options.selection, IntensitySelection::Range { .. })
            || core.organ.is_some();
        let asked = match self.settings.lumen.wall {
            WallMethod::Auto => self.settings.methods().wall,
            asked => asked,
        };
        match asked {
            _ if self.settings.wall.from_mask => WallMethod::Exact,
            WallMethod::Auto if is_grey => WallMethod::Field,
            WallMethod::Auto if relaxes_by_default(loaded.volume.grid().spacing_mm) => {
                WallMethod::Relaxed
            }
            WallMethod::Auto => WallMethod::Exact,
            // Labels hold no grey values, but the image they were drawn on may.
            WallMethod::Field if !is_grey && loaded.image.is_none() => WallMethod::Exact,
            method => method,
        }
    }

    /// Whether the surface lies where grey values between two voxels cross a threshold.
    pub(super) fn crosses_grey(&self, method: WallMethod, selection: &IntensitySelection) -> bool {
        let is_range = matches!(selection, IntensitySelection::Range { .. });
        is_range && method == WallMethod::Exact && !self.settings.wall.from_mask
    }

    /// The grey values that the wall is drawn from, whole.
    fn grey_volume(&self, loaded: &Loaded) -> Result<Arc<Volume>, SessionError> {
        match &self.source {
            Source::Mask { image: Some(image), .. } => {
                Ok(canonical(read_any_volume(image, self.settings.max_memory_mb)?))
            }
            _ => self.whole(loaded),
        }
    }

    /// The wall about a core in grey values, as they are or of a colon whose fluid was taken away;
    /// and the number of bricks it was computed on.
    fn wall_about(
        &self,
        loaded: Arc<Loaded>,
        core: &Core,
        clock: &mut Clock,
    ) -> Result<((Lumen, WallField), u64), SessionError> {
        let tissue = match core.organ.as_ref().map(|o| o.organ) {
            Some(Organ::Airway) => Tissue::Airway,
            Some(Organ::Colon) => Tissue::Colon,
            Some(Organ::Vessel) => Tissue::Vessel,
            None => Tissue::Unknown,
        };
        let device = present(&self.slots.device);
        let limit = self.settings.max_memory_mb;
        let device = &mut device.lock();
        if let InputVolume::Parts(input) = &loaded.volume {
            let bricks = bricks_about(core.voxels(), input.parts.grid());
            let held = (bricks.field_len() * input.parts.sample_type().size()) as u64;
            let grey = GreyBricks::read(&input.parts, bricks)?;
            let wall = WallInput::new(GreyValues::Bricks(&grey), core.voxels(), tissue)?;
            drop(grey);
            return wall_field(device, held, wall, limit, clock);
        }
        let volume = self.grey_volume(&loaded)?;
        drop(loaded);
        let fluid = core.organ.as_ref().and_then(|o| o.fluid.as_ref());
        let cleansed = match fluid {
            Some(fluid) => {
                let (mask, down) = (&fluid.mask, fluid.down);
                Some(CleansedFluid::new(&volume, core.voxels(), &core.mask, mask, down)?)
            }
            None => None,
        };
        let wall = match &cleansed {
            Some(fluid) => WallInput::cleansed(fluid),
            None => WallInput::new(GreyValues::Whole(&volume), core.voxels(), tissue)?,
        };
        // Its values were copied.
        drop(volume);
        let held = self.end_samples();
        wall_field(device, held, wall, limit, clock)
    }

    pub(super) fn run_lumen(&self, clock: &mut Clock) -> Result<Segmented, SessionError> {
        let loaded = self.with_samples()?;
        let core = present(&self.slots.core);
        let method = self.wall_method(&loaded, &core);
        let input = InputSize::of(&loaded.volume);
        let (lumen, wall, field_bricks) = if method == WallMethod::Field {
            let ((lumen, wall), bricks) = self.wall_about(loaded, &core, clock)?;
            (lumen, Some(wall), Some(bricks))
        } else {
            let grid = *loaded.volume.grid();
            drop(loaded);
            if !self.crosses_grey(method, &core.options.selection) {
                self.end_samples();
            }
            (Lumen::new(grid, &core.mask), None, None)
        };
        self.check_memory(&input, method, &core, &lumen, field_bricks)?;
        let mut notes = core.notes.clone();
        if lumen.touches_edge {
            notes.push(TOUCHES_EDGE.into());
            tracing::warn!("{TOUCHES_EDGE}");
        }
        let (found, options, organ) =
            (core.found.clone(), core.options.clone(), core.organ.clone());
        Ok(Segmented { lumen, wall, method, found, options, organ, notes })
    }

    pub(super) fn run_core(&self, clock: &mut Clock) -> Result<Core, SessionError> {
        let loaded = self.with_samples()?;
        let grid = *loaded.volume.grid();
        let settings = &self.settings.lumen;
        let name = || match &self.source {
            Source::Image(source) | Source::Mask { mask: source, .. } => source.name(),
        };
        if let Some(options) = settings.organ {
            return self.run_organ(&*self.whole(&loaded)?, options, clock);
        }
        let selection = loaded.selection(settings.select.as_ref());
        let Some(selection) = selection else {
            let organ = organ::suggest(&*self.whole(&loaded)?);
            return Err(SessionError::LumenNotChosen { name: name(), organ });
        };
        let seed = match settings.seed {
            None => None,
            Some(Seed::Voxel(v)) => Some(canonical_seed(v, &grid)?),
            Some(Seed::Point(p)) => {
                let v = grid.nearest_voxel(p);
                Some(v.ok_or(LumenError::SeedPoint(p.to_array()))?)
            }
        };
        let options = SegmentationOptions {
            selection,
            seed,
            all_components: settings.all_components,
            fill: settings.fill,
            leak_control: settings.leak_control,
        };
        let voxels = |r: &Result<Chosen, _>| r.as_ref().map_or(0, |r| r.0.count());
        let choose = || self.choose(&loaded, &options).map_err(|error| as_stored(error, &grid));
        let (mask, found) = clock.time("segment", "voxels", choose, voxels)?;
        if mask.is_empty() {
            let (selection, range) = (options.selection.clone(), None);
            return Err(LumenError::Empty { selection, range }.into());
        }
        let notes = notes(&grid, &found);
        notes.iter().for_each(|line| tracing::warn!("{line}"));
        Ok(Core { mask, found, options, organ: None, notes })
    }

    /// Chooses the lumen in a volume in memory, or in one that is read in parts.
    fn choose(
        &self,
        loaded: &Loaded,
        options: &SegmentationOptions,
    ) -> Result<Chosen, SessionError> {
        let input = match &loaded.volume {
            InputVolume::Parts(input) if !options.leak_control => input,
            _ => return Ok(options.select(&*self.whole(loaded)?)?),
        };
        if let Some(seed) = options.seed {
            check_seed_in_parts(&input.parts, &options.selection, seed)??;
        }
        let selected = input.select(&options.selection)?;
        Ok(options.select_among(selected, input.parts.grid())?)
    }

    fn run_organ(
        &self,
        volume: &Volume,
        options: OrganOptions,
        clock: &mut Clock,
    ) -> Result<Core, SessionError> {
        let voxels = |r: &Result<FoundOrgan, _>| r.as_ref().map_or(0, |r| r.mask.count());
        let mut organ = clock.time("organ", "voxels", || options.find(volume), voxels)?;
        let mut found =
            SegmentationStats { grown_voxels: organ.mask.count(), ..Default::default() };
        if self.settings.lumen.fill {
            found.filled = fill_cavities(&mut organ.mask);
        }
        let seed = organ.segments.first().map(|s| s.seed);
        let options = SegmentationOptions {
            seed,
            all_components: organ.segments.len() > 1,
            fill: self.settings.lumen.fill,
            ..SegmentationOptions::new(organ.selection.clone())
        };
        organ.reasons.iter().for_each(|reason| tracing::info!("{reason}"));
        let notes = notes(&volume.grid, &found);
        notes.iter().for_each(|line| tracing::warn!("{line}"));
        let mask = organ.mask.clone();
        Ok(Core { mask, found, options, organ: Some(organ), notes })
    }

    fn check_memory(
        &self,
        input: &InputSize,
        method: WallMethod,
        core: &Core,
        lumen: &Lumen,
        field_bricks: Option<u64>,
    ) -> Result<(), SessionError> {
        let voxels = lumen.volume_grid().len() as u64;
        let mask = match input.parts {
            None => voxels / 8,
            Some([reading, _]) => 2 * core.mask.bytes() + box_bytes(lumen) + reading,
        };
        let bricks = lumen.bricks.len() as u64;
        let (Source::Image(source) | Source::Mask { mask: source, .. }) = &self.source;
        let size = RunSize {
            stored: input.stored,
            keeps_stored: self.keep_volume
                || self.crosses_grey(method, &core.options.selection)
                || matches!(source, VolumeSource::Memory(_)),
            mask,
            voxels,
            bricks,
            field_bricks: field_bricks.unwrap_or(0),
            wall_sides: lumen.wall_sides(),
            is_field: field_bricks.is_some(),
            is_organ: self.settings.lumen.organ.is_some(),
            pixels: self.settings.flight.size.iter().map(|s| u64::from(*s)).product(),
            is_multisampled: self.settings.flight.antialiasing != Antialiasing::Off,
            is_subdivided: self.settings.drawn_lod() == Lod::Vds,
        };
        let bytes = estimate_bytes(&size, |p| self.expects(p));
        let bytes = bytes.max(input.parts.map_or(0, |[_, selecting]| selecting));
        tracing::info!("about {} MB will be needed", bytes / 1_000_000);
        refuse_above(self.settings.max_memory_mb, bytes, "estimated for all stages")
    }
}

/// Bytes that an input takes.
struct InputSize {
    /// Samples in memory.
    stored: u64,
    /// Chunks while samples are read in parts, and the peak of the first time they were.
    parts: Option<[u64; 2]>,
}

impl InputSize {
    fn of(volume: &InputVolume) -> Self {
        let parts = match volume {
            InputVolume::Parts(input) => {
                Some([input.parts.reading_bytes(), in_parts_bytes(&input.parts)])
            }
            _ => None,
        };
        Self { stored: volume.bytes(), parts }
    }
}

/// The voxel of a canonical grid that a seed in the file's own is.
///
/// # Errors
/// [`LumenError::SeedOutside`].
fn canonical_seed(seed: UVec3, grid: &Grid) -> Result<UVec3, LumenError> {
    let dims = grid.as_stored().dims;
    if seed.cmpge(dims).any() {
        return Err(LumenError::SeedOutside { seed, dims });
    }
    Ok(grid.canonical_voxel(seed.as_ivec3()).as_uvec3())
}

/// An error whose seed is a voxel of the file.
fn as_stored(error: SessionError, grid: &Grid) -> SessionError {
    match error {
        SessionError::Lumen(LumenError::SeedValue { seed, value, selection }) => {
            let seed = grid.stored_voxel(seed.as_ivec3()).as_uvec3();
            LumenError::SeedValue { seed, value, selection }.into()
        }
        other => other,
    }
}

/// Mask of a lumen, with what choosing it found.
type Chosen = (BitVolume, SegmentationStats);

/// Note on a lumen that reaches the volume's edge.
const TOUCHES_EDGE: &str = "the lumen touches the edge of the volume; it is closed there by caps";
/// Bytes a voxel of a brick that the wall field takes while it is computed.
const WALL_BYTES: u64 = 40;

/// Bytes of what spans the box of a large volume, however thin its lumen: tables of bricks here and
/// on the device, and the slices of classes and distances that are written at a time.
fn box_bytes(lumen: &Lumen) -> u64 {
    let dims = lumen.stored_grid().dims;
    let slice = u64::from(dims.x) * u64::from(dims.y);
    3 * 4 * lumen.bricks.table().2.len() as u64 + 8 * (4 + 1) * slice
}

/// The lumen about a core as the grey values have it.
///
/// * `held`: bytes of the samples in memory.
///
/// Returns the number of bricks it was computed on too.
///
/// # Errors
/// [`SessionError::Wall`], [`SessionError::Memory`], the device's.
fn wall_field(
    device: &mut Device,
    held: u64,
    input: WallInput<'_>,
    allowed_mb: Option<u64>,
    clock: &mut Clock,
) -> Result<((Lumen, WallField), u64), SessionError> {
    let start = Instant::now();
    let voxels = input.voxels() as u64;
    let bytes = held + WALL_BYTES * voxels;
    refuse_above(allowed_mb, bytes, "volume and wall field")?;
    let (buffers, mut out) = {
        let mut plan = Plan::new();
        let buffers = input.profile(&mut plan);
        (buffers, device.run(&plan)?)
    };
    clock.record_plan("wall profile", device.name(), start, (voxels, "voxels"), &out);
    let start = Instant::now();
    let profile = input.select(&buffers, &mut out)?;
    let (moved, mut out) = {
        let mut plan = Plan::new();
        let moved = profile.correct(&mut plan);
        (moved, device.run(&plan)?)
    };
    let moved = out.take(moved);
    let made = profile.finish(&moved)?;
    clock.record_plan("wall field", device.name(), start, (voxels, "voxels"), &out);
    let stats = &made.1.stats;
    tracing::info!(
        "wall: from {:.0} to {:.0} (noise {:.0}), blur {:.2} mm, {:.1} % on sheets, {:.1} % not seen",
        stats.contrast.lumen,
        stats.contrast.wall,
        stats.contrast.noise,
        stats.sigma_mm,
        100.0 * stats.sheet_share,
        100.0 * stats.closed_by_limit_share
    );
    Ok((made, voxels / BRICK as u64))
}

fn notes(grid: &Grid, found: &SegmentationStats) -> Vec<String> {
    let mut out = Vec::new();
    if let Some(leak) = found.leak {
        let leaks = leak.leak_ml.map_or("no leak found".to_owned(), |ml| {
            format!("the next step would fill {ml:.0} ml")
        });
        let (t, v) = (leak.threshold, leak.volume_ml);
        out.push(format!("leak control: threshold {t} holds {v:.1} ml; {leaks}"));
    }
    if let Some(first) = found.joined.first() {
        let voxel = grid.stored_voxel(first.as_ivec3());
        out.push(format!(
            "parts of the label that touch by edges or corners of voxels were joined: {} voxels \
             added, the first at voxel {voxel}",
            found.joined.len()
        ));
    }
    if !found.others.is_empty() || !found.outside.is_empty() {
        out.push(taken_note(grid, found));
    }
    out
}

/// Returns the note on the components taken and left out.
fn taken_note(grid: &Grid, found: &SegmentationStats) -> String {
    let list = |all: &[Component]| {
        let named = |c: &Component| {
            let first = grid.stored_voxel(c.first.as_ivec3());
            format!("{:.3} ml from voxel {first}", c.volume_ml(grid))
        };
        let listed: Vec<String> = all.iter().take(3).map(named).collect();
        listed.join(", ") + if all.len() > 3 { ", …" } else { "" }
    };
    let mut note = found.taken.map_or_else(
        || "took every component in the body".to_owned(),
        |taken| format!("took the component of {}", list(&[taken])),
    );
    let (others, outside) = (&found.others, &found.outside);
    if !others.is_empty() {
        note += &format!(
            ", the largest of {}; left out {} voxels ({})",
            others.len() + 1,
            found.other_voxels,
            list(others)
        );
    }
    if !outside.is_empty() {
        note += &format!("; left out the air outside the body ({})", list(outside));
    }
    note
}
