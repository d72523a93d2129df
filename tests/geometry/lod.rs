//! Levels of detail against the original, by ray casting and nearest-point queries that share no
//! code with the crate.

use common::cast::Cast;
use common::pages::Pages;
use common::{screen, tube};
use intima::geometry::{Camera, Lens, Mesh, TriangleBvh};
use intima::lod::vds::VdsOptions;
use intima::lod::{PageCache, Tolerance};
use intima::mesh::{Metric, SimplifyOptions};
use intima::session::{Clock, Levels};
use intima::surface::shading;

fn camera(s: f32, fov_deg: f32) -> Camera {
    let lens = Lens { fov_y_rad: fov_deg.to_radians(), aspect: 4.0 / 3.0, near_mm: 0.5 };
    Camera { pose: tube::pose(s), lens, height_px: 60 }
}

fn clusters(mesh: &Mesh) -> Levels {
    let vertices = shading(mesh).vertices;
    let built =
        intima::lod::clusters::Clusters::build(mesh, &vertices, &TriangleBvh::new(mesh)).unwrap();
    Levels::of_clusters(built, 1.0, false)
}

fn subdivision(mesh: &Mesh) -> Levels {
    let vertices = shading(mesh).vertices;
    let clock = &mut Clock::default();
    let base = SimplifyOptions::to_faces(mesh.faces.len() / 100);
    let base = SimplifyOptions { metric: Metric::NormalQem, ..base };
    let (tree, vds) = (TriangleBvh::new(mesh), VdsOptions::default());
    Levels::of_subdivision(mesh, &vertices, &tree, base, vds, 1.0, clock).unwrap()
}

/// Compares every pixel of a flight through the tube.
fn flown(levels: Levels, mesh: &Mesh, tau: f64) -> (screen::Found, f64) {
    let original = Cast::of(mesh);
    let tolerance = Tolerance { pixels: levels.report.pixel_error };
    let cache = &mut PageCache::new(levels.pages, u32::MAX, 0);
    let mut hierarchy = levels.hierarchy();
    let mut pages = Pages::of(levels.resident());
    let (mut found, mut drawn) = (screen::Found::default(), 0);
    for fov in [60.0, 90.0, 120.0] {
        for i in 0..5 {
            let camera = camera(30.0 + 50.0 * i as f32, fov);
            pages.settle(hierarchy.as_mut(), &camera, &tolerance, cache);
            let cut = pages.corners();
            drawn += cut.len();
            found = found.and(screen::compare(&original, &Cast::new(cut), &camera, tau));
        }
    }
    (found, drawn as f64 / 15.0 / mesh.faces.len() as f64)
}

#[test]
fn cluster_cuts_have_no_hole_and_keep_the_pixel_error() {
    let mesh = tube::tube(500, 160);
    let (found, share) = flown(clusters(&mesh), &mesh, 1.0);
    println!("{found:?}, {share:.3} of the faces");
    assert!(share < 0.5, "nothing is saved: {share}");
    assert_eq!(found.holes, 0);
    assert!(found.inside() >= 0.9999, "{found:?}");
}

#[test]
fn subdivision_cuts_have_no_hole_and_keep_the_pixel_error() {
    let mesh = tube::tube(300, 96);
    let (found, share) = flown(subdivision(&mesh), &mesh, 1.0);
    println!("{found:?}, {share:.3} of the faces");
    assert!(share < 0.7, "nothing is saved: {share}");
    assert_eq!(found.holes, 0);
    assert!(found.inside() >= 0.9999, "{found:?}");
}

#[test]
fn the_pixel_comparison_detects_a_cut_coarser_than_the_bound() {
    let mesh = tube::tube(300, 96);
    let mut levels = clusters(&mesh);
    levels.report.pixel_error = 8.0;
    let (found, _) = flown(levels, &mesh, 0.05);
    assert!(found.inside() < 0.999 && found.worst_px > 0.1, "{found:?}");
}
