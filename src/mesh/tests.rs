use std::path::Path;
use std::time::Instant;

use super::*;

/// Times and writes results for scoring outside: `INTIMA_MESHES=folder`, results beside as
/// `<name>.simple.ply`.
#[test]
#[ignore = "measures; needs INTIMA_MESHES"]
fn measure() {
    let folder = std::env::var("INTIMA_MESHES").expect("INTIMA_MESHES names a folder");
    let out = std::env::var("INTIMA_OUT").unwrap_or("/tmp".into());
    let only = std::env::var("ONLY").unwrap_or_default();
    for (name, faces) in [("vessel_143k", 7000), ("trachea_96k", 15000), ("colon_1m", 50000)] {
        if !name.contains(&only) {
            continue;
        }
        let path = Path::new(&folder).join(format!("{name}.ply"));
        let (mesh, _) = crate::formats::read_mesh(&path, None).unwrap();
        let t = Instant::now();
        HalfEdges::new(&mesh).unwrap().check().unwrap();
        println!("{name}: half-edges and check {:.3} s", t.elapsed().as_secs_f64());
        let t = Instant::now();
        HalfEdges::new(&mesh).unwrap();
        println!("{name}: half-edges {:.3} s", t.elapsed().as_secs_f64());
        for metric in [Metric::NormalQem] {
            let relocate = std::env::var("MOVE").is_ok();
            let options = SimplifyOptions { metric, relocate, ..SimplifyOptions::to_faces(faces) };
            let mut seconds = f64::INFINITY;
            let mut s = None;
            for _ in 0..3 {
                let cpu = || {
                    std::fs::read_to_string(
                        "/proc/self/task/".to_owned()
                            + &std::fs::read_link("/proc/thread-self")
                                .unwrap()
                                .file_name()
                                .unwrap()
                                .to_string_lossy()
                            + "/schedstat",
                    )
                    .unwrap()
                    .split(' ')
                    .next()
                    .unwrap()
                    .parse::<f64>()
                    .unwrap()
                        * 1e-9
                };
                let t0 = cpu();
                s = Some(simplify(&mesh, &options, &mut ()).unwrap());
                seconds = seconds.min(cpu() - t0);
            }
            let s = s.unwrap();
            println!(
                "{name} {metric:?}: {seconds:.3} s, {} faces {:?} {}",
                s.mesh.faces.len(),
                s.stopped,
                s.error_mm
            );
            let file = format!("{out}/{name}.{metric:?}.ply");
            crate::formats::write_mesh(Path::new(&file), &s.mesh).unwrap();
        }
    }
}
