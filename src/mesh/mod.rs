//! Half-edge meshes: invariants, simplification by half-edge collapse, parameterisation.

mod collapse;
pub mod contract;
mod deviation;
mod eight;
mod error;
mod given;
mod greedy;
pub mod halfedge;
mod heap;
pub mod maps;
mod nearest;
mod parts;
pub(crate) mod placed;
mod prepare;
mod quadric;
mod relocate;
mod simplify;
mod star;
mod start;

pub use collapse::{Collapse, Log, OnMesh, Recorder};
pub use deviation::{Deviation, deviation};
pub use error::MeshError;
pub use halfedge::HalfEdges;
pub use maps::{Mapped, Maps, MapsError};
pub use nearest::{Closest, Nearest};
pub use prepare::{Repairs, prepare};
pub use simplify::{Metric, Simplified, SimplifyOptions, Stopped, simplify};

#[cfg(test)]
mod tests;
