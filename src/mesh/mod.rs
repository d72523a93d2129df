//! Half-edge meshes: invariants, simplification by half-edge collapse, parameterisation.

mod collapse;

pub use collapse::{Collapse, OnMesh, Recorder};
