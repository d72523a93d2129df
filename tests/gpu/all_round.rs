//! Everything about the eye in one picture: each pixel of the cube and of the panorama shows what lies
//! in its direction, by formulas of this test alone.

use std::f32::consts::{PI, TAU};

use glam::{Quat, Vec3};
use intima::geometry::{Lens, Mesh, Pose};
use intima::render::{PreparedMesh, Renderer, Scene, Shot, View};
use intima::vk::Validate;

/// A sphere about a place, seen from within; each vertex has the colour of the axis that it lies
/// nearest to.
fn coloured_sphere(centre: Vec3) -> (Mesh, Vec<[u8; 4]>) {
    const RINGS: u32 = 96;
    const SIDES: u32 = 192;
    let mut mesh = Mesh::default();
    for i in 0..=RINGS {
        let a = PI * i as f32 / RINGS as f32;
        for k in 0..SIDES {
            let b = TAU * k as f32 / SIDES as f32;
            let d = Vec3::new(a.sin() * b.cos(), a.sin() * b.sin(), a.cos());
            mesh.positions.push(centre + 20.0 * d);
        }
    }
    for i in 0..RINGS {
        for k in 0..SIDES {
            let l = (k + 1) % SIDES;
            let [a, b, c, d] =
                [i * SIDES + k, (i + 1) * SIDES + k, (i + 1) * SIDES + l, i * SIDES + l];
            mesh.faces.extend([[a, c, b], [a, d, c]]);
        }
    }
    let colours = mesh.positions.iter().map(|p| COLOURS[axis(*p - centre).0]).collect();
    (mesh, colours)
}

/// Red, green and blue for x, y and z, what is left of white for the other way.
const COLOURS: [[u8; 4]; 6] = [
    [255, 0, 0, 255],
    [0, 255, 0, 255],
    [0, 0, 255, 255],
    [0, 255, 255, 255],
    [255, 0, 255, 255],
    [255, 255, 0, 255],
];

/// The axis nearest to a direction, and how clearly: 0 where two are equally near.
fn axis(d: Vec3) -> (usize, f32) {
    let along = [d.x, d.y, d.z, -d.x, -d.y, -d.z];
    let mut order: Vec<usize> = (0..6).collect();
    order.sort_by(|a, b| along[*b].total_cmp(&along[*a]));
    (order[0], (along[order[0]] - along[order[1]]) / d.length())
}

/// Which of the colours a pixel has.
fn named(rgb: &[u8]) -> usize {
    // Highlights add white.
    let (least, most) = (rgb.iter().min().unwrap(), rgb.iter().max().unwrap());
    let on = |v: u8| 2 * u32::from(v) > u32::from(*least) + u32::from(*most);
    let bits = [on(rgb[0]), on(rgb[1]), on(rgb[2])];
    COLOURS.iter().position(|c| [c[0] > 0, c[1] > 0, c[2] > 0] == bits).unwrap_or(9)
}

/// The direction, in the eye's own axes, of a pixel of the unfolded cube.
fn in_cube(x: f32, y: f32, size: [u32; 2]) -> Option<Vec3> {
    let unit = (size[0] / 4).min(size[1] / 3) as f32;
    let left = ((size[0] as f32 - 4.0 * unit) / 2.0).floor();
    let top = ((size[1] as f32 - 3.0 * unit) / 2.0).floor();
    let (u, v) = ((x - left) / unit, (y - top) / unit);
    let (column, row) = (u.floor(), v.floor());
    let (p, q) = (2.0 * (u - column) - 1.0, 2.0 * (v - row) - 1.0);
    match (column as i32, row as i32) {
        (0, 1) => Some(Vec3::new(-1.0, -q, -p)),
        (1, 1) => Some(Vec3::new(p, -q, -1.0)),
        (2, 1) => Some(Vec3::new(1.0, -q, p)),
        (3, 1) => Some(Vec3::new(-p, -q, 1.0)),
        // Above the front: its lower edge is the front's upper one.
        (1, 0) => Some(Vec3::new(p, 1.0, -q)),
        (1, 2) => Some(Vec3::new(p, -1.0, q)),
        _ => None,
    }
}

/// The same of a panorama that fills the width.
fn in_panorama(x: f32, y: f32, size: [u32; 2]) -> Option<Vec3> {
    let height = size[0] as f32 / 2.0;
    let top = (size[1] as f32 - height) / 2.0;
    let (longitude, latitude) = ((x / size[0] as f32 - 0.5) * TAU, (0.5 - (y - top) / height) * PI);
    (latitude.abs() < 0.5 * PI).then(|| {
        let (s, c) = longitude.sin_cos();
        Vec3::new(s * latitude.cos(), latitude.sin(), -c * latitude.cos())
    })
}

#[test]
fn every_pixel_of_cube_and_panorama_shows_what_lies_in_its_direction() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let size = [400, 240];
    let centre = Vec3::new(5.0, -3.0, 40.0);
    let (mesh, colours) = coloured_sphere(centre);
    let mesh = PreparedMesh::new(&mesh).unwrap();
    let lens = Lens { fov_y_rad: 1.2, aspect: 1.5, near_mm: 0.5 };
    for samples in [1, 4] {
        let mut r = Renderer::new(&mut gpu, size[0], size[1], samples).unwrap();
        let wall = r.upload_coloured_mesh(&mut gpu, &mesh, &colours).unwrap();
        for (i, rotation) in [
            Quat::IDENTITY,
            Quat::from_rotation_x(1.5),
            Quat::from_scaled_axis(Vec3::new(0.7, -1.1, 2.0)),
        ]
        .into_iter()
        .enumerate()
        {
            type Direction = fn(f32, f32, [u32; 2]) -> Option<Vec3>;
            let views: [(View, Direction); 2] =
                [(View::Cube, in_cube), (View::Panorama, in_panorama)];
            for (view, direction) in views {
                let pose = Pose { position_mm: centre, rotation };
                let shot = Shot { view, pose, lens, progress: 0.0, room_mm: None };
                assert_eq!(r.cameras(&shot).len(), 6);
                let rgb = r.render(&mut gpu, &Scene::of(wall), &shot).unwrap();
                let (mut compared, mut empty) = (0, 0);
                for y in 0..size[1] {
                    for x in 0..size[0] {
                        let at = 3 * (y * size[0] + x) as usize;
                        let pixel = &rgb[at..at + 3];
                        let Some(d) = direction(x as f32 + 0.5, y as f32 + 0.5, size) else {
                            assert!(
                                pixel.iter().all(|v| *v < 30),
                                "{view:?} at {x}, {y}: {pixel:?}"
                            );
                            empty += 1;
                            continue;
                        };
                        let (wanted, margin) = axis(rotation * d);
                        if margin > 0.06 {
                            let got = named(pixel);
                            assert_eq!(got, wanted, "{view:?} {i} at {x}, {y}: {pixel:?}");
                            compared += 1;
                        }
                    }
                }
                assert!(compared > 30_000 && empty > 5_000, "{view:?}: {compared}, {empty}");
            }
        }
        // Other colours, from the next frame on.
        let white = vec![[0, 255, 0, 255]; colours.len()];
        r.recolour(&mut gpu, wall, &white).unwrap();
        let pose = Pose { position_mm: centre, rotation: Quat::IDENTITY };
        let shot = Shot { view: View::Inside, pose, lens, progress: 0.0, room_mm: None };
        let rgb = r.render(&mut gpu, &Scene::of(wall), &shot).unwrap();
        assert!(rgb.chunks(3).all(|p| named(p) == 1), "all of it is green");
        // In the overview too, whose glass is kept between frames.
        let over = Shot { view: View::Overview, ..shot };
        let green = r.render(&mut gpu, &Scene::of(wall), &over).unwrap();
        r.recolour(&mut gpu, wall, &colours).unwrap();
        assert_ne!(r.render(&mut gpu, &Scene::of(wall), &over).unwrap(), green);
    }
    let said = gpu.validation_messages();
    assert!(said.is_empty(), "{said:?}");
}

#[test]
fn the_opacity_of_the_overview_goes_from_nothing_over_glass_to_solid() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let (mesh, _) = coloured_sphere(Vec3::ZERO);
    let mut r = Renderer::new(&mut gpu, 120, 90, 4).unwrap();
    let wall = r.upload_mesh(&mut gpu, &mesh, false).unwrap();
    let pose = Pose { position_mm: Vec3::ZERO, rotation: Quat::IDENTITY };
    let lens = Lens { fov_y_rad: 1.2, aspect: 1.5, near_mm: 0.5 };
    let shot = Shot { view: View::Overview, pose, lens, progress: 0.0, room_mm: None };
    let mut draw = |opacity: f32| {
        let mut scene = Scene::of(wall);
        scene.look.opacity = opacity;
        r.render(&mut gpu, &scene, &shot).unwrap()
    };
    let (none, glass, solid) = (draw(0.0), draw(1.0), draw(2.0));
    let light = |rgb: &[u8]| rgb.iter().map(|v| u64::from(*v)).sum::<u64>();
    assert!(light(&none) < light(&glass) && light(&glass) < light(&solid));
    // The camera within is seen through nothing and through glass, and not through what is solid.
    let yellow = |rgb: &[u8]| rgb.chunks(3).filter(|p| p[0] > 120 && p[2] < p[0] / 3).count();
    assert!(yellow(&none) > 20 && yellow(&solid) == 0, "{} {}", yellow(&none), yellow(&solid));
}
