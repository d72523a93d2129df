//! Report of a surface.

use crate::geometry::Mesh;
use crate::session::{Wall, written_mesh};
use crate::surface::{Adjacency, Topology};
use crate::wall::FluidLevel;
use serde::Serialize;
use std::borrow::Cow;

/// The surface.
#[derive(Clone, Debug, Serialize)]
pub struct SurfaceReport {
    /// Vertices of the mesh.
    pub vertices: usize,
    /// Triangles of the mesh.
    pub faces: usize,
    /// Connected parts of the mesh.
    pub components: usize,
    /// Euler characteristic: vertices − edges + faces.
    pub euler: i64,
    /// Tunnels through the lumen (handles of its surface): loops that a tree does not follow.
    pub tunnels: i64,
    /// Whether every edge has two faces.
    pub watertight: bool,
    /// Area of all faces.
    pub area_mm2: f64,
    /// Flat pieces that are levels of fluid under gas and no mucosa, the largest first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub fluid_levels: Vec<FluidLevel>,
}

impl SurfaceReport {
    /// Counts of a wall as it is written.
    pub fn of_written(wall: &Wall, open_ends: bool) -> Self {
        let counts = match written_mesh(&wall.mesh, open_ends) {
            Cow::Borrowed(mesh) => Self::of(wall.topology, mesh.area_mm2()),
            Cow::Owned(mesh) => Self::of_mesh(&mesh),
        };
        Self { fluid_levels: wall.levels.clone(), ..counts }
    }

    /// Counts of any mesh.
    pub fn of_mesh(mesh: &Mesh) -> Self {
        let (adjacency, watertight) = Adjacency::of(mesh);
        Self::of(adjacency.topology(mesh, watertight), mesh.area_mm2())
    }

    /// Counts of a surface.
    pub fn of(topology: Topology, area_mm2: f64) -> Self {
        let Topology { vertices, faces, components, euler, watertight, .. } = topology;
        let tunnels = topology.tunnels();
        let fluid_levels = Vec::new();
        Self { vertices, faces, components, euler, tunnels, watertight, area_mm2, fluid_levels }
    }
}
