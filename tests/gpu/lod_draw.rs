//! Drawing a mesh less what cameras cannot see of it, and flights of such frames.

use std::sync::Arc;

use common::{child, tube};
use intima::geometry::Lens;
use intima::lod::{CulledWall, FaceOctree};
use intima::render::{FrameSequence, FrameStats, PreparedMesh, Renderer, Scene, Shot, View};
use intima::surface::shading;
use intima::vk::{Gpu, Validate};

const SIZE: [u32; 2] = [160, 120];
const LENS: Lens = Lens { fov_y_rad: 1.4, aspect: 4.0 / 3.0, near_mm: 0.5 };

fn shot(s: f32) -> Shot {
    Shot {
        view: View::Inside,
        pose: tube::pose(s),
        lens: LENS,
        progress: s / tube::length(),
        room_mm: None,
    }
}

/// There and back again.
fn flight(frames: usize) -> Vec<Shot> {
    let there = |i: usize| {
        let t = 2.0 * i as f32 / (frames - 1) as f32;
        8.0 + (tube::length() - 16.0) * if t > 1.0 { 2.0 - t } else { t }
    };
    (0..frames).map(|i| shot(there(i))).collect()
}

fn renderer(gpu: &mut Gpu, samples: u32) -> Renderer {
    Renderer::new(gpu, SIZE[0], SIZE[1], samples).unwrap()
}

/// A scene of a culled mesh.
fn culled(gpu: &mut Gpu, r: &mut Renderer) -> Scene {
    let mesh = tube::tube(250, 64);
    let wall = Arc::new(CulledWall { octree: Arc::new(FaceOctree::new(&mesh)), closed: None });
    let prepared = PreparedMesh::culled(&mesh, Arc::new(shading(&mesh)), wall).unwrap();
    Scene::of(r.upload_prepared_mesh(gpu, &prepared).unwrap())
}

/// Draws the shots one by one.
fn pictures(gpu: &mut Gpu, r: &mut Renderer, scene: &Scene, shots: &[Shot]) -> Vec<Vec<u8>> {
    shots.iter().map(|s| r.render(gpu, scene, s).unwrap()).collect()
}

#[test]
fn a_culled_mesh_draws_the_same_image_as_the_whole_mesh_through_open_ends_too() {
    let mesh = tube::tube(250, 64);
    let shots = flight(7);
    for (samples, at_once) in [(1, u32::MAX), (4, 7), (1, 1)] {
        let Some(mut gpu) = common::few_draws_gpu(at_once, Validate::Sync) else { return };
        let mut r = renderer(&mut gpu, samples);
        let plain = Scene::of(r.upload_mesh(&mut gpu, &mesh, false).unwrap());
        let want = pictures(&mut gpu, &mut r, &plain, &shots);
        let at_once_culled = culled(&mut gpu, &mut r);
        let later = PreparedMesh::new(&mesh).unwrap();
        let handle = r.upload_prepared_mesh(&mut gpu, &later).unwrap();
        let octree = Arc::new(FaceOctree::new(&mesh));
        r.cull_mesh(&mut gpu, handle, &later, Arc::new(CulledWall { octree, closed: None }))
            .unwrap();
        let scene = Scene::of(handle);
        for scene in [&at_once_culled, &scene] {
            let got = pictures(&mut gpu, &mut r, scene, &shots);
            assert!(got == want, "{samples} samples, {at_once} draws at once");
        }
        let ticket = r.begin_frame(&mut gpu, &scene, &shots[2]).unwrap();
        let FrameStats { triangles, draws, .. } = ticket.stats;
        assert!(triangles > 0 && 2 * triangles < 3 * mesh.faces.len() as u64 && draws > 1);
        r.fetch(&mut gpu, ticket).unwrap();
        let ticket = r.begin_frame(&mut gpu, &plain, &shots[2]).unwrap();
        let all = mesh.faces.len() as u64;
        assert_eq!(ticket.stats, FrameStats { triangles: all, draws: 1, waiting: 0 });
        r.fetch(&mut gpu, ticket).unwrap();
        // An overview without a mesh is path and camera alone.
        let at = Shot { view: View::Overview, ..shots[0] };
        assert!(r.cameras(&at).is_empty());
        r.render(&mut gpu, &Scene::with(handle, None), &at).unwrap();
        drop(r);
        common::assert_silent(&gpu);
    }
}

/// Frames of a flight and their statistics.
fn capture(gpu: &mut Gpu, shots: &[Shot]) -> Vec<(Vec<u8>, FrameStats)> {
    let mut r = renderer(gpu, 1);
    let scene = culled(gpu, &mut r);
    let mut sequence = FrameSequence::new(scene, shots.to_vec());
    let mut frames = Vec::new();
    while let Some(frame) = sequence.next_frame(&mut r, gpu).unwrap() {
        frames.push(frame);
    }
    assert_eq!(frames.len(), shots.len());
    frames
}

#[test]
fn captured_frames_do_not_depend_on_earlier_frames_or_on_those_found_at_once() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let mut shots = flight(19);
    shots[4].view = View::Cube;
    shots[11].view = View::Panorama;
    let frames = capture(&mut gpu, &shots);
    for (i, frame) in frames.iter().enumerate() {
        let alone = capture(&mut gpu, &shots[i..=i]);
        assert!(alone[0] == *frame, "frame {i} differs");
    }
    common::assert_silent(&gpu);
}

#[test]
fn after_a_stopped_capture_the_renderer_is_free() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let shots = flight(12);
    let mut r = renderer(&mut gpu, 1);
    let scene = culled(&mut gpu, &mut r);
    let want = r.render(&mut gpu, &scene, &shots[9]).unwrap();
    let mut sequence = FrameSequence::new(scene, shots.clone());
    for _ in 0..3 {
        sequence.next_frame(&mut r, &mut gpu).unwrap().expect("twelve frames");
    }
    sequence.finish(&mut r, &mut gpu);
    assert!(sequence.next_frame(&mut r, &mut gpu).unwrap().is_none());
    assert!(r.render(&mut gpu, &scene, &shots[9]).unwrap() == want);
    drop(r);
    common::assert_silent(&gpu);
}

/// Runs in a process of its own.
fn child_hashes_a_capture() {
    let mut gpu = common::gpu(Validate::Off).expect("the parent found a device");
    for (rgb, stats) in capture(&mut gpu, &flight(6)) {
        println!("child: {} {stats:?}", blake3::hash(&rgb));
    }
}

#[test]
fn captured_frames_have_the_same_bytes_at_any_thread_count() {
    if child::is_child() {
        return child_hashes_a_capture();
    }
    let Some(_) = common::gpu(Validate::Off) else { return };
    let run = |threads| {
        let env = [("LP_NUM_THREADS", threads), ("RAYON_NUM_THREADS", threads)];
        child::said(&child::run(
            "lod_draw::captured_frames_have_the_same_bytes_at_any_thread_count",
            &env,
        ))
    };
    let first = run("1");
    assert_eq!(first.len(), 6);
    for threads in ["1", "2", "0"] {
        assert_eq!(run(threads), first, "with {threads} threads");
    }
}
