//! Drawing the patches of the subdivision, which stay on the device, by index templates and morphs.

use std::sync::Arc;

use common::tube;
use intima::geometry::{Camera, Lens, TriangleBvh, Vertex};
use intima::lod::vds::{ParameterizedOriginal, Scheme, SubdivisionSurface, Vds, VdsOptions};
use intima::lod::{LodHierarchy, LodStep, PageCache, Tolerance, Upload, VisiblePatch};
use intima::mesh::{Parameterization, SimplifyOptions, simplify};
use intima::render::{RenderError, Renderer, Scene, Shot, View};
use intima::surface::shading;
use intima::vk::Validate;

const SIZE: [u32; 2] = [160, 120];
const LENS: Lens = Lens { fov_y_rad: 1.4, aspect: 4.0 / 3.0, near_mm: 0.5 };

/// A tube of few base faces, and its mean radius.
fn surface(scheme: Scheme) -> (Arc<SubdivisionSurface>, f32) {
    let mesh = tube::tube(200, 64);
    let shaded = shading(&mesh);
    let mut maps = Parameterization::new(&mesh).unwrap();
    let base = simplify(&mesh, &SimplifyOptions::to_faces(200), &mut maps).unwrap();
    let tree = TriangleBvh::new(&mesh);
    let original = ParameterizedOriginal::new(&mesh, &shaded.vertices, &tree, &base, &maps);
    let options = VdsOptions { scheme, ..VdsOptions::default() };
    let surface = SubdivisionSurface::new(&base.mesh, &original, options).unwrap();
    (Arc::new(surface), shaded.mean_radius_mm)
}

/// The same triangles in pages.
fn in_pages(surface: &SubdivisionSurface, step: &LodStep) -> LodStep {
    let mut out = LodStep { settled: true, ..LodStep::default() };
    for d in &step.drawn {
        for part in surface.patches().triangles(d).chunks(32) {
            let page = out.uploads.len() as u32;
            let vertices: Vec<Vertex> = part.iter().flatten().copied().collect();
            let triangles = (0..part.len() as u8).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
            out.uploads.push(Upload { page, vertices, triangles });
            let triangles = part.len() as u32;
            out.drawn.push(VisiblePatch { page, resident: None, triangles, ..*d });
        }
    }
    out
}

#[test]
fn resident_patches_draw_the_same_image_as_their_triangles_in_pages() {
    for (samples, at_once, scheme) in [
        (1, u32::MAX, Scheme::OneToFour),
        (4, u32::MAX, Scheme::OneToFour),
        (1, 1, Scheme::OneToFour),
        (1, 7, Scheme::OneToFour),
        (1, u32::MAX, Scheme::Butterfly),
        (1, u32::MAX, Scheme::Sqrt3),
        (1, u32::MAX, Scheme::FourEight),
    ] {
        let (surface, radius) = surface(scheme);
        let Some(mut gpu) = common::few_draws_gpu(at_once, Validate::Sync) else { return };
        let mut r = Renderer::new(&mut gpu, SIZE[0], SIZE[1], samples).unwrap();
        let patches = r.open_patches(&mut gpu, surface.patches(), radius).unwrap();
        let mut vds = Vds::new(Arc::clone(&surface));
        let mut between = 0;
        for s in [20.0, 90.0, 160.0] {
            let (pose, lens) = (tube::pose(s), LENS);
            let camera = Camera { pose, lens, height_px: SIZE[1] };
            let cache = &mut PageCache::new(0, 0, 1);
            let step = vds.step(&camera, &Tolerance { pixels: 0.5 }, cache);
            let morphs = step.drawn.iter().filter_map(|d| d.resident).map(|m| m.morph);
            between += morphs.filter(|m| m % 32 != 0).count();
            let paged = in_pages(&surface, &step);
            let pages = r.open_pages(&mut gpu, paged.uploads.len() as u32, radius).unwrap();
            r.apply(patches, step).unwrap();
            r.apply(pages, paged).unwrap();
            let shot = Shot { view: View::Inside, pose, lens, progress: 0.5, room_mm: None };
            let mut draw = |of| r.render(&mut gpu, &Scene::paged(of, None), &shot).unwrap();
            let (got, want) = (draw(patches), draw(pages));
            r.close_pages(pages);
            let apart: Vec<u32> =
                got.iter().zip(&want).map(|(a, b)| u32::from(a.abs_diff(*b))).collect();
            let mean = f64::from(apart.iter().sum::<u32>()) / apart.len() as f64;
            let far = apart.iter().filter(|d| **d > 8).count();
            assert!(mean < 0.1 && far < 100, "{samples} samples: {mean} apart, {far} far");
            assert!(want.iter().any(|p| *p > 60), "the wall is seen");
        }
        // Predictions err so much that nearly all patches are at their finest.
        let least = match scheme {
            Scheme::OneToFour | Scheme::FourEight => 11,
            Scheme::Butterfly | Scheme::Sqrt3 => 0,
        };
        assert!(between >= least, "{scheme:?}: {between} patches are between two levels");
        assert!(scheme != Scheme::Sqrt3 || between == 0, "flipped edges do not morph");
        common::assert_silent(&gpu);
    }
}

#[test]
fn patches_that_do_not_lie_on_the_device_are_refused() {
    let (surface, radius) = surface(Scheme::OneToFour);
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let mut r = Renderer::new(&mut gpu, SIZE[0], SIZE[1], 1).unwrap();
    let patches = r.open_patches(&mut gpu, surface.patches(), radius).unwrap();
    let camera = Camera { pose: tube::pose(50.0), lens: LENS, height_px: SIZE[1] };
    let mut vds = Vds::new(Arc::clone(&surface));
    let step = vds.step(&camera, &Tolerance { pixels: 0.5 }, &mut PageCache::new(0, 0, 1));
    let first = step.drawn[0];
    let beyond = surface.patches().patches() as u32;
    for bad in [
        VisiblePatch { page: beyond, ..first },
        VisiblePatch { resident: None, ..first },
        VisiblePatch { triangles: 1 << 20, ..first },
    ] {
        let step = LodStep { drawn: vec![bad], ..LodStep::default() };
        let e = r.apply(patches, step).unwrap_err();
        assert!(matches!(e, RenderError::NoPatch { .. }), "{e}");
    }
    let pages = r.open_pages(&mut gpu, 4, radius).unwrap();
    assert!(matches!(r.apply(pages, step), Err(RenderError::NoPatch { patches: 0, .. })));
}
