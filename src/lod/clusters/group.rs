//! Simplification of one group of clusters: half the faces, new clusters, measured error.

use glam::{DVec3, Vec3};

use super::cluster_builder::ClusterBuilder;
use super::clusterize;
use super::distance_bound::{TargetCache, TargetSurface};
use super::group_error::{ErrorAccumulator, GroupErrorMeasure};
use super::group_simplify::{SimplifiedFaces, simplify_faces};
use super::partition::{self, NO_FACE};
use super::surface_map::map_surface;
use super::surfaces::{FineSurface, IntermediateSurface, OriginalSurface, VertexTable};
use crate::geometry::{Mesh, TriangleBvh, Vertex};

/// A group that keeps more than this share of its faces is left as it is.
const MAX_FACES_KEPT: f64 = 0.85;
/// Margin for the rounding of positions, relative to the largest coordinate.
const ROUNDING: f64 = 1e-9;
/// Resolution of measured distances, relative to the largest coordinate: a few steps between
/// neighbouring f32 numbers. Moved vertices are rounded at each level, so flat walls deviate a
/// little, and measuring that would clip every face of the original.
const RESOLUTION: f64 = 1e-6;

/// The map from fine to coarse faces crosses edges within this times the bound known at that time;
/// the bound may still rise.
const MAP_LIMIT: f64 = 1.25;

/// Result of simplifying a group.
pub struct SimplifiedGroup {
    /// New clusters. Vertex ids from the number of existing vertices upwards are indices into
    /// `moved`.
    pub outputs: Vec<ClusterBuilder>,
    /// Moved vertices: the vertex, an original face near it, and the vertex that it replaces.
    pub moved: Vec<(Vertex, u32, u32)>,
    /// Two-sided distance bound, mm.
    pub error: f64,
    /// Root mean square angle between normals, radians.
    pub angle: f64,
    /// Longest edge, mm.
    pub edge: f32,
}

/// The faces of a group before simplification.
struct FineGroup<'a> {
    inputs: &'a [&'a ClusterBuilder],
    /// Vertex ids, ascending; faces hold indices into this.
    ids: Vec<u32>,
    faces: Vec<[u32; 3]>,
    /// Face across each edge.
    face_neighbors: Vec<[u32; 3]>,
    /// Position of each vertex, LPS mm; `normals`: its unit normal.
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
}

impl<'a> FineGroup<'a> {
    fn new(inputs: &'a [&'a ClusterBuilder], places: &VertexTable) -> Self {
        let mut ids: Vec<u32> = inputs.iter().flat_map(|d| d.vertices.iter().copied()).collect();
        ids.sort_unstable();
        ids.dedup();
        let mut faces: Vec<[u32; 3]> = Vec::new();
        for d in inputs {
            let local = |v: &u32| ids.binary_search(v).unwrap_or(0) as u32;
            let own: Vec<u32> = d.vertices.iter().map(local).collect();
            faces.extend(d.triangles.iter().map(|t| t.map(|v| own[usize::from(v)])));
        }
        let positions = ids.iter().map(|v| places.positions[*v as usize]).collect();
        let normals = ids.iter().map(|v| places.normals[*v as usize]).collect();
        let face_neighbors = partition::face_neighbors(&faces, ids.len());
        Self { inputs, ids, faces, face_neighbors, positions, normals }
    }

    /// Simplifies to half the faces; also returns the origin that was used.
    fn simplified(&self, locked: &[bool]) -> (SimplifiedFaces, DVec3) {
        let middle = self.positions[self.ids.len() / 2].as_dvec3();
        let at = self.positions.iter().map(|p| p.as_dvec3() - middle).collect();
        let fixed: Vec<bool> = self.ids.iter().map(|v| locked[*v as usize]).collect();
        let small = self.faces.iter().map(|f| f.map(|v| v as u16)).collect();
        (simplify_faces(at, small, &self.face_neighbors, &fixed, self.faces.len() / 2), middle)
    }
}

/// The faces of a group after simplification, indices into [`FineGroup::ids`], sorted by cluster.
struct CoarseGroup {
    mesh: Mesh,
    normals: Vec<Vec3>,
    face_neighbors: Vec<[u32; 3]>,
    /// Number of faces of each cluster.
    sizes: Vec<usize>,
    /// Vertex ids; from the number of existing vertices upwards those that moved.
    ids: Vec<u32>,
    moved: Vec<(Vertex, u32, u32)>,
}

impl CoarseGroup {
    /// `None` if there are not fewer clusters than before.
    fn new(
        before: &FineGroup<'_>,
        (simplified, middle): (&SimplifiedFaces, DVec3),
        original: &OriginalSurface<'_>,
        places: &VertexTable,
        vertices: &[Vertex],
    ) -> Option<Self> {
        let faces: Vec<[u32; 3]> = simplified.faces.iter().map(|f| f.map(u32::from)).collect();
        let face_neighbors = partition::face_neighbors(&faces, before.ids.len());
        let centre = |f: u32| {
            let [a, b, c] = faces[f as usize].map(|v| simplified.at[v as usize]);
            ((a + b + c) / 3.0).as_vec3()
        };
        let (order, sizes) = clusterize::clusterize(&faces, &face_neighbors, &centre);
        if sizes.len() >= before.inputs.len() {
            return None;
        }
        let mut place = vec![NO_FACE; faces.len()];
        order.iter().zip(0..).for_each(|(f, i)| place[*f as usize] = i);
        let over = |n: u32| if n == NO_FACE { NO_FACE } else { place[n as usize] };
        let face_neighbors = order.iter().map(|f| face_neighbors[*f as usize].map(over)).collect();
        // Moved vertices get new ids, and normal and curvature tint of the original at their new
        // place.
        let (mut moved, mut ids) = (Vec::new(), before.ids.clone());
        let (mut positions, mut normals) = (before.positions.clone(), before.normals.clone());
        for v in (0..ids.len()).filter(|v| simplified.onto[*v] as usize == *v) {
            if simplified.at[v] == positions[v].as_dvec3() - middle {
                continue;
            }
            let p = (simplified.at[v] + middle).as_vec3();
            let (was, known) = (ids[v], vertices.len() + moved.len());
            let (vertex, face) = original.vertex(p, places.face_at[was as usize], vertices);
            (positions[v], normals[v], ids[v]) = (p, vertex.normal(), known as u32);
            moved.push((vertex, face, was));
        }
        let faces = order.iter().map(|f| faces[*f as usize]).collect();
        let mesh = Mesh { positions, faces, ..Mesh::default() };
        Some(Self { mesh, normals, face_neighbors, sizes, ids, moved })
    }

    /// Returns the clusters, without correspondences yet, and for each face its cluster and its
    /// index in that cluster.
    fn drafts(&self) -> (Vec<ClusterBuilder>, Vec<(u16, u8)>) {
        let mut owner = Vec::with_capacity(self.mesh.faces.len());
        let mut rest = self.mesh.faces.as_slice();
        let drafts = self.sizes.iter().zip(0..).map(|(n, cluster)| {
            let (own, after) = rest.split_at(*n);
            rest = after;
            owner.extend((0..*n).map(|t| (cluster, t as u8)));
            let own: Vec<[u32; 3]> = own.iter().map(|f| f.map(|v| self.ids[v as usize])).collect();
            clusterize::cluster_builder(&own)
        });
        (drafts.collect(), owner)
    }

    fn longest_edge(&self) -> f32 {
        let long = |f: &[u32; 3]| {
            let [a, b, c] = f.map(|v| self.mesh.positions[v as usize]);
            a.distance(b).max(b.distance(c)).max(c.distance(a))
        };
        self.mesh.faces.iter().map(long).fold(0.0, f32::max)
    }
}

/// One incident face of each vertex.
fn face_at(faces: &[[u32; 3]], vertices: usize) -> Vec<u32> {
    let mut out = vec![0u32; vertices];
    for (f, i) in faces.iter().zip(0..) {
        f.iter().for_each(|v| out[*v as usize] = i);
    }
    out
}

/// Simplifies a group to half its faces, splits the result into clusters, and measures the
/// two-sided distance to the original. `None` if that saves too little.
///
/// * `floor`: largest error of the groups below, mm.
/// * `intermediate`: a surface to measure to before the original.
/// * `vertices`: all, as drawn.
pub fn simplify(
    inputs: &[&ClusterBuilder],
    floor: f64,
    locked: &[bool],
    original: &OriginalSurface<'_>,
    places: &VertexTable,
    intermediate: Option<&IntermediateSurface>,
    vertices: &[Vertex],
) -> Option<SimplifiedGroup> {
    let before = FineGroup::new(inputs, places);
    let (simplified, middle) = before.simplified(locked);
    let (count, left) = (before.faces.len(), simplified.faces.len());
    if left == 0 || left as f64 > MAX_FACES_KEPT * count as f64 {
        return None;
    }
    let after = CoarseGroup::new(&before, (&simplified, middle), original, places, vertices)?;
    let (mut outputs, owner) = after.drafts();
    let bvh = TriangleBvh::new(&after.mesh);
    let none = TargetCache::default();
    let target = TargetSurface {
        positions: &after.mesh.positions,
        normals: &after.normals,
        faces: &after.mesh.faces,
        face_neighbors: &after.face_neighbors,
        bvh: &bvh,
        cache: &none,
    };
    let cache = TargetCache::new(&target);
    let measure = GroupErrorMeasure {
        target: TargetSurface { cache: &cache, ..target },
        original,
        owner: &owner,
    };
    // A coarse face near each vertex, to start searches from.
    let coarse_at = face_at(&after.mesh.faces, before.ids.len());
    let coarse_at: Vec<u32> = simplified.onto.iter().map(|v| coarse_at[usize::from(*v)]).collect();
    let mut rest = before.faces.as_slice();
    let start = inputs.iter().map(|d| {
        let (own, after) = rest.split_at(d.triangles.len());
        rest = after;
        own.iter().map(|f| coarse_at[f[0] as usize]).collect()
    });
    let start: Vec<Vec<u32>> = start.collect();
    // Distances below the resolution of the coordinates are not distinguished.
    let far = f64::from(after.mesh.positions[0].abs().max_element());
    let bound = measure.lower_bound(inputs, &start, count, floor + RESOLUTION * far);
    let target = TargetSurface {
        positions: &before.positions,
        normals: &before.normals,
        faces: &before.faces,
        face_neighbors: &before.face_neighbors,
        bvh: &bvh,
        cache: &none,
    };
    let fine = FineSurface {
        target: TargetSurface { cache: &TargetCache::new(&target), ..target },
        to_original_mm: inputs.iter().flat_map(|d| d.to_original_mm.iter().copied()).collect(),
        face_at: face_at(&before.faces, before.ids.len()),
        ids: &before.ids,
        places,
        intermediate,
        coarse_at,
    };
    let map = map_surface(&measure.target, &fine, MAP_LIMIT * bound);
    let all = inputs.iter().map(|d| d.whole_faces.len()).sum();
    let mut found = ErrorAccumulator::new(bound, &mut outputs, all);
    measure.measure_forward(inputs, &start, &map, &mut found);
    let (angle, bound) = (found.angle(), found.bound);
    for d in &mut outputs {
        d.merge_parts(|face| original.corners(face));
    }
    let (bound, back) = measure.measure_backward(bound, &fine, &map);
    for ((cluster, _), b) in owner.iter().zip(back) {
        let own = &mut outputs[usize::from(*cluster)];
        own.to_original_mm.push(b);
        own.error = own.error.max(f64::from(b));
    }
    outputs.iter_mut().for_each(|d| d.error += ROUNDING * far);
    Some(SimplifiedGroup {
        outputs,
        error: bound + ROUNDING * far,
        angle,
        edge: after.longest_edge(),
        moved: after.moved,
    })
}
