//! View-dependent subdivision of the paper (Li et al. 2004): the triangles of a base mesh are split
//! 1-to-4 where the camera looks, and new vertices lie on the original surface, found through the
//! parameterisation (MAPS, Lee et al. 1998, doi:10.1145/280814.280828).
//!
//! The unit is a patch: a base face, or a part of one, with the samples of a few levels. All
//! patches stay in buffers on the device. A camera decides how fine each is: a change is another
//! index template and other morphing weights in its draw command, and nothing is uploaded. Other
//! [schemes](Scheme) than 1-to-4 have other templates over the same machinery.
//!
//! Departures. The paper resamples while it flies; here every sample is taken once, when the
//! surface is made. The paper's levels meet in cracks; here neighbouring patches differ by at most
//! one level, the gap is filled by the templates of red-green refinement, and points on the side of
//! a patch depend on that side alone. The paper calls its finest level "the original mesh"; a
//! resampled surface never is, and its distance is measured
//! ([`SubdivisionSurface::finest_error_mm`]).

mod base_mesh;
mod butterfly;
mod criterion;
mod cut;
mod forest;
mod measure;
mod original;
mod patch;
mod scheme;
mod surface;
mod template;
mod wall;

pub use original::{Original, ParameterizedOriginal};
pub use patch::{DrawnPatch, ResidentPatches};
pub use scheme::Scheme;
pub use surface::{SubdivisionSurface, VdsError, VdsOptions};
pub use wall::SubdividedWall;

#[cfg(test)]
mod tests;
