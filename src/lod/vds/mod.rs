//! The paper's view-dependent subdivision (ALGORITHMS, stage j.1): a base mesh whose triangles are
//! split 1-to-4 where the camera looks and whose new vertices lie on the original surface, found
//! through the parameterisation (Lee et al. 1998, doi:10.1145/280814.280828).
//!
//! Our departures. The paper resamples while it flies; here every sample of the finest level is
//! taken once, when the surface is made, so that a step only gathers. Its levels meet in cracks;
//! here the level belongs to the edges as well, neighbouring triangles differ by one level at most
//! and the gap is filled by the seven templates of red-green refinement (Bank et al. 1983). Its
//! finest level is "the original mesh"; a resampled surface never is, and by how much it is not is
//! measured and part of every bound ([`Surface::finest_error_mm`]).

mod base;
mod epsilon;
mod levels;
mod pages;
mod resample;
mod samples;
pub mod schemes;
mod select;
mod state;
mod surface;
mod tessellate;

pub use resample::{Original, Recorded};
pub use state::Vds;
pub use surface::{Surface, VdsError, VdsOptions};

#[cfg(test)]
mod measure;
#[cfg(test)]
mod tests;
