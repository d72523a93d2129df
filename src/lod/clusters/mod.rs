//! The default level of detail: a hierarchy of clusters of triangles.
//!
//! The finest clusters are the original triangles. Neighbouring clusters form a group; a group is
//! simplified to half its faces with its rim locked and cut into new clusters, which form groups
//! with others, and so on. A group is either open, its fine clusters (inputs) being used, or
//! closed, its coarse ones (outputs) being used. Since rims are the same at both sides, any set of
//! open groups that holds with a group all groups that use its outputs draws the surface once and
//! without cracks.
//!
//! The finest level has the original's vertices. Inside a group, coarse ones move to where they
//! stand best for those that went, and have the normal and relief of the original there.
//!
//! After Karis 2021 (Nanite) and the cluster hierarchies before it (Cignoni et al. 2004,
//! doi:10.1145/1015706.1015802; Yoon et al. 2004). Ours: the error of a group is not a quadric's
//! but a measured bound of the distance to the original, both ways ([`Group::error_mm`]).

mod back;
mod build;
mod bytes;
mod carry;
mod cover;
mod cut;
mod draft;
mod error;
mod even;
mod fans;
mod fill;
mod group;
mod halve;
mod image;
mod lay;
mod measure;
mod partition;

pub use bytes::key;
pub use cut::{ClusterLod, DEFAULT_SHADING_RAD};
pub use error::ClusterError;

use super::{Cone, Sphere};
use crate::geometry::Vertex;

/// No group.
pub const NONE: u32 = u32::MAX;

/// At most [`super::PAGE_TRIANGLES`] neighbouring triangles of one level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cluster {
    /// Its vertices in [`Clusters::vertex_ids`]: the first,
    pub first_vertex: u32,
    /// and how many.
    pub vertices: u32,
    /// Its triangles in [`Clusters::triangles`]: the first,
    pub first_triangle: u32,
    /// and how many.
    pub triangles: u32,
    /// Holds its triangles.
    pub sphere: Sphere,
    /// Holds the normals of its triangles.
    pub cone: Cone,
    /// No point of it is farther than this from the original, and no point of what it stands for
    /// farther from it, mm; 0 for the finest. At most that of the group that made it.
    pub error_mm: f32,
    /// The group it is an output of; [`NONE`] for the finest.
    pub made_by: u32,
    /// The group it is an input of; [`NONE`] for the coarsest.
    pub used_by: u32,
}

/// Clusters that are replaced together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Group {
    /// Its fine clusters in `Clusters::members`: the first,
    pub first_input: u32,
    /// and how many.
    pub inputs: u32,
    /// Its coarse clusters, ids next to each other: the first,
    pub first_output: u32,
    /// and how many.
    pub outputs: u32,
    /// Holds its clusters, fine and coarse, and the part of the original they stand for.
    pub sphere: Sphere,
    /// Holds [`Self::sphere`] and the reach of every group below.
    pub reach: Sphere,
    /// No point of the outputs is farther than this from the original, and no point of the
    /// original they stand for is farther from them, mm. At least that of every group below.
    pub error_mm: f32,
    /// Angle between the original's interpolated normals and the outputs', root mean square by
    /// area, radians; the largest would be that of single creases.
    pub angle_rad: f32,
    /// Largest angle of this group and of every group below, radians.
    pub reach_angle_rad: f32,
    /// Largest product of angle and longest edge of this group and of every group below, rad mm.
    pub reach_turn_mm: f32,
    /// Longest edge of the outputs, mm. At least that of every group below.
    pub edge_mm: f32,
}

/// A surface at all its levels. Groups come after all groups below them.
#[derive(Clone, Debug, PartialEq)]
pub struct Clusters {
    /// Vertices of the original, then those that coarser levels moved, as drawn.
    vertices: Vec<Vertex>,
    /// How many are the original's.
    own_vertices: usize,
    clusters: Vec<Cluster>,
    groups: Vec<Group>,
    members: Vec<u32>,
    vertex_ids: Vec<u32>,
    triangles: Vec<[u8; 3]>,
    /// Of what it was built from.
    key: [u8; 32],
}

impl Clusters {
    /// All clusters of all levels, by id.
    pub fn clusters(&self) -> &[Cluster] {
        &self.clusters
    }

    /// All groups, by id.
    pub fn groups(&self) -> &[Group] {
        &self.groups
    }

    /// Ids of a group's fine clusters.
    pub fn inputs(&self, group: u32) -> &[u32] {
        let g = &self.groups[group as usize];
        &self.members[g.first_input as usize..][..g.inputs as usize]
    }

    /// Ids of a group's coarse clusters.
    pub fn outputs(&self, group: u32) -> std::ops::Range<u32> {
        let g = &self.groups[group as usize];
        g.first_output..g.first_output + g.outputs
    }

    /// All vertices as drawn: the original's under its own ids, then those that coarser levels
    /// moved.
    pub fn vertices(&self) -> &[Vertex] {
        &self.vertices
    }

    /// The vertices that a cluster uses, as places in [`Self::vertices`].
    pub fn vertex_ids(&self, cluster: u32) -> &[u32] {
        let c = &self.clusters[cluster as usize];
        &self.vertex_ids[c.first_vertex as usize..][..c.vertices as usize]
    }

    /// A cluster's triangles, as places in [`Self::vertex_ids`].
    pub fn triangles(&self, cluster: u32) -> &[[u8; 3]] {
        let c = &self.clusters[cluster as usize];
        &self.triangles[c.first_triangle as usize..][..c.triangles as usize]
    }

    /// A cluster's triangles by places in [`Self::vertices`].
    pub fn faces(&self, cluster: u32) -> impl Iterator<Item = [u32; 3]> + '_ {
        let ids = self.vertex_ids(cluster);
        self.triangles(cluster).iter().map(move |t| t.map(|v| ids[usize::from(v)]))
    }

    /// How far any cut may be from the original, mm.
    pub fn largest_error_mm(&self) -> f64 {
        self.groups.iter().fold(0.0, |most, g| f64::from(g.error_mm).max(most))
    }

    /// Triangles of the original.
    pub fn finest_faces(&self) -> u64 {
        let finest = self.clusters.iter().filter(|c| c.made_by == NONE);
        finest.map(|c| u64::from(c.triangles)).sum()
    }

    /// Clusters that no group takes further: what is drawn where nothing is open.
    pub fn roots(&self) -> impl Iterator<Item = u32> + '_ {
        let ids = 0..self.clusters.len() as u32;
        ids.filter(|c| self.clusters[*c as usize].used_by == NONE)
    }

    /// The most clusters on one side of a group.
    pub fn widest_group(&self) -> u32 {
        self.groups.iter().map(|g| g.inputs.max(g.outputs)).max().unwrap_or(0)
    }

    /// Bytes it takes in memory.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.vertices[..])
            + size_of_val(&self.clusters[..])
            + size_of_val(&self.groups[..])
            + size_of_val(&self.members[..])
            + size_of_val(&self.vertex_ids[..])
            + size_of_val(&self.triangles[..])
    }
}

#[cfg(test)]
mod tests;
