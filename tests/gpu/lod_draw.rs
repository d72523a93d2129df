//! Drawing a wall from pages, with few pages and small upload budgets.

use std::collections::VecDeque;
use std::sync::Arc;

use common::sections::{BASE_PAGES, FINE_PAGES, Sections, whole};
use common::{child, tube};
use intima::geometry::{Camera, Lens, Mesh};
use intima::lod::{
    FaceOctree, LodHierarchy, LodStep, PAGE_BYTES, Tolerance, Upload, VisiblePatch, Worker,
};
use intima::render::{
    Culling, FrameSequence, FrameStats, IN_FLIGHT, Look, PreparedMesh, RenderError, Renderer,
    Scene, SceneWall, Shot, View,
};
use intima::surface::shading;
use intima::vk::{Gpu, STAGING_BYTES, Validate};

const SIZE: [u32; 2] = [160, 120];
const LENS: Lens = Lens { fov_y_rad: 1.4, aspect: 4.0 / 3.0, near_mm: 0.5 };
/// Tissue is never greener than red.
const GREEN: Look = Look { background: [0.0, 1.0, 0.0], falloff_mm: None, opacity: 1.0 };

fn shot(s: f32) -> Shot {
    Shot {
        view: View::Inside,
        pose: tube::pose(s),
        lens: LENS,
        progress: s / tube::length(),
        room_mm: None,
    }
}

/// There and back again, faster than uploads can follow.
fn flight(frames: usize) -> Vec<Shot> {
    let there = |i: usize| {
        let t = 2.0 * i as f32 / (frames - 1) as f32;
        8.0 + (tube::length() - 16.0) * if t > 1.0 { 2.0 - t } else { t }
    };
    (0..frames).map(|i| shot(there(i))).collect()
}

fn holes(rgb: &[u8]) -> usize {
    rgb.chunks_exact(3).filter(|p| p[1] > p[0]).count()
}

fn renderer(gpu: &mut Gpu, samples: u32) -> Renderer {
    Renderer::new(gpu, SIZE[0], SIZE[1], samples).unwrap()
}

/// A scene of all of `mesh` in pages of at most `most` triangles.
fn paged(gpu: &mut Gpu, r: &mut Renderer, mesh: &Mesh, most: usize, backs: bool) -> Scene {
    let step = whole(mesh, most);
    let pages = step.drawn.len() as u32;
    let pages = r.open_pages(gpu, pages, shading(mesh).mean_radius_mm).unwrap();
    r.apply(pages, step).unwrap();
    Scene { wall: SceneWall::Pages { pages, backs }, ..Scene::paged(pages, None) }
}

/// Draws the shots one by one.
fn pictures(gpu: &mut Gpu, r: &mut Renderer, scene: &Scene, shots: &[Shot]) -> Vec<Vec<u8>> {
    shots.iter().map(|s| r.render(gpu, scene, s).unwrap()).collect()
}

fn worker(pages: u32, uploads: u64) -> Worker {
    let tolerance = Tolerance { pixels: 1.0 };
    let refine = Box::new(Sections::of_tube());
    Worker::spawn(refine, tolerance, pages, uploads * PAGE_BYTES, IN_FLIGHT as u32).unwrap()
}

#[test]
fn pages_draw_the_same_image_as_their_mesh() {
    let mesh = tube::tube(250, 64);
    let shots = flight(7);
    for (samples, at_once) in [(1, u32::MAX), (4, u32::MAX), (4, 1), (1, 7)] {
        let Some(mut gpu) = common::few_draws_gpu(at_once, Validate::Sync) else { return };
        let mut r = renderer(&mut gpu, samples);
        let plain = Scene::of(r.upload_mesh(&mut gpu, &mesh, false).unwrap());
        let want = pictures(&mut gpu, &mut r, &plain, &shots);
        let mut fronts = Vec::new();
        for (most, backs) in [(128, true), (16, true), (128, false), (16, false)] {
            let scene = paged(&mut gpu, &mut r, &mesh, most, backs);
            let got = pictures(&mut gpu, &mut r, &scene, &shots);
            let what = format!("{samples} samples, {at_once} draws at once, {most}");
            if backs {
                assert!(got == want, "{what}");
            } else {
                // On the crest of a fold front and back may have the same depth, and the back win.
                let apart = got
                    .iter()
                    .zip(&want)
                    .map(|(g, w)| g.chunks(3).zip(w.chunks(3)).filter(|(a, b)| a != b).count());
                assert!(apart.clone().all(|n| n <= 2), "{what}: {:?}", apart.collect::<Vec<_>>());
                fronts.push(got);
            }
        }
        assert!(fronts[0] == fronts[1], "{samples} samples, {at_once} draws at once");
        drop(r);
        common::assert_silent(&gpu);
    }
}

#[test]
fn a_culled_mesh_draws_the_same_image_as_the_whole_mesh_through_open_ends_too() {
    let mesh = tube::tube(250, 64);
    let shots = flight(7);
    for (samples, at_once) in [(1, u32::MAX), (4, 7)] {
        let Some(mut gpu) = common::few_draws_gpu(at_once, Validate::Sync) else { return };
        let mut r = renderer(&mut gpu, samples);
        let plain = Scene::of(r.upload_mesh(&mut gpu, &mesh, false).unwrap());
        let want = pictures(&mut gpu, &mut r, &plain, &shots);
        let culling = Culling { octree: Arc::new(FaceOctree::new(&mesh)), closed: None };
        let prepared =
            PreparedMesh::culled(&mesh, Arc::new(shading(&mesh)), Culling::clone(&culling))
                .unwrap();
        let at_once_culled = r.upload_prepared_mesh(&mut gpu, &prepared).unwrap();
        let later = PreparedMesh::new(&mesh).unwrap();
        let handle = r.upload_prepared_mesh(&mut gpu, &later).unwrap();
        r.cull_mesh(&mut gpu, handle, &later, culling).unwrap();
        let culled = Scene::of(handle);
        for scene in [&Scene::of(at_once_culled), &culled] {
            let got = pictures(&mut gpu, &mut r, scene, &shots);
            assert!(got == want, "{samples} samples, {at_once} draws at once");
        }
        let ticket = r.begin_frame(&mut gpu, &culled, &shots[2]).unwrap();
        let FrameStats { triangles, draws, .. } = ticket.stats;
        assert!(triangles > 0 && 2 * triangles < 3 * mesh.faces.len() as u64 && draws > 1);
        r.fetch(&mut gpu, ticket).unwrap();
        drop(r);
        common::assert_silent(&gpu);
    }
}

#[test]
fn culled_pages_are_not_submitted() {
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    let mesh = tube::tube(250, 64);
    let mut r = renderer(&mut gpu, 1);
    let mut took = Vec::new();
    for backs in [true, false] {
        let scene = paged(&mut gpu, &mut r, &mesh, 16, backs);
        let ticket = r.begin_frame(&mut gpu, &scene, &shot(140.0)).unwrap();
        took.push(ticket.stats);
        r.fetch(&mut gpu, ticket).unwrap();
        let again = r.begin_frame(&mut gpu, &scene, &shot(140.0)).unwrap();
        assert_eq!(FrameStats { uploaded_bytes: 0, ..took[took.len() - 1] }, again.stats);
        r.fetch(&mut gpu, again).unwrap();
    }
    let all = mesh.faces.len() as u64;
    assert!(took[1].triangles < took[0].triangles && took[0].triangles < all, "{took:?} of {all}");
    assert!(took[0].triangles > 0 && took[0].uploaded_bytes > 18 * all, "{took:?}");
    let plain = Scene::of(r.upload_mesh(&mut gpu, &mesh, false).unwrap());
    let ticket = r.begin_frame(&mut gpu, &plain, &shot(140.0)).unwrap();
    assert_eq!(ticket.stats, FrameStats { triangles: all, draws: 1, ..Default::default() });
    r.fetch(&mut gpu, ticket).unwrap();
}

#[test]
fn uploads_larger_than_one_submission_arrive_before_the_frame() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let mesh = tube::tube(1400, 130);
    let mut r = renderer(&mut gpu, 1);
    let plain = Scene::of(r.upload_mesh(&mut gpu, &mesh, false).unwrap());
    let scene = paged(&mut gpu, &mut r, &mesh, 128, true);
    let ticket = r.begin_frame(&mut gpu, &scene, &shot(140.0)).unwrap();
    assert!(ticket.stats.uploaded_bytes > 7 << 20, "{:?}", ticket.stats);
    let got = r.fetch(&mut gpu, ticket).unwrap();
    assert!(got == r.render(&mut gpu, &plain, &shot(140.0)).unwrap());
    drop(r);
    common::assert_silent(&gpu);
}

/// The whole wall is written anew for each frame while three frames that show the old one run.
#[test]
fn pages_can_be_overwritten_while_frames_that_drew_them_are_in_flight() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let first = tube::tube(60, 64);
    let mut second = first.clone();
    second.normals.iter_mut().for_each(|n| *n = (*n + glam::Vec3::Z).normalize());
    let steps = [whole(&first, 128), whole(&second, 128)];
    let mut r = renderer(&mut gpu, 1);
    let want = [&first, &second].map(|mesh| {
        let scene = paged(&mut gpu, &mut r, mesh, 128, false);
        r.render(&mut gpu, &scene, &shot(60.0)).unwrap()
    });
    assert!(want[0] != want[1]);
    let scene = paged(&mut gpu, &mut r, &first, 128, false);
    let SceneWall::Pages { pages, .. } = scene.wall else { unreachable!() };
    let mut waiting = VecDeque::new();
    let mut uploaded = 0;
    for i in 0..40 {
        r.apply(pages, steps[i % 2].clone()).unwrap();
        let ticket = r.begin_frame(&mut gpu, &scene, &shot(60.0)).unwrap();
        uploaded += ticket.stats.uploaded_bytes;
        waiting.push_back((i, ticket));
        if waiting.len() == IN_FLIGHT || i == 39 {
            let (i, ticket) = waiting.pop_front().unwrap();
            // The mean radius is that of the first wall in both: only the normals differ.
            assert!(r.fetch(&mut gpu, ticket).unwrap() == want[i % 2], "frame {i}");
        }
    }
    for (i, ticket) in waiting {
        assert!(r.fetch(&mut gpu, ticket).unwrap() == want[i % 2], "frame {i}");
    }
    let held = gpu.staging_held();
    assert!(uploaded > 2 * held && held <= STAGING_BYTES, "{uploaded} bytes by {held}");
    drop(r);
    common::assert_silent(&gpu);
}

#[test]
fn a_live_flight_has_no_hole_with_few_pages_and_converges_to_the_captured_image() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let few = BASE_PAGES + 4 * FINE_PAGES + 3;
    let mut r = renderer(&mut gpu, 1);
    let pages = r.open_pages(&mut gpu, few, tube::RADIUS).unwrap();
    let scene = Scene { look: GREEN, ..Scene::paged(pages, None) };
    let mut w = worker(few, 1);
    let shots = flight(120);
    r.apply(pages, w.converge(r.cameras(&shots[0])[0]).unwrap()).unwrap();
    let (mut waiting, mut steps, mut changed, mut most) = (VecDeque::new(), 0, 0, 0);
    for (i, shot) in shots.iter().enumerate() {
        w.set_camera(&r.cameras(shot)[0]);
        while let Some(step) = w.try_recv().unwrap() {
            assert!(step.uploads.len() <= 1, "{} pages in one step", step.uploads.len());
            (steps, changed) = (steps + 1, changed + step.leaves_changed);
            r.apply(pages, step).unwrap();
        }
        let ticket = r.begin_frame(&mut gpu, &scene, shot).unwrap();
        most = most.max(ticket.stats.uploaded_bytes);
        waiting.push_back((i, ticket));
        if waiting.len() == IN_FLIGHT {
            let (i, ticket) = waiting.pop_front().unwrap();
            let holes = holes(&r.fetch(&mut gpu, ticket).unwrap());
            assert_eq!(holes, 0, "{holes} pixels of background in frame {i}");
        }
    }
    for (_, ticket) in waiting {
        r.fetch(&mut gpu, ticket).unwrap();
    }
    assert!(steps > 20 && changed > 5 && most > 0, "{steps} steps, {changed} changes, {most} B");
    // The last camera's cut, however it was reached.
    let last = *shots.last().unwrap();
    r.apply(pages, w.converge(r.cameras(&last)[0]).unwrap()).unwrap();
    let live = r.render(&mut gpu, &scene, &last).unwrap();
    let pages = r.open_pages(&mut gpu, few, tube::RADIUS).unwrap();
    let film = Scene { look: GREEN, ..Scene::paged(pages, None) };
    let mut fresh = worker(few, 1000);
    r.apply(pages, fresh.converge(r.cameras(&last)[0]).unwrap()).unwrap();
    assert!(live == r.render(&mut gpu, &film, &last).unwrap(), "the cut depends on the way to it");
    // The test for holes sees the first missing page.
    let mut step = fresh.converge(r.cameras(&last)[0]).unwrap();
    step.drawn.truncate(step.drawn.len() - 9);
    r.apply(pages, step).unwrap();
    assert!(holes(&r.render(&mut gpu, &film, &last).unwrap()) > 0);
    drop(r);
    common::assert_silent(&gpu);
}

/// Captures a flight with few pages: frames and their statistics.
fn capture(gpu: &mut Gpu, pages: u32, shots: &[Shot]) -> Vec<(Vec<u8>, FrameStats)> {
    let mut r = renderer(gpu, 1);
    let handle = r.open_pages(gpu, pages, tube::RADIUS).unwrap();
    let scene = Scene { look: GREEN, ..Scene::paged(handle, None) };
    let mut sequence = FrameSequence::new(scene, shots.to_vec(), Some(worker(pages, 2)));
    let mut frames = Vec::new();
    while let Some(frame) = sequence.next_frame(&mut r, gpu).unwrap() {
        frames.push(frame);
    }
    assert_eq!(frames.len(), shots.len());
    assert_eq!(sequence.finish(&mut r, gpu).unwrap().map(|w| w.outstanding()), Some(0));
    frames
}

#[test]
fn captured_frames_do_not_depend_on_earlier_frames() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let pages = BASE_PAGES + 5 * FINE_PAGES;
    let shots = flight(12);
    let frames = capture(&mut gpu, pages, &shots);
    let uploaded: u64 = frames.iter().map(|f| f.1.uploaded_bytes).sum();
    assert!(uploaded > 3 * u64::from(pages) * PAGE_BYTES / 2, "no page was used again: {uploaded}");
    for (i, frame) in frames.iter().enumerate() {
        assert_eq!(holes(&frame.0), 0, "frame {i}");
        let alone = capture(&mut gpu, pages, &shots[i..=i]);
        assert!(alone[0].0 == frame.0, "frame {i} differs");
        assert_eq!(alone[0].1.triangles, frame.1.triangles);
    }
    common::assert_silent(&gpu);
}

#[test]
fn a_stopped_capture_loses_no_page() {
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    let pages = BASE_PAGES + 5 * FINE_PAGES;
    let shots = flight(12);
    let want = capture(&mut gpu, pages, &shots[9..10]);
    let mut r = renderer(&mut gpu, 1);
    let handle = r.open_pages(&mut gpu, pages, tube::RADIUS).unwrap();
    let scene = Scene { look: GREEN, ..Scene::paged(handle, None) };
    let mut sequence = FrameSequence::new(scene, shots.clone(), Some(worker(pages, 2)));
    for _ in 0..3 {
        sequence.next_frame(&mut r, &mut gpu).unwrap().expect("twelve frames");
    }
    let mut w = sequence.finish(&mut r, &mut gpu).unwrap().expect("the worker");
    assert_eq!(w.outstanding(), 0);
    r.apply(handle, w.converge(r.cameras(&shots[9])[0]).unwrap()).unwrap();
    assert!(r.render(&mut gpu, &scene, &shots[9]).unwrap() == want[0].0);
}

#[test]
fn a_failed_worker_ends_the_capture_with_its_error() {
    struct Failing;
    impl LodHierarchy for Failing {
        fn step(&mut self, _: &Camera, _: &Tolerance, _: &mut intima::lod::PageCache) -> LodStep {
            panic!("planted")
        }
        fn state_hash(&self) -> u64 {
            0
        }
        fn finest_faces(&self) -> u64 {
            0
        }
    }
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    let mut r = renderer(&mut gpu, 1);
    let w = Worker::spawn(Box::new(Failing), Tolerance { pixels: 1.0 }, 4, 0, 3).unwrap();
    let pages = r.open_pages(&mut gpu, 4, 1.0).unwrap();
    let mut sequence = FrameSequence::new(Scene::paged(pages, None), flight(3), Some(w));
    let failed = sequence.next_frame(&mut r, &mut gpu);
    assert!(failed.unwrap_err().to_string().contains("planted"));
    assert!(sequence.next_frame(&mut r, &mut gpu).unwrap().is_none(), "a frame after the error");
}

#[test]
fn an_invalid_step_is_refused_without_side_effects() {
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    let mut r = renderer(&mut gpu, 1);
    assert!(matches!(r.open_pages(&mut gpu, 0, 1.0), Err(RenderError::BadPages { pages: 0 })));
    assert!(matches!(r.open_pages(&mut gpu, u32::MAX, 1.0), Err(RenderError::BadPages { .. })));
    let all = whole(&tube::tube(20, 16), 128);
    let n = all.drawn.len() as u32;
    let pages = r.open_pages(&mut gpu, n, 18.0).unwrap();
    let scene = Scene { look: GREEN, ..Scene::paged(pages, None) };
    let empty = r.render(&mut gpu, &scene, &shot(60.0)).unwrap();
    assert_eq!(holes(&empty), empty.len() / 3);
    let (mut far, mut more): (LodStep, LodStep) = (all.clone(), all.clone());
    far.uploads.push(Upload { page: n, vertices: Vec::new(), triangles: Vec::new() });
    more.drawn.push(VisiblePatch { triangles: 129, ..all.drawn[0] });
    let unwritten = LodStep { uploads: Vec::new(), ..all.clone() };
    assert!(matches!(r.apply(pages, far), Err(RenderError::BadUpload { .. })));
    assert!(matches!(r.apply(pages, more), Err(RenderError::EmptyPage { .. })));
    assert!(matches!(r.apply(pages, unwritten), Err(RenderError::EmptyPage { there: 0, .. })));
    assert!(r.render(&mut gpu, &scene, &shot(60.0)).unwrap() == empty);
    r.apply(pages, all).unwrap();
    assert_eq!(holes(&r.render(&mut gpu, &scene, &shot(60.0)).unwrap()), 0);
    // An overview without a mesh is path and camera alone.
    let at = Shot { view: View::Overview, ..shot(60.0) };
    assert!(r.cameras(&at).is_empty());
    r.render(&mut gpu, &scene, &at).unwrap();
    r.close_pages(pages);
}

/// Runs in a process of its own.
fn child_hashes_a_capture() {
    let mut gpu = common::gpu(Validate::Off).expect("the parent found a device");
    for (rgb, stats) in capture(&mut gpu, BASE_PAGES + 5 * FINE_PAGES, &flight(6)) {
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
