//! The tissue behind the wall: what a colour says, and the picture beside its twin.

use std::sync::Arc;

use common::cast::Cast;
use common::colour::{linear, srgb};
use glam::{DVec3, Quat, Vec3};
use intima::behind::BehindWall;
use intima::geometry::{Lens, Pose};
use intima::lumen::IntensitySelection;
use intima::render::{PreparedMesh, Renderer, Scene, Shot, View};
use intima::session::{LumenSettings, Reading, Session, Settings, Source, VolumeSource};
use intima::vk::Validate;
use intima::volume::{Grid, Samples, Volume};

const SPACING: f64 = 0.8;
const DIMS: [u32; 3] = [80, 80, 60];
/// Axis and radius of a tube of gas along z, mm.
const AXIS: DVec3 = DVec3::new(32.0, 32.0, 24.0);
const RADIUS: f64 = 16.0;
/// Place of the eye, off the planes of the grid: no ray runs along an edge of the wall.
const EYE: DVec3 = DVec3::new(32.013, 32.017, 24.011);
/// Soft tissue about the tube, mm; fat lies behind it.
const WALL: f64 = 4.0;
const GAS: f64 = -1000.0;
const FAT: f64 = -100.0;
const SOFT: f64 = 40.0;
const TAGGED: f64 = 400.0;
/// Radius of the balls, mm.
const BALL: f64 = 3.0;

/// Direction of one of three balls from the axis.
fn towards(ball: usize) -> DVec3 {
    let angle = ball as f64 * std::f64::consts::TAU / 3.0;
    DVec3::new(angle.cos(), angle.sin(), 0.0)
}

const BALLS: [f64; 3] = [SOFT, TAGGED, FAT];

fn value(p: DVec3) -> f64 {
    for (i, value) in BALLS.into_iter().enumerate() {
        if p.distance(AXIS + RADIUS * towards(i)) < BALL {
            return value;
        }
    }
    match (p - AXIS).truncate().length() {
        r if r < RADIUS => GAS,
        r if r < RADIUS + WALL => SOFT,
        _ => FAT,
    }
}

/// The tube with its balls, each voxel the mean of 4³ points, and noise of so many HU.
fn volume(noise: f64) -> Arc<Volume> {
    let grid = Grid::axis_aligned(DIMS, [SPACING; 3]);
    let mut seed = 1u64;
    let mut normal = || {
        let mut next = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            ((seed >> 11) as f64 + 0.5) / (1u64 << 53) as f64
        };
        (-2.0 * next().ln()).sqrt() * (std::f64::consts::TAU * next()).cos()
    };
    let mean = |i: usize| {
        let middle = SPACING * grid.voxel(i).as_dvec3();
        let part = |k: usize| (k as f64 - 1.5) * 0.25 * SPACING;
        let points = (0..64).map(|k| DVec3::new(part(k % 4), part(k / 4 % 4), part(k / 16)));
        points.map(|d| value(middle + d)).sum::<f64>() / 64.0
    };
    let values: Vec<i16> =
        (0..grid.len()).map(|i| (mean(i) + noise * normal()).round() as i16).collect();
    Arc::new(Volume::new(grid, Samples::from(values)))
}

fn session(noise: f64) -> Session {
    let select = Some(IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: -500.0 });
    let lumen = LumenSettings { select, ..LumenSettings::default() };
    let source = Source::Image(VolumeSource::Memory(volume(noise)));
    Session::new(source, Settings { lumen, ..Settings::default() }).unwrap()
}

/// Tissue whose colour is nearest to that of a ray: fat, soft, or tagged.
fn told(colour: [f32; 3]) -> f64 {
    let hue = |c: [f32; 3]| Vec3::from(c) / Vec3::from(c).element_sum().max(1e-6);
    let known =
        [(FAT, [0.46, 0.36, 0.10]), (SOFT, [0.62, 0.15, 0.11]), (TAGGED, [0.72, 0.88, 0.80])];
    let off = |of: &(f64, [f32; 3])| hue(of.1).distance(hue(colour));
    known.into_iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap().0
}

/// Share of the rays through the middle of a ball that tell its tissue.
fn told_right(behind: &BehindWall, wall: &Cast, ball: usize) -> f64 {
    let way = towards(ball);
    let (right, up) = (DVec3::Z, DVec3::Z.cross(way));
    let mut shares = (0, 0);
    for i in -10..=10 {
        for k in -10..=10 {
            let (x, y) = (0.15 * f64::from(i), 0.15 * f64::from(k));
            if x.hypot(y) > 0.5 * BALL {
                continue;
            }
            let to = AXIS + RADIUS * way + x * right + y * up;
            let along = (to - EYE).normalize();
            let hit = wall.ray(EYE, along).expect("a closed wall");
            let seen = behind.seen(hit.point, along.as_vec3());
            shares.0 += usize::from(told(seen.colour) == BALLS[ball]);
            shares.1 += 1;
        }
    }
    shares.0 as f64 / shares.1 as f64
}

#[test]
fn a_ball_of_3_mm_behind_the_wall_has_the_colour_of_its_tissue() {
    for (noise, must) in [(20.0, [0.95, 0.95, 0.75]), (80.0, [0.95, 0.95, 0.60])] {
        let session = session(noise);
        let (behind, wall) = (session.behind().unwrap(), session.wall().unwrap());
        let wall = Cast::of(&wall.mesh);
        let shares = [0, 1, 2].map(|ball| told_right(&behind, &wall, ball));
        println!("{noise} HU: soft, tagged, fat told right: {shares:.2?}");
        assert!(shares.iter().zip(must).all(|(share, must)| *share >= must), "{noise}: {shares:?}");
    }
}

#[test]
fn the_wall_itself_is_not_told_to_be_fat() {
    let session = session(20.0);
    let (behind, wall) = (session.behind().unwrap(), session.wall().unwrap());
    let wall = Cast::of(&wall.mesh);
    let tells = |i: i32| {
        let angle = 0.5 + 1.1 * f64::from(i) / 200.0;
        let way = DVec3::new(angle.cos(), angle.sin(), 0.3).normalize();
        let hit = wall.ray(EYE, way).expect("a closed wall");
        told(behind.seen(hit.point, way.as_vec3()).colour) == SOFT
    };
    let soft = (0..200).filter(|i| tells(*i)).count();
    assert!(soft >= 194, "{soft} of 200");
}

#[test]
fn a_volume_read_in_parts_shows_the_same_tissue() {
    let tmp = tempfile::tempdir().unwrap();
    let file = tmp.path().join("scan.mha");
    intima::formats::write_volume(&file, &volume(20.0)).unwrap();
    let plain = |reading| {
        let source = Source::Image(VolumeSource::file(&file));
        let mut settings = session(20.0).settings().clone();
        settings.reading = reading;
        settings.flight.behind_mm = Some(1.0);
        Session::new(source, settings).unwrap()
    };
    let [whole, parts] = [Reading::Whole, Reading::Parts].map(plain);
    let (a, b) = (whole.behind().unwrap(), parts.behind().unwrap());
    assert_eq!(a.opacity, b.opacity);
    assert!(a.tissue.words() == b.tissue.words());
}

const SIZE: [u32; 2] = [96, 72];

#[test]
fn the_picture_is_what_the_twin_sees() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let session = session(20.0);
    let (behind, wall) = (session.behind().unwrap(), session.wall().unwrap());
    let cast = Cast::of(&wall.mesh);
    let lens = Lens { fov_y_rad: 1.3, aspect: 4.0 / 3.0, near_mm: 0.5 };
    for samples in [1, 4] {
        let mut renderer = Renderer::new(&mut gpu, SIZE[0], SIZE[1], samples).unwrap();
        let prepared = PreparedMesh::new(&wall.mesh).unwrap();
        let mesh = renderer.upload_prepared_mesh(&mut gpu, &prepared).unwrap();
        let tissue = renderer.upload_tissue(&mut gpu, &behind).unwrap();
        for (ball, tilt) in [(0, 0.2f32), (1, -0.3), (2, 0.0)] {
            let forward = Quat::from_rotation_z(tilt) * towards(ball).as_vec3();
            let pose = Pose::looking(EYE.as_vec3(), forward, Vec3::Z);
            let room = Some(16.0);
            let shot = Shot { view: View::Inside, pose, lens, progress: 0.0, room_mm: room };
            let plain = renderer.render(&mut gpu, &Scene::of(mesh), &shot).unwrap();
            let scene = Scene { behind: Some(tissue), ..Scene::of(mesh) };
            let got = renderer.render(&mut gpu, &scene, &shot).unwrap();
            let mut off = Vec::new();
            for i in 0..(SIZE[0] * SIZE[1]) as usize {
                let (x, y) = (i as u32 % SIZE[0], i as u32 / SIZE[0]);
                let focal = 0.5 * SIZE[1] as f32 / (0.5 * lens.fov_y_rad).tan();
                let at = Vec3::new(
                    x as f32 + 0.5 - 0.5 * SIZE[0] as f32,
                    0.5 * SIZE[1] as f32 - y as f32 - 0.5,
                    -focal,
                );
                let way = (pose.rotation * at).normalize();
                let hit = cast.ray(EYE, way.as_dvec3()).expect("a closed wall");
                let laid = laid_over(&behind, &pose, hit.point, way);
                let want: [f32; 3] = std::array::from_fn(|c| {
                    laid.0[c] + (1.0 - laid.1) * linear(plain[3 * i + c]) as f32
                });
                let d = |c: usize| {
                    (srgb(f64::from(want[c].min(1.0))) - f64::from(got[3 * i + c])).abs()
                };
                off.push(d(0).max(d(1)).max(d(2)));
            }
            off.sort_by(f64::total_cmp);
            let (p50, p98) = (off[off.len() / 2], off[off.len() * 98 / 100]);
            println!("{samples} samples, ball {ball}: off by {p50:.2} (median), {p98:.2} (98 %)");
            // With four samples the place of a pixel is that of one of them.
            let most = if samples == 1 { (1.0, 3.0) } else { (2.0, 12.0) };
            assert!(p50 <= most.0 && p98 <= most.1, "{samples} {ball}: {p50} {p98}");
            assert!(got != plain, "the tissue shows");
        }
    }
    common::assert_silent(&gpu);
}

/// Light that the shader lays over a pixel, and the share of the wall's picture that it hides.
fn laid_over(behind: &BehindWall, pose: &Pose, place: DVec3, way: Vec3) -> ([f32; 3], f32) {
    let (light, falloff) = (pose.position_mm + 0.35 * 16.0 * pose.up(), 20.0 * 16.0);
    let lit = |place: Vec3, normal: Vec3| {
        let to_light = light - place;
        let facing = (-normal.dot(to_light.normalize())).max(0.0);
        (facing, 1.0 / (1.0 + to_light.length_squared() / (falloff * falloff)))
    };
    let seen = behind.seen(place, way);
    let (facing, near) = lit(place.as_vec3(), seen.normal);
    let beyond = match seen.next_wall {
        Some((place, normal)) => {
            let (facing, near) = lit(place.as_vec3(), normal);
            [0.62, 0.27, 0.21].map(|c| c * (0.08 + 1.1 * facing * facing) * near)
        }
        None => [0.012, 0.012, 0.016],
    };
    let side = 1.0 - seen.normal.dot(way).clamp(0.0, 1.0);
    let hides = 0.7 - 0.35 * side.powi(3);
    let shade = (0.35 + 0.65 * facing) * near;
    let of = |c: usize| hides * (seen.colour[c] * shade + beyond[c] * seen.through);
    ([of(0), of(1), of(2)], hides)
}
