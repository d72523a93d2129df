//! Command lines in the documents run as they are written.

use common::torso;
use glam::DVec3;
use intima::volume::{Samples, Volume};

use super::*;

/// Lines of shell blocks that call the program.
fn command_lines(document: &str) -> Vec<String> {
    let mut lines = Vec::new();
    let mut in_shell = false;
    for line in document.lines() {
        if line.starts_with("```") {
            in_shell = line == "```sh";
        } else if in_shell && line.starts_with("intima ") {
            lines.push(line.split(" #").next().unwrap_or(line).trim().to_owned());
        }
    }
    lines
}

#[test]
fn command_lines_in_the_documents_run() {
    if !can_draw() {
        return;
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut documents = vec![root.join("README.md")];
    let docs = std::fs::read_dir(root.join("docs")).unwrap().map(|e| e.unwrap().path());
    documents.extend(docs.filter(|p| p.extension().is_some_and(|e| e == "md")));
    let read = |p: &std::path::PathBuf| std::fs::read_to_string(p).unwrap();
    let lines: Vec<String> = documents.iter().flat_map(|p| command_lines(&read(p))).collect();
    assert!(lines.len() >= 2, "{lines:?}");
    // The names that the documents use: a CT in which the point named lies in the lumen, and a
    // label map of three labels; where an organ is to be found, a torso.
    let tmp = tempfile::tempdir().unwrap();
    let tube = Phantom::new(Kind::Tube, 40, [1.0; 3]).unwrap();
    let mut ct = tube.grey(None, 1);
    let middle = tube.truth().branches[0].points[0];
    ct.grid.origin_mm +=
        DVec3::new(-12.0, 4.0, -300.0) - DVec3::new(middle[0], middle[1], middle[2]);
    let mask = tube.mask();
    let labels: Vec<u8> = (0..mask.grid.len()).map(|i| 3 * u8::from(mask.real(i) > 0.0)).collect();
    write_volume(&tmp.path().join("ct.nii.gz"), &ct).unwrap();
    let labels = Volume::new(ct.grid, Samples::from(labels));
    write_volume(&tmp.path().join("labels.nii.gz"), &labels).unwrap();
    let torso = torso::Torso::default().scan();
    std::fs::create_dir(tmp.path().join("SCANS")).unwrap();
    for name in ["torso.nrrd", "SCANS/torso.nrrd"] {
        write_volume(&tmp.path().join(name), &torso).unwrap();
    }
    for line in lines {
        let ct = if line.contains("--organ") { "torso.nrrd" } else { "ct.nii.gz" };
        let line = line.replace("CT_FOLDER", ct);
        let mut args: Vec<&str> = line.split_whitespace().skip(1).collect();
        if ["run", "record"].contains(&args[0]) || args.contains(&"participant") {
            args.extend(["--frames", "2", "--size", "64x48"]);
        }
        works(tmp.path(), &args);
        println!("{line}");
    }
    assert!(tmp.path().join("case/report.json").exists());
}

/// Fields of the structures of a source file.
fn public_fields(source: &str) -> impl Iterator<Item = &str> {
    let fields = source.lines().filter_map(|l| l.strip_prefix("    pub ")?.split_once(": "));
    fields.map(|(name, _)| name).filter(|n| n.chars().all(|c| c.is_alphanumeric() || c == '_'))
}

#[test]
fn every_field_of_the_report_is_in_its_page() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = |name: &str| std::fs::read_to_string(root.join(name)).unwrap();
    let page = text("docs/report.md");
    let part = |name: &str, from: &str, to: &str| {
        let all = text(name);
        let begin = all.find(from).unwrap_or_else(|| panic!("{from} in {name}"));
        all[begin..][..all[begin..].find(to).unwrap()].to_owned()
    };
    let parts = [
        part("src/session/report/mod.rs", "pub struct Report", "impl Session"),
        text("src/session/report/centerline.rs"),
        text("src/session/report/frames.rs"),
        text("src/session/report/input.rs"),
        text("src/session/report/lumen.rs"),
        text("src/session/report/surface.rs"),
        part("src/session/levels.rs", "pub struct LodReport", "\n}"),
        part("src/flight/lumen_profile.rs", "pub struct LumenProfile", "/// A point of the path"),
        part("src/session/clock.rs", "pub struct StageTime", "/// Collects stages."),
        part("src/geometry/tree.rs", "pub struct TreeSummary", "\n}"),
        part("src/centerline/containment.rs", "pub struct Proof", "\n}"),
    ];
    let fields: Vec<&str> = parts.iter().flat_map(|p| public_fields(p)).collect();
    assert!(fields.len() > 100, "{fields:?}");
    // Their own fields stand where these do.
    let flat = ["timing", "field"];
    let missing: Vec<_> = fields
        .into_iter()
        .filter(|f| !flat.contains(f) && !page.contains(&format!("`{f}`")))
        .collect();
    assert!(missing.is_empty(), "docs/report.md lacks {missing:?}");
}
