//! What a film shows: the wall, whole or at many levels, on a renderer.

use std::borrow::Cow;
use std::sync::Arc;
use std::time::Instant;

use super::CliError;
use super::detail::Keep;
use super::frames::Setup;
use super::surface::without_caps;
use crate::device::{Device, DeviceError};
use crate::geometry::Mesh;
use crate::lod::clusters::Clusters;
use crate::lod::{Tolerance, Worker};
use crate::pipeline::detail::{LodReport, UPLOAD_BYTES};
use crate::pipeline::{Clock, Detail, Wall};
use crate::render::{self, IN_FLIGHT, Renderer, Scene, View};
use crate::surface::{Shading, shading};
use crate::vk::{Choice, Gpu};

/// The mesh that is drawn.
pub struct Shown<'a> {
    pub mesh: Cow<'a, Mesh>,
    pub closed: bool,
}

impl<'a> Shown<'a> {
    /// `open_ends`: without caps.
    pub fn of(wall: &'a Wall, open_ends: bool) -> Self {
        let mesh = &wall.mesh;
        let open = open_ends && mesh.caps.contains(&true);
        let closed = wall.topology.watertight && !open;
        let mesh = if open { Cow::Owned(without_caps(mesh)) } else { Cow::Borrowed(mesh) };
        Self { mesh, closed }
    }
}

/// The renderer on the device that computes or, where that is the CPU, on what Vulkan there is,
/// kept in `own`.
pub fn open_renderer<'a>(
    device: &'a mut Device,
    own: &'a mut Option<Gpu>,
    setup: &Setup,
    clock: &mut Clock,
) -> Result<Opened<'a>, CliError> {
    let start = Instant::now();
    let gpu = match device {
        Device::Gpu(gpu) => &mut **gpu,
        Device::Cpu => own.insert(Gpu::open(Choice::Any).map_err(DeviceError::from)?),
    };
    let name = gpu.info().name.clone();
    let [width, height] = setup.size;
    let renderer = Renderer::new(gpu, width, height, setup.samples)?;
    let pixels = u64::from(width) * u64::from(height);
    clock.record("renderer", &name, start, (pixels, "pixels"), Vec::new());
    Ok(Opened { gpu, renderer, name })
}

/// A renderer and the name of its device.
pub struct Opened<'a> {
    pub gpu: &'a mut Gpu,
    pub renderer: Renderer,
    pub name: String,
}

/// What is drawn, where, and by what it is refined.
pub struct Staged<'a> {
    pub on: Opened<'a>,
    pub scene: Scene,
    pub worker: Option<Worker>,
    pub lod: LodReport,
    /// What is to be found next time.
    pub keep: Option<Keep>,
}

/// The wall at many levels.
pub struct Levels {
    detail: Detail,
    /// Of the lumen, mm.
    mean_radius_mm: f32,
    keep: Option<Keep>,
}

impl Levels {
    /// The clusters, if it is these.
    pub fn clusters(&self) -> Option<Arc<Clusters>> {
        self.detail.clusters.clone()
    }
}

/// `None` where the whole mesh is to be drawn.
pub fn levels(
    Shown { mesh, closed }: &Shown<'_>,
    setup: &Setup,
    clock: &mut Clock,
) -> Result<Option<Levels>, CliError> {
    if setup.view == View::Overview {
        return Ok(None);
    }
    let count = |s: &Shading| s.vertices.len() as u64;
    let shading = clock.time("shading", "vertices", || shading(mesh), count);
    let built = setup.detail.build(mesh, &shading.vertices, *closed, clock)?;
    let mean_radius_mm = shading.mean_radius_mm;
    Ok(built.map(|(detail, keep)| Levels { detail, mean_radius_mm, keep }))
}

/// Puts the wall on the device: whole, or as pages that a worker fills.
pub fn set<'a>(
    mut on: Opened<'a>,
    Shown { mesh, closed }: &Shown<'_>,
    setup: &Setup,
    levels: Option<Levels>,
) -> Result<Staged<'a>, CliError> {
    let (gpu, renderer) = (&mut *on.gpu, &mut on.renderer);
    let Some(Levels { detail, mean_radius_mm, keep }) = levels else {
        let faces = mesh.faces.len() as u64;
        let lod =
            LodReport { mode: "off", base_faces: faces, finest_faces: faces, ..Default::default() };
        let scene = Scene::of(renderer.upload_mesh(gpu, mesh, false)?);
        return Ok(Staged { on, scene, worker: None, lod, keep: None });
    };
    let overview = match setup.view {
        View::Inside => None,
        _ => Some(renderer.upload_mesh(gpu, mesh, false)?),
    };
    let pages = renderer.open_pages(gpu, detail.pages, mean_radius_mm)?;
    if let Some(outside) = detail.outside {
        renderer.hide(pages, outside);
    }
    let tolerance = Tolerance { pixels: setup.detail.pixel_error };
    let worker =
        Worker::spawn(detail.refine, tolerance, detail.pages, UPLOAD_BYTES, IN_FLIGHT as u32);
    let mut scene = Scene::paged(pages, overview);
    // Through an open end the back of a wall can be seen.
    scene.wall = render::Wall::Pages { pages, backs: !closed };
    let worker = Some(worker.map_err(|e| CliError::System(e.to_string()))?);
    Ok(Staged { on, scene, worker, lod: detail.report, keep })
}
