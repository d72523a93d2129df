//! Level of detail on large meshes: frame times and errors on screen.

use std::sync::Arc;
use std::time::Instant;

use common::cast::Cast;
use common::pages::Pages;
use common::{fly, screen};
use intima::geometry::{Camera, Mesh, TriangleBvh};
use intima::lod::clusters::{ClusterLod, Clusters, DEFAULT_SHADING_RAD};
use intima::lod::{LodHierarchy, OcclusionTest, PageCache, Tolerance, Worker, occlusion_grid};
use intima::render::{FrameSequence, FrameStats, MAX_PAGES, Renderer, Scene, Shot, View};
use intima::surface::shading;
use intima::vk::{Gpu, Validate};

const SIZE: [u32; 2] = [1280, 720];
const TAU: f32 = 1.0;

fn median(mut v: Vec<f64>) -> f64 {
    v.sort_by(f64::total_cmp);
    v.get(v.len() / 2).copied().unwrap_or(f64::NAN)
}

fn clusters(mesh: &Mesh) -> (Arc<Clusters>, f32) {
    let shading = shading(mesh);
    let start = Instant::now();
    let clusters = Clusters::build(mesh, &shading.vertices, &TriangleBvh::new(mesh)).unwrap();
    println!(
        "  clusters: {:.2} s, {} of them, {:.1} MB, {:.1} bytes a face",
        start.elapsed().as_secs_f64(),
        clusters.clusters().len(),
        clusters.bytes() as f64 / 1e6,
        clusters.bytes() as f64 / mesh.faces.len() as f64
    );
    (Arc::new(clusters), shading.mean_radius_mm)
}

struct Flown {
    ms: Vec<f64>,
    stats: Vec<FrameStats>,
    pictures: Vec<Vec<u8>>,
}

fn fly(
    gpu: &mut Gpu,
    samples: u32,
    shots: &[Shot],
    mesh: &Mesh,
    lod: Option<&(Arc<Clusters>, f32)>,
) -> Flown {
    let mut r = Renderer::new(gpu, SIZE[0], SIZE[1], samples).unwrap();
    let (scene, worker) = match lod {
        None => (Scene::of(r.upload_mesh(gpu, mesh, false).unwrap()), None),
        Some((clusters, radius)) => {
            let outside = Arc::new(OcclusionTest::new(
                occlusion_grid(mesh),
                0.0,
                clusters.largest_error_mm(),
            ));
            let refine = ClusterLod::new(Arc::clone(clusters), DEFAULT_SHADING_RAD);
            let refine = Box::new(refine.with_occlusion(Arc::clone(&outside)));
            let count = (clusters.clusters().len() as u32).min(MAX_PAGES);
            let pages = r.open_pages(gpu, count, *radius).unwrap();
            r.hide(pages, outside);
            let tolerance = Tolerance { pixels: TAU };
            let worker = Worker::spawn(refine, tolerance, count, 4 << 20, 3).unwrap();
            (Scene::paged(pages, None), Some(worker))
        }
    };
    let (mut ms, mut stats, mut pictures) = (Vec::new(), Vec::new(), Vec::new());
    let mut sequence = FrameSequence::new(scene, shots.to_vec(), worker);
    let mut since = Instant::now();
    while let Some((rgb, of_frame)) = sequence.next_frame(&mut r, gpu).unwrap() {
        ms.push(since.elapsed().as_secs_f64() * 1e3);
        if stats.len().is_multiple_of(10) {
            pictures.push(rgb);
        }
        stats.push(of_frame);
        since = Instant::now();
    }
    Flown { ms, stats, pictures }
}

/// Frame times and triangles with level of detail and without.
pub fn frame_times_with_and_without_level_of_detail() {
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    for name in ["colon_62k", "colon_250k", "colon_1m", "vessel_143k", "trachea_96k"] {
        let Some((mesh, axis)) = fly::named(name) else { continue };
        println!("{name}: {} faces", mesh.faces.len());
        let lod = clusters(&mesh);
        let lens = fly::lens(90.0);
        let shot = |pose| Shot { view: View::Inside, pose, lens, progress: 0.0, room_mm: None };
        let shots: Vec<Shot> = fly::poses(&axis, 100).into_iter().map(shot).collect();
        for samples in [1, 4] {
            let on = fly(&mut gpu, samples, &shots, &mesh, Some(&lod));
            let off = fly(&mut gpu, samples, &shots, &mesh, None);
            let apart: Vec<f64> = on
                .pictures
                .iter()
                .zip(&off.pictures)
                .map(|(a, b)| {
                    let sum: u64 = a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
                    sum as f64 / a.len() as f64
                })
                .collect();
            let of = |f: &Flown, g: fn(&FrameStats) -> u64| {
                let mut all: Vec<u64> = f.stats.iter().map(g).collect();
                all.sort_unstable();
                (all[all.len() / 2], all[all.len() * 99 / 100])
            };
            let mean = apart.iter().sum::<f64>() / apart.len() as f64;
            let (on_ms, off_ms) = (median(on.ms.clone()), median(off.ms.clone()));
            println!(
                "  {samples}x: on {on_ms:.1} ms ({:.1}/s), off {off_ms:.1} ms ({:.1}/s); \
                 triangles {:?}, uploaded {:?}, leaves {:?}, degraded {}; \
                 pictures apart {mean:.4} of 255 in the mean",
                1e3 / on_ms,
                1e3 / off_ms,
                of(&on, |s| s.triangles),
                of(&on, |s| s.uploaded_bytes),
                of(&on, |s| s.leaves_changed),
                on.stats.iter().filter(|s| s.degraded).count(),
            );
        }
    }
}

/// The same organ at 1, 4, 16 and, as far as they are there, 64 and 256 times the triangles, flown
/// through in turns.
pub fn growth_of_the_frame_time() {
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    let names = ["colon_62k", "colon_250k", "colon_1m", "colon_4m", "colon_16m"];
    let named = names.into_iter().map_while(fly::named);
    let all: Vec<_> = named
        .map(|(mesh, axis)| {
            let shot = |pose| Shot {
                view: View::Inside,
                pose,
                lens: fly::lens(90.0),
                progress: 0.0,
                room_mm: None,
            };
            let shots: Vec<Shot> = fly::poses(&axis, 100).into_iter().map(shot).collect();
            (clusters(&mesh), mesh, shots)
        })
        .collect();
    for samples in [1, 4] {
        let mut ms = vec![Vec::new(); all.len()];
        for _ in 0..5 {
            for ((lod, mesh, shots), ms) in all.iter().zip(&mut ms) {
                ms.push(median(fly(&mut gpu, samples, shots, mesh, Some(lod)).ms));
            }
        }
        let ms: Vec<f64> = ms.into_iter().map(median).collect();
        let grown = |ms: &[f64]| ms.windows(3).map(|m| m[2] / m[0]).collect::<Vec<_>>();
        println!("{samples}x: {ms:.1?} ms; 16 times the triangles: {:.3?} times", grown(&ms));
        let off = all
            .iter()
            .map(|(_, mesh, shots)| median(fly(&mut gpu, samples, &shots[..20], mesh, None).ms));
        let off: Vec<f64> = off.collect();
        println!("  off: {off:.1?} ms; {:.3?} times", grown(&off));
    }
}

/// Share of pixels whose point lies within the bound on screen.
pub fn pixels_inside_the_bound() {
    for name in ["vessel_143k", "trachea_96k", "colon_250k"] {
        let Some((mesh, axis)) = fly::named(name) else { continue };
        let original = Cast::of(&mesh);
        let (clusters, _) = clusters(&mesh);
        for fov in [60.0, 90.0, 120.0] {
            let mut refine = ClusterLod::new(Arc::clone(&clusters), DEFAULT_SHADING_RAD);
            let cache = &mut PageCache::new(clusters.clusters().len() as u32, u32::MAX, 0);
            let mut pages = Pages::default();
            let (mut found, mut drawn) = (screen::Found::default(), Vec::new());
            for pose in fly::poses(&axis, 64) {
                let camera = Camera { pose, lens: fly::lens(fov), height_px: 180 };
                let tolerance = Tolerance { pixels: TAU };
                pages.settle(&mut refine as &mut dyn LodHierarchy, &camera, &tolerance, cache);
                let cut = pages.corners();
                drawn.push(cut.len() as f64);
                let one = screen::compare(&original, &Cast::new(cut), &camera, f64::from(TAU));
                found = found.and(one);
            }
            println!(
                "{name}, {fov} degrees: {:.5} % of {} pixels inside, {} holes, {} away, {} missed, \
                 {} depth; worst {:.3} px; {:.0} triangles in the whole cut; {:?}",
                100.0 * found.inside(),
                found.pixels,
                found.holes,
                found.away,
                found.missed,
                found.depth,
                found.worst_px,
                median(drawn),
                found.listed
            );
            assert!(found.inside() >= 0.9999);
        }
    }
}
