//! Normal smoothing (*fairing*, Li et al. 2004, section 2): vertices never move.

use glam::Vec3;
use rayon::prelude::*;

use super::Adjacency;
use crate::compute::{Buf, Plan};
use crate::geometry::Mesh;
use crate::kernels::fair as kernel;

/// Weights of the discrete Laplacian (Li et al. 2004, section 2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Weights {
    /// Equal weights 1/m, m the valence.
    Uniform,
    /// Inverse edge lengths, divided by their sum.
    InverseDistance,
}

/// Options of normal smoothing by steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fairing {
    /// Number of steps, which has to be given: the iteration has no useful limit.
    pub steps: u32,
    /// Share of the neighbours' mean in a step, in (0, 1).
    pub lambda: f32,
    /// Weights of the neighbours.
    pub weights: Weights,
}

/// Method of smoothing normals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Smoothing {
    /// Multiscale smoothing: each vertex as far as its surroundings allow
    /// ([`super::multiscale_normals`]).
    Multiscale,
    /// Smoothing of Li et al. 2004: the same number of steps for every vertex.
    Steps(Fairing),
}

/// Number of steps with which the error on spheres, tori and tubes is within a fifth of that with
/// the best number of steps.
pub const DEFAULT_STEPS: u32 = 30;

impl Fairing {
    /// Options of Li et al. 2004: uniform weights, λ = 0.5.
    pub const PAPER: Self = Self { steps: DEFAULT_STEPS, lambda: 0.5, weights: Weights::Uniform };
}

/// Returns area-weighted vertex normals, three floats a vertex; a vertex without area gets +z.
pub fn face_normals(mesh: &Mesh) -> Vec<f32> {
    let mut sum = vec![Vec3::ZERO; mesh.positions.len()];
    for &f in &mesh.faces {
        let n = mesh.face_cross(f);
        for v in f {
            sum[v as usize] += n;
        }
    }
    sum.par_iter()
        .with_min_len(8192)
        .flat_map_iter(|n| n.try_normalize().unwrap_or(Vec3::Z).to_array())
        .collect()
}

/// Returns the normalised weights of every adjacency entry.
pub fn weights(mesh: &Mesh, adjacency: &Adjacency, weights: Weights) -> Vec<f32> {
    let shortest =
        mesh.bounds().map_or(0.0, |(lo, hi)| 1e-6 * (hi - lo).length()).max(f32::MIN_POSITIVE);
    (0..mesh.positions.len())
        .into_par_iter()
        .with_min_len(4096)
        .flat_map_iter(|v| {
            let p = mesh.positions[v];
            let raw = move |w: u32| match weights {
                Weights::Uniform => 1.0,
                Weights::InverseDistance => {
                    1.0 / p.distance(mesh.positions[w as usize]).max(shortest)
                }
            };
            let row = adjacency.row(v);
            let sum: f32 = row.iter().map(|w| raw(*w)).sum();
            row.iter().map(move |w| raw(*w) / sum)
        })
        .collect()
}

/// Appends the smoothing steps; returns the smoothed normals, three floats a vertex.
///
/// * `start`: unit normals, three floats a vertex.
/// * `weight`: from [`weights`].
pub fn fair<'a>(
    plan: &mut Plan<'a>,
    adjacency: &'a Adjacency,
    weight: &'a [f32],
    start: &'a [f32],
    fairing: Fairing,
) -> Buf<f32> {
    let vertices = start.len() / 3;
    let (rows, near) = adjacency.upload(plan);
    let weight = plan.upload("weights", weight);
    let mut normal = plan.upload("normals", start);
    let mut spare: Option<Buf<f32>> = None;
    let params = kernel::Params { vertices: vertices as u32, lambda: fairing.lambda };
    for step in 0..fairing.steps {
        let faired = spare.unwrap_or_else(|| plan.undefined("faired normals", start.len()));
        let bindings = kernel::Bindings { start: rows, near, weight, normal, faired };
        plan.launch(&kernel::KERNEL, bindings, params, vertices, vertices);
        // Two buffers of our own go back and forth; the caller's stays as it was.
        spare = (step > 0).then_some(normal);
        normal = faired;
    }
    normal
}
