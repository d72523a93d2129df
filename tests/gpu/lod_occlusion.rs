//! Occlusion culling changes no pixel.

use std::sync::Arc;

use glam::Vec3;
use intima::geometry::{Lens, Mesh, Pose};
use intima::lod::{CulledWall, FaceOctree, OcclusionTest, occlusion_grid};
use intima::render::{PreparedMesh, Renderer, Scene, Shot, View};
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
    let shaded = Arc::new(shading(&mesh));
    let octree = Arc::new(FaceOctree::new(&mesh));
    let test = Arc::new(OcclusionTest::of_wall(occlusion_grid(&mesh)));
    let mut r = Renderer::new(&mut gpu, 160, 120, 1).unwrap();
    let mut fly = |hide: bool| {
        let closed = hide.then(|| Arc::clone(&test));
        let wall = Arc::new(CulledWall { octree: Arc::clone(&octree), closed });
        let prepared = PreparedMesh::culled(&mesh, Arc::clone(&shaded), wall).unwrap();
        let scene = Scene::of(r.upload_prepared_mesh(&mut gpu, &prepared).unwrap());
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
            let ticket = r.begin_frame(&mut gpu, &scene, &shot).unwrap();
            triangles += ticket.stats.triangles;
            pictures.push(r.fetch(&mut gpu, ticket).unwrap());
        }
        (pictures, triangles)
    };
    let ((all, many), (without, fewer)) = (fly(false), fly(true));
    for (all, without) in all.iter().zip(&without) {
        // On the crest of a fold front and back may have the same depth, and the back win.
        let apart = all.chunks(3).zip(without.chunks(3)).filter(|(a, b)| a != b).count();
        assert!(apart <= 2, "{apart} pixels see what was left out");
    }
    assert!(fewer * 10 < many * 8, "{fewer} triangles of {many}");
}
