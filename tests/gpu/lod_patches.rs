//! Drawing the patches of the subdivision, which stay on the device, by index templates and morphs.

use std::sync::Arc;

use common::tube;
use intima::geometry::{Camera, Lens, Mesh, TriangleBvh, Vertex};
use intima::lod::Tolerance;
use intima::lod::vds::{
    ParameterizedOriginal, Scheme, SubdividedWall, SubdivisionSurface, VdsOptions,
};
use intima::mesh::{Parameterization, SimplifyOptions, simplify};
use intima::render::{PreparedMesh, Renderer, Scene, Shot, View};
use intima::surface::{Shading, shading};
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

/// Triangles as a mesh whose vertices are drawn as they are.
fn as_mesh(triangles: Vec<[Vertex; 3]>, mean_radius_mm: f32) -> PreparedMesh {
    let vertices: Vec<Vertex> = triangles.into_iter().flatten().collect();
    let mesh = Mesh {
        positions: vertices.iter().map(Vertex::position).collect(),
        faces: (0..vertices.len() as u32 / 3).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect(),
        ..Mesh::default()
    };
    PreparedMesh::shaded(&mesh, Arc::new(Shading { vertices, mean_radius_mm })).unwrap()
}

#[test]
fn patches_draw_the_same_image_as_their_triangles_in_a_mesh() {
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
        let tolerance = Tolerance { pixels: 0.5 };
        let wall = Arc::new(SubdividedWall::new(Arc::clone(&surface), tolerance, None));
        let prepared = PreparedMesh::subdivided(Arc::clone(&wall), radius);
        let patches = r.upload_prepared_mesh(&mut gpu, &prepared).unwrap();
        let mut between = 0;
        for s in [20.0, 90.0, 160.0] {
            let (pose, lens) = (tube::pose(s), LENS);
            let camera = Camera { pose, lens, height_px: SIZE[1] };
            let cut = wall.cut(&camera);
            between += cut.iter().filter(|d| d.morph % 32 != 0).count();
            let triangles = cut.iter().flat_map(|d| surface.patches().triangles(d)).collect();
            let mesh = r.upload_prepared_mesh(&mut gpu, &as_mesh(triangles, radius)).unwrap();
            let shot = Shot { view: View::Inside, pose, lens, progress: 0.5, room_mm: None };
            let mut draw = |of| r.render(&mut gpu, &Scene::with(of, None), &shot).unwrap();
            let (got, want) = (draw(patches), draw(mesh));
            r.remove_mesh(mesh);
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
