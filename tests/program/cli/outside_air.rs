//! A threshold without a seed on a body in air.

use intima::volume::{Grid, Samples, Volume};

use super::*;

/// A round body in air along z; a tube of air in it, where asked for.
fn body(path: &Path, has_lumen: bool) {
    let grid = Grid::axis_aligned([48, 48, 24], [1.0, 1.0, 2.0]);
    let value = |i: usize| {
        let v = grid.voxel(i).as_vec3();
        let off = |x: f32, y: f32| ((v.x - x).powi(2) + (v.y - y).powi(2)).sqrt();
        let lumen = has_lumen && off(26.0, 20.0) < 5.0 && (3.0..21.0).contains(&v.z);
        if lumen || off(23.5, 23.5) > 20.0 { -1000i16 } else { 40 }
    };
    let values: Vec<i16> = (0..grid.len()).map(value).collect();
    write_volume(path, &Volume::new(grid, Samples::from(values))).unwrap();
}

#[test]
fn what_was_taken_and_left_out_is_said_and_reported() {
    let tmp = tempfile::tempdir().unwrap();
    body(&tmp.path().join("ct.nrrd"), true);
    let args = ["segment", "ct.nrrd", "--threshold", ":-500", "-o", "m.nrrd", "--json"];
    let out = intima(tmp.path(), &args);
    let err = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.success(), "{err}");
    let json: Value = serde_json::from_slice(&out.stdout).unwrap();
    let lumen = &json["lumen"];
    let voxels = lumen["taken"]["voxels"].as_u64().unwrap();
    let inside =
        lumen["internal_voxels"].as_u64().unwrap() + lumen["boundary_voxels"].as_u64().unwrap();
    assert_eq!((voxels, lumen["taken"]["outside_body"].as_bool()), (inside, Some(false)));
    assert_eq!(lumen["taken"]["volume_ml"].as_f64(), Some(voxels as f64 * 2.0 / 1000.0));
    let first: Vec<u64> = lumen["taken"]["first_voxel"]
        .as_array()
        .unwrap()
        .iter()
        .map(|n| n.as_u64().unwrap())
        .collect();
    assert_eq!((first[2], lumen["taken"]["first_mm"][2].as_f64()), (3, Some(6.0)));
    let air = &lumen["left_out"][0];
    assert_eq!(
        (air["outside_body"].as_bool(), &air["first_voxel"]),
        (Some(true), &serde_json::json!([0, 0, 0]))
    );
    assert_eq!(lumen["outside_components"], 1);
    assert!(air["voxels"].as_u64() > Some(5 * voxels), "{lumen}");
    assert!(err.contains("took the component") && err.contains("outside the body"), "{err}");
    // Its first voxel is a seed for the same lumen.
    let seed = format!("{},{},{}", first[0], first[1], first[2]);
    let args = ["segment", "ct.nrrd", "--threshold", ":-500", "--seed", &seed, "-o", "s.nrrd"];
    works(tmp.path(), &args);
    let file = |name| std::fs::read(tmp.path().join(name)).unwrap();
    assert!(file("m.nrrd") == file("s.nrrd"));
}

#[test]
fn only_outside_air_is_bad_input_and_leaves_nothing() {
    let tmp = tempfile::tempdir().unwrap();
    body(&tmp.path().join("ct.nrrd"), false);
    let args = ["segment", "ct.nrrd", "--threshold", ":-500", "-o", "m.nrrd"];
    let out = intima(tmp.path(), &args);
    let err = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(3), "{err}");
    assert!(err.contains("outside the body") && err.contains("seed"), "{err}");
    assert_eq!(names(tmp.path()), ["ct.nrrd"]);
}
