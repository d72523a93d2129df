//! DICOM slices become the volume they were, or are refused with the reason.

use std::path::{Path, PathBuf};

use common::volumes::{self, dicom_slice, read, refusal, unzip};
use glam::{DVec3, UVec3};
use intima::formats::{ReadOptions, inspect, read_volume};
use intima::lumen::{IntensitySelection, LumenError, SegmentationOptions};
use intima::volume::{SampleType, Volume};

pub fn series(dir: &Path, places: &[f64], edit: impl Fn(usize, &mut volumes::Slice)) {
    for (n, z) in places.iter().enumerate() {
        let mut slice = volumes::Slice { position: [-5.0, 7.0, *z], ..volumes::Slice::default() };
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
    let refused = |places: &[f64], edit: &dyn Fn(usize, &mut volumes::Slice)| {
        let dir = tempfile::tempdir().unwrap();
        series(dir.path(), places, edit);
        refusal(dir.path())
    };
    let none = |_: usize, _: &mut volumes::Slice| {};
    assert!(refused(&[0.0, 2.0, 4.0, 8.0], &none).contains("4.00 mm apart"));
    let other = |n: usize, s: &mut volumes::Slice| s.pixels[0] += n as u16;
    assert!(refused(&[0.0, 2.0, 2.0, 4.0], &other).contains("duplicate slices: 1 of 4"));
    let turned = |n: usize, s: &mut volumes::Slice| {
        if n == 1 {
            s.orientation = [0.0, 1.0, 0.0, 0.0, 0.0, -1.0];
        }
    };
    assert!(refused(&[0.0, 2.0], &turned).contains("holds 2 series"));
    let rle = |_: usize, s: &mut volumes::Slice| s.syntax = "1.2.840.10008.1.2.5";
    let plain = refused(&[0.0, 2.0], &rle);
    assert!(plain.contains("RLE Lossless (1.2.840.10008.1.2.5) has them in fragments"), "{plain}");
    let progressive = |_: usize, s: &mut volumes::Slice| s.syntax = "1.2.840.10008.1.2.4.55";
    assert!(refused(&[0.0, 2.0], &progressive).contains("JPEG Full Progression"));
    let deflated = |_: usize, s: &mut volumes::Slice| s.syntax = "1.2.840.10008.1.2.8.1";
    assert!(refused(&[0.0, 2.0], &deflated).contains("Deflated Image Frame Compression"));
    let no_spacing = |_: usize, s: &mut volumes::Slice| s.pixel_spacing = "";
    assert!(refused(&[0.0, 2.0], &no_spacing).contains("PixelSpacing"));
    let inverse = |_: usize, s: &mut volumes::Slice| s.photometric = "MONOCHROME1";
    assert!(refused(&[0.0, 2.0], &inverse).contains("MONOCHROME1"));
    let frames = |_: usize, s: &mut volumes::Slice| s.frames = "12";
    assert!(refused(&[0.0, 2.0], &frames).contains("12 frames in a file that does not say where"));
}

/// A volume that grows linearly in all directions, on slices that are pushed and uneven.
fn linear_series(dir: &Path, places: &[f64], push: [f64; 2]) {
    series(dir, places, |n, s| {
        s.size = [8, 9];
        s.position[0] += push[0] * places[n];
        s.position[1] += push[1] * places[n];
        let at = s.position;
        let value = |i: usize| {
            let (x, y) = ((i % 8) as f64 * 0.5, (i / 8) as f64 * 0.75);
            (2000.0 + 100.0 * (at[0] + x) - 60.0 * (at[1] + y) + 40.0 * at[2]).round() as u16
        };
        s.pixels = (0..72).map(value).collect();
    });
}

/// Largest miss of a volume against that growth, and voxels that were compared: those between the
/// slices' own pixels.
fn linear_miss(v: &Volume, push: [f64; 2]) -> (f64, usize) {
    let (mut most, mut compared) = (0.0f64, 0);
    for i in 0..v.grid.len() {
        let p = v.grid.world_from_voxel().transform_point3(v.grid.voxel(i).as_dvec3());
        let within = |x: f64, first: f64, width: f64| x > first + 0.8 && x < first + width - 0.8;
        if within(p.x, -5.0 + push[0] * p.z, 3.5) && within(p.y, 7.0 + push[1] * p.z, 6.0) {
            let wanted = 2000.0 + 100.0 * p.x - 60.0 * p.y + 40.0 * p.z - 1024.0;
            most = most.max((v.real(i) - wanted).abs());
            compared += 1;
        }
    }
    (most, compared)
}

#[test]
fn a_gantry_tilt_is_sheared_to_a_box_whatever_its_direction() {
    for push in [[0.0, 0.25], [0.0, -0.33], [0.2, 0.1]] {
        let dir = tempfile::tempdir().unwrap();
        linear_series(dir.path(), &[0.0, 1.0, 2.0, 3.0], push);
        let v = read(dir.path()).unwrap();
        assert_eq!((v.grid.dims.z, v.grid.spacing_mm), (4, DVec3::new(0.5, 0.75, 1.0)));
        assert!(v.grid.dims.x * v.grid.dims.y > 72, "the box holds every slice");
        let (miss, compared) = linear_miss(&v, push);
        // Pixels are whole numbers.
        assert!(miss <= 0.51 && compared > 30, "{push:?}: {miss} over {compared}");
        let info = inspect(dir.path(), &ReadOptions::default()).unwrap();
        assert!(info.notes.iter().any(|n| n.contains("gantry tilt")), "{:?}", info.notes);
        assert_eq!(info.image.unwrap().dims, v.grid.dims.to_array());
    }
}

#[test]
fn uneven_slices_are_named_and_interpolated_only_where_that_is_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    linear_series(dir.path(), &[0.0, 1.0, 2.0, 4.0, 5.0], [0.0, 0.0]);
    let said = refusal(dir.path());
    assert!(said.contains("slices 3 and 4 are 2.00 mm apart") && said.contains("--fill-gaps"));
    let options = ReadOptions { fill_gaps: true, ..ReadOptions::default() };
    let v = read_volume(dir.path(), &options).unwrap();
    assert_eq!((v.grid.dims, v.grid.spacing_mm.z), (UVec3::new(8, 9, 6), 1.0));
    let (miss, compared) = linear_miss(&v, [0.0, 0.0]);
    assert!(miss <= 0.51 && compared > 100, "{miss} over {compared}");
}

/// An element, explicit little endian.
pub fn element(tag: (u16, u16), vr: &str, value: &[u8]) -> Vec<u8> {
    let mut value = value.to_vec();
    if value.len() % 2 == 1 {
        value.push(if vr == "UI" { 0 } else { b' ' });
    }
    let mut out = [tag.0.to_le_bytes(), tag.1.to_le_bytes()].concat();
    out.extend(vr.as_bytes());
    if ["SQ", "OW", "OB"].contains(&vr) {
        out.extend([0, 0]);
        out.extend((value.len() as u32).to_le_bytes());
    } else {
        out.extend((value.len() as u16).to_le_bytes());
    }
    out.extend(value);
    out
}

/// A sequence of items, of defined or undefined lengths.
fn sequence(tag: (u16, u16), items: &[Vec<u8>], defined: bool) -> Vec<u8> {
    let item = |body: &Vec<u8>| {
        let mut out = b"\xfe\xff\x00\xe0".to_vec();
        out.extend((if defined { body.len() as u32 } else { u32::MAX }).to_le_bytes());
        out.extend(body);
        if !defined {
            out.extend(b"\xfe\xff\x0d\xe0\0\0\0\0");
        }
        out
    };
    let body: Vec<u8> = items.iter().flat_map(item).collect();
    if defined {
        return element(tag, "SQ", &body);
    }
    let mut out = [tag.0.to_le_bytes(), tag.1.to_le_bytes()].concat();
    out.extend(b"SQ\0\0\xff\xff\xff\xff");
    out.extend(body);
    out.extend(b"\xfe\xff\xdd\xe0\0\0\0\0");
    out
}

/// An enhanced CT of frames at these places, each of 4 x 3 pixels that say which frame it is.
pub fn enhanced(places: &[f64], defined: bool, compressed: bool) -> Vec<u8> {
    let syntax: &[u8] = if compressed { b"1.2.840.10008.1.2.5" } else { b"1.2.840.10008.1.2.1" };
    let mut out = vec![0; 128];
    out.extend(b"DICM");
    out.extend(element((2, 0x10), "UI", syntax));
    out.extend(element((0x08, 0x16), "UI", b"1.2.840.10008.5.1.4.1.1.2.1"));
    out.extend(element((0x08, 0x60), "CS", b"CT"));
    out.extend(element((0x20, 0x0e), "UI", b"1.2.3"));
    let short = |v: u16| v.to_le_bytes();
    out.extend(element((0x28, 0x02), "US", &short(1)));
    out.extend(element((0x28, 0x04), "CS", b"MONOCHROME2"));
    out.extend(element((0x28, 0x08), "IS", places.len().to_string().as_bytes()));
    out.extend(element((0x28, 0x10), "US", &short(3)));
    out.extend(element((0x28, 0x11), "US", &short(4)));
    for (number, value) in [(0x100, 16), (0x101, 16), (0x102, 15), (0x103, 1)] {
        out.extend(element((0x28, number), "US", &short(value)));
    }
    let group = |tag, body: Vec<u8>| sequence(tag, &[body], defined);
    let measures = group((0x28, 0x9110), element((0x28, 0x30), "DS", b"0.75\\0.5"));
    let turned = group((0x20, 0x9116), element((0x20, 0x37), "DS", b"1\\0\\0\\0\\1\\0"));
    let other = sequence((0x18, 0x9329), &[element((0x08, 0x9007), "CS", b"ORIGINAL")], !defined);
    out.extend(sequence((0x5200, 0x9229), &[[other, turned, measures].concat()], defined));
    let frame = |(i, z): (usize, &f64)| {
        let at = element((0x20, 0x32), "DS", format!("-5\\7\\{z}").as_bytes());
        // Each frame has its own rescale.
        let offset = element((0x28, 0x1052), "DS", (-1000 - i as i32).to_string().as_bytes());
        let slope = element((0x28, 0x1053), "DS", b"1");
        [group((0x20, 0x9113), at), group((0x28, 0x9145), [offset, slope].concat())].concat()
    };
    let frames: Vec<Vec<u8>> = places.iter().enumerate().map(frame).collect();
    out.extend(sequence((0x5200, 0x9230), &frames, defined));
    let pixels = |i: usize| (0..12u16).map(move |p| 100 * i as u16 + p);
    if !compressed {
        let all: Vec<u8> =
            (0..places.len()).flat_map(pixels).flat_map(|v| v.to_le_bytes()).collect();
        out.extend(element((0x7fe0, 0x10), "OW", &all));
        return out;
    }
    out.extend(b"\xe0\x7f\x10\0OB\0\0\xff\xff\xff\xff\xfe\xff\0\xe0\0\0\0\0");
    for i in 0..places.len() {
        let literal = |plane: Vec<u8>| [vec![11], plane].concat();
        let high = literal(pixels(i).map(|v| (v >> 8) as u8).collect());
        let low = literal(pixels(i).map(|v| v as u8).collect());
        let mut words = [0u32; 16];
        (words[0], words[1], words[2]) = (2, 64, 64 + high.len() as u32);
        let mut stream: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).collect();
        stream.extend([high, low].concat());
        out.extend(b"\xfe\xff\0\xe0");
        out.extend((stream.len() as u32).to_le_bytes());
        out.extend(stream);
    }
    out.extend(b"\xfe\xff\xdd\xe0\0\0\0\0");
    out
}

#[test]
fn frames_of_an_enhanced_file_are_ordered_by_place_each_with_its_own_rescale() {
    let places = [4.0, 0.0, 6.0, 2.0];
    for (defined, compressed) in [(true, false), (false, false), (true, true), (false, true)] {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("enhanced");
        std::fs::write(&file, enhanced(&places, defined, compressed)).unwrap();
        for path in [&file, dir.path()] {
            let v = read(path).unwrap();
            assert_eq!(v.grid.dims, UVec3::new(4, 3, 4));
            assert_eq!(v.grid.spacing_mm, DVec3::new(0.5, 0.75, 2.0));
            assert_eq!(v.grid.origin_mm, DVec3::new(-5.0, 7.0, 0.0));
            for (slice, frame) in [1, 3, 0, 2].into_iter().enumerate() {
                let wanted = f64::from(100 * frame + 5) - 1000.0 - f64::from(frame);
                assert_eq!(v.real(12 * slice + 5), wanted, "{defined} {compressed}");
            }
        }
    }
    // Pixels of a frame are cut off.
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("cut.dcm");
    let whole = enhanced(&places, true, false);
    std::fs::write(&file, &whole[..whole.len() - 8]).unwrap();
    assert!(refusal(&file).contains("truncated"));
}

/// An enhanced file as a part of a volume that is spread over several files.
///
/// * `parts`: how many there are, if the file says it.
fn part(places: &[f64], number: u16, parts: Option<u16>) -> Vec<u8> {
    let whole = enhanced(places, true, false);
    let short = |n: u16| n.to_le_bytes();
    let said = [
        element((0x20, 0x9161), "UI", b"1.2.3.4"),
        element((0x20, 0x9162), "US", &short(number)),
        parts.map_or(Vec::new(), |n| element((0x20, 0x9163), "US", &short(n))),
    ];
    let at = whole.windows(4).position(|w| w == b"\x28\0\x02\0").unwrap();
    [&whole[..at], &said.concat(), &whole[at..]].concat()
}

#[test]
fn a_volume_that_is_spread_over_several_enhanced_files_is_whole_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("b"), part(&[2.0, 0.0], 1, Some(3))).unwrap();
    std::fs::write(dir.path().join("a"), part(&[6.0, 4.0], 2, Some(3))).unwrap();
    let why = refusal(dir.path());
    assert!(why.contains("InConcatenationTotalNumber is `3`: 2 of its parts are there"), "{why}");
    // Without their number the greatest one tells that a part is missing.
    std::fs::write(dir.path().join("a"), part(&[8.0, 10.0], 3, None)).unwrap();
    std::fs::write(dir.path().join("b"), part(&[2.0, 0.0], 1, None)).unwrap();
    assert!(refusal(dir.path()).contains("2 of its parts are there"));
    std::fs::write(dir.path().join("b"), part(&[2.0, 0.0], 1, Some(3))).unwrap();
    std::fs::write(dir.path().join("a"), part(&[6.0, 4.0], 2, Some(3))).unwrap();
    std::fs::write(dir.path().join("c"), part(&[8.0], 3, Some(3))).unwrap();
    let v = read(dir.path()).unwrap();
    assert_eq!(v.grid.dims, UVec3::new(4, 3, 5));
    let pixels = [100.0, 0.0, 100.0, 0.0, 0.0].map(|frame| frame + 5.0);
    for (slice, wanted) in pixels.into_iter().enumerate() {
        let offset = if wanted > 100.0 { -1001.0 } else { -1000.0 };
        assert_eq!(v.real(12 * slice + 5), wanted + offset, "slice {slice}");
    }
}

#[test]
fn padding_is_no_part_of_a_threshold_nor_of_the_range() {
    let dir = tempfile::tempdir().unwrap();
    // Rescaled by -1024: 24 is -1000 HU.
    series(dir.path(), &[0.0, 2.0], |_, s| {
        s.signed = true;
        s.padding = vec![-1500, -1400];
        s.pixels =
            [24i16, -1500, -1450, -1400, 24, 50, 60, 70, 24, 24, 24, 24].map(|p| p as u16).to_vec();
    });
    let volume = read(dir.path()).unwrap();
    assert_eq!(volume.padding, Some([-1500.0, -1400.0]));
    assert_eq!(volume.range(), Some((-1000.0, -954.0)));
    assert_eq!(volume.real(1), -2524.0, "values stay as they are stored");
    let below = IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: -1000.0 };
    assert_eq!(below.select(&volume).count(), 12);
    let seeded =
        |seed| SegmentationOptions { seed: Some(seed), ..SegmentationOptions::new(below.clone()) };
    assert!(seeded(UVec3::ZERO).apply(&volume).is_ok());
    let refused = seeded(UVec3::new(1, 0, 0)).apply(&volume);
    assert!(matches!(refused, Err(LumenError::SeedValue { .. })));
}

#[test]
fn pixels_that_may_show_who_the_patient_is_are_read_only_where_that_is_allowed() {
    type Edit<'a> = &'a dyn Fn(usize, &mut volumes::Slice);
    let yes = |n: usize| if n == 1 { "YES" } else { "NO" };
    let edits: [(&str, Edit<'_>); 3] = [
        ("BurnedInAnnotation", &|n, s| s.burned_in = yes(n)),
        ("RecognizableVisualFeatures", &|n, s| s.recognizable = yes(n)),
        ("Secondary Capture", &|_, s| s.class = "1.2.840.10008.5.1.4.1.1.7.3"),
    ];
    for (name, edit) in edits {
        let dir = tempfile::tempdir().unwrap();
        series(dir.path(), &[0.0, 2.0], edit);
        let said = refusal(dir.path());
        assert!(said.contains(name) && said.contains("may show who the patient is"), "{said}");
        let allowed = ReadOptions { allow_burned_in: true, ..ReadOptions::default() };
        assert!(read_volume(dir.path(), &allowed).is_ok());
        let notes = inspect(dir.path(), &ReadOptions::default()).unwrap().notes;
        assert!(notes.iter().any(|n| n.contains("may show who the patient is")), "{notes:?}");
    }
}

#[test]
fn a_data_set_without_preamble_is_read_and_other_files_are_not_taken_for_one() {
    let dir = tempfile::tempdir().unwrap();
    let whole = enhanced(&[0.0, 1.0], true, false);
    // From the first element of the data set on, behind preamble and meta group.
    let meta = 132 + element((2, 0x10), "UI", b"1.2.840.10008.1.2.1").len();
    std::fs::write(dir.path().join("IM0001"), &whole[meta..]).unwrap();
    std::fs::write(dir.path().join("notes"), "just a text, longer than its first elements")
        .unwrap();
    let v = read(dir.path()).unwrap();
    assert_eq!(v.grid.dims, UVec3::new(4, 3, 2));
}

#[test]
fn folders_of_media_are_searched_and_their_directory_file_stands_for_them() {
    let dir = tempfile::tempdir().unwrap();
    let deep = dir.path().join("PATIENT/STUDY/SERIES/IMAGE");
    std::fs::create_dir_all(&deep).unwrap();
    series(&deep, &[0.0, 2.0, 4.0], |_, _| {});
    std::fs::write(dir.path().join("DICOMDIR"), b"a directory").unwrap();
    for path in [dir.path().to_owned(), dir.path().join("DICOMDIR")] {
        assert_eq!(read(&path).unwrap().grid.dims, UVec3::new(4, 3, 3));
    }
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
fn no_patient_text_reaches_description_or_error() {
    const CANARY: &str = "CANARY^NAME";
    let dir = tempfile::tempdir().unwrap();
    series(dir.path(), &[0.0, 1.0], |_, s| s.canary = CANARY);
    let json =
        |p: &Path| serde_json::to_string(&inspect(p, &ReadOptions::default()).unwrap()).unwrap();
    assert!(!json(dir.path()).contains("CANARY"));
    // A choice on the screen may show what the series is called: it goes no further.
    let of = |p: &Path| inspect(p, &ReadOptions::default()).unwrap().series.remove(0);
    series(dir.path(), &[0.0, 1.0], |_, s| (s.canary, s.kernel) = (CANARY, "B70f\\3"));
    let listed = of(dir.path());
    assert_eq!((&listed.description.0[..], &listed.kernel.0[..]), (CANARY, "B70f 3"));
    assert!(!json(dir.path()).contains("B70f"));
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
    // As pydicom 3.0.2 decodes them.
    for name in ["", "_j2k", "_jpeg", "_jpegls", "_rle"] {
        let v = read(&at(&format!("generic/compressed{name}/001"))).unwrap();
        assert_eq!(sum(&v), 33_304_746.0, "{name}");
    }
    assert!(read(&at("failing/gantrytilting/001")).unwrap().grid.dims.y > 256);
    for (name, reason) in [
        ("generic/rgb/001", "colour"),
        ("failing/sliceincrement/001", "uneven slices"),
        ("failing/sliceorientation/001", "series; choose one"),
    ] {
        let text = refusal(&at(name));
        assert!(text.contains(reason), "{name}: {text}");
    }
}

/// The feature that a codec of the fixtures needs and this build lacks.
fn missing_feature(codec: &str) -> Option<&'static str> {
    match codec {
        "jpeg_12" if !cfg!(feature = "jpeg-12") => Some("jpeg-12"),
        _ => None,
    }
}

#[test]
fn a_slice_reads_alike_in_every_compressed_syntax_or_the_refusal_names_the_feature() {
    let file = |name: &str| volumes::fixture(&format!("codec/{name}"));
    for (name, most) in [
        ("jpeg_8", 2.0),
        ("jpeg_12", 3.0),
        ("jpeg_lossless", 0.0),
        ("jpeg_ls", 0.0),
        ("jpeg_2000", 0.0),
        ("htj2k", 0.0),
    ] {
        if let Some(feature) = missing_feature(name) {
            let said = refusal(&file(&format!("{name}.dcm")));
            assert!(said.contains(&format!("`{feature}`")), "{said}");
            continue;
        }
        let truth = if name == "jpeg_8" { "truth_8.nrrd" } else { "truth.nrrd" };
        let (truth, v) =
            (read(&file(truth)).unwrap(), read(&file(&format!("{name}.dcm"))).unwrap());
        assert_eq!(v.grid.dims, truth.grid.dims, "{name}");
        let miss = (0..v.grid.len()).map(|i| (v.real(i) - truth.real(i)).abs()).fold(0.0, f64::max);
        assert!(miss <= most, "{name}: {miss}");
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
fn a_real_gantry_tilt_with_two_steps_becomes_a_box() {
    let Some(dir) = unzip("head_ct_gantry_tilt.zip") else { return };
    let folder = dir.path().join("head_ct_gantry_tilt");
    assert!(refusal(&folder).contains("uneven slices"));
    let options = ReadOptions { fill_gaps: true, ..ReadOptions::default() };
    let v = read_volume(&folder, &options).unwrap();
    assert_eq!(v.grid.dims, UVec3::new(512, 611, 37));
    assert!((v.grid.spacing_mm.z - 4.0).abs() < 0.01, "{}", v.grid.spacing_mm);
}

#[test]
fn one_real_slice_reads_alike_in_every_syntax_that_keeps_its_values() {
    let Some(dir) = unzip("dicom_one_slice_15_syntaxes.zip") else { return };
    let folder = dir.path().join("dicom_one_slice_15_syntaxes");
    let first = read(&folder.join("CTImage.dcm")).unwrap();
    let sum = |v: &Volume| (0..v.grid.len()).map(|i| v.real(i)).sum::<f64>();
    let (mut alike, mut lossy) = (0, 0);
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let is = |uid: &str| name.ends_with(&format!("_1.2.840.10008.1.2.{uid}.dcm"));
        if ["4.53", "4.55"].into_iter().any(is) {
            assert!(refusal(&path).contains("transfer syntax JPEG"));
        } else if is("4.51") && missing_feature("jpeg_12").is_some() {
            assert!(refusal(&path).contains("`jpeg-12`"));
            lossy += 1;
        } else if ["4.50", "4.51", "4.81", "4.91"].into_iter().any(is) {
            // Sums of what pydicom decodes; of the two JPEG within a grey level a pixel.
            let (wanted, miss) = match () {
                () if is("4.81") => (-248_761_732.0, 0.0),
                () if is("4.91") => (-248_809_088.0, 0.0),
                () if is("4.51") => (-249_051_885.8, 1.1),
                () => (-253_720_533.8, 17.3),
            };
            let v = read(&path).unwrap();
            let off = (sum(&v) - wanted).abs() / v.grid.len() as f64;
            assert!(off <= miss, "{name}: {off}");
            assert_eq!(v.grid, first.grid, "{name}");
            lossy += 1;
        } else if name.contains("_1.2.840.10008.1.2") {
            let v = read(&path).unwrap();
            assert_eq!(v.samples, first.samples, "{name}");
            assert_eq!(v.grid, first.grid, "{name}");
            alike += 1;
        }
    }
    assert_eq!((alike, lossy), (9, 4));
    assert_eq!(first.range(), Some((-3024.0, 1378.0)));
}
