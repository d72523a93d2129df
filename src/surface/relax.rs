//! Relaxed walls of label maps: every vertex slides along its grid edge, between the inside and the
//! outside voxel, to where the wall agrees with the smoothed normals.
//!
//! A label map says that the wall passes between two voxel centres, not where; halfway is wrong by a
//! fraction that is nearly uniform over the edge. Positions from normals are after Nehab et al.
//! 2005, doi:10.1145/1073204.1073226. The unknown is one number a vertex, so that the noise is
//! averaged along the wall and no voxel centre can change sides; the residual is that of the mean of
//! two normals, which is 0 on circles and spheres, so that curvature does not shrink the wall.
//! `shaders/relax_coefficients.wgsl` has the formula.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::extract::{GridEdge, point_on, vertex_edges};
use super::{Adjacency, Crossing, Midpoint};
use crate::compute::{Buf, Plan};
use crate::geometry::Mesh;
use crate::kernels::relax_coefficients::{FIXED, OUTSIDE_IS_LOWER, edge_axis};
use crate::kernels::{relax_average, relax_coefficients, relax_guard, relax_step};
use crate::lumen::Lumen;

/// Largest ratio of spacings that is relaxed. Beyond it the normals are off by 6 to 13 degrees, and
/// sliding to them is no gain.
pub const MAX_SPACING_RATIO: f64 = 3.0;

/// Largest ratio of spacings that is relaxed by default: beyond it small polyps lose half of their
/// height.
const DEFAULT_SPACING_RATIO: f64 = 2.0;

/// Number of steps of the minimisation: with this many it has converged as far as noise allows.
const STEPS: u32 = 24;

/// Momentum of a step.
const MOMENTUM: f32 = 0.87;

/// Weight of the distance to the halfway wall: it ties low frequencies to the mask.
const STIFFNESS: f32 = 0.05;

/// Least distance of a vertex from a voxel centre, in smallest spacings. It keeps the angles of
/// faces above 4.5 degrees.
const CLEARANCE: f64 = 1.0 / 8.0;

/// Number of averaging steps of the curvature in the guard.
const BEND_STEPS: u32 = 2;

/// Number of averaging steps of the low-pass in the guard, and of its applications.
const SHIFT_STEPS: u32 = 4;
const GUARD_ROUNDS: u32 = 2;

/// Errors of relaxing a wall.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RelaxError {
    /// The spacings differ too much: slices are too thick.
    #[error(
        "the largest voxel spacing is {ratio:.2} times the smallest; walls are relaxed up to \
         {MAX_SPACING_RATIO}"
    )]
    SpacingRatio {
        /// Ratio of the largest to the smallest spacing.
        ratio: f64,
    },
}

/// Whether the wall of a label map with this voxel spacing is relaxed by default.
pub fn relaxes_by_default(spacing_mm: DVec3) -> bool {
    spacing_ratio(spacing_mm) <= DEFAULT_SPACING_RATIO * (1.0 + 1e-6)
}

fn spacing_ratio(spacing_mm: DVec3) -> f64 {
    spacing_mm.max_element() / spacing_mm.min_element()
}

/// Grid edges of a halfway wall, as input of its relaxation.
pub struct RelaxInput {
    /// Grid edge of each vertex, one word: see `shaders/lib/grid_edge.wgsl`.
    edges: Vec<u32>,
    /// Vectors from a voxel to the next along each grid axis, mm.
    axes_mm: [DVec3; 3],
}

impl RelaxInput {
    /// Finds the grid edges of a lumen's halfway wall.
    ///
    /// * `mesh`: mesh [`super::extract`]ed with [`Midpoint`], all of it or a component.
    ///
    /// # Errors
    /// [`RelaxError`].
    ///
    /// # Panics
    /// If `mesh` has a vertex that is not halfway along a crossed edge of the lumen.
    pub fn new(mesh: &Mesh, lumen: &Lumen) -> Result<Self, RelaxError> {
        let grid = &lumen.grid;
        let ratio = spacing_ratio(grid.spacing_mm);
        if ratio > MAX_SPACING_RATIO * (1.0 + 1e-6) {
            return Err(RelaxError::SpacingRatio { ratio });
        }
        let all = vertex_edges(lumen);
        let edges = if all.len() == mesh.positions.len() {
            all.par_iter().with_min_len(4096).map(|e| code(*e, lumen)).collect()
        } else {
            // Vertices of a component keep their order.
            let world = grid.world_from_voxel();
            let mut rest = all.iter();
            let next = |p: &Vec3| {
                let halfway = |e: &GridEdge| {
                    point_on(*e, &world, Midpoint.fraction(e.inside, e.outside)) == *p
                };
                let edge = rest.find(|e| halfway(e)).expect("a vertex of the lumen's halfway wall");
                code(*edge, lumen)
            };
            mesh.positions.iter().map(next).collect()
        };
        let axes_mm = [0, 1, 2].map(|k| grid.direction.col(k) * grid.spacing_mm[k]);
        Ok(Self { edges, axes_mm })
    }

    /// Computes the positions of the relaxed wall, LPS mm.
    ///
    /// * `halfway`: positions of the mesh that `self` was made of.
    /// * `fractions`: from [`relax`].
    pub fn positions(&self, halfway: &[Vec3], fractions: &[f32]) -> Vec<Vec3> {
        let moved = |(p, (s, code)): (&Vec3, (&f32, &u32))| {
            let s = if code & OUTSIDE_IS_LOWER != 0 { -s } else { *s };
            (p.as_dvec3() + f64::from(s) * self.axes_mm[edge_axis(*code)]).as_vec3()
        };
        let places = fractions.par_iter().zip(&self.edges);
        halfway.par_iter().zip(places).with_min_len(4096).map(moved).collect()
    }

    fn params(&self) -> relax_coefficients::Params {
        let length = self.axes_mm.map(DVec3::length);
        let h = length.into_iter().fold(f64::INFINITY, f64::min);
        let axis = |k: usize| (self.axes_mm[k] / h).extend(length[k] / h).as_vec4().to_array();
        let limit = |k: usize| (0.5 - CLEARANCE * h / length[k]) as f32;
        relax_coefficients::Params {
            axis_x: axis(0),
            axis_y: axis(1),
            axis_z: axis(2),
            limit_x: limit(0),
            limit_y: limit(1),
            limit_z: limit(2),
            stiffness: STIFFNESS,
            vertices: self.edges.len() as u32,
            ..Default::default()
        }
    }
}

/// Returns the word that encodes a grid edge.
fn code(edge: GridEdge, lumen: &Lumen) -> u32 {
    let middle = edge.inside + edge.outside;
    let [x, y, z] = middle.to_array().map(|m| m as u32 & 255);
    let side = if edge.outside.cmplt(edge.inside).any() { OUTSIDE_IS_LOWER } else { 0 };
    // Ends of a lumen that the volume cuts off stay where they are.
    let fixed = if lumen.is_in_volume(edge.outside) { 0 } else { FIXED };
    x | y << 8 | z << 16 | side | fixed
}

/// Appends the relaxation; returns for each vertex its shift from the middle of its grid edge
/// towards the outside voxel, as a fraction of the edge in (−½, ½); 0 where the edge leaves the
/// volume.
///
/// * `adjacency`: adjacency of the mesh that `input` was made of.
/// * `normals`: smoothed unit normals of that mesh, three floats a vertex.
pub fn relax<'a>(
    plan: &mut Plan<'a>,
    adjacency: &'a Adjacency,
    input: &'a RelaxInput,
    normals: Buf<f32>,
) -> Buf<f32> {
    let n = input.edges.len();
    let vertices = n as u32;
    let (start, near) = adjacency.upload(plan);
    let edge = plan.upload("grid edges", &input.edges);
    let bound = plan.undefined::<[f32; 2]>("offsets and limits", n);
    let coupling = plan.undefined::<f32>("couplings", adjacency.near.len());
    let mut bend = plan.undefined::<f32>("bend of normals", n);
    let bindings =
        relax_coefficients::Bindings { start, near, edge, normal: normals, bound, coupling, bend };
    plan.launch(&relax_coefficients::KERNEL, bindings, input.params(), n, n);

    let place = plan.zeroed::<f32>("fractions", n);
    let mut now = plan.zeroed::<f32>("extrapolated fractions", n);
    let mut next = plan.undefined::<f32>("next fractions", n);
    for _ in 0..STEPS {
        let params = relax_step::Params { momentum: MOMENTUM, vertices };
        let bindings = relax_step::Bindings { start, near, coupling, bound, now, place, next };
        plan.launch(&relax_step::KERNEL, bindings, params, n, n);
        std::mem::swap(&mut now, &mut next);
    }

    // The guard. Normals are too smooth on bumps three voxels across, and the wall follows them: a
    // shift that the low-pass of the fractions shows, as the noise of voxel steps averages out.
    let average = |plan: &mut Plan<'a>, value, average| {
        let bindings = relax_average::Bindings { start, near, value, average };
        plan.launch(&relax_average::KERNEL, bindings, relax_average::Params { vertices }, n, n);
    };
    for _ in 0..BEND_STEPS {
        average(plan, bend, now);
        std::mem::swap(&mut bend, &mut now);
    }
    for _ in 0..GUARD_ROUNDS {
        average(plan, place, now);
        for _ in 1..SHIFT_STEPS {
            average(plan, now, next);
            std::mem::swap(&mut now, &mut next);
        }
        let bindings = relax_guard::Bindings { bend, bound, shift: now, place };
        plan.launch(&relax_guard::KERNEL, bindings, relax_guard::Params { vertices }, n, n);
    }
    place
}

#[cfg(test)]
mod tests;
