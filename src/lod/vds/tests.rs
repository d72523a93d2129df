mod ring;

use std::collections::{HashMap, HashSet};
use std::f64::consts::TAU;
use std::sync::Arc;

use glam::{DVec3, Vec3};

pub(super) use ring::{Flat, Ring};

use super::fineness::level;
use super::*;
use crate::geometry::{Camera, Lens, Mesh, Pose, point_triangle_distance};
use crate::lod::{LodHierarchy, LodStep, PageCache, Tolerance, Upload};
use ring::RING_MM;

/// Page contents as on the device.
#[derive(Default)]
struct Device(HashMap<u32, Upload>);

impl Device {
    fn apply(&mut self, step: &LodStep) {
        for u in &step.uploads {
            assert!(u.vertices.len() <= 128 && u.triangles.len() <= 128 && !u.triangles.is_empty());
            self.0.insert(u.page, u.clone());
        }
    }

    /// Corners of all triangles that are drawn.
    fn triangles(&self, step: &LodStep) -> Vec<[Vec3; 3]> {
        let mut all = Vec::new();
        for d in &step.drawn {
            let u = &self.0[&d.page];
            assert_eq!(u.triangles.len(), d.triangles as usize);
            for t in &u.triangles {
                let corners = t.map(|v| u.vertices[usize::from(v)].position());
                for c in corners {
                    assert!(d.sphere.centre.distance(c) <= d.sphere.radius * (1.0 + 1e-6));
                }
                all.push(corners);
            }
        }
        all
    }
}

/// Whether every directed edge, told by the bits of its ends, has its reverse.
fn closed(triangles: &[[Vec3; 3]]) -> bool {
    let mut open: HashMap<([u32; 3], [u32; 3]), i32> = HashMap::new();
    let bits = |p: Vec3| p.to_array().map(f32::to_bits);
    for t in triangles {
        for e in 0..3 {
            let (a, b) = (bits(t[e]), bits(t[(e + 1) % 3]));
            if a < b {
                *open.entry((a, b)).or_default() += 1;
            } else {
                *open.entry((b, a)).or_default() -= 1;
            }
        }
    }
    !triangles.is_empty() && open.values().all(|n| *n == 0)
}

fn noise(seed: &mut u64) -> f64 {
    *seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
    (*seed >> 40) as f64 / (1u64 << 24) as f64
}

/// A camera near the middle of the ring's tube, looking along it, give or take.
fn camera(seed: &mut u64) -> Camera {
    let mut v = |s: f64| s * (2.0 * noise(seed) - 1.0);
    let u = v(TAU / 2.0);
    let (radial, along) = (DVec3::new(u.cos(), u.sin(), 0.0), DVec3::new(-u.sin(), u.cos(), 0.0));
    let at = radial * (RING_MM + v(4.0)) + DVec3::Z * v(4.0);
    let to = at + along + radial * v(0.8) + DVec3::Z * v(0.8);
    Camera {
        pose: Pose::looking(at.as_vec3(), to.as_vec3(), Vec3::Z),
        lens: Lens { fov_y_rad: 1.4, aspect: 1.5, near_mm: 0.2 },
        height_px: 600,
    }
}

const PIXELS: Tolerance = Tolerance { pixels: 4.0 };

fn surface(options: VdsOptions) -> Arc<SubdivisionSurface> {
    let ring = Ring::new([20, 10], 5);
    Arc::new(SubdivisionSurface::new(&ring.base(), &ring, options).unwrap())
}

fn leaves_of(n: u32) -> VdsOptions {
    VdsOptions { leaf_faces: n, ..VdsOptions::default() }
}

fn settle(vds: &mut Vds, camera: &Camera, cache: &mut PageCache, device: &mut Device) -> LodStep {
    for _ in 0..2000 {
        cache.begin_step();
        let step = vds.step(camera, &PIXELS, cache);
        device.apply(&step);
        if step.settled {
            return step;
        }
    }
    panic!("not settled after 2000 steps");
}

#[test]
fn cuts_are_watertight_during_geomorphs_and_levels_differ_by_at_most_one() {
    for morph in [true, false] {
        let surface = surface(VdsOptions { morph, ..leaves_of(6) });
        let mut vds = Vds::new(surface.clone());
        let (mut cache, mut device) = (PageCache::new(4000, 4000, 2), Device::default());
        let (mut templates, mut levels) = (0u32, HashSet::new());
        let seed = &mut 11;
        for _ in 0..30 {
            let step = settle(&mut vds, &camera(seed), &mut cache, &mut device);
            assert!(!step.degraded && closed(&device.triangles(&step)));
            for f in 0..surface.base.faces.len() as u32 {
                let own = vds.face[f as usize];
                levels.insert(level(own));
                for g in (0..3).filter_map(|e| surface.base.across(f, e)) {
                    assert!(own.abs_diff(vds.face[g as usize]) <= 8);
                }
            }
            for b in vds.now.iter().flatten().flat_map(|p| p.blocks()) {
                templates |= 1 << b.split.iter().fold(0, |m, s| m << 1 | u32::from(*s));
            }
        }
        assert_eq!(templates, 0xff, "the plain triangle and all seven templates");
        assert_eq!(levels.len(), surface.depth() as usize + 1);
    }
}

/// The check for cracks can fail: sampled from both faces, edges crack as soon as the two answers
/// differ in their last bits.
#[test]
fn edges_sampled_from_both_faces_crack() {
    for (jitter, apart, want) in [(0.0, true, true), (1e-5, false, true), (1e-5, true, false)] {
        let mut ring = Ring::new([20, 10], 5);
        ring.jitter = jitter;
        let mut base = ring.base();
        if apart {
            // Every face has its own corners, so that no edge is shared.
            base.positions =
                base.faces.iter().flatten().map(|v| base.positions[*v as usize]).collect();
            base.faces =
                (0..base.faces.len() as u32).map(|f| [0, 1, 2].map(|c| 3 * f + c)).collect();
        }
        let surface = Arc::new(SubdivisionSurface::new(&base, &ring, leaves_of(6)).unwrap());
        let mut vds = Vds::new(surface);
        let (mut cache, mut device) = (PageCache::new(4000, 4000, 2), Device::default());
        let step = settle(&mut vds, &camera(&mut 3), &mut cache, &mut device);
        assert!(closed(&device.triangles(&step)) || apart);
        // The same level everywhere: faces without shared edges cannot be balanced.
        cache.begin_step();
        let mut step = LodStep::default();
        let finest = vec![8 * vds.surface().depth() as u8; vds.surface().leaves()];
        assert!(vds.commit(vds.cut_for(finest), &mut cache, &mut step.uploads));
        device.apply(&step);
        step.drawn = vds.drawn.iter().flatten().copied().collect();
        let all = device.triangles(&step);
        assert_eq!(all.len() as u64, vds.finest_faces());
        assert_eq!(closed(&all), want, "jitter {jitter}, apart {apart}");
    }
}

#[test]
fn every_intermediate_cut_is_watertight_for_any_page_and_upload_budget() {
    let surface = surface(leaves_of(6));
    let least = Vds::new(surface.clone()).least_pages();
    let (mut settled, mut degraded) = (0, 0);
    for (pages, uploads, in_flight) in [
        (least, 4, 1),
        (2 * least, 1, 2),
        (2 * least + 25, 3, 3),
        (3 * least, 40, 2),
        (4 * least, 1, 0),
    ] {
        let mut vds = Vds::new(surface.clone());
        let (mut cache, mut device) =
            (PageCache::new(pages, uploads, in_flight), Device::default());
        let seed = &mut 5;
        let mut cam = camera(seed);
        let mut begun = false;
        for i in 0..400 {
            if i % 40 == 39 {
                cam = camera(seed);
            }
            cache.begin_step();
            let step = vds.step(&cam, &PIXELS, &mut cache);
            assert!(step.uploads.len() <= uploads as usize);
            let fresh: HashSet<u32> = step.uploads.iter().map(|u| u.page).collect();
            assert_eq!(fresh.len(), step.uploads.len(), "a page is written once a step");
            device.apply(&step);
            begun |= !step.drawn.is_empty();
            assert!(!begun || closed(&device.triangles(&step)), "step {i}, {pages} pages");
            settled += u32::from(step.settled);
            degraded += u32::from(step.degraded);
        }
        assert!(begun);
        // From every state it settles.
        let step = settle(&mut vds, &cam, &mut cache, &mut device);
        let mut anew = Vds::new(surface.clone());
        let other =
            settle(&mut anew, &cam, &mut PageCache::new(pages, 10_000, 0), &mut Device::default());
        assert_eq!((vds.state_hash(), step.degraded), (anew.state_hash(), other.degraded));
        assert!(step.drawn.len() <= (pages / 2).max(least) as usize);
    }
    assert!(settled > 50 && degraded > 50, "{settled} {degraded}");
    let mut vds = Vds::new(surface);
    let mut cache = PageCache::new(least - 1, 100, 1);
    cache.begin_step();
    let step = vds.step(&camera(&mut 1), &PIXELS, &mut cache);
    assert!(step.settled && step.degraded && step.drawn.is_empty() && step.uploads.is_empty());
}

#[test]
fn the_settled_cut_does_not_depend_on_earlier_cameras() {
    let surface = surface(leaves_of(6));
    let mut vds = Vds::new(surface.clone());
    let (mut cache, mut device) = (PageCache::new(1500, 20, 2), Device::default());
    let (mut changed, mut kept) = (0, 0);
    let seed = &mut 77;
    for i in 0..500u32 {
        // A flight round the ring, with a jump now and then.
        let mut cam = camera(seed);
        if i % 50 != 0 {
            let u = f64::from(i) * 0.02;
            let (x, y) = (u.cos(), u.sin());
            let at = DVec3::new(x, y, 0.0) * RING_MM;
            cam.pose =
                Pose::looking(at.as_vec3(), (at + DVec3::new(-y, x, 0.1)).as_vec3(), Vec3::Z);
        }
        cache.begin_step();
        let step = vds.step(&cam, &PIXELS, &mut cache);
        device.apply(&step);
        changed += step.leaves_changed;
        kept += u32::from(!step.settled);
        if i % 100 != 99 {
            continue;
        }
        let step = settle(&mut vds, &cam, &mut cache, &mut device);
        let mut anew = Vds::new(surface.clone());
        let (mut other_pool, mut other) = (PageCache::new(1500, 1500, 2), Device::default());
        let scratch = settle(&mut anew, &cam, &mut other_pool, &mut other);
        assert_eq!(vds.state_hash(), anew.state_hash());
        assert_eq!(device.triangles(&step), other.triangles(&scratch));
        let same = |a: &[crate::lod::VisiblePatch], b: &[crate::lod::VisiblePatch]| {
            a.len() == b.len()
                && a.iter().zip(b).all(|(a, b)| (a.sphere, a.cone) == (b.sphere, b.cone))
        };
        assert!(same(&step.drawn, &scratch.drawn));
        // Standing still changes nothing and writes nothing.
        cache.begin_step();
        let again = vds.step(&cam, &PIXELS, &mut cache);
        assert!(again.settled && again.uploads.is_empty() && again.leaves_changed == 0);
        assert_eq!(again.drawn, step.drawn);
    }
    assert!(changed > 300 && kept > 10, "{changed} {kept}");
}

#[test]
fn returning_to_an_earlier_camera_uploads_nothing() {
    let mut vds = Vds::new(surface(leaves_of(6)));
    let (mut cache, mut device) = (PageCache::new(4000, 4000, 2), Device::default());
    let (a, b) = (camera(&mut 1), camera(&mut 2));
    let first = settle(&mut vds, &a, &mut cache, &mut device);
    settle(&mut vds, &b, &mut cache, &mut device);
    cache.begin_step();
    let back = vds.step(&a, &PIXELS, &mut cache);
    assert!(back.settled && back.uploads.is_empty());
    assert_eq!(back.drawn, first.drawn);
}

#[test]
fn steps_have_the_same_bytes_at_any_thread_count() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut vds = Vds::new(surface(leaves_of(6)));
            let mut cache = PageCache::new(2000, 200, 2);
            let seed = &mut 9;
            let step = |_| {
                cache.begin_step();
                vds.step(&camera(seed), &PIXELS, &mut cache)
            };
            (0..12).map(step).collect::<Vec<_>>()
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn an_open_base_has_no_boundary_but_its_own() {
    let ring = Ring::new([20, 10], 5);
    let mut base = ring.base();
    // A fifth of the ring is taken out; face ids of the rest stay what they were.
    base.faces.truncate(320);
    let surface = Arc::new(SubdivisionSurface::new(&base, &ring, leaves_of(6)).unwrap());
    let mut vds = Vds::new(surface);
    let (mut cache, mut device) = (PageCache::new(4000, 4000, 2), Device::default());
    for s in 0..8 {
        let step = settle(&mut vds, &camera(&mut (s * 71)), &mut cache, &mut device);
        let mut sum: HashMap<([u32; 3], [u32; 3]), i32> = HashMap::new();
        for t in device.triangles(&step) {
            let bits = t.map(|p| p.to_array().map(f32::to_bits));
            for e in 0..3 {
                let (a, b) = (bits[e], bits[(e + 1) % 3]);
                *sum.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
            }
        }
        // The rims lie in two planes through the ring's axis.
        for ((a, b), n) in sum {
            let u = |p: [u32; 3]| {
                f64::from(f32::from_bits(p[1])).atan2(f64::from(f32::from_bits(p[0])))
            };
            let rim = |u: f64| u.abs() < 1e-3 || (u - (0.8 * TAU - TAU)).abs() < 1e-3;
            assert_eq!(n != 0, rim(u(a)) && rim(u(b)), "{n} at {} {}", u(a), u(b));
        }
    }
}

#[test]
fn invalid_base_meshes_are_refused_and_non_manifold_ones_are_drawn() {
    let ring = Ring::new([20, 10], 5);
    let new = |base: &Mesh, o| SubdivisionSurface::new(base, &ring, o).map(|_| ());
    let mut base = ring.base();
    assert_eq!(new(&Mesh::default(), leaves_of(6)), Err(VdsError::Empty));
    let zero = new(&base, leaves_of(0)).unwrap_err();
    assert_eq!(zero.to_string(), "leaf_faces is 0, must be 1 to 128");
    let deep = VdsOptions { depth: Some(9), ..leaves_of(6) };
    assert!(matches!(new(&base, deep), Err(VdsError::Option { name: "depth", value: 9, .. })));
    let mut nan = Ring::new([20, 10], 5);
    nan.jitter = f64::NAN;
    assert!(matches!(
        SubdivisionSurface::new(&base, &nan, leaves_of(6)),
        Err(VdsError::NotFinite { .. })
    ));
    // Three faces on one edge, a face twice, one without area.
    base.faces[1] = base.faces[0];
    base.faces[2] = [base.faces[0][0], base.faces[0][1], 77];
    base.faces[3] = [5, 5, 5];
    let mut vds = Vds::new(Arc::new(SubdivisionSurface::new(&base, &ring, leaves_of(6)).unwrap()));
    let (mut cache, mut device) = (PageCache::new(4000, 4000, 2), Device::default());
    for s in 0..4 {
        settle(&mut vds, &camera(&mut (s * 31)), &mut cache, &mut device);
    }
    base.faces[0][1] = 200;
    assert!(matches!(
        new(&base, leaves_of(6)),
        Err(VdsError::NoVertex { face: 0, vertex: 200, vertices: 200 })
    ));
}

/// Distance to the nearest of some triangles.
fn nearest(p: DVec3, all: &[[DVec3; 3]]) -> f64 {
    all.iter().map(|t| point_triangle_distance(p, *t)).fold(f64::INFINITY, f64::min)
}

/// Points spread over a triangle.
fn spread_over([a, b, c]: [DVec3; 3]) -> impl Iterator<Item = DVec3> {
    let w = [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [0.5, 0.5], [0.5, 0.0], [0.0, 0.5], [0.33, 0.33]];
    w.into_iter().map(move |[u, v]| u * a + v * b + (1.0 - u - v) * c)
}

#[test]
fn level_bounds_are_never_below_sampled_distance_either_way() {
    let ring = Ring::new([12, 6], 5);
    let surface = SubdivisionSurface::new(&ring.base(), &ring, leaves_of(6)).unwrap();
    let original: Vec<_> = (0..ring.faces() as u32).map(|f| ring.triangle(f)).collect();
    let all: Vec<f32> = (0..=surface.depth()).map(|l| surface.error_mm(l)).collect();
    assert!(surface.depth() == 3 && all[1] < 0.45 * all[0] && all[2] < 0.5 * all[1], "{all:?}");
    assert!(surface.finest_error_mm() < 0.2 * all[0], "{all:?}");
    for l in 0..=surface.depth() {
        let step = 1 << (surface.depth() - l);
        let of_face = |f: u32| {
            let surface = &surface;
            let at =
                move |g: [u32; 3]| surface.samples.position(&surface.base, f, g.map(|c| c * step));
            super::samples::triangles(1 << l).map(move |t| t.map(|g| at(g).as_dvec3()))
        };
        let level: Vec<_> = (0..surface.base.faces.len() as u32).flat_map(of_face).collect();
        let mut worst = vec![0.0f64; surface.leaves()];
        for f in (0..surface.base.faces.len() as u32).step_by(3) {
            let w = &mut worst[surface.leaf_of[f as usize] as usize];
            for p in of_face(f).step_by(1 << l).flat_map(spread_over) {
                *w = w.max(nearest(p, &original));
            }
        }
        for v in (0..ring.vertices()).step_by(3) {
            let (f, _, p) = ring.vertex(v).unwrap();
            let w = &mut worst[surface.leaf_of[f as usize] as usize];
            *w = w.max(nearest(p.as_dvec3(), &level));
        }
        let mut tight: f64 = 0.0;
        for (leaf, worst) in surface.leaves.iter().zip(worst) {
            let bound = f64::from(leaf.error_mm[l as usize]);
            assert!(worst <= bound + 1e-6, "level {l}: {worst} mm, bound {bound} mm");
            tight = tight.max(worst / bound);
        }
        assert!(tight > 0.6, "level {l}: the bound is loose, {tight}");
    }
}

/// The whole cut with templates and geomorphs, seen from the camera: no point is further from the
/// original, in pixels, than the tolerance or than the finest level allows.
#[test]
fn visible_points_are_within_the_screen_space_tolerance() {
    let ring = Ring::new([36, 16], 3);
    let surface = Arc::new(SubdivisionSurface::new(&ring.base(), &ring, leaves_of(2)).unwrap());
    let original: Vec<_> = (0..ring.faces() as u32).map(|f| ring.triangle(f)).collect();
    let mut vds = Vds::new(surface.clone());
    let (mut cache, mut device) = (PageCache::new(4000, 4000, 2), Device::default());
    let (mut worst, mut met) = (0.0f64, 0);
    for s in 0..6u64 {
        let mut cam = camera(&mut (s * 1234 + 5));
        cam.height_px = 200;
        let frustum = crate::geometry::ViewFrustum::new(&cam);
        settle(&mut vds, &cam, &mut cache, &mut device);
        for (leaf, drawn) in surface.leaves.iter().zip(&vds.drawn) {
            let finest = frustum.error_px(&leaf.sphere, *leaf.error_mm.last().unwrap());
            if !frustum.intersects(&leaf.sphere) || finest > f64::from(PIXELS.pixels) {
                continue;
            }
            for u in drawn.iter().map(|d| &device.0[&d.page]) {
                for t in u.triangles.iter().step_by(5) {
                    let t = t.map(|v| u.vertices[usize::from(v)].position().as_dvec3());
                    let facing = (t[1] - t[0])
                        .cross(t[2] - t[0])
                        .dot(cam.pose.position_mm.as_dvec3() - t[0]);
                    for p in spread_over(t).skip(3).filter(|_| facing > 0.0) {
                        let here = crate::geometry::Sphere { centre: p.as_vec3(), radius: 1e-5 };
                        if frustum.intersects(&here) {
                            met += 1;
                            worst =
                                worst.max(frustum.error_px(&here, nearest(p, &original) as f32));
                        }
                    }
                }
            }
        }
    }
    let most = f64::from(PIXELS.pixels);
    assert!(met > 500 && worst < most && worst > 0.2 * most, "{worst} px of {most}, {met}");
}

/// Simplified, recorded, resampled.
#[test]
fn a_simplified_mesh_is_refined_back_to_its_original() {
    let mesh = Ring::new([20, 10], 4).mesh;
    let mut maps = crate::mesh::Parameterization::new(&mesh).unwrap();
    let base =
        crate::mesh::simplify(&mesh, &crate::mesh::SimplifyOptions::to_faces(400), &mut maps)
            .unwrap();
    let shading = crate::surface::shading(&mesh);
    let original = ParameterizedOriginal::new(&mesh, &shading.vertices, &base, &maps);
    for (f, face) in base.mesh.faces.iter().enumerate() {
        for c in 0..3 {
            let mut weights = [0.0; 3];
            weights[c] = 1.0;
            let at = original.at(f as u32, weights).position();
            assert_eq!(at, base.mesh.positions[face[c] as usize], "corners keep their order");
        }
    }
    let surface = Arc::new(SubdivisionSurface::new(&base.mesh, &original, leaves_of(6)).unwrap());
    let all: Vec<f32> = (0..=surface.depth()).map(|l| surface.error_mm(l)).collect();
    assert!(surface.depth() == 2 && all[2] < 0.5 * all[0], "{all:?}");
    // The finest level against the original, sampled.
    let search = crate::geometry::TriangleBvh::new(&mesh);
    let at = |f: u32, g| surface.samples.position(&surface.base, f, g).as_dvec3();
    for f in 0..base.mesh.faces.len() as u32 {
        let bound = f64::from(surface.leaves[surface.leaf_of[f as usize] as usize].error_mm[2]);
        for t in super::samples::triangles(4) {
            for p in spread_over(t.map(|g| at(f, g))) {
                let far = search.closest(p).unwrap().distance_mm;
                assert!(far <= bound + 1e-5, "{far} mm, bound {bound} mm");
            }
        }
    }
    let mut vds = Vds::new(surface);
    let (mut cache, mut device) = (PageCache::new(4000, 4000, 2), Device::default());
    for s in 0..6 {
        let step = settle(&mut vds, &camera(&mut (s * 71 + 3)), &mut cache, &mut device);
        assert!(closed(&device.triangles(&step)));
    }
}
