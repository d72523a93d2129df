//! What drawing a large wall costs: `colon_1m.ply` in pages, with its centerline in `colon_1m.json`.

use std::time::Instant;

use common::sections::whole;
use glam::Vec3;
use intima::formats::{Space, read_mesh};
use intima::geometry::{Cone, Lens, Mesh, Pose, Sphere};
use intima::lod::{LodStep, VisiblePatch};
use intima::render::{Renderer, Scene, SceneWall, Shot, View};
use intima::surface::shading;
use intima::vk::{Gpu, Validate};

fn wall() -> Option<(Mesh, Vec<Shot>)> {
    let folder = std::path::PathBuf::from(std::env::var_os("INTIMA_MESHES")?);
    let (mut mesh, _) = read_mesh(&folder.join("colon_1m.ply"), Some(Space::Lps)).unwrap();
    if mesh.volume_mm3() < 0.0 {
        mesh.faces.iter_mut().for_each(|f| f.swap(1, 2));
        mesh.normals.iter_mut().for_each(|n| *n = -*n);
    }
    // Neighbours next to each other: along a Morton curve.
    let (low, high) = mesh.bounds().unwrap();
    let cell = (high - low).max_element() / 1023.0;
    let code = |f: &[u32; 3]| -> u64 {
        let at = f.map(|v| mesh.positions[v as usize]).iter().sum::<Vec3>() / 3.0;
        let q = ((at - low) / cell).to_array().map(|v| v as u64);
        (0..30).map(|bit| (q[bit % 3] >> (bit / 3) & 1) << bit).sum()
    };
    mesh.faces.sort_by_cached_key(code);
    let json = std::fs::read_to_string(folder.join("colon_1m.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let points: Vec<Vec3> = json["branches"][0]["points"]
        .as_array()
        .unwrap()
        .iter()
        .map(|p| Vec3::from_array([0, 1, 2].map(|k| p[k].as_f64().unwrap() as f32)))
        .collect();
    let shots = (0..24).map(|i| {
        let at = 60 + i * (points.len() - 180) / 24;
        let pose = Pose::looking(points[at], points[at + 30] - points[at], Vec3::Y);
        let lens = Lens { fov_y_rad: 90f32.to_radians(), aspect: 16.0 / 9.0, near_mm: 0.3 };
        Shot { view: View::Inside, pose, lens, progress: 0.0, room_mm: None }
    });
    Some((mesh, shots.collect()))
}

/// Frames one by one; prints milliseconds, and what the frame of the middle size took.
fn time(
    gpu: &mut Gpu,
    r: &mut Renderer,
    name: &str,
    scene: &Scene,
    shots: &[Shot],
) -> Vec<Vec<u8>> {
    let mut ms = Vec::new();
    let (mut stats, mut frames) = (Vec::new(), Vec::new());
    r.render(gpu, scene, &shots[0]).unwrap();
    for shot in shots {
        let start = Instant::now();
        let ticket = r.begin_frame(gpu, scene, shot).unwrap();
        let begun = start.elapsed();
        stats.push((ticket.stats.triangles, ticket.stats.draws, begun));
        frames.push(r.fetch(gpu, ticket).unwrap());
        ms.push(start.elapsed().as_secs_f64() * 1e3);
    }
    ms.sort_by(f64::total_cmp);
    stats.sort();
    let (triangles, draws, begun) = stats[stats.len() / 2];
    let (p50, worst) = (ms[ms.len() / 2], ms[ms.len() - 1]);
    println!(
        "{name:44} {p50:8.1} ms p50 {worst:8.1} max; {triangles:8} triangles {draws:5} draws, \
         host {:.2} ms",
        begun.as_secs_f64() * 1e3
    );
    frames
}

/// Milliseconds a frame in pages and in one piece.
pub fn pages_against_one_mesh() {
    let Some((mesh, shots)) = wall() else { return };
    let step = whole(&mesh, 128);
    println!("{} faces, {} pages", mesh.faces.len(), step.drawn.len());
    let everything = LodStep {
        drawn: step
            .drawn
            .iter()
            .map(|d| VisiblePatch {
                sphere: Sphere { radius: 1e6, ..d.sphere },
                half: Vec3::splat(1e6),
                cone: Cone::default(),
                ..*d
            })
            .collect(),
        ..step.clone()
    };
    let radius = shading(&mesh).mean_radius_mm;
    for (samples, at_once) in [(1, u32::MAX), (1, 1), (4, u32::MAX)] {
        let Some(mut gpu) = common::few_draws_gpu(at_once, Validate::Off) else { return };
        println!("{}: {samples} samples, {at_once} draws at once", gpu.info().name);
        let mut r = Renderer::new(&mut gpu, 1280, 720, samples).unwrap();
        let plain = Scene::of(r.upload_mesh(&mut gpu, &mesh, false).unwrap());
        let want = time(&mut gpu, &mut r, "one draw", &plain, &shots);
        let pages = r.open_pages(&mut gpu, step.drawn.len() as u32, radius).unwrap();
        let mut all = |name: &str, step: &LodStep, backs: bool| {
            r.apply(pages, step.clone()).unwrap();
            let scene = Scene { wall: SceneWall::Pages { pages, backs }, ..plain };
            let got = time(&mut gpu, &mut r, name, &scene, &shots);
            let off = |(a, b): (&Vec<u8>, &Vec<u8>)| {
                a.chunks_exact(3).zip(b.chunks_exact(3)).filter(|(a, b)| a != b).count()
            };
            let pixels: usize = got.iter().zip(&want).map(off).sum();
            println!("{:44} {pixels} pixels of {} frames differ", "", got.len());
        };
        all("pages, all submitted", &everything, true);
        all("pages in the frustum", &step, true);
        all("pages in the frustum that face the eye", &step, false);
    }
}
