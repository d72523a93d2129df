//! Settings of a [`Session`](super::Session): its volumes, the choice of the lumen, and the methods
//! of each stage. Plain data; nothing here reads a file.

use std::path::PathBuf;
use std::sync::Arc;

use glam::{DVec3, UVec3};

use super::mode::{Methods, Mode};
use crate::centerline::Loops;
use crate::device::DeviceChoice;
use crate::flight::{CameraPath, Frames};
use crate::formats::{Facing, ReadOptions, shown};
use crate::lod::vds::Scheme;
use crate::lumen::IntensitySelection;
use crate::organ::OrganOptions;
use crate::render::View;
use crate::surface::Smoothing;
use crate::volume::Volume;

/// Source of a volume.
#[derive(Clone, Debug)]
pub enum VolumeSource {
    /// A file or a DICOM folder, read when first needed and again if it was dropped since.
    File {
        /// File or folder.
        path: PathBuf,
        /// Options for reading it.
        options: ReadOptions,
    },
    /// A volume in memory.
    Memory(Arc<Volume>),
}

impl VolumeSource {
    /// A file or DICOM folder of one series.
    pub fn file(path: impl Into<PathBuf>) -> Self {
        Self::File { path: path.into(), options: ReadOptions::default() }
    }

    /// Returns the name in messages: the file's name, or `volume in memory`.
    pub fn name(&self) -> String {
        match self {
            Self::File { path, .. } => shown(path),
            Self::Memory(_) => "volume in memory".to_owned(),
        }
    }
}

/// The volumes of a session.
#[derive(Clone, Debug)]
pub enum Source {
    /// Grey values from which the lumen is chosen, or a label map.
    Image(VolumeSource),
    /// A label map, and the image it was drawn on. The image's voxels are not read for the lumen;
    /// its geometry is the grid of all products.
    Mask {
        /// The label map; resampled to the image's grid (nearest label) where it has another.
        mask: VolumeSource,
        /// Image that the label map was drawn on.
        image: Option<VolumeSource>,
    },
}

/// Seed from which a component grows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Seed {
    /// A voxel, x fastest.
    Voxel(UVec3),
    /// A point, LPS mm.
    Point(DVec3),
}

/// Method by which the wall of the lumen is placed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum WallMethod {
    /// The field for grey values, relaxed for a label map whose largest spacing is at most twice the
    /// smallest; else, and in paper mode, exact.
    #[default]
    Auto,
    /// Wall field, from the profile of the grey values.
    Field,
    /// Smooth within half a voxel of a label map's wall: every voxel centre stays on its side.
    Relaxed,
    /// Crossing of the threshold, held in the mask, or half way between voxels of a label map.
    Exact,
}

/// Choice of the voxels of the lumen.
#[derive(Clone, Debug, PartialEq)]
pub struct LumenSettings {
    /// Organ to find; nothing else of these settings but `fill` has a meaning then.
    pub organ: Option<OrganOptions>,
    /// Values or labels inside; `None` takes the image for a label map if it is one.
    pub select: Option<IntensitySelection>,
    /// Seed of the 6-connected component to keep; the largest is kept without one.
    pub seed: Option<Seed>,
    /// Whether every component is kept.
    pub all_components: bool,
    /// Whether closed cavities are filled.
    pub fill: bool,
    /// Whether the threshold is drawn in to just before the first leak (needs a seed).
    pub leak_control: bool,
    /// Method by which the wall is placed.
    pub wall: WallMethod,
}

impl Default for LumenSettings {
    fn default() -> Self {
        Self {
            organ: None,
            select: None,
            seed: None,
            all_components: false,
            fill: true,
            leak_control: false,
            wall: WallMethod::Auto,
        }
    }
}

/// An end of the path that someone asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EndPoint {
    /// Place in the lumen, LPS mm.
    Point(DVec3),
    /// Root of the tree.
    Root,
    /// Tip of a branch of the tree, by its number.
    Tip(usize),
}

impl From<DVec3> for EndPoint {
    fn from(at: DVec3) -> Self {
        Self::Point(at)
    }
}

/// The centerline.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CenterlineSettings {
    /// Start; found where `None`.
    pub from: Option<EndPoint>,
    /// End; found where `None`.
    pub to: Option<EndPoint>,
    /// Whether all branches are wanted instead of one path.
    pub tree: bool,
    /// Loops of a tree.
    pub loops: Loops,
}

/// The wall.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WallSettings {
    /// Leave vertices half way between voxels even where grey values say more.
    pub from_mask: bool,
    /// Normal smoothing; by mode where `None`.
    pub smoothing: Option<Smoothing>,
    /// Leave caps at the edge of the volume out of what is drawn and written.
    pub open_ends: bool,
    /// Faces of the simplified surface; a twentieth of the wall's where `None`.
    pub base_faces: Option<usize>,
    /// Side to which written meshes look.
    pub facing: Facing,
}

/// Level-of-detail method by which a wall is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Lod {
    /// As `culled`, and faces near the eye are split and put on the smooth wall, so that no voxel
    /// shows.
    #[default]
    Auto,
    /// The paper's: a base mesh subdivided where the camera looks.
    Vds,
    /// The whole mesh, less what a camera cannot see of it; the same picture.
    Culled,
    /// The whole mesh.
    Off,
}

/// Levels of detail.
#[derive(Clone, Debug, PartialEq)]
pub struct LevelSettings {
    /// Level-of-detail method.
    pub lod: Lod,
    /// Subdivision scheme of [`Lod::Vds`].
    pub scheme: Scheme,
    /// Largest distance of what is drawn from the full mesh, pixels.
    pub pixel_error: f32,
}

impl Default for LevelSettings {
    fn default() -> Self {
        Self { lod: Lod::default(), scheme: Scheme::default(), pixel_error: 1.0 }
    }
}

/// Branches of a centerline that are flown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FlightRoute {
    /// The path, or the trunk of a tree; all pieces of a lumen that has several.
    #[default]
    Trunk,
    /// Path from the root to the tip of a branch, by the branch's number.
    Leaf(usize),
    /// Every branch, from where it leaves the one before it.
    All,
}

/// Ways to keep edges in a frame from looking like stairs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Antialiasing {
    /// Four samples on a GPU; `edges` where software draws.
    #[default]
    #[serde(rename = "auto")]
    Auto,
    /// One sample a pixel.
    #[serde(rename = "1")]
    #[cfg_attr(feature = "cli", value(name = "1"))]
    Off,
    /// Four samples a pixel.
    #[serde(rename = "4")]
    #[cfg_attr(feature = "cli", value(name = "4"))]
    Samples,
    /// One sample a pixel, and the stairs along edges become slanted lines.
    #[serde(rename = "edges")]
    Edges,
}

/// The flight and its frames.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightSettings {
    /// Number of frames, directly or by speed.
    pub frames: Frames,
    /// Columns and rows of a frame.
    pub size: [u32; 2],
    /// View that a frame shows.
    pub view: View,
    /// Depth of the tissue behind the wall that inside views show, mm. Where `None`, the translucent
    /// view alone shows tissue, as deep as the organ asks.
    pub behind_mm: Option<f32>,
    /// Share by which light departs farther from smooth light in views from inside; 0 leaves it.
    pub local_contrast: f32,
    /// Vertical field of view, radians.
    pub fov_y_rad: f32,
    /// How edges are kept from looking like stairs.
    pub antialiasing: Antialiasing,
    /// Whether the flight goes from the end to the start.
    pub reverse: bool,
    /// Branches that are flown.
    pub route: FlightRoute,
    /// Camera path to fly instead of one along the centerline.
    pub script: Option<CameraPath>,
    /// Poses the camera path is resampled to; as many as it has where `None`.
    pub script_frames: Option<usize>,
}

impl Default for FlightSettings {
    fn default() -> Self {
        Self {
            frames: Frames::Count(120),
            size: [1280, 720],
            view: View::Inside,
            behind_mm: None,
            local_contrast: 0.0,
            fov_y_rad: std::f32::consts::FRAC_PI_2,
            antialiasing: Antialiasing::Auto,
            reverse: false,
            route: FlightRoute::Trunk,
            script: None,
            script_frames: None,
        }
    }
}

/// Way a volume is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reading {
    /// In parts where it is larger than [`IN_PARTS_ABOVE`](super::IN_PARTS_ABOVE) or than the limit
    /// of memory allows, and the choice of the lumen and the file let it be.
    #[default]
    Auto,
    /// The whole volume at once.
    Whole,
    /// In parts wherever the choice of the lumen and the file let it be.
    Parts,
}

/// Everything a session is asked to do.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    /// Default or the paper's methods.
    pub mode: Mode,
    /// Device on which plans run.
    pub device: DeviceChoice,
    /// Threads of the session's pool; all cores where `None`.
    pub threads: Option<usize>,
    /// Limit of memory, MB; work that would take more is refused.
    pub max_memory_mb: Option<u64>,
    /// Way the volume is read; the results are the same.
    pub reading: Reading,
    /// Choice of the lumen.
    pub lumen: LumenSettings,
    /// The centerline.
    pub centerline: CenterlineSettings,
    /// The wall.
    pub wall: WallSettings,
    /// Levels of detail.
    pub levels: LevelSettings,
    /// The flight and its frames.
    pub flight: FlightSettings,
}

impl Settings {
    /// Methods of the mode, for what the settings leave open.
    pub(super) fn methods(&self) -> &'static Methods {
        self.mode.methods()
    }

    /// Normal smoothing.
    pub(super) fn smoothing(&self) -> Smoothing {
        self.wall.smoothing.unwrap_or(self.methods().smoothing)
    }

    /// Values of the settings that decide which products there are.
    pub(super) fn deciding(&self) -> String {
        let (mode, lod, view) = (self.mode, self.levels.lod, self.flight.view);
        format!("mode {mode:?}, levels.lod {lod:?} and flight.view {view:?}")
    }

    /// Whether frames show the tissue behind the wall.
    pub(super) fn shows_tissue(&self) -> bool {
        self.flight.view == View::Translucent || self.flight.behind_mm.is_some()
    }

    /// The levels that are drawn: an overview alone shows the whole mesh.
    pub(super) fn drawn_lod(&self) -> Lod {
        match self.levels.lod {
            _ if self.flight.view == View::Overview => Lod::Off,
            // The paper draws the mesh of its voxels.
            Lod::Auto if self.mode == Mode::Paper => Lod::Culled,
            lod => lod,
        }
    }
}
