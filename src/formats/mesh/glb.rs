//! glTF 2.0, binary. glTF is metres with y up; vertices stay LPS mm and the node turns them.

use std::path::Path;

use serde_json::json;

use super::{FacedMesh, FormatError};
use crate::formats::atomic_file;

/// glTF's codes.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// World of glTF from LPS mm, column by column: left to +x, head to +y, front to +z. Its
/// determinant is positive, so nothing is mirrored.
const MATRIX: [f64; 16] = [1e-3, 0., 0., 0., 0., 0., -1e-3, 0., 0., 1e-3, 0., 0., 0., 0., 0., 1.];

pub(super) fn write(path: &Path, faced: &FacedMesh<'_>) -> Result<(), FormatError> {
    let mesh = &*faced.whole();
    let Some((low, high)) = mesh.bounds().filter(|_| !mesh.faces.is_empty()) else {
        return Err(FormatError::unsupported(path, "a mesh without faces as glTF"));
    };
    let n = mesh.positions.len();
    let blocks: [(&[u8], u32); 3] = [
        (bytemuck::cast_slice(&mesh.positions), ARRAY_BUFFER),
        (bytemuck::cast_slice(&mesh.normals), ARRAY_BUFFER),
        (bytemuck::cast_slice(&mesh.faces), ELEMENT_ARRAY_BUFFER),
    ];
    let (mut views, mut length) = (Vec::new(), 0);
    for (bytes, target) in blocks.iter().filter(|b| !b.0.is_empty()) {
        let size = bytes.len();
        views
            .push(json!({"buffer": 0, "byteOffset": length, "byteLength": size, "target": target}));
        length += size;
    }
    let mut attributes = json!({"POSITION": 0});
    let mut accessors = vec![json!({
        "bufferView": 0, "componentType": FLOAT, "count": n, "type": "VEC3",
        "min": low.to_array(), "max": high.to_array(),
    })];
    if !mesh.normals.is_empty() {
        attributes["NORMAL"] = json!(1);
        accessors
            .push(json!({"bufferView": 1, "componentType": FLOAT, "count": n, "type": "VEC3"}));
    }
    let indices = accessors.len();
    accessors.push(json!({
        "bufferView": indices, "componentType": UNSIGNED_INT,
        "count": 3 * mesh.faces.len(), "type": "SCALAR",
    }));
    let mut extras = json!({"SPACE": "LPS", "units": "mm"});
    if let Some(facing) = faced.tag() {
        extras["FACING"] = facing.into();
    }
    let document = json!({
        "asset": {"version": "2.0", "generator": "intima", "extras": extras},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "metres, y up, from LPS mm", "matrix": MATRIX, "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [{
            "doubleSided": true,
            "pbrMetallicRoughness": {
                "baseColorFactor": [0.85, 0.5, 0.45, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.6,
            },
        }],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": length}],
    });
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    // Every block is whole words, so that the chunk needs no padding.
    let total = 12 + 8 + text.len() + 8 + length;
    let Ok(total) = u32::try_from(total) else {
        return Err(FormatError::unsupported(path, "a .glb of more than 4 GiB"));
    };
    atomic_file::write_atomic(path, |out| {
        for word in [0x4654_6c67, 2, total, text.len() as u32, 0x4e4f_534a] {
            out.write_all(&u32::to_le_bytes(word))?;
        }
        out.write_all(&text)?;
        for word in [length as u32, 0x004e_4942] {
            out.write_all(&word.to_le_bytes())?;
        }
        for word in blocks.iter().flat_map(|b| b.0.chunks_exact(4)) {
            out.write_all(&u32::from_ne_bytes([word[0], word[1], word[2], word[3]]).to_le_bytes())?;
        }
        Ok(())
    })
}
