//! Levels of detail against the original, by ray casting and nearest-point queries that share no
//! code with the crate.

use common::cast::Cast;
use common::{screen, tube};
use intima::geometry::{Camera, Lens, Mesh, TriangleBvh};
use intima::lod::vds::VdsOptions;
use intima::mesh::{Metric, SimplifyOptions};
use intima::session::{Clock, Levels, WallForm};
use intima::surface::shading;

fn camera(s: f32, fov_deg: f32) -> Camera {
    let lens = Lens { fov_y_rad: fov_deg.to_radians(), aspect: 4.0 / 3.0, near_mm: 0.5 };
    Camera { pose: tube::pose(s), lens, height_px: 60 }
}

fn subdivision(mesh: &Mesh, pixel_error: f32) -> Levels {
    let vertices = shading(mesh).vertices;
    let clock = &mut Clock::default();
    let base = SimplifyOptions::to_faces(mesh.faces.len() / 100);
    let base = SimplifyOptions { metric: Metric::NormalQem, ..base };
    let (tree, vds) = (TriangleBvh::new(mesh), VdsOptions::default());
    Levels::of_subdivision(mesh, &vertices, &tree, base, vds, pixel_error, clock).unwrap()
}

/// Compares every pixel of a flight through the tube.
fn flown(levels: Levels, mesh: &Mesh, tau: f64) -> (screen::Found, f64) {
    let original = Cast::of(mesh);
    let WallForm::Subdivided(wall) = &levels.form else { panic!("a subdivision") };
    let patches = wall.surface().patches();
    let (mut found, mut drawn) = (screen::Found::default(), 0);
    for fov in [60.0, 90.0, 120.0] {
        for i in 0..5 {
            let camera = camera(30.0 + 50.0 * i as f32, fov);
            let cut = wall.cut(&camera);
            let cut = cut.iter().flat_map(|d| patches.triangles(d));
            let cut: Vec<_> = cut.map(|t| t.map(|v| v.position().as_dvec3())).collect();
            drawn += cut.len();
            found = found.and(screen::compare(&original, &Cast::new(cut), &camera, tau));
        }
    }
    (found, drawn as f64 / 15.0 / mesh.faces.len() as f64)
}

#[test]
fn subdivision_cuts_have_no_hole_and_keep_the_pixel_error() {
    let mesh = tube::tube(300, 96);
    let (found, share) = flown(subdivision(&mesh, 1.0), &mesh, 1.0);
    println!("{found:?}, {share:.3} of the faces");
    assert!(share < 0.7, "nothing is saved: {share}");
    assert_eq!(found.holes, 0);
    assert!(found.inside() >= 0.9999, "{found:?}");
}

#[test]
fn the_pixel_comparison_detects_a_cut_coarser_than_the_bound() {
    let mesh = tube::tube(300, 96);
    let (found, _) = flown(subdivision(&mesh, 8.0), &mesh, 0.05);
    assert!(found.inside() < 0.999 && found.worst_px > 0.1, "{found:?}");
}
