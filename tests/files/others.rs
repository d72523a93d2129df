//! Files of other programs that were refused, read wrongly, or accepted without a word: each by a
//! small one of its kind, and by the shared ones where they are.

use std::path::{Path, PathBuf};

use common::volumes::shared_data;
use glam::DVec3;
use intima::formats::{ReadOptions, inspect, read_mesh, read_volume, write_volume};
use intima::geometry::Mesh;
use intima::volume::{Grid, Volume};

/// A file in a folder of its own, which is kept as long.
struct OwnFile(PathBuf, #[allow(dead_code)] tempfile::TempDir);

fn file(name: &str, bytes: impl AsRef<[u8]>) -> OwnFile {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    OwnFile(path, folder)
}

fn mesh(name: &str, bytes: impl AsRef<[u8]>) -> (Mesh, Vec<String>) {
    let own = file(name, bytes);
    read_mesh(&own.0, None).unwrap_or_else(|e| panic!("{e}"))
}

fn area(mesh: &Mesh) -> f64 {
    let twice: f32 = mesh.faces.iter().map(|f| mesh.face_cross(*f).length()).sum();
    f64::from(twice) / 2.0
}

/// An arrowhead whose first corner does not see all of it: 10 mm², a fan has 30.
const ARROW: [[i32; 3]; 4] = [[0, 0, 0], [4, 4, 0], [0, 10, 0], [2, 4, 0]];

#[test]
fn a_concave_polygon_is_not_a_fan() {
    let shape = |turn: usize| -> Vec<[i32; 3]> { (0..4).map(|i| ARROW[(i + turn) % 4]).collect() };
    for turn in 0..4 {
        let v: String = shape(turn).iter().map(|[x, y, z]| format!("v {x} {y} {z}\n")).collect();
        let (obj, _) = mesh("a.obj", format!("{v}f 1 2 3 4\n"));
        let rows: String = shape(turn).iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
        let (ply, _) = mesh(
            "a.ply",
            format!(
                "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n\
                 property float z\nelement face 1\nproperty list uchar int vertex_indices\n\
                 end_header\n{rows}4 0 1 2 3\n"
            ),
        );
        for found in [obj, ply] {
            assert!((area(&found) - 10.0).abs() < 1e-5, "{turn}: {}", area(&found));
            assert!(found.faces.iter().all(|f| found.face_cross(*f).z > 0.0), "one side");
        }
    }
}

#[test]
fn an_obj_that_names_normals_it_does_not_hold_is_read() {
    let (found, warnings) = mesh("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1//1 2//2 3//3\n");
    assert_eq!((found.faces.len(), found.normals.len()), (1, 0));
    assert!(warnings.iter().any(|w| w.contains("normals that are not there")), "{warnings:?}");
}

#[test]
fn an_stl_in_capitals_is_text_and_one_of_no_triangles_is_empty() {
    let text = "SOLID A\nFACET NORMAL 0 0 1\nOUTER LOOP\nVERTEX 0 0 0\nVERTEX 1 0 0\nVERTEX 0 1 0\n\
                ENDLOOP\nENDFACET\nENDSOLID A\n";
    assert_eq!(mesh("a.stl", text).0.faces.len(), 1);
    let (none, warnings) = mesh("a.stl", [0u8; 84]);
    assert!(none.faces.is_empty() && warnings.iter().any(|w| w.contains("no faces")));
}

#[test]
fn a_mesh_in_metres_is_asked_about() {
    let tetrahedron = |scale: f64| {
        let v = format!("v 0 0 0\nv {scale} 0 0\nv 0 {scale} 0\nv 0 0 {scale}\n");
        mesh("a.obj", format!("{v}f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")).1
    };
    let is_asked = |scale: f64| tetrahedron(scale).iter().any(|w| w.contains("are they?"));
    assert_eq!([0.15, 150.0, 150_000.0].map(is_asked), [true, false, true]);
}

/// A NIfTI-1 file of 4 x 3 x 2 voxels that is changed at some bytes.
fn nifti(name: &str, changes: &[(usize, &[u8])]) -> Result<(Volume, Vec<String>), String> {
    let own = file(name, []);
    let grid = Grid::axis_aligned([4, 3, 2], [0.5, 0.75, 2.0]);
    let volume = Volume::new(grid, (0..24).collect::<Vec<i16>>().into());
    write_volume(&own.0, &volume).unwrap();
    let mut bytes = std::fs::read(&own.0).unwrap();
    for (at, with) in changes {
        bytes[*at..at + with.len()].copy_from_slice(with);
    }
    std::fs::write(&own.0, bytes).unwrap();
    let options = ReadOptions::default();
    let notes = inspect(&own.0, &options).map_err(|e| e.to_string())?.notes;
    Ok((read_volume(&own.0, &options).map_err(|e| e.to_string())?, notes))
}

#[test]
fn a_nifti_whose_sform_is_empty_is_read_by_its_qform_and_one_whose_forms_disagree_says_so() {
    const SROW: usize = 280;
    let (whole, notes) = nifti("a.nii", &[]).unwrap();
    assert!(notes.is_empty(), "{notes:?}");
    for row in [0f32, f32::NAN] {
        let rows = row.to_le_bytes().repeat(12);
        let (found, notes) = nifti("a.nii", &[(SROW, &rows)]).unwrap();
        assert_eq!(found.grid, whole.grid);
        assert!(notes.iter().any(|n| n.contains("the qform is taken")), "{notes:?}");
    }
    let (found, notes) = nifti("a.nii", &[(SROW + 12, &40f32.to_le_bytes())]).unwrap();
    assert_eq!(found.grid.origin_mm.x, -40.0);
    assert!(notes.iter().any(|n| n.contains("disagree by up to 40.0 mm")), "{notes:?}");
}

#[test]
fn one_volume_of_a_series_in_time_is_read_and_the_choice_is_asked_for() {
    let volume = |path: &Path, n: Option<usize>| {
        let options = ReadOptions { volume: n, ..Default::default() };
        read_volume(path, &options).map_err(|e| e.to_string())
    };
    // Two volumes of 4 x 3 x 2 voxels one after the other, as NIfTI plain and gzipped, and as NRRD.
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let grid = Grid::axis_aligned([4, 3, 4], [1.0; 3]);
    let both = Volume::new(grid, (0..48).collect::<Vec<i16>>().into());
    write_volume(&at("a.nii"), &both).unwrap();
    let mut bytes = std::fs::read(at("a.nii")).unwrap();
    for (field, value) in [4i16, 4, 3, 2, 2].iter().enumerate() {
        bytes[40 + 2 * field..42 + 2 * field].copy_from_slice(&value.to_le_bytes());
    }
    std::fs::write(at("a.nii"), &bytes).unwrap();
    std::fs::write(at("b.nii.gz"), gzipped(&bytes)).unwrap();
    let head = "NRRD0004\ntype: short\nencoding: raw\nendian: little\ndimension: 4\n\
                sizes: 4 3 2 2\nkinds: domain domain domain time\nspacings: 1 1 1 nan\n\n";
    std::fs::write(at("c.nrrd"), [head.as_bytes(), &bytes[352..]].concat()).unwrap();
    for name in ["a.nii", "b.nii.gz", "c.nrrd"] {
        let values = |n: usize| {
            let found = volume(&at(name), Some(n)).unwrap_or_else(|e| panic!("{name}: {e}"));
            (found.grid.dims.z, found.real(0), found.real(23))
        };
        assert_eq!([values(0), values(1)], [(2, 0.0, 23.0), (2, 24.0, 47.0)], "{name}");
        let why = volume(&at(name), None).unwrap_err();
        assert!(why.contains("--volume 0 to 1 takes one"), "{name}: {why}");
        assert!(volume(&at(name), Some(2)).unwrap_err().contains("counted from 0"), "{name}");
        let notes = inspect(&at(name), &ReadOptions::default()).unwrap().notes;
        assert!(notes.iter().any(|n| n.contains("2 volumes")), "{name}: {notes:?}");
    }
}

fn gzipped(bytes: &[u8]) -> Vec<u8> {
    let mut zipped = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut zipped, bytes).unwrap();
    zipped.finish().unwrap()
}

#[test]
fn a_pair_of_gzipped_header_and_image_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("a.nii");
    let volume = Volume::new(Grid::axis_aligned([4, 3, 2], [1.0; 3]), vec![7i16; 24].into());
    write_volume(&whole, &volume).unwrap();
    let bytes = std::fs::read(&whole).unwrap();
    let mut header = bytes[..348].to_vec();
    header[108..112].copy_from_slice(&0f32.to_le_bytes());
    header[344..348].copy_from_slice(b"ni1\0");
    for (header_name, image_name) in
        [("b.hdr.gz", "b.img.gz"), ("c.hdr.gz", "c.img"), ("d.hdr", "d.img.gz")]
    {
        for (name, part) in [(header_name, &header[..]), (image_name, &bytes[352..])] {
            let mut part = part.to_vec();
            if name.ends_with(".gz") {
                part = gzipped(&part);
            }
            std::fs::write(folder.path().join(name), part).unwrap();
        }
        for name in [header_name, image_name] {
            let found = read_volume(&folder.path().join(name), &ReadOptions::default()).unwrap();
            assert_eq!((found.grid, found.real(5)), (volume.grid, 7.0), "{name}");
        }
    }
}

fn nrrd(fields: &str) -> Result<Volume, String> {
    let head = format!("NRRD0004\ntype: uchar\nencoding: raw\n{fields}\n\n");
    let own = file("a.nrrd", [head.as_bytes(), &[1; 96]].concat());
    read_volume(&own.0, &ReadOptions::default()).map_err(|e| e.to_string())
}

#[test]
fn least_places_of_nrrd_axes_are_edges_of_cells_unless_they_are_nodes() {
    let fields = "dimension: 3\nsizes: 4 3 2\nspacings: 0.5 0.75 2\naxis mins: 1 2 3";
    let origin = |more: &str| nrrd(&format!("{fields}{more}")).unwrap().grid.origin_mm.to_array();
    assert_eq!(origin(""), [1.25, 2.375, 4.0]);
    assert_eq!(origin("\ncenters: cell cell cell"), [1.25, 2.375, 4.0]);
    assert_eq!(origin("\ncenterings: node node cell"), [1.0, 2.0, 4.0]);
}

#[test]
fn messages_name_what_is_not_supported() {
    let grid = "sizes: 4 3 2\nspacings: 1 1 1";
    let vectors = "dimension: 4\nsizes: 3 4 3 2\nspacings: nan 1 1 1\nkinds: 3-vector space space \
                   space";
    for (fields, words) in [
        (format!("dimension: 3\n{grid}\ndata file: LIST\na.raw\nb.raw"), "data file: LIST"),
        (vectors.to_owned(), "vectors: axis 0 holds 3 values a voxel"),
        (
            format!("dimension: 3\n{grid}\nencoding: gzip\nbyte skip: -1"),
            "samples at the end of the file are of encoding raw alone",
        ),
    ] {
        let why = nrrd(&fields).unwrap_err();
        assert!(why.contains(words), "{why}");
    }
    let dicom = [&[0; 128][..], b"DICM", &[0; 600]].concat();
    for (name, bytes, words) in [
        ("a.dcm.gz", gzipped(&dicom), "a gzipped DICOM file"),
        ("a.nrrd.gz", gzipped(b"NRRD0004\n"), "a gzipped NRRD file"),
        ("a.gz", gzipped(b"words"), "a gzip file of something else"),
        ("a.npz", b"PK\x03\x04".to_vec(), "arrays of NumPy"),
    ] {
        let own = file(name, bytes);
        let why = read_volume(&own.0, &ReadOptions::default()).unwrap_err().to_string();
        assert!(why.contains(words), "{name}: {why}");
    }
}

#[test]
fn shared_files_of_other_programs_give_what_they_must() {
    let Some(folder) = shared_data().map(|data| data.join("faults")) else { return };
    for name in ["concave.obj", "concave.vtp"] {
        let (found, _) = read_mesh(&folder.join(name), None).unwrap();
        assert!((area(&found) - 82.0).abs() < 1e-3, "{name}: {}", area(&found));
    }
    for name in ["obj_normal_absent.obj", "stl_upper_case.stl"] {
        assert!(!read_mesh(&folder.join(name), None).unwrap().0.faces.is_empty(), "{name}");
    }
    let (_, warnings) = read_mesh(&folder.join("mesh_in_metres.ply"), None).unwrap();
    assert!(warnings.iter().any(|w| w.contains("are they?")), "{warnings:?}");
    let options = ReadOptions::default();
    for name in ["jpegls_zero_before_eoi.dcm", "minimal.hdr.gz", "minimal.img.gz"] {
        read_volume(&folder.join(name), &options).unwrap_or_else(|e| panic!("{name}: {e}"));
    }
    let edges = read_volume(&folder.join("nrrd_axis_mins.nrrd"), &options).unwrap();
    assert!((edges.grid.origin_mm - DVec3::new(1.35, 2.4, 4.25)).length() < 1e-9);
    let segments = inspect(&folder.join("seg_label_latin1.dcm"), &options).unwrap().segments;
    assert_eq!(segments[0].name, "Trachée");
    let named = ReadOptions { segments: vec!["Trachée".into()], ..Default::default() };
    read_volume(&folder.join("seg_label_latin1.dcm"), &named).unwrap();
    for (name, words) in [
        ("nifti_sform_zero_qform_good.nii", "the qform is taken"),
        ("nifti_forms_disagree.nii", "sform and qform disagree"),
    ] {
        let notes = inspect(&folder.join(name), &options).unwrap().notes;
        assert!(notes.iter().any(|n| n.contains(words)), "{name}: {notes:?}");
    }
    for (name, words) in [
        ("siemens_dwi_0.dcm.gz", "a gzipped DICOM file"),
        ("nrrd_data_file_list.nhdr", "data file: LIST"),
        ("siemens_mosaic.dcm", "mosaic"),
    ] {
        let why = read_volume(&folder.join(name), &options).unwrap_err().to_string();
        assert!(why.contains(words), "{name}: {why}");
    }
}
