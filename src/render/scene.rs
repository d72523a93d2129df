//! The scene, and the shots that frames show of it.

use super::{Framing, Look};
use crate::geometry::{Camera, Lens, Pose};
use crate::vk::Area;

/// A wall in pages on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PagesHandle(pub(super) usize);

/// A mesh on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshHandle(pub(super) usize);

/// A path on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathHandle(pub(super) usize);

/// Statistics of drawing a frame's inside view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameStats {
    /// Number of wall triangles that were submitted.
    pub triangles: u64,
    /// Number of draws they were submitted in: pages, or one for a mesh.
    pub draws: u32,
    /// Number of bytes written to pages.
    pub uploaded_bytes: u64,
    /// Number of octree leaves whose state changed since the frame before.
    pub leaves_changed: u64,
    /// Whether the cut did not fit its pages and is coarser than asked for.
    pub degraded: bool,
}

impl FrameStats {
    /// Adds the statistics of another part of the same frame.
    pub(super) fn plus(self, o: Self) -> Self {
        Self {
            triangles: self.triangles + o.triangles,
            draws: self.draws + o.draws,
            uploaded_bytes: self.uploaded_bytes + o.uploaded_bytes,
            leaves_changed: self.leaves_changed + o.leaves_changed,
            degraded: self.degraded || o.degraded,
        }
    }
}

/// Views of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum View {
    /// The wall as the camera sees it.
    #[default]
    Inside,
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

/// Geometry that the wall is drawn from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneWall {
    /// Mesh, drawn as a whole.
    Mesh(MeshHandle),
    /// Pages of a cut, drawn as far as the camera can see them.
    Pages {
        /// Handle of the pages.
        pages: PagesHandle,
        /// Whether back faces are drawn too. From inside a closed wall they are always hidden;
        /// through open ends, or from outside, they are not.
        backs: bool,
    },
}

/// Wall, path and light that frames show.
#[derive(Clone, Copy, Debug)]
pub struct Scene {
    /// The wall.
    pub wall: SceneWall,
    /// Wall of the overview; by default that of the inside view, if it is a mesh. Without any, the
    /// overview shows path and camera alone.
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
        Self::with(SceneWall::Mesh(mesh), None)
    }

    /// Creates a scene of one closed wall in pages, and a mesh of it for the overview.
    pub fn paged(pages: PagesHandle, overview: Option<MeshHandle>) -> Self {
        let wall = SceneWall::Pages { pages, backs: false };
        Self::with(wall, overview)
    }

    fn with(wall: SceneWall, overview: Option<MeshHandle>) -> Self {
        let (framing, look) = (Framing::default(), Look::default());
        Self { wall, overview, path: None, camera: true, framing, look }
    }

    /// Returns the mesh the overview shows.
    pub(super) fn overview_mesh(&self) -> Option<MeshHandle> {
        self.overview.or(match self.wall {
            SceneWall::Mesh(mesh) => Some(mesh),
            SceneWall::Pages { .. } => None,
        })
    }

    pub(super) fn pages(&self) -> Option<PagesHandle> {
        match self.wall {
            SceneWall::Mesh(_) => None,
            SceneWall::Pages { pages, .. } => Some(pages),
        }
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
