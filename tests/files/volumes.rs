//! Volumes keep their place in the patient through every reader and writer.

use common::volumes::{NiftiHeader, phantom, read, refusal, shared_data, unzip};
use glam::{DMat3, DVec3, UVec3};
use intima::formats::{ReadOptions, inspect, write_vector_field, write_volume};
use intima::volume::{Grid, Rescale, SampleType, Samples, Volume};

/// Real values at a few labelled points by world position.
fn assert_same_world(a: &Volume, b: &Volume, tolerance_mm: f64, what: &str) {
    assert_eq!(a.grid.dims, b.grid.dims, "{what}");
    for i in 0..a.grid.len() {
        let v = a.real(i);
        if v == 0.0 {
            continue;
        }
        let world = a.grid.world_from_voxel().transform_point3(a.grid.voxel(i).as_dvec3());
        let there = b.grid.nearest_voxel(world).unwrap_or_else(|| panic!("{what}: point lost"));
        let back = b.grid.world_from_voxel().transform_point3(there.as_dvec3());
        assert!((back - world).length() < tolerance_mm, "{what}: {world} came back as {back}");
        let got = b.real(b.grid.index(there));
        assert!((got - v).abs() <= 1e-6 * v.abs(), "{what}: {v} came back as {got}");
    }
    assert_eq!(a.grid.is_left_handed(), b.grid.is_left_handed(), "{what}");
    assert!((a.grid.spacing_mm - b.grid.spacing_mm).length() < 1e-5, "{what}");
}

#[test]
fn labelled_points_keep_their_place_through_every_writer_and_reader() {
    let dir = tempfile::tempdir().unwrap();
    for left_handed in [false, true] {
        for name in ["p.nrrd", "p.nii", "p.nii.gz", "p.mha", "p.mhd"] {
            let path = dir.path().join(name);
            let before = phantom(left_handed);
            write_volume(&path, &before).unwrap();
            let after = read(&path).unwrap();
            let what = format!("{name}, left-handed {left_handed}");
            assert_same_world(&before, &after, 1e-3, &what);
            assert_eq!(after.samples, before.samples, "{what}");
            let info = inspect(&path, &ReadOptions::default()).unwrap().image.unwrap();
            assert_eq!(info.handedness, if left_handed { "left" } else { "right" }, "{what}");
            assert_eq!(info.dims, [7, 5, 4], "{what}");
        }
    }
}

#[test]
fn a_sheared_grid_is_kept_as_it_is() {
    let dir = tempfile::tempdir().unwrap();
    let mut volume = phantom(false);
    volume.grid.direction.z_axis =
        (volume.grid.direction.z_axis + 0.3 * volume.grid.direction.y_axis).normalize();
    assert!(!volume.grid.is_orthogonal());
    for name in ["s.nrrd", "s.nii.gz", "s.mha"] {
        let path = dir.path().join(name);
        write_volume(&path, &volume).unwrap();
        assert_same_world(&volume, &read(&path).unwrap(), 1e-3, name);
    }
}

#[test]
fn every_sample_type_survives_every_format() {
    let dir = tempfile::tempdir().unwrap();
    let grid = Grid::axis_aligned([3, 2, 2], [0.5, 0.75, 2.0]);
    let all: Vec<Samples> = vec![
        (0u8..12).map(|v| v * 21).collect::<Vec<_>>().into(),
        (0i8..12).map(|v| v * 10 - 60).collect::<Vec<_>>().into(),
        (0u16..12).map(|v| v * 5900).collect::<Vec<_>>().into(),
        (0i16..12).map(|v| v * 2500 - 15000).collect::<Vec<_>>().into(),
        (0u32..12).map(|v| v * 350_000_000).collect::<Vec<_>>().into(),
        (0i32..12).map(|v| v * 170_000_000 - 1_000_000_000).collect::<Vec<_>>().into(),
        (0u64..12).map(|v| v << 59).collect::<Vec<_>>().into(),
        (0i64..12).map(|v| (v - 6) << 60).collect::<Vec<_>>().into(),
        (0u8..12).map(|v| f32::from(v) * 0.1 - 0.3).collect::<Vec<_>>().into(),
        (0u8..12).map(|v| f64::from(v) * 0.1 - 0.3).collect::<Vec<_>>().into(),
    ];
    for samples in all {
        let before = Volume::new(grid, samples);
        for name in ["t.nrrd", "t.nii", "t.nii.gz", "t.mha", "t.mhd"] {
            let path = dir.path().join(name);
            write_volume(&path, &before).unwrap();
            assert_eq!(read(&path).unwrap(), before, "{name}");
        }
    }
}

#[test]
fn a_rescale_is_carried_by_nifti_and_applied_elsewhere() {
    let dir = tempfile::tempdir().unwrap();
    let mut volume = phantom(false);
    for (slope, intercept, kind) in [
        (1.0, -1024.0, SampleType::I16),
        (100.0, 0.0, SampleType::I32),
        (0.25, 33.5, SampleType::F32),
    ] {
        volume.rescale = Rescale { slope, intercept };
        for name in ["r.nii.gz", "r.nrrd", "r.mha", "r.mhd"] {
            let path = dir.path().join(name);
            write_volume(&path, &volume).unwrap();
            let after = read(&path).unwrap();
            for i in 0..volume.grid.len() {
                assert_eq!(after.real(i), volume.real(i), "{name}");
            }
            if name == "r.nii.gz" {
                assert_eq!(after.rescale, volume.rescale);
                assert_eq!(after.samples, volume.samples);
            } else {
                assert_eq!(after.samples.sample_type(), kind, "{name}");
            }
        }
    }
}

/// The numbers 0, 1, … 23 as bytes of one type and byte order.
fn counted(kind: SampleType, big: bool) -> Vec<u8> {
    let mut samples = Samples::zeroed(kind, 24);
    match &mut samples {
        Samples::U8(s) => (0..).zip(s.iter_mut()).for_each(|(n, v)| *v = n),
        Samples::I8(s) => (0..).zip(s.iter_mut()).for_each(|(n, v)| *v = n),
        Samples::U16(s) => (0..).zip(s.iter_mut()).for_each(|(n, v)| *v = n),
        Samples::I16(s) => (0..).zip(s.iter_mut()).for_each(|(n, v)| *v = n),
        Samples::U32(s) => (0..).zip(s.iter_mut()).for_each(|(n, v)| *v = n),
        Samples::I32(s) => (0..).zip(s.iter_mut()).for_each(|(n, v)| *v = n),
        Samples::U64(s) => (0..).zip(s.iter_mut()).for_each(|(n, v)| *v = n),
        Samples::I64(s) => (0..).zip(s.iter_mut()).for_each(|(n, v)| *v = n),
        Samples::F32(s) => (0u8..).zip(s.iter_mut()).for_each(|(n, v)| *v = n.into()),
        Samples::F64(s) => (0u8..).zip(s.iter_mut()).for_each(|(n, v)| *v = n.into()),
    }
    if big != cfg!(target_endian = "big") {
        samples.swap_bytes();
    }
    samples.bytes().to_vec()
}

fn assert_counted(volume: &Volume, kind: SampleType, what: &str) {
    assert_eq!(volume.samples.sample_type(), kind, "{what}");
    assert_eq!(volume.grid.dims, UVec3::new(2, 3, 4), "{what}");
    for i in 0..24 {
        assert_eq!(volume.samples.get(i), i as f64, "{what}");
    }
}

#[test]
fn every_nrrd_type_name_in_both_byte_orders() {
    use SampleType::*;
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("t.nrrd");
    let names: [(SampleType, &[&str]); 10] = [
        (I8, &["signed char", "int8", "int8_t"]),
        (U8, &["uchar", "unsigned char", "uint8", "uint8_t"]),
        (I16, &["short", "short int", "signed short", "signed short int", "int16", "int16_t"]),
        (U16, &["ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"]),
        (I32, &["int", "signed int", "int32", "int32_t"]),
        (U32, &["uint", "unsigned int", "uint32", "uint32_t"]),
        (I64, &["longlong", "long long", "long long int", "signed long long", "int64", "int64_t"]),
        (U64, &["ulonglong", "unsigned long long", "unsigned long long int", "uint64_t"]),
        (F32, &["float"]),
        (F64, &["double"]),
    ];
    for (kind, names) in names {
        for name in names {
            for (big, endian) in [(false, "little"), (true, "big")] {
                let mut file = format!(
                    "NRRD0004\n# note\ntype: {name}\ndimension: 3\nsizes: 2 3 4\n\
                     encoding: raw\nendian: {endian}\nspacings: 1 2 3\nkey:=text\n\n"
                )
                .into_bytes();
                file.extend(counted(kind, big));
                std::fs::write(&path, file).unwrap();
                let volume = read(&path).unwrap();
                assert_counted(&volume, kind, &format!("{name} {endian}"));
                assert_eq!(volume.grid.spacing_mm, DVec3::new(1.0, 2.0, 3.0));
            }
        }
    }
}

#[test]
fn every_metaimage_type_in_both_byte_orders() {
    use SampleType::*;
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("t.mha");
    for (kind, name) in [
        (I8, "MET_CHAR"),
        (U8, "MET_UCHAR"),
        (I16, "MET_SHORT"),
        (U16, "MET_USHORT"),
        (I32, "MET_INT"),
        (I32, "MET_LONG"),
        (U32, "MET_UINT"),
        (U32, "MET_ULONG"),
        (I64, "MET_LONG_LONG"),
        (U64, "MET_ULONG_LONG"),
        (F32, "MET_FLOAT"),
        (F64, "MET_DOUBLE"),
    ] {
        for (order, big) in [("False", false), ("True", true)] {
            for field in ["BinaryDataByteOrderMSB", "ElementByteOrderMSB"] {
                let mut file = format!(
                    "NDims = 3\nDimSize = 2 3 4\nElementType = {name}\n{field} = {order}\n\
                     ElementSpacing = 1 2 3\nElementDataFile = LOCAL\n"
                )
                .into_bytes();
                file.extend(counted(kind, big));
                std::fs::write(&path, file).unwrap();
                assert_counted(&read(&path).unwrap(), kind, &format!("{name} {order}"));
            }
        }
    }
}

#[test]
fn every_nifti_type_in_both_byte_orders() {
    use SampleType::*;
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("t.nii");
    for (kind, code) in [
        (U8, 2),
        (I16, 4),
        (I32, 8),
        (F32, 16),
        (F64, 64),
        (I8, 256),
        (U16, 512),
        (U32, 768),
        (I64, 1024),
        (U64, 1280),
    ] {
        for big in [false, true] {
            let header = NiftiHeader { big, code, ..NiftiHeader::default() };
            let mut file = header.bytes();
            file.extend(counted(kind, big));
            std::fs::write(&path, file).unwrap();
            assert_counted(&read(&path).unwrap(), kind, &format!("{kind:?} big {big}"));
        }
    }
}

#[test]
fn nifti_units_and_frames_are_heeded() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("t.nii");
    let write = |h: NiftiHeader| {
        let mut file = h.bytes();
        file.extend(counted(SampleType::U8, false));
        std::fs::write(&path, file).unwrap();
    };
    let plain = NiftiHeader { code: 2, ..NiftiHeader::default() };
    // pixdim alone: right, anterior, superior, so -x -y +z in LPS.
    write(plain.clone());
    let g = read(&path).unwrap().grid;
    assert_eq!(g.direction, DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)));
    write(NiftiHeader { units: 3, pixdim: [1000.0, 2000.0, 3000.0], ..plain.clone() });
    assert!((read(&path).unwrap().grid.spacing_mm - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-9);
    write(NiftiHeader { units: 1, pixdim: [0.001, 0.002, 0.003], ..plain.clone() });
    assert!((read(&path).unwrap().grid.spacing_mm - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-6);
    // A quarter turn about z, slices counted downwards.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    write(NiftiHeader {
        qform: Some((-1.0, [0.0, 0.0, half], [10.0, 20.0, 30.0])),
        ..plain.clone()
    });
    let g = read(&path).unwrap().grid;
    let want = DMat3::from_cols(-DVec3::Y, DVec3::X, -DVec3::Z);
    assert!((g.direction - want).abs_diff_eq(DMat3::ZERO, 1e-6), "{:?}", g.direction);
    assert_eq!(g.origin_mm, DVec3::new(-10.0, -20.0, 30.0));
    assert!(g.is_left_handed() == (want.determinant() < 0.0));
    write(NiftiHeader { dim4: 1, ..plain.clone() });
    assert!(read(&path).is_ok());
    write(NiftiHeader { dim4: 2, ..plain.clone() });
    assert!(refusal(&path).contains("2 volumes one after the other; --volume 0 to 1"));
    write(NiftiHeader { code: 1792, ..plain });
    assert!(refusal(&path).contains("complex"));
}

#[test]
fn nrrd_spaces_become_lps() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("t.nrrd");
    for (space, signs) in [
        ("left-posterior-superior", [1.0, 1.0, 1.0]),
        ("LPS", [1.0, 1.0, 1.0]),
        ("right-anterior-superior", [-1.0, -1.0, 1.0]),
        ("RAS", [-1.0, -1.0, 1.0]),
        ("left-anterior-superior", [1.0, -1.0, 1.0]),
        ("3D-right-handed", [1.0, 1.0, 1.0]),
        ("3D-left-handed", [1.0, -1.0, 1.0]),
    ] {
        let mut file = format!(
            "NRRD0005\ntype: uint8\ndimension: 3\nsizes: 2 3 4\nencoding: raw\nspace: {space}\n\
             space directions: (2,0,0) (0,0,3) (0,4,0)\nspace origin: (5, 6, 7)\n\n"
        )
        .into_bytes();
        file.extend(counted(SampleType::U8, false));
        std::fs::write(&path, file).unwrap();
        let g = read(&path).unwrap().grid;
        let s = DVec3::from(signs);
        assert_eq!(g.origin_mm, DVec3::new(5.0, 6.0, 7.0) * s, "{space}");
        let last = g.world_from_voxel().transform_point3(DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(last, DVec3::new(7.0, 18.0, 13.0) * s, "{space}");
    }
}

#[test]
fn a_nrrd_without_a_space_says_that_lps_is_assumed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("t.nrrd");
    for (more, is_said) in [("", true), ("space dimension: 3\n", true), ("space: LPS\n", false)] {
        let vectors = if more.is_empty() {
            "spacings: 1 2 3"
        } else {
            "space directions: (1,0,0) (0,2,0) (0,0,3)"
        };
        let head = format!(
            "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 3 4\nencoding: raw\n{more}{vectors}\n\n"
        );
        std::fs::write(&path, [head.as_bytes(), &[0; 24]].concat()).unwrap();
        let notes = inspect(&path, &ReadOptions::default()).unwrap().notes;
        assert_eq!(notes.iter().any(|n| n.contains("no space; LPS")), is_said, "{notes:?}");
    }
}

#[test]
fn detached_data_is_found_skipped_into_and_kept_inside_its_folder() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("t.nhdr");
    let mut data = b"one line\nanother\nxyz".to_vec();
    data.extend(counted(SampleType::I16, false));
    std::fs::create_dir(dir.path().join("in")).unwrap();
    std::fs::write(dir.path().join("in/t.raw"), &data).unwrap();
    let header = |extra: &str| {
        let text = format!(
            "NRRD0004\ntype: short\ndimension: 3\nsizes: 2 3 4\nencoding: raw\nendian: little\n\
             spacings: 1 1 1\n{extra}\n"
        );
        std::fs::write(&path, text).unwrap();
    };
    header("line skip: 2\nbyte skip: 3\ndata file: in/t.raw");
    assert_counted(&read(&path).unwrap(), SampleType::I16, "line and byte skip");
    header("byteskip: -1\ndatafile: ./in/t.raw");
    assert_counted(&read(&path).unwrap(), SampleType::I16, "byte skip -1");
    for outside in ["../t.raw", "/etc/passwd", "in/../../t.raw"] {
        header(&format!("data file: {outside}"));
        assert!(refusal(&path).contains("inside the header's folder"));
    }
    header("data file: LIST\nin/t.raw: 1");
    assert!(refusal(&path).contains("several files"));
    let mhd = dir.path().join("t.mhd");
    let text = "NDims = 3\nDimSize = 2 3 4\nElementType = MET_SHORT\nHeaderSize = -1\n\
                ElementSpacing = 1 1 1\nElementDataFile = in/t.raw\n";
    std::fs::write(&mhd, text).unwrap();
    assert_counted(&read(&mhd).unwrap(), SampleType::I16, "HeaderSize -1");
}

#[test]
fn text_samples_and_a_leading_axis_of_one_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("t.nrrd");
    let numbers: Vec<String> = (0..24).map(|n| n.to_string()).collect();
    let head = "NRRD0004\ntype: float\ndimension: 4\nsizes: 1 2 3 4\nencoding: ascii\n\
                kinds: vector domain domain domain\n\
                space: LPS\nspace directions: none (1,0,0) (0,1,0) (0,0,1)\n\n";
    std::fs::write(&path, format!("{head}{}\n", numbers.join(" "))).unwrap();
    assert_counted(&read(&path).unwrap(), SampleType::F32, "ascii");
    let grid = Grid::axis_aligned([2, 2, 2], [1.0; 3]);
    let field: Vec<f32> = (0u8..24).map(f32::from).collect();
    write_vector_field(&path, &grid, 3, &field).unwrap();
    assert!(refusal(&path).contains("axis 0 holds 3 values a voxel"));
    assert!(write_vector_field(&path, &grid, 2, &field).is_err());
}

#[test]
fn unknown_files_and_zips_are_told_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.txt");
    std::fs::write(&path, "hello").unwrap();
    assert!(refusal(&path).contains(".nrrd"));
    std::fs::write(&path, b"PK\x03\x04rest").unwrap();
    assert!(refusal(&path).contains("unzip it"));
    for name in ["a.mgz", "B.MGH"] {
        let path = dir.path().join(name);
        std::fs::write(&path, b"\x1f\x8brest").unwrap();
        assert!(refusal(&path).contains(".mgz, .mgh"), "a volume of FreeSurfer is named");
    }
    let gone = read(&dir.path().join("gone.nrrd")).unwrap_err();
    assert!(gone.is_bad_input());
    assert!(write_volume(&dir.path().join("a.jpg"), &phantom(false)).is_err());
}

fn count(v: &Volume, yes: impl Fn(f64) -> bool) -> usize {
    (0..v.grid.len()).filter(|&i| yes(v.real(i))).count()
}

#[test]
fn real_volumes_have_their_published_counts() {
    let Some(data) = shared_data() else { return };
    let open = |name: &str| read(&data.join(name)).unwrap();
    for (name, voxels) in [
        ("airway_label_lidc1.nii.gz", 207_263),
        ("airway_label_lidc4.nii.gz", 356_731),
        ("colon_ct_prone_half_label.nrrd", 885_347),
        ("colon_label_1.nii.gz", 2_785_172),
        ("colon_label_2.nii.gz", 4_546_993),
        ("brain_vessels_label.nii.gz", 187_876),
    ] {
        assert_eq!(count(&open(name), |v| v == 1.0), voxels, "{name}");
    }
    assert_eq!(count(&open("aorta_mra_levelset.mha"), |v| v < 0.0), 11_590);
    assert_eq!(count(&open("CT_pitch.nii.gz"), |v| v >= 80.0), 502_598);
    let avm = open("CT_AVM.nii.gz");
    assert!((avm.range().unwrap().1 - 563.2).abs() < 0.05);
    assert!((avm.rescale.slope - 2.2086).abs() < 1e-4);
    assert_eq!(open("colon_ct_prone_half.nrrd").range(), Some((-1024.0, 2160.0)));
    assert_eq!(open("head_ct_cranium.nrrd").range(), Some((-1024.0, 2986.0)));
    let aneurism = open("aneurism.nrrd");
    assert_eq!(aneurism.range(), Some((0.0, 255.0)));
    assert_eq!(aneurism.grid.dims, UVec3::splat(256));
    let aorta = open("aorta_mra.mha");
    assert_eq!(aorta.grid.direction, DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)));
    assert!((aorta.range().unwrap().1 - 2570.2).abs() < 0.05);
    let airway = open("airway_label_lidc1.nii.gz").grid;
    assert!(
        (airway.direction - DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)))
            .abs_diff_eq(DMat3::ZERO, 1e-6)
    );
    let oblique = open("chris_MRA.nii.gz").grid;
    assert!((oblique.direction.x_axis - DVec3::new(-0.997, 0.001, 0.075)).length() < 2e-3);
}

#[test]
fn one_head_in_48_orientations_is_one_head() {
    let Some(dir) = unzip("nifti_48_orientations.zip") else { return };
    let files = std::fs::read_dir(dir.path().join("nifti_space")).unwrap();
    // Each is named by its axes; others there are not orientations of it.
    let is_code = |p: &std::path::PathBuf| {
        let name = p.file_name().unwrap().to_string_lossy();
        name.len() == "LPS.nii.gz".len() && name[..3].bytes().all(|b| b.is_ascii_uppercase())
    };
    let files: Vec<_> = files.map(|e| e.unwrap().path()).filter(is_code).collect();
    assert_eq!(files.len(), 48);
    let first = read(&files[0]).unwrap();
    for file in &files[1..] {
        let volume = read(file).unwrap();
        let voxel_from_first = volume.grid.voxel_from_world() * first.grid.world_from_voxel();
        let mut worst = 0.0f64;
        for i in 0..first.grid.len() {
            let [nx, ny] = [first.grid.dims.x, first.grid.dims.y].map(|n| n as usize);
            let v = UVec3::from([i % nx, i / nx % ny, i / nx / ny].map(|n| n as u32));
            let there = voxel_from_first.transform_point3(v.as_dvec3());
            worst = worst.max((there - there.round()).abs().max_element());
            let at = volume.grid.index(there.round().as_uvec3());
            assert_eq!(volume.real(at), first.real(i), "{}: voxel {v}", file.display());
        }
        assert!(worst < 1e-3, "{}: {worst} voxels off", file.display());
    }
}

#[test]
fn the_real_chest_ct_has_its_published_place_and_range() {
    let Some(dir) = unzip("chest_ct_fnndsc.zip") else { return };
    let v = read(&dir.path().join("chest_ct_fnndsc")).unwrap();
    assert_eq!(v.grid.dims, UVec3::new(512, 512, 175));
    assert_eq!(v.grid.spacing_mm, DVec3::new(0.78125, 0.78125, 1.0));
    assert!((v.grid.origin_mm - DVec3::new(-201.0, -59.0, -579.8)).length() < 1e-3);
    assert_eq!(v.range(), Some((-1000.0, 1979.0)));
}

#[test]
fn a_closed_mesh_as_input_is_the_lumen_it_encloses() {
    use intima::session::{Session, SessionError, Settings, Source, VolumeSource};
    use intima::volume::phantom::{Kind, Phantom};
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("wall.stl");
    let mask = Phantom::new(Kind::Bend, 48, [1.0; 3]).unwrap().mask();
    let source = Source::Image(VolumeSource::Memory(std::sync::Arc::new(mask)));
    let made = Session::new(source, Settings::default()).unwrap();
    let wanted = made.lumen().unwrap().lumen.volume_ml();
    let mut mesh = made.wall().unwrap().mesh.clone();
    intima::formats::write_mesh(&file, &mesh).unwrap();
    let session = |spacing: Option<f64>| {
        let options = ReadOptions { mesh_spacing_mm: spacing, ..ReadOptions::default() };
        let source = Source::Image(VolumeSource::File { path: file.clone(), options });
        Session::new(source, Settings::default()).unwrap()
    };
    for spacing in [None, Some(0.5)] {
        let found = session(spacing).lumen().unwrap();
        let lumen = &found.lumen;
        assert!(spacing.is_none_or(|s| lumen.grid.spacing_mm == glam::DVec3::splat(s)));
        let off = lumen.volume_ml() / wanted - 1.0;
        assert!(off.abs() < 0.03, "{spacing:?}: off by {off}");
    }
    mesh.faces.pop();
    intima::formats::write_mesh(&file, &mesh).unwrap();
    let open = session(None).lumen().err().unwrap();
    assert!(matches!(open, SessionError::Enclosed { .. }));
    assert!(open.to_string().contains("3 edges without a neighbouring face"), "{open}");
}
