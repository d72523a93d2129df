//! The program as its users and their scripts meet it: products, exit codes, one-line errors,
//! nothing half written, nothing of a patient.

#[cfg(unix)]
mod canaries;
#[cfg(unix)]
mod crash;
mod documents;
#[cfg(feature = "faults")]
mod faults;
#[cfg(unix)]
mod files;
mod outside_air;
mod paper;
mod report_page;

use std::path::Path;
use std::process::{Command, Output};

use common::volumes;
use intima::formats::{ReadOptions, read_png, read_volume, write_volume};
use intima::volume::phantom::{Kind, Phantom};
use serde_json::{Value, json};

fn intima(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_intima"))
        .args(args)
        .current_dir(dir)
        .env_remove("INTIMA_FAULT")
        .output()
        .expect("the program starts")
}

/// Runs and wants success; the last line of standard output as JSON, if it is that.
fn works(dir: &Path, args: &[&str]) -> Value {
    let out = intima(dir, args);
    let err = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{args:?}: {:?}\n{err}", out.status.code());
    let text = String::from_utf8_lossy(&out.stdout);
    text.lines().last().and_then(|l| serde_json::from_str(l).ok()).unwrap_or(Value::Null)
}

fn phantom(dir: &Path, kind: Kind, size: u32) {
    let p = Phantom::new(kind, size, [1.0; 3]).unwrap();
    write_volume(&dir.join("ct.nrrd"), &p.grey(None, 1)).unwrap();
    write_volume(&dir.join("mask.nrrd"), &p.mask()).unwrap();
}

fn names(dir: &Path) -> Vec<String> {
    let mut all: Vec<String> = std::fs::read_dir(dir)
        .unwrap()
        .map(|e| e.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    all.sort();
    all
}

/// Whether frames can be drawn here; a machine that must have a device fails instead.
pub(crate) fn can_draw() -> bool {
    let devices = intima::vk::list().unwrap_or_default();
    let required = std::env::var("INTIMA_REQUIRE_GPU").is_ok_and(|v| v == "1");
    assert!(!devices.is_empty() || !required, "no Vulkan device");
    if devices.is_empty() {
        eprintln!("skipped: no Vulkan device");
    }
    !devices.is_empty()
}

#[test]
fn run_writes_every_product_and_a_report_of_this_run() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Bend, 64);
    let args = ["run", "ct.nrrd", "--threshold", ":-455", "--out", "out", "--frames", "3"];
    let more = ["--size", "96x64", "--view", "split", "--base", "--lod", "culled", "--json"];
    let json = works(tmp.path(), &[&args[..], &more].concat());
    let out = tmp.path().join("out");
    let want = [
        "base.ply",
        "branches.vtp",
        "centerline.csv",
        "centerline.mrk.json",
        "centerline.vtp",
        "distance.nrrd",
        "frames",
        "mask.nrrd",
        "report.html",
        "report.json",
        "surface.ply",
        "unseen.csv",
    ];
    assert_eq!(names(&out), want);
    let frames = ["frame_00001.png", "frame_00002.png", "frame_00003.png"];
    assert_eq!(names(&out.join("frames")), frames);
    let (w, h, _) = read_png(&out.join("frames/frame_00002.png")).unwrap();
    assert_eq!((w, h), (96, 64));
    let report: Value =
        serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    assert_eq!(report, json);
    assert_eq!(report["schema"], "intima.report/1");
    assert_eq!([&report["space"], &report["unit"]], ["LPS", "mm"]);
    assert_eq!(report["surface"]["watertight"], true);
    assert_eq!(report["surface"]["euler"], 2);
    assert_eq!(report["frames"]["count"], 3);
    assert_eq!(report["lod"]["mode"], "culled");
    assert_eq!(report["lod"]["finest_faces"], report["surface"]["faces"]);
    let drawn = report["frames"]["triangles_p99"].as_u64().unwrap();
    assert!(drawn > 0 && drawn < report["surface"]["faces"].as_u64().unwrap());
    assert!(report["frames"]["min_near_clearance_mm"].as_f64() > Some(0.0));
    let names: Vec<&str> =
        report["stages"].as_array().unwrap().iter().map(|s| s["name"].as_str().unwrap()).collect();
    let wanted =
        ["read", "segment", "wall field", "distance, smooth", "visibility", "route", "surface"];
    for stage in wanted.into_iter().chain(["field normals"]) {
        assert!(names.contains(&stage), "{stage} in {names:?}");
    }
    let total = report["total_ms"].as_f64().unwrap();
    for stage in report["stages"].as_array().unwrap() {
        let (start, ms) = (stage["start_ms"].as_f64().unwrap(), stage["ms"].as_f64().unwrap());
        assert!(start >= 0.0 && start + ms <= total, "{stage} of {total} ms");
    }
    // No path of this machine in the report.
    let text = report.to_string();
    assert!(!text.contains(&*tmp.path().to_string_lossy()) && !text.contains("ct.nrrd"));
    let mask = read_volume(&out.join("mask.nrrd"), &ReadOptions::default()).unwrap();
    assert_eq!(mask.range(), Some((0.0, 2.0)));
}

#[test]
fn a_shorter_flight_leaves_nothing_of_the_one_before_in_its_folder() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Bend, 32);
    let out = tmp.path().join("out");
    let fly = |frames: &str, more: &[&str]| {
        let args = ["run", "--mask", "mask.nrrd", "--out", "out", "--size", "64x48", "--frames"];
        intima(tmp.path(), &[&args[..], &[frames], more].concat())
    };
    assert!(fly("4", &[]).status.success());
    for other in ["frame_1.png", "frame_000001.png", "frame_00009.txt", "notes"] {
        std::fs::write(out.join("frames").join(other), "kept").unwrap();
    }
    assert!(fly("2", &[]).status.success());
    let want = ["frame_00001.png", "frame_00002.png", "frame_000001.png", "frame_00009.txt"];
    let mut want = [&want[..], &["frame_1.png", "notes"]].concat();
    want.sort_unstable();
    assert_eq!(names(&out.join("frames")), want);
    // One that fails among its frames leaves no report either.
    std::fs::remove_file(out.join("frames/frame_00002.png")).unwrap();
    std::fs::create_dir(out.join("frames/frame_00002.png")).unwrap();
    let failed = fly("3", &[]);
    assert_eq!(failed.status.code(), Some(1), "{}", String::from_utf8_lossy(&failed.stderr));
    assert!(String::from_utf8_lossy(&failed.stderr).contains("frame_00002.png"));
    assert!(!out.join("report.json").exists());
}

#[test]
fn a_run_that_fails_before_its_first_frame_leaves_no_file() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Bend, 32);
    for threads in ["1", "2"] {
        let args = ["run", "--mask", "mask.nrrd", "--out", "out", "--threads", threads];
        // Nowhere is seen before anything is computed; a folder in its place when it is written.
        std::fs::create_dir_all(tmp.path().join("path.json")).unwrap();
        for (path, code) in [("nowhere/path.json", 2), ("path.json", 1)] {
            let more = ["--frames", "2", "--size", "64x48", "--write-path", path];
            let out = intima(tmp.path(), &[&args[..], &more].concat());
            assert_eq!(out.status.code(), Some(code), "{}", String::from_utf8_lossy(&out.stderr));
            assert_eq!(names(tmp.path()), ["ct.nrrd", "mask.nrrd", "path.json"]);
        }
    }
}

#[test]
fn frames_are_the_same_bytes_with_one_thread_and_with_two() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Bend, 64);
    let frames = |threads: &str, out: &str| {
        let args = ["record", "--mask", "mask.nrrd", "--out", out, "--threads", threads];
        works(tmp.path(), &[&args[..], &["--frames", "4", "--size", "160x120"]].concat());
        let dir = tmp.path().join(out);
        names(&dir).iter().map(|n| std::fs::read(dir.join(n)).unwrap()).collect::<Vec<_>>()
    };
    let one = frames("1", "a");
    assert_eq!(one.len(), 4);
    assert!(one == frames("2", "b") && one == frames("2", "c"));
}

#[test]
fn every_way_of_drawing_shows_nearly_the_same() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Bend, 128);
    let film = |lod: &str, out: &str| {
        let args = ["record", "--mask", "mask.nrrd", "--out", out, "--json", "--lod"];
        let lod: Vec<&str> = lod.split(' ').collect();
        let more = ["--frames", "3", "--size", "160x120", "--msaa", "1"];
        let report = works(tmp.path(), &[&args[..], &lod, &more].concat());
        let pictures: Vec<Vec<u8>> = names(&tmp.path().join(out))
            .iter()
            .map(|n| read_png(&tmp.path().join(out).join(n)).unwrap().2)
            .collect();
        (report, pictures)
    };
    let (whole, want) = film("off", "off");
    assert_eq!(whole["lod"]["mode"], "off");
    for (lod, out) in [("vds", "c"), ("vds --scheme sqrt3", "d"), ("vds --scheme 4-8", "e")] {
        let (report, got) = film(lod, out);
        let mode = lod.split(' ').next();
        assert_eq!(report["lod"]["mode"].as_str(), mode);
        let scheme = lod.split(' ').nth(2).or((mode == Some("vds")).then_some("1-to-4"));
        assert_eq!(report["lod"]["scheme"].as_str(), scheme);
        for (a, b) in want.iter().zip(&got) {
            let sum: u64 = a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
            let apart = sum as f64 / a.len() as f64;
            // Relative to the contrast of the picture, which the light decides.
            let mean = a.iter().map(|v| f64::from(*v)).sum::<f64>() / a.len() as f64;
            let square: f64 = a.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum();
            let contrast = (square / a.len() as f64).sqrt();
            println!("{lod}: {apart:.2} of a contrast of {contrast:.1}");
            assert!(30.0 * apart < contrast, "{lod}: {apart} of a contrast of {contrast}");
        }
    }
    // Of a closed wall nothing that is seen is left out.
    let (culled, got) = film("culled", "f");
    assert_eq!(culled["lod"]["mode"], "culled");
    for (a, b) in want.iter().zip(&got) {
        // On the crest of a fold front and back may have the same depth, and the back win.
        let apart = a.chunks(3).zip(b.chunks(3)).filter(|(a, b)| a != b).count();
        assert!(apart <= 4, "{apart} pixels see what was left out");
    }
    let drawn = |report: &Value| report["frames"]["triangles_p50"].as_u64().unwrap();
    assert!(2 * drawn(&culled) < drawn(&whole), "{} of {}", drawn(&culled), drawn(&whole));
}

#[test]
fn every_computing_command_repeats_in_memory_and_answers_one_json_line() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 48);
    works(tmp.path(), &["surface", "--mask", "mask.nrrd", "-o", "in.ply"]);
    for (command, input, output) in [
        ("segment", ["--mask", "mask.nrrd"], "o.nii.gz"),
        ("distance", ["--mask", "mask.nrrd"], "o.nrrd"),
        ("hessian", ["--mask", "mask.nrrd"], "o.mha"),
        ("surface", ["--mask", "mask.nrrd"], "o.vtp"),
        ("centerline", ["--mask", "mask.nrrd"], "o.csv"),
        ("fair", ["in.ply", "-q"], "o.obj"),
    ] {
        let args = [command, input[0], input[1], "-o", output, "--repeat", "3", "--json"];
        let out = intima(tmp.path(), &args);
        assert!(out.status.success(), "{command}: {}", String::from_utf8_lossy(&out.stderr));
        let text = String::from_utf8(out.stdout).unwrap();
        assert_eq!(text.lines().count(), 1, "{command}");
        let json: Value = serde_json::from_str(&text).unwrap();
        for key in ["median_s", "min_s", "stages", "device", "peak_memory_mb"] {
            assert!(!json[key].is_null(), "{command} has no {key}");
        }
        assert_eq!(json["runs"], 3);
        assert!(tmp.path().join(output).exists());
    }
}

/// A tube that runs out of the volume at both ends.
fn open_tube(dir: &Path) {
    let mut voxels = vec![0u8; 20 * 20 * 12];
    for (i, v) in voxels.iter_mut().enumerate() {
        let (x, y) = ((i % 20) as f64 - 9.5, (i / 20 % 20) as f64 - 9.5);
        *v = u8::from(x.hypot(y) < 6.0);
    }
    let grid = intima::volume::Grid::axis_aligned([20, 20, 12], [1.0; 3]);
    let volume = intima::volume::Volume::new(grid, voxels.into());
    intima::formats::write_volume(&dir.join("open.nrrd"), &volume).unwrap();
}

#[test]
fn open_ends_reports_the_mesh_that_it_writes_and_leaves_no_vertex_without_a_face() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    open_tube(dir);
    let run = |more: &[&str]| {
        let all = [&["surface", "--mask", "open.nrrd", "-o", "o.ply", "--json"], more].concat();
        let out = intima(dir, &all);
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let json: Value = serde_json::from_slice(&out.stdout).unwrap();
        let mesh = intima::formats::read_mesh(&dir.join("o.ply"), None).unwrap().0;
        let used: std::collections::BTreeSet<u32> = mesh.faces.iter().flatten().copied().collect();
        assert_eq!(used.len(), mesh.positions.len(), "{more:?}: a vertex without a face");
        assert_eq!(json["surface"]["vertices"], mesh.positions.len(), "{more:?}");
        assert_eq!(json["surface"]["faces"], mesh.faces.len(), "{more:?}");
        json["surface"].clone()
    };
    let closed = run(&[]);
    assert_eq!((&closed["watertight"], &closed["euler"]), (&true.into(), &2.into()));
    let open = run(&["--open-ends"]);
    assert_eq!((&open["watertight"], &open["euler"]), (&false.into(), &0.into()), "a cylinder");
    assert!(open["area_mm2"].as_f64() < closed["area_mm2"].as_f64());
    run(&["--open-ends", "--decimate", "300"]);
}

#[test]
fn meshes_look_outwards_as_other_programs_expect_and_either_side_is_an_input() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    phantom(dir, Kind::Y, 32);
    let mesh = |name: &str| intima::formats::read_mesh(&dir.join(name), None).unwrap().0;
    for (name, more, is_inward) in
        [("out.ply", &[][..], false), ("in.ply", &["--facing", "in"][..], true)]
    {
        works(dir, &[&["surface", "--mask", "mask.nrrd", "-o", name], more].concat());
        let mesh = mesh(name);
        // Enclosed volume by the faces' own sign, and the normals with them.
        assert_eq!(mesh.volume_mm3() > 0.0, is_inward, "{name}");
        let along = |f: &[u32; 3]| mesh.face_cross(*f).dot(mesh.normals[f[0] as usize]) > 0.0;
        let agree = mesh.faces.iter().filter(|f| along(f)).count();
        assert!(agree * 100 > mesh.faces.len() * 99, "{name}: normals look as the faces do");
        works(dir, &["segment", name, "--mesh-spacing", "1", "-o", &format!("{name}.nrrd")]);
    }
    let bytes = |name: &str| std::fs::read(dir.join(name)).unwrap();
    assert_eq!(bytes("out.ply.nrrd"), bytes("in.ply.nrrd"), "the same lumen from either side");
    works(
        dir,
        &["run", "--mask", "mask.nrrd", "--frames", "1", "--size", "32x32", "--out", "r", "--base"],
    );
    for name in ["r/surface.ply", "r/base.ply"] {
        assert!(mesh(name).volume_mm3() < 0.0, "{name}");
    }
}

#[test]
fn a_graph_of_all_branches_is_written_whatever_line_is_asked_for() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Y, 64);
    let read = |name: &str| -> Value {
        serde_json::from_slice(&std::fs::read(tmp.path().join(name)).unwrap()).unwrap()
    };
    let mask = ["centerline", "--mask", "mask.nrrd", "-o", "o.csv"];
    works(tmp.path(), &[&mask[..], &["--graph", "path.json"]].concat());
    works(tmp.path(), &[&mask[..], &["--tree", "--graph", "tree.json"]].concat());
    let (path, tree) = (read("path.json"), read("tree.json"));
    assert_eq!(tree["schema"], "intima.graph/1");
    let kinds = |graph: &Value, kind: &str| {
        graph["nodes"].as_array().unwrap().iter().filter(|n| n["kind"] == kind).count()
    };
    // The root and the phantom's four tips.
    assert_eq!((kinds(&tree, "end"), kinds(&tree, "junction")), (5, 3));
    assert_eq!((kinds(&path, "end"), kinds(&path, "junction")), (5, 3));
    assert_eq!((&tree["roots"], &path["roots"]), (&json!([0]), &json!([0])));
    let said = |more: &[&str]| -> Value {
        let out = intima(tmp.path(), &[&mask[..], more, &["--json"]].concat());
        serde_json::from_slice(&out.stdout).unwrap()
    };
    let tree = said(&["--tree"])["centerline"]["tree"].take();
    let counted = ["branches", "terminal_branches", "greatest_generation", "generations", "loops"]
        .map(|name| tree[name].clone());
    assert_eq!(counted, [json!(7), json!(4), json!(2), json!([1, 2, 4]), json!(0)]);
    assert!(tree["generation_lengths_mm"].as_array().is_some_and(|l| l.len() == 3));
    assert_eq!(said(&[])["centerline"]["tree"], Value::Null);
    let wrong = [&mask[..], &["--graph", "o.txt"]].concat();
    assert_eq!(intima(tmp.path(), &wrong).status.code(), Some(2));
}

#[test]
fn branches_are_flown_with_cuts_and_a_missing_one_is_named() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Y, 64);
    let film = |route: &'static str| {
        let mask = ["record", "--mask", "mask.nrrd", "--out", "film", "--json", "--route", route];
        let size = ["--frames", "20", "--size", "64x48", "--lod", "off", "--msaa", "1"];
        intima(tmp.path(), &[&mask[..], &size].concat())
    };
    let cuts = |route| {
        let out = film(route);
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let report: Value = serde_json::from_slice(&out.stdout).unwrap();
        let branches = report["centerline"]["branches"].as_u64().unwrap() as usize;
        (branches, report["frames"]["cuts"].as_array().unwrap().len())
    };
    let (branches, of_all) = cuts("all");
    assert_eq!((branches, of_all), (4, 3));
    assert_eq!(cuts("leaf:2"), (4, 0));
    let missing = film("leaf:9");
    assert_eq!(missing.status.code(), Some(3));
    let said = String::from_utf8_lossy(&missing.stderr).into_owned();
    assert!(said.contains("there is no branch 9; the centerline has 4"), "{said}");
    assert_eq!(film("twig").status.code(), Some(2));
}

#[test]
fn the_hessian_of_grey_values_asks_for_no_lumen() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 48);
    let args = ["hessian", "ct.nrrd", "--of", "grey", "--response", "tubeness", "-o", "o.nrrd"];
    works(tmp.path(), &args);
    assert!(tmp.path().join("o.nrrd").exists());
}

#[test]
fn every_command_that_reads_or_writes_says_the_most_memory_it_held() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 48);
    works(tmp.path(), &["surface", "--mask", "mask.nrrd", "-o", "in.ply"]);
    let lumen = ["ct.nrrd", "--threshold", ":-455"];
    let film = ["--frames", "1", "--size", "16x16", "--out", "film"];
    let mut all: Vec<Vec<&str>> = vec![
        vec!["info", "ct.nrrd"],
        vec!["convert", "ct.nrrd", "-o", "o.nii"],
        vec!["phantom", "tube", "--size", "32", "-o", "p.nrrd"],
        [&["segment"], &lumen[..], &["-o", "o.nrrd"]].concat(),
        [&["distance"], &lumen[..], &["-o", "o.nrrd"]].concat(),
        [&["hessian"], &lumen[..], &["-o", "o.nrrd"]].concat(),
        [&["centerline"], &lumen[..], &["-o", "o.csv"]].concat(),
        [&["surface"], &lumen[..], &["-o", "o.ply"]].concat(),
        vec!["fair", "in.ply", "-o", "o.ply"],
        vec!["simplify", "in.ply", "--faces", "300", "-o", "o.ply"],
    ];
    if can_draw() {
        all.push([&["record"], &lumen[..], &film].concat());
        all.push([&["run"], &lumen[..], &film].concat());
    }
    for mut args in all {
        args.push("--json");
        let said = works(tmp.path(), &args)["peak_memory_mb"].as_f64();
        // Where the system does not say, it is 0.
        let least = if cfg!(target_os = "linux") { 1.0 } else { 0.0 };
        assert!(said.is_some_and(|mb| mb >= least), "{}: {said:?} MB", args[0]);
    }
}

#[test]
fn bad_input_is_one_line_that_names_it_with_its_own_exit_code_and_leaves_nothing() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    phantom(dir, Kind::Tube, 48);
    let whole = std::fs::read(dir.join("ct.nrrd")).unwrap();
    std::fs::write(dir.join("short.nrrd"), &whole[..whole.len() / 2]).unwrap();
    let header = b"NRRD0004\ntype: float\ndimension: 3\nsizes: 3000 3000 3000\nencoding: raw\n\n";
    std::fs::write(dir.join("lying.nrrd"), [&header[..], &[0; 20_000]].concat()).unwrap();
    std::fs::write(dir.join("note.txt"), "hello").unwrap();
    let before = names(dir);
    let cases: &[(&[&str], i32, &str)] = &[
        (&["distance", "none.nrrd", "--threshold", ":0", "-o", "o.nrrd"], 3, "none.nrrd"),
        (&["distance", "short.nrrd", "--threshold", ":0", "-o", "o.nrrd"], 3, "short.nrrd"),
        (&["distance", "lying.nrrd", "--threshold", ":0", "-o", "o.nrrd"], 3, "lying.nrrd"),
        (&["info", "note.txt"], 3, "note.txt"),
        (
            &["segment", "ct.nrrd", "--threshold", ":-455", "--seed", "99,0,0", "-o", "o.nrrd"],
            3,
            "seed",
        ),
        (
            &["segment", "ct.nrrd", "--threshold", ":-455", "--seed", "0,0,0", "-o", "o.nrrd"],
            3,
            "value 40",
        ),
        (
            &[
                "segment",
                "ct.nrrd",
                "--threshold",
                ":-455",
                "--seed-mm",
                "-500,0,0",
                "-o",
                "o.nrrd",
            ],
            3,
            "outside",
        ),
        (&["segment", "ct.nrrd", "--threshold", "9000:", "-o", "o.nrrd"], 3, "empty lumen"),
        (&["segment", "--mask", "mask.nrrd:7", "-o", "o.nrrd"], 3, "label 7"),
        (
            &["centerline", "--mask", "mask.nrrd", "--from", "-900,0,0", "-o", "o.csv"],
            3,
            "the start (-900.00",
        ),
        (&["segment", "ct.nrrd", "-o", "o.nrrd"], 2, "--threshold"),
        (&["segment", "ct.nrrd", "--threshold", "5:1", "-o", "o.nrrd"], 2, "5:1"),
        (&["surface", "--mask", "mask.nrrd", "--lambda", "1", "-o", "o.ply"], 2, "--lambda"),
        (&["record", "--mask", "mask.nrrd", "--size", "0x9", "--out", "o"], 2, "--size"),
        (&["record", "--mask", "mask.nrrd", "--scheme", "4-8", "--out", "o"], 2, "--scheme"),
        (&["distance", "--mask", "mask.nrrd", "-o", "o.xyz"], 2, "o.xyz"),
        (&["distance", "--mask", "mask.nrrd", "-o", "no/such/o.nrrd"], 2, "no folder"),
        (
            &["distance", "--mask", "mask.nrrd", "-o", "o.nrrd", "--max-memory", "0"],
            1,
            "--max-memory",
        ),
        (&["distance", "--mask", "mask.nrrd", "-o", "o.nrrd", "--device", "gpu:77"], 4, "77"),
    ];
    for (args, code, says) in cases {
        let out = intima(dir, args);
        let err = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(out.status.code(), Some(*code), "{args:?}: {err}");
        assert!(err.contains(says), "{args:?}: {err}");
        assert!(!err.contains("panicked"), "{args:?}: {err}");
        let lines = err.lines().filter(|l| l.starts_with("intima: ")).count();
        assert_eq!(lines, 1, "{args:?}: {err}");
        assert_eq!(names(dir), before, "{args:?}");
    }
    let usage = intima(dir, &["distance", "--no-such-flag"]);
    assert_eq!(usage.status.code(), Some(2));
}

#[test]
fn convert_and_info_keep_geometry_through_every_format() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    write_volume(&dir.join("a.nrrd"), &volumes::phantom(true)).unwrap();
    for (from, to) in
        [("a.nrrd", "b.nii.gz"), ("b.nii.gz", "c.mha"), ("c.mha", "d.nii"), ("d.nii", "e.nrrd")]
    {
        works(dir, &["convert", from, "-o", to]);
    }
    let (a, e) =
        (works(dir, &["info", "a.nrrd", "--json"]), works(dir, &["info", "e.nrrd", "--json"]));
    for key in ["dims", "range", "handedness", "orientation"] {
        assert_eq!(a[key], e[key], "{key}");
    }
    let numbers = |v: &Value| -> Vec<f64> {
        v.as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect()
    };
    for key in ["spacing_mm", "origin_mm", "direction"] {
        for (x, y) in numbers(&a[key]).iter().zip(numbers(&e[key])) {
            assert!((x - y).abs() < 1e-4 * x.abs().max(1.0), "{key}");
        }
    }
}

#[test]
fn help_completions_and_the_manual_cover_every_command() {
    let tmp = tempfile::tempdir().unwrap();
    let page = intima(tmp.path(), &["man"]).stdout;
    let page = String::from_utf8(page).unwrap();
    for shell in ["bash", "zsh", "fish"] {
        let text = intima(tmp.path(), &["completions", shell]).stdout;
        assert!(String::from_utf8(text).unwrap().contains("centerline"), "{shell}");
    }
    for sub in intima::cli::command().get_subcommands() {
        let help = intima(tmp.path(), &[sub.get_name(), "--help"]);
        assert!(help.status.success(), "{}", sub.get_name());
        assert!(page.contains(&format!("intima\\-{}", sub.get_name())), "{}", sub.get_name());
    }
    let page = include_str!("../../docs/commands.md");
    assert!(page.matches("| `intima ").count() > 15);
    for line in page.lines().filter(|l| l.starts_with("| `intima ")) {
        let name = line.trim_start_matches("| `intima ").split([' ', '`']).next().unwrap();
        assert!(intima::cli::command().find_subcommand(name).is_some(), "{name}");
    }
}

#[test]
fn manual_pages_of_every_command_are_written_into_a_folder() {
    let tmp = tempfile::tempdir().unwrap();
    let out = intima(tmp.path(), &["man", "--out", "."]);
    assert!(out.status.success() && out.stdout.is_empty());
    for sub in intima::cli::command().get_subcommands() {
        let page = format!("intima-{}.1", sub.get_name());
        let page = std::fs::read_to_string(tmp.path().join(page)).unwrap();
        assert!(page.contains(".TH"), "{}", sub.get_name());
    }
    let missing = intima(tmp.path(), &["man", "--out", "missing"]);
    assert!(!missing.status.success());
    assert!(String::from_utf8_lossy(&missing.stderr).contains("missing"));
}

#[test]
fn the_version_names_commit_and_features() {
    let tmp = tempfile::tempdir().unwrap();
    let long = String::from_utf8(intima(tmp.path(), &["--version"]).stdout).unwrap();
    assert!(long.starts_with(concat!("intima ", env!("CARGO_PKG_VERSION"), "\n")), "{long}");
    for line in ["commit: ", "features: ", "target: "] {
        assert!(long.lines().any(|l| l.starts_with(line) && l.len() > line.len()), "{long}");
    }
    let short = String::from_utf8(intima(tmp.path(), &["-V"]).stdout).unwrap();
    assert_eq!(short.lines().count(), 1, "{short}");
}

#[test]
fn a_reader_that_closes_the_pipe_is_no_error() {
    use std::process::Stdio;
    let mut child = Command::new(env!("CARGO_BIN_EXE_intima"))
        .arg("man")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let out = child.wait_with_output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
}

/// `run` needs --from for the end of a path, so `surface` has the flag by two names.
#[test]
fn surface_takes_its_vertices_from_the_mask_by_both_names_of_the_flag() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 24);
    let surface = ["surface", "ct.nrrd", "--threshold", ":-455", "--wall", "exact", "-o"];
    for (name, flag) in
        [("a.ply", "--from"), ("b.ply", "--surface-from"), ("c.ply", "--surface-from")]
    {
        let value = if name == "c.ply" { "grey" } else { "mask" };
        works(tmp.path(), &[&surface[..], &[name, flag, value]].concat());
    }
    let read = |name| std::fs::read(tmp.path().join(name)).unwrap();
    assert_eq!(read("a.ply"), read("b.ply"));
    assert_ne!(read("b.ply"), read("c.ply"));
}

#[test]
fn no_output_takes_the_place_of_an_input() {
    let dir = tempfile::tempdir().unwrap();
    phantom(dir.path(), Kind::Tube, 24);
    let before = std::fs::read(dir.path().join("mask.nrrd")).unwrap();
    let args = ["run", "--mask", "mask.nrrd", "--out", ".", "--frames", "2", "--size", "64x64"];
    let out = intima(dir.path(), &args);
    let said = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(2), "{said}");
    assert!(said.contains("mask.nrrd: an output of this run would take the place"), "{said}");
    assert_eq!(std::fs::read(dir.path().join("mask.nrrd")).unwrap(), before);
    // The core that is written is not the mask that is read.
    let args = ["record", "--mask", "mask.nrrd", "--core", "mask.nrrd", "--out", "frames"];
    assert_eq!(intima(dir.path(), &args).status.code(), Some(2));
    assert_eq!(names(dir.path()), ["ct.nrrd", "mask.nrrd"]);
}

#[test]
fn names_of_further_outputs_are_checked_before_anything_is_written() {
    let dir = tempfile::tempdir().unwrap();
    phantom(dir.path(), Kind::Tube, 24);
    for args in [
        vec!["run", "--mask", "mask.nrrd", "--core", "c.vtk", "--out", "o"],
        vec!["segment", "--mask", "mask.nrrd", "--core", "c.vtk", "-o", "s.nrrd"],
        vec!["centerline", "--mask", "mask.nrrd", "--core", "no/c.nrrd", "-o", "l.csv"],
        vec!["hessian", "ct.nrrd", "--of", "grey", "--core", "c.nrrd", "-o", "h.nrrd"],
        vec!["surface", "--mask", "mask.nrrd", "--mode", "paper", "--refine", "2", "-o", "s.ply"],
    ] {
        let out = intima(dir.path(), &args);
        assert_eq!(out.status.code(), Some(2), "{args:?}");
        assert_eq!(names(dir.path()), ["ct.nrrd", "mask.nrrd"], "{args:?}");
    }
    let args = ["surface", "--mask", "mask.nrrd", "-o", "w.ply"];
    works(dir.path(), &args);
    let out =
        intima(dir.path(), &["fair", "w.ply", "--mask", "mask.nrrd", "--sigma=-1", "-o", "f.ply"]);
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.code() == Some(2) && said.contains("sigma"), "{said}");
}

/// `… | head -1` lost the files that were written after the first line.
#[test]
#[cfg(unix)]
fn a_closed_pipe_costs_lines_and_no_files() {
    let dir = tempfile::tempdir().unwrap();
    phantom(dir.path(), Kind::Y, 32);
    let args = ["centerline", "--mask", "mask.nrrd", "--core", "c.nrrd", "--graph", "g.json"];
    let mut child = Command::new(env!("CARGO_BIN_EXE_intima"))
        .args(args)
        .args(["--unseen", "u.csv", "-o", "l.csv"])
        .current_dir(dir.path())
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let all = ["c.nrrd", "ct.nrrd", "g.json", "l.csv", "mask.nrrd", "u.csv"];
    assert_eq!(names(dir.path()), all);
}
