//! The scene, and the shots that frames show of it.

use super::{Framing, Look};
use crate::geometry::{Camera, Lens, Pose};
use crate::vk::Area;

/// A mesh, or a wall of patches, on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshHandle(pub(super) usize);

/// A path on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathHandle(pub(super) usize);

/// The tissue behind a wall, on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TissueHandle(pub(super) usize);

/// Statistics of drawing a frame's inside view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameStats {
    /// Number of wall triangles that were submitted.
    pub triangles: u64,
    /// Number of draws they were submitted in.
    pub draws: u32,
    /// Number of faces that are not yet as fine as the camera asks.
    pub waiting: u32,
}

/// Views of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum View {
    /// The wall as the camera sees it.
    #[default]
    Inside,
    /// The wall as glass, with the tissue behind it.
    Translucent,
    /// The whole organ from in front of the patient, as glass, with path and camera.
    Overview,
    /// Inside view on the left, overview on the right.
    Split,
    /// Everything about the eye: the six faces of a cube, unfolded to a cross.
    Cube,
    /// Everything about the eye: an equirectangular map.
    Panorama,
}

impl View {
    /// Whether the view shows everything about the eye, whatever the lens's field of view.
    pub fn is_all_round(self) -> bool {
        matches!(self, Self::Cube | Self::Panorama)
    }
}

/// Wall, path and light that frames show.
#[derive(Clone, Copy, Debug)]
pub struct Scene {
    /// The wall of the inside view.
    pub wall: MeshHandle,
    /// Tissue behind the wall, where the inside views show it.
    pub behind: Option<TissueHandle>,
    /// Mesh of the overview, which shows path and camera alone without one.
    pub overview: Option<MeshHandle>,
    /// The path, drawn in the overview.
    pub path: Option<PathHandle>,
    /// Whether the overview shows the camera.
    pub camera: bool,
    /// Side from which the overview shows the organ, and how near.
    pub framing: Framing,
    /// Light and background.
    pub look: Look,
}

impl Scene {
    /// Creates a scene of one mesh.
    pub fn of(mesh: MeshHandle) -> Self {
        Self::with(mesh, Some(mesh))
    }

    /// Creates a scene of a wall, and of a mesh of it for the overview.
    pub fn with(wall: MeshHandle, overview: Option<MeshHandle>) -> Self {
        let (framing, look) = (Framing::default(), Look::default());
        Self { wall, behind: None, overview, path: None, camera: true, framing, look }
    }
}

/// Description of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    /// View that is drawn.
    pub view: View,
    /// Position and orientation of the eye.
    pub pose: Pose,
    /// The lens; its aspect is replaced by that of the part of the frame it fills.
    pub lens: Lens,
    /// Share of the path behind the eye, 0 to 1; the rest is drawn dim.
    pub progress: f32,
    /// Room about the eye, mm, by which light is scaled; the organ's mean radius where `None`.
    pub room_mm: Option<f32>,
}

/// Inputs of the glass image, which is drawn anew when they change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct GlassKey {
    pub mesh: Option<MeshHandle>,
    pub area: Area,
    pub framing: Framing,
    pub opacity: f32,
}

/// Camera and area of one inside view.
pub(super) struct UnfoldedFace {
    pub camera: Camera,
    pub area: Area,
}
