//! Meshes and centerlines: what is written is what is read.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use intima::formats::{
    Facing, FormatError, Space, read_mesh, write_branches, write_centerline, write_mesh, write_wall,
};
use intima::geometry::{Attachment, Branch, Centerline, CenterlinePoint, Mesh};

/// A tetrahedron without any symmetry, so that a mirror or a swapped axis shows; normals are unit.
fn chiral() -> Mesh {
    let positions = [[1.5, 2.25, -3.0], [11.0, 2.5, -2.75], [1.25, 22.1, -3.3], [2.0, 3.0, 37.7]]
        .map(Vec3::from);
    let middle = positions.iter().sum::<Vec3>() / 4.0;
    Mesh {
        normals: positions.iter().map(|&p| (middle - p).normalize()).collect(),
        positions: positions.to_vec(),
        faces: vec![[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]],
        caps: Vec::new(),
    }
}

fn scratch(name: &str, content: impl AsRef<[u8]>) -> (tempfile::TempDir, PathBuf) {
    let dir = common::scratch();
    let path = dir.path().join(name);
    std::fs::write(&path, content).unwrap();
    (dir, path)
}

fn read(name: &str, content: impl AsRef<[u8]>) -> Result<(Mesh, Vec<String>), FormatError> {
    let (_dir, path) = scratch(name, content);
    read_mesh(&path, None)
}

#[test]
fn every_format_gives_back_every_bit_and_stl_every_triangle() {
    let mesh = chiral();
    assert!(mesh.volume_mm3() > 0.0, "normals point inwards");
    for name in ["a.ply", "a.obj", "a.STL", "a.vtp"] {
        let (_dir, path) = scratch(name, "");
        write_mesh(&path, &mesh).unwrap();
        // The file's own tag beats the option.
        let (back, warnings) = read_mesh(&path, Some(Space::Ras)).unwrap();
        assert_eq!(warnings, Vec::<String>::new(), "{name}");
        if name == "a.STL" {
            let corners = |m: &Mesh| {
                m.faces.iter().flatten().map(|&v| m.positions[v as usize]).collect::<Vec<_>>()
            };
            assert_eq!(corners(&back), corners(&mesh));
            assert_eq!(back.positions.len(), 4, "equal points are one vertex");
            assert!(!std::fs::read(&path).unwrap().starts_with(b"solid"));
        } else {
            assert_eq!(back, mesh, "{name}");
        }
        let bytes = std::fs::read(&path).unwrap();
        write_mesh(&path, &mesh).unwrap();
        assert_eq!(bytes, std::fs::read(&path).unwrap(), "same mesh, same bytes");
    }
}

#[test]
fn glb_keeps_lps_mm_in_its_buffer_and_its_node_turns_without_mirroring() {
    let mesh = chiral();
    let (_dir, path) = scratch("a.glb", "");
    write_mesh(&path, &mesh).unwrap();
    let b = std::fs::read(&path).unwrap();
    let word = |at: usize| u32::from_le_bytes(b[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&b[..4], word(4), word(8)), (&b"glTF"[..], 2, b.len()));
    let (text, bin) = (&b[20..20 + word(12)], 20 + word(12));
    assert_eq!((&b[16..20], &b[bin + 4..bin + 8]), (&b"JSON"[..], &b"BIN\0"[..]));
    assert_eq!((bin % 4, word(bin) % 4, bin + 8 + word(bin)), (0, 0, b.len()));
    let json: serde_json::Value = serde_json::from_slice(text).unwrap();
    let buffer = &b[bin + 8..];
    let view = |k: usize| {
        let v = &json["bufferViews"][json["accessors"][k]["bufferView"].as_u64().unwrap() as usize];
        let at = v["byteOffset"].as_u64().unwrap() as usize;
        &buffer[at..at + v["byteLength"].as_u64().unwrap() as usize]
    };
    assert_eq!(view(0), bytemuck::cast_slice::<Vec3, u8>(&mesh.positions));
    assert_eq!(view(1), bytemuck::cast_slice::<Vec3, u8>(&mesh.normals));
    assert_eq!(view(2), bytemuck::cast_slice::<[u32; 3], u8>(&mesh.faces));
    assert_eq!(json["accessors"][0]["max"][2].as_f64().unwrap() as f32, 37.7);
    let m: Vec<f64> = json["nodes"][0]["matrix"]
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_f64().unwrap())
        .collect();
    let m = glam::DMat4::from_cols_slice(&m);
    assert!((m.determinant() - 1e-9).abs() < 1e-18, "no mirror, a thousandth");
    // Head up, left to +x, front towards the viewer.
    assert_eq!(m.transform_vector3(glam::DVec3::Z), glam::DVec3::Y * 1e-3);
    assert_eq!(m.transform_vector3(glam::DVec3::X), glam::DVec3::X * 1e-3);
    assert_eq!(m.transform_vector3(-glam::DVec3::Y), glam::DVec3::Z * 1e-3);
    assert!(write_mesh(&path, &Mesh::default()).is_err(), "glTF has no empty mesh");
}

/// Name, components and bytes of every array of a .vtp we wrote.
fn arrays(path: &Path) -> (String, Vec<(String, Vec<u8>)>) {
    let bytes = std::fs::read(path).unwrap();
    let mark = b"<AppendedData encoding=\"raw\">\n_";
    let at = bytes.windows(mark.len()).position(|w| w == mark).unwrap();
    let xml = String::from_utf8(bytes[..at].to_vec()).unwrap();
    let data = &bytes[at + mark.len()..];
    let part = |line: &str, key: &str| {
        line.split_once(&format!("{key}=\"")).unwrap().1.split('"').next().unwrap().to_owned()
    };
    let list = xml.lines().filter(|l| l.starts_with("<DataArray")).map(|l| {
        let offset: usize = part(l, "offset").parse().unwrap();
        let size = u64::from_ne_bytes(data[offset..offset + 8].try_into().unwrap()) as usize;
        (part(l, "Name"), data[offset + 8..offset + 8 + size].to_vec())
    });
    let list = list.collect();
    (xml, list)
}

#[test]
fn vtp_surface_holds_the_mesh_its_normals_and_its_caps() {
    let mesh = Mesh { caps: vec![false, true, false, false], ..chiral() };
    let (_dir, path) = scratch("a.vtp", "");
    write_mesh(&path, &mesh).unwrap();
    let (xml, arrays) = arrays(&path);
    assert!(xml.contains("Name=\"SPACE\"") && xml.contains(">76 80 83 0<"));
    let find = |name: &str| &arrays.iter().find(|a| a.0 == name).unwrap().1[..];
    assert_eq!(find("Points"), bytemuck::cast_slice::<Vec3, u8>(&mesh.positions));
    assert_eq!(find("Normals"), bytemuck::cast_slice::<Vec3, u8>(&mesh.normals));
    assert_eq!(find("connectivity"), bytemuck::cast_slice::<[u32; 3], u8>(&mesh.faces));
    assert_eq!(find("offsets"), bytemuck::cast_slice::<i32, u8>(&[3, 6, 9, 12]));
    assert_eq!(find("Cap"), [0, 1, 0, 0]);
}

#[test]
fn a_wall_is_written_outwards_unless_asked_and_every_format_says_which() {
    let wall = Mesh { caps: vec![false, true, false, false], ..chiral() };
    let turned = Mesh {
        normals: wall.normals.iter().map(|n| -*n).collect(),
        faces: wall.faces.iter().map(|[a, b, c]| [*a, *c, *b]).collect(),
        ..wall.clone()
    };
    assert_eq!(Facing::default(), Facing::Out);
    for name in ["a.ply", "a.obj", "a.stl", "a.vtp", "a.glb"] {
        for (facing, tag, want) in [(Facing::In, "IN", &wall), (Facing::Out, "OUT", &turned)] {
            let (_dir, path) = scratch(name, "");
            write_wall(&path, &wall, facing).unwrap();
            let text = String::from_utf8_lossy(&std::fs::read(&path).unwrap()).into_owned();
            let codes = if tag == "IN" { ">73 78 0<" } else { ">79 85 84 0<" };
            let says = [format!("FACING={tag}"), format!("\"FACING\":\"{tag}\""), codes.into()];
            assert!(says.iter().any(|s| text.contains(s)), "{name} {tag}");
            if name == "a.glb" {
                continue;
            }
            let (back, warnings) = read_mesh(&path, None).unwrap();
            assert!(warnings.is_empty(), "{name}: {warnings:?}");
            // Faces are the side that shows: positive where they look inwards.
            assert_eq!(back.volume_mm3() > 0.0, facing == Facing::In, "{name} {tag}");
            if name != "a.stl" {
                assert_eq!((&back.faces, &back.normals), (&want.faces, &want.normals), "{name}");
            }
        }
    }
}

#[test]
fn caps_of_a_vtp_come_back_with_their_faces() {
    let caps = vec![false, true, false, true];
    let mut mesh = Mesh { caps: caps.clone(), ..chiral() };
    let (_dir, path) = scratch("a.vtp", "");
    write_mesh(&path, &mesh).unwrap();
    assert_eq!(read_mesh(&path, None).unwrap().0.caps, caps);
    // A face that is dropped takes its flag along.
    mesh.faces[0] = [1, 1, 2];
    write_mesh(&path, &mesh).unwrap();
    assert_eq!(read_mesh(&path, None).unwrap().0.caps, caps[1..]);
}

#[test]
fn vtp_of_other_writers_is_read_where_it_is_plain() {
    let make = |tag: &str, polys: &str, offsets: &str| {
        format!(
            "<?xml version='1.0'?><VTKFile type=\"PolyData\" byte_order='LittleEndian'>\n\
             <PolyData>{tag}<Piece NumberOfPoints='4' NumberOfPolys='2'>\n<Points>\
             <DataArray type='Float64' NumberOfComponents='3' format='ascii'>\n\
             0 0 0 1 0 0 1 1 0 0 1 0\n</DataArray></Points><Polys>\n\
             <DataArray type='Int64' Name='connectivity' format='ascii'>{polys}</DataArray>\
             <DataArray type='Int64' Name='offsets' format='ascii'>{offsets}</DataArray>\
             </Polys></Piece></PolyData></VTKFile>"
        )
    };
    let ras = "<FieldData><Array type='String' Name='SPACE' NumberOfTuples='1' format='ascii'>\
               82 65 83 0</Array></FieldData>";
    let (mesh, warnings) = read("a.vtp", make(ras, "0 1 2 3", "4")).unwrap();
    assert_eq!(mesh.faces, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!((mesh.positions[1], warnings.len()), (Vec3::new(-1.0, 0.0, 0.0), 0));
    let (_, warnings) = read("a.vtp", make("", "0 1 2 0 2 3", "3 6")).unwrap();
    assert!(warnings[0].contains("LPS assumed"));
    let error = |polys: &str, offsets: &str| {
        read("a.vtp", make("", polys, offsets)).unwrap_err().to_string()
    };
    assert!(error("0 1 2", "4").contains("vertex of polygon 0"));
    assert!(error("0 1 9", "3").contains("is `9`"));
    assert!(error("0 1 -2", "3").contains("vertex of polygon 0"));
    assert!(error("0 1 2 0 2 3", "3 2").contains("offset of polygon 1"));
    assert!(error("0 1", "2").contains("three vertices"));
    let whole = make("", "0 1 2", "3");
    for (from, to) in [
        ("NumberOfPoints='4'", "NumberOfPoints='5'"),
        ("type=\"PolyData\"", "type='ImageData'"),
        ("byte_order=", "compressor='z' byte_order="),
        ("format='ascii'>\n0", "format='binary'>\n0"),
        ("0 0 0 1", "0 0 JANE 1"),
    ] {
        let message = read("a.vtp", whole.replace(from, to)).unwrap_err().to_string();
        assert!(!message.contains("JANE"), "{message}");
    }
}

#[test]
fn ras_is_turned_into_lps_and_a_silent_file_is_lps_with_a_warning() {
    let body = "v 1 2 3\nv 4 2 3\nv 1 5 3\nvn 0 1 0\nf 1//1 2//1 3//1\n";
    let (lps, w) = read("a.obj", body).unwrap();
    assert_eq!(lps.positions[0], Vec3::new(1.0, 2.0, 3.0));
    assert!(w.len() == 1 && w[0].contains("LPS assumed"));
    let (tagged, w) = read("a.obj", format!("# x SPACE=RAS y\n{body}")).unwrap();
    assert_eq!(tagged.positions[0], Vec3::new(-1.0, -2.0, 3.0));
    assert_eq!(tagged.normals[0], Vec3::new(0.0, -1.0, 0.0));
    assert!(w.is_empty());
    let (_dir, path) = scratch("b.obj", body);
    assert_eq!(read_mesh(&path, Some(Space::Ras)).unwrap().0, tagged);
    let cross = |m: &Mesh| m.face_cross(m.faces[0]).z;
    assert_eq!(cross(&lps), cross(&tagged), "a turn keeps the side of a face");
    assert_eq!("ras".parse(), Ok(Space::Ras));
}

#[test]
fn ply_dialects_read_alike() {
    let head = |format: &str, x: &str, count: &str, index: &str| {
        format!(
            "ply\r\nformat {format} 1.0\r\ncomment SPACE=LPS\r\nelement vertex 4\r\nproperty uchar red\r\n\
             property {x} x\r\nproperty {x} y\r\nproperty list uchar short extra\r\nproperty {x} z\r\n\
             element face 1\r\nproperty list {count} {index} vertex_index\r\nproperty float q\r\n\
             element edge 1\r\nproperty int a\r\nend_header\r\n"
        )
    };
    let text = head("ascii", "double", "uchar", "int")
        + "9 0 0 0 0.5\n9 1 0 1 7 0.5\n9 1 1 0 0.5\n9 0 1 0 0.5\n4 0 1 2 3 0.25\n8\n";
    let (mesh, _) = read("a.ply", text).unwrap();
    assert_eq!(mesh.faces, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(mesh.positions[1], Vec3::new(1.0, 0.0, 0.5));
    let xy = [[0.0f64, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    for big in [false, true] {
        let order = if big { "binary_big_endian" } else { "binary_little_endian" };
        let mut bytes = head(order, "double", "ushort", "uint").into_bytes();
        let mut put = |b: &[u8]| {
            let mut b = b.to_vec();
            if big {
                b.reverse();
            }
            bytes.extend(b);
        };
        for (i, [x, y]) in xy.into_iter().enumerate() {
            put(&[9]);
            put(&x.to_le_bytes());
            put(&y.to_le_bytes());
            put(&[u8::from(i == 1)]);
            if i == 1 {
                put(&7i16.to_le_bytes());
            }
            put(&0.5f64.to_le_bytes());
        }
        put(&4u16.to_le_bytes());
        (0..4u32).for_each(|v| put(&v.to_le_bytes()));
        put(&0.25f32.to_le_bytes());
        put(&8i32.to_le_bytes());
        assert_eq!(read("b.ply", &bytes).unwrap().0, mesh, "{order}");
        for cut in 0..bytes.len() {
            assert!(read("c.ply", &bytes[..cut]).is_err() || cut + 4 > bytes.len(), "cut at {cut}");
        }
    }
}

#[test]
fn hostile_ply_is_named_not_believed() {
    let make = |vertices: &str, faces: &str, rows: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n\
             property float z\nelement face {faces}\nproperty list int int vertex_indices\n\
             end_header\n{rows}"
        )
    };
    let error =
        |v: &str, f: &str, rows: &str| read("a.ply", make(v, f, rows)).unwrap_err().to_string();
    let three = "0 0 0 1 0 0 0 1 0 ";
    assert!(read("a.ply", make("3", "1", &format!("{three} 3 0 1 2"))).is_ok());
    assert!(error("9999999999999", "1", three).contains("truncated"));
    assert!(error("18446744073709551615", "1", three).contains("truncated"));
    assert!(error("18446744073709551616", "1", three).contains("element count"));
    assert!(error("3", "1", &format!("{three} 3 0 1 7")).contains("is `7`"));
    assert!(error("3", "1", &format!("{three} 3 0 1 -1")).contains("is `-1`"));
    assert!(error("3", "1", &format!("{three} 3 0 1 1.5")).contains("is `1.5`"));
    assert!(error("3", "1", &format!("{three} 2000000000 0 1 2")).contains("list length"));
    assert!(error("3", "1", &format!("{three} -3 0 1 2")).contains("list length"));
    assert!(error("3", "1", &format!("{three} 3 0 1")).contains("face 0 of 1"));
    assert!(error("3", "1", "0 0 0 1 nan 0 0 1 0 3 0 1 2").contains("vertex 1 is `1 NaN 0`"));
    assert!(error("3", "1", "0 0 0 1 1e99 0 0 1 0 3 0 1 2").contains("not finite"));
    assert!(error("3", "1", "0 0 0 1 what 0 0 1 0 3 0 1 2").contains("vertex 1 of 3"));
    for header in [
        "",
        "ply",
        "ply\nformat ascii 1.0\n",
        "obj\n",
        "ply\nformat morse 1.0\nend_header\n",
        "ply\nproperty float x\nend_header\n",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n1",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar x\nend_header\n1",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1 2 3",
    ] {
        assert!(read("a.ply", header).is_err(), "{header}");
    }
    // Rows without content take no time however many are promised.
    assert!(
        read("a.ply", "ply\nformat ascii 1.0\nelement x 18446744073709551615\nend_header\n")
            .is_ok()
    );
}

#[test]
fn hostile_stl_and_obj_are_named_not_believed() {
    let mesh = chiral();
    let (_dir, path) = scratch("a.stl", "");
    write_mesh(&path, &mesh).unwrap();
    let good = std::fs::read(&path).unwrap();
    for cut in 0..good.len() {
        assert!(read("a.stl", &good[..cut]).is_err(), "cut at {cut}");
    }
    let mut bad = good.clone();
    bad[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    let message = read("a.stl", &bad).unwrap_err().to_string();
    assert!(message.contains("truncated") && message.contains("214748364834 bytes"), "{message}");
    let mut bad = good.clone();
    bad[96..100].copy_from_slice(&f32::INFINITY.to_le_bytes());
    assert!(read("a.stl", &bad).unwrap_err().to_string().contains("vertex 0"));
    // A binary file whose header says `solid` still is binary.
    let mut solid = good.clone();
    solid[..5].copy_from_slice(b"solid");
    assert_eq!(read("a.stl", &solid).unwrap().0.faces.len(), 4);
    let loops = "solid SPACE=LPS\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n\
                 vertex -0 1 0\nendloop\nendfacet\nfacet normal 0 0 1\nouter loop\nvertex -0 0 0\n\
                 vertex 0 1 0\nvertex -1 0 0\nendloop\nendfacet\nendsolid\n";
    let (two, warnings) = read("a.stl", loops).unwrap();
    assert_eq!((two.positions.len(), two.faces.len(), warnings.len()), (4, 2, 0));
    assert!(read("a.stl", &loops[..loops.len() - 12]).is_err());
    assert!(read("a.stl", loops.replace("vertex 1 0 0", "vertex 1 0")).is_err());
    assert!(read("a.stl", loops.replace("vertex 1 0 0", "vertex nan 0 0")).is_err());

    let square = "v 0 0 0\nv 1 0 0\nv 1 1 0 1.0\nv 0 1 0 1 .5 .5\nvt 0 0\n";
    let (fan, _) = read("a.obj", format!("{square}f -4/1 -3/1 -2/1 -1/1\nf 1 1 2\n")).unwrap();
    assert_eq!(fan.faces, [[0, 1, 2], [0, 2, 3]]);
    for face in [
        "f 1 2 5",
        "f 0 1 2",
        "f -5 1 2",
        "f 1 2",
        "f a b c",
        "v 1 2",
        "v nan 0 0",
        "f 1 2 99999999999999999999",
        "f -9223372036854775808 1 2",
    ] {
        let message = read("a.obj", format!("{square}{face}\n")).unwrap_err().to_string();
        assert!(message.contains("line 6") || message.contains("vertex 4"), "{face}: {message}");
    }
    assert!(read("a.xyz", "").unwrap_err().to_string().contains(".xyz"));
    assert!(read("a.glb", "glTF").unwrap_err().to_string().contains("there are ply, stl"));
    assert!(read("a", "").is_err());
}

#[test]
fn a_mesh_that_does_not_fit_together_is_not_written() {
    let (dir, _) = scratch("x", "");
    for name in ["a.ply", "a.stl", "a.obj", "a.vtp", "a.glb"] {
        let path = dir.path().join(name);
        let mut mesh = chiral();
        mesh.faces[2][1] = 4;
        assert!(write_mesh(&path, &mesh).is_err());
        mesh = chiral();
        mesh.normals.pop();
        assert!(write_mesh(&path, &mesh).is_err());
        mesh = chiral();
        mesh.positions[1].y = f32::NAN;
        assert!(write_mesh(&path, &mesh).is_err());
        assert!(!path.exists());
        mesh = chiral();
        mesh.normals.clear();
        write_mesh(&path, &mesh).unwrap();
    }
    assert!(write_mesh(&dir.path().join("a.step"), &chiral()).is_err());
}

fn forked_line() -> Centerline {
    let point = |x: f64, y: f64, r: f64, s: f64| CenterlinePoint {
        position_mm: DVec3::new(x, y, 0.1),
        radius_mm: r,
        abscissa_mm: s,
    };
    let branch = |parent: Option<usize>, points: &[CenterlinePoint]| Branch {
        start: parent.map(|branch| Attachment { branch, point: 1 }),
        end: None,
        points: points.to_vec(),
    };
    Centerline {
        branches: vec![
            branch(None, &[point(0.0, 0.0, 2.0, 0.0), point(1.0 / 3.0, 0.0, 2.0, 1.0 / 3.0)]),
            branch(Some(0), &[point(1.0 / 3.0, 0.0, 2.0, 1.0 / 3.0), point(1.0, 1e-7, 1.0, 1.0)]),
            branch(Some(0), &[point(1.0 / 3.0, 0.0, 2.0, 1.0 / 3.0), point(0.5, 2.0, 0.5, 2.4)]),
        ],
    }
}

#[test]
fn csv_centerline_reads_back_to_the_same_numbers() {
    let (_dir, path) = scratch("a.csv", "");
    let line = forked_line();
    write_centerline(&path, &line).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    let mut rows = text.lines();
    assert_eq!(rows.next(), Some("x,y,z,radius,abscissa,branch,parent"));
    let parents = ["-1", "0", "0"];
    for (b, p) in
        line.branches.iter().enumerate().flat_map(|(b, x)| x.points.iter().map(move |p| (b, p)))
    {
        let cells: Vec<&str> = rows.next().unwrap().split(',').collect();
        let numbers: Vec<f64> = cells[..5].iter().map(|c| c.parse().unwrap()).collect();
        let DVec3 { x, y, z } = p.position_mm;
        assert_eq!(numbers, [x, y, z, p.radius_mm, p.abscissa_mm]);
        assert_eq!(cells[5..], [b.to_string().as_str(), parents[b]]);
    }
    assert_eq!(rows.next(), None);
}

#[test]
fn swc_centerline_is_one_tree_whose_branches_follow_a_point_of_their_parent() {
    let (_dir, path) = scratch("a.swc", "");
    let mut line = forked_line();
    // A branch of the last branch's first point, which is the trunk's second; and one beside it.
    let twig = |point, x| {
        let mut twig = line.branches[2].clone();
        twig.start = Some(Attachment { branch: 2, point });
        twig.points[0].position_mm.x = x;
        twig
    };
    let twigs = [twig(0, 1.0 / 3.0), twig(1, 7.0)];
    line.branches.extend(twigs);
    line.branches[3].end = Some(Attachment { branch: 0, point: 0 });
    write_centerline(&path, &line).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.starts_with("# SPACE=LPS, mm\n# 1 loops are open\n"), "{text}");
    let rows: Vec<&str> = text.lines().filter(|l| !l.starts_with('#')).collect();
    let wanted = [
        "1 0 0 0 0.1 2 -1",
        "2 0 0.3333333333333333 0 0.1 2 1",
        "3 0 1 0.0000001 0.1 1 2",
        "4 0 0.5 2 0.1 0.5 2",
        "5 0 0.5 2 0.1 0.5 2",
        "6 0 7 0 0.1 2 4",
        "7 0 0.5 2 0.1 0.5 6",
    ];
    assert_eq!(rows, wanted);
}

#[test]
fn vtp_centerline_has_a_line_from_the_root_to_every_tip() {
    let (_dir, path) = scratch("a.vtp", "");
    write_centerline(&path, &forked_line()).unwrap();
    let (xml, arrays) = arrays(&path);
    assert!(xml.contains("NumberOfLines=\"2\"") && xml.contains("NumberOfPoints=\"6\""));
    assert!(xml.contains("Name=\"SPACE\""));
    let find = |name: &str| &arrays.iter().find(|a| a.0 == name).unwrap().1[..];
    let doubles = |name| bytemuck::pod_collect_to_vec::<u8, f64>(find(name));
    let ints = |name| bytemuck::pod_collect_to_vec::<u8, i32>(find(name));
    assert_eq!(doubles("Radius"), [2.0, 2.0, 1.0, 2.0, 2.0, 0.5]);
    assert_eq!(doubles("MaximumInscribedSphereRadius"), doubles("Radius"));
    assert_eq!(doubles("Abscissa"), [0.0, 1.0 / 3.0, 1.0, 0.0, 1.0 / 3.0, 2.4]);
    assert_eq!(doubles("Points")[..4], [0.0, 0.0, 0.1, 1.0 / 3.0]);
    assert_eq!(ints("connectivity"), [0, 1, 2, 3, 4, 5]);
    assert_eq!(ints("offsets"), [3, 6]);
    assert_eq!((ints("CenterlineIds"), ints("GroupIds")), (vec![0, 1], vec![0, 1]));
    assert_eq!((ints("TractIds"), ints("Blanking")), (vec![0; 2], vec![0; 2]));
}

#[test]
fn branches_vtp_shares_a_group_where_paths_share_a_stretch() {
    // Spheres small enough that both arms leave the trunk's at once.
    let mut line = forked_line();
    for p in line.branches.iter_mut().flat_map(|b| &mut b.points) {
        p.radius_mm = 0.1;
    }
    let (_dir, path) = scratch("a.vtp", "");
    write_branches(&path, &line).unwrap();
    let (xml, arrays) = arrays(&path);
    assert!(xml.contains("NumberOfLines=\"4\"") && xml.contains("NumberOfPoints=\"6\""));
    let find = |name: &str| &arrays.iter().find(|a| a.0 == name).unwrap().1[..];
    let ints = |name| bytemuck::pod_collect_to_vec::<u8, i32>(find(name));
    // The bifurcation reaches from the touching sphere, the fork's own, to the arm's next point.
    assert_eq!(ints("connectivity"), [0, 1, 1, 2, 3, 4, 4, 5]);
    assert_eq!(ints("offsets"), [2, 4, 6, 8]);
    assert_eq!(ints("CenterlineIds"), [0, 0, 1, 1]);
    assert_eq!(ints("TractIds"), [0, 1, 0, 1]);
    assert_eq!(ints("GroupIds"), [0, 1, 0, 1]);
    assert_eq!(ints("Blanking"), [0, 1, 0, 1]);
}

#[test]
fn a_trunk_that_goes_on_behind_its_branch_has_a_line_of_its_own() {
    let mut line = forked_line();
    line.branches.truncate(2);
    let end = CenterlinePoint {
        position_mm: DVec3::new(0.4, -3.0, 0.1),
        radius_mm: 1.0,
        abscissa_mm: 3.4,
    };
    line.branches[0].points.push(end);
    let (_dir, path) = scratch("a.vtp", "");
    write_centerline(&path, &line).unwrap();
    let (_, arrays) = arrays(&path);
    let find = |name: &str| &arrays.iter().find(|a| a.0 == name).unwrap().1[..];
    let ints = |name| bytemuck::pod_collect_to_vec::<u8, i32>(find(name));
    let points = bytemuck::pod_collect_to_vec::<u8, f64>(find("Points"));
    assert_eq!(points[6..9], end.position_mm.to_array(), "the trunk's own tip");
    assert_eq!(ints("CenterlineIds"), [0, 1]);
}

#[test]
fn slicer_markup_is_an_lps_curve_with_the_radius_as_a_measurement() {
    let (_dir, path) = scratch("a.mrk.json", "");
    write_centerline(&path, &forked_line()).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    assert!(json["@schema"].as_str().unwrap().ends_with("markups-schema-v1.0.3.json#"));
    assert_eq!(json["markups"].as_array().unwrap().len(), 3);
    let last = &json["markups"][2];
    assert_eq!((&last["type"], &last["coordinateSystem"]), (&"Curve".into(), &"LPS".into()));
    assert_eq!(last["controlPoints"][1]["position"], serde_json::json!([0.5, 2.0, 0.1]));
    let radius = last["measurements"].as_array().unwrap().iter().find(|m| m["name"] == "Radius");
    assert_eq!(radius.unwrap()["controlPointValues"], serde_json::json!([2.0, 0.5]));
}

#[test]
fn a_centerline_that_is_not_finite_or_not_a_tree_is_not_written() {
    let (dir, _) = scratch("x", "");
    for name in ["b.vtp", "b.csv", "b.swc", "b.mrk.json"] {
        let path = dir.path().join(name);
        let mut line = forked_line();
        line.branches[1].points[1].radius_mm = f64::NAN;
        let message = write_centerline(&path, &line).unwrap_err().to_string();
        assert!(message.contains("point 1 of branch 1"), "{message}");
        line = forked_line();
        line.branches[1].start = Some(Attachment { branch: 1, point: 0 });
        assert!(write_centerline(&path, &line).is_err());
        assert!(!path.exists());
        write_centerline(&path, &Centerline::default()).unwrap();
    }
    assert!(write_centerline(&dir.path().join("b.json"), &forked_line()).is_err());
}

#[test]
fn damaged_files_give_an_error_or_a_sound_mesh_and_never_a_panic() {
    let (dir, _) = scratch("x", "");
    let mut state = 1u64;
    let mut random = move |below: usize| {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
                property float z\nelement face 1\nproperty list uchar int vertex_indices\n\
                end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    for name in ["a.ply", "b.ply", "a.stl", "a.obj", "a.vtp"] {
        let path = dir.path().join(name);
        write_mesh(&path, &chiral()).unwrap();
        let good = if name == "b.ply" { text.into() } else { std::fs::read(&path).unwrap() };
        for _ in 0..1500 {
            let mut bytes = good.clone();
            for _ in 0..=random(3) {
                let at = random(bytes.len());
                match random(4) {
                    0 => bytes[at] = random(256) as u8,
                    1 => bytes[at] ^= 1 << random(8),
                    2 => bytes.insert(at, b"0123456789-. \n\xff"[random(15)]),
                    _ => bytes.truncate(at.max(1)),
                }
            }
            std::fs::write(&path, &bytes).unwrap();
            let Ok((mesh, _)) = read_mesh(&path, None) else { continue };
            assert!(mesh.positions.iter().chain(&mesh.normals).all(|v| v.is_finite()));
            assert!(mesh.faces.iter().flatten().all(|&v| (v as usize) < mesh.positions.len()));
            assert!([0, mesh.positions.len()].contains(&mesh.normals.len()));
        }
    }
}
