//! Builds the cluster hierarchy of a mesh, level by level.

use std::collections::VecDeque;

use glam::Vec3;
use rayon::prelude::*;

use super::cluster_builder::ClusterBuilder;
use super::clusterize;
use super::distance_bound::{TargetCache, TargetSurface, round_up};
use super::group::{SimplifiedGroup, simplify};
use super::partition::{self, ClusterBorder};
use super::surfaces::{IntermediateSurface, OriginalSurface, VertexTable};
use super::{Cluster, ClusterError, Clusters, Group, NO_GROUP};
use crate::fault;
use crate::geometry::{Cone, Mesh, Sphere, TriangleBvh, Vertex};
use crate::lod::octree::{Item, bounding_cone};

/// No coarser level is built where at most this many clusters are left (up to 31,000 triangles).
/// Coarser ones serve only the farthest places of an organ, and each level still takes six tenths
/// of the time of the one before.
const MIN_CLUSTERS: usize = 512;
/// Most faces: ids are 32 bits, and four half-edge ids a face must fit.
const MAX_FACES: usize = (1 << 30) - 1;

impl Clusters {
    /// Builds all levels. `vertices`: one for each vertex of the mesh, as drawn
    /// ([`crate::surface::shading`]). Any triangle soup is accepted; the fewer of its edges have
    /// two faces, the less can be simplified. `tree`: of the mesh's triangles. The result does not depend on the number of threads.
    ///
    /// # Errors
    /// [`ClusterError`]: a face or position that makes no sense, or too many.
    pub fn build(
        mesh: &Mesh,
        vertices: &[Vertex],
        tree: &TriangleBvh,
    ) -> Result<Self, ClusterError> {
        Self::build_with(mesh, vertices, tree, MIN_CLUSTERS, true)
    }

    /// * `min_clusters`: no coarser level is built once so few clusters are left.
    /// * `lock`: whether group boundaries are locked; false only in the test of what happens
    ///   without.
    pub(super) fn build_with(
        mesh: &Mesh,
        vertices: &[Vertex],
        tree: &TriangleBvh,
        min_clusters: usize,
        lock: bool,
    ) -> Result<Self, ClusterError> {
        Self::build_observed(mesh, vertices, tree, min_clusters, lock, |_, _| ())
    }

    /// Builds as [`Self::build_with`] and calls `observe` after each level with its live clusters
    /// and the vertices so far.
    pub(super) fn build_observed(
        mesh: &Mesh,
        vertices: &[Vertex],
        tree: &TriangleBvh,
        min_clusters: usize,
        lock: bool,
        mut observe: impl FnMut(&[(u32, ClusterBuilder)], &VertexTable),
    ) -> Result<Self, ClusterError> {
        check(mesh, vertices)?;
        let normals: Vec<Vec3> = vertices.iter().map(Vertex::normal).collect();
        // Clustering is partly serial, so the hash is taken at the same time.
        let ((face_neighbors, finest), key) = rayon::join(
            || {
                let face_neighbors = partition::face_neighbors(&mesh.faces, vertices.len());
                let finest = clusterize::finest_clusters(mesh, &face_neighbors);
                (face_neighbors, finest)
            },
            || super::bytes::key(mesh, vertices),
        );
        crate::task::checkpoint();
        let mut face_at = vec![0; vertices.len()];
        for (f, i) in mesh.faces.iter().zip(0..) {
            f.iter().for_each(|v| face_at[*v as usize] = i);
        }
        let target = TargetSurface {
            positions: &mesh.positions,
            normals: &normals,
            faces: &mesh.faces,
            face_neighbors: &face_neighbors,
            bvh: tree,
            cache: &TargetCache::default(),
        };
        let original = OriginalSurface { target };
        let mut places = VertexTable {
            positions: mesh.positions.clone(),
            normals: normals.clone(),
            face_at,
            predecessor: vec![NO_GROUP; vertices.len()],
        };
        let mut intermediate = VecDeque::new();
        let mut this = Self {
            vertices: vertices.to_vec(),
            original_vertices: vertices.len(),
            clusters: Vec::new(),
            groups: Vec::new(),
            members: Vec::new(),
            vertex_ids: Vec::new(),
            triangles: Vec::new(),
            key,
        };
        let bounds: Vec<ClusterBounds> =
            finest.par_iter().map(|d| ClusterBounds::of(d, &mesh.positions)).collect();
        let mut live: Vec<(u32, ClusterBuilder)> = Vec::with_capacity(finest.len());
        for (draft, bounds) in finest.into_iter().zip(bounds) {
            live.push((this.push(&draft, bounds, NO_GROUP), draft));
        }
        while live.len() > min_clusters {
            crate::task::checkpoint();
            let before = this.groups.len();
            let known = places.positions.len();
            let made = !this.groups.is_empty();
            let (new, form_groups) = rayon::join(
                || made.then(|| IntermediateSurface::new(live.iter().map(|l| &l.1), known)),
                || this.form_groups(&live, lock),
            );
            intermediate.extend(new);
            // The first surface, or the one three levels below: nearer ones have too large an error
            // themselves.
            if intermediate.len() > 3 {
                intermediate.pop_front();
            }
            let ask = if intermediate.len() > 1 { intermediate.front() } else { None };
            live = this.simplify_level(live, form_groups, &original, &mut places, ask);
            observe(&live, &places);
            if this.groups.len() == before {
                break;
            }
        }
        if fault::hit(fault::Point::ErrorBound) {
            this.groups.iter_mut().for_each(|g| g.error_mm *= 0.125);
            this.clusters.iter_mut().for_each(|c| c.error_mm *= 0.125);
        }
        Ok(this)
    }

    /// Adds a cluster; returns its id.
    fn push(&mut self, draft: &ClusterBuilder, bounds: ClusterBounds, output_of: u32) -> u32 {
        let most = self.groups.get(output_of as usize).map_or(0.0, |g| g.error_mm);
        self.clusters.push(Cluster {
            first_vertex: self.vertex_ids.len() as u32,
            vertices: draft.vertices.len() as u32,
            first_triangle: self.triangles.len() as u32,
            triangles: draft.triangles.len() as u32,
            sphere: bounds.sphere,
            half: bounds.half,
            cone: bounds.cone,
            error_mm: round_up(draft.error).min(most),
            output_of,
            input_of: NO_GROUP,
        });
        self.vertex_ids.extend_from_slice(&draft.vertices);
        self.triangles.extend_from_slice(&draft.triangles);
        self.clusters.len() as u32 - 1
    }

    /// Groups the live clusters, and finds the locked vertices.
    fn form_groups(
        &self,
        live: &[(u32, ClusterBuilder)],
        lock: bool,
    ) -> (Vec<Vec<u32>>, Vec<bool>) {
        let bordered: Vec<ClusterBorder> = live
            .par_iter()
            .map(|(id, d)| ClusterBorder {
                border: partition::border_edges(d.faces()),
                centre: self.clusters[*id as usize].sphere.centre,
            })
            .collect();
        let groups = partition::group_clusters(&bordered);
        drop(bordered);
        // Vertices of several groups are locked.
        let known = self.vertices.len();
        let mut group_of = vec![NO_GROUP; known];
        let mut locked = vec![false; known];
        for (g, of) in groups.iter().zip(0..) {
            for v in g.iter().flat_map(|c| &live[*c as usize].1.vertices) {
                let first = &mut group_of[*v as usize];
                if *first == NO_GROUP {
                    *first = of;
                }
                locked[*v as usize] |= lock && *first != of;
            }
        }
        (groups, locked)
    }

    /// Simplifies each group; returns the live clusters of the next level.
    fn simplify_level(
        &mut self,
        live: Vec<(u32, ClusterBuilder)>,
        (groups, locked): (Vec<Vec<u32>>, Vec<bool>),
        original: &OriginalSurface<'_>,
        places: &mut VertexTable,
        intermediate: Option<&IntermediateSurface>,
    ) -> Vec<(u32, ClusterBuilder)> {
        let made: Vec<Option<SimplifiedGroup>> = groups
            .par_iter()
            .map(|g| {
                crate::task::checkpoint();
                let floor = g.iter().map(|c| self.producer(live[*c as usize].0));
                let floor = floor.map(|g| g.map_or(0.0, |g| f64::from(g.error_mm)));
                let drafts: Vec<&ClusterBuilder> = g.iter().map(|c| &live[*c as usize].1).collect();
                let floor = floor.fold(0.0, f64::max);
                simplify(&drafts, floor, &locked, original, places, intermediate, &self.vertices)
            })
            .collect();
        self.append_level(live, &groups, made, places)
    }

    /// Adds the results of all groups; returns the live clusters of the next level.
    fn append_level(
        &mut self,
        live: Vec<(u32, ClusterBuilder)>,
        groups: &[Vec<u32>],
        mut made: Vec<Option<SimplifiedGroup>>,
        places: &mut VertexTable,
    ) -> Vec<(u32, ClusterBuilder)> {
        let known = self.vertices.len() as u32;
        for made in made.iter_mut().flatten() {
            let shift = self.vertices.len() as u32 - known;
            let ids = made.outputs.iter_mut().flat_map(|d| &mut d.vertices);
            ids.filter(|v| **v >= known).for_each(|v| *v += shift);
            for (vertex, face, before) in &made.moved {
                self.vertices.push(*vertex);
                places.positions.push(vertex.position());
                places.normals.push(vertex.normal());
                places.face_at.push(*face);
                places.predecessor.push(*before);
            }
        }
        let bounds_of = |m: &Option<SimplifiedGroup>| {
            let outputs = m.iter().flat_map(|m| &m.outputs);
            outputs.map(|d| ClusterBounds::of(d, &places.positions)).collect()
        };
        let bounds: Vec<Vec<ClusterBounds>> = made.par_iter().map(bounds_of).collect();
        let mut next = Vec::new();
        let mut live: Vec<Option<(u32, ClusterBuilder)>> = live.into_iter().map(Some).collect();
        for ((members, made), bounds) in groups.iter().zip(made).zip(bounds) {
            let taken = members.iter().filter_map(|c| live[*c as usize].take());
            let Some(made) = made else {
                next.extend(taken);
                continue;
            };
            let inputs: Vec<u32> = taken.map(|l| l.0).collect();
            let id = self.add_group(&inputs, &made, &places.positions);
            for (draft, bounds) in made.outputs.into_iter().zip(bounds) {
                next.push((self.push(&draft, bounds, id), draft));
            }
        }
        next
    }

    /// The group that a cluster is an output of.
    fn producer(&self, cluster: u32) -> Option<&Group> {
        self.groups.get(self.clusters[cluster as usize].output_of as usize)
    }

    fn add_group(&mut self, inputs: &[u32], made: &SimplifiedGroup, positions: &[Vec3]) -> u32 {
        let id = self.groups.len() as u32;
        let below: Vec<Group> = inputs.iter().filter_map(|c| self.producer(*c)).copied().collect();
        let most = |first: f32, of: fn(&Group) -> f32| below.iter().map(of).fold(first, f32::max);
        // The original is within the error of the inputs around them.
        let out = most(0.0, |g| g.error_mm);
        let fine = inputs.iter().flat_map(|c| self.vertex_ids(*c)).map(|v| (v, out));
        let coarse = made.outputs.iter().flat_map(|d| &d.vertices).map(|v| (v, 0.0));
        let sphere = bounding_sphere(fine.chain(coarse).map(|(v, r)| (positions[*v as usize], r)));
        let all = below.iter().map(|g| g.subtree_sphere).chain([sphere]);
        self.groups.push(Group {
            first_input: self.members.len() as u32,
            inputs: inputs.len() as u32,
            first_output: self.clusters.len() as u32,
            outputs: made.outputs.len() as u32,
            sphere,
            subtree_sphere: bounding_sphere(all.map(|s| (s.centre, s.radius))),
            error_mm: most(round_up(made.error), |g| g.error_mm),
            angle_rad: round_up(made.angle),
            subtree_angle_rad: most(round_up(made.angle), |g| g.subtree_angle_rad),
            subtree_turn_mm: most(round_up(made.angle * f64::from(made.edge)), |g| {
                g.subtree_turn_mm
            }),
            edge_mm: most(made.edge, |g| g.edge_mm),
        });
        self.members.extend_from_slice(inputs);
        inputs.iter().for_each(|c| self.clusters[*c as usize].input_of = id);
        id
    }
}

/// Bounding sphere and box of a cluster and cone of its normals.
struct ClusterBounds {
    sphere: Sphere,
    half: Vec3,
    cone: Cone,
}

impl ClusterBounds {
    fn of(draft: &ClusterBuilder, positions: &[Vec3]) -> Self {
        let at = |v: u32| positions[v as usize];
        let cones: Vec<Cone> = draft.faces().map(|f| Item::triangle(f.map(at)).cone).collect();
        let sphere = bounding_sphere(draft.vertices.iter().map(|v| (at(*v), 0.0)));
        // The centre may be off the middle by rounding.
        let away = |v: &u32| (at(*v) - sphere.centre).abs();
        let half = draft.vertices.iter().map(away).fold(Vec3::ZERO, Vec3::max) * (1.0 + 1e-6);
        Self { sphere, half, cone: bounding_cone(cones.into_iter()) }
    }
}

fn check(mesh: &Mesh, vertices: &[Vertex]) -> Result<(), ClusterError> {
    let wanted = mesh.positions.len();
    if vertices.len() != wanted {
        return Err(ClusterError::Vertices { found: vertices.len(), wanted });
    }
    for (what, count) in [("faces", mesh.faces.len()), ("vertices", wanted)] {
        if count > MAX_FACES {
            return Err(ClusterError::TooMany { what, count, limit: MAX_FACES });
        }
    }
    for (face, f) in mesh.faces.iter().enumerate() {
        if let Some(&vertex) = f.iter().find(|v| **v as usize >= wanted) {
            return Err(ClusterError::Face { face, vertex, vertices: wanted });
        }
    }
    // Larger coordinates would overflow sums of squares.
    let placed = |p: &Vec3| p.is_finite() && p.abs().max_element() < 1e9;
    match mesh.positions.iter().position(|p| !placed(p)) {
        Some(vertex) => Err(ClusterError::Place { vertex }),
        None => Ok(()),
    }
}

/// Bounding sphere of spheres, about the centre of their box.
fn bounding_sphere(of: impl Iterator<Item = (Vec3, f32)> + Clone) -> Sphere {
    let (lo, hi) = of
        .clone()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, (c, r)| (b.0.min(c - r), b.1.max(c + r)));
    let centre = 0.5 * (lo + hi);
    let away = |(c, r): (Vec3, f32)| centre.as_dvec3().distance(c.as_dvec3()) + f64::from(r);
    Sphere { centre, radius: round_up(of.map(away).fold(0.0, f64::max)) }
}
