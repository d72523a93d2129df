use glam::Vec3;

use super::*;
use crate::geometry::Mesh;
use crate::geometry::shapes::{boxed, sphere, torus};
use garland_heckbert::contract;

mod garland_heckbert;

/// A square of n × n cells with a boundary, bent a little.
fn sheet(n: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for (i, j) in (0..=n).flat_map(|i| (0..=n).map(move |j| (i, j))) {
        let (x, y) = (i as f32, j as f32);
        mesh.positions.push(Vec3::new(x, y, (0.3 * x).sin() + 0.1 * y));
        if i < n && j < n {
            let a = i * (n + 1) + j;
            mesh.faces.extend([[a, a + n + 1, a + n + 2], [a, a + n + 2, a + 1]]);
        }
    }
    mesh
}

/// Two meshes as one.
fn both(a: &Mesh, b: &Mesh, shift: Vec3) -> Mesh {
    let mut mesh = a.clone();
    let first = a.positions.len() as u32;
    mesh.positions.extend(b.positions.iter().map(|p| *p + shift));
    mesh.normals.extend(&b.normals);
    mesh.faces.extend(b.faces.iter().map(|f| f.map(|v| v + first)));
    mesh
}

fn edges_of(mesh: &Mesh) -> HalfEdges {
    let edges = HalfEdges::new(mesh).unwrap();
    edges.check().unwrap();
    edges
}

/// V − E + F over vertices that faces use, and the number of boundary edges.
fn euler(mesh: &Mesh) -> (i64, usize) {
    let edges = edges_of(mesh);
    let used = (0..mesh.positions.len() as u32).filter(|v| edges.out(*v) != halfedge::NONE);
    let open = (0..mesh.faces.len() as u32)
        .flat_map(|f| [4 * f, 4 * f + 1, 4 * f + 2])
        .filter(|h| edges.pair(*h) == halfedge::NONE)
        .count();
    let sides = (3 * mesh.faces.len() + open) / 2;
    (used.count() as i64 - sides as i64 + mesh.faces.len() as i64, open)
}

fn down_to(mesh: &Mesh, faces: usize) -> Simplified {
    let s = simplify(mesh, &SimplifyOptions::to_faces(faces), &mut ()).unwrap();
    edges_of(&s.mesh);
    s
}

const METRICS: [Metric; 3] = [Metric::Qem, Metric::NormalQem, Metric::Paper];

#[test]
fn euler_number_and_manifoldness_hold_at_every_thousandth_collapse() {
    let mesh = both(&torus(80, 40), &sphere(4.0, 12), Vec3::ZERO);
    let want = euler(&mesh);
    assert_eq!(want, (2, 0));
    let mut faces = mesh.faces.len();
    while faces > 100 {
        faces = faces.saturating_sub(2000).max(100);
        for (metric, relocate) in METRICS.into_iter().flat_map(|m| [(m, false), (m, true)]) {
            let options = SimplifyOptions { metric, relocate, ..SimplifyOptions::to_faces(faces) };
            let s = simplify(&mesh, &options, &mut ()).unwrap();
            assert_eq!(euler(&s.mesh), want, "{faces} {metric:?} {relocate}");
            assert_eq!((s.stopped, s.mesh.faces.len()), (StopReason::Reached, faces));
            assert_eq!(2 * s.collapses, mesh.faces.len() - faces);
        }
    }
}

#[test]
fn a_target_out_of_reach_is_reported_and_the_shape_is_kept() {
    // A torus needs 14 faces; the link condition may end a little earlier.
    let s = down_to(&torus(30, 15), 0);
    assert_eq!((s.stopped, euler(&s.mesh).0), (StopReason::NoLegalCollapse, 0));
    assert!(s.mesh.faces.len() >= 14 && s.mesh.faces.len() < 120, "{}", s.mesh.faces.len());
    let s = down_to(&sphere(3.0, 8), 0);
    assert_eq!((s.stopped, euler(&s.mesh).0), (StopReason::NoLegalCollapse, 2));
}

#[test]
fn a_target_above_the_mesh_changes_nothing() {
    let mesh = torus(12, 8);
    for (faces, relocate) in [(mesh.faces.len(), false), (usize::MAX, true)] {
        let options = SimplifyOptions { relocate, ..SimplifyOptions::to_faces(faces) };
        let s = simplify(&mesh, &options, &mut ()).unwrap();
        assert!(s.mesh == mesh && s.collapses == 0 && s.stopped == StopReason::Reached);
        assert!(s.vertex_ids.iter().zip(0..).all(|(a, b)| *a == b));
    }
}

#[test]
fn the_smallest_meshes_end_as_they_should() {
    let tetrahedron = Mesh {
        positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
        faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        ..Mesh::default()
    };
    assert_eq!(down_to(&tetrahedron, 0).mesh, tetrahedron);
    // Two triangles may lose one; the last face never goes.
    let s = down_to(&sheet(1), 0);
    assert_eq!((s.mesh.faces.len(), s.stopped), (1, StopReason::NoLegalCollapse));
    let pillow = Mesh { faces: vec![[0, 1, 2], [0, 2, 1]], ..tetrahedron.clone() };
    let s = simplify(&pillow, &SimplifyOptions::to_faces(0), &mut ()).unwrap();
    assert_eq!(s.mesh.faces.len(), 2);
    let none = simplify(&Mesh::default(), &SimplifyOptions::to_faces(0), &mut ());
    assert_eq!(none.unwrap_err(), MeshError::Empty);
}

#[test]
fn flat_faces_cost_nothing_and_edges_of_a_cube_stay() {
    for metric in METRICS {
        // 3 × 4 × 4 squares a side: the normals given are of no use at edges, so none are.
        let mesh = boxed(8);
        let options = SimplifyOptions { metric, ..SimplifyOptions::to_faces(12) };
        let s = simplify(&mesh, &options, &mut ()).unwrap();
        assert_eq!(euler(&s.mesh), (2, 0));
        let volume = s.mesh.volume_mm3();
        if metric == Metric::Qem {
            assert!((volume - 8.0).abs() < 1e-6 && s.error_mm < 1e-6, "{volume} {}", s.error_mm);
        }
        assert!(volume > 7.0, "{metric:?}: {volume} {}", s.mesh.faces.len());
    }
}

#[test]
fn a_boundary_stays_in_its_plane_and_whole() {
    let mesh = sheet(20);
    for relocate in [false, true] {
        let options = SimplifyOptions { relocate, ..SimplifyOptions::to_faces(120) };
        let s = simplify(&mesh, &options, &mut ()).unwrap();
        let (number, open) = euler(&s.mesh);
        assert!(number == 1 && (4..80).contains(&open), "{number} {open}");
        let edges = edges_of(&s.mesh);
        let (mut lo, mut hi) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for (v, p) in s.mesh.positions.iter().enumerate() {
            let border = |c: f32| c == 0.0 || c == 20.0;
            assert_eq!(edges.on_boundary(v as u32), border(p.x) || border(p.y), "{p}");
            (lo, hi) = (lo.min(*p), hi.max(*p));
        }
        assert_eq!([lo.x, lo.y, hi.x, hi.y], [0.0, 0.0, 20.0, 20.0]);
    }
}

#[test]
fn the_rim_of_a_cap_stays_a_loop_around_it() {
    let mut mesh = boxed(10);
    mesh.caps =
        mesh.faces.iter().map(|f| f.iter().all(|v| mesh.positions[*v as usize].z == 1.0)).collect();
    let options = SimplifyOptions { relocate: true, ..SimplifyOptions::to_faces(60) };
    let s = simplify(&mesh, &options, &mut ()).unwrap();
    let on_top = |v: &u32| s.mesh.positions[*v as usize].z > 1.0 - 1e-5;
    let mut area = 0.0;
    for (f, cap) in s.mesh.faces.iter().zip(&s.mesh.caps) {
        assert_eq!(*cap, f.iter().all(on_top), "{f:?}");
        area += if *cap { 0.5 * f64::from(s.mesh.face_cross(*f).length()) } else { 0.0 };
    }
    assert!((area - 4.0).abs() < 0.05, "{area}");
}

#[test]
fn locked_vertices_stay_where_they_are_and_all_others_may_go() {
    let mesh = torus(40, 20);
    let locked: Vec<bool> = (0..mesh.positions.len()).map(|v| v % 7 == 0).collect();
    let options =
        SimplifyOptions { locked: Some(&locked), relocate: true, ..SimplifyOptions::to_faces(0) };
    let s = simplify(&mesh, &options, &mut ()).unwrap();
    edges_of(&s.mesh);
    for v in (0..locked.len()).filter(|v| locked[*v]) {
        let at = s.vertex_ids.iter().position(|id| *id as usize == v).unwrap();
        assert_eq!(s.mesh.positions[at], mesh.positions[v]);
    }
    assert!(s.vertex_ids.len() < 2 * locked.iter().filter(|l| **l).count());
    let options = SimplifyOptions { locked: Some(&locked[1..]), ..options };
    let wrong = simplify(&mesh, &options, &mut ()).unwrap_err();
    assert!(matches!(wrong, MeshError::Length { what: "locked flags", .. }), "{wrong}");
}

#[test]
fn no_collapse_errs_more_than_allowed() {
    let mesh = torus(60, 30);
    let mut last = mesh.faces.len();
    for most in [0.01, 0.05, 0.2] {
        let options = SimplifyOptions { max_error_mm: Some(most), ..SimplifyOptions::to_faces(0) };
        let s = simplify(&mesh, &options, &mut ()).unwrap();
        assert!(s.error_mm <= most && s.stopped == StopReason::MaxError, "{most}: {s:?}");
        assert!(s.mesh.faces.len() < last);
        last = s.mesh.faces.len();
    }
}

#[test]
fn vertices_that_move_lie_better_and_take_the_normal_of_where_they_lie() {
    let mesh = torus(120, 60);
    let at = |relocate| {
        let options = SimplifyOptions { relocate, ..SimplifyOptions::to_faces(700) };
        let s = simplify(&mesh, &options, &mut ()).unwrap();
        for (p, n) in s.mesh.positions.iter().zip(&s.mesh.normals) {
            let tube = 10.0 * Vec3::new(p.x, p.y, 0.0).normalize() - *p;
            assert!(n.dot(tube.normalize()) > 0.999, "{p} {n}");
        }
        deviation(&s.mesh, &mesh).unwrap()
    };
    let (stay, moved) = (at(false), at(true));
    assert!(moved.mean_mm < 0.7 * stay.mean_mm, "{moved:?} {stay:?}");
    assert!(moved.hausdorff_mm < stay.hausdorff_mm, "{moved:?} {stay:?}");
}

#[test]
fn ids_name_where_vertices_and_faces_come_from() {
    let mesh = torus(30, 20);
    let s = down_to(&mesh, 300);
    for (p, id) in s.mesh.positions.iter().zip(&s.vertex_ids) {
        assert_eq!(*p, mesh.positions[*id as usize]);
    }
    assert_eq!(s.face_ids.len(), s.mesh.faces.len());
    assert!(s.face_ids.windows(2).all(|w| w[0] < w[1]));
}

/// A collapse as it was heard of.
struct Heard {
    from: u32,
    to: u32,
    ring: Vec<u32>,
    faces: Vec<u32>,
}

/// Refuses every third collapse.
#[derive(Default)]
struct Third {
    made: Vec<Heard>,
    heard: usize,
}

impl Log for Third {
    fn record(&mut self, c: &Collapse<'_>) -> bool {
        let n = c.ring.len();
        assert!(c.from_at.is_finite() && c.ring_at.iter().all(|p| p.is_finite()));
        assert_eq!((c.faces.len(), c.ring_at.len()), (if c.boundary { n - 1 } else { n }, n));
        if c.boundary {
            assert!(c.to == c.ring[0] || c.to == c.ring[n - 1]);
        } else {
            assert_eq!(c.to, c.ring[0]);
        }
        self.heard += 1;
        if self.heard.is_multiple_of(3) {
            return false;
        }
        let (ring, faces) = (c.ring.to_vec(), c.faces.to_vec());
        self.made.push(Heard { from: c.from, to: c.to, ring, faces });
        true
    }
}

/// Replays what logs hold on faces of its own.
struct Replay {
    faces: Vec<Option<[u32; 3]>>,
    heard: usize,
    made: usize,
}

impl Recorder for Replay {
    type Log = Third;

    fn merge(&mut self, log: Third) {
        self.heard += log.heard;
        self.made += log.made.len();
        for c in log.made {
            for (i, f) in c.faces.iter().enumerate() {
                let (a, b) = (c.ring[i], c.ring[(i + 1) % c.ring.len()]);
                let face = &mut self.faces[*f as usize];
                let was = face.unwrap();
                let turned = (0..3).map(|k| [was[k], was[(k + 1) % 3], was[(k + 2) % 3]]);
                assert!(turned.into_iter().any(|t| t == [c.from, a, b]), "{was:?}");
                *face = (a != c.to && b != c.to).then_some([c.to, a, b]);
            }
        }
    }
}

#[test]
fn a_recorder_hears_of_every_collapse_and_may_refuse() {
    // The last two are large enough to be cut into parts.
    let smooth = torus(170, 100);
    let bare = Mesh { normals: Vec::new(), ..smooth.clone() };
    let two = both(&bare, &sheet(40), Vec3::splat(50.0));
    for mesh in [torus(30, 20), sheet(15), boxed(6), smooth, two] {
        let faces = mesh.faces.iter().map(|f| Some(*f)).collect();
        let mut replay = Replay { faces, heard: 0, made: 0 };
        let options = SimplifyOptions { relocate: true, ..SimplifyOptions::to_faces(100) };
        let s = simplify(&mesh, &options, &mut replay).unwrap();
        assert_eq!(replay.made, s.collapses);
        assert!(replay.heard > replay.made && s.mesh.faces.len() <= 100);
        for (id, f) in s.face_ids.iter().zip(&s.mesh.faces) {
            let mut want = replay.faces[*id as usize].take().unwrap();
            let mut f = f.map(|v| s.vertex_ids[v as usize]);
            want.sort_unstable();
            f.sort_unstable();
            assert_eq!(f, want);
        }
        assert!(replay.faces.iter().all(Option::is_none));
    }
}

#[test]
fn the_result_is_the_same_at_any_number_of_threads() {
    // Whole, and in parts.
    for mesh in [torus(150, 50), torus(250, 100)] {
        let at = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let options = SimplifyOptions { relocate: true, ..SimplifyOptions::to_faces(900) };
            pool.install(|| simplify(&mesh, &options, &mut ()).unwrap())
        };
        let (one, four) = (at(1), at(4));
        assert!(one.mesh == four.mesh && one.face_ids == four.face_ids);
    }
}

#[test]
fn normals_beat_plain_quadrics_on_a_torus_of_voxels() {
    use crate::surface::{
        Adjacency, Fairing, Midpoint, Surface, Weights, face_normals, fair, weights,
    };
    let grid = crate::volume::Grid::axis_aligned([64, 64, 28], [1.0; 3]);
    let mut bits = crate::lumen::BitVolume::new(grid.dims);
    for v in (0..grid.len()).map(|i| grid.voxel(i)) {
        let p = v.as_dvec3() - glam::DVec3::new(31.4, 31.6, 13.5);
        if (p.truncate().length() - 20.0).hypot(p.z) < 8.0 {
            bits.set(v.x, v.y, v.z);
        }
    }
    let mut mesh = Surface::new(&crate::lumen::Lumen::new(grid, &bits), &Midpoint, None).mesh;
    let (adjacency, _) = Adjacency::of(&mesh);
    let (start, w) = (face_normals(&mesh), weights(&mesh, &adjacency, Weights::Uniform));
    let mut plan = crate::compute::Plan::new();
    let n = fair(&mut plan, &adjacency, &w, &start, Fairing::PAPER);
    plan.download(n);
    let run = crate::compute::run_cpu(&plan);
    mesh.normals = run.get(n).chunks(3).map(Vec3::from_slice).collect();
    let distance = |metric| {
        let faces = mesh.faces.len() / 20;
        let options = SimplifyOptions { metric, ..SimplifyOptions::to_faces(faces) };
        let s = simplify(&mesh, &options, &mut ()).unwrap();
        deviation(&s.mesh, &mesh).unwrap()
    };
    let [plain, fair, paper] = METRICS.map(distance);
    println!("plain {plain:?}\nnormals {fair:?}\npaper {paper:?}");
    assert!(fair.hausdorff_mm <= 0.85 * plain.hausdorff_mm, "{fair:?} {plain:?}");
}

#[test]
fn shading_after_the_default_metric_is_nearer_to_the_torus_than_after_plain_quadrics() {
    let mesh = torus(160, 64);
    // Mean angle between the normals that the faces left give their corners, and the torus's.
    let off = |metric| {
        let options = SimplifyOptions { metric, ..SimplifyOptions::to_faces(1000) };
        let s = simplify(&mesh, &options, &mut ()).unwrap().mesh;
        let mut sums = vec![Vec3::ZERO; s.positions.len()];
        for f in &s.faces {
            f.iter().for_each(|v| sums[*v as usize] += s.face_cross(*f));
        }
        let sum: f32 = sums.iter().zip(&s.normals).map(|(a, b)| a.angle_between(*b)).sum();
        sum.to_degrees() / s.positions.len() as f32
    };
    let (plain, ours) = (off(Metric::Qem), off(Metric::NormalQem));
    println!("{plain} {ours}");
    assert!(ours < 0.75 * plain, "{ours} {plain}");
}

#[test]
fn contracted_edges_lie_nearer_than_vertices_that_stay_and_keep_the_kind() {
    let mesh = both(&torus(80, 40), &sphere(4.0, 12), Vec3::ZERO);
    let c = contract(&mesh, 800).unwrap();
    assert_eq!((euler(&c), c.faces.len()), ((2, 0), 800));
    let options = SimplifyOptions { metric: Metric::Qem, ..SimplifyOptions::to_faces(800) };
    let kept = simplify(&mesh, &options, &mut ()).unwrap().mesh;
    let [contracted, kept] = [c, kept].map(|m| deviation(&m, &mesh).unwrap());
    assert!(contracted.mean_mm < 0.8 * kept.mean_mm, "{contracted:?} {kept:?}");
}

#[test]
fn contraction_keeps_cubes_and_the_borders_of_sheets() {
    // All but the edges of a cube is singular.
    let cube = contract(&boxed(8), 12).unwrap();
    assert_eq!((euler(&cube), cube.faces.len()), ((2, 0), 12));
    assert!((cube.volume_mm3() - 8.0).abs() < 1e-5, "{}", cube.volume_mm3());
    let sheet = contract(&sheet(20), 120).unwrap();
    let (number, open) = euler(&sheet);
    assert!(number == 1 && (4..80).contains(&open), "{number} {open}");
    let (lo, hi) = sheet.bounds().unwrap();
    assert!(
        lo.truncate().length() < 0.05 && hi.truncate().distance(glam::Vec2::splat(20.0)) < 0.05
    );
    // Nothing is left to contract: it ends.
    assert!(contract(&boxed(2), 0).unwrap().faces.len() >= 4);
}
