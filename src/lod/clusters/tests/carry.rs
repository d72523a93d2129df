//! What clusters stand for while they are built.

use super::super::cover::{Known, Piece};
use super::super::draft::Draft;
use super::super::group::Places;
use super::*;

#[test]
fn all_of_the_original_is_as_near_to_what_stands_for_it_as_is_said() {
    let mesh = ring(160, 48);
    let vertices = shading(&mesh).vertices;
    let corners = |f: &[u32; 3]| f.map(|v| mesh.positions[v as usize].as_dvec3());
    let areas: Vec<f64> = mesh.faces.iter().map(|f| Piece::new(&corners(f)).area()).collect();
    let (mut levels, mut close) = (0, 0);
    let see = |live: &[(u32, Draft)], places: &Places| {
        levels += 1;
        let mut held = vec![0.0; mesh.faces.len()];
        for (_, d) in live {
            let faces: Vec<Known> = d
                .faces()
                .map(|f| Known::new(f.map(|v| places.positions[v as usize].as_dvec3())))
                .collect();
            for (lies, piece) in d.stands_for(&mesh) {
                held[lies.face as usize] += Piece::new(&piece).area();
                let far = f64::from(lies.far);
                assert!(far <= d.error, "{far} of a cluster that errs {}", d.error);
                assert!(lies.over != 0);
                let middle = piece.iter().sum::<DVec3>() / piece.len() as f64;
                for p in piece.iter().chain([&middle]) {
                    let d2 = lies.triangles().map(|t| faces[t].nearest(*p).d2);
                    let away = d2.fold(f64::INFINITY, f64::min).sqrt();
                    assert!(away <= far + 1e-6, "{away} mm, not {far}");
                    close += usize::from(away > 0.9 * far && far > 0.01);
                }
            }
        }
        for (held, area) in held.iter().zip(&areas) {
            assert!(*held > (1.0 - 1e-5) * area, "{held} mm\u{b2} of {area} are stood for");
        }
    };
    Clusters::build_seen(&mesh, &vertices, 1, true, see).unwrap();
    // The bounds mean something.
    assert!(levels > 4 && close > 100, "{levels} levels, {close} points near the bound");
}
