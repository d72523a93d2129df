//! Simplification of three large meshes: seconds, and distances to what they were.

use std::path::Path;
use std::time::Instant;

use intima::geometry::TriangleBvh;
use intima::mesh::{HalfEdges, Metric, SimplifyOptions, deviation, make_manifold, simplify};

/// Times, and leaves results for scoring by others in the folder `INTIMA_OUT`, if it is set.
pub fn times_and_deviations() {
    let folder = std::env::var("INTIMA_MESHES").expect("INTIMA_MESHES names a folder");
    let cases = [("vessel_143k", 7000), ("trachea_96k", 15000), ("colon_1m", 50000)];
    for (name, faces) in cases {
        let path = Path::new(&folder).join(format!("{name}.ply"));
        let (mesh, _) = intima::formats::read_mesh(&path, None).unwrap();
        let t = Instant::now();
        HalfEdges::new(&mesh).unwrap();
        println!("{name}: half-edges {:.3} s", t.elapsed().as_secs_f64());
        let t = Instant::now();
        TriangleBvh::new(&mesh);
        println!("{name}: tree {:.3} s", t.elapsed().as_secs_f64());
        let t = Instant::now();
        make_manifold(&mesh).unwrap();
        println!("{name}: repairs {:.3} s", t.elapsed().as_secs_f64());
        for (metric, relocate) in [Metric::Qem, Metric::NormalQem, Metric::Paper]
            .into_iter()
            .flat_map(|m| [(m, false), (m, true)])
        {
            let options = SimplifyOptions { metric, relocate, ..SimplifyOptions::to_faces(faces) };
            let run = |_| {
                let t = Instant::now();
                let s = simplify(&mesh, &options, &mut ()).unwrap();
                (t.elapsed().as_secs_f64(), s)
            };
            let runs: Vec<_> = (0..5).map(run).collect();
            let best = runs.iter().map(|r| r.0).fold(f64::INFINITY, f64::min);
            let mesh_out = &runs[0].1.mesh;
            let t = Instant::now();
            let d = deviation(mesh_out, &mesh).unwrap();
            let seconds = t.elapsed().as_secs_f64();
            println!(
                "{name} {metric:?} relocate {relocate}: best of 5 {best:.3} s; {d:?} in {seconds:.2} s"
            );
            if let Ok(out) = std::env::var("INTIMA_OUT") {
                let file = format!("{out}/{name}.{metric:?}.{relocate}.ply");
                intima::formats::write_mesh(Path::new(&file), mesh_out).unwrap();
            }
        }
    }
}
