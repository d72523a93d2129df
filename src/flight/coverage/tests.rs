use std::f32::consts::{FRAC_PI_2, TAU};

use glam::Vec3;

use super::{Coverage, CoverageMap};
use crate::geometry::shapes::{boxed, sphere};
use crate::geometry::{Lens, Mesh, Pose, TriangleBvh};
use crate::lod::ExteriorGrid;
use crate::surface::Adjacency;

/// Coverage of a wall, with the space outside it where it is closed.
fn coverage(wall: &Mesh, there: &[(Pose, Lens)], back: &[(Pose, Lens)]) -> Coverage {
    let is_closed = wall.positions.iter().all(|p| p.is_finite()) && Adjacency::of(wall).1;
    let exterior = is_closed.then(|| ExteriorGrid::new(wall, 10_000));
    let tree = TriangleBvh::new(wall);
    super::coverage(CoverageMap::new(wall, &tree, exterior.as_ref()), there, back, &arcs(there))
}

/// Length of the straight ways from eye to eye.
fn arcs(views: &[(Pose, Lens)]) -> Vec<f64> {
    let mut arc = 0.0;
    let mut last = views.first().map(|v| v.0.position_mm);
    let up_to = |v: &(Pose, Lens)| {
        arc +=
            f64::from(v.0.position_mm.distance(last.replace(v.0.position_mm).unwrap_or_default()));
        arc
    };
    views.iter().map(up_to).collect()
}

/// Views along the six axes, 90 degrees wide: everything about a place.
fn cube_views(eye: Vec3) -> Vec<(Pose, Lens)> {
    let along = [Vec3::X, Vec3::Y, Vec3::Z];
    along.into_iter().flat_map(|a| [a, -a]).map(|a| view(eye, a, FRAC_PI_2)).collect()
}

fn view(eye: Vec3, forward: Vec3, fov_y_rad: f32) -> (Pose, Lens) {
    let up = if forward.x.abs() > 0.5 { Vec3::Y } else { Vec3::X };
    (Pose::looking(eye, forward, up), Lens { fov_y_rad, aspect: 1.0, near_mm: 0.05 })
}

/// Rings of `sides` vertices about the z axis at each (z, radius); where a radius is 0 the ring
/// closes in a point. Normals point inwards.
fn revolved(profile: &[(f32, f32)], sides: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let rings: Vec<Vec<u32>> = profile
        .iter()
        .map(|(z, r)| {
            let first = mesh.positions.len() as u32;
            let count = if *r > 0.0 { sides } else { 1 };
            for k in 0..count {
                let a = TAU * k as f32 / sides as f32;
                mesh.positions.push(Vec3::new(r * a.cos(), r * a.sin(), *z));
            }
            (0..sides).map(|k| first + k % count).collect()
        })
        .collect();
    for pair in rings.windows(2) {
        for k in 0..sides as usize {
            let l = (k + 1) % sides as usize;
            let (a, b, c, d) = (pair[0][k], pair[1][k], pair[1][l], pair[0][l]);
            mesh.faces.extend(
                [[a, b, c], [a, c, d]].into_iter().filter(|[u, v, w]| u != v && v != w && w != u),
            );
        }
    }
    if mesh.volume_mm3() < 0.0 {
        mesh.faces.iter_mut().for_each(|f| f.swap(1, 2));
    }
    mesh
}

/// Points every half millimetre along a profile's corners.
fn refined(corners: &[(f32, f32)]) -> Vec<(f32, f32)> {
    let mut out = vec![corners[0]];
    for w in corners.windows(2) {
        let ((z, r), (z1, r1)) = (w[0], w[1]);
        let n = (2.0 * (z1 - z).hypot(r1 - r)).ceil();
        out.extend((1..=n as usize).map(|i| {
            let t = i as f32 / n;
            (z + t * (z1 - z), r + t * (r1 - r))
        }));
    }
    out
}

const RADIUS: f32 = 15.0;
const HOLE: f32 = 8.0;
const FOLD: std::ops::Range<f32> = 30.0..32.0;
const LENGTH: f32 = 60.0;

/// A tube along z with one ring-shaped fold across it, closed by discs.
fn folded_tube() -> Mesh {
    let corners = [
        (0.0, 0.0),
        (0.0, RADIUS),
        (FOLD.start, RADIUS),
        (FOLD.start, HOLE),
        (FOLD.end, HOLE),
        (FOLD.end, RADIUS),
        (LENGTH, RADIUS),
        (LENGTH, 0.0),
    ];
    revolved(&refined(&corners), 96)
}

/// Eyes on the axis of the tube every half millimetre, looking along it.
fn along_tube(forward: Vec3) -> Vec<(Pose, Lens)> {
    let eyes = (2..=118).map(|i| Vec3::new(0.0, 0.0, 0.5 * i as f32));
    let mut views: Vec<_> = eyes.map(|eye| view(eye, forward, 170f32.to_radians())).collect();
    if forward.z < 0.0 {
        views.reverse();
    }
    views
}

#[test]
fn a_cube_camera_in_a_sphere_covers_all_of_it_and_each_side_a_sixth() {
    let wall = sphere(10.0, 24);
    let all = coverage(&wall, &cube_views(Vec3::ZERO), &[]);
    assert_eq!((all.one_way_fraction, all.both_ways_fraction), (1.0, 1.0));
    assert!(all.patches.is_empty() && all.smaller_patches == 0);
    assert!((all.area_mm2 / wall.area_mm2() - 1.0).abs() < 1e-6);
    for side in cube_views(Vec3::ZERO) {
        let one = coverage(&wall, &[side], &[]);
        assert!((one.one_way_fraction - 1.0 / 6.0).abs() < 1e-6, "{}", one.one_way_fraction);
        // What is missed hangs together.
        assert_eq!((one.patches.len(), one.smaller_patches), (1, 0));
        assert!((one.patches[0].area_mm2 / one.area_mm2 - 5.0 / 6.0).abs() < 1e-6);
    }
}

#[test]
fn a_screen_hides_its_own_back_and_its_shadow_on_the_wall_behind() {
    let mut wall = boxed(64);
    wall.positions.iter_mut().for_each(|p| *p *= 10.0);
    // A square of 5 mm half way to the wall at +x throws a shadow of 10 mm.
    let first = wall.positions.len() as u32;
    for (y, z) in [(-2.5, -2.5), (2.5, -2.5), (2.5, 2.5), (-2.5, 2.5)] {
        wall.positions.push(Vec3::new(5.0, y, z));
    }
    let [a, b, c, d] = [0, 1, 2, 3].map(|k| first + k);
    wall.faces.extend([[a, c, b], [a, d, c], [a, b, c], [a, c, d]]);
    let front = wall.faces.len() - 4;
    assert!(wall.face_cross(wall.faces[front]).x < 0.0, "the first two look at the eye");
    let seen = coverage(&wall, &[view(Vec3::ZERO, Vec3::X, FRAC_PI_2)], &[]);
    let want = (400.0 - 100.0 + 25.0) / (2400.0 + 50.0);
    assert!((seen.one_way_fraction - want).abs() < 1e-6, "{} {want}", seen.one_way_fraction);
    assert_eq!(seen.seen_one_way[front..], [true, true, false, false]);
    let all = coverage(&wall, &cube_views(Vec3::ZERO), &[]);
    let patches: Vec<f64> = all.patches.iter().map(|p| p.area_mm2).collect();
    assert_eq!((patches.len(), all.smaller_patches), (0, 2), "{patches:?}");
    assert!((all.smaller_patches_mm2 - 125.0).abs() < 1e-3);
}

#[test]
fn one_way_misses_the_back_of_a_fold_and_what_is_behind_the_start_and_both_ways_nothing() {
    let wall = folded_tube();
    let there = along_tube(Vec3::Z);
    let back = along_tube(Vec3::NEG_Z);
    let both = coverage(&wall, &there, &back);
    let disc = f64::from(RADIUS * RADIUS) * std::f64::consts::PI;
    let ring = disc - f64::from(HOLE * HOLE) * std::f64::consts::PI;
    let missed = (1.0 - both.one_way_fraction) * both.area_mm2;
    // By the lens alone a strip beside the first eye and one behind the fold are missed too:
    // cot 85° of the radius, less the hole behind the fold, and 1 mm before the first eye.
    let strip = f64::from(RADIUS) * std::f64::consts::TAU;
    let cot = 85f64.to_radians().tan().recip();
    let most = strip * (1.0 + cot * f64::from(RADIUS) + 0.5)
        + strip * (cot * f64::from(RADIUS - HOLE) + 0.5);
    println!("missed one way {missed:.1} mm2: {:.1} to {:.1}", disc + ring, disc + ring + most);
    assert!(missed > 0.995 * (disc + ring) && missed < disc + ring + most);
    let back_of_fold = |f: usize| {
        let corners = wall.faces[f].map(|v| wall.positions[v as usize]);
        corners.iter().all(|p| p.z == FOLD.end)
    };
    let all: Vec<usize> = (0..wall.faces.len()).filter(|f| back_of_fold(*f)).collect();
    assert!(all.len() > 1000);
    assert!(all.iter().all(|f| !both.seen_one_way[*f] && both.seen_both_ways[*f]));
    assert_eq!((both.both_ways_fraction, both.patches.len()), (1.0, 0));

    let one = coverage(&wall, &there, &[]);
    assert_eq!(one.seen_both_ways, both.seen_one_way);
    // The two missed places, the disc with its strip first; each with its place along the flight.
    let [start, fold] = &one.patches[..] else { panic!("{:?}", one.patches) };
    assert!(start.area_mm2 > disc * 0.995 && start.area_mm2 < disc + most);
    assert!(fold.area_mm2 > ring * 0.995 && fold.area_mm2 < ring + most);
    assert!(start.arc_mm < 3.0 && (fold.arc_mm - 31.0).abs() < 2.5, "{one:?}");
    assert!(fold.center_mm.truncate().length() < 0.01);
    let sum = start.area_mm2 + fold.area_mm2 + one.smaller_patches_mm2;
    assert!((sum - missed).abs() < 1e-6 * missed);
    let faces =
        |number| one.patch_of_face.iter().filter(|p| p.is_some_and(|p| p.get() == number)).count();
    assert_eq!([faces(1), faces(2)], [start.faces, fold.faces]);
}

#[test]
fn the_back_of_a_wall_is_not_seen_through_an_open_end() {
    let mut wall = folded_tube();
    let disc = |f: &[u32; 3]| f.iter().all(|v| wall.positions[*v as usize].z == 0.0);
    wall.faces = wall.faces.iter().copied().filter(|f| !disc(f)).collect();
    // From outside, beside the tube and through its open end.
    let outside = [Vec3::new(60.0, 0.0, 20.0), Vec3::new(0.0, 60.0, 40.0)];
    let looking = |eye: &Vec3| view(*eye, Vec3::Z * 30.0 - *eye, FRAC_PI_2);
    let none = coverage(&wall, &outside.iter().map(looking).collect::<Vec<_>>(), &[]);
    assert_eq!(none.one_way_fraction, 0.0);
    let end = view(Vec3::new(0.0, 0.0, -20.0), Vec3::Z, FRAC_PI_2);
    assert!(coverage(&wall, &[end], &[]).one_way_fraction > 0.1);
}

#[test]
fn caps_hide_what_is_behind_them_and_do_not_count() {
    let mut wall = folded_tube();
    let z_all = |f: &[u32; 3], z: f32| f.iter().all(|v| wall.positions[*v as usize].z == z);
    wall.caps = wall.faces.iter().map(|f| z_all(f, 0.0) || z_all(f, LENGTH)).collect();
    let seen = coverage(&wall, &along_tube(Vec3::Z), &along_tube(Vec3::NEG_Z));
    let cap: f64 = wall
        .faces
        .iter()
        .zip(&wall.caps)
        .filter(|(_, c)| **c)
        .map(|(f, _)| 0.5 * f64::from(wall.face_cross(*f).length()))
        .sum();
    assert!((seen.area_mm2 + cap - wall.area_mm2()).abs() < 1e-3);
    assert_eq!(seen.both_ways_fraction, 1.0);
    let end = view(Vec3::new(0.0, 0.0, -20.0), Vec3::Z, FRAC_PI_2);
    assert_eq!(coverage(&wall, &[end], &[]).one_way_fraction, 0.0);
}

#[test]
fn walls_without_faces_area_or_views_have_no_coverage() {
    let none = coverage(&Mesh::default(), &cube_views(Vec3::ZERO), &[]);
    assert_eq!((none.one_way_fraction, none.area_mm2), (0.0, 0.0));
    let wall = sphere(10.0, 4);
    let unseen = coverage(&wall, &[], &[]);
    assert_eq!((unseen.both_ways_fraction, unseen.patches.len()), (0.0, 1));
    let mut odd = wall.clone();
    odd.positions.extend([Vec3::NAN, Vec3::ZERO]);
    let n = wall.positions.len() as u32;
    odd.faces.extend([[0, 1, n], [n + 1, n + 1, n + 1], [0, 0, 1]]);
    let seen = coverage(&odd, &cube_views(Vec3::ZERO), &[]);
    assert_eq!(seen.one_way_fraction, 1.0);
    assert_eq!(seen.seen_one_way[wall.faces.len()..], [false; 3]);
    assert_eq!(seen.patch_of_face, vec![None; odd.faces.len()]);
}

#[test]
fn coverage_is_the_same_at_any_number_of_threads_and_in_any_order_of_views() {
    let wall = folded_tube();
    let (there, back) = (along_tube(Vec3::Z), along_tube(Vec3::NEG_Z));
    let want = coverage(&wall, &there[20..60], &back[90..]);
    for threads in [1, 2, 3, 8] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| coverage(&wall, &there[20..60], &back[90..])), want);
    }
    let reversed: Vec<_> = there[20..60].iter().rev().copied().collect();
    let other = coverage(&wall, &reversed, &back[90..]);
    assert_eq!(
        (other.seen_one_way, other.seen_both_ways),
        (want.seen_one_way, want.seen_both_ways)
    );
}

#[test]
fn the_arc_length_of_a_missed_patch_is_that_of_the_path() {
    let mut wall = sphere(10.0, 24);
    let other = wall.clone();
    let first = wall.positions.len() as u32;
    wall.positions.extend(other.positions.iter().map(|p| *p + 100.0 * Vec3::X));
    wall.faces.extend(other.faces.iter().map(|f| f.map(|v| v + first)));
    // Two eyes in each sphere, all looking away from the half that is missed.
    let eyes = [0.0, 2.0, 100.0, 103.0].map(|x| view(x * Vec3::X, Vec3::X, FRAC_PI_2));
    let tree = TriangleBvh::new(&wall);
    let arcs = |arcs_mm: &[f64]| {
        let seen = super::coverage(CoverageMap::new(&wall, &tree, None), &eyes, &[], arcs_mm);
        let mut arcs: Vec<f64> = seen.patches.iter().map(|p| p.arc_mm).collect();
        arcs.sort_by(f64::total_cmp);
        arcs
    };
    assert_eq!(arcs(&[0.0, 2.0, 2.0, 5.0]), [0.0, 2.0]);
    assert_eq!(
        arcs(&[0.0, 2.5, 102.5, 106.0]),
        [0.0, 102.5],
        "the path is longer than the eye's way"
    );
}
