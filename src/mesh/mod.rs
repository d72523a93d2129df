//! Half-edge meshes: repair, simplification by half-edge collapse, parameterization, and the
//! deviation of two meshes.

mod collapse;
mod deviation;
mod edge_collapse;
mod error;
pub mod halfedge;
mod heap;
mod input;
mod make_manifold;
mod options;
pub mod parameterization;
mod parts;
mod quadric;
mod relocate;
mod simplify;
mod star;
mod triangle_x8;
mod vertex_quadrics;

pub use collapse::{Collapse, Log, Recorder};
pub use deviation::{Deviation, deviation};
pub use error::MeshError;
pub use halfedge::HalfEdges;
pub use make_manifold::{Repairs, make_manifold};
pub use options::{Metric, SimplifyOptions, StopReason};
pub use parameterization::{MappedPoint, Parameterization, ParameterizationError};
pub use simplify::{Simplified, simplify};

#[cfg(test)]
mod tests;
