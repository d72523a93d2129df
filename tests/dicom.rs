//! DICOM slices become the volume they were, or are refused with the reason.

#[path = "common/volumes.rs"]
mod common;

use std::path::{Path, PathBuf};

use common::{dicom_slice, read, refusal, unzip};
use glam::{DVec3, UVec3};
use intima::formats::{FormatError, ReadOptions, inspect, read_volume};
use intima::volume::{SampleType, Volume};

fn series(dir: &Path, places: &[f64], edit: impl Fn(usize, &mut common::Slice)) {
    for (n, z) in places.iter().enumerate() {
        let mut slice = common::Slice { position: [-5.0, 7.0, *z], ..common::Slice::default() };
        edit(n, &mut slice);
        // Names run against the order of the slices.
        let name = format!("{:03}.dcm", places.len() - n);
        std::fs::write(dir.join(name), dicom_slice(&slice)).unwrap();
    }
}

#[test]
fn dicom_slices_are_ordered_by_place_and_their_bits_tidied() {
    for (implicit, signed) in [(false, false), (false, true), (true, false), (true, true)] {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("notes.txt"), "not an image").unwrap();
        series(dir.path(), &[4.0, 0.0, 2.0], |n, s| {
            s.implicit = implicit;
            s.signed = signed;
            // 12 bits stored: the upper four hold rubbish.
            let low: i16 = if signed { -7 } else { 100 };
            s.pixels =
                (0..12).map(|p| ((low + n as i16) as u16 & 0xfff | 0x5000) + p % 2).collect();
        });
        let v = read(dir.path()).unwrap();
        assert_eq!(v.grid.dims, UVec3::new(4, 3, 3));
        assert_eq!(v.grid.origin_mm, DVec3::new(-5.0, 7.0, 0.0));
        assert_eq!(v.grid.spacing_mm, DVec3::new(0.5, 0.75, 2.0));
        let base = if signed { -7.0 } else { 100.0 } - 1024.0;
        assert_eq!([v.real(0), v.real(12), v.real(24)], [base + 1.0, base + 2.0, base]);
        let info = inspect(dir.path(), &ReadOptions::default()).unwrap();
        assert_eq!(info.series[0].slices, 3);
        assert!(info.notes[0].starts_with("1 files that are not DICOM"), "{:?}", info.notes);
    }
}

#[test]
fn dicom_series_that_are_no_box_are_refused_with_the_miss() {
    let refused = |places: &[f64], edit: &dyn Fn(usize, &mut common::Slice)| {
        let dir = tempfile::tempdir().unwrap();
        series(dir.path(), places, edit);
        refusal(dir.path())
    };
    let none = |_: usize, _: &mut common::Slice| {};
    assert!(refused(&[0.0, 2.0, 4.0, 8.0], &none).contains("4.00 mm apart"));
    assert!(refused(&[0.0, 2.0, 2.0, 4.0], &none).contains("duplicate slices: 1 of 4"));
    let tilted = |n: usize, s: &mut common::Slice| s.position[1] += 0.5 * n as f64;
    assert!(refused(&[0.0, 2.0, 4.0], &tilted).contains("14.0 degrees"));
    let turned = |n: usize, s: &mut common::Slice| {
        if n == 1 {
            s.orientation = [0.0, 1.0, 0.0, 0.0, 0.0, -1.0];
        }
    };
    assert!(refused(&[0.0, 2.0], &turned).contains("mixed orientations"));
    let rle = |_: usize, s: &mut common::Slice| s.syntax = "1.2.840.10008.1.2.5";
    assert!(refused(&[0.0, 2.0], &rle).contains("RLE Lossless (1.2.840.10008.1.2.5)"));
    let no_spacing = |_: usize, s: &mut common::Slice| s.pixel_spacing = "";
    assert!(refused(&[0.0, 2.0], &no_spacing).contains("PixelSpacing"));
    let inverse = |_: usize, s: &mut common::Slice| s.photometric = "MONOCHROME1";
    assert!(refused(&[0.0, 2.0], &inverse).contains("MONOCHROME1"));
    let frames = |_: usize, s: &mut common::Slice| s.frames = "12";
    assert!(refused(&[0.0, 2.0], &frames).contains("multi-frame (enhanced) file of 12"));
}

#[test]
fn slices_with_their_own_rescale_become_real_values() {
    let dir = tempfile::tempdir().unwrap();
    series(dir.path(), &[0.0, 2.0, 4.0], |n, s| s.slope = ["1", "2", "0.5"][n]);
    let v = read(dir.path()).unwrap();
    assert_eq!(v.samples.sample_type(), SampleType::F32);
    assert_eq!([v.real(3), v.real(15), v.real(27)], [-1021.0, -1018.0, -1022.5]);
    let info = inspect(dir.path(), &ReadOptions::default()).unwrap().image.unwrap();
    assert_eq!(info.sample_type, "float32");
}

#[test]
fn several_dicom_series_are_listed_and_one_is_chosen() {
    let dir = tempfile::tempdir().unwrap();
    let second = dir.path().join("b");
    std::fs::create_dir(&second).unwrap();
    series(dir.path(), &[0.0, 1.0], |_, s| s.series = "1.2.3");
    series(&second, &[0.0, 2.0, 4.0], |_, s| s.series = "1.2.4");
    let e = read(dir.path()).unwrap_err();
    assert!(matches!(e, FormatError::Series { .. }));
    let text = e.to_string();
    assert!(text.contains("1.2.3") && text.contains("1.2.4") && text.contains("3 slices"));
    let info = inspect(dir.path(), &ReadOptions::default()).unwrap();
    assert!(info.image.is_none() && info.series.len() == 2);
    for wish in ["1", "1.2.4"] {
        let options = ReadOptions { series: Some(wish.to_owned()) };
        assert_eq!(read_volume(dir.path(), &options).unwrap().grid.dims.z, 3);
    }
    let options = ReadOptions { series: Some("9".to_owned()) };
    assert!(matches!(read_volume(dir.path(), &options), Err(FormatError::Series { .. })));
}

#[test]
fn no_patient_text_reaches_description_or_error() {
    const CANARY: &str = "CANARY^NAME";
    let dir = tempfile::tempdir().unwrap();
    series(dir.path(), &[0.0, 1.0], |_, s| s.canary = CANARY);
    let json =
        |p: &Path| serde_json::to_string(&inspect(p, &ReadOptions::default()).unwrap()).unwrap();
    assert!(!json(dir.path()).contains("CANARY"));
    series(dir.path(), &[0.0, 1.0], |_, s| {
        s.canary = CANARY;
        s.pixel_spacing = CANARY;
    });
    assert!(!refusal(dir.path()).contains("CANARY"));
}

#[test]
fn real_dicom_series_are_read_or_refused_with_their_reason() {
    let Some(dir) = unzip("dicom_codecs_series.zip") else { return };
    let at = |name: &str| -> PathBuf { dir.path().join("dicom_codecs_series").join(name) };
    let sum = |v: &Volume| (0..v.grid.len()).map(|i| v.real(i)).sum::<f64>();
    let plain = read(&at("generic/anatomical/001")).unwrap();
    assert_eq!(sum(&plain), 33_296_710.0);
    assert_eq!(sum(&read(&at("generic/anatomical/001_implicit")).unwrap()), 33_313_126.0);
    for name in ["001", "001_implicit", "002_non_isotropic"] {
        let v = read(&at(&format!("generic/anatomical/{name}"))).unwrap();
        let truth = read(&at(&format!("generic/anatomical/{name}_ground_truth.nii.gz"))).unwrap();
        assert_agree(&v, &truth, name);
    }
    let oblique = read(&at("hitachi/anatomical/001")).unwrap();
    let truth = read(&at("hitachi/anatomical/001_ground_truth.nii.gz")).unwrap();
    assert_agree(&oblique, &truth, "hitachi");
    for (name, reason) in [
        ("generic/compressed/001", "JPEG"),
        ("generic/compressed_j2k/001", "JPEG 2000"),
        ("generic/compressed_jpeg/001", "JPEG Lossless"),
        ("generic/compressed_jpegls/001", "JPEG-LS"),
        ("generic/compressed_rle/001", "RLE"),
        ("generic/rgb/001", "colour"),
        ("failing/gantrytilting/001", "gantry tilt"),
        ("failing/sliceincrement/001", "uneven slices"),
        ("failing/sliceorientation/001", "mixed orientations"),
    ] {
        let text = refusal(&at(name));
        assert!(text.contains(reason), "{name}: {text}");
    }
}

/// Each voxel of `a` has the same value at the same place in `b`, whose axes may be flipped.
fn assert_agree(a: &Volume, b: &Volume, what: &str) {
    for i in (0..a.grid.len()).step_by(7) {
        let p = a.grid.world_from_voxel().transform_point3(a.grid.voxel(i).as_dvec3());
        let j = b.grid.nearest_voxel(p).unwrap_or_else(|| panic!("{what}: {p} not in the truth"));
        let (x, y) = (a.real(i), b.real(b.grid.index(j)));
        assert!((x - y).abs() <= 0.51, "{what}: {x} instead of {y} at {p}");
    }
}

#[test]
fn a_real_gantry_tilt_is_refused_with_its_degrees() {
    let Some(dir) = unzip("head_ct_gantry_tilt.zip") else { return };
    let text = refusal(&dir.path().join("head_ct_gantry_tilt"));
    assert!(text.contains("gantry tilt") && text.contains("18.5 degrees"), "{text}");
}

#[test]
fn one_real_slice_reads_alike_in_every_plain_syntax() {
    let Some(dir) = unzip("dicom_one_slice_15_syntaxes.zip") else { return };
    let folder = dir.path().join("dicom_one_slice_15_syntaxes");
    let first = read(&folder.join("CTImage.dcm")).unwrap();
    let mut plain = 0;
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if ["Implicit", "LittleEndianExplicit", "BigEndian"].iter().any(|n| name.contains(n)) {
            let v = read(&path).unwrap();
            assert_eq!(v.samples, first.samples, "{name}");
            assert_eq!(v.grid, first.grid, "{name}");
            plain += 1;
        } else if name.ends_with(".dcm") && name != "CTImage.dcm" {
            refusal(&path);
        }
    }
    assert_eq!(plain, 3);
    assert_eq!(first.range(), Some((-3024.0, 1378.0)));
}
