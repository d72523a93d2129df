//! Pictures without a window: the wall from inside, the whole organ from outside, both halves
//! side by side, or everything about the eye. Drawing is described as passes and handed to [`crate::vk`]; no Vulkan here.

mod behind;
mod camera;
mod contrast;
mod edges;
mod error;
mod inside;
mod lines;
mod look;
mod mesh;
mod overlay;
mod overview;
mod picture;
mod pipelines;
mod placed_mesh;
mod refined_faces;
mod renderer;
mod scene;
mod sequence;
mod targets;
mod unfold;

pub use camera::{Framing, clip_from_world, framing};
pub use contrast::MAX_LOCAL_CONTRAST;
pub use error::RenderError;
pub use look::{Look, MISSED};
pub use mesh::PreparedMesh;
pub use overlay::{FlatMesh, FlatVertex, Overlay};
pub use picture::Spares;
pub use renderer::{IN_FLIGHT, Renderer, Ticket};
pub use scene::{FrameStats, MeshHandle, PathHandle, Scene, Shot, TissueHandle, View};
pub use sequence::FrameSequence;
pub use unfold::cube_areas;

/// Description of the shaders in `shaders/draw`: SPIR-V, entry points and immediate blocks, written
/// by the build script.
#[allow(missing_docs, dead_code, clippy::all)]
mod host {
    include!(concat!(env!("OUT_DIR"), "/draw.rs"));
}
