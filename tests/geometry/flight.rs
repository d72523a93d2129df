//! Facts about flights through the phantoms, and through a real colon where there is one.

use common::volumes;
use glam::{DVec3, Vec3};
use intima::centerline::{RouteOptions, centerline};
use intima::compute::{Plan, run_cpu};
use intima::field::{LumenBuffers, distance, smooth};
use intima::flight::{
    CameraPath, Clearance, Flight, FlightError, FlightOptions, Frames, Track, WallDistance,
    collide_and_slide,
};
use intima::geometry::{CenterlinePoint, Mesh, TriangleBvh};
use intima::lumen::{IntensitySelection, Lumen, SegmentationOptions};
use intima::surface::{Midpoint, Surface};
use intima::volume::Volume;
use intima::volume::phantom::{Kind, Phantom};

struct Organ {
    lumen: Lumen,
    distance: Vec<f32>,
    path: Vec<CenterlinePoint>,
    wall: Mesh,
}

fn organ(kind: Kind, size: u32, spacing: [f64; 3]) -> Organ {
    organ_of(&Phantom::new(kind, size, spacing).unwrap().mask())
}

fn organ_of(volume: &Volume) -> Organ {
    let (lumen, _) =
        SegmentationOptions::new(IntensitySelection::Labels(Vec::new())).apply(volume).unwrap();
    let mut plan = Plan::new();
    let buffers = LumenBuffers::new(&mut plan, &lumen);
    let d = distance(&mut plan, &buffers);
    let f = smooth(&mut plan, &buffers, d, lumen.grid.spacing_mm.min_element(), None);
    plan.download(d);
    plan.download(f);
    let out = run_cpu(&plan);
    let (d, f) = (out.get(d).to_vec(), out.get(f).to_vec());
    let line = centerline(&lumen, &d, &f, RouteOptions::default()).unwrap().line;
    let wall = Surface::new(&lumen, &Midpoint, None).mesh;
    Organ { path: line.path_to(0), lumen, distance: d, wall }
}

/// A straight or curved path without an organ about it: a lumen that is all inside.
fn open_space(path: impl Fn(f64) -> DVec3, length_mm: f64, step_mm: f64, radius: f64) -> Organ {
    use intima::lumen::BitVolume;
    use intima::volume::Grid;
    let grid = Grid::axis_aligned([120, 120, 120], [1.0; 3]);
    let mut bits = BitVolume::new(grid.dims);
    for v in (0..grid.len()).map(|i| grid.voxel(i)) {
        bits.set(v.x, v.y, v.z);
    }
    let lumen = Lumen::of_volume(grid, &bits);
    let distance = vec![20.0; lumen.bricks.field_len()];
    let n = (length_mm / step_mm) as usize;
    let path = (0..=n)
        .map(|i| {
            let s = step_mm * i as f64;
            CenterlinePoint { position_mm: path(s), radius_mm: radius, abscissa_mm: s }
        })
        .collect();
    Organ { lumen, distance, path, wall: Mesh::default() }
}

impl Organ {
    fn fly(&self, options: FlightOptions<'_>) -> Result<Flight, FlightError> {
        Flight::new(&self.path, &self.lumen, &self.distance, options)
    }
}

/// Turn of the gaze and roll about it between consecutive frames, degrees. Roll is what is left
/// when the first frame is turned onto the second gaze by the shortest way.
fn turns(flight: &Flight) -> Vec<(f64, f64)> {
    let pair = |w: &[intima::geometry::Pose]| {
        let (a, b) = (w[0].forward().as_dvec3(), w[1].forward().as_dvec3());
        let carried = glam::DQuat::from_rotation_arc(a.normalize(), b.normalize());
        let up = carried * w[0].up().as_dvec3();
        let roll = up.angle_between(w[1].up().as_dvec3());
        (a.angle_between(b).to_degrees(), roll.to_degrees())
    };
    flight.poses.windows(2).map(pair).collect()
}

fn median(v: impl Iterator<Item = f64>) -> f64 {
    let mut v: Vec<f64> = v.collect();
    v.sort_by(f64::total_cmp);
    v[v.len() / 2]
}

fn greatest(v: impl Iterator<Item = f64>) -> f64 {
    v.fold(0.0, f64::max)
}

/// White noise in a ball-like cloud of standard deviation `sigma` an axis.
fn noise(i: u64, sigma: f64) -> DVec3 {
    let uniform = |k: u64| {
        let n = (i * 64 + k).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let n = (n ^ n >> 31).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        ((n ^ n >> 29) >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    // the sum of twelve uniforms has variance one
    DVec3::from_array([0, 12, 24].map(|a| sigma * (0..12).map(|k| uniform(a + k)).sum::<f64>()))
}

#[test]
fn a_noisy_path_is_flown_with_a_calm_gaze() {
    let arc = |s: f64| {
        let a = s / 40.0;
        DVec3::new(20.0 + 40.0 * (1.0 - a.cos()), 20.0 + 40.0 * a.sin(), 30.0 + 0.3 * s)
            + noise((s * 2.0).round() as u64, 0.05)
    };
    let organ = open_space(arc, 100.0, 0.5, 5.0);
    // a frame every half millimetre, as the paths of other programs are flown
    let flight = organ.fly(FlightOptions { frames: Frames::Count(200), ..Default::default() });
    let turns = turns(&flight.unwrap());
    let (mid, most) = (median(turns.iter().map(|t| t.0)), greatest(turns.iter().map(|t| t.0)));
    let roll = greatest(turns.iter().map(|t| t.1));
    println!("noisy arc: gaze {mid:.3} deg a frame (median), {most:.3} (most); roll {roll:.4}");
    assert!(mid < 2.0 && most < 4.0 && roll < 0.1);
}

#[test]
fn up_does_not_flip_over_an_arch_and_a_drop() {
    // Climbs past the vertical, goes over, and drops past it: the gaze crosses both poles.
    let arch = |s: f64| {
        let steps = (s * 20.0).round() as usize;
        let lean =
            |k: usize| 1.92 * (std::f64::consts::TAU * 0.05 * (k as f64 + 0.5) / 115.0).sin();
        let way = (0..steps).map(|k| DVec3::new(0.0, lean(k).cos(), lean(k).sin()) * 0.05);
        DVec3::new(60.0, 40.0, 40.0) + way.sum::<DVec3>()
    };
    let organ = open_space(arch, 115.0, 0.5, 5.0);
    for reverse in [false, true] {
        let frames = Frames::Count(150);
        let flight = organ.fly(FlightOptions { frames, reverse, ..Default::default() }).unwrap();
        let turns = turns(&flight);
        let (gaze, roll) =
            (greatest(turns.iter().map(|t| t.0)), greatest(turns.iter().map(|t| t.1)));
        println!("arch and drop: gaze {gaze:.3} deg a frame at most, roll {roll:.5}");
        assert!(gaze < 4.0 && roll < 0.05);
        // A fixed up flips here.
        let naive = |p: &intima::geometry::Pose| p.forward().cross(Vec3::Z);
        let right = flight
            .poses
            .windows(2)
            .map(|w| f64::from(naive(&w[0]).angle_between(naive(&w[1]))).to_degrees());
        assert!(greatest(right) > 90.0, "the path does not try what it should");
    }
}

#[test]
fn the_first_up_is_the_head_or_the_front() {
    let along = |d: DVec3| {
        let organ = open_space(|s| DVec3::splat(30.0) + s * d, 40.0, 0.5, 5.0);
        organ.fly(FlightOptions::default()).unwrap().poses[0].up()
    };
    assert!(along(DVec3::X).z > 0.999 && along(DVec3::Y).z > 0.999);
    assert!(along(DVec3::Z).y < -0.999);
}

#[test]
fn narrow_places_are_flown_slowly_and_the_gaze_turns_no_faster_than_it_may() {
    for kind in [Kind::Colon, Kind::Bend, Kind::Helix] {
        let o = organ(kind, 64, [1.0; 3]);
        let frames = Frames::Speed { mm_per_s: 20.0, fps: 25.0 };
        let f = o
            .fly(FlightOptions {
                frames,
                wall: Some(&TriangleBvh::new(&o.wall)),
                ..Default::default()
            })
            .unwrap();
        let speed: Vec<f64> = f
            .poses
            .windows(2)
            .map(|w| 25.0 * f64::from(w[0].position_mm.distance(w[1].position_mm)))
            .collect();
        let turn = greatest(turns(&f).iter().map(|t| 25.0 * t.0));
        let roll = greatest(turns(&f).iter().map(|t| t.1));
        assert!(roll < 0.1, "{}: rolls {roll} deg in a frame", kind.name());
        let fastest = greatest(speed.iter().copied());
        println!(
            "{}: {} frames, {fastest:.2} mm/s and {turn:.2} deg/s at most",
            kind.name(),
            f.poses.len()
        );
        assert!(fastest < 20.2 && turn < 30.2, "{}: {fastest} mm/s, {turn} deg/s", kind.name());
        let jerk = greatest(speed.windows(2).map(|w| (w[1] - w[0]).abs()));
        assert!(jerk < 2.0, "{}: speed jumps by {jerk} mm/s", kind.name());
        assert!(f.seconds.windows(2).all(|w| (w[1] - w[0] - 0.04).abs() < 1e-9));
    }
}

/// Whether the segment from `a` to `b` meets a triangle.
fn meets(a: Vec3, b: Vec3, t: [Vec3; 3]) -> bool {
    let [a, b, t0, t1, t2] = [a, b, t[0], t[1], t[2]].map(|v| v.as_dvec3());
    let d = b - a;
    let (e1, e2) = (t1 - t0, t2 - t0);
    let p = d.cross(e2);
    let det = e1.dot(p);
    if det.abs() < 1e-12 {
        return false;
    }
    let s = (a - t0) / det;
    let u = s.dot(p);
    let q = s.cross(e1);
    let v = d.dot(q);
    u >= 0.0 && v >= 0.0 && u + v <= 1.0 && (0.0..=1.0).contains(&e2.dot(q))
}

#[test]
fn no_near_plane_corner_reaches_the_wall_on_any_frame() {
    let deg = |d: f32| d.to_radians();
    for (kind, spacing) in [
        (Kind::Bend, [1.0; 3]),
        (Kind::Helix, [1.0; 3]),
        (Kind::Colon, [1.0; 3]),
        (Kind::Y, [0.7, 0.7, 1.5]),
    ] {
        let o = organ(kind, 64, spacing);
        for (fov_y_rad, aspect) in
            [(deg(90.0), 1.0), (deg(60.0), 16.0 / 9.0), (deg(120.0), 16.0 / 9.0), (deg(150.0), 2.4)]
        {
            let frames = Frames::Count(60);
            let f = o
                .fly(FlightOptions {
                    frames,
                    fov_y_rad,
                    aspect,
                    wall: Some(&TriangleBvh::new(&o.wall)),
                    reverse: false,
                })
                .unwrap();
            let nears = f.near_mm.iter().map(|n| f64::from(*n));
            println!(
                "{} {:3.0} deg {aspect:.2}: near {:.3} to {:.3} mm, margin {:.4} mm, {} moved",
                kind.name(),
                fov_y_rad.to_degrees(),
                nears.clone().fold(f64::MAX, f64::min),
                greatest(nears),
                f.min_margin_mm(),
                f.moved
            );
            assert!(f.min_margin_mm() > 0.0);
            for (i, pose) in f.poses.iter().enumerate() {
                let lens = f.lens(i);
                let t = (0.5 * fov_y_rad).tan() * lens.near_mm;
                let true_distance = nearest(&o.wall, pose.position_mm);
                assert!(true_distance > f.clearance_mm[i] - 1e-4, "{} frame {i}", kind.name());
                assert!(true_distance > f64::from(lens.near_ball_mm()));
                for (x, y) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
                    let corner = Vec3::new(x * aspect * t, y * t, -lens.near_mm);
                    let corner = pose.position_mm + pose.rotation * corner;
                    let hit = o.wall.faces.iter().any(|f| {
                        meets(pose.position_mm, corner, f.map(|v| o.wall.positions[v as usize]))
                    });
                    assert!(!hit, "{} frame {i}", kind.name());
                }
            }
        }
    }
}

/// Every triangle of the wall of a real colon against the view pyramid up to the near plane: rays
/// to its corners, and the distance from the eye.
#[test]
fn no_near_plane_corner_reaches_the_wall_of_a_real_colon() {
    let Some(data) = volumes::shared_data() else { return };
    let o = organ_of(&volumes::read(&data.join("colon_label_1.nii.gz")).unwrap());
    let (fov_y_rad, aspect) = (90f32.to_radians(), 16.0 / 9.0);
    let frames = Frames::Count(1000);
    let index = TriangleBvh::new(&o.wall);
    let wall: Option<&dyn WallDistance> = Some(&index);
    let f = o.fly(FlightOptions { frames, fov_y_rad, aspect, wall, reverse: false }).unwrap();
    // The frames with the least room, and some along the way.
    let mut tightest: Vec<usize> = (0..f.poses.len()).collect();
    tightest.sort_by(|a, b| f.clearance_mm[*a].total_cmp(&f.clearance_mm[*b]));
    let chosen = tightest.into_iter().take(16).chain((0..1000).step_by(63));
    let (mut least, mut looked) = (f64::MAX, 0);
    for i in chosen {
        let (pose, lens) = (f.poses[i], f.lens(i));
        let room = nearest(&o.wall, pose.position_mm) - f64::from(lens.near_ball_mm());
        (least, looked) = (least.min(room), looked + 1);
        assert!(room > 0.0, "frame {i}: the wall is {room} mm inside the near ball");
        let t = (0.5 * fov_y_rad).tan() * lens.near_mm;
        for (x, y) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
            let corner = Vec3::new(x * aspect * t, y * t, -lens.near_mm);
            let reach = |times: f32| pose.position_mm + pose.rotation * (times * corner);
            let met = |to: Vec3| {
                let corners = |f: &[u32; 3]| f.map(|v| o.wall.positions[v as usize]);
                o.wall.faces.iter().any(|f| meets(pose.position_mm, to, corners(f)))
            };
            assert!(!met(reach(1.0)), "frame {i}");
            // The lumen is closed: a ray that goes on meets its wall.
            assert!(met(reach(2000.0 / corner.length())), "frame {i}: no wall at all");
        }
    }
    println!("{looked} frames, {} triangles, {least:.3} mm at least", o.wall.faces.len());
}

/// Distance to the mesh by trying every triangle: corners, edges, plane.
fn nearest(mesh: &Mesh, p: Vec3) -> f64 {
    let p = p.as_dvec3();
    let all = mesh.faces.iter().map(|f| {
        let [a, b, c] = f.map(|v| mesh.positions[v as usize].as_dvec3());
        let edge = |u: DVec3, v: DVec3| {
            let t = ((p - u).dot(v - u) / (v - u).length_squared()).clamp(0.0, 1.0);
            p.distance(u.lerp(v, t))
        };
        let rim = edge(a, b).min(edge(b, c)).min(edge(c, a));
        let n = (b - a).cross(c - a).normalize_or_zero();
        let q = p - n * (p - a).dot(n);
        let side = |u: DVec3, v: DVec3| (v - u).cross(q - u).dot(n) >= 0.0;
        if n != DVec3::ZERO && side(a, b) && side(b, c) && side(c, a) { p.distance(q) } else { rim }
    });
    all.fold(f64::MAX, f64::min)
}

#[test]
fn every_way_from_root_to_leaf_of_a_tree_is_flown_through_its_corners() {
    let o = organ(Kind::Y, 96, [1.0; 3]);
    let mut plan = Plan::new();
    let buffers = LumenBuffers::new(&mut plan, &o.lumen);
    let d = distance(&mut plan, &buffers);
    let f = smooth(&mut plan, &buffers, d, 1.0, None);
    plan.download(f);
    let out = run_cpu(&plan);
    let options = RouteOptions { tree: true, ..Default::default() };
    let tree = centerline(&o.lumen, &o.distance, out.get(f), options).unwrap().line;
    assert!(tree.branches.len() >= 4);
    for branch in 0..tree.branches.len() {
        let path = tree.path_to(branch);
        for reverse in [false, true] {
            let frames = Frames::Speed { mm_per_s: 25.0, fps: 25.0 };
            let options = FlightOptions {
                frames,
                reverse,
                wall: Some(&TriangleBvh::new(&o.wall)),
                ..Default::default()
            };
            let f = Flight::new(&path, &o.lumen, &o.distance, options).unwrap();
            let turns = turns(&f);
            let gaze = greatest(turns.iter().map(|t| t.0));
            let roll = greatest(turns.iter().map(|t| t.1));
            println!(
                "branch {branch}: gaze {gaze:.2}, roll {roll:.4} deg a frame, {} moved",
                f.moved
            );
            assert!(gaze < 1.21 && roll < 0.1 && f.moved == 0 && f.min_margin_mm() > 0.0);
        }
    }
}

#[test]
fn a_waist_is_flown_at_the_share_of_speed_its_radius_has() {
    let mut organ = open_space(|s| DVec3::new(20.0 + s, 50.0, 50.0), 80.0, 0.5, 6.0);
    for p in &mut organ.path[60..100] {
        p.radius_mm = 3.0;
    }
    let frames = Frames::Speed { mm_per_s: 10.0, fps: 25.0 };
    let f = organ.fly(FlightOptions { frames, ..Default::default() }).unwrap();
    let speed_near = |x: f32| {
        let i = f.poses.iter().position(|p| p.position_mm.x >= x).unwrap();
        25.0 * f64::from(f.poses[i + 1].position_mm.x - f.poses[i].position_mm.x)
    };
    let (wide, waist) = (speed_near(30.0), speed_near(60.0));
    assert!((wide - 10.0).abs() < 0.2 && (waist - 5.0).abs() < 0.2, "{wide} {waist}");
}

#[test]
fn the_eye_looks_at_what_it_sees() {
    for (kind, spacing) in
        [(Kind::Bend, [1.0; 3]), (Kind::Helix, [1.0; 3]), (Kind::Colon, [0.8, 0.8, 1.6])]
    {
        let o = organ(kind, 64, spacing);
        let wall = Clearance::new(&o.lumen, &o.distance, None);
        let t = Track::new(&o.path, &wall, 0.8);
        let mut least = f64::MAX;
        for i in 0..t.eye.len() {
            assert!(wall.sees(t.eye[i], t.eye[i] + t.ahead_mm[i] * t.gaze[i]), "{}", kind.name());
            assert!(t.gaze[i].dot(t.up[i]).abs() < 1e-9);
            least = least.min(t.ahead_mm[i] / t.radius_mm[i]);
        }
        let mid = median(t.ahead_mm.iter().zip(&t.radius_mm).map(|(a, r)| a / r));
        println!("{}: looks {mid:.2} radii ahead (median), {least:.2} (least)", kind.name());
        assert!(least > 0.5);
    }
}

/// A straight lumen along x whose cross-section at x is `2 half(x) + 1` voxels square.
fn channel(half: impl Fn(u32) -> u32) -> Organ {
    use intima::lumen::BitVolume;
    use intima::volume::Grid;
    let grid = Grid::axis_aligned([60, 24, 24], [0.5; 3]);
    let mut bits = BitVolume::new(grid.dims);
    for v in (0..grid.len()).map(|i| grid.voxel(i)) {
        let h = half(v.x);
        if (4..56).contains(&v.x) && v.y.abs_diff(12) <= h && v.z.abs_diff(12) <= h {
            bits.set(v.x, v.y, v.z);
        }
    }
    let lumen = Lumen::of_volume(grid, &bits);
    let mut plan = Plan::new();
    let buffers = LumenBuffers::new(&mut plan, &lumen);
    let d = distance(&mut plan, &buffers);
    plan.download(d);
    let distance = run_cpu(&plan).get(d).to_vec();
    let wall = Surface::new(&lumen, &Midpoint, None).mesh;
    let point = |i: u32| CenterlinePoint {
        position_mm: DVec3::new(2.5 + 0.25 * f64::from(i), 6.0, 6.0),
        radius_mm: 0.5 * f64::from(half(5 + i / 2)) + 0.25,
        abscissa_mm: 0.25 * f64::from(i),
    };
    let path = (0..=99).map(point).collect();
    Organ { lumen, distance, path, wall }
}

#[test]
fn a_lumen_one_voxel_wide_is_flown_by_exact_distances_alone() {
    let o = channel(|x| if (25..35).contains(&x) { 0 } else { 4 });
    let options = FlightOptions { frames: Frames::Count(80), ..Default::default() };
    let f = o.fly(FlightOptions { wall: Some(&TriangleBvh::new(&o.wall)), ..options }).unwrap();
    let waist = (0..80).find(|&i| (f.poses[i].position_mm.x - 15.0).abs() < 1.0).unwrap();
    assert_eq!(f.moved, 0);
    assert!(f.near_mm[waist] >= 0.05 && f.near_mm[waist] < 0.25 && f.min_margin_mm() > 0.0);
    // The distance field alone proves nothing there, and everything in the wide parts.
    let g = o.fly(options).unwrap();
    assert!(g.moved > 0 && g.min_margin_mm() > 0.0);
    let thin = channel(|_| 0);
    assert!(matches!(thin.fly(options), Err(FlightError::NoRoom { frame: 0, .. })));
    assert!(
        thin.fly(FlightOptions { wall: Some(&TriangleBvh::new(&thin.wall)), ..options }).is_ok()
    );
}

#[test]
fn a_thin_lumen_is_not_flown_in_the_dark() {
    // Light falls off by the room about the eye; on the path through one voxel the clearance is a
    // fraction of that voxel, and the picture was black.
    let thin = channel(|_| 0);
    let voxel = thin.lumen.grid.voxel_mm3().cbrt();
    let options = FlightOptions { frames: Frames::Count(40), ..Default::default() };
    let f =
        thin.fly(FlightOptions { wall: Some(&TriangleBvh::new(&thin.wall)), ..options }).unwrap();
    let index = TriangleBvh::new(&thin.wall);
    let wall = Clearance::new(&thin.lumen, &thin.distance, Some(&index));
    let again = CameraPath::from(&f).fly(&wall, options.aspect).unwrap();
    for room in f.room_mm.iter().chain(&again.room_mm) {
        assert!(f64::from(*room) >= 0.999 * voxel, "{room} of {voxel} mm");
    }
    assert!(f.clearance_mm.iter().any(|c| *c < 0.5 * voxel), "thinner than a voxel");
}

#[test]
fn a_path_outside_the_lumen_is_refused_or_left_for_its_inside() {
    let mut o = channel(|_| 4);
    let options = FlightOptions { frames: Frames::Count(50), ..Default::default() };
    for p in &mut o.path[40..50] {
        p.position_mm.y += 4.0;
    }
    let f = o.fly(FlightOptions { wall: Some(&TriangleBvh::new(&o.wall)), ..options }).unwrap();
    assert!(f.moved > 0 && f.min_margin_mm() > 0.0);
    for p in &mut o.path {
        p.position_mm.y += 40.0;
    }
    let e = o.fly(FlightOptions { wall: Some(&TriangleBvh::new(&o.wall)), ..options }).unwrap_err();
    assert!(e.to_string().starts_with("frame 0 at (") && e.to_string().contains("0.000 mm"), "{e}");
}

#[test]
fn options_and_paths_that_cannot_be_flown_are_named() {
    let mut o = channel(|_| 4);
    let ok = FlightOptions::default();
    let said = |options| o.fly(options).unwrap_err().to_string();
    assert!(said(FlightOptions { frames: Frames::Count(0), ..ok }).contains("frames is 0"));
    assert!(said(FlightOptions { frames: Frames::Count(1 << 30), ..ok }).contains("frames"));
    assert!(said(FlightOptions { fov_y_rad: f32::NAN, ..ok }).contains("NaN"));
    assert!(said(FlightOptions { aspect: 0.0, ..ok }).contains("height"));
    for (mm_per_s, fps) in [(f64::NAN, 25.0), (0.0, 25.0), (10.0, 0.0), (0.01, 1000.0)] {
        said(FlightOptions { frames: Frames::Speed { mm_per_s, fps }, ..ok });
    }
    o.path[7].position_mm.z = f64::NAN;
    assert_eq!(o.fly(ok), Err(FlightError::NotFinite(7)));
    o.path.truncate(1);
    assert_eq!(o.fly(ok), Err(FlightError::TooShort { length_mm: 0.0 }));
    o.path.clear();
    assert!(matches!(o.fly(ok), Err(FlightError::TooShort { .. })));
}

#[test]
fn one_or_two_frames_and_two_points_are_a_flight() {
    let mut o = channel(|_| 4);
    let wall = TriangleBvh::new(&o.wall);
    let two =
        |n| FlightOptions { frames: Frames::Count(n), wall: Some(&wall), ..Default::default() };
    assert_eq!(o.fly(two(1)).unwrap().seconds, [0.0]);
    o.path = vec![o.path[0], o.path[60]];
    let f = o.fly(two(2)).unwrap();
    let ends: Vec<f32> = f.poses.iter().map(|p| p.position_mm.x).collect();
    assert!((ends[0] - 2.5).abs() < 1e-4 && (ends[1] - 17.5).abs() < 1e-4, "{ends:?}");
}

#[test]
fn a_written_flight_is_flown_again_and_a_pose_in_the_wall_is_named() {
    let o = organ(Kind::Bend, 48, [1.0; 3]);
    let index = TriangleBvh::new(&o.wall);
    let options = FlightOptions { wall: Some(&index), ..Default::default() };
    let f = o.fly(options).unwrap();
    assert_eq!(o.fly(options).unwrap(), f, "a second flight is the same");
    let json = CameraPath::from(&f).to_json();
    let script = CameraPath::parse(json.as_bytes()).unwrap();
    let wall = Clearance::new(&o.lumen, &o.distance, Some(&index));
    let again = script.fly(&wall, options.aspect).unwrap();
    for i in 0..f.poses.len() {
        assert_eq!(again.poses[i].position_mm, f.poses[i].position_mm);
        assert!(again.poses[i].rotation.angle_between(f.poses[i].rotation) < 1e-3);
        assert!((again.near_mm[i] - f.near_mm[i]).abs() < 1e-6);
    }
    assert!(script.resampled(333).fly(&wall, 2.0).unwrap().min_margin_mm() > 0.0);
    let mut bad = script.clone();
    bad.shots[30].position_mm += DVec3::splat(30.0);
    let e = bad.fly(&wall, 1.0).unwrap_err();
    assert!(matches!(e, FlightError::NoRoom { frame: 30, .. }), "{e}");
    // A near plane that is asked for too far out is drawn in, not refused.
    let mut far = script;
    far.shots.iter_mut().for_each(|s| s.near_mm = 50.0);
    assert!(far.fly(&wall, 1.0).unwrap().min_margin_mm() > 0.0);
}

#[test]
fn random_moves_never_bring_the_near_ball_to_the_wall() {
    let moves: u64 = if cfg!(debug_assertions) { 20_000 } else { 1_000_000 };
    for kind in [Kind::Bend, Kind::Colon] {
        let o = organ(kind, 64, [1.0; 3]);
        let exact = TriangleBvh::new(&o.wall);
        let wall = Clearance::new(&o.lumen, &o.distance, Some(&exact));
        let lens = intima::geometry::Lens { fov_y_rad: 1.6, aspect: 1.5, near_mm: 0.4 };
        let rho = f64::from(lens.near_ball_mm());
        let mut at = o.path[o.path.len() / 2].position_mm;
        let (mut least, mut gone) = (f64::MAX, 0.0);
        for i in 0..moves / 2 {
            // long and short moves, and now and then a drift that keeps pressing on the wall
            let size = [0.1, 1.0, 4.0, 30.0][i as usize % 4];
            let to = collide_and_slide(at, noise(i, size) + noise(i / 50, 1.0), &wall, lens);
            gone += to.distance(at);
            at = to;
            assert!(wall.holds(at), "{} move {i}", kind.name());
            least = least.min(exact.distance(at, 10.0));
        }
        println!(
            "{}: {gone:.0} mm in {} moves, least room {:.4} mm",
            kind.name(),
            moves / 2,
            least - rho
        );
        assert!(least >= 1.05 * rho - 1e-6 && gone > moves as f64 * 0.05);
    }
}

#[test]
fn the_bound_never_exceeds_the_true_distance_on_grids_of_any_pose() {
    use intima::volume::Grid;
    let turned = glam::DMat3::from_euler(glam::EulerRot::XYZ, 0.4, -0.7, 1.1);
    let mirrored = glam::DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
    for direction in [glam::DMat3::IDENTITY, turned, turned * mirrored] {
        let mut volume = Phantom::new(Kind::Colon, 48, [0.7, 1.0, 2.0]).unwrap().mask();
        let (dims, h) = (volume.grid.dims.to_array().map(u64::from), volume.grid.spacing_mm);
        volume.grid = Grid::new(dims, h, DVec3::new(-70.0, 30.0, 900.0), direction).unwrap();
        let o = organ_of(&volume);
        let index = TriangleBvh::new(&o.wall);
        let wall = Clearance::new(&o.lumen, &o.distance, Some(&index));
        let (mut most, mut used, mut sharp) = (f64::MIN, 0, 0.0f64);
        for (i, p) in o.path.iter().cycle().take(3000).enumerate() {
            let at = p.position_mm + noise(i as u64, 0.6 * p.radius_mm);
            let exact = wall.exact_mm(at, 50.0).unwrap();
            let bound = wall.bound_mm(at);
            most = most.max(bound - exact);
            used += usize::from(bound > 0.0);
            sharp = sharp.max(bound / exact.max(1e-9));
            if exact > 0.0 {
                let away = wall.away(at).map(|a| wall.exact_mm(at + 0.05 * exact * a, 50.0));
                assert!(away.is_none_or(|d| d.unwrap() > 0.9 * exact), "away from the wall");
            }
        }
        println!(
            "bound less distance {most:.3} mm at most, {used} of 3000 proven, best {sharp:.2}"
        );
        assert!(most <= 0.0 && used > 100 && sharp > 0.4);
    }
}
