//! Surfaces as other programs write them in VTK's XML: base64 and compressed, inline and appended.

use common::fixtures;
use common::volumes::shared_file;
use glam::Vec3;
use intima::formats::read_mesh;
use intima::geometry::Mesh;

/// A surface of the oracle, from its points in RAS.
fn truth() -> Mesh {
    let json = fixtures::json("vtp/cone.json");
    let vectors = |key: &str| -> Vec<Vec3> {
        let rows = fixtures::list(&json[key]).iter().map(fixtures::list);
        rows.map(|r| Vec3::from([0, 1, 2].map(|k| fixtures::real(&r[k]) as f32)))
            .map(|v| Vec3::new(-v.x, -v.y, v.z))
            .collect()
    };
    let faces = fixtures::list(&json["faces"]).iter().map(|f| {
        let f = fixtures::ints(f);
        [f[0] as u32, f[1] as u32, f[2] as u32]
    });
    let faces = faces.collect();
    Mesh { positions: vectors("points"), normals: vectors("normals"), faces, caps: Vec::new() }
}

/// Triangles by their corners, each from its least one on.
fn turned(mesh: &Mesh) -> Vec<[u32; 3]> {
    let least_first = |f: &[u32; 3]| {
        let first = (0..3).min_by_key(|k| f[*k]).unwrap();
        [f[first], f[(first + 1) % 3], f[(first + 2) % 3]]
    };
    let mut faces: Vec<_> = mesh.faces.iter().map(least_first).collect();
    faces.sort_unstable();
    faces
}

#[test]
fn vtp_as_vtk_writes_it_is_read_in_every_encoding() {
    let truth = truth();
    for name in ["as_vtk_writes", "inline", "inline_blocks", "appended_plain", "text", "strips"] {
        let path = fixtures::path(&format!("vtp/{name}.vtp"));
        let (mesh, warnings) = read_mesh(&path, None).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(warnings, Vec::<String>::new(), "{name}: the file says its space");
        assert_eq!(turned(&mesh), turned(&truth), "{name}");
        let near = |a: &[Vec3], b: &[Vec3]| {
            // Text has eight digits.
            let tolerance = if name == "text" { 1e-6 } else { 0.0 };
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.distance(*b) <= tolerance)
        };
        assert!(near(&mesh.positions, &truth.positions), "{name}");
        assert!(near(&mesh.normals, &truth.normals), "{name}");
    }
}

#[test]
fn damaged_vtp_of_vtk_is_refused_and_other_compressors_by_name() {
    let dir = common::scratch();
    let path = dir.path().join("a.vtp");
    let refusal = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        read_mesh(&path, None).unwrap_err().to_string()
    };
    let text = String::from_utf8(fixtures::bytes("vtp/as_vtk_writes.vtp")).unwrap();
    let other = text.replace("vtkZLibDataCompressor", "vtkLZ4DataCompressor");
    assert!(refusal(other.as_bytes()).contains("vtkLZ4DataCompressor"));
    let named = text.replace("vtkZLibDataCompressor", "JANE");
    assert!(!refusal(named.as_bytes()).contains("JANE"));
    // The second of the compressed blocks is that of the normals.
    let data = text.find("<AppendedData").unwrap();
    let begin = text[data..].match_indices("eJ").nth(1).unwrap().0 + data;
    let mut changed = text.clone().into_bytes();
    changed[begin + 20..begin + 60].reverse();
    assert!(refusal(&changed).contains("damaged"));
    assert!(refusal(&text.as_bytes()[..begin + 20]).contains("a VTK array"));
}

#[test]
fn a_surface_of_vmtk_is_read() {
    for (name, vertices, faces) in
        [("aorta_mra_surface.vtp", 6468, 12932), ("aorto_iliac_surface.vtp", 9294, 18584)]
    {
        let Some(path) = shared_file(name) else { return };
        let (mesh, warnings) = read_mesh(&path, None).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((mesh.positions.len(), mesh.faces.len()), (vertices, faces), "{name}");
        assert_eq!(warnings, ["the mesh does not say its space; LPS assumed"]);
        assert!(mesh.volume_mm3().abs() > 100.0, "{name}");
    }
}
