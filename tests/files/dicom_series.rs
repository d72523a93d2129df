//! A folder of DICOM slices becomes series and stacks: told apart, listed, chosen, passed over.

use std::path::Path;

use common::volumes::{self, dicom_slice, read, refusal};
use glam::UVec3;
use intima::formats::{FormatError, ReadOptions, inspect, read_volume};
use intima::volume::Volume;

use super::dicom::series;

#[test]
fn a_slice_that_is_there_twice_is_left_out_and_named() {
    let dir = tempfile::tempdir().unwrap();
    series(dir.path(), &[0.0, 2.0, 2.0, 4.0], |_, _| {});
    assert_eq!(read(dir.path()).unwrap().grid.dims, UVec3::new(4, 3, 3));
    let notes = inspect(dir.path(), &ReadOptions::default()).unwrap().notes;
    assert!(notes.iter().any(|n| n.starts_with("1 slices that repeat another")), "{notes:?}");
}

#[test]
fn several_series_are_told_apart_by_size_and_thickness_and_not_by_uid() {
    let dir = tempfile::tempdir().unwrap();
    for (uid, step) in [("1.2.826.1", 2.0), ("1.2.826.2", 0.75)] {
        for n in 0..3 {
            let position = [0.0, 0.0, step * f64::from(n)];
            let slice = volumes::Slice { series: uid, position, ..volumes::Slice::default() };
            let file = dir.path().join(format!("{uid}-{n}.dcm"));
            std::fs::write(file, dicom_slice(&slice)).unwrap();
        }
    }
    let said = refusal(dir.path());
    let lines: Vec<&str> = said.lines().skip(1).collect();
    assert!(
        lines[0].starts_with("  0  CT  ") && lines[0].ends_with("3 slices of 2 mm, axial"),
        "{said}"
    );
    assert!(
        lines[1].starts_with("  1  CT  ") && lines[1].ends_with("3 slices of 0.75 mm, axial"),
        "{said}"
    );
    assert!(!said.contains("1.2.826"), "{said}");
}

#[test]
fn two_acquisitions_at_the_same_places_are_two_stacks_of_one_series() {
    let dir = tempfile::tempdir().unwrap();
    series(dir.path(), &[0.0, 2.0, 0.0, 2.0], |n, s| {
        s.acquisition = if n < 2 { "1" } else { "2" };
        s.pixels = vec![10 + n as u16; 12];
    });
    let said = refusal(dir.path());
    assert!(said.contains("2 volumes of one series; --volume 0 to 1 takes one"), "{said}");
    let pick = |wish: &str| {
        let series = Some(wish.to_owned());
        read_volume(dir.path(), &ReadOptions { series, ..ReadOptions::default() })
    };
    let volume = |n: usize| {
        read_volume(dir.path(), &ReadOptions { volume: Some(n), ..ReadOptions::default() })
    };
    let values = |v: Volume| [v.real(0) + 1024.0, v.real(12) + 1024.0];
    assert_eq!(values(pick("0").unwrap()), [12.0, 13.0]);
    assert_eq!(values(pick("1").unwrap()), [10.0, 11.0]);
    assert!(pick("1.2.3.4").unwrap_err().to_string().contains("2 volumes of one series"));
    assert_eq!([0, 1].map(|n| values(volume(n).unwrap())), [[12.0, 13.0], [10.0, 11.0]]);
    assert!(volume(2).unwrap_err().to_string().contains("there is no 2"));
}

#[test]
fn acquisitions_that_interleave_at_other_places_are_stacks_of_their_own() {
    let pick = |dir: &Path, wish: &str| {
        let series = Some(wish.to_owned());
        read_volume(dir, &ReadOptions { series, ..ReadOptions::default() })
    };
    // Steps of 2 mm and of 3 mm from 0.5 mm on, a scout of three slices among them.
    let places: Vec<f64> = (0..9)
        .map(|i| 2.0 * f64::from(i))
        .chain((0..6).map(|i| 0.5 + 3.0 * f64::from(i)))
        .chain([3.1, 8.1, 13.1])
        .collect();
    let number = |n: usize| match n {
        0..9 => "1",
        9..15 => "2",
        _ => "3",
    };
    let dir = tempfile::tempdir().unwrap();
    series(dir.path(), &places, |n, s| s.acquisition = number(n));
    assert!(refusal(dir.path()).contains("holds 3 series"));
    let mut found: Vec<(u32, f64)> = ["0", "1", "2"]
        .map(|wish| pick(dir.path(), wish).unwrap().grid)
        .map(|grid| (grid.dims.z, grid.spacing_mm.z))
        .to_vec();
    found.sort_by_key(|f| f.0);
    assert_eq!(found, [(3, 5.0), (6, 3.0), (9, 2.0)]);
    // One stack taken in two passes, and one in two parts, stay whole.
    for (places, passes) in
        [([0.0, 2.0, 4.0, 6.0], [1, 2, 1, 2]), ([0.0, 2.0, 4.0, 6.0], [1, 1, 2, 2])]
    {
        let dir = tempfile::tempdir().unwrap();
        series(dir.path(), &places, |n, s| s.acquisition = if passes[n] == 1 { "1" } else { "2" });
        assert_eq!(read(dir.path()).unwrap().grid.dims.z, 4, "{passes:?}");
    }
    let dir = tempfile::tempdir().unwrap();
    series(dir.path(), &[0.0, 2.0, 7.0, 9.0], |n, s| s.acquisition = if n < 2 { "1" } else { "2" });
    assert!(refusal(dir.path()).contains("uneven slices"), "a gap is no reason to split");
}

#[test]
fn several_dicom_series_are_listed_and_one_is_chosen() {
    let dir = tempfile::tempdir().unwrap();
    let second = dir.path().join("b");
    std::fs::create_dir(&second).unwrap();
    series(dir.path(), &[0.0, 1.0, 2.0], |_, s| s.series = "1.2.3");
    series(&second, &[0.0, 2.0, 4.0], |_, s| s.series = "1.2.4");
    let e = read(dir.path()).unwrap_err();
    assert!(matches!(e, FormatError::Series { .. }));
    let text = e.to_string();
    assert!(text.contains("\n  0  CT  ") && text.contains("\n  1  CT  "), "{text}");
    assert!(text.contains("3 slices") && !text.contains("1.2.4"), "{text}");
    let info = inspect(dir.path(), &ReadOptions::default()).unwrap();
    assert!(info.image.is_none() && info.series.len() == 2);
    for wish in ["1", "1.2.4"] {
        let options = ReadOptions { series: Some(wish.to_owned()), ..Default::default() };
        assert_eq!(read_volume(dir.path(), &options).unwrap().grid.dims.z, 3);
    }
    let options = ReadOptions { series: Some("9".to_owned()), ..Default::default() };
    assert!(matches!(read_volume(dir.path(), &options), Err(FormatError::Series { .. })));
}

#[test]
fn a_stray_series_of_two_slices_is_named_and_the_other_one_taken() {
    let dir = tempfile::tempdir().unwrap();
    let second = dir.path().join("b");
    std::fs::create_dir(&second).unwrap();
    series(dir.path(), &[0.0, 1.0], |_, s| s.series = "1.2.3");
    series(&second, &[0.0, 2.0, 4.0], |_, s| s.series = "1.2.4");
    assert_eq!(read(dir.path()).unwrap().grid.dims.z, 3);
    let info = inspect(dir.path(), &ReadOptions::default()).unwrap();
    assert_eq!(info.image.unwrap().dims[2], 3);
    let named = |note: &String| note.contains("passed over series 0 (CT, 2 slices)");
    assert!(info.notes.iter().any(named), "{:?}", info.notes);
    let options = ReadOptions { series: Some("0".into()), ..Default::default() };
    assert_eq!(read_volume(dir.path(), &options).unwrap().grid.dims.z, 2);
}

#[test]
fn series_of_two_kernels_and_planes_are_told_apart_in_the_message() {
    let dir = tempfile::tempdir().unwrap();
    let parts = [("a", "1.2.3", "B70f"), ("b", "1.2.4", "B40f"), ("c", "1.2.5", "DOE JANE")];
    for (folder, uid, kernel) in parts {
        let at = dir.path().join(folder);
        std::fs::create_dir(&at).unwrap();
        series(&at, &[0.0, 1.0, 2.0], |_, s| (s.series, s.kernel) = (uid, kernel));
    }
    let said = refusal(dir.path());
    assert!(said.contains("axial, B70f") && said.contains("axial, B40f"), "{said}");
    assert!(!said.contains("DOE"), "{said}");
}

#[test]
fn noise_in_the_orientation_does_not_cut_a_series_in_two() {
    let dir = tempfile::tempdir().unwrap();
    let places: Vec<f64> = (0..12).map(|i| 2.0 * f64::from(i)).collect();
    // Cosines on both sides of a rounded thousandth.
    let across: f64 = 0.0315;
    series(dir.path(), &places, |n, s| {
        let along = if n % 3 == 0 { 0.999_499_9 } else { 0.999_500_1 };
        s.orientation = [along, across, 0.0, -across, along, 0.0];
    });
    assert_eq!(read(dir.path()).unwrap().grid.dims.z, 12);
}

#[test]
fn a_repeated_slice_in_a_series_whose_acquisition_differs_by_slice_is_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let numbers: Vec<String> = (0..13).map(|n| n.to_string()).collect();
    let numbers: Vec<&'static str> = numbers.into_iter().map(|n| &*n.leak()).collect();
    let mut places: Vec<f64> = (0..12).map(|i| 2.0 * f64::from(i)).collect();
    places.push(6.0);
    series(dir.path(), &places, |n, s| s.acquisition = numbers[n]);
    assert_eq!(read(dir.path()).unwrap().grid.dims.z, 12);
}

#[test]
fn phases_by_fractions_of_a_trigger_time_are_told_apart() {
    let dir = tempfile::tempdir().unwrap();
    for (phase, time) in ["0", "62.5", "125.5"].into_iter().enumerate() {
        for n in 0..3u16 {
            let position = [0.0, 0.0, 2.0 * f64::from(n)];
            let slice = volumes::Slice { position, trigger: time, ..volumes::Slice::default() };
            let file = dir.path().join(format!("{phase}-{n}.dcm"));
            std::fs::write(file, dicom_slice(&slice)).unwrap();
        }
    }
    let said = refusal(dir.path());
    assert!(said.contains("3 volumes of one series"), "{said}");
}

#[test]
fn frames_without_places_beside_a_series_are_named_and_stop_no_run() {
    let dir = tempfile::tempdir().unwrap();
    series(dir.path(), &[0.0, 2.0, 4.0], |_, _| {});
    let cine = volumes::Slice { series: "1.2.9", frames: "3", ..volumes::Slice::default() };
    let cine = volumes::Slice { pixels: vec![7; 36], ..cine };
    let mut bytes = dicom_slice(&cine);
    let modality = bytes.windows(6).position(|w| w == b"CS\x02\0CT").unwrap() + 4;
    bytes[modality..modality + 2].copy_from_slice(b"US");
    std::fs::write(dir.path().join("cine.dcm"), &bytes).unwrap();
    assert_eq!(read(dir.path()).unwrap().grid.dims.z, 3);
    let notes = inspect(dir.path(), &ReadOptions::default()).unwrap().notes;
    let said = "1 DICOM files were passed over, the first: 3 frames in a file";
    assert!(notes.iter().any(|n| n.starts_with(said)), "{notes:?}");
    // One of CT may be the volume that is wanted.
    std::fs::write(dir.path().join("cine.dcm"), dicom_slice(&cine)).unwrap();
    assert!(refusal(dir.path()).contains("3 frames in a file"));
}
