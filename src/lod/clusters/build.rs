//! From a mesh to its clusters, level by level.

use std::collections::VecDeque;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::back::{Earlier, Fine};
use super::cover::{Target, Worked};
use super::halve::halve;
use super::measure::{Draft, Measure, Original, Parts};
use super::partition::{self, Bordered};
use super::{Cluster, ClusterError, Clusters, Group, NONE};
use crate::geometry::{Mesh, Vertex};
use crate::lod::octree::{Item, around};
use crate::lod::{PAGE_TRIANGLES, PAGE_VERTICES, Sphere};
use crate::mesh::Nearest;

/// A group that keeps more than this share of its faces is not worth a level.
const KEPT_MAX: f64 = 0.85;
/// Faces of a cluster as first cut. About half a page: smaller clusters need finer levels where
/// they are near only, and less of them is drawn beyond the edge of the picture.
const FILL: usize = 60;
/// Faces of a cluster once its rim is evened out.
const MOST: usize = 64;
const _: () = assert!(MOST <= PAGE_TRIANGLES);
/// Faces: ids are 32 bits, and four half-edge ids a face must fit.
const FACES_MAX: usize = (1 << 30) - 1;
/// Added to measured distances for the rounding of positions, as a part of the largest coordinate.
const ROUNDING: f64 = 1e-9;
/// Half the distance between neighbouring f32 numbers, as a part of them.
const RESOLUTION: f64 = 6e-8;

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
struct Made {
    /// Ids from the number of vertices there were upwards are places in `moved`.
    outputs: Vec<Draft>,
    /// Vertices that went to better places, an original face near each, and what it was.
    moved: Vec<(Vertex, u32, u32)>,
    error: f64,
    angle: f64,
    edge: f32,
}

impl Clusters {
    /// Builds all levels. `vertices`: one for each of the mesh's, as drawn
    /// ([`crate::surface::shading`]). Any soup of triangles will do; the fewer of its edges have
    /// two faces, the less can be simplified. The same at any number of threads.
    ///
    /// # Errors
    /// [`ClusterError`]: a face or position that makes no sense, or too many.
    pub fn build(mesh: &Mesh, vertices: &[Vertex]) -> Result<Self, ClusterError> {
        Self::build_with(mesh, vertices, true)
    }

    /// `lock`: false only to show what becomes of a surface whose rims are not locked.
    pub(super) fn build_with(
        mesh: &Mesh,
        vertices: &[Vertex],
        lock: bool,
    ) -> Result<Self, ClusterError> {
        check(mesh, vertices)?;
        let normals: Vec<Vec3> = vertices.iter().map(Vertex::normal).collect();
        let beside = partition::beside(&mesh.faces, vertices.len());
        let mut face_at = vec![0; vertices.len()];
        for (f, i) in mesh.faces.iter().zip(0..) {
            f.iter().for_each(|v| face_at[*v as usize] = i);
        }
        let target = Target {
            positions: &mesh.positions,
            normals: &normals,
            faces: &mesh.faces,
            beside: &beside,
            tree: &Nearest::new(mesh),
            worked: &Worked::default(),
        };
        let original = Original { target };
        let mut places = Places {
            positions: mesh.positions.clone(),
            normals: normals.clone(),
            face_at,
            before: vec![NONE; vertices.len()],
        };
        let mut earlier = VecDeque::new();
        let mut this = Self {
            vertices: vertices.to_vec(),
            own_vertices: vertices.len(),
            clusters: Vec::new(),
            groups: Vec::new(),
            members: Vec::new(),
            vertex_ids: Vec::new(),
            triangles: Vec::new(),
            key: super::bytes::key(mesh, vertices),
        };
        let mut live: Vec<(u32, Draft)> = Vec::new();
        for draft in finest(mesh, &beside) {
            live.push((this.push(&draft, &mesh.positions, NONE), draft));
        }
        while live.len() > 1 {
            let before = this.groups.len();
            let known = places.positions.len();
            if !this.groups.is_empty() {
                earlier.push_back(Earlier::new(live.iter().map(|l| &l.1), known));
            }
            let ask = if earlier.len() > 2 { earlier.pop_front() } else { None };
            live = this.level(live, &original, &mut places, ask.as_ref(), lock);
            if this.groups.len() == before {
                break;
            }
        }
        Ok(this)
    }

    /// Adds a cluster; its id.
    fn push(&mut self, draft: &Draft, positions: &[Vec3], made_by: u32) -> u32 {
        let at = |v: u32| positions[v as usize];
        let items = draft.faces().map(|f| Item::triangle(f.map(at)).cone);
        let cones: Vec<_> = items.collect();
        self.clusters.push(Cluster {
            first_vertex: self.vertex_ids.len() as u32,
            vertices: draft.vertices.len() as u32,
            first_triangle: self.triangles.len() as u32,
            triangles: draft.triangles.len() as u32,
            sphere: ball(draft.vertices.iter().map(|v| (at(*v), 0.0))),
            cone: around(cones.into_iter()),
            made_by,
            used_by: NONE,
        });
        self.vertex_ids.extend_from_slice(&draft.vertices);
        self.triangles.extend_from_slice(&draft.triangles);
        self.clusters.len() as u32 - 1
    }

    /// Groups the live clusters and simplifies each group; what is live then.
    fn level(
        &mut self,
        live: Vec<(u32, Draft)>,
        original: &Original<'_>,
        places: &mut Places,
        earlier: Option<&Earlier>,
        lock: bool,
    ) -> Vec<(u32, Draft)> {
        let bordered: Vec<Bordered> = live
            .par_iter()
            .map(|(id, d)| Bordered {
                border: partition::border(d.faces()),
                centre: self.clusters[*id as usize].sphere.centre,
            })
            .collect();
        let groups = partition::group(&bordered);
        drop(bordered);
        // A vertex in two groups stays.
        let known = self.vertices.len() as u32;
        let mut group_of = vec![NONE; known as usize];
        let mut locked = vec![false; known as usize];
        for (g, of) in groups.iter().zip(0..) {
            for v in g.iter().flat_map(|c| &live[*c as usize].1.vertices) {
                let first = &mut group_of[*v as usize];
                if *first == NONE {
                    *first = of;
                }
                locked[*v as usize] |= lock && *first != of;
            }
        }
        drop(group_of);
        let made: Vec<Option<Made>> = groups
            .par_iter()
            .map(|g| {
                let floor = g.iter().map(|c| self.below(live[*c as usize].0));
                let floor = floor.map(|g| g.map_or(0.0, |g| f64::from(g.error_mm)));
                let drafts: Vec<&Draft> = g.iter().map(|c| &live[*c as usize].1).collect();
                let floor = floor.fold(0.0, f64::max);
                simplify(&drafts, floor, &locked, original, places, earlier, &self.vertices)
            })
            .collect();
        let mut next = Vec::new();
        let mut live: Vec<Option<(u32, Draft)>> = live.into_iter().map(Some).collect();
        for (members, made) in groups.iter().zip(made) {
            let taken = members.iter().filter_map(|c| live[*c as usize].take());
            let Some(mut made) = made else {
                next.extend(taken);
                continue;
            };
            let shift = self.vertices.len() as u32 - known;
            let ids = made.outputs.iter_mut().flat_map(|d| &mut d.vertices);
            ids.filter(|v| **v >= known).for_each(|v| *v += shift);
            for (vertex, face, before) in &made.moved {
                self.vertices.push(*vertex);
                places.positions.push(vertex.position());
                places.normals.push(vertex.normal());
                places.face_at.push(*face);
                places.before.push(*before);
            }
            let inputs: Vec<u32> = taken.map(|l| l.0).collect();
            let id = self.add_group(&inputs, &made, &places.positions);
            for draft in made.outputs {
                next.push((self.push(&draft, &places.positions, id), draft));
            }
        }
        next
    }

    /// The group that made a cluster.
    fn below(&self, cluster: u32) -> Option<&Group> {
        self.groups.get(self.clusters[cluster as usize].made_by as usize)
    }

    fn add_group(&mut self, inputs: &[u32], made: &Made, positions: &[Vec3]) -> u32 {
        let id = self.groups.len() as u32;
        let below: Vec<Group> = inputs.iter().filter_map(|c| self.below(*c)).copied().collect();
        let most = |first: f32, of: fn(&Group) -> f32| below.iter().map(of).fold(first, f32::max);
        // The original lies within the error of the inputs around them.
        let out = most(0.0, |g| g.error_mm);
        let fine = inputs.iter().flat_map(|c| self.vertex_ids(*c)).map(|v| (v, out));
        let coarse = made.outputs.iter().flat_map(|d| &d.vertices).map(|v| (v, 0.0));
        let sphere = ball(fine.chain(coarse).map(|(v, r)| (positions[*v as usize], r)));
        let all = below.iter().map(|g| g.reach).chain([sphere]);
        self.groups.push(Group {
            first_input: self.members.len() as u32,
            inputs: inputs.len() as u32,
            first_output: self.clusters.len() as u32,
            outputs: made.outputs.len() as u32,
            sphere,
            reach: ball(all.map(|s| (s.centre, s.radius))),
            error_mm: most(up(made.error), |g| g.error_mm),
            angle_rad: most(up(made.angle), |g| g.angle_rad),
            edge_mm: most(made.edge, |g| g.edge_mm),
        });
        self.members.extend_from_slice(inputs);
        inputs.iter().for_each(|c| self.clusters[*c as usize].used_by = id);
        id
    }
}

fn check(mesh: &Mesh, vertices: &[Vertex]) -> Result<(), ClusterError> {
    let wanted = mesh.positions.len();
    if vertices.len() != wanted {
        return Err(ClusterError::Vertices { found: vertices.len(), wanted });
    }
    for (what, count) in [("faces", mesh.faces.len()), ("vertices", wanted)] {
        if count > FACES_MAX {
            return Err(ClusterError::TooMany { what, count, limit: FACES_MAX });
        }
    }
    for (face, f) in mesh.faces.iter().enumerate() {
        if let Some(&vertex) = f.iter().find(|v| **v as usize >= wanted) {
            return Err(ClusterError::Face { face, vertex, vertices: wanted });
        }
    }
    // Sums of squares of smaller numbers are numbers.
    let placed = |p: &Vec3| p.is_finite() && p.abs().max_element() < 1e9;
    match mesh.positions.iter().position(|p| !placed(p)) {
        Some(vertex) => Err(ClusterError::Place { vertex }),
        None => Ok(()),
    }
}

/// The next f32 that is not smaller.
pub fn up(v: f64) -> f32 {
    let f = v as f32;
    if f64::from(f) < v { f.next_up() } else { f }
}

/// A ball that holds balls, about the middle of their box.
fn ball(of: impl Iterator<Item = (Vec3, f32)> + Clone) -> Sphere {
    let (lo, hi) = of
        .clone()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, (c, r)| (b.0.min(c - r), b.1.max(c + r)));
    let centre = 0.5 * (lo + hi);
    let away = |(c, r): (Vec3, f32)| centre.as_dvec3().distance(c.as_dvec3()) + f64::from(r);
    Sphere { centre, radius: up(of.map(away).fold(0.0, f64::max)) }
}

/// Clusters of the original's own faces.
fn finest(mesh: &Mesh, beside: &[[u32; 3]]) -> Vec<Draft> {
    let centre = |f: u32| {
        let [a, b, c] = mesh.faces[f as usize].map(|v| mesh.positions[v as usize]);
        (a + b + c) / 3.0
    };
    let (mut ids, parts) = clusters_of(&mesh.faces, beside, &centre);
    let mut rest = ids.as_mut_slice();
    let mut own = Vec::with_capacity(parts.len());
    for n in parts {
        let (a, b) = std::mem::take(&mut rest).split_at_mut(n);
        own.push(a);
        rest = b;
    }
    own.into_par_iter()
        .map(|ids| {
            ids.sort_unstable();
            let faces: Vec<[u32; 3]> = ids.iter().map(|f| mesh.faces[*f as usize]).collect();
            let whole = ids.iter().copied().zip(0..=u8::MAX).collect();
            Draft { whole, back: vec![0.0; faces.len()], ..draft(&faces) }
        })
        .collect()
}

/// A cluster of at most [`PAGE_TRIANGLES`] faces, which stands for nothing yet.
fn draft(faces: &[[u32; 3]]) -> Draft {
    let vertices = vertices_of(faces.iter().copied());
    let place = |v: u32| vertices.binary_search(&v).unwrap_or(0) as u8;
    let triangles = faces.iter().map(|f| f.map(place)).collect();
    Draft { triangles, vertices, whole: Vec::new(), parts: Parts::default(), back: Vec::new() }
}

/// Each vertex once, ascending.
fn vertices_of(faces: impl Iterator<Item = [u32; 3]>) -> Vec<u32> {
    let mut all: Vec<u32> = faces.flatten().collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Sorts faces into clusters that fit a page: their ids cluster after cluster, ascending in each,
/// and how many each takes.
fn clusters_of(
    faces: &[[u32; 3]],
    beside: &[[u32; 3]],
    centre: &(impl Fn(u32) -> Vec3 + Sync),
) -> (Vec<u32>, Vec<usize>) {
    let mut order: Vec<u32> = (0..faces.len() as u32).collect();
    let mut sizes = partition::split(&mut order, FILL, centre);
    let mut part = vec![0u32; faces.len()];
    let mut first = 0;
    for (n, id) in sizes.iter().zip(0..) {
        order[first..first + n].iter().for_each(|f| part[*f as usize] = id);
        first += n;
    }
    partition::smooth(&mut part, &mut sizes, MOST, beside);
    let mut fill = vec![0; sizes.len()];
    for i in 1..sizes.len() {
        fill[i] = fill[i - 1] + sizes[i - 1];
    }
    for (f, p) in (0..).zip(&part) {
        order[fill[*p as usize]] = f;
        fill[*p as usize] += 1;
    }
    let mut fit = Vec::with_capacity(sizes.len());
    let mut first = 0;
    for n in sizes.into_iter().filter(|n| *n > 0) {
        let own = &mut order[first..first + n];
        // Loose triangles have more vertices than faces.
        if vertices_of(own.iter().map(|f| faces[*f as usize])).len() > PAGE_VERTICES {
            fit.extend(partition::split(own, PAGE_VERTICES / 3, centre));
        } else {
            fit.push(n);
        }
        first += n;
    }
    (order, fit)
}

/// Halves the faces of a group, measures what that did, and cuts the result into clusters. `None`
/// where that leads nowhere.
fn simplify(
    inputs: &[&Draft],
    floor: f64,
    locked: &[bool],
    original: &Original<'_>,
    places: &Places,
    earlier: Option<&Earlier>,
    vertices: &[Vertex],
) -> Option<Made> {
    let mut own: Vec<u32> = inputs.iter().flat_map(|d| d.vertices.iter().copied()).collect();
    own.sort_unstable();
    own.dedup();
    let local = |v: u32| own.binary_search(&v).unwrap_or(0) as u32;
    let mut fine: Vec<[u32; 3]> = Vec::new();
    for d in inputs {
        let ids: Vec<u32> = d.vertices.iter().map(|v| local(*v)).collect();
        fine.extend(d.triangles.iter().map(|t| t.map(|v| ids[usize::from(v)])));
    }
    let before = fine.len();
    let fine_positions: Vec<Vec3> = own.iter().map(|v| places.positions[*v as usize]).collect();
    let fine_normals: Vec<Vec3> = own.iter().map(|v| vertices[*v as usize].normal()).collect();
    let middle = fine_positions[own.len() / 2].as_dvec3();
    let at: Vec<DVec3> = fine_positions.iter().map(|p| p.as_dvec3() - middle).collect();
    let fixed: Vec<bool> = own.iter().map(|v| locked[*v as usize]).collect();
    let small = fine.iter().map(|f| f.map(|v| v as u16)).collect();
    let halved = halve(at.clone(), small, &fixed, before / 2);
    let left = halved.faces.len();
    if left == 0 || left as f64 > KEPT_MAX * before as f64 {
        return None;
    }
    // Vertices that moved get ids of their own, and what the original has where they are now.
    let (mut moved, mut ids) = (Vec::new(), own.clone());
    let (mut positions, mut normals) = (fine_positions.clone(), fine_normals.clone());
    for v in (0..own.len()).filter(|v| halved.onto[*v] as usize == *v && halved.at[*v] != at[*v]) {
        let p = (halved.at[v] + middle).as_vec3();
        let (vertex, face) = original.vertex(p, places.face_at[own[v] as usize], vertices);
        (positions[v], normals[v]) = (p, vertex.normal());
        ids[v] = (vertices.len() + moved.len()) as u32;
        moved.push((vertex, face, own[v]));
    }
    // Coarse faces, cluster after cluster.
    let faces: Vec<[u32; 3]> = halved.faces.iter().map(|f| f.map(u32::from)).collect();
    let beside = partition::beside(&faces, own.len());
    let centre = |f: u32| {
        let [a, b, c] = faces[f as usize].map(|v| halved.at[v as usize]);
        ((a + b + c) / 3.0).as_vec3()
    };
    let (order, sizes) = clusters_of(&faces, &beside, &centre);
    if sizes.len() >= inputs.len() {
        return None;
    }
    let coarse: Vec<[u32; 3]> = order.iter().map(|f| faces[*f as usize]).collect();
    let mut place = vec![NONE; left];
    order.iter().zip(0..).for_each(|(f, i)| place[*f as usize] = i);
    let over = |n: u32| if n == NONE { NONE } else { place[n as usize] };
    let beside: Vec<[u32; 3]> = order.iter().map(|f| beside[*f as usize].map(over)).collect();
    let coarse_mesh = Mesh { positions, faces: coarse, ..Mesh::default() };
    let (positions, coarse) = (&coarse_mesh.positions, &coarse_mesh.faces);
    let tree = Nearest::new(&coarse_mesh);
    let none = &Worked::default();
    let normals = &normals;
    let target =
        Target { positions, normals, faces: coarse, beside: &beside, tree: &tree, worked: none };
    let target = Target { worked: &Worked::new(&target), ..target };
    let mut outputs = Vec::with_capacity(sizes.len());
    let mut owner: Vec<(u16, u8)> = Vec::with_capacity(left);
    for (n, cluster) in sizes.into_iter().zip(0..) {
        let own = &coarse[owner.len()..owner.len() + n];
        let own: Vec<[u32; 3]> = own.iter().map(|f| f.map(|v| ids[v as usize])).collect();
        outputs.push(draft(&own));
        owner.extend((0..n).map(|t| (cluster, t as u8)));
    }
    // Where to begin looking for what a fine triangle stood for.
    let mut some_face = vec![0u32; own.len()];
    for (f, i) in coarse.iter().zip(0..) {
        f.iter().for_each(|v| some_face[*v as usize] = i);
    }
    let stands = |v: u32| some_face[usize::from(halved.onto[v as usize])];
    let mut start: Vec<Vec<u32>> = Vec::with_capacity(inputs.len());
    let mut rest = fine.as_slice();
    for d in inputs {
        let (a, b) = rest.split_at(d.triangles.len());
        start.push(a.iter().map(|f| stands(f[0])).collect());
        rest = b;
    }
    // Nothing below the resolution of the coordinates is told apart.
    let far = positions[0].abs().max_element();
    let least = floor.max(RESOLUTION * f64::from(far));
    let measure = Measure { target, original, owner: &owner };
    let mut bound = measure.least(inputs, &start, before, least);
    let (mut turn, mut area) = (0.0, 0.0);
    for (d, start) in inputs.iter().zip(&start) {
        for found in measure.towards(d, start, bound) {
            bound = bound.max(found.bound);
            turn += found.turn;
            area += found.area;
            found.share(&mut outputs);
        }
    }
    outputs.iter_mut().for_each(|d| d.unite(original));
    let fine_beside = partition::beside(&fine, own.len());
    let mut fine_at = vec![0u32; own.len()];
    for (f, i) in fine.iter().zip(0..) {
        f.iter().for_each(|v| fine_at[*v as usize] = i);
    }
    let fine_target = Target {
        positions: &fine_positions,
        normals: &fine_normals,
        faces: &fine,
        beside: &fine_beside,
        tree: &tree,
        worked: none,
    };
    let fine = Fine {
        target: Target { worked: &Worked::new(&fine_target), ..fine_target },
        known: inputs.iter().flat_map(|d| d.back.iter().copied()).collect(),
        face_at: fine_at,
        ids: &own,
        places,
        earlier,
        coarse_at: (0..own.len()).map(|v| stands(v as u32)).collect(),
    };
    let (bound, back) = measure.back(bound, &fine);
    for ((cluster, _), b) in owner.iter().zip(back) {
        outputs[usize::from(*cluster)].back.push(b);
    }
    let long = |f: &[u32; 3]| {
        let [a, b, c] = f.map(|v| positions[v as usize]);
        a.distance(b).max(b.distance(c)).max(c.distance(a))
    };
    Some(Made {
        outputs,
        moved,
        error: bound + ROUNDING * f64::from(far),
        angle: if area > 0.0 { (turn / area).sqrt() } else { 0.0 },
        edge: coarse.iter().map(long).fold(0.0, f32::max),
    })
}
