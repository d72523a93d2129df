//! Paper mode from the volume to the frames.

use glam::DVec3;

use super::*;

/// Points of the path in a folder, in order.
fn path(folder: &Path) -> Vec<DVec3> {
    let text = std::fs::read_to_string(folder.join("centerline.csv")).unwrap();
    let numbers = |line: &str| -> DVec3 {
        let mut n = line.split(',').map(|n| n.parse::<f64>().unwrap());
        DVec3::from_array(std::array::from_fn(|_| n.next().unwrap()))
    };
    text.lines().skip(1).map(numbers).collect()
}

fn report(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("report.json")).unwrap()).unwrap()
}

#[test]
fn the_papers_chain_flies_every_phantom_between_given_ends() {
    if !can_draw() {
        return;
    }
    for kind in [Kind::Tube, Kind::Y, Kind::Colon] {
        let tmp = tempfile::tempdir().unwrap();
        phantom(tmp.path(), kind, 64);
        let truth = Phantom::new(kind, 64, [1.0; 3]).unwrap().truth();
        let text = |p: DVec3| format!("{},{},{}", p.x, p.y, p.z);
        let (start, end) = (text(truth.start), text(truth.ends[0]));
        let fly = |from: &str, to: &str, lod: &str, out: &str| {
            let args =
                ["run", "--mask", "mask.nrrd", "--mode", "paper", "--out", out, "--lod", lod];
            let more = ["--from", from, "--to", to, "--frames", "2", "--size", "64x48"];
            works(tmp.path(), &[&args[..], &more, &[]].concat());
            (path(&tmp.path().join(out)), report(&tmp.path().join(out)))
        };
        let (line, culled) = fly(&start, &end, "culled", "a");
        let (again, vds) = fly(&start, &end, "vds", "b");
        assert_eq!(line, again, "{kind:?}");
        let (back, _) = fly(&end, &start, "vds", "c");
        let name = kind.name();
        // The ends are kept points: nearer to the end asked for than a tenth of the way.
        let tenth = 0.1 * culled["centerline"]["length_mm"].as_f64().unwrap();
        for (found, asked) in [
            (line[0], truth.start),
            (line[line.len() - 1], truth.ends[0]),
            (back[0], truth.ends[0]),
            (back[back.len() - 1], truth.start),
        ] {
            let off = found.distance(asked);
            println!("{name}: {off:.2} mm of {:.1} mm", 10.0 * tenth);
            assert!(off < tenth.max(4.0), "{name}: {off} mm off {asked}");
        }
        assert_eq!(vds["lod"]["mode"], "vds", "{name}");
        assert_eq!(vds["lod"]["metric"], "paper", "{name}");
        assert_eq!(vds["frames"]["count"], 2, "{name}");
        assert!(culled["centerline"]["proof"].is_null(), "{name}: the paper proves nothing");
        let stages: Vec<&str> =
            vds["stages"].as_array().unwrap().iter().filter_map(|s| s["name"].as_str()).collect();
        for stage in ["paper path", "subdivision", "simplify"] {
            assert!(stages.contains(&stage), "{name}: {stage} in {stages:?}");
        }
        assert!(!stages.contains(&"route"), "{name}: {stages:?}");
        for out in ["a", "b"] {
            for frame in ["frame_00001.png", "frame_00002.png"] {
                let file = tmp.path().join(out).join("frames").join(frame);
                let (.., pixels) = read_png(&file).unwrap();
                let lit = pixels.iter().filter(|p| **p > 40).count();
                assert!(4 * lit > pixels.len(), "{name} {out} {frame}: {lit} of {}", pixels.len());
            }
        }
    }
}

#[test]
fn the_paper_has_no_tree_and_says_so_before_anything_is_computed() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Y, 32);
    for (command, output) in [("run", "--out"), ("record", "--out"), ("centerline", "-o")] {
        let args = [command, "--mask", "mask.nrrd", "--mode", "paper", "--tree", output, "o.csv"];
        let out = intima(tmp.path(), &args);
        let err = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(3), "{args:?}: {err}");
        assert!(err.contains("no tree"), "{args:?}: {err}");
        assert_eq!(names(tmp.path()), ["ct.nrrd", "mask.nrrd"], "{args:?}");
    }
}
