mod ring;

use std::collections::{HashMap, HashSet};
use std::f64::consts::TAU;
use std::sync::Arc;

use glam::{DVec3, Vec3};

pub(super) use ring::Ring;

use super::criterion::STEP;
use super::cut::{Cut, NodeState};
use super::template::{PatchShape, SPLITS};
use super::*;
use crate::geometry::{
    Camera, Lens, Mesh, Pose, Sphere, TriangleBvh, Vertex, point_triangle_distance,
};
use crate::lod::{DrawnWall, OcclusionTest, Tolerance, ViewFrustum, occlusion_grid};
use ring::RING_MM;

const PIXELS: Tolerance = Tolerance { pixels: 4.0 };

fn shape() -> &'static PatchShape {
    PatchShape::of(Scheme::OneToFour)
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
    let ahead = along + radial * v(0.8) + DVec3::Z * v(0.8);
    Camera {
        pose: Pose::looking(at.as_vec3(), ahead.as_vec3(), Vec3::Z),
        lens: Lens { fov_y_rad: 1.4, aspect: 1.5, near_mm: 0.2 },
        height_px: 600,
    }
}

/// A ring of 144 base faces whose patches may grow to twice the faces of the original.
fn surface(options: VdsOptions) -> Arc<SubdivisionSurface> {
    let ring = Ring::new([12, 6], 16);
    Arc::new(SubdivisionSurface::new(&ring.base(), &ring, options).unwrap())
}

fn deep() -> VdsOptions {
    VdsOptions { finest_share: 2.0, ..VdsOptions::default() }
}

fn wall(surface: &Arc<SubdivisionSurface>, pixels: f32) -> SubdividedWall {
    SubdividedWall::new(Arc::clone(surface), Tolerance { pixels }, None)
}

/// Corners of all triangles that are drawn.
fn corners(surface: &SubdivisionSurface, drawn: &[DrawnPatch]) -> Vec<[Vec3; 3]> {
    let mut all = Vec::new();
    for d in drawn {
        let own = surface.patches().triangles(d);
        assert_eq!(own.len(), d.triangles as usize);
        let bounds = &surface.bounds[d.patch as usize];
        for t in own {
            let t = t.map(|v| v.position());
            let away = |p: Vec3| bounds.sphere.centre.distance(p);
            assert!(t.iter().all(|p| away(*p) <= bounds.sphere.radius * (1.0 + 1e-6)));
            let off = |p: Vec3| (p - bounds.sphere.centre).abs() - bounds.half;
            assert!(t.iter().all(|p| off(*p).max_element() <= 1e-5));
            all.push(t);
        }
    }
    all
}

/// Edges without a reverse, told by the bits of their ends.
fn open_edges(triangles: &[[Vec3; 3]]) -> Vec<[Vec3; 2]> {
    let mut open: HashMap<([u32; 3], [u32; 3]), i32> = HashMap::new();
    let bits = |p: Vec3| p.to_array().map(f32::to_bits);
    for t in triangles {
        for e in 0..3 {
            let (a, b) = (bits(t[e]), bits(t[(e + 1) % 3]));
            *open.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
        }
    }
    let point = |p: [u32; 3]| Vec3::from(p.map(f32::from_bits));
    let left = open.into_iter().filter(|(_, n)| *n != 0);
    left.map(|((a, b), _)| [point(a), point(b)]).collect()
}

fn is_closed(triangles: &[[Vec3; 3]]) -> bool {
    !triangles.is_empty() && open_edges(triangles).is_empty()
}

const SCHEMES: [Scheme; 4] =
    [Scheme::OneToFour, Scheme::Butterfly, Scheme::Sqrt3, Scheme::FourEight];

#[test]
fn cuts_are_watertight_during_geomorphs_and_levels_differ_by_at_most_one() {
    for (morph, scheme) in [true, false].into_iter().flat_map(|m| SCHEMES.map(|s| (m, s))) {
        let surface = surface(VdsOptions { morph, scheme, ..deep() });
        let wall = wall(&surface, 1.0);
        let mut depths = HashSet::new();
        let seed = &mut 11;
        for _ in 0..20 {
            let mut cut = Cut::of(&surface, &wall.criterion(&camera(seed)));
            let drawn = cut.drawn_patches();
            assert!(is_closed(&corners(&surface, &drawn)));
            for d in &drawn {
                let own = cut.fineness(d.patch);
                depths.insert((surface.forest.node(d.patch).depth, own / STEP));
                for (m, _) in (0..3).filter_map(|e| cut.across(d.patch, e)) {
                    assert!(own.abs_diff(cut.fineness(m)) <= STEP);
                }
            }
        }
        assert_eq!(depths.iter().any(|d| d.0 >= 1), scheme.nests(), "{depths:?}");
        assert!(depths.len() > 3, "{depths:?}");
    }
}

/// Any fineness of any patches, as no camera would ask for it.
#[test]
fn arbitrary_cuts_are_watertight_and_use_every_template() {
    SCHEMES.into_iter().for_each(arbitrary_cuts_are_watertight);
}

fn arbitrary_cuts_are_watertight(scheme: Scheme) {
    let surface = surface(VdsOptions { scheme, ..deep() });
    let shape = PatchShape::of(scheme);
    let mut cut = Cut::new(&surface);
    let (seed, mut used) = (&mut 3, HashSet::new());
    for round in 0..40 {
        cut.states.fill(NodeState::UnderDrawn);
        // Where nothing is fine, base faces have all levels.
        let open = if round % 4 == 0 { 0.0 } else { 0.8 };
        let mut todo: Vec<u32> = (0..surface.base_faces() as u32).collect();
        while let Some(id) = todo.pop() {
            let children = surface.forest.children(id);
            if !children.is_empty() && noise(seed) < open {
                cut.states[id as usize] = NodeState::Split;
                todo.extend(children);
                continue;
            }
            let (least, most) =
                (cut.min_fineness(id), cut.origin(id) + shape.finest() as u16 * STEP);
            let most = if open < 0.5 { most.min(least + STEP + 8) } else { most };
            let q = f64::from(least) + noise(seed).powi(2) * f64::from(most - least);
            let q = if scheme.morphs() { q as u16 } else { q as u16 / STEP * STEP };
            cut.states[id as usize] = NodeState::Drawn(q);
        }
        cut.balance();
        let drawn = cut.drawn_patches();
        assert!(is_closed(&corners(&surface, &drawn)), "{scheme:?}, round {round}");
        used.extend(drawn.iter().map(|d| d.first_index));
    }
    let all = (0..=shape.finest()).flat_map(|l| (0..8).map(move |s| shape.template(l, s).first));
    let unused: Vec<u32> = all.filter(|t| !used.contains(t)).collect();
    // A base face that is one triangle rarely has finer faces on all sides.
    // Base faces at their finest have no finer ones beside them where patches do not nest.
    assert!(!scheme.nests() || unused.len() <= 2, "{unused:?}");
}

/// The check for cracks can fail: sampled from both faces, edges crack as soon as the two answers
/// differ in their last bits.
#[test]
fn edges_sampled_from_both_faces_crack() {
    for (jitter, apart, want) in [(0.0, true, true), (1e-5, false, true), (1e-5, true, false)] {
        let mut ring = Ring::new([12, 6], 16);
        ring.jitter = jitter;
        let mut base = ring.base();
        if apart {
            // Every face has its own corners, so that no edge is shared.
            base.positions =
                base.faces.iter().flatten().map(|v| base.positions[*v as usize]).collect();
            base.faces =
                (0..base.faces.len() as u32).map(|f| [0, 1, 2].map(|c| 3 * f + c)).collect();
        }
        let options = VdsOptions { finest_share: 0.0, ..VdsOptions::default() };
        let surface = Arc::new(SubdivisionSurface::new(&base, &ring, options).unwrap());
        let mut cut = Cut::new(&surface);
        // The same level everywhere: faces without shared edges cannot be balanced.
        cut.states.fill(NodeState::Drawn(SPLITS as u16 * STEP));
        let drawn = cut.drawn_patches();
        assert_eq!(drawn.len() as u64, surface.base_faces());
        assert_eq!(is_closed(&corners(&surface, &drawn)), want, "jitter {jitter}, apart {apart}");
    }
}

#[test]
fn the_cut_depends_on_the_camera_alone() {
    let surface = surface(deep());
    let wall = wall(&surface, PIXELS.pixels);
    let cameras: Vec<Camera> = (0..20).scan(77, |seed, _| Some(camera(seed))).collect();
    let flown: Vec<_> = cameras.iter().map(|c| wall.cut(c)).collect();
    let back: Vec<_> = cameras.iter().rev().map(|c| wall.cut(c)).collect();
    assert!(flown.iter().eq(back.iter().rev()));
    assert!(flown.windows(2).all(|w| w[0] != w[1]), "cameras that see the same");
}

#[test]
fn an_open_base_has_no_boundary_but_its_own() {
    let ring = Ring::new([12, 6], 16);
    let mut base = ring.base();
    // A part of the ring is taken out; face ids of the rest stay what they were.
    base.faces.truncate(12 * 9);
    let surface = Arc::new(SubdivisionSurface::new(&base, &ring, deep()).unwrap());
    let wall = wall(&surface, PIXELS.pixels);
    let seed = &mut 71;
    for _ in 0..8 {
        let open = open_edges(&corners(&surface, &wall.cut(&camera(seed))));
        // The rims lie in two planes through the ring's axis.
        let around = |p: Vec3| f64::from(p.y).atan2(f64::from(p.x));
        let rim = |u: f64| u.abs() < 1e-3 || (u - (0.75 * TAU - TAU)).abs() < 1e-3;
        assert!(open.len() >= 12 && open.iter().flatten().all(|p| rim(around(*p))));
    }
}

#[test]
fn invalid_base_meshes_are_refused_and_non_manifold_ones_are_drawn() {
    let ring = Ring::new([12, 6], 5);
    let new = |base: &Mesh| SubdivisionSurface::new(base, &ring, deep()).map(|_| ());
    let mut base = ring.base();
    assert_eq!(new(&Mesh::default()), Err(VdsError::Empty));
    let mut nan = Ring::new([12, 6], 5);
    nan.jitter = f64::NAN;
    let refused = SubdivisionSurface::new(&base, &nan, deep()).map(|_| ());
    assert!(matches!(refused, Err(VdsError::NotFinite { .. })));
    // Three faces on one edge, a face twice, one without area.
    base.faces[1] = base.faces[0];
    base.faces[2] = [base.faces[0][0], base.faces[0][1], 37];
    base.faces[3] = [5, 5, 5];
    let surface = Arc::new(SubdivisionSurface::new(&base, &ring, deep()).unwrap());
    let wall = wall(&surface, PIXELS.pixels);
    let seed = &mut 31;
    for _ in 0..4 {
        assert!(!wall.visible(&camera(seed)).ranges.is_empty());
    }
    base.faces[0][1] = 72;
    assert!(matches!(new(&base), Err(VdsError::NoVertex { face: 0, vertex: 72, vertices: 72 })));
}

/// Points spread over a triangle.
fn spread_over([a, b, c]: [DVec3; 3]) -> impl Iterator<Item = DVec3> {
    let w = [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [0.5, 0.5], [0.5, 0.0], [0.0, 0.5], [0.33, 0.33]];
    w.into_iter().map(move |[u, v]| u * a + v * b + (1.0 - u - v) * c)
}

/// A patch at one of its levels, on its own.
fn alone(id: u32, surface: &SubdivisionSurface, level: u32) -> Vec<[DVec3; 3]> {
    let t = shape().template(level, 0);
    let own = surface.patches().vertices_of(id);
    let at = |i: usize| own[i].own.position().as_dvec3();
    shape().faces(t).map(|t| t.map(at)).collect()
}

#[test]
fn errors_are_never_below_sampled_distance_either_way() {
    let ring = Ring::new([12, 6], 16);
    let surface = surface(deep());
    let mut tight: f64 = 0.0;
    for id in (0..surface.forest.nodes.len() as u32).step_by(5) {
        for level in measure::lowest_level(surface.forest.node(id).depth)..=SPLITS {
            let triangles = alone(id, &surface, level);
            let error = f64::from(surface.bounds[id as usize].error_mm[level as usize]);
            let points = triangles.iter().copied().flat_map(spread_over);
            let there = points.map(|p| ring.distance_mm(p)).fold(0.0, f64::max);
            assert!(there <= error + 1e-6, "node {id}, level {level}: {there} of {error} mm");
            tight = tight.max(there / error);
        }
    }
    assert!(tight > 0.6, "the errors are loose, {tight}");
    // From the original to the base faces, of which each has its own part of it.
    let mut inside = vec![Vec::new(); surface.base_faces() as usize];
    for v in 0..ring.vertices() {
        let (f, _, vertex) = ring.vertex(v).unwrap();
        inside[f as usize].push(vertex.position().as_dvec3());
    }
    for (f, inside) in inside.iter().enumerate() {
        for level in 0..=SPLITS {
            let triangles = alone(f as u32, &surface, level);
            let error = f64::from(surface.bounds[f].error_mm[level as usize]);
            for p in inside {
                let far = triangles.iter().map(|t| point_triangle_distance(*p, *t));
                let far = far.fold(f64::INFINITY, f64::min);
                assert!(far <= error + 1e-6, "face {f}, level {level}: {far} of {error} mm");
            }
        }
    }
}

/// The whole cut with templates and geomorphs, seen from the camera: no point is further from the
/// original, in pixels, than the tolerance or than the finest level allows.
#[test]
fn visible_points_are_within_the_screen_space_tolerance() {
    let ring = Ring::new([12, 6], 16);
    let surface = surface(deep());
    let wall = wall(&surface, PIXELS.pixels);
    let (mut worst, mut met) = (0.0f64, 0);
    let most = f64::from(PIXELS.pixels);
    for s in 0..6u64 {
        let mut cam = camera(&mut (s * 1234 + 5));
        cam.height_px = 200;
        let frustum = ViewFrustum::new(&cam);
        for d in wall.cut(&cam) {
            let own = &surface.bounds[d.patch as usize];
            let is_leaf = surface.forest.children(d.patch).is_empty();
            let finest = frustum.error_scale(&own.sphere).px(own.error_mm[SPLITS as usize].into());
            if !frustum.intersects(&own.sphere) || is_leaf && finest > most {
                continue;
            }
            for t in corners(&surface, &[d]).iter().step_by(3) {
                let t = t.map(|p| p.as_dvec3());
                let eye = cam.pose.position_mm.as_dvec3();
                let facing = (t[1] - t[0]).cross(t[2] - t[0]).dot(eye - t[0]);
                for p in spread_over(t).skip(3).filter(|_| facing > 0.0) {
                    let here = Sphere { centre: p.as_vec3(), radius: 1e-5 };
                    if frustum.intersects(&here) {
                        met += 1;
                        worst = worst.max(frustum.error_scale(&here).px(ring.distance_mm(p)));
                    }
                }
            }
        }
    }
    assert!(met > 500 && worst < most && worst > 0.2 * most, "{worst} px of {most}, {met}");
}

/// Rays into a surface that is near the original everywhere, and into one that the test takes to be
/// far from it in places.
#[test]
fn rays_meet_nothing_before_the_patches_that_are_visible() {
    let ring = Ring::new([60, 20], 9);
    let grid = Arc::new(occlusion_grid(&ring.mesh));
    for (finest_mm, is_far) in [(0.02, false), (1e-4, true)] {
        let options = VdsOptions { finest_mm, ..VdsOptions::default() };
        let surface = SubdivisionSurface::new(&ring.base(), &ring, options).unwrap();
        let surface = Arc::new(surface);
        let test = Arc::new(surface.occlusion_test(Arc::clone(&grid), &ring.mesh));
        let plain = OcclusionTest::new(
            Arc::clone(&grid),
            f64::from(surface.finest_error_mm()),
            f64::from(surface.coarsest_error_mm()),
        );
        assert_eq!(surface.finest_error_mm() > 10.0 * finest_mm, is_far);
        let wall = SubdividedWall::new(Arc::clone(&surface), PIXELS, Some(test));
        let (mut met, mut inside, mut visible, mut by_worst) = (0, 0, 0, 0);
        let seed = &mut 77;
        for _ in 0..12 {
            let cam = camera(seed);
            let drawn = wall.cut(&cam);
            let frustum = ViewFrustum::new(&cam);
            let worst = plain.depths(&frustum);
            let is_in_front = |d: &&DrawnPatch| {
                let b = &surface.bounds[d.patch as usize];
                let away = b.sphere.centre.as_dvec3() - frustum.position();
                frustum.intersects_box(away, b.half.as_dvec3())
                    && !frustum.is_backfacing(&b.sphere, &b.cone)
            };
            let is_unhidden = |d: &&DrawnPatch| {
                let b = &surface.bounds[d.patch as usize];
                !worst.hides_box(b.sphere.centre, b.half)
            };
            let seen: Vec<DrawnPatch> = drawn.iter().filter(|d| d.is_seen).copied().collect();
            inside += drawn.iter().filter(is_in_front).count();
            by_worst += drawn.iter().filter(is_in_front).filter(is_unhidden).count();
            visible += seen.len();
            let tree = |drawn| {
                let corners = corners(&surface, drawn);
                let faces = (0..corners.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]);
                let faces = faces.collect();
                TriangleBvh::new(&Mesh {
                    positions: corners.into_iter().flatten().collect(),
                    faces,
                    ..Mesh::default()
                })
            };
            let (whole, seen) = (tree(&drawn), tree(&seen));
            let eye = frustum.position();
            for _ in 0..300 {
                let [t_x, t_y] = frustum.tangents();
                let mut at = |t: f64| t * (2.0 * noise(seed) - 1.0);
                let along = 200.0 * frustum.way(at(t_x), at(t_y));
                let Some(hit) = whole.first_hit(eye, along) else { continue };
                met += 1;
                let found = seen.first_hit(eye, along).map(|p| p.distance(hit));
                assert!(found.is_some_and(|d| d < 1e-3), "{hit} from {eye}: {found:?}");
            }
        }
        println!("{visible} of {inside} patches are visible, {by_worst} by the worst error");
        assert!(met > 3_500 && 10 * visible < 9 * inside, "{met} rays");
        // A margin of its own for each place hides as much as the largest, or nearly.
        let [hidden, hidden_by_worst] = [visible, by_worst].map(|left| inside - left);
        assert!(100 * hidden >= 98 * hidden_by_worst, "{hidden} hidden, {hidden_by_worst}");
    }
}

#[test]
fn each_scheme_comes_nearer_at_each_level_and_samples_err_less_than_predictions() {
    let finest = SCHEMES.map(|scheme| {
        let surface = surface(VdsOptions { scheme, ..VdsOptions::default() });
        let levels = PatchShape::of(scheme).finest() as usize;
        let mean = |level: usize| {
            let bounds = &surface.bounds[..surface.base_faces() as usize];
            bounds.iter().map(|b| b.error_mm[level]).sum::<f32>() / bounds.len() as f32
        };
        // Two levels of √3 and of 4-8 halve a side at least.
        let apart = if matches!(scheme, Scheme::Sqrt3 | Scheme::FourEight) { 2 } else { 1 };
        for level in (apart..=levels).step_by(apart) {
            let (coarse, fine) = (mean(level - apart), mean(level));
            assert!(fine < coarse, "{scheme:?}, level {level}: {coarse} to {fine} mm");
        }
        mean(levels)
    });
    let [sampled, predicted, ..] = finest;
    assert!(predicted > 2.0 * sampled, "{finest:?}");
}

/// Simplified, recorded, resampled.
#[test]
fn a_simplified_mesh_is_refined_back_to_its_original() {
    let mesh = Ring::new([20, 10], 4).mesh;
    let mut maps = crate::mesh::Parameterization::new(&mesh).unwrap();
    let base =
        crate::mesh::simplify(&mesh, &crate::mesh::SimplifyOptions::to_faces(100), &mut maps)
            .unwrap();
    let shading = crate::surface::shading(&mesh);
    let tree = TriangleBvh::new(&mesh);
    let original = ParameterizedOriginal::new(&mesh, &shading.vertices, &tree, &base, &maps);
    for (f, face) in base.mesh.faces.iter().enumerate() {
        for c in 0..3 {
            let mut weights = [0.0; 3];
            weights[c] = 1.0;
            let at = original.at(f as u32, weights).position();
            assert_eq!(at, base.mesh.positions[face[c] as usize], "corners keep their order");
        }
    }
    let options = VdsOptions::default();
    let surface = Arc::new(SubdivisionSurface::new(&base.mesh, &original, options).unwrap());
    let (coarsest, finest) = (surface.coarsest_error_mm(), surface.finest_error_mm());
    assert!(finest < 0.3 * coarsest, "{coarsest} {finest}");
    let share = surface.finest_faces() as f64 / mesh.faces.len() as f64;
    assert!(share > 0.9 && share <= 1.2, "{share} of the original's faces");
    let wall = wall(&surface, PIXELS.pixels);
    for s in 0..6 {
        assert!(is_closed(&corners(&surface, &wall.cut(&camera(&mut (s * 71 + 3))))));
    }
}

#[test]
fn vertices_reach_both_ends_of_their_morph() {
    let place = |x: f32| Vertex::new(Vec3::new(x, 0.0, 0.0), Vec3::X, 0.5);
    let samples: Vec<Vertex> = (0..shape().points.len()).map(|i| place(i as f32)).collect();
    let patches = ResidentPatches {
        vertices: patch::vertices(shape(), &samples).collect(),
        scheme: Scheme::OneToFour,
    };
    let template = shape().template(SPLITS, 0);
    let drawn = |q: u32| DrawnPatch {
        patch: 0,
        first_index: template.first,
        triangles: template.triangles,
        morph: q * 0x0101_0101,
        is_seen: true,
    };
    let level = |l: u32| SPLITS * u32::from(STEP) - (SPLITS - l) * u32::from(STEP);
    let [fine, coarse] = [SPLITS, SPLITS - 1].map(|l| patches.triangles(&drawn(level(l))));
    for (t, (fine, coarse)) in shape().faces(template).zip(fine.iter().zip(&coarse)) {
        for (c, i) in t.into_iter().enumerate() {
            let p = shape().points[i];
            let [a, b] = p.parents.map(|q| q as f32);
            let edge = if p.born == SPLITS { 0.5 * (a + b) } else { i as f32 };
            assert_eq!((fine[c].position().x, coarse[c].position().x), (i as f32, edge));
        }
    }
}
