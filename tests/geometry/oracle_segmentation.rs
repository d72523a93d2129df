//! Segmentations that highdicom and slicerio wrote: every voxel where it belongs, segments by name.

use common::fixtures::{path, volume};
use glam::{DMat3, DVec3, UVec3};
use intima::formats::{FormatError, ReadOptions, inspect, read_volume};
use intima::session::{Session, Settings, Source, VolumeSource};
use intima::volume::{Grid, Volume};

/// As tools/oracle/segmentation.py has it.
fn truth_grid() -> Grid {
    let axes = DMat3::from_cols_array(&[0.8, 0.0, 0.6, 0.36, 0.8, -0.48, -0.48, 0.6, 0.64]);
    let (spacing, origin) = (DVec3::new(0.7, 0.8, 2.5), DVec3::new(-30.0, 12.0, -100.0));
    Grid::new([22, 18, 14], spacing, origin, axes).unwrap()
}

fn named(file: &str, names: &[&str]) -> Result<Volume, FormatError> {
    let segments = names.iter().map(|n| n.to_string()).collect();
    read_volume(&path(&format!("seg/{file}")), &ReadOptions { segments, ..Default::default() })
}

/// Compares a label map with what each voxel should hold, given the truth's bits; voxels beyond its
/// grid must hold nothing.
fn assert_labels(v: &Volume, wanted: impl Fn(u64) -> f64, what: &str) {
    let (truth, grid) = (volume("seg/truth.nrrd"), truth_grid());
    let bits = |i: usize| truth.samples.get(i) as u64;
    let map = v.grid.voxel_from_world() * grid.world_from_voxel();
    let mut set = 0;
    for i in 0..grid.len() {
        let at = map.transform_point3(grid.voxel(i).as_dvec3());
        assert!((at - at.round()).abs().max_element() < 1e-4, "{what}: {at}");
        let at = at.round().as_ivec3();
        let found = if v.grid.contains(at) { v.real(v.grid.index(at.as_uvec3())) } else { 0.0 };
        assert_eq!(found, wanted(bits(i)), "{what}: voxel {}", grid.voxel(i));
        set += usize::from(found != 0.0);
    }
    let all = (0..v.grid.len()).filter(|i| v.real(*i) != 0.0).count();
    assert_eq!(set, all, "{what}: voxels outside the truth's grid");
}

#[test]
fn segments_are_read_by_name_from_every_kind_of_file() {
    for file in ["binary.dcm", "fractional.dcm", "layers.seg.nrrd"] {
        for (names, bits) in [
            (&["Lumen"][..], 1),
            (&["outer WALL"], 2),
            (&["Polyps"], 4),
            (&["Lumen", "Outer wall"], 3),
            (&["Polyps", "Outer wall", "Lumen"], 7),
        ] {
            let v = named(file, names).unwrap();
            assert_labels(&v, |b| f64::from(b & bits != 0), &format!("{file} {names:?}"));
        }
    }
    let v = named("labels.dcm", &["polyps"]).unwrap();
    assert_labels(&v, |b| f64::from(b & 4 != 0), "labels.dcm");
}

#[test]
fn a_segmentation_without_overlap_is_a_label_map_and_one_with_overlap_asks() {
    let v = named("labels.dcm", &[]).unwrap();
    assert_eq!(v.grid.dims, UVec3::new(22, 18, 11), "empty slices between two pieces are there");
    assert_labels(&v, |b| [0.0, 1.0, 0.0, 1.0, 3.0, 3.0, 3.0, 3.0][b as usize], "labels.dcm");
    for file in ["binary.dcm", "fractional.dcm", "layers.seg.nrrd"] {
        let why = named(file, &[]).unwrap_err().to_string();
        assert!(why.contains("3 segments may overlap: choose with --segment"), "{why}");
    }
}

#[test]
fn a_segment_that_is_not_there_is_an_error_that_shows_no_text_of_the_file() {
    for file in ["binary.dcm", "fractional.dcm", "labels.dcm", "layers.seg.nrrd"] {
        let why = named(file, &["Liver"]).unwrap_err().to_string();
        assert!(why.contains("no segment is called `Liver`") && why.contains("3 names"), "{why}");
        assert!(!why.contains("Polyps"), "{why}");
        let info = inspect(&path(&format!("seg/{file}")), &ReadOptions::default()).unwrap();
        let names: Vec<&str> = info.segments.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["Lumen", "Outer wall", "Polyps"]);
    }
    let options = ReadOptions { segments: vec!["Lumen".into()], ..Default::default() };
    let why = read_volume(&path("seg/truth.nrrd"), &options).unwrap_err().to_string();
    assert!(why.contains("names no segments"), "{why}");
}

/// Damaged or lying heads of a DICOM segmentation.
#[test]
fn a_damaged_segmentation_is_refused_with_the_reason() {
    let whole = std::fs::read(path("seg/binary.dcm")).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let refused = |bytes: &[u8]| {
        let file = dir.path().join("a.dcm");
        std::fs::write(&file, bytes).unwrap();
        let options = ReadOptions { segments: vec!["Lumen".into()], ..Default::default() };
        read_volume(&file, &options).unwrap_err().to_string()
    };
    let cut = refused(&whole[..whole.len() - 200]);
    assert!(cut.contains("truncated"), "{cut}");
    let edited = |from: &[u8], to: &[u8]| {
        let at = whole.windows(from.len()).rposition(|w| w == from).expect("is in the file");
        let mut bytes = whole.clone();
        bytes[at..at + to.len()].copy_from_slice(to);
        bytes
    };
    let segment = refused(&edited(b"\x62\0\x0b\0US\x02\0\x03\0", b"\x62\0\x0b\0US\x02\0\0\0"));
    assert!(segment.contains("ReferencedSegmentNumber of frame"), "{segment}");
    let kind = refused(&edited(b"BINARY", b"BINERY"));
    assert!(kind.contains("neither binary, fractional nor a label map"), "{kind}");
    let bits = edited(b"\x28\0\0\x01US\x02\0\x01\0", b"\x28\0\0\x01US\x02\0\x08\0");
    assert!(refused(&bits).contains("8 bits a pixel"));
    // Rows, of which the pixels have not so many.
    let rows = edited(b"\x28\0\x10\0US\x02\0\x12\0", b"\x28\0\x10\0US\x02\0\x00\x7d");
    assert!(refused(&rows).contains("truncated"));
    // The place of the last frame: another digit before the point.
    let at = whole.windows(6).rposition(|w| w == b"\x20\0\x32\0DS").expect("a place") + 8;
    let mut moved = whole.clone();
    let digit = (at..).find(|i| moved[*i].is_ascii_digit()).unwrap();
    moved[digit] = if moved[digit] == b'9' { b'1' } else { b'9' };
    let place = refused(&moved);
    assert!(place.contains("ImagePositionPatient"), "{place}");
    // A frame far away from the others: all slices between would be empty.
    let spacing = edited(b"\x18\0\x88\0DS\x04\x002.5 ", b"\x18\0\x88\0DS\x04\x00.002");
    assert!(refused(&spacing).contains("slices"), "{}", refused(&spacing));
}

#[test]
fn a_segment_is_the_lumen_of_a_session_on_the_image_that_it_was_drawn_on() {
    let image = Volume::new(truth_grid(), vec![0i16; truth_grid().len()].into());
    let options = ReadOptions { segments: vec!["Lumen".into()], ..Default::default() };
    let mask = VolumeSource::File { path: path("seg/binary.dcm"), options };
    let image = VolumeSource::Memory(std::sync::Arc::new(image));
    let source = Source::Mask { mask, image: Some(image) };
    let session = Session::new(source, Settings::default()).unwrap();
    let lumen = session.lumen().unwrap();
    assert_eq!(lumen.lumen.volume_grid().dims, UVec3::new(22, 18, 14), "the image's grid");
    let truth = volume("seg/truth.nrrd");
    let wanted = (0..truth.grid.len()).filter(|i| truth.samples.get(*i) as u64 & 1 == 1).count();
    assert_eq!(lumen.lumen.inside_voxels(), wanted as u64);
}
