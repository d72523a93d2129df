//! The paper's Figs. 12 and 13 with organs of ours: a trachea of 26,979 faces on 1,500, a colon of
//! 30,720 on 8,000. Pictures to look at, of `airway.ply` and `colon.ply`, in `INTIMA_OUT`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use common::fly;
use glam::Vec3;
use intima::formats::write_png;
use intima::geometry::{Camera, Mesh, Pose, TriangleBvh};
use intima::lod::Tolerance;
use intima::lod::vds::{ParameterizedOriginal, SubdividedWall, SubdivisionSurface, VdsOptions};
use intima::mesh::{Parameterization, SimplifyOptions, simplify};
use intima::render::{PreparedMesh, Renderer, Scene, Shot, View};
use intima::surface::shading;
use intima::vk::Validate;

const SIZE: [u32; 2] = [960, 540];
const OVERVIEW: u32 = 900;

/// A mesh seen along y, its front faces with their edges; the camera as a dot.
fn overview(path: &Path, triangles: &[[Vec3; 3]], camera: Vec3) {
    let all = triangles.iter().flatten();
    let (lo, hi) =
        all.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
    let per = 0.95 * OVERVIEW as f32 / (hi - lo).x.max((hi - lo).z);
    let place = |p: Vec3| {
        let q = (p - 0.5 * (lo + hi)) * per;
        Vec3::new(0.5 * OVERVIEW as f32 + q.x, 0.5 * OVERVIEW as f32 - q.z, q.y)
    };
    let mut depth = vec![f32::INFINITY; (OVERVIEW * OVERVIEW) as usize];
    let mut rgb = vec![255u8; 3 * depth.len()];
    for t in triangles {
        let [a, b, c] = t.map(place);
        let area = (b - a).truncate().perp_dot((c - a).truncate());
        let facing = (t[1] - t[0]).cross(t[2] - t[0]).normalize_or_zero().y.abs();
        let (low, high) = (a.min(b).min(c).floor(), a.max(b).max(c).ceil());
        for (x, y) in (low.x as i32..high.x as i32)
            .flat_map(|x| (low.y as i32..high.y as i32).map(move |y| (x, y)))
        {
            let p = glam::Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
            let weight = |u: Vec3, v: Vec3| (u.truncate() - p).perp_dot(v.truncate() - p) / area;
            let w = [weight(b, c), weight(c, a), weight(a, b)];
            if area == 0.0 || w.iter().any(|w| *w < 0.0) {
                continue;
            }
            let z = w[0] * a.z + w[1] * b.z + w[2] * c.z;
            let at = y as usize * OVERVIEW as usize + x as usize;
            if z >= depth[at] {
                continue;
            }
            depth[at] = z;
            // Distance to each edge in pixels: area over length.
            let edges = [(b, c), (c, a), (a, b)];
            let near = (0..3).any(|i| {
                let length = (edges[i].1 - edges[i].0).truncate().length();
                w[i] * area.abs() / length < 0.5
            });
            let grey = if near { 30 } else { (120.0 + 120.0 * facing) as u8 };
            rgb[3 * at..3 * at + 3].fill(grey);
        }
    }
    let eye = place(camera);
    for (dx, dy) in (-5..=5).flat_map(|x| (-5..=5).map(move |y| (x, y))) {
        let at = (eye.y as i32 + dy) * OVERVIEW as i32 + eye.x as i32 + dx;
        if dx * dx + dy * dy <= 25 {
            rgb[3 * at as usize..3 * at as usize + 3].copy_from_slice(&[220, 30, 30]);
        }
    }
    write_png(path, OVERVIEW, OVERVIEW, &rgb).unwrap();
}

fn corners(mesh: &Mesh) -> Vec<[Vec3; 3]> {
    mesh.faces.iter().map(|f| f.map(|v| mesh.positions[v as usize])).collect()
}

/// Draws them.
pub fn trachea_and_colon_as_in_the_papers_figures() {
    let out = PathBuf::from(std::env::var_os("INTIMA_OUT").expect("INTIMA_OUT names a folder"));
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    let mut r = Renderer::new(&mut gpu, SIZE[0], SIZE[1], 4).unwrap();
    for (name, faces, at, bounds) in
        [("airway", 1500, 0.35, [16.0, 4.0]), ("colon", 8000, 0.62, [0.5, 0.2])]
    {
        let (mesh, axis) = fly::named(name).expect("the meshes");
        let pose: Pose = fly::poses(&axis, 101)[(at * 100.0) as usize];
        let shot =
            Shot { view: View::Inside, pose, lens: fly::lens(90.0), progress: at, room_mm: None };
        let mut maps = Parameterization::new(&mesh).unwrap();
        let base = simplify(&mesh, &SimplifyOptions::to_faces(faces), &mut maps).unwrap();
        let shaded = shading(&mesh);
        let tree = TriangleBvh::new(&mesh);
        let original = ParameterizedOriginal::new(&mesh, &shaded.vertices, &tree, &base, &maps);
        let options = VdsOptions::default();
        let surface = Arc::new(SubdivisionSurface::new(&base.mesh, &original, options).unwrap());
        println!(
            "{name}: {} patches, off by {:.3} mm at the base, {:.3} mm at the finest",
            surface.patches().patches(),
            surface.coarsest_error_mm(),
            surface.finest_error_mm()
        );
        let save = |tag: &str, rgb: &[u8], triangles: &[[Vec3; 3]]| {
            write_png(&out.join(format!("{name}_{tag}.png")), SIZE[0], SIZE[1], rgb).unwrap();
            overview(&out.join(format!("{name}_{tag}_over.png")), triangles, pose.position_mm);
            println!("{name} {tag}: {} faces", triangles.len());
        };
        for (tag, mesh) in [("a_original", &mesh), ("b_base", &base.mesh)] {
            let scene = Scene::of(r.upload_mesh(&mut gpu, mesh, false).unwrap());
            save(tag, &r.render(&mut gpu, &scene, &shot).unwrap(), &corners(mesh));
        }
        for (tag, pixels) in ["c_coarse", "d_fine"].into_iter().zip(bounds) {
            let tolerance = Tolerance { pixels };
            let wall = Arc::new(SubdividedWall::new(Arc::clone(&surface), tolerance, None));
            let camera = Camera { pose, lens: shot.lens, height_px: SIZE[1] };
            let cut = wall.cut(&camera);
            let triangles = cut.iter().flat_map(|d| surface.patches().triangles(d));
            let prepared = PreparedMesh::subdivided(Arc::clone(&wall), shaded.mean_radius_mm);
            let handle = r.upload_prepared_mesh(&mut gpu, &prepared).unwrap();
            let rgb = r.render(&mut gpu, &Scene::with(handle, None), &shot).unwrap();
            let corners: Vec<_> = triangles.map(|t| t.map(|v| v.position())).collect();
            save(tag, &rgb, &corners);
        }
    }
}
