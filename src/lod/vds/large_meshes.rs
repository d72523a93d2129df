//! Long runs on large meshes, which also print their figures: `INTIMA_MESHES=folder cargo test
//! --release --lib lod::vds::large_meshes -- --ignored --nocapture`.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::schemes::{Scheme, butterfly, refine};
use super::*;
use crate::geometry::{Camera, Lens, Mesh, Pose, TriangleBvh, ViewFrustum};
use crate::lod::{LodHierarchy, PageCache, Tolerance};
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
        let original = ParameterizedOriginal::new(&mesh, &shading.vertices, &base, &maps);
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

/// Camera poses along the first branch of a mesh's axis, one a step of `step_mm`.
fn flight(name: &str, step_mm: f32) -> Vec<Pose> {
    let text = std::fs::read_to_string(folder().join(format!("{name}.json"))).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let points: Vec<Vec3> = json["branches"][0]["points"]
        .as_array()
        .unwrap()
        .iter()
        .map(|p| Vec3::from_array([0, 1, 2].map(|k| p[k].as_f64().unwrap() as f32)))
        .collect();
    let mut poses = Vec::new();
    let mut gone = f32::INFINITY;
    for (i, pair) in points.windows(2).enumerate() {
        gone += pair[0].distance(pair[1]);
        let ahead = points[i..].iter().find(|p| p.distance(pair[0]) >= 4.0);
        if let (true, Some(to)) = (gone >= step_mm, ahead) {
            gone = 0.0;
            poses.push(Pose::looking(pair[0], *to, Vec3::Z));
        }
    }
    poses
}

#[test]
#[ignore = "minutes: INTIMA_MESHES=FOLDER cargo test --release --lib large_meshes -- --ignored"]
fn no_level_of_a_large_mesh_errs_more_than_its_bound() {
    for (name, faces) in [("vessel_143k", 7000), ("trachea_96k", 15000), ("colon_1m", 50000)] {
        let (mesh, base, maps) = prepared(name, faces);
        let shading = crate::surface::shading(&mesh);
        let t = Instant::now();
        let original = ParameterizedOriginal::new(&mesh, &shading.vertices, &base, &maps);
        let surface =
            SubdivisionSurface::new(&base.mesh, &original, VdsOptions::default()).unwrap();
        println!(
            "{name}: surface in {:.2?}, {:.1} MB, {} leaves",
            t.elapsed(),
            surface.bytes() as f64 / 1e6,
            surface.leaves()
        );
        let surface = Arc::new(surface);
        for l in 0..=surface.depth() {
            let step = 1 << (surface.depth() - l);
            let mut level = Mesh::default();
            for f in 0..surface.base.faces.len() as u32 {
                for t in super::samples::triangles(1 << l) {
                    let first = level.positions.len() as u32;
                    level.positions.extend(
                        t.map(|g| surface.samples.position(&surface.base, f, g.map(|c| c * step))),
                    );
                    level.faces.push([first, first + 1, first + 2]);
                }
            }
            let mean =
                surface.leaves.iter().map(|x| f64::from(x.error_mm[l as usize])).sum::<f64>()
                    / surface.leaves() as f64;
            if mesh.faces.len() < 200_000 || l == surface.depth() {
                let (rms, most) = distance(&level, &mesh);
                println!(
                    "  level {l}: {} faces, bound {:.4} (mean of leaves {mean:.4}), measured max {most:.4} rms {rms:.5} mm",
                    level.faces.len(),
                    surface.error_mm(l)
                );
                assert!(most <= f64::from(surface.error_mm(l)), "{name}, level {l}");
            } else {
                println!(
                    "  level {l}: {} faces, bound {:.4} (mean of leaves {mean:.4})",
                    level.faces.len(),
                    surface.error_mm(l)
                );
            }
        }
        for morph in [false, true] {
            let surface = Arc::new(SubdivisionSurface {
                options: VdsOptions { morph, ..surface.options },
                ..(*surface).clone()
            });
            let mut vds = Vds::new(surface.clone());
            let mut cache = PageCache::new(16384, 1200, 3);
            let tolerance = Tolerance { pixels: 1.0 };
            let (mut times, mut triangles, mut seen_triangles, mut uploads, mut changed) =
                (vec![], vec![], vec![], vec![], vec![]);
            let mut cut = vec![];
            for pose in flight(name, 0.25).into_iter().take(400) {
                let lens = Lens { fov_y_rad: 90f32.to_radians(), aspect: 16.0 / 9.0, near_mm: 0.2 };
                let camera = Camera { pose, lens, height_px: 720 };
                let frustum = ViewFrustum::new(&camera);
                cache.begin_step();
                let t = Instant::now();
                let step = vds.step(&camera, &tolerance, &mut cache);
                times.push(t.elapsed().as_secs_f64() * 1e3);
                let sum = |seen: bool| -> u64 {
                    step.drawn
                        .iter()
                        .filter(|d| !seen || frustum.intersects(&d.sphere))
                        .map(|d| u64::from(d.triangles))
                        .sum()
                };
                triangles.push(sum(false) as f64);
                seen_triangles.push(sum(true) as f64);
                cut.push(step.drawn.len() as f64);
                uploads.push(step.uploads.len() as f64);
                changed.push(f64::from(step.leaves_changed));
            }
            let p = |v: &[f64], q: f64| {
                let mut v = v.to_vec();
                v.sort_by(f64::total_cmp);
                v.get(((v.len().max(1) - 1) as f64 * q) as usize).copied().unwrap_or(0.0)
            };
            println!(
                "  morph {morph}: {} frames; p50/p99: step {:.2}/{:.2} ms, triangles {:.0}/{:.0}, seen {:.0}/{:.0}, pages {:.0}/{:.0}, uploads {:.0}/{:.0}, leaves changed {:.0}/{:.0}",
                times.len(),
                p(&times[1..], 0.5),
                p(&times[1..], 0.99),
                p(&triangles, 0.5),
                p(&triangles, 0.99),
                p(&seen_triangles, 0.5),
                p(&seen_triangles, 0.99),
                p(&cut, 0.5),
                p(&cut, 0.99),
                p(&uploads[1..], 0.5),
                p(&uploads[1..], 0.99),
                p(&changed[1..], 0.5),
                p(&changed[1..], 0.99),
            );
        }
    }
}
