//! The wall near the eye: what is drawn beside ray casting of the smooth wall.
//!
//! `INTIMA_NEAR="VOLUME [ORGAN [PIXELS]]" cargo bench --bench measure -- near`

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DQuat, DVec3};
use intima::geometry::{Camera, Lens, Mesh, Pose, TriangleBvh};
use intima::lod::DrawnWall;
use intima::lod::refined::RefinedWall;
use intima::lumen::IntensitySelection;
use intima::organ::Organ;
use intima::session::{Session, Settings, Source, VolumeSource, WallForm};
use intima::volume::phantom::{Kind, Phantom};
use intima::volume::{Grid, Volume};
use intima::wall::WallSpline;
use rayon::prelude::*;

const SIZE: [u32; 2] = [960, 720];
const POSES: usize = 6;
/// Depths beyond this count as none, mm.
const FAR_MM: f64 = 200.0;
/// Ratio of neighbouring depths that makes a silhouette.
const JUMP: f64 = 1.15;
/// Largest distance between silhouettes that counts, pixels.
const SEARCH: i64 = 60;

/// Depths of all pixels along their rays, rows from the top; infinite without a hit.
fn depths(camera: &Camera, cast: impl Fn(DVec3, DVec3) -> f64 + Sync) -> Vec<f64> {
    let [width, height] = SIZE;
    let t_y = (0.5 * f64::from(camera.lens.fov_y_rad)).tan();
    let focal = f64::from(height) / (2.0 * t_y);
    let turn = camera.pose.rotation.as_dquat().normalize();
    let eye = camera.pose.position_mm.as_dvec3();
    let pixel = |i: u32| {
        let x = (f64::from(i % width) + 0.5 - 0.5 * f64::from(width)) / focal;
        let y = (0.5 * f64::from(height) - f64::from(i / width) - 0.5) / focal;
        cast(eye, (turn * DVec3::new(x, y, -1.0)).normalize())
    };
    (0..width * height).into_par_iter().map(pixel).collect()
}

/// First place along a ray where the spline rises through zero.
fn cast_spline(spline: &WallSpline, grid: &Grid, eye: DVec3, way: DVec3) -> f64 {
    let step = 0.2 * grid.spacing_mm.min_element();
    let (mut at, mut before) = (0.0, None::<f64>);
    while at < FAR_MM {
        if grid.nearest_voxel(eye + at * way).is_none() {
            return f64::INFINITY;
        }
        let value = spline.value(eye + at * way).map(f64::from);
        if let (Some(a), Some(b)) = (before, value)
            && a < 0.0
            && b >= 0.0
        {
            let (mut lo, mut hi) = (at - step, at);
            for _ in 0..24 {
                let middle = 0.5 * (lo + hi);
                let inside = spline.value(eye + middle * way).is_some_and(|v| v < 0.0);
                (lo, hi) = if inside { (middle, hi) } else { (lo, middle) };
            }
            return lo;
        }
        before = value;
        at += step;
    }
    f64::INFINITY
}

fn cast_mesh(tree: &TriangleBvh, eye: DVec3, way: DVec3) -> f64 {
    tree.first_hit(eye, FAR_MM * way).map_or(f64::INFINITY, |hit| hit.distance(eye))
}

/// Pixels at a silhouette.
fn contours(depths: &[f64]) -> Vec<bool> {
    let [width, height] = SIZE.map(|s| s as usize);
    let jumps = |a: f64, b: f64| a.max(b) > JUMP * a.min(b);
    let at = |i: usize| {
        let (x, y) = (i % width, i / width);
        x + 1 < width && jumps(depths[i], depths[i + 1])
            || y + 1 < height && jumps(depths[i], depths[i + width])
    };
    (0..width * height).map(at).collect()
}

/// Distances from each pixel of one set to the nearest of the other, pixels.
fn distances(from: &[bool], to: &[bool]) -> Vec<f64> {
    let [width, height] = SIZE.map(i64::from);
    let of = |i: usize| {
        let (x, y) = (i as i64 % width, i as i64 / width);
        let mut best = SEARCH * SEARCH;
        let mut ring = 0;
        while ring <= SEARCH && ring * ring <= best {
            for dy in -ring..=ring {
                let step = if dy.abs() == ring { 1 } else { 2 * ring.max(1) };
                let mut dx = -ring;
                while dx <= ring {
                    let (u, v) = (x + dx, y + dy);
                    let inside = (0..width).contains(&u) && (0..height).contains(&v);
                    if inside && to[(u + width * v) as usize] {
                        best = best.min(dx * dx + dy * dy);
                    }
                    dx += step;
                }
            }
            ring += 1;
        }
        (best as f64).sqrt()
    };
    (0..from.len()).into_par_iter().filter(|i| from[*i]).map(of).collect()
}

/// Silhouettes and depths of a picture beside another one, for print.
///
/// * `is_central`: whether the silhouettes of the central quarter alone count.
fn compared(picture: &[f64], truth: &[f64], is_central: bool) -> String {
    // The smooth wall has no caps.
    let masked = picture.iter().zip(truth).map(|(a, b)| if b.is_finite() { *a } else { *b });
    let picture = &masked.collect::<Vec<f64>>()[..];
    let [width, height] = SIZE.map(|s| s as usize);
    let counts = |i: usize| {
        let (x, y) = (i % width, i / width);
        let middle = (width / 4..3 * width / 4).contains(&x);
        !is_central || middle && (height / 4..3 * height / 4).contains(&y)
    };
    let central = |depths| {
        let of = |(i, at): (usize, bool)| at && counts(i);
        contours(depths).into_iter().enumerate().map(of).collect::<Vec<bool>>()
    };
    let (a, b) = (central(picture), central(truth));
    let mut off = [distances(&a, &b), distances(&b, &a)].concat();
    off.sort_by(f64::total_cmp);
    let mean = off.iter().sum::<f64>() / off.len().max(1) as f64;
    let high = off.get(off.len() * 95 / 100).copied().unwrap_or(0.0);
    let is_off = |(a, b): (&f64, &f64)| b.is_finite() && ((a / b - 1.0).abs() > 0.02);
    let count = picture.iter().zip(truth).filter(|p| is_off(*p)).count();
    let share = 100.0 * count as f64 / picture.len() as f64;
    format!("{mean:6.2} px, 95 % {high:5.1} px, {share:6.2} % off in depth")
}

/// The triangles that a camera draws of a refined wall.
fn drawn(wall: &RefinedWall, camera: &Camera) -> Mesh {
    let seen = wall.visible(camera);
    let mut mesh = Mesh::default();
    let mut numbers: HashMap<[u32; 3], u32> = HashMap::new();
    let flat = seen.ranges.iter().flat_map(|r| r.first_index / 3..(r.first_index + r.indices) / 3);
    let corners = |f: u32| wall.faces()[f as usize].map(|v| wall.shading().vertices[v as usize]);
    let refined = seen.refined.iter().flat_map(|f| wall.triangles(*f));
    for t in flat.map(corners).chain(refined) {
        mesh.faces.push(t.map(|v| {
            let p = v.position();
            *numbers.entry(p.to_array().map(f32::to_bits)).or_insert_with(|| {
                mesh.positions.push(p);
                mesh.positions.len() as u32 - 1
            })
        }));
    }
    mesh
}

/// Number of triangles of which an edge crosses another triangle that shares no vertex with them.
fn crossing(mesh: &Mesh) -> usize {
    let corners = |f: usize| mesh.faces[f].map(|v| mesh.positions[v as usize].as_dvec3());
    let size = mesh.faces.iter().enumerate().map(|(f, _)| {
        let [a, b, c] = corners(f);
        a.distance(b).max(b.distance(c)).max(c.distance(a))
    });
    let cell = size.fold(0.0, f64::max).max(1e-9);
    let mut cells: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
    let cells_of = |f: usize| {
        let [a, b, c] = corners(f);
        let lo = (a.min(b).min(c) / cell).floor().as_ivec3();
        let hi = (a.max(b).max(c) / cell).floor().as_ivec3();
        (lo.z..=hi.z).flat_map(move |z| {
            (lo.y..=hi.y).flat_map(move |y| (lo.x..=hi.x).map(move |x| [x, y, z]))
        })
    };
    for f in 0..mesh.faces.len() {
        cells_of(f).for_each(|c| cells.entry(c).or_default().push(f as u32));
    }
    let pierces = |ends: [DVec3; 2], [a, b, c]: [DVec3; 3]| {
        // Möller & Trumbore 1997, strictly inside both.
        let (way, u, v) = (ends[1] - ends[0], b - a, c - a);
        let p = way.cross(v);
        let scale = u.dot(p);
        if scale.abs() < 1e-14 {
            return false;
        }
        let (s, q) = (ends[0] - a, (ends[0] - a).cross(u));
        let (x, y, t) = (s.dot(p) / scale, way.dot(q) / scale, v.dot(q) / scale);
        let inside = |w: f64| w > 1e-6 && w < 1.0 - 1e-6;
        inside(t) && x > 1e-6 && y > 1e-6 && x + y < 1.0 - 1e-6
    };
    let crosses = |f: usize| {
        let own = mesh.faces[f];
        let [a, b, c] = corners(f);
        let others = cells_of(f).filter_map(|c| cells.get(&c)).flatten();
        let mut apart =
            others.filter(|g| !mesh.faces[**g as usize].iter().any(|v| own.contains(v)));
        apart.any(|g| {
            let other = corners(*g as usize);
            let [d, e, h] = other;
            [[a, b], [b, c], [c, a]].into_iter().any(|ends| pierces(ends, other))
                || [[d, e], [e, h], [h, d]].into_iter().any(|ends| pierces(ends, [a, b, c]))
        })
    };
    (0..mesh.faces.len()).into_par_iter().filter(|f| crosses(*f)).count()
}

/// Prints silhouettes and depths of the mesh and of the refined wall beside the smooth wall.
pub fn silhouettes_beside_ray_casting() {
    let Ok(what) = std::env::var("INTIMA_NEAR") else { return };
    let mut words = what.split(' ');
    let file = words.next().unwrap_or_default();
    let mut settings = Settings::default();
    settings.flight.size = SIZE;
    let named = words.next().unwrap_or_default();
    settings.lumen.organ = Organ::ALL.into_iter().find(|o| o.name() == named).map(Organ::into);
    if let Some(pixels) = words.next() {
        settings.levels.pixel_error = pixels.parse().expect("pixels");
    }
    let source = Source::Image(VolumeSource::file(file));
    let session = Session::new(source, settings).expect("a volume");
    let flight = session.flight().expect("a flight");
    let levels = session.levels().expect("a wall");
    let WallForm::Refined(wall) = &levels.form else { panic!("a refined wall") };
    let (found, mesh) = (session.lumen().expect("a lumen"), session.wall().expect("a wall"));
    let spline = match &found.wall {
        Some(field) => WallSpline::of_field(&found.lumen, field, &mesh.mesh.positions),
        None => WallSpline::of_mesh(&found.lumen, &mesh.mesh),
    };
    let grid = *session.lumen().expect("a lumen").lumen.volume_grid();
    let spacing = grid.spacing_mm.min_element();
    let whole = TriangleBvh::new(&session.wall().expect("a wall").mesh);
    for stage in &session.clock().stages {
        if ["smooth wall", "refined wall", "octree", "shading"].contains(&stage.name) {
            println!("{:<18} {:>8.1} ms", stage.name, stage.ms);
        }
    }
    let split = wall.mesh(2, &[]);
    let (flat, fine) = (crossing(&session.wall().expect("a wall").mesh), crossing(&split));
    let faces = split.faces.len();
    let share = 100.0 * fine as f64 / faces as f64;
    println!("crossing: {flat} of the mesh, {fine} of {faces} after two splits ({share:.3} %)");
    for k in 0..POSES {
        let i = (2 * k + 1) * flight.poses.len() / (2 * POSES);
        let camera = Camera { pose: flight.poses[i], lens: flight.lens(i), height_px: SIZE[1] };
        let camera = Camera {
            lens: Lens { aspect: SIZE[0] as f32 / SIZE[1] as f32, ..camera.lens },
            ..camera
        };
        let mesh = drawn(wall, &camera);
        let tree = TriangleBvh::new(&mesh);
        let refined = depths(&camera, |eye, way| cast_mesh(&tree, eye, way));
        let flat = depths(&camera, |eye, way| cast_mesh(&whole, eye, way));
        let mut seen: Vec<f64> = flat.iter().copied().filter(|d| d.is_finite()).collect();
        seen.sort_by(f64::total_cmp);
        let focal = f64::from(SIZE[1]) / (2.0 * (0.5 * f64::from(camera.lens.fov_y_rad)).tan());
        let voxel = focal * spacing / seen.get(seen.len() / 2).copied().unwrap_or(f64::NAN);
        println!("frame {i}: {voxel:.0} px a voxel, {} triangles", mesh.faces.len());
        let truth = depths(&camera, |eye, way| cast_spline(&spline, &grid, eye, way));
        println!("  mesh     {}", compared(&flat, &truth, false));
        println!("  refined  {}", compared(&refined, &truth, false));
    }
}

/// A torus about an oblique axis through the middle of its volume, off the grid.
struct Ring {
    middle: DVec3,
    turn: DQuat,
    radius: f64,
}

/// Standard deviation of the blur of a ring's CT, mm.
const BLUR_MM: f64 = 0.7;
/// Radius of the circle in the middle of a ring, mm.
const AROUND_MM: f64 = 30.0;

impl Ring {
    fn new(radius: f64) -> Self {
        let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.35, 0.5, 0.2);
        Self { middle: DVec3::new(47.63, 47.81, 47.42), turn, radius }
    }

    /// Signed distance from the wall, negative inside.
    fn offset(&self, p: DVec3) -> f64 {
        let q = self.turn.inverse() * (p - self.middle);
        DVec3::new(q.truncate().length() - AROUND_MM, q.z, 0.0).length() - self.radius
    }

    /// Camera on the circle in the middle.
    fn camera(&self, angle: f64) -> Camera {
        let out = self.turn * DVec3::new(angle.cos(), angle.sin(), 0.0);
        let along = self.turn * DVec3::new(-angle.sin(), angle.cos(), 0.0);
        let eye = self.middle + AROUND_MM * out;
        // Towards the place where the inner bend hides the rest.
        let inwards = ((AROUND_MM - self.radius) / AROUND_MM).acos();
        let forward = inwards.cos() * along - inwards.sin() * out;
        let pose = Pose::looking(eye.as_vec3(), forward.as_vec3(), glam::Vec3::Z);
        let aspect = SIZE[0] as f32 / SIZE[1] as f32;
        let lens = Lens { fov_y_rad: std::f32::consts::FRAC_PI_2, aspect, near_mm: 0.05 };
        Camera { pose, lens, height_px: SIZE[1] }
    }

    fn cast(&self, eye: DVec3, way: DVec3) -> f64 {
        let mut at = 0.0;
        for _ in 0..4000 {
            let free = -self.offset(eye + at * way);
            if free < 1e-5 {
                return at;
            }
            at += free;
        }
        f64::INFINITY
    }

    /// The ring as a CT of gas in tissue: 990 HU of contrast, a blur of 0.7 voxel, noise of 20 HU.
    fn ct(&self) -> Volume {
        let mut seed = 7u64;
        let mut noise = || {
            let sum: f64 = (0..12)
                .map(|_| {
                    seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    (seed >> 40) as f64 / (1u64 << 24) as f64
                })
                .sum();
            sum - 6.0
        };
        // Points of a Gaussian, and the share of it that each stands for.
        const STEP_MM: f64 = 0.3;
        let line: Vec<(f64, f64)> = (-7..=7)
            .map(|k| STEP_MM * f64::from(k))
            .map(|x| (x, (-x * x / (2.0 * BLUR_MM * BLUR_MM)).exp()))
            .collect();
        let sum: f64 = line.iter().map(|l| l.1).sum();
        self.volume(|p| {
            let offset = self.offset(p);
            let mut tissue = if offset > 0.0 { 1.0 } else { 0.0 };
            if offset.abs() < 3.0 * BLUR_MM + STEP_MM {
                tissue = 0.0;
                for (x, wx) in &line {
                    for (y, wy) in &line {
                        for (z, wz) in &line {
                            // A step as steep as the points are dense.
                            let off = self.offset(p + DVec3::new(*x, *y, *z)) / STEP_MM;
                            tissue += wx * wy * wz * (0.5 + off).clamp(0.0, 1.0);
                        }
                    }
                }
                tissue /= sum * sum * sum;
            }
            (-950.0 + 990.0 * tissue + 20.0 * noise()).round() as i16
        })
    }

    fn label(&self) -> Volume {
        self.volume(|p| i16::from(self.offset(p) < 0.0))
    }

    fn volume(&self, mut value: impl FnMut(DVec3) -> i16) -> Volume {
        let grid = Grid::axis_aligned([96; 3], [1.0; 3]);
        let world = grid.world_from_voxel();
        let samples: Vec<i16> = (0..grid.len())
            .map(|i| value(world.transform_point3(grid.voxel(i).as_dvec3())))
            .collect();
        Volume::new(grid, samples.into())
    }
}

/// Prints silhouettes and depths of rings from a CT and from a label map beside the rings themselves.
pub fn silhouettes_of_rings() {
    for (radius, is_ct) in [(1.5, true), (3.0, true), (8.0, true), (3.0, false), (8.0, false)] {
        let ring = Ring::new(radius);
        let volume = if is_ct { ring.ct() } else { ring.label() };
        let mut settings = Settings::default();
        if is_ct {
            let range = IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: -500.0 };
            settings.lumen.select = Some(range);
        }
        let source = Source::Image(VolumeSource::Memory(Arc::new(volume)));
        let session = Session::new(source, settings).expect("a volume");
        let levels = session.levels().expect("a wall");
        let WallForm::Refined(wall) = &levels.form else { panic!("a refined wall") };
        let whole = TriangleBvh::new(&session.wall().expect("a wall").mesh);
        println!("{} of radius {radius}", if is_ct { "CT" } else { "label map" });
        let off = |mesh: &Mesh| {
            let centres = mesh.faces.iter().map(|f| {
                let [a, b, c] = f.map(|v| mesh.positions[v as usize].as_dvec3());
                ((a + b + c) / 3.0, 0.5 * (b - a).cross(c - a).length())
            });
            let sums = centres.fold((0.0, 0.0, 0.0), |s, (p, area)| {
                let off = ring.offset(p);
                (s.0 + area * off, s.1 + area * off * off, s.2 + area)
            });
            format!("mean {:+.3} rms {:.3} voxels", sums.0 / sums.2, (sums.1 / sums.2).sqrt())
        };
        println!("  mesh     {}", off(&session.wall().expect("a wall").mesh));
        println!("  refined  {}", off(&wall.mesh(2, &[])));
        for angle in [0.7, 3.1] {
            let camera = ring.camera(angle);
            let truth = depths(&camera, |eye, way| ring.cast(eye, way));
            let tree = TriangleBvh::new(&drawn(wall, &camera));
            let refined = depths(&camera, |eye, way| cast_mesh(&tree, eye, way));
            let flat = depths(&camera, |eye, way| cast_mesh(&whole, eye, way));
            println!("  mesh     {}", compared(&flat, &truth, true));
            println!("  refined  {}", compared(&refined, &truth, true));
        }
    }
}

/// First place along a ray where a phantom's field rises through zero.
fn cast_phantom(phantom: &Phantom, eye: DVec3, way: DVec3) -> f64 {
    /// Share of the field's value that a step is: the field of folds is steeper than a distance.
    const SHARE: f64 = 0.3;
    let field = |at: f64| phantom.field(eye + at * way);
    let mut at = 0.0;
    while at < FAR_MM {
        let here = field(at);
        let step = (SHARE * here.abs()).max(0.01);
        if here < 0.0 && field(at + step) >= 0.0 {
            let (mut lo, mut hi) = (at, at + step);
            for _ in 0..24 {
                let middle = 0.5 * (lo + hi);
                (lo, hi) = if field(middle) < 0.0 { (middle, hi) } else { (lo, middle) };
            }
            return lo;
        }
        at += step;
    }
    f64::INFINITY
}

/// Prints silhouettes and depths of phantoms beside the formula of their walls.
pub fn silhouettes_of_phantoms() {
    for (kind, is_ct) in [(Kind::Y, true), (Kind::Colon, true), (Kind::Colon, false)] {
        let phantom = Phantom::new(kind, 128, [1.0; 3]).expect("a phantom");
        let mut settings = Settings::default();
        settings.flight.size = SIZE;
        if is_ct {
            let range = IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: -500.0 };
            settings.lumen.select = Some(range);
        }
        let volume = if is_ct { phantom.grey(None, 0) } else { phantom.mask() };
        let source = Source::Image(VolumeSource::Memory(Arc::new(volume)));
        let session = Session::new(source, settings).expect("a volume");
        let flight = session.flight().expect("a flight");
        let levels = session.levels().expect("a wall");
        let WallForm::Refined(wall) = &levels.form else { panic!("a refined wall") };
        let whole = TriangleBvh::new(&session.wall().expect("a wall").mesh);
        println!("{} as {}", kind.name(), if is_ct { "CT" } else { "label map" });
        for k in 0..4 {
            let i = (2 * k + 1) * flight.poses.len() / 8;
            let lens = Lens { aspect: SIZE[0] as f32 / SIZE[1] as f32, ..flight.lens(i) };
            let camera = Camera { pose: flight.poses[i], lens, height_px: SIZE[1] };
            let truth = depths(&camera, |eye, way| cast_phantom(&phantom, eye, way));
            let tree = TriangleBvh::new(&drawn(wall, &camera));
            let refined = depths(&camera, |eye, way| cast_mesh(&tree, eye, way));
            let flat = depths(&camera, |eye, way| cast_mesh(&whole, eye, way));
            println!("  mesh     {}", compared(&flat, &truth, false));
            println!("  refined  {}", compared(&refined, &truth, false));
        }
    }
}
