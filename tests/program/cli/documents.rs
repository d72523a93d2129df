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
    write_volume(&tmp.path().join("torso.nrrd"), &torso::Torso::default().scan()).unwrap();
    for line in lines {
        let ct = if line.contains("--organ") { "torso.nrrd" } else { "ct.nii.gz" };
        let line = line.replace("CT_FOLDER", ct);
        let mut args: Vec<&str> = line.split_whitespace().skip(1).collect();
        if ["run", "record"].contains(&args[0]) {
            args.extend(["--frames", "2", "--size", "64x48"]);
        }
        works(tmp.path(), &args);
        println!("{line}");
    }
    assert!(tmp.path().join("case/report.json").exists());
}
