//! Nothing of a patient reaches an output: every free-text field of an input, its name and its
//! folder's hold a canary, and no product, no message and no argument of another program may.

use std::io::Read;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;

use flate2::bufread::{GzDecoder, ZlibDecoder};
use intima::formats::{read_mesh, write_mesh};
use intima::volume::Volume;

use super::*;

/// In no word of any language, and in no number.
const CANARY: &str = "ZQXJANE";

/// A canary that names the field it was put into.
fn in_field(field: &str) -> String {
    format!("{CANARY}^{field}")
}

/// The first canary in some bytes, in either case.
fn canary_in_bytes(bytes: &[u8]) -> Option<String> {
    let found = |w: &[u8]| w.eq_ignore_ascii_case(CANARY.as_bytes());
    let at = bytes.windows(CANARY.len()).position(found)?;
    let tail = &bytes[at..bytes.len().min(at + 40)];
    Some(String::from_utf8_lossy(tail).into_owned())
}

/// The first canary in a file's bytes, in what it holds compressed by gzip, or in the compressed
/// texts of a PNG.
fn canary_in(bytes: &[u8]) -> Option<String> {
    if let Some(found) = canary_in_bytes(bytes) {
        return Some(found);
    }
    let mut hidden = Vec::new();
    for (at, _) in bytes.windows(3).enumerate().filter(|(_, w)| *w == [0x1f, 0x8b, 8]) {
        // Damaged where those three bytes are something else.
        let _ = GzDecoder::new(&bytes[at..]).read_to_end(&mut hidden);
    }
    if bytes.starts_with(b"\x89PNG") {
        let mut at = 8;
        while let Some(head) = bytes.get(at..at + 8) {
            let size = u32::from_be_bytes([head[0], head[1], head[2], head[3]]) as usize;
            let body = bytes.get(at + 8..at + 8 + size).expect("a whole chunk");
            if [&b"zTXt"[..], b"iTXt", b"iCCP"].contains(&&head[4..]) {
                for (end, _) in body.iter().enumerate().filter(|(_, b)| **b == 0x78) {
                    let _ = ZlibDecoder::new(&body[end..]).read_to_end(&mut hidden);
                }
            }
            at += 12 + size;
        }
    }
    canary_in_bytes(&hidden)
}

/// All files below a folder.
fn files_below(dir: &Path) -> Vec<PathBuf> {
    let (mut open, mut files) = (vec![dir.to_owned()], Vec::new());
    while let Some(folder) = open.pop() {
        for path in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
            if path.is_dir() { open.push(path) } else { files.push(path) }
        }
    }
    files
}

/// Runs the program, whose products go to `out`, and finds no canary: not in a name of a file, not
/// in a file, not in what is printed. The number of files.
fn keeps_quiet(dir: &Path, args: &[&str]) -> usize {
    // Writes what it is called with and what it is given into its output.
    let folder = dir.join("bin");
    std::fs::create_dir_all(&folder).unwrap();
    let script = "#!/bin/sh\nfor last; do :; done\n{ echo \"$@\"; cat; } > \"$last\"\n";
    std::fs::write(folder.join("ffmpeg"), script).unwrap();
    std::fs::set_permissions(folder.join("ffmpeg"), PermissionsExt::from_mode(0o755)).unwrap();
    let path = std::env::var_os("PATH").unwrap_or_default();
    let all = std::iter::once(folder).chain(std::env::split_paths(&path));
    let _ = std::fs::remove_dir_all(dir.join("out"));
    std::fs::create_dir(dir.join("out")).unwrap();
    let out = Command::new(env!("CARGO_BIN_EXE_intima"))
        .args(args)
        .current_dir(dir)
        .env_remove("INTIMA_FAULT")
        .env("PATH", std::env::join_paths(all).unwrap())
        .env("XDG_CACHE_HOME", dir.join("out/caches"))
        .output()
        .unwrap();
    let (said, err) = (String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    assert!(out.status.success(), "{args:?}: {err}");
    for (what, text) in [("standard output", &said), ("standard error", &err)] {
        assert_eq!(canary_in(text.as_bytes()), None, "{args:?}: {what}: {text}");
    }
    let files = files_below(&dir.join("out"));
    for file in &files {
        let name = file.strip_prefix(dir).unwrap().to_string_lossy().into_owned();
        assert_eq!(canary_in(name.as_bytes()), None, "{args:?}");
        assert_eq!(canary_in(&std::fs::read(file).unwrap()), None, "{args:?}: {name}");
    }
    files.len()
}

/// Everything `run` makes of a volume in a folder with a canary for a name.
fn run_keeps_quiet(dir: &Path, input: &str) {
    let args = ["run", input, "--threshold", ":-455", "--out", "out/all", "--frames", "2"];
    let more = ["--size", "64x48", "--video", "out/v.mp4", "--write-path", "out/path.json"];
    let last = ["-vvv", "--json"];
    let files = keeps_quiet(dir, &[&args[..], &more, &last].concat());
    assert!(files > 12, "{files} files");
    let report = std::fs::read_to_string(dir.join("out/all/report.json")).unwrap();
    let folder = dir.file_name().unwrap().to_string_lossy();
    assert!(!report.contains(&*folder), "the report names the input's folder");
}

fn grey() -> Volume {
    Phantom::new(Kind::Tube, 40, [1.0; 3]).unwrap().grey(None, 1)
}

/// The bytes of the phantom written in a format.
fn written(dir: &Path, name: &str) -> Vec<u8> {
    write_volume(&dir.join(name), &grey()).unwrap();
    std::fs::read(dir.join(name)).unwrap()
}

/// Puts a file where its folder and its name are canaries; its path below `dir`.
fn hide(dir: &Path, extension: &str, bytes: &[u8]) -> String {
    let name = format!("{}/{}.{extension}", in_field("FOLDER"), in_field("FILE"));
    std::fs::create_dir_all(dir.join(in_field("FOLDER"))).unwrap();
    std::fs::write(dir.join(&name), bytes).unwrap();
    name
}

#[test]
fn canaries_are_found_wherever_they_hide() {
    let text = format!("a zqxjane {CANARY}");
    assert!(canary_in(b"of zqxJane").is_some() && canary_in(b"of Jane").is_none());
    let mut gz = flate2::read::GzEncoder::new(text.as_bytes(), flate2::Compression::best());
    let mut bytes = b"NRRD\n\n".to_vec();
    gz.read_to_end(&mut bytes).unwrap();
    assert!(canary_in_bytes(&bytes).is_none() && canary_in(&bytes).is_some());
    let mut file = Vec::new();
    let mut png = png::Encoder::new(&mut file, 1, 1);
    png.add_ztxt_chunk("Comment".into(), text).unwrap();
    png.write_header().unwrap().write_image_data(&[0]).unwrap();
    assert!(canary_in_bytes(&file).is_none() && canary_in(&file).is_some());
}

#[test]
fn no_text_of_a_nifti_header_reaches_an_output_of_a_run() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let mut bytes = written(tmp.path(), "a.nii");
    for (at, room, field) in [
        (4, 10, "data_type"),
        (14, 18, "db_name"),
        (148, 80, "descrip"),
        (228, 24, "aux_file"),
        (328, 16, "intent_name"),
    ] {
        let text = in_field(field);
        let text = &text.as_bytes()[..text.len().min(room)];
        bytes[at..at + text.len()].copy_from_slice(text);
    }
    // An extension of text (code 6), a multiple of 16 bytes long.
    let mut extension = [64i32.to_le_bytes(), 6i32.to_le_bytes()].concat();
    extension.extend(in_field("extension").bytes());
    extension.resize(64, 0);
    bytes[348] = 1;
    bytes[108..112].copy_from_slice(&416f32.to_le_bytes());
    bytes.splice(352..352, extension);
    run_keeps_quiet(tmp.path(), &hide(tmp.path(), "nii", &bytes));
}

#[test]
fn no_text_of_a_metaimage_header_reaches_an_output_of_a_run() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let mut bytes = written(tmp.path(), "a.mha");
    let at = bytes.windows(15).position(|w| w == b"ElementDataFile").unwrap();
    let fields = ["Comment", "Name", "PatientName", "PatientID", "StudyDate", "Modality"];
    let text: String = fields.iter().map(|f| format!("{f} = {}\n", in_field(f))).collect();
    bytes.splice(at..at, text.into_bytes());
    run_keeps_quiet(tmp.path(), &hide(tmp.path(), "mha", &bytes));
}

#[test]
fn no_text_of_a_nrrd_header_reaches_an_output_of_a_run() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let mut bytes = written(tmp.path(), "a.nrrd");
    let at = bytes.windows(2).position(|w| w == b"\n\n").unwrap() + 1;
    let name = in_field;
    let text = format!(
        "# {}\ncontent: {}\nsample units: {}\nlabels: \"{}\" \"b\" \"c\"\nPatientName:={}\n{}:=x\n",
        name("comment"),
        name("content"),
        name("units"),
        name("labels"),
        name("value"),
        name("key")
    );
    bytes.splice(at..at, text.into_bytes());
    run_keeps_quiet(tmp.path(), &hide(tmp.path(), "nrrd", &bytes));
}

#[test]
fn no_text_of_dicom_elements_reaches_an_output_of_a_run() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let volume = grey();
    let [columns, rows, slices] = volume.grid.dims.to_array();
    let folder = format!("{}/{}", in_field("FOLDER"), in_field("SERIES"));
    std::fs::create_dir_all(tmp.path().join(&folder)).unwrap();
    let area = (columns * rows) as usize;
    for z in 0..slices {
        let value = |i: usize| (volume.samples.get(z as usize * area + i) + 1024.0) as u16;
        let slice = volumes::Slice {
            canary: "ZQXJANE^DICOM",
            size: [columns as u16, rows as u16],
            pixel_spacing: "1\\1",
            position: [0.0, 0.0, f64::from(z)],
            pixels: (0..area).map(value).collect(),
            ..volumes::Slice::default()
        };
        let bytes = volumes::dicom_slice(&slice);
        assert!(canary_in(&bytes).is_some());
        let file = format!("{folder}/{}_{z:03}.dcm", in_field("SLICE"));
        std::fs::write(tmp.path().join(file), bytes).unwrap();
    }
    run_keeps_quiet(tmp.path(), &folder);
}

/// A mesh with canaries where its format has room for text.
fn mesh_with_canaries(dir: &Path, extension: &str) -> Vec<u8> {
    let (mesh, _) = read_mesh(&dir.join("mesh.ply"), None).unwrap();
    let path = dir.join(format!("plain.{extension}"));
    write_mesh(&path, &mesh).unwrap();
    let mut bytes = std::fs::read(path).unwrap();
    let find = |bytes: &[u8], what: &[u8]| {
        bytes.windows(what.len()).position(|w| w == what).expect("in the file")
    };
    let name = in_field;
    match extension {
        "ply" => {
            let at = find(&bytes, b"element vertex");
            let (a, b, c) = (name("comment"), name("info"), name("element"));
            let text = format!("comment {a}\nobj_info {b}\nelement {c} 0\nproperty int {c}\n");
            bytes.splice(at..at, text.into_bytes());
        }
        "obj" => {
            let [a, b, c, d] = ["comment", "object", "group", "material"].map(name);
            let text = format!("# {a}\nmtllib {d}.mtl\no {b}\ng {c}\nusemtl {d}\n");
            bytes.splice(0..0, text.into_bytes());
        }
        "stl" => {
            let text = name("header");
            bytes[40..40 + text.len()].copy_from_slice(text.as_bytes());
        }
        "vtp" => {
            let at = find(&bytes, b"</FieldData>");
            let codes: String = name("string").bytes().map(|b| format!("{b} ")).collect();
            let text = format!(
                "<!-- {} --><Array type=\"String\" Name=\"{}\" NumberOfTuples=\"1\" \
                 format=\"ascii\">{codes}0</Array>",
                name("comment"),
                name("array")
            );
            bytes.splice(at..at, text.into_bytes());
        }
        _ => {
            let size = u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]) as usize;
            let mut json: Value = serde_json::from_slice(&bytes[20..20 + size]).unwrap();
            json["asset"]["copyright"] = name("copyright").into();
            json["asset"]["generator"] = name("generator").into();
            json["asset"]["extras"][name("key")] = name("extras").into();
            json["nodes"][0]["name"] = name("node").into();
            json["meshes"][0]["name"] = name("mesh").into();
            let mut text = json.to_string().into_bytes();
            text.resize(text.len().next_multiple_of(4), b' ');
            bytes[12..16].copy_from_slice(&(text.len() as u32).to_le_bytes());
            bytes.splice(20..20 + size, text);
            let whole = bytes.len() as u32;
            bytes[8..12].copy_from_slice(&whole.to_le_bytes());
        }
    }
    assert!(canary_in(&bytes).is_some());
    bytes
}

#[test]
fn no_text_of_a_mesh_reaches_an_output_of_simplify_or_fair() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    phantom(dir, Kind::Tube, 32);
    works(dir, &["surface", "--mask", "mask.nrrd", "-o", "mesh.ply"]);
    for extension in ["ply", "obj", "stl", "vtp"] {
        let input = hide(dir, extension, &mesh_with_canaries(dir, extension));
        for output in ["out/o.ply", "out/o.obj", "out/o.stl", "out/o.vtp", "out/o.glb"] {
            let args = ["simplify", &input, "--faces", "300", "-o", output, "-vvv", "--json"];
            assert_eq!(keeps_quiet(dir, &[&args[..], &["--measure"]].concat()), 1);
            assert_eq!(keeps_quiet(dir, &["fair", &input, "-o", output, "-vvv", "--json"]), 1);
        }
    }
}
