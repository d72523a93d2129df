//! The default level of detail: a hierarchy of triangle clusters.
//!
//! The finest clusters consist of the original triangles. Neighbouring clusters form a group; the
//! group is simplified to half its faces with its boundary locked and split into new clusters,
//! which form groups with others, and so on. A group is either open, its fine clusters (inputs)
//! being used, or closed, its coarse ones (outputs) being used. Since both sides have the same
//! boundary, any set of open groups that contains, with a group, all groups that use its outputs
//! draws the surface once and without cracks.
//!
//! Vertices of the finest level are the original's. Vertices of coarser levels move to the minimum
//! of their quadric and take normal and curvature tint from the original there.
//!
//! After Karis 2021 (Nanite) and the cluster hierarchies before it (Cignoni et al. 2004,
//! doi:10.1145/1015706.1015802; Yoon et al. 2004). Departure: the cluster error bound
//! ([`Group::error_mm`]) is not estimated by a quadric but measured; it bounds the two-sided
//! (Hausdorff) distance to the original.

mod build;
mod bytes;
mod cluster_builder;
mod clusterize;
mod coarse_to_fine;
mod convex_polygon;
mod cut;
mod cut_criterion;
mod distance_bound;
mod error;
mod group;
mod group_error;
mod group_simplify;
mod partition;
mod projection;
mod propagate;
mod surface_map;
mod surfaces;
mod uniform_cut;
mod vertex_faces;

pub use bytes::key;
pub use cut::{ClusterLod, DEFAULT_SHADING_RAD};
pub use error::ClusterError;

use glam::Vec3;

use crate::geometry::{Cone, Sphere, Vertex};

/// Stands for "no group".
pub const NO_GROUP: u32 = u32::MAX;

/// A cluster: at most [`super::PAGE_TRIANGLES`] neighbouring triangles of one level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cluster {
    /// First of its vertices in [`Clusters::vertex_ids`].
    pub first_vertex: u32,
    /// Number of its vertices.
    pub vertices: u32,
    /// First of its triangles in [`Clusters::triangles`].
    pub first_triangle: u32,
    /// Number of its triangles.
    pub triangles: u32,
    /// Bounding sphere of its triangles.
    pub sphere: Sphere,
    /// Half extent of their bounding box, which has the centre of the sphere, mm.
    pub half: Vec3,
    /// Cone that contains the normals of its triangles.
    pub cone: Cone,
    /// Cluster error bound: two-sided distance bound to the source patch, the part of the original
    /// that the cluster replaces, mm; 0 for the finest. At most that of the group that made it.
    pub error_mm: f32,
    /// The group it is an output of; [`NO_GROUP`] for the finest.
    pub output_of: u32,
    /// The group it is an input of; [`NO_GROUP`] for the coarsest.
    pub input_of: u32,
}

/// A group: clusters that are refined or coarsened together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Group {
    /// First of its fine clusters in `Clusters::members`.
    pub first_input: u32,
    /// Number of its fine clusters.
    pub inputs: u32,
    /// First of its coarse clusters; their ids are consecutive.
    pub first_output: u32,
    /// Number of its coarse clusters.
    pub outputs: u32,
    /// Bounding sphere of its clusters, fine and coarse, and of the source patch.
    pub sphere: Sphere,
    /// Bounding sphere of [`Self::sphere`] and the same of every group below.
    pub subtree_sphere: Sphere,
    /// Two-sided distance bound between the outputs and their source patch, mm. At least that of
    /// every group below.
    pub error_mm: f32,
    /// Root mean square over area of the angle between the interpolated normals of the original and
    /// of the outputs, radians. The maximum would be that of single creases.
    pub angle_rad: f32,
    /// Largest [`Self::angle_rad`] of this group and of every group below, radians.
    pub subtree_angle_rad: f32,
    /// Largest product of angle and longest edge of this group and of every group below, rad mm.
    pub subtree_turn_mm: f32,
    /// Longest edge of the outputs, mm. At least that of every group below.
    pub edge_mm: f32,
}

/// A surface at all its levels. Groups come after all groups below them.
#[derive(Clone, Debug, PartialEq)]
pub struct Clusters {
    /// Vertices of the original, then those that coarser levels added, as drawn.
    vertices: Vec<Vertex>,
    /// Number of vertices of the original.
    original_vertices: usize,
    clusters: Vec<Cluster>,
    groups: Vec<Group>,
    members: Vec<u32>,
    vertex_ids: Vec<u32>,
    triangles: Vec<[u8; 3]>,
    /// Hash of the mesh that it was built from ([`key`]).
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

    /// All vertices as drawn: those of the original under its own ids, then those that coarser
    /// levels added.
    pub fn vertices(&self) -> &[Vertex] {
        &self.vertices
    }

    /// Vertices of a cluster, as indices into [`Self::vertices`].
    pub fn vertex_ids(&self, cluster: u32) -> &[u32] {
        let c = &self.clusters[cluster as usize];
        &self.vertex_ids[c.first_vertex as usize..][..c.vertices as usize]
    }

    /// Triangles of a cluster, as indices into [`Self::vertex_ids`].
    pub fn triangles(&self, cluster: u32) -> &[[u8; 3]] {
        let c = &self.clusters[cluster as usize];
        &self.triangles[c.first_triangle as usize..][..c.triangles as usize]
    }

    /// Triangles of a cluster, as indices into [`Self::vertices`].
    pub fn faces(&self, cluster: u32) -> impl Iterator<Item = [u32; 3]> + '_ {
        let ids = self.vertex_ids(cluster);
        self.triangles(cluster).iter().map(move |t| t.map(|v| ids[usize::from(v)]))
    }

    /// Two-sided distance bound of every cut to the original, mm.
    pub fn largest_error_mm(&self) -> f64 {
        self.groups.iter().fold(0.0, |most, g| f64::from(g.error_mm).max(most))
    }

    /// Triangles of the original.
    pub fn finest_faces(&self) -> u64 {
        let finest = self.clusters.iter().filter(|c| c.output_of == NO_GROUP);
        finest.map(|c| u64::from(c.triangles)).sum()
    }

    /// Clusters that are input of no group: the coarsest cut, where no group is open.
    pub fn roots(&self) -> impl Iterator<Item = u32> + '_ {
        let ids = 0..self.clusters.len() as u32;
        ids.filter(|c| self.clusters[*c as usize].input_of == NO_GROUP)
    }

    /// Largest number of clusters on one side of a group.
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
