//! Serialization of clusters, so that a known mesh need not be clustered again.
//!
//! Little-endian: magic, version, hash of the mesh, six counts, then clusters, groups, members,
//! vertex ids, vertices that are not the mesh's (32-bit words each), triangles (three bytes each),
//! and a BLAKE3 hash of all that.

use glam::Vec3;

use super::{Cluster, ClusterError, Clusters, Group, NO_GROUP};
use crate::geometry::{Cone, Mesh, Sphere, Vertex};
use crate::lod::{PAGE_TRIANGLES, PAGE_VERTICES};

const MAGIC: &[u8; 8] = b"intimaCL";
/// Raised whenever the same mesh gives other clusters or other bytes.
const VERSION: u32 = 11;
const HEADER: usize = 8 + 4 + 32 + 6 * 8;
const HASH: usize = 32;
const CLUSTER_WORDS: usize = 18;
const GROUP_WORDS: usize = 17;
const VERTEX_WORDS: usize = size_of::<Vertex>() / 4;

/// Hash of everything that the clusters depend on.
pub fn key(mesh: &Mesh, vertices: &[Vertex]) -> [u8; 32] {
    let mut hash = blake3::Hasher::new();
    hash.update(&(vertices.len() as u64).to_le_bytes());
    hash.update(bytemuck::cast_slice(vertices));
    hash.update(bytemuck::cast_slice(&mesh.positions));
    hash.update(bytemuck::cast_slice(&mesh.faces));
    *hash.finalize().as_bytes()
}

impl Clusters {
    /// Serializes everything but the vertices of the mesh.
    pub fn to_bytes(&self) -> Vec<u8> {
        let moved = &self.vertices[self.original_vertices..];
        let counts = [
            self.clusters.len(),
            self.groups.len(),
            self.members.len(),
            self.vertex_ids.len(),
            moved.len(),
            self.triangles.len(),
        ];
        let mut out = Vec::with_capacity(length(counts.map(|c| c as u64)) as usize);
        out.extend_from_slice(MAGIC);
        out.extend_from_slice(&VERSION.to_le_bytes());
        out.extend_from_slice(&self.key);
        counts.iter().for_each(|c| out.extend_from_slice(&(*c as u64).to_le_bytes()));
        let clusters = self.clusters.iter().flat_map(cluster_words);
        let groups = self.groups.iter().flat_map(group_words);
        let ids = self.members.iter().chain(&self.vertex_ids).copied();
        let moved = moved.iter().flat_map(|v| bytemuck::cast::<Vertex, [u32; VERTEX_WORDS]>(*v));
        let words = clusters.chain(groups).chain(ids).chain(moved);
        words.for_each(|w| out.extend_from_slice(&w.to_le_bytes()));
        self.triangles.iter().for_each(|t| out.extend_from_slice(t));
        let hash = blake3::hash(&out);
        out.extend_from_slice(hash.as_bytes());
        out
    }

    /// Clusters of `mesh` as [`Self::to_bytes`] gave them; `vertices` as for [`Self::build`].
    /// Takes no more memory than there are bytes.
    ///
    /// # Errors
    /// [`ClusterError`]: another version or mesh, damaged bytes, or content that contradicts
    /// itself.
    pub fn from_bytes(
        bytes: &[u8],
        mesh: &Mesh,
        vertices: &[Vertex],
    ) -> Result<Self, ClusterError> {
        let found = bytes.len();
        if found < HEADER + HASH {
            return Err(ClusterError::Length { found, wanted: (HEADER + HASH) as u64 });
        }
        if &bytes[..8] != MAGIC || bytes[8..12] != VERSION.to_le_bytes() {
            return Err(ClusterError::Kind);
        }
        let mut key_read = [0; 32];
        key_read.copy_from_slice(&bytes[12..44]);
        if key_read != key(mesh, vertices) {
            return Err(ClusterError::OtherMesh);
        }
        let mut counts = [0u64; 6];
        for (c, b) in counts.iter_mut().zip(bytes[44..HEADER].chunks_exact(8)) {
            *c = b.iter().rev().fold(0, |n, b| n << 8 | u64::from(*b));
        }
        let wanted = length(counts);
        if wanted != found as u64 {
            return Err(ClusterError::Length { found, wanted });
        }
        let (content, hash) = bytes.split_at(found - HASH);
        if blake3::hash(content).as_bytes() != hash {
            return Err(ClusterError::Checksum);
        }
        // The length agrees, so the counts are bounded by the bytes present.
        let [clusters, groups, members, ids, moved, triangles] = counts.map(|c| c as usize);
        let (words, bytes) = content[HEADER..].split_at(content.len() - HEADER - 3 * triangles);
        let mut words = words.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let mut next = || words.next().unwrap_or(0);
        let mut this = Self {
            clusters: (0..clusters).map(|_| read_cluster(&mut next)).collect(),
            groups: (0..groups).map(|_| read_group(&mut next)).collect(),
            members: (0..members).map(|_| next()).collect(),
            vertex_ids: (0..ids).map(|_| next()).collect(),
            triangles: bytes.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
            vertices: vertices.to_vec(),
            original_vertices: vertices.len(),
            key: key_read,
        };
        let mut word = || [(); VERTEX_WORDS].map(|()| next());
        this.vertices.extend((0..moved).map(|_| bytemuck::cast::<_, Vertex>(word())));
        this.check()?;
        Ok(this)
    }

    /// Whether all ids and bounds are consistent, so that nothing built on them can fail.
    fn check(&self) -> Result<(), ClusterError> {
        let broken = |what, at| Err(ClusterError::Broken { what, at });
        let (mut ids, mut triangles) = (0usize, 0usize);
        for (at, c) in self.clusters.iter().enumerate() {
            let (v, t) = (c.vertices as usize, c.triangles as usize);
            let fits = v <= PAGE_VERTICES && t <= PAGE_TRIANGLES;
            let placed = c.first_vertex as usize == ids && c.first_triangle as usize == triangles;
            (ids, triangles) = (ids + v, triangles + t);
            let there = ids <= self.vertex_ids.len() && triangles <= self.triangles.len();
            let groups = self.groups.len() as u32;
            let known = [c.output_of, c.input_of].iter().all(|g| *g == NO_GROUP || *g < groups);
            let shaped = sound(&c.sphere)
                && c.half.is_finite()
                && c.half.cmpge(Vec3::ZERO).all()
                && c.cone.axis.is_finite()
                && !c.cone.sine.is_nan()
                && c.error_mm >= 0.0;
            if !(fits && placed && there && known && shaped) {
                return broken("cluster", at);
            }
            let corners = self.triangles(at as u32).iter().flatten();
            if corners.max().is_some_and(|m| usize::from(*m) >= v) {
                return broken("cluster", at);
            }
        }
        if ids != self.vertex_ids.len() || triangles != self.triangles.len() {
            return broken("cluster", self.clusters.len());
        }
        let placed = |v: &Vertex| v.position().is_finite();
        if let Some(at) = self.vertices.iter().position(|v| !placed(v)) {
            return broken("vertex", at);
        }
        if let Some(at) = self.vertex_ids.iter().position(|v| *v as usize >= self.vertices.len()) {
            return broken("vertex", at);
        }
        self.check_groups()
    }

    fn check_groups(&self) -> Result<(), ClusterError> {
        let all = self.clusters.len();
        let (mut members, mut outputs) = (0usize, 0usize);
        let mut met = vec![false; all];
        for (at, g) in self.groups.iter().enumerate() {
            let broken = Err(ClusterError::Broken { what: "group", at });
            let (i, o) = (g.inputs as usize, g.outputs as usize);
            let end = g.first_output as usize + o;
            let placed = g.first_input as usize == members && members + i <= self.members.len();
            let numbers = group_numbers(g).iter().all(|v| *v >= 0.0);
            let shaped = sound(&g.sphere) && sound(&g.subtree_sphere) && numbers;
            let rises = g.angle_rad <= g.subtree_angle_rad;
            if !placed || !shaped || !rises || end > all || i == 0 || o == 0 {
                return broken;
            }
            (members, outputs) = (members + i, outputs + o);
            let made = |c: &Cluster| c.output_of as usize == at && c.error_mm <= g.error_mm;
            if !self.clusters[g.first_output as usize..end].iter().all(made) {
                return broken;
            }
            for &c in self.inputs(at as u32) {
                let Some(cluster) = self.clusters.get(c as usize) else { return broken };
                let below = self.groups.get(cluster.output_of as usize);
                // Groups below come first.
                let order = cluster.output_of == NO_GROUP || (cluster.output_of as usize) < at;
                // The selection of open groups relies on bounds that rise with the level.
                let reach =
                    |g: &Group| [g.error_mm, g.subtree_angle_rad, g.subtree_turn_mm, g.edge_mm];
                let rises = below.is_none_or(|b| (0..4).all(|k| reach(b)[k] <= reach(g)[k]));
                let met = std::mem::replace(&mut met[c as usize], true);
                if met || cluster.input_of as usize != at || !order || !rises {
                    return broken;
                }
            }
        }
        // No cluster names a group that does not list it.
        let used = self.clusters.iter().filter(|c| c.input_of != NO_GROUP).count();
        let made = self.clusters.iter().filter(|c| c.output_of != NO_GROUP).count();
        match used == members && made == outputs && members == self.members.len() {
            true => Ok(()),
            false => Err(ClusterError::Broken { what: "group", at: self.groups.len() }),
        }
    }
}

/// File length by the counts; saturates.
fn length([clusters, groups, members, ids, moved, triangles]: [u64; 6]) -> u64 {
    let words = clusters
        .saturating_mul(CLUSTER_WORDS as u64)
        .saturating_add(groups.saturating_mul(GROUP_WORDS as u64))
        .saturating_add(members)
        .saturating_add(ids)
        .saturating_add(moved.saturating_mul(VERTEX_WORDS as u64));
    let content = words.saturating_mul(4).saturating_add(triangles.saturating_mul(3));
    content.saturating_add((HEADER + HASH) as u64)
}

fn sound(s: &Sphere) -> bool {
    s.centre.is_finite() && s.radius.is_finite() && s.radius >= 0.0
}

fn cluster_words(c: &Cluster) -> [u32; CLUSTER_WORDS] {
    let [x, y, z, r] = sphere_words(&c.sphere);
    let [p, q, s] = c.half.to_array().map(f32::to_bits);
    let [a, b, d] = c.cone.axis.to_array().map(f32::to_bits);
    let sine = c.cone.sine.to_bits();
    let place = [c.first_vertex, c.vertices, c.first_triangle, c.triangles];
    let [i, j, k, l] = place;
    let error = c.error_mm.to_bits();
    [i, j, k, l, x, y, z, r, p, q, s, a, b, d, sine, error, c.output_of, c.input_of]
}

fn read_cluster(next: &mut impl FnMut() -> u32) -> Cluster {
    Cluster {
        first_vertex: next(),
        vertices: next(),
        first_triangle: next(),
        triangles: next(),
        sphere: read_sphere(next),
        half: read_vector(next),
        cone: Cone { axis: read_vector(next), sine: f32::from_bits(next()) },
        error_mm: f32::from_bits(next()),
        output_of: next(),
        input_of: next(),
    }
}

fn group_numbers(g: &Group) -> [f32; 5] {
    [g.error_mm, g.angle_rad, g.subtree_angle_rad, g.subtree_turn_mm, g.edge_mm]
}

fn group_words(g: &Group) -> [u32; GROUP_WORDS] {
    let [a, b, c, d] = sphere_words(&g.sphere);
    let [e, f, h, i] = sphere_words(&g.subtree_sphere);
    let [u, v, x, y, z] = group_numbers(g).map(f32::to_bits);
    let (first, last) = (g.first_input, g.first_output);
    [first, g.inputs, last, g.outputs, a, b, c, d, e, f, h, i, u, v, x, y, z]
}

fn read_group(next: &mut impl FnMut() -> u32) -> Group {
    Group {
        first_input: next(),
        inputs: next(),
        first_output: next(),
        outputs: next(),
        sphere: read_sphere(next),
        subtree_sphere: read_sphere(next),
        error_mm: f32::from_bits(next()),
        angle_rad: f32::from_bits(next()),
        subtree_angle_rad: f32::from_bits(next()),
        subtree_turn_mm: f32::from_bits(next()),
        edge_mm: f32::from_bits(next()),
    }
}

fn sphere_words(s: &Sphere) -> [u32; 4] {
    s.centre.extend(s.radius).to_array().map(f32::to_bits)
}

fn read_vector(next: &mut impl FnMut() -> u32) -> Vec3 {
    Vec3::from_array([(); 3].map(|()| f32::from_bits(next())))
}

fn read_sphere(next: &mut impl FnMut() -> u32) -> Sphere {
    Sphere { centre: read_vector(next), radius: f32::from_bits(next()) }
}
