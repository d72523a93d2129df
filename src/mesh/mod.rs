//! Half-edge meshes: invariants, simplification by half-edge collapse, parameterisation.

mod collapse;
pub mod maps;

pub use collapse::{Collapse, OnMesh, Recorder};
pub use maps::{Mapped, Maps, MapsError};
