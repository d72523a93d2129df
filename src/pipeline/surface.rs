//! The surface with its normals.

use std::time::Instant;

use glam::{IVec3, Vec3};

use super::{Clock, PipelineError};
use crate::compute::Plan;
use crate::device::Device;
use crate::geometry::Mesh;
use crate::lumen::{Lumen, Window};
use crate::surface::{self as stage, Adjacency, Fairing, Grey, Midpoint, Surface, Topology};
use crate::volume::Volume;

/// How to make the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceOptions {
    /// Sub-voxel crossings from grey values, where the window is a threshold.
    pub from_grey: bool,
    /// Fairing of the normals.
    pub fairing: Fairing,
    /// Keep only the component a walk from this voxel along +x hits first.
    pub track_from: Option<IVec3>,
}

/// A surface ready to draw.
pub struct Wall {
    /// Mesh with smoothed normals.
    pub mesh: Mesh,
    /// Counts.
    pub topology: Topology,
}

/// Extracts and fairs the surface of a lumen.
///
/// # Errors
/// The device's.
pub fn wall(
    device: &mut Device,
    volume: &Volume,
    window: &Window,
    lumen: &Lumen,
    options: SurfaceOptions,
    clock: &mut Clock,
) -> Result<Wall, PipelineError> {
    let seed = options.track_from;
    let surface = clock.time(
        "surface",
        "faces",
        || match Grey::new(volume, window).filter(|_| options.from_grey) {
            Some(grey) => Surface::new(lumen, &grey, seed),
            None => Surface::new(lumen, &Midpoint, seed),
        },
        |s| s.mesh.faces.len() as u64,
    );
    let Surface { mut mesh, adjacency, topology } = surface;
    mesh.normals = faired(device, &mesh, &adjacency, options.fairing, clock)?;
    Ok(Wall { mesh, topology })
}

/// Smoothed normals of a mesh, from its face normals.
///
/// # Errors
/// The device's.
pub fn faired(
    device: &mut Device,
    mesh: &Mesh,
    adjacency: &Adjacency,
    fairing: Fairing,
    clock: &mut Clock,
) -> Result<Vec<Vec3>, PipelineError> {
    let start = Instant::now();
    let normals = stage::face_normals(mesh);
    let weights = stage::weights(mesh, adjacency, fairing.weights);
    let mut plan = Plan::new();
    let n = stage::fair(&mut plan, adjacency, &weights, &normals, fairing);
    plan.download(n);
    let out = device.run(&plan)?;
    clock.plan("fair", device.name(), start, (mesh.positions.len() as u64, "vertices"), &out);
    Ok(out.get(n).chunks_exact(3).map(Vec3::from_slice).collect())
}
