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
    for (name, faces) in [("vessel_143k", 7000), ("trachea_96k", 15000), ("colon_1m", 50000)] {
        let path = Path::new(&folder).join(format!("{name}.ply"));
        let (mesh, _) = crate::formats::read_mesh(&path, None).unwrap();
        let t = Instant::now();
        HalfEdges::new(&mesh).unwrap().check().unwrap();
        println!("{name}: half-edges and check {:.3} s", t.elapsed().as_secs_f64());
        let t = Instant::now();
        HalfEdges::new(&mesh).unwrap();
        println!("{name}: half-edges {:.3} s", t.elapsed().as_secs_f64());
        for metric in [Metric::NormalQem, Metric::Qem, Metric::Paper] {
            let options = SimplifyOptions { metric, ..SimplifyOptions::to_faces(faces) };
            let t = Instant::now();
            let s = simplify(&mesh, &options, &mut ()).unwrap();
            let seconds = t.elapsed().as_secs_f64();
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
