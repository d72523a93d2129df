//! Drawn walls, occlusion test and culling against ray casting on a folded colon.
//!
//! No exceptions are allowed, so each check is one that correct bounds can never fail:
//! - The ray of a pixel hits the visible part where it hits the whole wall that is drawn: culling and
//!   the occlusion test reject nothing that a ray hits first.
//! - The point that the ray hits on the drawn wall has a point of the full mesh within the pixel error,
//!   or within the distance of the finest surface.
//! - The point that the ray hits on the full mesh has a point of the drawn wall as near, and the ray
//!   through that point hits the visible part there or before.

use std::sync::{Arc, LazyLock};

use common::cast::Cast;
#[cfg(feature = "faults")]
use common::child;
use glam::{DVec3, Vec3};
use intima::geometry::{Camera, Lens, Mesh, Pose, TriangleBvh, Vertex};
use intima::lod::ExteriorGrid;
use intima::lod::vds::{ParameterizedOriginal, SubdividedWall, SubdivisionSurface, VdsOptions};
use intima::lod::{CulledWall, DrawnWall, FaceOctree, OcclusionTest, Tolerance, occlusion_grid};
use intima::lumen::{IntensitySelection, SegmentationOptions};
use intima::mesh::{Parameterization, SimplifyOptions, simplify};
use intima::surface::{Midpoint, Surface, shading};
use intima::volume::phantom::{Kind, Phantom};

/// Pixel errors, from finer than a pixel to coarse.
const PIXEL_ERRORS: [f32; 3] = [0.5, 2.0, 8.0];
/// Rays of each view.
const RAYS: usize = 800;
/// Share of the largest inscribed ball by which eyes are off the axis.
const OFF_AXIS: [f32; 3] = [0.0, 0.4, 0.7];

struct Colon {
    mesh: Mesh,
    surface: Arc<SubdivisionSurface>,
    grid: Arc<ExteriorGrid>,
    full: Cast,
    cameras: Vec<Camera>,
}

fn random(seed: &mut u64) -> f64 {
    *seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
    (*seed >> 40) as f64 / (1u64 << 24) as f64
}

static COLON: LazyLock<Colon> = LazyLock::new(|| {
    let phantom = Phantom::new(Kind::Colon, 160, [1.0; 3]).unwrap();
    let (lumen, _) = SegmentationOptions::new(IntensitySelection::Labels(vec![1]))
        .apply(&phantom.mask())
        .unwrap();
    let mesh = Surface::new(&lumen, &Midpoint, None).mesh;
    let vertices = shading(&mesh).vertices;
    let mut maps = Parameterization::new(&mesh).unwrap();
    let options = SimplifyOptions {
        relocate: false,
        max_error_mm: Some(1.0),
        ..SimplifyOptions::to_faces(mesh.faces.len() / 80)
    };
    let base = simplify(&mesh, &options, &mut maps).unwrap();
    let tree = TriangleBvh::new(&mesh);
    let original = ParameterizedOriginal::new(&mesh, &vertices, &tree, &base, &maps);
    // By distance alone: shading would keep the steps of a mask at their finest.
    let options =
        VdsOptions { finest_mm: 0.1, shading_rad: f32::INFINITY, ..VdsOptions::default() };
    let surface = Arc::new(SubdivisionSurface::new(&base.mesh, &original, options).unwrap());
    let grid = Arc::new(occlusion_grid(&mesh));
    let axis = &phantom.truth().branches[0].points;
    let point = |i: usize| DVec3::new(axis[i][0], axis[i][1], axis[i][2]).as_vec3();
    let seed = &mut 17;
    let cameras = (1..25).map(|k| {
        let i = k * (axis.len() - 1) / 26;
        let ahead = (point(i + axis.len() / 60) - point(i)).normalize();
        // Off the axis, and turned towards the wall by up to a right angle.
        let (u, v) = ahead.any_orthonormal_pair();
        let turn = std::f64::consts::TAU * random(seed);
        let side = u * turn.cos() as f32 + v * turn.sin() as f32;
        let eye = point(i) + side * OFF_AXIS[k % 3] * axis[i][3] as f32;
        let forward = if k % 2 == 0 { ahead } else { -ahead };
        let tilt = 1.2 * (random(seed) as f32 - 0.5);
        let pose = Pose::looking(eye, forward + side.cross(ahead) * tilt, Vec3::Z);
        let lens = Lens { fov_y_rad: 1.5, aspect: 4.0 / 3.0, near_mm: 0.2 };
        Camera { pose, lens, height_px: 240 }
    });
    let (full, cameras) = (Cast::of(&mesh), cameras.collect());
    Colon { mesh, surface, grid, full, cameras }
});

/// What failed, by check, and what was compared.
#[derive(Debug, Default)]
struct Found {
    rays: usize,
    /// Rays that miss the full mesh or the cut.
    holes: usize,
    /// Rays that hit the whole cut before the visible patches.
    culled: usize,
    /// Points of the cut without a point of the full mesh within the pixel error.
    away: usize,
    /// Points of the full mesh without a point of the cut within the pixel error.
    missed: usize,
    /// Points of the full mesh whose point of the cut is behind what is visible.
    hidden: usize,
    /// Rays whose first hits are at nearly the same depth.
    same_depth: usize,
    worst_px: f64,
    drawn_share: f64,
}

impl Found {
    fn violations(&self) -> usize {
        self.holes + self.culled + self.away + self.missed + self.hidden
    }
}

/// A wall as it is drawn, and its largest distance from the full mesh at the finest.
struct Drawn<'a> {
    wall: &'a dyn DrawnWall,
    /// Triangles of the whole wall for a camera, and of the part that the camera sees.
    triangles: &'a dyn Fn(&Camera) -> [Vec<[DVec3; 3]>; 2],
    finest_mm: f64,
}

fn corners(triangles: &[[Vertex; 3]]) -> Vec<[DVec3; 3]> {
    triangles.iter().map(|t| t.map(|v| v.position().as_dvec3())).collect()
}

/// Casts random rays of one view at the full mesh, the drawn wall, and its visible part.
fn view(colon: &Colon, drawn: &Drawn<'_>, camera: &Camera, pixels: f32, found: &mut Found) {
    let [whole, visible] = (drawn.triangles)(camera);
    assert_eq!(visible.len() as u64, drawn.wall.visible(camera).triangles());
    found.drawn_share += visible.len() as f64 / colon.mesh.faces.len() as f64;
    let (visible, whole) = (Cast::new(visible), Cast::new(whole));
    let eye = camera.pose.position_mm.as_dvec3();
    let world = camera.pose.rotation.as_dquat().normalize();
    let height = f64::from(camera.height_px);
    let width = height * f64::from(camera.lens.aspect);
    let focal = height / (2.0 * (0.5 * f64::from(camera.lens.fov_y_rad)).tan());
    let tau = f64::from(pixels) + 1e-3;
    let pixel_distance = |p: DVec3, q: DVec3| {
        let [p, q] = [p, q].map(|p| world.inverse() * (p - eye));
        (p.truncate() / p.z).distance(q.truncate() / q.z) * focal
    };
    let seed = &mut 5;
    for _ in 0..RAYS {
        // So far inside the picture that what is within the pixel error is in it, too.
        let mut at = |size: f64| (random(seed) - 0.5) * (size - 2.0 * (tau + 1.0)) / focal;
        let along = world * DVec3::new(at(width), at(height), -1.0);
        found.rays += 1;
        let (Some(h), Some(w)) = (colon.full.ray(eye, along), whole.ray(eye, along)) else {
            found.holes += 1;
            continue;
        };
        let Some(d) = visible.ray(eye, along).filter(|d| d.t <= w.t * (1.0 + 1e-9)) else {
            found.culled += 1;
            continue;
        };
        found.same_depth += usize::from((h.t - d.t).abs() < 0.05 * h.t);
        let (q, _) = colon.full.nearest(d.point).unwrap();
        let (c, _) = whole.nearest(h.point).unwrap();
        let (there, back) = (pixel_distance(d.point, q), pixel_distance(h.point, c));
        let is_far = |px: f64, p: DVec3, q: DVec3| {
            px > tau && p.distance(q) > drawn.finest_mm * (1.0 + 1e-6) + 1e-6
        };
        found.worst_px = found.worst_px.max((there.max(back)) / f64::from(pixels));
        found.away += usize::from(is_far(there, d.point, q));
        found.missed += usize::from(is_far(back, h.point, c));
        let seen = visible.ray(eye, c - eye);
        found.hidden += usize::from(seen.is_none_or(|s| s.t > 1.0 + 1e-6));
    }
}

fn all_views(colon: &Colon, drawn: &Drawn<'_>, pixels: f32) -> Found {
    let mut found = Found::default();
    for camera in &colon.cameras {
        view(colon, drawn, camera, pixels, &mut found);
    }
    found.drawn_share /= colon.cameras.len() as f64;
    found
}

/// The whole mesh, less what cameras cannot see.
fn culled(colon: &Colon) -> Found {
    let octree = Arc::new(FaceOctree::new(&colon.mesh));
    let closed = Some(Arc::new(OcclusionTest::of_wall(Arc::clone(&colon.grid))));
    let indices = octree.indices(&colon.mesh.faces);
    let wall = CulledWall { octree, closed };
    let triangle = |t: &[u32]| [0, 1, 2].map(|c| colon.mesh.positions[t[c] as usize].as_dvec3());
    let triangles = |camera: &Camera| {
        let part = |r: &intima::lod::DrawnRange| {
            let first = r.first_index as usize;
            &indices[first..first + r.indices as usize]
        };
        let ranges = wall.visible(camera).ranges;
        let seen = ranges.iter().flat_map(|r| part(r).chunks(3).map(triangle));
        [indices.chunks(3).map(triangle).collect(), seen.collect()]
    };
    let drawn = Drawn { wall: &wall, triangles: &triangles, finest_mm: 0.0 };
    all_views(colon, &drawn, 0.01)
}

/// The subdivision at a pixel error.
fn subdivided(colon: &Colon, pixels: f32) -> Found {
    let test = colon.surface.occlusion_test(Arc::clone(&colon.grid), &colon.mesh);
    let tolerance = Tolerance { pixels };
    let wall = SubdividedWall::new(Arc::clone(&colon.surface), tolerance, Some(Arc::new(test)));
    let triangles = |camera: &Camera| {
        let cut = wall.cut(camera);
        let of = |d| corners(&colon.surface.patches().triangles(d));
        let seen = cut.iter().filter(|d| d.is_seen).flat_map(of).collect();
        [cut.iter().flat_map(of).collect(), seen]
    };
    let finest_mm = f64::from(colon.surface.finest_error_mm());
    all_views(colon, &Drawn { wall: &wall, triangles: &triangles, finest_mm }, pixels)
}

#[test]
fn rays_into_a_folded_colon_hit_the_visible_wall_within_the_pixel_error() {
    let colon = &*COLON;
    for camera in &colon.cameras {
        let eye = camera.pose.position_mm.as_dvec3();
        let clearance = colon.full.nearest(eye).unwrap().1;
        assert!(clearance > 0.5, "an eye is {clearance} mm from the wall");
    }
    let found = culled(colon);
    println!("culled: {found:?}");
    assert_eq!(found.violations(), 0, "{found:?}");
    assert!(found.drawn_share < 0.2, "{found:?}");
    let mut shares = Vec::new();
    for pixels in PIXEL_ERRORS {
        let found = subdivided(colon, pixels);
        println!("{pixels} px: {found:?}, finest {} mm", colon.surface.finest_error_mm());
        assert_eq!(found.violations(), 0, "{pixels} px: {found:?}");
        // The comparison is of the same walls, and the cut is coarser than the mesh.
        assert!(found.same_depth * 2 > found.rays, "{found:?}");
        shares.push(found.drawn_share);
    }
    assert!(shares[2] < 0.8 * shares[0], "{shares:?} of the faces are drawn");
}

/// Runs in a process of its own.
#[cfg(feature = "faults")]
fn child_counts_violations() {
    println!("child: {}", culled(&COLON).violations());
    for pixels in PIXEL_ERRORS {
        println!("child: {}", subdivided(&COLON, pixels).violations());
    }
}

/// Error bounds an eighth of what was measured, and an occlusion test that takes any exterior cell
/// between eye and centre for clear of the whole patch.
#[cfg(feature = "faults")]
#[test]
fn rays_detect_planted_faults_in_error_bound_and_occlusion() {
    if child::is_child() {
        return child_counts_violations();
    }
    for (fault, expected) in [("none:1", false), ("errorbound:1", true), ("occlusion:1", true)] {
        let said = child::said(&child::run(
            "lod_rays::rays_detect_planted_faults_in_error_bound_and_occlusion",
            &[("INTIMA_FAULT", fault)],
        ));
        let violations: usize = said.iter().map(|n| n.parse::<usize>().unwrap()).sum();
        println!("{fault}: {said:?} violations");
        assert_eq!(violations > 0, expected, "{fault}: {said:?}");
    }
}
