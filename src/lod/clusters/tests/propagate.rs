//! Correspondences of clusters while they are built.

use super::super::cluster_builder::ClusterBuilder;
use super::super::convex_polygon::ConvexPolygon;
use super::super::distance_bound::TriangleCache;
use super::super::surfaces::VertexTable;
use super::*;

#[test]
fn source_patches_cover_the_original_and_are_within_their_distance_bound() {
    let mesh = ring(160, 48);
    let vertices = shading(&mesh).vertices;
    let corners = |f: &[u32; 3]| f.map(|v| mesh.positions[v as usize].as_dvec3());
    let areas: Vec<f64> =
        mesh.faces.iter().map(|f| ConvexPolygon::new(&corners(f)).area()).collect();
    let (mut levels, mut close) = (0, 0);
    let see = |live: &[(u32, ClusterBuilder)], places: &VertexTable| {
        levels += 1;
        let mut held = vec![0.0; mesh.faces.len()];
        for (_, d) in live {
            let faces: Vec<TriangleCache> = d
                .faces()
                .map(|f| TriangleCache::new(f.map(|v| places.positions[v as usize].as_dvec3())))
                .collect();
            for (corr, piece) in d.source_patch(&mesh) {
                held[corr.face as usize] += ConvexPolygon::new(&piece).area();
                let far = f64::from(corr.distance_mm);
                assert!(far <= d.error, "{far} of a cluster that errs {}", d.error);
                assert!(corr.triangle_mask != 0);
                let middle = piece.iter().sum::<DVec3>() / piece.len() as f64;
                for p in piece.iter().chain([&middle]) {
                    let d2 = corr.triangles().map(|t| faces[t].nearest(*p).d2);
                    let away = d2.fold(f64::INFINITY, f64::min).sqrt();
                    assert!(away <= far + 1e-6, "{away} mm, not {far}");
                    close += usize::from(away > 0.9 * far && far > 0.01);
                }
            }
        }
        for (held, area) in held.iter().zip(&areas) {
            assert!(*held > (1.0 - 1e-5) * area, "{held} mm\u{b2} of {area} have a correspondence");
        }
    };
    Clusters::build_observed(&mesh, &vertices, &TriangleBvh::new(&mesh), 1, true, see).unwrap();
    // The bounds are nearly attained.
    assert!(levels > 4 && close > 100, "{levels} levels, {close} points near the bound");
}
