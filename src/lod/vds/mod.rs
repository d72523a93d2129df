//! View-dependent subdivision of the paper (Li et al. 2004): the triangles of a base mesh are split
//! 1-to-4 where the camera looks, and new vertices lie on the original surface, found through the
//! parameterisation (MAPS, Lee et al. 1998, doi:10.1145/280814.280828).
//!
//! Departures. The paper resamples while it flies; here every sample of the finest level is taken
//! once, when the surface is made, so a step only gathers. The paper's levels meet in cracks; here
//! the level belongs to the edges as well, neighbouring triangles differ by at most one level, and
//! the gap is filled by the seven templates of red-green refinement (Bank et al. 1983). The paper
//! calls its finest level "the original mesh"; a resampled surface never is, and its deviation is
//! measured and part of every bound ([`SubdivisionSurface::finest_error_mm`]).

mod base_mesh;
mod level_bounds;
mod fineness;
mod pages;
mod original;
mod samples;
pub mod schemes;
mod select;
mod state;
mod surface;
mod tessellate;

pub use original::{Original, ParameterizedOriginal};
pub use state::Vds;
pub use surface::{SubdivisionSurface, VdsError, VdsOptions};

#[cfg(test)]
mod large_meshes;
#[cfg(test)]
mod tests;
