//! Projection of polygons onto a surface, and the map of one surface onto another.

use super::super::coarse_to_fine::bounds_through_map;
use super::super::convex_polygon::ConvexPolygon;
use super::super::distance_bound::{TargetCache, TargetSurface};
use super::super::partition;
use super::super::projection::{BoundaryTrace, ProjectedPoint};
use super::super::surface_map::map_surface;
use super::super::surfaces::{FineSurface, VertexTable};
use super::*;

/// A bumpy square sheet of 2 n² faces, side 1 mm each.
fn sheet(n: u32) -> Mesh {
    let at = |v: u32| {
        let (x, y) = ((v % (n + 1)) as f32, (v / (n + 1)) as f32);
        Vec3::new(x, y, 0.3 * (1.1 * x).sin() * (0.8 * y).cos())
    };
    let quad = |q: u32| {
        let i = q / n * (n + 1) + q % n;
        [[i, i + 1, i + n + 2], [i, i + n + 2, i + n + 1]]
    };
    Mesh {
        positions: (0..(n + 1) * (n + 1)).map(at).collect(),
        faces: (0..n * n).flat_map(quad).collect(),
        ..Mesh::default()
    }
}

/// Runs `test` with a mesh as target.
fn with_target<T>(mesh: &Mesh, test: impl FnOnce(&TargetSurface<'_>) -> T) -> T {
    let target = TargetSurface {
        positions: &mesh.positions,
        normals: &shading(mesh).vertices.iter().map(Vertex::normal).collect::<Vec<_>>(),
        faces: &mesh.faces,
        face_neighbors: &partition::face_neighbors(&mesh.faces, mesh.positions.len()),
        bvh: &TriangleBvh::new(mesh),
        cache: &TargetCache::default(),
    };
    test(&target)
}

#[test]
fn projected_polygons_and_their_parts_are_within_the_limit() {
    let mesh = sheet(12);
    let seed = &mut 5;
    // Number of accepted polygons by crossings: none, some, and around a vertex.
    let mut closed = [0; 3];
    let mut refused = 0;
    with_target(&mesh, |target| {
        for k in 0..6000 {
            let size = [0.3, 1.0, 2.0][k % 3];
            let mid = Vec3::new(3.0 + 6.0 * noise(seed), 3.0 + 6.0 * noise(seed), 0.0);
            let mut corner = || {
                let p = mid + size * Vec3::new(noise(seed) - 0.5, noise(seed) - 0.5, 0.0);
                let z = 0.3 * (1.1 * p.x).sin() * (0.8 * p.y).cos();
                p.with_z(z + 0.05 * noise(seed))
            };
            let corners = [corner(), corner(), corner()];
            let at = corners.map(|p| p.as_dvec3());
            let limit = f64::from(0.02 + 0.2 * noise(seed));
            let limit2 = limit * limit;
            let projected: [ProjectedPoint; 3] = at.map(|p| {
                let c = target.bvh.closest(p).unwrap();
                ProjectedPoint { face: c.at.face, d2: c.distance_mm * c.distance_mm }
            });
            let mut trace = BoundaryTrace::default();
            let led = (0..3).all(|k| {
                let end = |k: usize| (at[k], projected[k].face);
                target.trace_side(k as u8, end(k), end((k + 1) % 3), limit2, &mut trace)
            });
            let near = projected.iter().all(|l| l.d2 <= limit2);
            if !near || !led || target.close_trace(&at, limit2, &mut trace).is_none() {
                refused += 1;
                continue;
            }
            for p in sprinkle(corners, 20, seed) {
                assert!(target.bvh.closest(p).unwrap().distance_mm <= limit + 1e-9);
            }
            let apart = trace.split_by_cluster(&at, projected[0].face, |t| t as u16);
            let kind = if trace.crossings.is_empty() { 0 } else { 2 - usize::from(apart) };
            closed[kind] += 1;
            if apart {
                let mut area = 0.0;
                for (t, corners) in &trace.parts {
                    let near = |p: &DVec3| target.nearest(*t, *p).d2 <= limit2 * (1.0 + 1e-9);
                    assert!(corners.iter().all(near));
                    let fan = corners.windows(2).skip(1);
                    let cross = |w: &[DVec3]| (w[0] - corners[0]).cross(w[1] - corners[0]);
                    area += 0.5 * fan.map(cross).sum::<DVec3>().length();
                }
                let whole = 0.5 * (at[1] - at[0]).cross(at[2] - at[0]).length();
                assert!(area >= whole * (1.0 - 1e-6), "{area} of {whole} mm²");
            }
        }
    });
    assert!(closed.iter().all(|n| *n > 50) && refused > 500, "{closed:?} {refused}");
}

/// Maps a sheet with a third of its inner vertices moved and without some faces onto the sheet.
/// Returns whether each face is covered, and how many samples are near their bound.
fn covered(without: &[u32]) -> (Vec<bool>, usize) {
    let coarse = sheet(12);
    let mut fine = coarse.clone();
    let seed = &mut 3;
    // One vertex of each face: a face that encloses two vertices of the other sheet is not mapped.
    for p in fine.positions.iter_mut().step_by(3) {
        let inside = |v: f32| v > 0.5 && v < 11.5;
        if inside(p.x) && inside(p.y) {
            *p += 0.3 * Vec3::new(noise(seed) - 0.5, noise(seed) - 0.5, 0.2 * noise(seed));
        }
    }
    let keep = |f: &u32| !without.contains(f);
    let all = 0..fine.faces.len() as u32;
    fine.faces = all.filter(keep).map(|f| coarse.faces[f as usize]).collect();
    let count = fine.positions.len();
    let mut coarse_at = vec![0; count];
    for (f, i) in coarse.faces.iter().zip(0..) {
        f.iter().for_each(|v| coarse_at[*v as usize] = i);
    }
    let (positions, normals, before) = (Vec::new(), Vec::new(), Vec::new());
    let places = VertexTable { positions, normals, face_at: Vec::new(), predecessor: before };
    with_target(&fine, |below| {
        with_target(&coarse, |above| {
            let fine = FineSurface {
                target: *below,
                to_original_mm: vec![0.0; fine.faces.len()],
                face_at: vec![0; count],
                ids: &[],
                places: &places,
                intermediate: None,
                coarse_at,
            };
            let map = map_surface(above, &fine, 0.1);
            let far = bounds_through_map(&map, &fine.to_original_mm, f64::INFINITY);
            assert!((0..far.len()).all(|t| far[t].is_some() == map.covered[t]));
            // Covered faces are covered, within their bound.
            let (mut near, mut seed) = (0, 8);
            for (t, f) in coarse.faces.iter().enumerate().filter(|t| map.covered[t.0]) {
                let corners = f.map(|v| coarse.positions[v as usize]);
                for p in sprinkle(corners, 10, &mut seed) {
                    let away = below.bvh.closest(p).unwrap().distance_mm;
                    assert!(away <= far[t].unwrap() + 1e-9, "{away} mm, not {}", far[t].unwrap());
                    near += usize::from(away > 0.3 * far[t].unwrap());
                }
            }
            (map.covered, near)
        })
    })
}

#[test]
fn the_map_covers_a_surface_with_the_same_boundary_except_over_holes() {
    let (all, near) = covered(&[]);
    let share = all.iter().filter(|c| **c).count() as f64 / all.len() as f64;
    assert!(share > 0.6 && near > 20, "{share} {near}");
    // Half a quad in the middle is missing.
    for hole in [130, 145, 150] {
        let (holed, _) = covered(&[hole]);
        assert!(!holed[hole as usize]);
        assert!(holed.iter().filter(|c| **c).count() > 150);
    }
    // A ring of faces is missing: the inside cannot be reached from the boundary.
    let ring = |f: &u32| {
        let (x, y) = (f / 2 % 12, f / 24);
        x.abs_diff(6).max(y.abs_diff(6)) == 3
    };
    let moat: Vec<u32> = (0..288).filter(ring).collect();
    let (holed, _) = covered(&moat);
    assert!(moat.iter().all(|f| !holed[*f as usize]) && !holed[2 * (12 * 6 + 6)]);
    assert!(holed[0] && holed.iter().any(|c| *c));
}

#[test]
fn clipping_to_a_tiny_face_yields_few_parts() {
    let positions = [Vec3::ZERO, 1e-6 * Vec3::X, 1e-6 * Vec3::Y].to_vec();
    let mesh = Mesh { positions, faces: vec![[0, 1, 2]], ..Mesh::default() };
    let corners = [[-1.0, -1.0, 0.1], [1.0, -0.5, 0.1], [0.0, 1.0, 0.1]].map(DVec3::from);
    with_target(&mesh, |target| {
        let (mut parts, mut area) = (0, 0.0);
        target.clip_to_faces(&ConvexPolygon::new(&corners), 0, &mut |_, part, _| {
            parts += 1;
            area += part.area();
        });
        let whole = ConvexPolygon::new(&corners).area();
        assert!(parts < 10, "{parts} parts");
        assert!((area - whole).abs() < 1e-9 * whole, "{area} of {whole}");
    });
}
