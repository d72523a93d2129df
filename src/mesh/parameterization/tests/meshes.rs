//! With the real simplifier.

use std::path::Path;
use std::time::Instant;

use rayon::prelude::*;

use super::*;
use crate::geometry::TriangleBvh;
use crate::mesh::{Metric, Simplified, SimplifyOptions, simplify as reduce};

/// Base faces as the simplifier hands them out, by original ids.
fn handed_out(s: &Simplified) -> Vec<(u32, [u32; 3])> {
    let ids = |f: [u32; 3]| f.map(|v| s.vertex_ids[v as usize]);
    s.face_ids.iter().zip(&s.mesh.faces).map(|(slot, f)| (*slot, ids(*f))).collect()
}

#[test]
fn the_simplifiers_base_faces_are_the_recorders_in_the_same_order_of_corners() {
    for (name, mesh) in [("sphere", sphere(4)), ("torus", torus()), ("tube", tube())] {
        for metric in [Metric::NormalQem, Metric::Qem, Metric::Paper] {
            let mut maps = Parameterization::new(&mesh).unwrap();
            let options = SimplifyOptions { metric, ..SimplifyOptions::to_faces(200) };
            let s = reduce(&mesh, &options, &mut maps).unwrap();
            assert_eq!(maps.collapses(), s.collapses, "{name}");
            assert!(maps.base_faces().eq(handed_out(&s)), "{name} {metric:?}");
            let gap = widest_gap(&mesh, &maps, |p| maps.to_fine(p).unwrap().at);
            assert!(gap <= CONTINUITY * diagonal(&mesh), "{name} {metric:?}: {gap:e}");
        }
    }
}

/// Every base face divided in 4^level, with its points mapped; a soup.
fn divided(mesh: &Mesh, maps: &Parameterization, level: u32) -> Mesh {
    let n = 1u32 << level;
    let mut at = Vec::new();
    for (face, _) in maps.base_faces() {
        let mut corner = |i: u32, j: u32| {
            let (a, b) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
            at.push(MeshPoint { face, weights: [1.0 - a - b, a, b] });
        };
        for (i, j) in (0..n).flat_map(|i| (0..n - i).map(move |j| (i, j))) {
            [(i, j), (i + 1, j), (i, j + 1)].into_iter().for_each(|(i, j)| corner(i, j));
            if i + j + 1 < n {
                let down = [(i + 1, j), (i + 1, j + 1), (i, j + 1)];
                down.into_iter().for_each(|(i, j)| corner(i, j));
            }
        }
    }
    let fine = maps.to_fine_all(&at).unwrap();
    let positions: Vec<_> = fine.iter().map(|m| point(mesh, m.at).as_vec3()).collect();
    let faces = (0..positions.len() as u32 / 3).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    Mesh { positions, faces, ..Mesh::default() }
}

fn seconds<T>(run: impl FnOnce() -> T) -> (T, f64) {
    let t = Instant::now();
    let out = run();
    (out, t.elapsed().as_secs_f64())
}

/// Best of five, in ms.
fn best_ms<T>(mut run: impl FnMut() -> T) -> f64 {
    (0..5).map(|_| seconds(&mut run).1 * 1e3).fold(f64::INFINITY, f64::min)
}

/// Takes `INTIMA_MESHES=folder`.
#[test]
#[ignore = "minutes: INTIMA_MESHES=FOLDER cargo test --release --lib maps_of_large -- --ignored"]
fn maps_of_large_meshes_come_back_from_round_trips() {
    let folder = std::env::var("INTIMA_MESHES").expect("INTIMA_MESHES names a folder");
    for (name, faces) in [("vessel_143k", 7000), ("trachea_96k", 15000), ("colon_1m", 50000)] {
        let path = Path::new(&folder).join(format!("{name}.ply"));
        let (mesh, _) = crate::formats::read_mesh(&path, None).unwrap();
        let size = diagonal(&mesh);
        let options = SimplifyOptions::to_faces(faces);
        let bare = best_ms(|| reduce(&mesh, &options, &mut ()).unwrap());
        let with = best_ms(|| {
            let mut maps = Parameterization::new(&mesh).unwrap();
            reduce(&mesh, &options, &mut maps).unwrap();
            maps
        });
        let mut maps = Parameterization::new(&mesh).unwrap();
        let s = reduce(&mesh, &options, &mut maps).unwrap();
        assert!(maps.base_faces().eq(handed_out(&s)), "{name}");
        println!(
            "{name}: {} collapses, {} refused; {bare:.0} ms alone, {with:.0} ms recorded; \
             {} bytes held",
            maps.collapses(),
            maps.refused(),
            maps.memory_bytes(),
        );

        let all: Vec<u32> = (0..mesh.faces.len() as u32).collect();
        let slots: Vec<u32> = maps.base_faces().map(|f| f.0).collect();
        for (way, down) in [("original to base", true), ("base to original", false)] {
            let at = places(if down { &all } else { &slots }, 1_000_000, 1);
            let carry = || if down { maps.to_base_all(&at) } else { maps.to_fine_all(&at) };
            let ms = best_ms(carry);
            let hops: Vec<u32> = carry().unwrap().iter().map(|m| m.hops).collect();
            let mean = hops.iter().map(|h| f64::from(*h)).sum::<f64>() / hops.len() as f64;
            let most = hops.iter().max().unwrap();
            println!("  {way}: {mean:.2} hops mean, {most} most; a million places {ms:.0} ms");
        }
        let fine = fine_round_trip(&mesh, &maps, &places(&all, 1_000_000, 2)) / size;
        let corners: BTreeMap<u32, [u32; 3]> = maps.base_faces().collect();
        let base = places(&slots, 1_000_000, 3)
            .into_par_iter()
            .map(|at| {
                let back = maps.to_base(maps.to_fine(at).unwrap().at).unwrap().at;
                let there = base_point(&mesh, &corners, back);
                (base_point(&mesh, &corners, at) - there).length()
            })
            .reduce(|| 0.0, f64::max);
        println!(
            "  round trips err by {fine:.1e} (original), {:.1e} (base) of the box",
            base / size
        );
        let gap = widest_gap(&mesh, &maps, |p| maps.to_fine(p).unwrap().at) / size;
        let torn =
            widest_gap(&mesh, &maps, |p| maps.to_fine_with(p, |[a, b, c]| [b, c, a]).unwrap().at);
        println!(
            "  base edges: sides {gap:.1e} of the box apart, planted fault {:.1e}",
            torn / size
        );
        let (tuples, ms) = seconds(|| maps.removed_vertices());
        let missed = tuples.iter().map(|t| {
            let found = point(&mesh, maps.to_fine(t.at).unwrap().at);
            (found - DVec3::from(mesh.positions[t.vertex as usize])).length()
        });
        println!(
            "  tuples miss their vertex by {:.1e} of the box at most, {:.0} ms",
            missed.fold(0.0, f64::max) / size,
            ms * 1e3
        );
        let mut pieces = 0;
        let mut filled: BTreeMap<u32, f64> = BTreeMap::new();
        for piece in (0..mesh.faces.len() as u32).flat_map(|f| overlay::pieces(&maps, f)) {
            *filled.entry(piece.base.face).or_default() += piece.area;
            pieces += 1;
        }
        let worst = filled.values().map(|a| (a - 1.0).abs()).fold(0.0, f64::max);
        println!("  {pieces} pieces fill {} base faces to {worst:.1e}", filled.len());
        println!("  divided three times: {:.3} % turned", 100.0 * turned(&mesh, &maps, 3));
        for level in 0..if faces > 20_000 { 3 } else { 5 } {
            let resampled = divided(&mesh, &maps, level);
            let nearest = TriangleBvh::new(&resampled);
            let far: Vec<f64> = (mesh.positions.par_iter())
                .map(|p| nearest.closest(DVec3::from(*p)).unwrap().distance_mm)
                .collect();
            let rms = (far.iter().map(|d| d * d).sum::<f64>() / far.len() as f64).sqrt();
            let most = far.iter().copied().fold(0.0, f64::max);
            println!(
                "  level {level}: {} faces ({:.2} of the original's), original vertices \
                 {rms:.5} mm rms, {most:.4} mm most from them",
                resampled.faces.len(),
                resampled.faces.len() as f64 / mesh.faces.len() as f64,
            );
        }
    }
}
