//! From a mesh to its clusters, level by level.

use std::collections::VecDeque;

use glam::Vec3;
use rayon::prelude::*;

use super::back::Earlier;
use super::cover::{Target, Worked};
use super::draft::Draft;
use super::fill;
use super::group::{Made, Places, simplify};
use super::measure::Original;
use super::partition::{self, Bordered};
use super::{Cluster, ClusterError, Clusters, Group, NONE};
use crate::geometry::{Mesh, TriangleBvh, Vertex};
use crate::lod::octree::{Item, around};
use crate::lod::{Cone, Sphere};

/// No coarser level is built where so few clusters are left, up to 31,000 triangles. What is coarser
/// is too far off for all but the farthest places of an organ, and a level still takes six tenths of
/// the time of the one before. With 256, building a CT colon of 220,180 faces takes 9 per cent longer
/// for 1 per cent fewer triangles in 100 views from within, a colon of 1 M faces 6 per cent longer for
/// none fewer, a trachea of 96 k 34 per cent longer for 14 per cent fewer; with 1,024 the first is
/// built in 83 per cent of the time and has 11 per cent more.
const COARSEST: usize = 512;
/// Faces: ids are 32 bits, and four half-edge ids a face must fit.
const FACES_MAX: usize = (1 << 30) - 1;

impl Clusters {
    /// Builds all levels. `vertices`: one for each of the mesh's, as drawn
    /// ([`crate::surface::shading`]). Any soup of triangles will do; the fewer of its edges have
    /// two faces, the less can be simplified. The same at any number of threads.
    ///
    /// # Errors
    /// [`ClusterError`]: a face or position that makes no sense, or too many.
    pub fn build(mesh: &Mesh, vertices: &[Vertex]) -> Result<Self, ClusterError> {
        Self::build_with(mesh, vertices, COARSEST, true)
    }

    /// * `coarsest`: no coarser levels are built once so few clusters are left.
    /// * `lock`: false only to show what becomes of a surface whose rims are not locked.
    pub(super) fn build_with(
        mesh: &Mesh,
        vertices: &[Vertex],
        coarsest: usize,
        lock: bool,
    ) -> Result<Self, ClusterError> {
        Self::build_seen(mesh, vertices, coarsest, lock, |_, _| ())
    }

    /// `see` is shown what is live after each level, and where all vertices are.
    pub(super) fn build_seen(
        mesh: &Mesh,
        vertices: &[Vertex],
        coarsest: usize,
        lock: bool,
        mut see: impl FnMut(&[(u32, Draft)], &Places),
    ) -> Result<Self, ClusterError> {
        check(mesh, vertices)?;
        let normals: Vec<Vec3> = vertices.iter().map(Vertex::normal).collect();
        // Cutting up and evening out is in part done by one thread alone.
        let ((beside, finest), (tree, key)) = rayon::join(
            || {
                let beside = partition::beside(&mesh.faces, vertices.len());
                let finest = fill::finest(mesh, &beside);
                (beside, finest)
            },
            || rayon::join(|| TriangleBvh::new(mesh), || super::bytes::key(mesh, vertices)),
        );
        let mut face_at = vec![0; vertices.len()];
        for (f, i) in mesh.faces.iter().zip(0..) {
            f.iter().for_each(|v| face_at[*v as usize] = i);
        }
        let target = Target {
            positions: &mesh.positions,
            normals: &normals,
            faces: &mesh.faces,
            beside: &beside,
            tree: &tree,
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
            key,
        };
        let bounds: Vec<Bounds> =
            finest.par_iter().map(|d| Bounds::of(d, &mesh.positions)).collect();
        let mut live: Vec<(u32, Draft)> = Vec::with_capacity(finest.len());
        for (draft, bounds) in finest.into_iter().zip(bounds) {
            live.push((this.push(&draft, bounds, NONE), draft));
        }
        while live.len() > coarsest {
            let before = this.groups.len();
            let known = places.positions.len();
            let made = !this.groups.is_empty();
            let (new, parted) = rayon::join(
                || made.then(|| Earlier::new(live.iter().map(|l| &l.1), known)),
                || this.parted(&live, lock),
            );
            earlier.extend(new);
            // The first, or the one three levels below: what is nearer errs too much itself.
            if earlier.len() > 3 {
                earlier.pop_front();
            }
            let ask = if earlier.len() > 1 { earlier.front() } else { None };
            live = this.level(live, parted, &original, &mut places, ask);
            see(&live, &places);
            if this.groups.len() == before {
                break;
            }
        }
        Ok(this)
    }

    /// Adds a cluster; its id.
    fn push(&mut self, draft: &Draft, bounds: Bounds, made_by: u32) -> u32 {
        let most = self.groups.get(made_by as usize).map_or(0.0, |g| g.error_mm);
        self.clusters.push(Cluster {
            first_vertex: self.vertex_ids.len() as u32,
            vertices: draft.vertices.len() as u32,
            first_triangle: self.triangles.len() as u32,
            triangles: draft.triangles.len() as u32,
            sphere: bounds.sphere,
            cone: bounds.cone,
            error_mm: up(draft.error).min(most),
            made_by,
            used_by: NONE,
        });
        self.vertex_ids.extend_from_slice(&draft.vertices);
        self.triangles.extend_from_slice(&draft.triangles);
        self.clusters.len() as u32 - 1
    }

    /// Groups of the live clusters, and whether each vertex stays.
    fn parted(&self, live: &[(u32, Draft)], lock: bool) -> (Vec<Vec<u32>>, Vec<bool>) {
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
        let known = self.vertices.len();
        let mut group_of = vec![NONE; known];
        let mut locked = vec![false; known];
        for (g, of) in groups.iter().zip(0..) {
            for v in g.iter().flat_map(|c| &live[*c as usize].1.vertices) {
                let first = &mut group_of[*v as usize];
                if *first == NONE {
                    *first = of;
                }
                locked[*v as usize] |= lock && *first != of;
            }
        }
        (groups, locked)
    }

    /// Simplifies each group; what is live then.
    fn level(
        &mut self,
        live: Vec<(u32, Draft)>,
        (groups, locked): (Vec<Vec<u32>>, Vec<bool>),
        original: &Original<'_>,
        places: &mut Places,
        earlier: Option<&Earlier>,
    ) -> Vec<(u32, Draft)> {
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
        self.take_in(live, &groups, made, places)
    }

    /// Adds what became of each group; what is live then.
    fn take_in(
        &mut self,
        live: Vec<(u32, Draft)>,
        groups: &[Vec<u32>],
        mut made: Vec<Option<Made>>,
        places: &mut Places,
    ) -> Vec<(u32, Draft)> {
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
                places.before.push(*before);
            }
        }
        let bounds_of = |m: &Option<Made>| {
            let outputs = m.iter().flat_map(|m| &m.outputs);
            outputs.map(|d| Bounds::of(d, &places.positions)).collect()
        };
        let bounds: Vec<Vec<Bounds>> = made.par_iter().map(bounds_of).collect();
        let mut next = Vec::new();
        let mut live: Vec<Option<(u32, Draft)>> = live.into_iter().map(Some).collect();
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
            angle_rad: up(made.angle),
            reach_angle_rad: most(up(made.angle), |g| g.reach_angle_rad),
            reach_turn_mm: most(up(made.angle * f64::from(made.edge)), |g| g.reach_turn_mm),
            edge_mm: most(made.edge, |g| g.edge_mm),
        });
        self.members.extend_from_slice(inputs);
        inputs.iter().for_each(|c| self.clusters[*c as usize].used_by = id);
        id
    }
}

/// What holds a cluster, and its normals.
struct Bounds {
    sphere: Sphere,
    cone: Cone,
}

impl Bounds {
    fn of(draft: &Draft, positions: &[Vec3]) -> Self {
        let at = |v: u32| positions[v as usize];
        let cones: Vec<Cone> = draft.faces().map(|f| Item::triangle(f.map(at)).cone).collect();
        let sphere = ball(draft.vertices.iter().map(|v| (at(*v), 0.0)));
        Self { sphere, cone: around(cones.into_iter()) }
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
