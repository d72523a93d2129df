//! A parameterisation as bytes, and back with nothing taken on trust.
//!
//! Little endian. Magic (8 bytes), version, vertices, faces, collapses, ring entries, base faces
//! (u32 each); hash of the original mesh, hash of the base's connectivity (32 bytes each); a
//! collapse: vertex, ring length with the kind of fan in the two highest bits (u32 each); a ring
//! entry: vertex, triangle (u32 each), place in the plane (2 × f32); hash of all that (32 bytes).
//! Triangles follow from the original's faces and the collapses, and are not written.

use super::flatten::{FanPlace, FlatRing};
use super::{NONE, Parameterization, ParameterizationError, RingEntry};
use crate::geometry::Mesh;

/// First bytes.
pub(super) const MAGIC: &[u8; 8] = b"intiMAPS";
/// Version written and read.
pub(super) const VERSION: u32 = 1;

const HASH: usize = 32;
const HEADER: usize = 8 + 6 * 4 + 2 * HASH;
const RECORD: usize = 8;
const ENTRY: usize = 16;
/// Bits of a record's second word that hold the ring length.
const LENGTH: u32 = (1 << 30) - 1;

impl Parameterization {
    /// The parameterisation as bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let size = HEADER + self.records.len() * RECORD + self.entries.len() * ENTRY + HASH;
        let mut out = Vec::with_capacity(size);
        out.extend_from_slice(MAGIC);
        let base_faces = self.base_faces().count() as u32;
        let counts = [self.records.len() as u32, self.entries.len() as u32, base_faces];
        for n in [VERSION, self.vertices, self.faces].into_iter().chain(counts) {
            out.extend_from_slice(&n.to_le_bytes());
        }
        out.extend_from_slice(&self.original);
        out.extend_from_slice(&self.base_hash());
        for r in 0..self.records.len() as u32 {
            let (record, polygon) = self.polygon(r);
            out.extend_from_slice(&record.from.to_le_bytes());
            let word = polygon.ring.len() as u32 | (record.kind as u32) << 30;
            out.extend_from_slice(&word.to_le_bytes());
        }
        for e in &self.entries {
            for word in [e.vertex, e.pre, e.flat[0].to_bits(), e.flat[1].to_bits()] {
                out.extend_from_slice(&word.to_le_bytes());
            }
        }
        let end = blake3::hash(&out);
        out.extend_from_slice(end.as_bytes());
        out
    }

    /// Reads what [`Parameterization::to_bytes`] wrote. `original` is the mesh it was made with. Every
    /// collapse is followed on the mesh and its polygon judged anew, so that what is returned is a
    /// bijection whatever the bytes hold.
    ///
    /// # Errors
    /// [`ParameterizationError`] other than `NoFace`. Memory is taken only once the length is right.
    pub fn from_bytes(bytes: &[u8], original: &Mesh) -> Result<Self, ParameterizationError> {
        if !bytes.starts_with(MAGIC) {
            return Err(ParameterizationError::Magic);
        }
        let found = bytes.len() as u64;
        let short = ParameterizationError::Length { wanted: (HEADER + HASH) as u64, found };
        let (header, rest) = bytes.split_at_checked(HEADER).ok_or(short)?;
        let [version, vertices, faces, records, entries, base_faces] =
            std::array::from_fn(|i| word(header, 2 + i));
        if version != VERSION {
            return Err(ParameterizationError::Version { found: version });
        }
        let wanted = HEADER as u64
            + u64::from(records) * RECORD as u64
            + u64::from(entries) * ENTRY as u64
            + HASH as u64;
        if found != wanted {
            return Err(ParameterizationError::Length { wanted, found });
        }
        let (content, end) = bytes.split_at(bytes.len() - HASH);
        if blake3::hash(content).as_bytes() != end {
            return Err(ParameterizationError::Damaged);
        }
        let (made_with, base) = header[HEADER - 2 * HASH..].split_at(HASH);
        let mut maps = Self::new(original)?;
        if (maps.vertices, maps.faces) != (vertices, faces) || maps.original != made_with {
            let digits = |h: &[u8]| h[..6].iter().map(|b| format!("{b:02x}")).collect();
            return Err(ParameterizationError::OtherMesh {
                vertices,
                faces,
                hash: digits(made_with),
                here_vertices: maps.vertices,
                here_faces: maps.faces,
                here: digits(&maps.original),
            });
        }

        let (records, entries) = rest.split_at(records as usize * RECORD);
        maps.records.reserve_exact(records.len() / RECORD);
        maps.entries.reserve_exact((entries.len() - HASH) / ENTRY);
        let mut live = Live::new(&maps);
        let mut at = entries[..entries.len() - HASH].chunks_exact(ENTRY);
        for (r, record) in records.chunks_exact(RECORD).enumerate() {
            let bad = |why| ParameterizationError::Record { collapse: r as u32, why };
            let (from, k) = (word(record, 0), (word(record, 1) & LENGTH) as usize);
            let kind = match word(record, 1) >> 30 {
                0 => FanPlace::Inner,
                1 => FanPlace::First,
                2 => FanPlace::Last,
                _ => return Err(bad("its fan is of no known kind")),
            };
            if k < 3 {
                return Err(bad("its ring has fewer than three vertices"));
            }
            let start = maps.entries.len();
            for _ in 0..k {
                let e = at.next().ok_or(bad("its ring ends after the last entry"))?;
                let flat = [2, 3].map(|i| f32::from_bits(word(e, i)));
                maps.entries.push(RingEntry { vertex: word(e, 0), pre: word(e, 1), flat });
            }
            live.check(&maps, from, &maps.entries[start..], kind).map_err(bad)?;
            for e in &maps.entries[start..start + kind.pre(k)] {
                for v in maps.triangles[e.pre as usize].vertices {
                    live.faces[v as usize] -= 1;
                }
            }
            maps.append(from, start, kind);
            for v in maps.triangles[maps.triangles.len() + 2 - k..].iter().flat_map(|t| t.vertices)
            {
                live.faces[v as usize] += 1;
            }
        }
        if at.next().is_some()
            || maps.base_hash() != base
            || maps.base_faces().count() != base_faces as usize
        {
            return Err(ParameterizationError::OtherBase);
        }
        Ok(maps)
    }

    /// Hash of the base's faces and their ids.
    fn base_hash(&self) -> [u8; HASH] {
        hash_words(self.base_faces().flat_map(|(slot, [a, b, c])| [slot, a, b, c]))
    }
}

/// State of the remaining mesh while collapses are read.
struct Live {
    /// Number of faces of each vertex.
    faces: Vec<u32>,
    /// Last collapse (from 1) whose ring passed the vertex.
    passed: Vec<u32>,
}

impl Live {
    /// Starts with the original mesh.
    fn new(maps: &Parameterization) -> Self {
        let mut faces = vec![0; maps.vertices as usize];
        for &v in maps.triangles.iter().flat_map(|t| &t.vertices) {
            if let Some(n) = faces.get_mut(v as usize) {
                *n += 1;
            }
        }
        Self { faces, passed: vec![0; maps.vertices as usize] }
    }

    /// Whether the collapse of `from` with this ring can come next.
    fn check(
        &mut self,
        maps: &Parameterization,
        from: u32,
        ring: &[RingEntry],
        kind: FanPlace,
    ) -> Result<(), &'static str> {
        let pre = kind.pre(ring.len());
        if self.faces.get(from as usize) != Some(&(pre as u32)) {
            return Err("its vertex has another number of faces");
        }
        let collapse = maps.records.len() as u32 + 1;
        for v in std::iter::once(from).chain(ring.iter().map(|e| e.vertex)) {
            match self.passed.get_mut(v as usize) {
                Some(passed) if *passed != collapse => *passed = collapse,
                Some(_) => return Err("its ring passes a vertex twice"),
                None => return Err("a vertex of it does not exist"),
            }
        }
        for (i, e) in ring[..pre].iter().enumerate() {
            let Some(t) = maps.triangles.get(e.pre as usize) else {
                return Err("a face of it does not exist");
            };
            if maps.current[t.slot as usize] != e.pre {
                return Err("a face of it is no longer there");
            }
            let [a, b, c] = t.vertices;
            let wanted = [from, e.vertex, ring[(i + 1) % ring.len()].vertex];
            if ![[a, b, c], [b, c, a], [c, a, b]].contains(&wanted) {
                return Err("a face of it has other vertices");
            }
        }
        if ring[pre..].iter().any(|e| e.pre != NONE) {
            return Err("its open ring is closed by a face");
        }
        // The comparisons inside are false for what is not a number.
        let polygon = FlatRing { ring, kind };
        if !(polygon.unfolded() && polygon.winds_once()) {
            return Err("its flattened polygon folds");
        }
        Ok(())
    }
}

/// Hash of a mesh's positions and faces.
pub(super) fn mesh_hash(mesh: &Mesh) -> [u8; HASH] {
    let sizes = [mesh.positions.len() as u32, mesh.faces.len() as u32].into_iter();
    let positions = mesh.positions.iter().flat_map(|p| p.to_array().map(f32::to_bits));
    hash_words(sizes.chain(positions).chain(mesh.faces.iter().flatten().copied()))
}

/// Hash of words, little endian.
fn hash_words(words: impl Iterator<Item = u32>) -> [u8; HASH] {
    let mut hasher = blake3::Hasher::new();
    let mut some = Vec::with_capacity(1 << 16);
    for w in words {
        some.extend_from_slice(&w.to_le_bytes());
        if some.len() == 1 << 16 {
            hasher.update(&some);
            some.clear();
        }
    }
    hasher.update(&some);
    hasher.finalize().into()
}

/// The i-th little-endian word; the caller has checked the length.
fn word(bytes: &[u8], i: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|b| bytes[4 * i + b]))
}
