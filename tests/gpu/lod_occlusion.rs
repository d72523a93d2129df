//! Occlusion culling changes no pixel.

use std::sync::Arc;

use glam::Vec3;
use intima::geometry::{Lens, Mesh, Pose, TriangleBvh};
use intima::lod::clusters::{ClusterLod, Clusters, DEFAULT_SHADING_RAD};
use intima::lod::{LodHierarchy, OcclusionTest, PageCache, Tolerance, occlusion_grid};
use intima::render::{Renderer, Scene, Shot, View};
use intima::surface::shading;
use intima::vk::Validate;

const MAJOR: f32 = 40.0;
const MINOR: f32 = 9.0;

/// A tube bent to a ring about z, with folds; faces look inwards.
fn ring(around: u32, across: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..around {
        for j in 0..across {
            let turn = |k: u32, n: u32| std::f32::consts::TAU * k as f32 / n as f32;
            let (u, v) = (turn(i, around), turn(j, across));
            let minor = MINOR * (1.0 + 0.15 * (18.0 * u).sin());
            let r = MAJOR + minor * v.cos();
            mesh.positions.push(Vec3::new(r * u.cos(), r * u.sin(), minor * v.sin()));
            let at = |i: u32, j: u32| (i % around) * across + j % across;
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            mesh.faces.extend([[a, c, b], [a, d, c]]);
        }
    }
    mesh
}

#[test]
fn occlusion_culling_in_a_torus_changes_no_pixel_and_draws_less() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let mesh = ring(400, 100);
    let shaded = shading(&mesh);
    let clusters =
        Arc::new(Clusters::build(&mesh, &shaded.vertices, &TriangleBvh::new(&mesh)).unwrap());
    let occlusion =
        Arc::new(OcclusionTest::new(occlusion_grid(&mesh), 0.0, clusters.largest_error_mm()));
    let count = clusters.clusters().len() as u32;
    let mut r = Renderer::new(&mut gpu, 160, 120, 1).unwrap();
    let mut fly = |hide: bool| {
        let pages = r.open_pages(&mut gpu, count, shaded.mean_radius_mm).unwrap();
        let mut lod = ClusterLod::new(Arc::clone(&clusters), DEFAULT_SHADING_RAD);
        if hide {
            lod = lod.with_occlusion(Arc::clone(&occlusion));
            r.hide(pages, Arc::clone(&occlusion));
        }
        let scene = Scene::paged(pages, None);
        let cache = &mut PageCache::new(count, u32::MAX, 0);
        let (mut pictures, mut triangles) = (Vec::new(), 0);
        for i in 0..12 {
            let u = 0.3 + 0.5 * i as f32;
            let (sine, cosine) = u.sin_cos();
            let eye = MAJOR * Vec3::new(cosine, sine, 0.0);
            // Along the tube, and more and more towards its hole.
            let ahead = Vec3::new(-sine, cosine, 0.0) - 0.12 * i as f32 * eye / MAJOR;
            let lens = Lens { fov_y_rad: 1.4, aspect: 4.0 / 3.0, near_mm: 0.5 };
            let pose = Pose::looking(eye, ahead, Vec3::Z);
            let shot = Shot { view: View::Inside, pose, lens, progress: 0.0, room_mm: None };
            let camera = r.cameras(&shot)[0];
            loop {
                let step = lod.step(&camera, &Tolerance { pixels: 0.5 }, cache);
                let settled = step.settled;
                r.apply(pages, step).unwrap();
                if settled {
                    break;
                }
            }
            let ticket = r.begin_frame(&mut gpu, &scene, &shot).unwrap();
            triangles += ticket.stats.triangles;
            pictures.push(r.fetch(&mut gpu, ticket).unwrap());
        }
        (pictures, triangles)
    };
    let ((all, many), (without, fewer)) = (fly(false), fly(true));
    assert!(all == without, "pixels differ");
    assert!(fewer * 10 < many * 8, "{fewer} triangles of {many}");
}
