//! One group of clusters: halved, cut into clusters anew, and measured.

use glam::{DVec3, Vec3};

use super::back::{Earlier, Fine};
use super::cover::{Target, Worked};
use super::draft::Draft;
use super::fill;
use super::halve::{Halved, halve};
use super::image::image;
use super::measure::{Found, Measure, Original};
use super::partition::{self, NONE};
use crate::geometry::{Mesh, TriangleBvh, Vertex};

/// A group that keeps more than this share of its faces is not worth a level.
const KEPT_MAX: f64 = 0.85;
/// Added to measured distances for the rounding of positions, as a part of the largest coordinate.
const ROUNDING: f64 = 1e-9;
/// Smaller distances are not told apart, as a part of the largest coordinate: some steps between
/// neighbouring f32 numbers. Vertices that move are rounded at each level, so flat walls are off
/// by a little, and to measure that cuts every face of the original.
const RESOLUTION: f64 = 1e-6;

/// Fine faces are laid upon coarse ones over edges within this times the bound that is known when
/// they are; it may still rise.
const LAID: f64 = 1.25;

/// Where all vertices are, first the original's.
pub struct Places {
    /// Of each, LPS mm.
    pub positions: Vec<Vec3>,
    /// Unit normals.
    pub normals: Vec<Vec3>,
    /// An original face at or near each.
    pub face_at: Vec<u32>,
    /// Of those that moved, the vertex each was before; else [`NONE`].
    pub before: Vec<u32>,
}

/// What became of a group.
pub struct Made {
    /// Ids from the number of vertices there were upwards are places in `moved`.
    pub outputs: Vec<Draft>,
    /// Vertices that went to better places, an original face near each, and what it was.
    pub moved: Vec<(Vertex, u32, u32)>,
    /// Bound of the distance both ways, mm.
    pub error: f64,
    /// Root mean square angle between normals, radians.
    pub angle: f64,
    /// Longest edge, mm.
    pub edge: f32,
}

/// The faces of the clusters to be simplified.
struct Before<'a> {
    inputs: &'a [&'a Draft],
    /// Vertices among all, ascending; faces name places here.
    ids: Vec<u32>,
    faces: Vec<[u32; 3]>,
    /// Face across each edge.
    beside: Vec<[u32; 3]>,
    /// Of each vertex.
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
}

impl<'a> Before<'a> {
    fn new(inputs: &'a [&'a Draft], places: &Places) -> Self {
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
        let beside = partition::beside(&faces, ids.len());
        Self { inputs, ids, faces, beside, positions, normals }
    }

    /// With half the faces, and where the origin was put for that.
    fn halved(&self, locked: &[bool]) -> (Halved, DVec3) {
        let middle = self.positions[self.ids.len() / 2].as_dvec3();
        let at = self.positions.iter().map(|p| p.as_dvec3() - middle).collect();
        let fixed: Vec<bool> = self.ids.iter().map(|v| locked[*v as usize]).collect();
        let small = self.faces.iter().map(|f| f.map(|v| v as u16)).collect();
        (halve(at, small, &self.beside, &fixed, self.faces.len() / 2), middle)
    }
}

/// The faces left, by places in [`Before::ids`], cluster after cluster.
struct After {
    mesh: Mesh,
    normals: Vec<Vec3>,
    beside: Vec<[u32; 3]>,
    /// Faces of each cluster.
    sizes: Vec<usize>,
    /// Vertices among all; from the number there were upwards those that moved.
    ids: Vec<u32>,
    moved: Vec<(Vertex, u32, u32)>,
}

impl After {
    /// `None` where there are not fewer clusters than before.
    fn new(
        before: &Before<'_>,
        (halved, middle): (&Halved, DVec3),
        original: &Original<'_>,
        places: &Places,
        vertices: &[Vertex],
    ) -> Option<Self> {
        let faces: Vec<[u32; 3]> = halved.faces.iter().map(|f| f.map(u32::from)).collect();
        let beside = partition::beside(&faces, before.ids.len());
        let centre = |f: u32| {
            let [a, b, c] = faces[f as usize].map(|v| halved.at[v as usize]);
            ((a + b + c) / 3.0).as_vec3()
        };
        let (order, sizes) = fill::clusters_of(&faces, &beside, &centre);
        if sizes.len() >= before.inputs.len() {
            return None;
        }
        let mut place = vec![NONE; faces.len()];
        order.iter().zip(0..).for_each(|(f, i)| place[*f as usize] = i);
        let over = |n: u32| if n == NONE { NONE } else { place[n as usize] };
        let beside = order.iter().map(|f| beside[*f as usize].map(over)).collect();
        // Vertices that moved get ids of their own, and what the original has where they are now.
        let (mut moved, mut ids) = (Vec::new(), before.ids.clone());
        let (mut positions, mut normals) = (before.positions.clone(), before.normals.clone());
        for v in (0..ids.len()).filter(|v| halved.onto[*v] as usize == *v) {
            if halved.at[v] == positions[v].as_dvec3() - middle {
                continue;
            }
            let p = (halved.at[v] + middle).as_vec3();
            let (was, known) = (ids[v], vertices.len() + moved.len());
            let (vertex, face) = original.vertex(p, places.face_at[was as usize], vertices);
            (positions[v], normals[v], ids[v]) = (p, vertex.normal(), known as u32);
            moved.push((vertex, face, was));
        }
        let faces = order.iter().map(|f| faces[*f as usize]).collect();
        let mesh = Mesh { positions, faces, ..Mesh::default() };
        Some(Self { mesh, normals, beside, sizes, ids, moved })
    }

    /// The clusters, standing for nothing yet; and of each face its cluster and place there.
    fn drafts(&self) -> (Vec<Draft>, Vec<(u16, u8)>) {
        let mut owner = Vec::with_capacity(self.mesh.faces.len());
        let mut rest = self.mesh.faces.as_slice();
        let drafts = self.sizes.iter().zip(0..).map(|(n, cluster)| {
            let (own, after) = rest.split_at(*n);
            rest = after;
            owner.extend((0..*n).map(|t| (cluster, t as u8)));
            let own: Vec<[u32; 3]> = own.iter().map(|f| f.map(|v| self.ids[v as usize])).collect();
            fill::draft(&own)
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

/// One of the faces at each vertex.
fn face_at(faces: &[[u32; 3]], vertices: usize) -> Vec<u32> {
    let mut out = vec![0u32; vertices];
    for (f, i) in faces.iter().zip(0..) {
        f.iter().for_each(|v| out[*v as usize] = i);
    }
    out
}

/// Halves the faces of a group, cuts the result into clusters, and measures what that did. `None`
/// where that leads nowhere.
///
/// * `floor`: the largest error of the groups below, mm.
/// * `earlier`: a surface to measure to before the original.
/// * `vertices`: all, as drawn.
pub fn simplify(
    inputs: &[&Draft],
    floor: f64,
    locked: &[bool],
    original: &Original<'_>,
    places: &Places,
    earlier: Option<&Earlier>,
    vertices: &[Vertex],
) -> Option<Made> {
    let before = Before::new(inputs, places);
    let (halved, middle) = before.halved(locked);
    let (count, left) = (before.faces.len(), halved.faces.len());
    if left == 0 || left as f64 > KEPT_MAX * count as f64 {
        return None;
    }
    let after = After::new(&before, (&halved, middle), original, places, vertices)?;
    let (mut outputs, owner) = after.drafts();
    let tree = TriangleBvh::new(&after.mesh);
    let none = Worked::default();
    let target = Target {
        positions: &after.mesh.positions,
        normals: &after.normals,
        faces: &after.mesh.faces,
        beside: &after.beside,
        tree: &tree,
        worked: &none,
    };
    let worked = Worked::new(&target);
    let measure = Measure { target: Target { worked: &worked, ..target }, original, owner: &owner };
    // Where to begin looking for what was at a vertex.
    let coarse_at = face_at(&after.mesh.faces, before.ids.len());
    let coarse_at: Vec<u32> = halved.onto.iter().map(|v| coarse_at[usize::from(*v)]).collect();
    let mut rest = before.faces.as_slice();
    let start = inputs.iter().map(|d| {
        let (own, after) = rest.split_at(d.triangles.len());
        rest = after;
        own.iter().map(|f| coarse_at[f[0] as usize]).collect()
    });
    let start: Vec<Vec<u32>> = start.collect();
    // Nothing below the resolution of the coordinates is told apart.
    let far = f64::from(after.mesh.positions[0].abs().max_element());
    let bound = measure.least(inputs, &start, count, floor.max(RESOLUTION * far));
    let target = Target {
        positions: &before.positions,
        normals: &before.normals,
        faces: &before.faces,
        beside: &before.beside,
        tree: &tree,
        worked: &none,
    };
    let fine = Fine {
        target: Target { worked: &Worked::new(&target), ..target },
        known: inputs.iter().flat_map(|d| d.back.iter().copied()).collect(),
        face_at: face_at(&before.faces, before.ids.len()),
        ids: &before.ids,
        places,
        earlier,
        coarse_at,
    };
    let image = image(&measure.target, &fine, LAID * bound);
    let all = inputs.iter().map(|d| d.whole.len()).sum();
    let mut found = Found::new(bound, &mut outputs, all);
    measure.towards(inputs, &start, &image, &mut found);
    let (angle, bound) = (found.angle(), found.bound);
    for d in &mut outputs {
        d.unite(original);
    }
    let (bound, back) = measure.back(bound, &fine, &image);
    for ((cluster, _), b) in owner.iter().zip(back) {
        let own = &mut outputs[usize::from(*cluster)];
        own.back.push(b);
        own.error = own.error.max(f64::from(b));
    }
    outputs.iter_mut().for_each(|d| d.error += ROUNDING * far);
    Some(Made {
        outputs,
        error: bound + ROUNDING * far,
        angle,
        edge: after.longest_edge(),
        moved: after.moved,
    })
}
