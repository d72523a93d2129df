//! Long runs on large meshes, which also print their figures: `INTIMA_MESHES=folder cargo test
//! --release --lib lod::vds::large_meshes -- --ignored --nocapture`.

use std::path::PathBuf;
use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use super::schemes::{Scheme, butterfly, refine};
use super::*;
use crate::geometry::{Mesh, TriangleBvh};
use crate::mesh::{Parameterization, Simplified, SimplifyOptions, simplify};

fn folder() -> PathBuf {
    std::env::var("INTIMA_MESHES").expect("INTIMA_MESHES names a folder").into()
}

fn prepared(name: &str, faces: usize) -> (Mesh, Simplified, Parameterization) {
    let (mesh, _) = crate::formats::read_mesh(&folder().join(format!("{name}.ply")), None).unwrap();
    let t = Instant::now();
    let mut maps = Parameterization::new(&mesh).unwrap();
    let base = simplify(&mesh, &SimplifyOptions::to_faces(faces), &mut maps).unwrap();
    println!(
        "{name}: {} to {} faces in {:.2?}",
        mesh.faces.len(),
        base.mesh.faces.len(),
        t.elapsed()
    );
    (mesh, base, maps)
}

/// Distance of two meshes both ways: root mean square over area from `a`, and the largest.
fn distance(a: &Mesh, b: &Mesh) -> (f64, f64) {
    let one = |a: &Mesh, b: &Mesh| {
        let search = TriangleBvh::new(b);
        let far = |p: DVec3| search.closest(p).map_or(0.0, |c| c.distance_mm);
        let face = |f: &[u32; 3]| {
            let [x, y, z] = f.map(|v| a.positions[v as usize].as_dvec3());
            let area = 0.5 * (y - x).cross(z - x).length();
            let at = |u: f64, v: f64| far(x + u * (y - x) + v * (z - x));
            let inner =
                [at(1.0 / 6.0, 1.0 / 6.0), at(2.0 / 3.0, 1.0 / 6.0), at(1.0 / 6.0, 2.0 / 3.0)];
            let most = inner
                .into_iter()
                .chain([at(0.5, 0.0), at(0.5, 0.5), at(0.0, 0.5)])
                .fold(0.0, f64::max);
            (area, area * inner.map(|d| d * d).iter().sum::<f64>() / 3.0, most)
        };
        let add = |p: (f64, f64, f64), q: (f64, f64, f64)| (p.0 + q.0, p.1 + q.1, p.2.max(q.2));
        let parts: Vec<_> = a.faces.par_iter().map(face).collect();
        let (area, squares, most) = parts.into_iter().fold((0.0, 0.0, 0.0), add);
        ((squares / area).sqrt(), most)
    };
    let (forth, back) = (one(a, b), one(b, a));
    (forth.0.max(back.0), forth.1.max(back.1))
}

#[test]
#[ignore = "minutes: INTIMA_MESHES=FOLDER cargo test --release --lib large_meshes -- --ignored"]
fn each_scheme_errs_less_at_a_tighter_tolerance() {
    for (name, faces) in [("vessel_143k", 7000), ("trachea_96k", 1500)] {
        let (mesh, base, maps) = prepared(name, faces);
        let shading = crate::surface::shading(&mesh);
        let tree = TriangleBvh::new(&mesh);
        let original = ParameterizedOriginal::new(&mesh, &shading.vertices, &tree, &base, &maps);
        let (rms, most) = distance(&base.mesh, &mesh);
        println!("{name}: base {} faces, rms {rms:.4}, max {most:.4} mm", base.mesh.faces.len());
        let predicted = butterfly::subdivide(&base.mesh);
        let (rms, most) = distance(&predicted, &mesh);
        println!(
            "  butterfly alone, once: {} faces, rms {rms:.4}, max {most:.4} mm",
            predicted.faces.len()
        );
        println!("  scheme  tolerance   faces      rms      max mm    time");
        for rounds in 1..=4 {
            for scheme in [Scheme::OneToFour, Scheme::Sqrt3, Scheme::FourEight] {
                if scheme == Scheme::OneToFour && rounds > 2 {
                    continue;
                }
                let t = Instant::now();
                let fine = refine(&base.mesh, &original, scheme, -1.0, rounds);
                let spent = t.elapsed();
                let (rms, most) = distance(&fine, &mesh);
                println!(
                    "  {scheme:<7?} all x{rounds} {:>8} {rms:>9.5} {most:>9.4} {spent:>9.2?}",
                    fine.faces.len()
                );
            }
        }
        let mut before = [f64::INFINITY; 3];
        for tolerance in [0.1, 0.05, 0.025, 0.0125] {
            for (k, scheme) in
                [Scheme::OneToFour, Scheme::Sqrt3, Scheme::FourEight].into_iter().enumerate()
            {
                let t = Instant::now();
                let fine = refine(&base.mesh, &original, scheme, tolerance, 24);
                let spent = t.elapsed();
                let (rms, most) = distance(&fine, &mesh);
                println!(
                    "  {scheme:<7?} {tolerance:>7} {:>8} {rms:>9.5} {most:>9.4} {spent:>9.2?}",
                    fine.faces.len()
                );
                assert!(rms < before[k], "{scheme:?} at {tolerance} mm");
                before[k] = rms;
            }
        }
    }
}
