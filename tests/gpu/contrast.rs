//! Local contrast of inside views beside a twin in double precision, and views without it.

use common::cast::Cast;
use common::colour::{linear, srgb};
use glam::DVec3;
use intima::geometry::{Lens, Mesh, Pose};
use intima::lumen::IntensitySelection;
use intima::render::{Look, MeshHandle, Renderer, Scene, Shot, View};
use intima::session::{Session, Settings, Source, VolumeSource};
use intima::vk::{Gpu, Validate};
use intima::volume::phantom::{Kind, Phantom};

const SIZE: [u32; 2] = [162, 118];
const RAISE: f32 = 0.5;

/// The folded wall of a colon, and eyes on its axis.
fn colon() -> (Mesh, Vec<Pose>) {
    let phantom = Phantom::new(Kind::Colon, 96, [1.0; 3]).unwrap();
    let mut settings = Settings::default();
    settings.lumen.select = Some(IntensitySelection::Labels(vec![1]));
    let source = Source::Image(VolumeSource::Memory(std::sync::Arc::new(phantom.mask())));
    let session = Session::new(source, settings).unwrap();
    let flight = session.flight().unwrap();
    let poses = [0.2, 0.5, 0.8].map(|t| flight.poses[(t * 119.0) as usize]);
    (session.wall().unwrap().mesh.clone(), poses.to_vec())
}

fn lens() -> Lens {
    Lens { fov_y_rad: 1.3, aspect: SIZE[0] as f32 / SIZE[1] as f32, near_mm: 0.5 }
}

fn shot(pose: Pose, view: View) -> Shot {
    Shot { view, pose, lens: lens(), progress: 0.0, room_mm: Some(8.0) }
}

fn scene(mesh: MeshHandle, local_contrast: f32) -> Scene {
    Scene { look: Look { local_contrast, ..Look::default() }, ..Scene::of(mesh) }
}

fn rendered(gpu: &mut Gpu, r: &mut Renderer, scene: &Scene, pose: Pose, view: View) -> Vec<u8> {
    r.render(gpu, scene, &shot(pose, view)).unwrap()
}

fn luminance(rgb: &[u8]) -> f64 {
    [0.2126, 0.7152, 0.0722].iter().zip(rgb).map(|(w, b)| w * linear(*b)).sum()
}

/// Depth of each pixel's middle, mm along the view.
fn depths(wall: &Cast, pose: &Pose) -> Vec<f64> {
    let focal = 0.5 * f64::from(SIZE[1]) / (0.5 * f64::from(lens().fov_y_rad)).tan();
    let of = |i: u32| {
        let (x, y) = (f64::from(i % SIZE[0]) + 0.5, f64::from(i / SIZE[0]) + 0.5);
        let [width, height] = SIZE.map(f64::from);
        let at = DVec3::new(x - 0.5 * width, 0.5 * height - y, -focal);
        let way = pose.rotation.as_dquat() * at;
        let eye = pose.position_mm.as_dvec3();
        let hit = wall.ray(eye, way).expect("a closed wall");
        (hit.point - eye).dot(pose.forward().as_dvec3())
    };
    (0..SIZE[0] * SIZE[1]).map(of).collect()
}

/// Means over windows of a grid of values, whose edges repeat.
fn means(values: &[f64], [columns, rows]: [usize; 2], radius: i64) -> Vec<f64> {
    let at = |x: i64, y: i64| {
        let (x, y) = (x.clamp(0, columns as i64 - 1), y.clamp(0, rows as i64 - 1));
        values[y as usize * columns + x as usize]
    };
    let count = ((2 * radius + 1) * (2 * radius + 1)) as f64;
    let mean = |i: usize| {
        let (x, y) = ((i % columns) as i64, (i / columns) as i64);
        let window = (-radius..=radius).flat_map(|v| (-radius..=radius).map(move |u| (u, v)));
        window.map(|(u, v)| at(x + u, y + v)).sum::<f64>() / count
    };
    (0..values.len()).map(mean).collect()
}

/// The picture with its contrast raised: the guided filter as its paper writes it.
fn raised(plain: &[u8], depth: &[f64]) -> Vec<[f64; 3]> {
    const GRID: usize = 4;
    let [width, height] = SIZE.map(|side| side as usize);
    let coarse = [width.div_ceil(GRID), height.div_ceil(GRID)];
    let radius = (SIZE[0] as f64 / 27.0 / GRID as f64).round() as i64;
    let light: Vec<f64> = plain.chunks(3).map(|rgb| luminance(rgb).max(0.001).ln()).collect();
    let guide: Vec<f64> = depth.iter().map(|z| (z / f64::from(lens().near_mm)).ln()).collect();
    let square = |of: &dyn Fn(usize) -> f64| -> Vec<f64> {
        let mean = |i: usize| {
            let (x, y) = (i % coarse[0] * GRID, i / coarse[0] * GRID);
            let pixels = (0..GRID * GRID).map(|k| {
                let (x, y) = ((x + k % GRID).min(width - 1), (y + k / GRID).min(height - 1));
                of(y * width + x)
            });
            pixels.sum::<f64>() / (GRID * GRID) as f64
        };
        (0..coarse[0] * coarse[1]).map(mean).collect()
    };
    let smooth = |values: Vec<f64>| means(&values, coarse, radius);
    let i = smooth(square(&|p| guide[p]));
    let l = smooth(square(&|p| light[p]));
    let il = smooth(square(&|p| guide[p] * light[p]));
    let ii = smooth(square(&|p| guide[p] * guide[p]));
    let slope: Vec<f64> =
        (0..i.len()).map(|k| (il[k] - i[k] * l[k]) / (ii[k] - i[k] * i[k] + 0.02)).collect();
    let offset: Vec<f64> = (0..i.len()).map(|k| l[k] - slope[k] * i[k]).collect();
    let (slope, offset) = (smooth(slope), smooth(offset));
    let between = |of: &[f64], x: usize, y: usize| {
        let place = |p: usize, count: usize| {
            ((p as f64 + 0.5) / GRID as f64 - 0.5).clamp(0.0, count as f64 - 1.0)
        };
        let (u, v) = (place(x, coarse[0]), place(y, coarse[1]));
        let (a, b) = (u as usize, v as usize);
        let (c, d) = ((a + 1).min(coarse[0] - 1), (b + 1).min(coarse[1] - 1));
        let at = |x: usize, y: usize| of[y * coarse[0] + x];
        let (s, t) = (u - a as f64, v - b as f64);
        (1.0 - t) * ((1.0 - s) * at(a, b) + s * at(c, b))
            + t * ((1.0 - s) * at(a, d) + s * at(c, d))
    };
    let one = |p: usize| {
        let (x, y) = (p % width, p / width);
        let base = between(&slope, x, y) * guide[p] + between(&offset, x, y);
        let gain = (f64::from(RAISE) * (light[p] - base)).clamp(-0.5, 0.5).exp();
        let rgb: [f64; 3] = std::array::from_fn(|c| gain * linear(plain[3 * p + c]));
        let most = rgb.iter().copied().fold(1.0, f64::max);
        rgb.map(|c| srgb(c / most))
    };
    (0..plain.len() / 3).map(one).collect()
}

#[test]
fn a_picture_with_raised_contrast_is_what_the_twin_makes_of_the_plain_one() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let (mesh, poses) = colon();
    let wall = Cast::of(&mesh);
    for samples in [1, 4] {
        let mut renderer = Renderer::new(&mut gpu, SIZE[0], SIZE[1], samples).unwrap();
        let mesh = renderer.upload_mesh(&mut gpu, &mesh, false).unwrap();
        for pose in &poses {
            let mut picture =
                |k| rendered(&mut gpu, &mut renderer, &scene(mesh, k), *pose, View::Inside);
            let (plain, got) = (picture(0.0), picture(RAISE));
            let want = raised(&plain, &depths(&wall, pose));
            let off = |p: usize| {
                let d = |c: usize| (want[p][c] - f64::from(got[3 * p + c])).abs();
                d(0).max(d(1)).max(d(2))
            };
            let mut off: Vec<f64> = (0..want.len()).map(off).collect();
            off.sort_by(f64::total_cmp);
            let (p50, p98) = (off[off.len() / 2], off[off.len() * 98 / 100]);
            println!("{samples} samples: off by {p50:.2} (median), {p98:.2} (98 %)");
            // With four samples the depth of a pixel is that of one of them.
            let most = if samples == 1 { (1.0, 2.0) } else { (1.0, 4.0) };
            assert!(p50 <= most.0 && p98 <= most.1, "{samples}: {p50} {p98}");
            // Relief shows more, and the picture is as bright.
            let detail = |rgb: &[u8]| {
                let light: Vec<f64> = rgb.chunks(3).map(luminance).collect();
                let side = SIZE.map(|side| side as usize);
                let even = means(&light, side, 4);
                let square: f64 = light.iter().zip(even).map(|(a, b)| (a - b).powi(2)).sum();
                (square.sqrt(), light.iter().sum::<f64>() / light.len() as f64)
            };
            let ((before, was), (after, is)) = (detail(&plain), detail(&got));
            assert!(after > 1.1 * before, "relief {before} becomes {after}");
            assert!((is / was - 1.0).abs() < 0.1, "light {was} becomes {is}");
        }
    }
    common::assert_silent(&gpu);
}

#[test]
fn an_overview_a_cube_and_a_later_plain_picture_are_left_as_they_are() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let (mesh, poses) = colon();
    let mut renderer = Renderer::new(&mut gpu, SIZE[0], SIZE[1], 1).unwrap();
    let mesh = renderer.upload_mesh(&mut gpu, &mesh, false).unwrap();
    let mut picture = |k, view| rendered(&mut gpu, &mut renderer, &scene(mesh, k), poses[1], view);
    for view in [View::Overview, View::Cube, View::Panorama] {
        assert!(picture(0.0, view) == picture(RAISE, view), "{view:?}");
    }
    let (plain, raised) = (picture(0.0, View::Split), picture(RAISE, View::Split));
    let half = (SIZE[0] / 2) as usize;
    let [left, right] = [0..half, half..SIZE[0] as usize].map(|columns| {
        let rows = 0..SIZE[1] as usize;
        rows.filter(|row| {
            let at = 3 * (row * SIZE[0] as usize + columns.start);
            plain[at..at + 3 * columns.len()] != raised[at..at + 3 * columns.len()]
        })
        .count()
    });
    assert!(left > SIZE[1] as usize / 2 && right == 0, "{left} and {right} rows differ");
    let plain = picture(0.0, View::Inside);
    let raised = picture(RAISE, View::Inside);
    assert!(plain != raised && plain == picture(0.0, View::Inside));
    // Another size, and the first again.
    renderer.resize(&mut gpu, 90, 60).unwrap();
    let pose = poses[0];
    let small = rendered(&mut gpu, &mut renderer, &scene(mesh, RAISE), pose, View::Inside);
    assert_eq!(small.len(), 3 * 90 * 60);
    renderer.resize(&mut gpu, SIZE[0], SIZE[1]).unwrap();
    let again = rendered(&mut gpu, &mut renderer, &scene(mesh, RAISE), poses[1], View::Inside);
    assert!(again == raised);
    common::assert_silent(&gpu);
}
