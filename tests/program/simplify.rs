//! `intima simplify` as its users meet it, good meshes and bad ones.

use std::path::Path;
use std::process::{Command, Output};

use common::tube;
use glam::Vec3;
use intima::formats::{read_mesh, write_mesh};
use intima::geometry::Mesh;
use serde_json::Value;

fn intima(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_intima")).args(args).current_dir(dir).output().unwrap()
}

/// Simplifies a mesh; the answer and what went to standard error.
fn simplify(mesh: &Mesh, more: &[&str]) -> (Option<i32>, Value, String, Mesh) {
    let dir = tempfile::tempdir().unwrap();
    write_mesh(&dir.path().join("in.ply"), mesh).unwrap();
    let mut args = vec!["simplify", "in.ply", "-o", "out.ply", "--json"];
    args.extend(more);
    let out = intima(dir.path(), &args);
    let text = String::from_utf8_lossy(&out.stdout);
    let json = text.lines().last().and_then(|l| serde_json::from_str(l).ok());
    let file = dir.path().join("out.ply");
    let done = if file.exists() { read_mesh(&file, None).unwrap().0 } else { Mesh::default() };
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    (out.status.code(), json.unwrap_or(Value::Null), said, done)
}

/// Directed edges without a reverse.
fn open_edges(mesh: &Mesh) -> usize {
    let edges = mesh.faces.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    let all: std::collections::HashSet<(u32, u32)> = edges.collect();
    all.iter().filter(|(a, b)| !all.contains(&(*b, *a))).count()
}

#[test]
fn a_closed_mesh_gets_the_faces_wanted_stays_closed_and_close() {
    let mesh = tube::tube(120, 64);
    let (code, json, _, done) = simplify(&mesh, &["--faces", "2000", "--measure"]);
    assert_eq!(code, Some(0));
    assert_eq!(done.faces.len(), 2000);
    assert_eq!(open_edges(&done), 0);
    assert_eq!(json["mesh"]["stopped"], "reached");
    assert_eq!(json["mesh"]["faces"], 2000);
    let off = json["mesh"]["deviation"]["hausdorff_mm"].as_f64().unwrap();
    assert!(off > 0.0 && off < 1.5, "{off} mm");
    let twice = simplify(&mesh, &["--faces", "2000", "--threads", "1"]).3;
    assert_eq!(twice, done, "threads change the result");
}

#[test]
fn vertices_stay_in_paper_mode_and_when_asked_to_and_move_otherwise() {
    let mesh = tube::tube(60, 48);
    let stay = |m: &Mesh| m.positions.iter().all(|p| mesh.positions.contains(p));
    assert!(stay(&simplify(&mesh, &["--faces", "900", "--mode", "paper"]).3));
    assert!(stay(&simplify(&mesh, &["--faces", "900", "--keep-vertices"]).3));
    assert!(!stay(&simplify(&mesh, &["--faces", "900"]).3));
}

#[test]
fn what_cannot_be_reached_is_said_with_its_reason() {
    let mesh = tube::tube(20, 12);
    let faces = mesh.faces.len();
    let (code, json, _, done) = simplify(&mesh, &["--faces", "100000"]);
    assert_eq!((code, done.faces.len()), (Some(0), faces));
    assert_eq!(json["mesh"]["stopped"], "reached");
    let (code, json, _, done) = simplify(&mesh, &["--faces", "0"]);
    assert_eq!(code, Some(0));
    assert!(done.faces.len() >= 4 && open_edges(&done) == 0);
    assert_eq!(json["mesh"]["stopped"], "no legal collapse");
    let (_, json, _, done) = simplify(&mesh, &["--faces", "10", "--max-error", "0.001"]);
    assert_eq!(json["mesh"]["stopped"], "max error");
    assert!(done.faces.len() > 10);
    assert_eq!(simplify(&mesh, &["--faces", "10", "--max-error", "-1"]).0, Some(2));
}

#[test]
fn odd_meshes_are_repaired_aloud() {
    let good = tube::tube(30, 16);
    type Case = (&'static str, fn(&mut Mesh), &'static str);
    let cases: [Case; 4] = [
        ("degenerate", |m| m.faces.push([3, 3, 4]), "repeated vertex"),
        ("duplicate", |m| m.faces.push(m.faces[5]), "repeat another"),
        ("flipped", |m| m.faces[7].swap(0, 1), "turned over"),
        (
            "third face at an edge",
            |m| {
                let [a, b, _] = m.faces[40];
                m.faces.push([a, b, m.positions.len() as u32]);
                m.positions.push(Vec3::new(500.0, 0.0, 0.0));
                m.normals.push(Vec3::X);
            },
            "more than two faces",
        ),
    ];
    for (name, spoil, word) in cases {
        let mut mesh = good.clone();
        spoil(&mut mesh);
        let (code, _, said, done) = simplify(&mesh, &["--faces", "400"]);
        assert_eq!(code, Some(0), "{name}: {said}");
        assert!(said.contains(word), "{name}: {said}");
        assert!(done.faces.len() >= 398 && done.faces.len() <= 402, "{name}");
    }
}

#[test]
fn meshes_past_repair_are_refused_in_one_line_and_nothing_is_written() {
    let dir = tempfile::tempdir().unwrap();
    for (name, text, word) in [
        ("nan", "v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("empty", "v 0 0 0\nv 1 0 0\n", "no faces"),
        ("index", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "line 4: names a vertex"),
        (
            "moebius",
            "v 0 0 0\nv 1 0 0\nv 2 1 0\nv 1 2 1\nv 0 1 1\n\
             f 1 2 3\nf 2 3 4\nf 3 4 5\nf 4 5 1\nf 5 1 2\n",
            "one-sided",
        ),
    ] {
        std::fs::write(dir.path().join("in.obj"), text).unwrap();
        let args = ["simplify", "in.obj", "--faces", "1", "-o", "out.ply", "--space", "lps"];
        let out = intima(dir.path(), &args);
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(out.status.code(), Some(3), "{name}: {said}");
        assert!(said.contains(word) && said.contains("in.obj"), "{name}: {said}");
        let lines = said.lines().filter(|l| l.starts_with("intima:")).count();
        assert_eq!(lines, 1, "{name}: {said}");
        assert!(!dir.path().join("out.ply").exists());
    }
}
