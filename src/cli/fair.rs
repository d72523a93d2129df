//! `intima fair`.

use std::path::PathBuf;

use glam::Vec3;

use super::CliError;
use super::global::{Global, MESHES};
use super::repeat::timed;
use super::surface_args::FairArgs;
use crate::device::Device;
use crate::formats::{Space, read_mesh, shown, write_mesh};
use crate::session::{
    Clock, MeshWork, VolumeSource, gradient_bytes, gradient_normals, mesh_bytes,
    read_orthogonal_volume, resident_memory_mb, smoothed_normals,
};
use crate::surface::{Adjacency, Smoothing, VoxelFrame};

/// `intima fair MESH -o MESH`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Mesh: .ply, .stl, .obj or .vtp
    mesh: PathBuf,
    /// Mesh to write: .ply, .stl, .obj, .vtp or .glb
    #[arg(short, long, value_name = "MESH")]
    output: PathBuf,
    /// Take normals from the gradient of this mask after a Gaussian, instead of smoothing
    #[arg(long, value_name = "MASK", conflicts_with = "volume")]
    mask: Option<PathBuf>,
    /// Take normals from the gradient of these grey values after a Gaussian
    #[arg(long, value_name = "VOLUME")]
    volume: Option<PathBuf>,
    /// Gaussian of --mask and --volume, mm (default: 1.5 of the largest voxel spacing)
    #[arg(long, value_name = "MM")]
    sigma: Option<f64>,
    /// Coordinates of a mesh that does not say: lps or ras
    #[arg(long)]
    space: Option<Space>,
    #[command(flatten)]
    fair: FairArgs,
}

impl Args {
    /// Reads, smooths and writes.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, MESHES)?;
        let (mut mesh, warnings) = read_mesh(&self.mesh, self.space)?;
        warnings.iter().for_each(|w| global.warn(w));
        if mesh.faces.is_empty() {
            return Err(CliError::Input(format!("{}: the mesh has no faces", shown(&self.mesh))));
        }
        mesh.caps.clear();
        let smoothing = self.fair.smoothing()?.unwrap_or(Smoothing::Multiscale);
        let field = self.mask.as_ref().or(self.volume.as_ref());
        let field = field
            .map(|p| read_orthogonal_volume(&VolumeSource::file(p), global.max_memory))
            .transpose()?;
        let before_mb = resident_memory_mb();
        let mut device = global.open()?;
        // A driver of software Vulkan stays in memory where it was looked at and not taken.
        let looked_at_mb = (resident_memory_mb() - before_mb).max(0.0);
        let (faces, on_gpu) = (mesh.faces.len(), matches!(device, Device::Gpu(_)));
        let bytes = match (&field, smoothing) {
            (Some(volume), _) => gradient_bytes(volume, self.mask.is_some(), faces, on_gpu),
            (None, Smoothing::Multiscale) => mesh_bytes(MeshWork::Multiscale, faces, on_gpu),
            (None, Smoothing::Steps(_)) => mesh_bytes(MeshWork::Steps, faces, on_gpu),
        };
        let driver = if on_gpu { 0 } else { (1e6 * looked_at_mb) as u64 };
        global.check_memory(bytes + driver, "estimated for the normals")?;
        let (normals, timing) = timed(
            global,
            &mut device,
            |d| Ok(d.name().to_owned()),
            |_| (),
            |device| {
                let mut clock = Clock::default();
                let normals = match &field {
                    Some(v) => gradient_normals(device, &mesh, v, self.sigma, &mut clock)?,
                    None => {
                        let vertices = mesh.positions.len() as u64;
                        let work = || Adjacency::of(&mesh);
                        let (adjacency, _) =
                            clock.time("adjacency", "vertices", work, |_| vertices);
                        let frame = VoxelFrame::of(&mesh);
                        smoothed_normals(device, (&mesh, &adjacency), frame, smoothing, &mut clock)?
                    }
                };
                Ok((normals, clock))
            },
        )?;
        let old = std::mem::take(&mut mesh.normals);
        let turned = mean_turn(&old, &normals);
        mesh.normals = normals;
        write_mesh(&self.output, &mesh)?;
        global.say(format_args!(
            "wrote {}: {} vertices, vertices unmoved",
            shown(&self.output),
            mesh.positions.len()
        ))?;
        global
            .answer(&timing.with("vertices", mesh.positions.len()).with("turned_mean_deg", turned))
    }
}

/// Mean angle between two sets of normals, degrees; `None` where the first is absent.
fn mean_turn(a: &[Vec3], b: &[Vec3]) -> Option<f64> {
    (!a.is_empty() && a.len() == b.len()).then(|| {
        let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a.angle_between(*b))).sum();
        (sum / a.len() as f64).to_degrees()
    })
}
