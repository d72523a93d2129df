//! Zarr and OME-Zarr as others write them, and what is refused.

use std::path::Path;

use common::volumes::{fixture, read, refusal};
use glam::{DVec3, UVec3};
use intima::formats::{ReadOptions, input_files, inspect};
use intima::volume::SampleType;
use serde_json::{Value, json};

/// The value that `tools/oracle/zarr_files.py` gives a voxel.
fn value([x, y, z]: [i64; 3]) -> f64 {
    if z >= 7 && x >= 9 { 0.0 } else { ((x * x / 8 + 3 * y + z) % 61 - 20) as f64 }
}

fn arrays() -> serde_json::Map<String, Value> {
    let packed = std::fs::File::open(fixture("zarr.json.gz")).unwrap();
    serde_json::from_reader(flate2::read::GzDecoder::new(packed)).unwrap()
}

/// Unpacks an array of the fixture.
fn unpack(files: &Value, to: &Path) {
    for (name, bytes) in files.as_object().unwrap() {
        let path = to.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let bytes = bytes.as_array().unwrap().iter().map(|b| b.as_u64().unwrap() as u8);
        std::fs::write(path, bytes.collect::<Vec<_>>()).unwrap();
    }
}

#[test]
fn every_codec_gives_the_values_that_zarr_python_wrote() {
    let arrays = arrays();
    assert_eq!(arrays.len(), 24);
    for (name, files) in &arrays {
        let dir = tempfile::tempdir().unwrap();
        unpack(files, dir.path());
        let volume = read(dir.path()).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(volume.grid.dims, UVec3::new(16, 9, 14), "{name}");
        let offset = if volume.samples.sample_type() == SampleType::U8 { 20.0 } else { 0.0 };
        for i in 0..volume.grid.len() {
            let v = volume.grid.voxel(i);
            let want = value(v.to_array().map(i64::from)) + offset;
            assert_eq!(volume.samples.get(i), want, "{name}: {v}");
        }
    }
}

/// A group with one level of 4 × 3 × 2 samples (x, y, z), 0 to 23 in the order of the file.
fn image(dir: &Path, shape: &[u64], multiscales: Value) {
    let level = dir.join("s0");
    std::fs::create_dir_all(&level).unwrap();
    let array = json!({
        "zarr_format": 2, "shape": shape, "chunks": shape, "dtype": "|u1", "compressor": null,
        "fill_value": 0, "order": "C", "filters": null, "dimension_separator": "."
    });
    std::fs::write(level.join(".zarray"), array.to_string()).unwrap();
    let key = vec!["0"; shape.len()].join(".");
    std::fs::write(level.join(key), (0..24).collect::<Vec<u8>>()).unwrap();
    let attributes = json!({ "multiscales": [multiscales] });
    std::fs::write(dir.join(".zattrs"), attributes.to_string()).unwrap();
}

fn axes(names: &str, more: &Value) -> Value {
    let axis = |name: char| {
        let kind = if "xyz".contains(name) { "space" } else { "channel" };
        let mut axis = json!({ "name": name.to_string(), "type": kind });
        if kind == "space" {
            axis.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        }
        axis
    };
    names.chars().map(axis).collect()
}

fn level(scale: Value, translation: Value) -> Value {
    json!([{ "path": "s0", "coordinateTransformations": [
        { "type": "scale", "scale": scale }, { "type": "translation", "translation": translation }
    ] }])
}

#[test]
fn axes_in_any_order_with_scale_and_translation_give_the_same_volume() {
    // Samples of the file by (x, y, z), whatever the order of the axes.
    for (names, shape, strides) in [
        ("zyx", vec![2, 3, 4], [1, 4, 12]),
        ("xyz", vec![4, 3, 2], [6, 2, 1]),
        ("yczx", vec![3, 1, 2, 4], [1, 8, 4]),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let of = |x: f64, y: f64, z: f64| -> Value {
            names
                .chars()
                .map(|n| match n {
                    'x' => x,
                    'y' => y,
                    'z' => z,
                    _ => 1.0,
                })
                .collect()
        };
        let scales = json!({
            "version": "0.4",
            "axes": axes(names, &json!({ "unit": "micrometer" })),
            "datasets": level(of(500.0, 250.0, 2000.0), of(100.0, 200.0, -300.0)),
            "coordinateTransformations": [{ "type": "scale", "scale": of(2.0, 2.0, 1.0) }]
        });
        image(dir.path(), &shape, scales);
        for path in [dir.path().to_owned(), dir.path().join("s0")] {
            let volume = read(&path).unwrap();
            assert_eq!(volume.grid.dims, UVec3::new(4, 3, 2), "{names}");
            assert!((volume.grid.spacing_mm - DVec3::new(1.0, 0.5, 2.0)).length() < 1e-12);
            assert!((volume.grid.origin_mm - DVec3::new(0.2, 0.4, -0.3)).length() < 1e-12);
            for i in 0..24 {
                let v = volume.grid.voxel(i).to_array();
                let want: u32 = (0..3).map(|k| v[k] * strides[k]).sum();
                assert_eq!(volume.samples.get(i), f64::from(want), "{names} {v:?}");
            }
        }
        let info = inspect(dir.path(), &ReadOptions::default()).unwrap();
        assert_eq!((info.format.as_str(), info.notes.len()), ("OME-Zarr", 1), "{:?}", info.notes);
        assert_eq!(input_files(dir.path()).unwrap().len(), 3, "attributes, array and chunk");
    }
}

#[test]
fn an_orientation_of_the_axes_turns_the_volume() {
    let dir = tempfile::tempdir().unwrap();
    let mut axes = axes("zyx", &json!({ "unit": "millimeter" }));
    for (axis, way) in
        [(0, "superior-to-inferior"), (1, "anterior-to-posterior"), (2, "left-to-right")]
    {
        axes[axis]["orientation"] = json!({ "type": "anatomical", "value": way });
    }
    let datasets = level(json!([1, 1, 1]), json!([7, 0, 0]));
    image(dir.path(), &[2, 3, 4], json!({ "axes": axes, "datasets": datasets }));
    let image = inspect(dir.path(), &ReadOptions::default()).unwrap();
    assert!(image.notes.is_empty(), "{:?}", image.notes);
    let image = image.image.unwrap();
    assert_eq!((image.orientation.as_str(), image.origin_mm), ("RPI", [0.0, 0.0, -7.0]));
}

#[test]
fn version_0_5_and_a_collection_are_found_and_what_no_unit_is_given_for_is_said() {
    let dir = tempfile::tempdir().unwrap();
    unpack(&arrays()["v3_sharded_end"], &dir.path().join("scan/0/a"));
    let scales = json!([{ "axes": axes("zyx", &json!({})), "datasets": [{ "path": "a" }] }]);
    let group = json!({ "zarr_format": 3, "node_type": "group",
        "attributes": { "ome": { "version": "0.5", "multiscales": scales } } });
    std::fs::write(dir.path().join("scan/0/zarr.json"), group.to_string()).unwrap();
    let top = json!({ "zarr_format": 3, "node_type": "group",
        "attributes": { "ome": { "bioformats2raw.layout": 3 } } });
    std::fs::write(dir.path().join("scan/zarr.json"), top.to_string()).unwrap();
    let info = inspect(&dir.path().join("scan"), &ReadOptions::default()).unwrap();
    let said = ["no scale", "no orientation", "no unit", "a collection"];
    assert!(
        info.notes.iter().zip(said).all(|(note, what)| note.contains(what)),
        "{:?}",
        info.notes
    );
    let volume = read(&dir.path().join("scan")).unwrap();
    assert_eq!(volume.real(volume.grid.index(UVec3::new(3, 5, 2))), value([3, 5, 2]));
}

#[test]
fn what_is_not_one_volume_or_is_damaged_is_refused_by_name() {
    let zyx = axes("zyx", &json!({}));
    let good = level(json!([1, 1, 1]), json!([0, 0, 0]));
    let with = |axes: &Value, datasets: &Value| json!({ "axes": axes, "datasets": datasets });
    let cases = [
        (
            "two axes of space",
            vec![2, 3, 4],
            with(&axes("cyx", &json!({})), &good),
            "2 axes of space",
        ),
        (
            "channels",
            vec![2, 1, 3, 4],
            with(&axes("czyx", &json!({})), &level(json!([1, 1, 1, 1]), json!([0, 0, 0, 0]))),
            "2 samples along axis 0",
        ),
        ("no names", vec![2, 3, 4], with(&json!([{}, {}, {}]), &good), "axes"),
        (
            "unit",
            vec![2, 3, 4],
            with(&axes("zyx", &json!({ "unit": "parsec" })), &good),
            "unit of an axis",
        ),
        (
            "scale of two",
            vec![2, 3, 4],
            with(&zyx, &level(json!([1, 1]), json!([0, 0, 0]))),
            "a number an axis",
        ),
        (
            "scale of 0",
            vec![2, 3, 4],
            with(&zyx, &level(json!([0, 1, 1]), json!([0, 0, 0]))),
            "spacing",
        ),
        ("outside", vec![2, 3, 4], with(&zyx, &json!([{ "path": "../s0" }])), "without `..`"),
        ("absent", vec![2, 3, 4], with(&zyx, &json!([{ "path": "s1" }])), "no array is there"),
        (
            "rotation",
            vec![2, 3, 4],
            with(
                &zyx,
                &json!([{ "path": "s0",
            "coordinateTransformations": [{ "type": "rotation" }] }]),
            ),
            "transformation",
        ),
        ("larger", vec![20, 30, 40], with(&zyx, &good), "damaged"),
    ];
    for (name, shape, scales, why) in cases {
        let dir = tempfile::tempdir().unwrap();
        image(dir.path(), &shape, scales);
        let said = refusal(dir.path());
        assert!(said.contains(why), "{name}: {said}");
    }
}

/// Replaces fields of an array's metadata.
fn changed(dir: &Path, name: &str, fields: &Value) {
    let path = dir.join(name);
    let mut meta: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    meta.as_object_mut().unwrap().extend(fields.as_object().unwrap().clone());
    std::fs::write(path, meta.to_string()).unwrap();
}

#[test]
fn metadata_that_lie_take_no_memory() {
    let arrays = arrays();
    let side = 1_u64 << 40;
    let huge = json!({ "name": "regular", "configuration": { "chunk_shape": [4096, 4096, 4096] } });
    let small = json!({ "name": "regular", "configuration": { "chunk_shape": [1, 1, 1] } });
    for (case, file, fields, why) in [
        ("v2_zstd", ".zarray", json!({ "shape": [side, side, side] }), "more than"),
        (
            "v2_zstd",
            ".zarray",
            json!({ "shape": [9000, 9000, 160], "chunks": [100, 90, 90] }),
            "truncated",
        ),
        ("v2_zstd", ".zarray", json!({ "shape": [0, 14, 16] }), "shape"),
        ("v2_zstd", ".zarray", json!({ "shape": [14, 16] }), "chunk shape"),
        ("v2_zstd", ".zarray", json!({ "chunks": [7, 9, 10] }), "damaged"),
        ("v2_zstd", ".zarray", json!({ "chunks": [1 << 20, 1 << 20, 9] }), "a chunk of more than"),
        ("v2_zstd", ".zarray", json!({ "chunks": ["7", 9, 9] }), "chunks"),
        ("v2_zstd", ".zarray", json!({ "dtype": "<c8" }), "dtype"),
        ("v2_zstd", ".zarray", json!({ "fill_value": 70000 }), "fill_value"),
        ("v2_zstd", ".zarray", json!({ "filters": [{ "id": "delta" }] }), "filters"),
        ("v2_blosc_lz4_bits", ".zarray", json!({ "chunks": [6, 9, 9] }), "damaged"),
        ("v3_raw", "zarr.json", json!({ "chunk_grid": huge }), "a chunk of more than"),
        (
            "v3_raw",
            "zarr.json",
            json!({ "shape": [1 << 14, 1 << 14, 128], "chunk_grid": small }),
            "chunks",
        ),
        ("v3_sharded_end", "zarr.json", json!({ "codecs": [] }), "no codec makes bytes"),
        ("v3_raw", "zarr.json", json!({ "data_type": "complex64" }), "data_type"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        unpack(&arrays[case], dir.path());
        changed(dir.path(), file, &fields);
        let said = refusal(dir.path());
        assert!(said.contains(why), "{case} {fields}: {said}");
    }
}

#[test]
fn chunks_with_changed_or_missing_bytes_are_refused_or_read_and_never_panic() {
    let arrays = arrays();
    let mut state = 9u64;
    let mut next = move |below: usize| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as usize % below
    };
    for (name, files) in &arrays {
        for _ in 0..12 {
            let dir = tempfile::tempdir().unwrap();
            unpack(files, dir.path());
            let chunks: Vec<&String> = files.as_object().unwrap().keys().collect();
            let chunk = dir.path().join(chunks[next(chunks.len())]);
            let mut bytes = std::fs::read(&chunk).unwrap();
            for _ in 0..=next(4) {
                let at = next(bytes.len());
                bytes[at] = next(256) as u8;
            }
            bytes.truncate(bytes.len() - next(2) * next(bytes.len()));
            std::fs::write(&chunk, bytes).unwrap();
            if let Ok(volume) = read(dir.path()) {
                assert!(volume.grid.len() < 1 << 30, "{name}");
            }
        }
    }
}

#[cfg(unix)]
#[test]
fn a_chunk_that_is_a_pipe_or_a_link_elsewhere_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let array = dir.path().join("a");
    unpack(&arrays()["v3_raw"], &array);
    let secret = dir.path().join("secret");
    let chunk = array.join("c/0/0/0");
    std::fs::rename(&chunk, &secret).unwrap();
    std::os::unix::fs::symlink(&secret, &chunk).unwrap();
    let said = refusal(&array);
    assert!(said.contains("link elsewhere"), "{said}");
    std::fs::remove_file(&chunk).unwrap();
    assert!(std::process::Command::new("mkfifo").arg(&chunk).status().unwrap().success());
    let said = refusal(&array);
    assert!(said.contains("not a plain file") || said.contains("not supported"), "{said}");
}

#[test]
fn a_level_in_a_folder_of_its_own_has_the_geometry_of_its_image() {
    let dir = tempfile::tempdir().unwrap();
    let datasets = json!([{ "path": "scale0/s0", "coordinateTransformations": [
        { "type": "scale", "scale": [3, 2, 1] }, { "type": "translation", "translation": [0, 0, 5] }
    ] }]);
    let axes = axes("zyx", &json!({ "unit": "millimeter" }));
    image(&dir.path().join("scale0"), &[2, 3, 4], Value::Null);
    std::fs::remove_file(dir.path().join("scale0/.zattrs")).unwrap();
    std::fs::write(dir.path().join("scale0/.zgroup"), "{\"zarr_format\": 2}").unwrap();
    let attributes = json!({ "multiscales": [{ "axes": axes, "datasets": datasets }] });
    std::fs::write(dir.path().join(".zattrs"), attributes.to_string()).unwrap();
    for path in ["", "scale0/s0"] {
        let grid = read(&dir.path().join(path)).unwrap().grid;
        assert_eq!(grid.spacing_mm, DVec3::new(1.0, 2.0, 3.0), "{path}");
        assert_eq!(grid.origin_mm, DVec3::new(5.0, 0.0, 0.0), "{path}");
    }
}
