//! The surface with its normals.

use std::time::Instant;

use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;

use super::{Clock, PipelineError};
use crate::centerline::Sampler;
use crate::compute::Plan;
use crate::device::Device;
use crate::geometry::Mesh;
use crate::lumen::{Lumen, Window};
use crate::surface::{
    self as stage, Adjacency, Grey, Midpoint, MultiscaleNormals, Smoothing, Surface, Topology,
    VoxelFrame,
};
use crate::volume::Volume;

/// How to make the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceOptions {
    /// Sub-voxel crossings from grey values, where the window is a threshold.
    pub from_grey: bool,
    /// Smoothing of the normals.
    pub smoothing: Smoothing,
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
    let mesh = clock.time(
        "surface",
        "faces",
        || match Grey::new(volume, window).filter(|_| options.from_grey) {
            Some(grey) => stage::extract(lumen, &grey),
            None => stage::extract(lumen, &Midpoint),
        },
        |mesh| mesh.faces.len() as u64,
    );
    let surface = clock.time(
        "topology",
        "faces",
        || Surface::of(mesh, lumen, options.track_from),
        |s| s.mesh.faces.len() as u64,
    );
    let Surface { mut mesh, adjacency, topology } = surface;
    let grid = &lumen.grid;
    let lattice = VoxelFrame { direction: grid.direction, spacing_mm: grid.spacing_mm };
    mesh.normals = faired(device, (&mesh, &adjacency), lattice, options.smoothing, clock)?;
    Ok(Wall { mesh, topology })
}

/// Smoothed normals of a mesh and its adjacency, from its face normals.
///
/// * `lattice`: the grid the mesh was taken from.
///
/// # Errors
/// The device's.
pub fn faired(
    device: &mut Device,
    (mesh, adjacency): (&Mesh, &Adjacency),
    lattice: VoxelFrame,
    smoothing: Smoothing,
    clock: &mut Clock,
) -> Result<Vec<Vec3>, PipelineError> {
    let start = Instant::now();
    let mut plan = Plan::new();
    let (scales, normals, weights);
    let n = match smoothing {
        Smoothing::Multiscale => {
            scales = MultiscaleNormals::new(mesh, adjacency, lattice);
            stage::multiscale_normals(&mut plan, adjacency, &scales)
        }
        Smoothing::Steps(fairing) => {
            normals = stage::face_normals(mesh);
            weights = stage::weights(mesh, adjacency, fairing.weights);
            stage::fair(&mut plan, adjacency, &weights, &normals, fairing)
        }
    };
    plan.download(n);
    let out = device.run(&plan)?;
    clock.plan("fair", device.name(), start, (mesh.positions.len() as u64, "vertices"), &out);
    Ok(out.get(n).chunks_exact(3).map(Vec3::from_slice).collect())
}

/// Normals of a mesh from the gradient of a volume after a Gaussian: what normal smoothing is
/// compared with, and the better choice on isotropic binary data (ALGORITHMS, stage c).
///
/// * `sigma_mm`: `None` takes 1.5 of the largest voxel spacing.
///
/// The gradient's sign is taken so that the mean normal agrees with the faces.
///
/// # Errors
/// The device's.
pub fn gradient_normals(
    device: &mut Device,
    mesh: &Mesh,
    volume: &Volume,
    sigma_mm: Option<f64>,
    clock: &mut Clock,
) -> Result<Vec<Vec3>, PipelineError> {
    let h = volume.grid.spacing_mm;
    let sigma = sigma_mm.unwrap_or(1.5 * h.max_element());
    let start = Instant::now();
    let (bricks, values) = super::volume_as_bricks(volume);
    let mut plan = Plan::new();
    let buffers = crate::field::LumenBuffers::new(&mut plan, &bricks);
    let f = plan.upload("values", &values);
    let f = crate::field::smooth(&mut plan, &buffers, f, sigma, Some(volume.grid.dims));
    plan.download(f);
    let out = device.run(&plan)?;
    let f = Sampler { lumen: &bricks, field: out.get(f) };
    let to_voxel = volume.grid.voxel_from_world();
    let faces = stage::face_normals(mesh);
    let top = volume.grid.dims.as_dvec3() - 1.0;
    let mut normals: Vec<Vec3> = mesh
        .positions
        .par_iter()
        .zip(faces.par_chunks_exact(3))
        .map(|(p, old)| {
            let v = to_voxel.transform_point3(p.as_dvec3());
            let at = |d: DVec3| f.at((v + d).clamp(DVec3::ZERO, top) * h);
            let g = DVec3::new(
                at(DVec3::X) - at(DVec3::NEG_X),
                at(DVec3::Y) - at(DVec3::NEG_Y),
                at(DVec3::Z) - at(DVec3::NEG_Z),
            ) / (2.0 * h);
            let g = volume.grid.direction * g;
            g.as_vec3().try_normalize().unwrap_or(Vec3::from_slice(old))
        })
        .collect();
    let agree: f64 = normals
        .iter()
        .zip(faces.chunks_exact(3))
        .map(|(n, f)| f64::from(n.dot(Vec3::from_slice(f))))
        .sum();
    if agree < 0.0 {
        normals.iter_mut().for_each(|n| *n = -*n);
    }
    let items = (mesh.positions.len() as u64, "vertices");
    clock.plan("gradient normals", device.name(), start, items, &out);
    Ok(normals)
}
