//! glTF 2.0 in: triangles of a binary file's own buffer, through the matrices of its nodes.

use std::fmt;
use std::marker::PhantomData;
use std::path::Path;

use glam::{DMat4, DQuat, DVec3};
use serde::de::{Deserialize, Deserializer, SeqAccess, Visitor};

use super::glb::{FLOAT, MATRIX, UNSIGNED_INT};
use super::{FormatError, RawMesh, Space};

const UNSIGNED_BYTE: u32 = 5121;
const UNSIGNED_SHORT: u32 = 5123;
const TRIANGLES: u32 = 4;
/// Signed and unsigned bytes and shorts.
const INTEGERS: [u32; 4] = [5120, UNSIGNED_BYTE, 5122, UNSIGNED_SHORT];

/// No description of a surface is longer, and none of its lists; they bound what it takes. Half a
/// megabyte is that of several hundred meshes; of the shortest primitives it makes 6 MB.
const MAX_JSON: usize = 1 << 19;
const MAX_ENTRIES: usize = 4096;
/// Meshes and accessors may be used many times; a surface is at most so many times its buffer.
const MAX_REUSE: usize = 64;

/// Extensions that change where vertices are or how they are stored, by which a file is refused.
const ENCODINGS: [&str; 4] = [
    "KHR_draco_mesh_compression",
    QUANTIZATION,
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
];
const QUANTIZATION: &str = "KHR_mesh_quantization";
/// Beginnings of the names of extensions that change colours and lights alone.
const SHADING: [&str; 4] = ["KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_"];

/// A list that is refused where it is longer than any surface needs.
struct List<T>(Vec<T>);

impl<T> Default for List<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for List<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Entries<T> {
            type Value = List<T>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<List<T>, A::Error> {
                let mut list = Vec::new();
                while let Some(entry) = seq.next_element()? {
                    if list.len() == MAX_ENTRIES {
                        return Err(serde::de::Error::custom("a list is too long"));
                    }
                    list.push(entry);
                }
                Ok(List(list))
            }
        }
        deserializer.deserialize_seq(Entries(PhantomData))
    }
}

#[derive(serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
#[derive(Default)]
struct GlbDocument {
    asset: Asset,
    scene: usize,
    scenes: List<GlbScene>,
    nodes: List<GlbNode>,
    meshes: List<MeshOf>,
    accessors: List<Accessor>,
    buffer_views: List<BufferView>,
    extensions_required: List<String>,
}

#[derive(Default, serde::Deserialize)]
#[serde(default)]
struct Asset {
    extras: Extras,
}

#[derive(Default, serde::Deserialize)]
#[serde(default)]
struct Extras {
    #[serde(rename = "SPACE")]
    space: Named,
}

/// The space that the asset names.
#[derive(Clone, Copy, Default, serde::Deserialize)]
enum Named {
    #[serde(rename = "LPS")]
    Lps,
    #[serde(rename = "RAS")]
    Ras,
    #[default]
    #[serde(other)]
    Other,
}

#[derive(Default, serde::Deserialize)]
#[serde(default)]
struct GlbScene {
    nodes: List<usize>,
}

#[derive(Default, serde::Deserialize)]
#[serde(default)]
struct GlbNode {
    mesh: Option<usize>,
    children: List<usize>,
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
}

#[derive(Default, serde::Deserialize)]
#[serde(default)]
struct MeshOf {
    primitives: List<Primitive>,
}

#[derive(Default, serde::Deserialize)]
#[serde(default)]
struct Primitive {
    attributes: Attributes,
    indices: Option<u32>,
    mode: Option<u32>,
}

#[derive(Default, serde::Deserialize)]
#[serde(rename_all = "UPPERCASE", default)]
struct Attributes {
    position: Option<u32>,
    normal: Option<u32>,
}

#[derive(Clone, Copy, Default, PartialEq, serde::Deserialize)]
enum GlbMesh {
    #[serde(rename = "SCALAR")]
    Scalar,
    #[serde(rename = "VEC3")]
    Vec3,
    #[default]
    #[serde(other)]
    Other,
}

#[derive(Default, serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Accessor {
    buffer_view: Option<usize>,
    byte_offset: u64,
    component_type: u32,
    count: u64,
    #[serde(rename = "type")]
    shape: GlbMesh,
    sparse: Option<serde::de::IgnoredAny>,
}

#[derive(Default, serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct BufferView {
    buffer: usize,
    byte_offset: u64,
    byte_length: u64,
    byte_stride: Option<u64>,
}

/// Entries of an accessor, each as stored.
struct Entries<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
    count: usize,
}

impl Entries<'_> {
    fn at(&self, i: usize) -> &[u8] {
        &self.bytes[i * self.stride..][..self.size]
    }

    fn vector(&self, i: usize) -> [f64; 3] {
        let b = self.at(i);
        [0, 4, 8].map(|k| f64::from(f32::from_le_bytes([b[k], b[k + 1], b[k + 2], b[k + 3]])))
    }

    fn index(&self, i: usize) -> u32 {
        let mut four = [0; 4];
        four[..self.size].copy_from_slice(self.at(i));
        u32::from_le_bytes(four)
    }
}

struct Reader<'a> {
    path: &'a Path,
    document: GlbDocument,
    buffer: &'a [u8],
}

/// The two chunks of a file: its description and its buffer.
fn chunks<'a>(path: &Path, bytes: &'a [u8]) -> Result<(&'a [u8], &'a [u8]), FormatError> {
    let word = |at: usize| {
        let b = bytes.get(at..at + 4)?;
        Some(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    };
    if word(0) != Some(0x4654_6c67) || word(4) != Some(2) {
        return Err(FormatError::text(path, "magic", "a .glb begins `glTF`, version 2"));
    }
    let chunk = |at: usize, kind: u32, what: &'static str| {
        let cut = |wanted: u64| {
            let (file, found) = (path.to_owned(), bytes.len() as u64);
            FormatError::Truncated { file, what, wanted, found }
        };
        let (size, found) = word(at).zip(word(at + 4)).ok_or_else(|| cut(at as u64 + 8))?;
        if found != kind {
            return Err(FormatError::text(path, what, "another kind of chunk"));
        }
        let end = (at as u64 + 8).saturating_add(u64::from(size));
        let chunk = usize::try_from(end).ok().and_then(|end| bytes.get(at + 8..end));
        chunk.ok_or_else(|| cut(end))
    };
    let json = chunk(12, 0x4e4f_534a, "JSON chunk")?;
    let buffer = chunk(20 + json.len(), 0x004e_4942, "BIN chunk")?;
    Ok((json, buffer))
}

pub(super) fn read(path: &Path, bytes: &[u8], raw: &mut RawMesh) -> Result<(), FormatError> {
    let (json, buffer) = chunks(path, bytes)?;
    if json.len() > MAX_JSON {
        return Err(FormatError::field(path, "JSON chunk, bytes", json.len(), "too long"));
    }
    let document: GlbDocument = serde_json::from_slice(json)
        .map_err(|e| FormatError::text(path, format!("JSON column {}", e.column()), "damaged"))?;
    raw.space = match document.asset.extras.space {
        Named::Lps => Some(Space::Lps),
        Named::Ras => Some(Space::Ras),
        Named::Other => None,
    };
    refuse_extensions(path, &document.extensions_required.0)?;
    let reader = Reader { path, document, buffer };
    reader.scene(raw)
}

/// Refuses what cannot be read without an extension, by its name where that is one of ours.
fn refuse_extensions(path: &Path, required: &[String]) -> Result<(), FormatError> {
    let is_shading = |name: &str| SHADING.iter().any(|start| name.starts_with(start));
    match required.iter().find(|name| !is_shading(name)) {
        None => Ok(()),
        Some(name) => {
            let known =
                ENCODINGS.into_iter().find(|k| *k == name.as_str()).unwrap_or("that is not known");
            Err(FormatError::unsupported(path, format!("the glTF extension {known}")))
        }
    }
}

/// Place of a primitive's vertices, for other primitives that share them.
#[derive(Clone, Copy, PartialEq)]
struct PlacedVertices {
    position: u32,
    normal: Option<u32>,
    first: usize,
}

impl<'a> Reader<'a> {
    fn bad(&self, what: &str, why: &str) -> FormatError {
        FormatError::text(self.path, what, why)
    }

    /// All meshes of the scene. World is metres with y up; what is read is LPS mm.
    fn scene(&self, raw: &mut RawMesh) -> Result<(), FormatError> {
        let doc = &self.document;
        let scene = doc.scenes.0.get(doc.scene).ok_or_else(|| self.bad("scene", "not there"))?;
        let mut seen = vec![false; doc.nodes.0.len()];
        let mut open: Vec<(usize, Option<DMat4>)> =
            scene.nodes.0.iter().rev().map(|n| (*n, None)).collect();
        let mut left = self.buffer.len().saturating_mul(MAX_REUSE);
        while let Some((index, above)) = open.pop() {
            let node = doc.nodes.0.get(index).ok_or_else(|| self.bad("node", "not there"))?;
            if std::mem::replace(&mut seen[index], true) {
                return Err(self.bad("node", "stands in two places"));
            }
            let local = node.transform();
            let world = match (above, local) {
                (None, local) => local,
                (Some(above), None) => Some(above),
                (Some(above), Some(local)) => Some(above * local),
            };
            if let Some(mesh) = node.mesh {
                let mesh = doc.meshes.0.get(mesh).ok_or_else(|| self.bad("mesh", "not there"))?;
                let turn = lps_mm_from(world);
                let mut placed = Vec::new();
                for primitive in &mesh.primitives.0 {
                    self.primitive(primitive, turn, &mut left, &mut placed, raw)?;
                }
            }
            open.extend(node.children.0.iter().rev().map(|n| (*n, world)));
        }
        Ok(())
    }

    fn primitive(
        &self,
        primitive: &Primitive,
        turn: Option<DMat4>,
        left: &mut usize,
        placed: &mut Vec<PlacedVertices>,
        raw: &mut RawMesh,
    ) -> Result<(), FormatError> {
        if primitive.mode.is_some_and(|m| m != TRIANGLES) {
            let what = "glTF primitives that are not triangles";
            return Err(FormatError::unsupported(self.path, what));
        }
        let position = primitive.attributes.position;
        let position = position.ok_or_else(|| self.bad("POSITION", "absent"))?;
        let positions = self.entries("POSITION", position, GlbMesh::Vec3, &[FLOAT])?;
        let normals = match primitive.attributes.normal {
            Some(n) => Some(self.entries("NORMAL", n, GlbMesh::Vec3, &[FLOAT])?),
            None => None,
        };
        let known = [UNSIGNED_BYTE, UNSIGNED_SHORT, UNSIGNED_INT];
        let indices = match primitive.indices {
            Some(n) => Some(self.entries("indices", n, GlbMesh::Scalar, &known)?),
            None => None,
        };
        // The parts of a mesh often share their vertices.
        let normal = primitive.attributes.normal;
        let known = placed.iter().find(|p| (p.position, p.normal) == (position, normal)).copied();
        let first = known.map_or(raw.vertex_count(), |p| p.first);
        let taken = match known {
            Some(_) => 0,
            None => positions.count * positions.size,
        } + indices.as_ref().map_or(0, |i| i.count * i.size);
        *left = left.checked_sub(taken).ok_or_else(|| {
            let what = format!("glTF data used more than {MAX_REUSE} times");
            FormatError::unsupported(self.path, what)
        })?;
        if known.is_none() {
            self.vertices(&positions, normals.as_ref(), turn, raw)?;
            placed.push(PlacedVertices { position, normal, first });
        }
        let corners = indices.as_ref().map_or(positions.count, |i| i.count);
        if corners % 3 != 0 {
            return Err(FormatError::field(self.path, "corners", corners, "not whole triangles"));
        }
        let mirrored = turn.is_some_and(|m| m.determinant() < 0.0);
        for t in 0..corners / 3 {
            let corner = |k: usize| match &indices {
                Some(list) => list.index(3 * t + k),
                None => (3 * t + k) as u32,
            };
            let [a, b, c] = [0, 1, 2].map(corner);
            if [a, b, c].iter().any(|v| *v as usize >= positions.count) {
                let field = format!("vertex of triangle {t}");
                let why = format!("there are {} vertices", positions.count);
                return Err(FormatError::field(self.path, field, a.max(b).max(c), why));
            }
            let [a, b, c] = [a, b, c].map(|v| v + first as u32);
            raw.push_face(if mirrored { [a, c, b] } else { [a, b, c] }, None);
        }
        Ok(())
    }

    fn vertices(
        &self,
        positions: &Entries,
        normals: Option<&Entries>,
        turn: Option<DMat4>,
        raw: &mut RawMesh,
    ) -> Result<(), FormatError> {
        if raw.vertex_count() + positions.count > u32::MAX as usize {
            return Err(FormatError::unsupported(self.path, "more than 2^32 vertices"));
        }
        for i in 0..positions.count {
            let p = positions.vector(i);
            let p = turn.map_or(p, |m| m.transform_point3(DVec3::from(p)).to_array());
            raw.push_vertex(self.path, p)?;
        }
        let Some(normals) = normals else { return Ok(()) };
        if normals.count != positions.count {
            let why = format!("there are {} vertices", positions.count);
            return Err(FormatError::field(self.path, "number of normals", normals.count, why));
        }
        let turn = turn.map(|m| m.inverse().transpose());
        for i in 0..normals.count {
            let n = DVec3::from(normals.vector(i));
            let turned = |m: DMat4| m.transform_vector3(n).normalize_or_zero();
            raw.push_normal(turn.map_or(n, turned).as_vec3());
        }
        Ok(())
    }

    /// The bytes of an accessor, held against its view and the buffer.
    fn entries(
        &self,
        what: &str,
        accessor: u32,
        shape: GlbMesh,
        components: &[u32],
    ) -> Result<Entries<'a>, FormatError> {
        let doc = &self.document;
        let a = doc
            .accessors
            .0
            .get(accessor as usize)
            .ok_or_else(|| self.bad(what, "no such accessor"))?;
        if shape == GlbMesh::Vec3 && a.shape == shape && INTEGERS.contains(&a.component_type) {
            let what = format!("{what} in whole numbers, the glTF extension {QUANTIZATION}");
            return Err(FormatError::unsupported(self.path, what));
        }
        if a.sparse.is_some() {
            let what = format!("{what} as a sparse accessor of glTF");
            return Err(FormatError::unsupported(self.path, what));
        }
        if a.shape != shape || !components.contains(&a.component_type) {
            return Err(self.bad(what, "another type than a surface has"));
        }
        let view = a.buffer_view.and_then(|v| doc.buffer_views.0.get(v));
        let view = view.ok_or_else(|| self.bad(what, "no such buffer view"))?;
        if view.buffer != 0 {
            return Err(FormatError::unsupported(self.path, "glTF data in another file"));
        }
        let component = match a.component_type {
            UNSIGNED_BYTE => 1,
            UNSIGNED_SHORT => 2,
            _ => 4,
        };
        let size = component * if shape == GlbMesh::Vec3 { 3 } else { 1 };
        let stride = view.byte_stride.unwrap_or(size);
        if !(size..=252u64.max(size)).contains(&stride) {
            return Err(FormatError::field(self.path, "byteStride", stride, "not a step"));
        }
        let span = match a.count {
            0 => Some(0),
            n => (n - 1).checked_mul(stride).and_then(|s| s.checked_add(size)),
        };
        let within = |start: u64, len: u64, whole: u64| {
            start.checked_add(len).is_some_and(|end| end <= whole)
        };
        let span = span.filter(|s| within(a.byte_offset, *s, view.byte_length));
        let whole = self.buffer.len() as u64;
        let span = span.filter(|_| within(view.byte_offset, view.byte_length, whole));
        let Some(span) = span else {
            return Err(self.bad(what, "reaches beyond its buffer"));
        };
        let start = (view.byte_offset + a.byte_offset) as usize;
        Ok(Entries {
            bytes: &self.buffer[start..start + span as usize],
            stride: stride as usize,
            size: size as usize,
            count: a.count as usize,
        })
    }
}

impl GlbNode {
    /// Returns the node's transform to its parent's space; `None` where the spaces are the same.
    fn transform(&self) -> Option<DMat4> {
        if let Some(m) = self.matrix {
            return Some(DMat4::from_cols_array(&m));
        }
        if self.translation.is_none() && self.rotation.is_none() && self.scale.is_none() {
            return None;
        }
        let q = self.rotation.map_or(DQuat::IDENTITY, DQuat::from_array);
        Some(DMat4::from_scale_rotation_translation(
            self.scale.map_or(DVec3::ONE, DVec3::from),
            q.normalize(),
            self.translation.map_or(DVec3::ZERO, DVec3::from),
        ))
    }
}

/// LPS mm from a node's coordinates, given their way to glTF's world; `None` where they are LPS mm
/// already, as in our own files, whose numbers come back bit by bit.
fn lps_mm_from(world: Option<DMat4>) -> Option<DMat4> {
    let ours = DMat4::from_cols_array(&MATRIX);
    match world {
        Some(m) if m == ours => None,
        m => Some(ours.inverse() * m.unwrap_or(DMat4::IDENTITY)),
    }
}
