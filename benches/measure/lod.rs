//! Level of detail on large meshes: frame times and errors on screen.

use std::sync::Arc;
use std::time::Instant;

use common::cast::Cast;
use common::{fly, screen};
use intima::geometry::{Camera, Mesh, TriangleBvh};
use intima::lod::refined::{RefinedWall, RefinedWallInput};
use intima::lod::vds::{SubdividedWall, VdsOptions};
use intima::lod::{CulledWall, DrawnWall, FaceOctree, OcclusionTest, Tolerance, occlusion_grid};
use intima::mesh::SimplifyOptions;
use intima::render::{FrameSequence, FrameStats, PreparedMesh, Renderer, Scene, Shot, View};
use intima::session::{Clock, Levels, WallForm};
use intima::surface::{Shading, shading};
use intima::vk::{Gpu, Validate};

const SIZE: [u32; 2] = [1280, 720];
const TAU: f32 = 1.0;

fn median(mut v: Vec<f64>) -> f64 {
    v.sort_by(f64::total_cmp);
    v.get(v.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Forms in which a wall is drawn.
struct Forms {
    whole: PreparedMesh,
    culled: PreparedMesh,
    subdivided: Option<PreparedMesh>,
}

impl Forms {
    fn of(mesh: &Mesh) -> Self {
        let shading = Arc::new(shading(mesh));
        let start = Instant::now();
        let octree = Arc::new(FaceOctree::new(mesh));
        let closed = Some(Arc::new(OcclusionTest::of_wall(occlusion_grid(mesh))));
        println!("  octree and exterior: {:.2} s", start.elapsed().as_secs_f64());
        let wall = Arc::new(CulledWall { octree, closed });
        let radius = shading.mean_radius_mm;
        let start = Instant::now();
        let subdivided = subdivided(mesh, &shading);
        println!("  subdivision: {:.2} s", start.elapsed().as_secs_f64());
        if let Err(why) = &subdivided {
            println!("  no subdivision: {why}");
        }
        Self {
            whole: PreparedMesh::shaded(mesh, Arc::clone(&shading)).unwrap(),
            culled: PreparedMesh::culled(mesh, shading, wall).unwrap(),
            subdivided: subdivided.ok().map(|wall| PreparedMesh::subdivided(wall, radius)),
        }
    }

    fn named(&self) -> impl Iterator<Item = (&'static str, &PreparedMesh)> {
        let all = [("off", &self.whole), ("culled", &self.culled)];
        all.into_iter().chain(self.subdivided.as_ref().map(|wall| ("vds", wall)))
    }
}

/// A mesh that is refined by its normals.
fn refined(mesh: &Mesh, shading: &Shading) -> RefinedWall {
    RefinedWall::new(RefinedWallInput {
        mesh,
        shading,
        is_fixed: vec![false; mesh.positions.len()],
        smooth: None,
        exterior: Some(Arc::new(occlusion_grid(mesh))),
        reach_mm: 0.0,
        tolerance: Tolerance { pixels: TAU },
    })
}

fn subdivided(mesh: &Mesh, shading: &Shading) -> Result<Arc<SubdividedWall>, String> {
    let base = SimplifyOptions {
        max_error_mm: Some(1.0),
        ..SimplifyOptions::to_faces((mesh.faces.len() / 80).max(500))
    };
    let options = VdsOptions { finest_mm: 0.1, ..VdsOptions::default() };
    let (tree, clock) = (TriangleBvh::new(mesh), &mut Clock::default());
    let made = Levels::of_subdivision(mesh, &shading.vertices, &tree, base, options, TAU, clock);
    let levels = made.map_err(|e| e.to_string())?;
    match levels.with_occlusion(Some(Arc::new(occlusion_grid(mesh))), mesh).form {
        WallForm::Subdivided(wall) => Ok(wall),
        _ => unreachable!("a subdivision"),
    }
}

struct Flown {
    ms: Vec<f64>,
    stats: Vec<FrameStats>,
}

fn fly(gpu: &mut Gpu, samples: u32, shots: &[Shot], wall: &PreparedMesh) -> Flown {
    let mut r = Renderer::new(gpu, SIZE[0], SIZE[1], samples).unwrap();
    let scene = Scene::with(r.upload_prepared_mesh(gpu, wall).unwrap(), None);
    let (mut ms, mut stats) = (Vec::new(), Vec::new());
    let mut sequence = FrameSequence::new(scene, shots.to_vec());
    let mut since = Instant::now();
    while let Some((_, of_frame)) = sequence.next_frame(&mut r, gpu).unwrap() {
        ms.push(since.elapsed().as_secs_f64() * 1e3);
        stats.push(of_frame);
        since = Instant::now();
    }
    Flown { ms, stats }
}

fn shots(axis: &[glam::DVec3]) -> Vec<Shot> {
    let lens = fly::lens(90.0);
    let shot = |pose| Shot { view: View::Inside, pose, lens, progress: 0.0, room_mm: None };
    fly::poses(axis, 100).into_iter().map(shot).collect()
}

/// Frame times and triangles of each form.
pub fn frame_times_of_each_form() {
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    for name in ["colon_62k", "colon_250k", "colon_1m", "vessel_143k", "trachea_96k", "torus_20m"] {
        let Some((mesh, axis)) = fly::named(name) else { continue };
        println!("{name}: {} faces", mesh.faces.len());
        let (forms, shots) = (Forms::of(&mesh), shots(&axis));
        for samples in [1, 4] {
            for (form, wall) in forms.named() {
                let flown = fly(&mut gpu, samples, &shots, wall);
                let mut triangles: Vec<u64> = flown.stats.iter().map(|s| s.triangles).collect();
                triangles.sort_unstable();
                let ms = median(flown.ms);
                println!(
                    "  {samples}x {form}: {ms:.1} ms ({:.1}/s), triangles {} in the median",
                    1e3 / ms,
                    triangles[triangles.len() / 2]
                );
            }
        }
    }
}

/// Time of one thread to find what a camera sees of each form.
pub fn times_of_the_cut() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for name in ["colon_label_1", "airway_label_lidc1", "colon_62k"] {
        let Some((mesh, axis)) = fly::named(name) else { continue };
        let octree = Arc::new(FaceOctree::new(&mesh));
        let closed = Some(Arc::new(OcclusionTest::of_wall(occlusion_grid(&mesh))));
        let culled = CulledWall { octree, closed };
        let shading = shading(&mesh);
        let refined = refined(&mesh, &shading);
        let subdivided = subdivided(&mesh, &shading).unwrap();
        let walls: [(&str, &(dyn DrawnWall + Sync)); 3] =
            [("culled", &culled), ("refined", &refined), ("vds", &*subdivided)];
        for (form, wall) in walls {
            let (mut ms, mut triangles) = (Vec::new(), 0);
            for pose in fly::poses(&axis, 100) {
                let camera = Camera { pose, lens: fly::lens(90.0), height_px: 360 };
                triangles += wall.visible(&camera).triangles() / 100;
                let rounds = (0..5).map(|_| {
                    let start = Instant::now();
                    pool.install(|| std::hint::black_box(wall.visible(&camera)));
                    start.elapsed().as_secs_f64() * 1e3
                });
                ms.push(median(rounds.collect()));
            }
            let mean = ms.iter().sum::<f64>() / ms.len() as f64;
            println!(
                "{name}, {form}: {mean:.2} ms, {triangles} triangles in the mean of 100 frames"
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
    let all: Vec<_> = named.map(|(mesh, axis)| (Forms::of(&mesh), shots(&axis))).collect();
    for samples in [1, 4] {
        for form in ["off", "culled", "vds"] {
            let mut ms = vec![Vec::new(); all.len()];
            for _ in 0..5 {
                for ((forms, shots), ms) in all.iter().zip(&mut ms) {
                    let wall = forms.named().find(|(name, _)| *name == form);
                    let flown = wall.map(|(_, wall)| fly(&mut gpu, samples, shots, wall));
                    ms.push(flown.map_or(f64::NAN, |flown| median(flown.ms)));
                }
            }
            let ms: Vec<f64> = ms.into_iter().map(median).collect();
            let grown: Vec<f64> = ms.windows(3).map(|m| m[2] / m[0]).collect();
            println!("{samples}x {form}: {ms:.1?} ms; 16 times the triangles: {grown:.3?} times");
        }
    }
}

/// Share of pixels whose point lies within the bound on screen.
pub fn pixels_inside_the_bound() {
    for name in ["colon_label_1", "colon_label_2", "airway_label_lidc1"] {
        let Some((mesh, axis)) = fly::named(name) else { continue };
        let original = Cast::of(&mesh);
        let wall = subdivided(&mesh, &shading(&mesh)).unwrap();
        for fov in [60.0, 90.0, 120.0] {
            let (mut found, mut drawn) = (screen::Found::default(), Vec::new());
            for pose in fly::poses(&axis, 64) {
                let camera = Camera { pose, lens: fly::lens(fov), height_px: 180 };
                let cut = wall.cut(&camera);
                let cut = cut.iter().flat_map(|d| wall.surface().patches().triangles(d));
                let cut: Vec<_> = cut.map(|t| t.map(|v| v.position().as_dvec3())).collect();
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
        }
    }
}
