use glam::{DMat3, DQuat, DVec2, DVec3, IVec3, UVec3, Vec3};

use super::*;
use crate::compute::run_cpu;
use crate::lumen::BitVolume;
use crate::surface::{MultiscaleNormals, Surface, VoxelFrame, extract, multiscale_normals};
use crate::volume::Grid;

/// Uniform numbers in [0, 1).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ z >> 31) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn point(&mut self) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next())
    }

    /// Uniform over rotations.
    fn rotation(&mut self) -> DMat3 {
        let [u, a, b] = self.point().to_array();
        let ((s, c), (t, d)) =
            ((std::f64::consts::TAU * a).sin_cos(), (std::f64::consts::TAU * b).sin_cos());
        let q = [(1.0 - u).sqrt() * s, (1.0 - u).sqrt() * c, u.sqrt() * t, u.sqrt() * d];
        DMat3::from_quat(DQuat::from_array(q).normalize())
    }
}

/// Voxels of a grid whose centre (grid-aligned mm) is inside.
fn lumen(grid: Grid, inside: impl Fn(DVec3) -> bool) -> Lumen {
    let mut bits = BitVolume::new(grid.dims);
    for v in (0..grid.len()).map(|i| grid.voxel(i)) {
        if inside(v.as_dvec3() * grid.spacing_mm) {
            bits.set(v.x, v.y, v.z);
        }
    }
    Lumen::of_volume(grid, &bits)
}

fn cube(size: u32, inside: impl Fn(DVec3) -> bool) -> Lumen {
    lumen(Grid::axis_aligned([size; 3], [1.0; 3]), inside)
}

/// Halfway wall, fractions and relaxed positions of a lumen.
struct Relaxed {
    surface: Surface,
    normals: Vec<f32>,
    fractions: Vec<f32>,
    positions: Vec<Vec3>,
}

impl Relaxed {
    fn new(lumen: &Lumen) -> Self {
        let surface = Surface::new(lumen, &Midpoint, None);
        let input = RelaxInput::new(&surface.mesh, lumen).unwrap();
        let Surface { mesh, adjacency, .. } = &surface;
        let grid = &lumen.grid;
        let frame = VoxelFrame { direction: grid.direction, spacing_mm: grid.spacing_mm };
        let scales = MultiscaleNormals::new(mesh, adjacency, frame);
        let mut plan = Plan::new();
        let normals = multiscale_normals(&mut plan, adjacency, &scales);
        let fractions = relax(&mut plan, adjacency, &input, normals);
        plan.download(fractions);
        plan.download(normals);
        let out = run_cpu(&plan);
        let (normals, fractions) = (out.get(normals).to_vec(), out.get(fractions).to_vec());
        let positions = input.positions(&mesh.positions, &fractions);
        Self { surface, normals, fractions, positions }
    }

    fn mesh(&self) -> Mesh {
        Mesh { positions: self.positions.clone(), ..self.surface.mesh.clone() }
    }
}

/// Voxels about whose centre the mesh winds, by rays along +x. They pass a voxel centre at 0.016
/// voxels, as vertices lie on the grid lines themselves.
fn filled(mesh: &Mesh, grid: &Grid) -> BitVolume {
    let offset = DVec2::new(0.0137, 0.0071);
    let (nx, dims) = (grid.dims.x as usize, grid.dims);
    let mut winding = vec![0i32; grid.len()];
    for face in &mesh.faces {
        let p = face.map(|v| {
            let p = mesh.positions[v as usize].as_dvec3();
            grid.voxel_from_world().transform_point3(p)
        });
        let flat = p.map(|p| DVec2::new(p.y, p.z) - offset);
        let low = flat[0].min(flat[1]).min(flat[2]).ceil().max(DVec2::ZERO).as_uvec2();
        let high = flat[0].max(flat[1]).max(flat[2]).floor();
        for z in (low.y..dims.z).take_while(|z| f64::from(*z) <= high.y) {
            for y in (low.x..dims.y).take_while(|y| f64::from(*y) <= high.x) {
                let at = DVec2::new(f64::from(y), f64::from(z));
                let part = |i: usize| {
                    let (q, r) = (flat[(i + 1) % 3], flat[(i + 2) % 3]);
                    (r - q).perp_dot(at - q)
                };
                let w = [part(0), part(1), part(2)];
                let turn = if w.iter().all(|w| *w > 0.0) {
                    1
                } else if w.iter().all(|w| *w < 0.0) {
                    -1
                } else {
                    continue;
                };
                let sum: f64 = w.iter().sum();
                let x = (w[0] * p[0].x + w[1] * p[1].x + w[2] * p[2].x) / sum;
                let first = x.ceil().max(0.0) as usize;
                let row = grid.index(UVec3::new(0, y, z));
                for i in first..nx {
                    winding[row + i] += turn;
                }
            }
        }
    }
    let mut bits = BitVolume::new(dims);
    for (i, w) in winding.iter().enumerate().filter(|(_, w)| **w != 0) {
        assert_eq!(w.abs(), 1, "voxel {i}");
        let v = grid.voxel(i);
        bits.set(v.x, v.y, v.z);
    }
    bits
}

fn assert_sides(mesh: &Mesh, lumen: &Lumen, what: &str) {
    let got = filled(mesh, &lumen.grid);
    let wrong = (0..lumen.grid.len())
        .map(|i| lumen.grid.voxel(i))
        .filter(|v| got.at(v.x, v.y, v.z) != lumen.holds(v.as_ivec3()))
        .count();
    assert_eq!(wrong, 0, "{what}: voxel centres on the wrong side");
}

/// Masks that hold every neighbourhood: random ones, and each of the 256 cells by itself.
fn hard_masks() -> Vec<Lumen> {
    let mut random = Random(7);
    let mut all: Vec<Lumen> = [0.1, 0.3, 0.5, 0.7, 0.9]
        .into_iter()
        .map(|density| {
            let bits: Vec<bool> = (0..24 * 24 * 24).map(|_| random.next() < density).collect();
            let at = |p: DVec3| p.as_uvec3().dot(UVec3::new(1, 24, 576)) as usize;
            cube(24, |p| bits[at(p)])
        })
        .collect();
    all.push(lumen(Grid::axis_aligned([32, 32, 16], [0.8, 0.7, 0.9]), |p| {
        let v = (p / DVec3::new(0.8, 0.7, 0.9)).round().as_uvec3();
        let (cell, place) = (v / 4, v % 4);
        let case = cell.dot(UVec3::new(1, 8, 64));
        let corner = place.wrapping_sub(UVec3::ONE);
        corner.max_element() < 2 && case >> corner.dot(UVec3::new(1, 2, 4)) & 1 != 0
    }));
    all
}

#[test]
fn voxel_centers_keep_their_side_of_the_relaxed_wall() {
    for (i, lumen) in hard_masks().iter().enumerate() {
        let relaxed = Relaxed::new(lumen);
        assert!(relaxed.fractions.iter().any(|s| s.abs() > 0.05), "mask {i}");
        assert_sides(&relaxed.mesh(), lumen, &format!("mask {i}"));
        let again = Surface::of(relaxed.mesh(), lumen, None);
        assert_eq!(again.topology, relaxed.surface.topology, "mask {i}");
    }
}

#[test]
fn voxel_centers_keep_their_side_at_the_limits_of_the_fractions() {
    let mut random = Random(11);
    for (i, lumen) in hard_masks().iter().enumerate() {
        let surface = Surface::new(lumen, &Midpoint, None);
        let input = RelaxInput::new(&surface.mesh, lumen).unwrap();
        let p = input.params();
        let limit = [p.limit_x, p.limit_y, p.limit_z];
        let places: Vec<f32> = (input.edges.iter())
            .map(|e| if random.next() < 0.5 { 1.0 } else { -1.0 } * limit[edge_axis(*e)])
            .collect();
        let positions = input.positions(&surface.mesh.positions, &places);
        assert_sides(&Mesh { positions, ..surface.mesh }, lumen, &format!("mask {i}"));
    }
}

#[test]
fn fractions_point_outward_within_their_limits_and_are_zero_where_the_volume_ends() {
    let lumen = cube(24, |p| (p.truncate() - 11.3).length() < 7.0);
    assert!(lumen.touches_edge);
    let relaxed = Relaxed::new(&lumen);
    let edges = vertex_edges(&lumen);
    let mut ends = 0;
    let moves = relaxed.positions.iter().zip(&relaxed.surface.mesh.positions);
    for ((edge, s), (x, m)) in edges.iter().zip(&relaxed.fractions).zip(moves) {
        assert!(s.abs() <= 0.375);
        let outward = (edge.outside - edge.inside).as_vec3();
        assert!((*x - *m - *s * outward).length() < 1e-5);
        if !lumen.grid.contains(edge.outside) {
            assert_eq!(*s, 0.0);
            ends += 1;
        }
    }
    assert!(ends > 200, "{ends}");
}

#[test]
fn vertex_edges_are_those_of_the_extracted_vertices() {
    for lumen in hard_masks() {
        let (mesh, edges) = (extract(&lumen, &Midpoint), vertex_edges(&lumen));
        assert_eq!(mesh.positions.len(), edges.len());
        let h = lumen.grid.spacing_mm;
        for (p, e) in mesh.positions.iter().zip(edges) {
            assert!(lumen.holds(e.inside) && !lumen.holds(e.outside));
            let halfway = (0.5 * (e.inside + e.outside).as_dvec3() * h).as_vec3();
            assert!(p.distance(halfway) < 1e-5);
        }
    }
}

#[test]
fn a_kept_component_has_the_grid_edges_of_its_vertices() {
    let two = |p: DVec3| (p - 6.2).length() < 4.0 || (p - 16.7).length() < 5.0;
    let lumen = cube(24, two);
    let all = RelaxInput::new(&extract(&lumen, &Midpoint), &lumen).unwrap();
    let one = Surface::new(&lumen, &Midpoint, Some(IVec3::splat(17)));
    let own = RelaxInput::new(&one.mesh, &lumen).unwrap();
    let mesh = extract(&lumen, &Midpoint);
    let kept = all.edges.iter().zip(&mesh.positions).filter(|(_, p)| p.x + p.y + p.z > 33.0);
    let kept: Vec<u32> = kept.map(|(e, _)| *e).collect();
    assert!(own.edges.len() < all.edges.len() && own.edges == kept);
}

#[test]
fn fractions_have_the_same_bytes_at_any_number_of_threads() {
    let lumen = cube(90, |p| (p - DVec3::new(44.3, 45.1, 44.8)).length() < 40.0);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let relaxed = pool.install(|| Relaxed::new(&lumen));
        let bits = |all: &[f32]| all.iter().map(|s| s.to_bits()).collect::<Vec<_>>();
        (bits(&relaxed.fractions), bits(bytemuck::cast_slice(&relaxed.positions)))
    };
    let one = run(1);
    assert!(one.0.len() > 25_000);
    for threads in [2, 5, 7] {
        assert!(run(threads) == one, "{threads} threads");
    }
}

#[test]
fn fractions_do_not_depend_on_the_unit_of_length() {
    let ball = |spacing: [f64; 3]| {
        let h = DVec3::from(spacing);
        lumen(Grid::axis_aligned([26, 26, 20], spacing), move |p| {
            (p / h - DVec3::new(12.3, 12.9, 9.6)).length() < 8.7
        })
    };
    for spacing in [[1.0; 3], [0.75, 0.7, 1.25]] {
        let one = Relaxed::new(&ball(spacing));
        let eight = Relaxed::new(&ball(spacing.map(|h| 8.0 * h)));
        assert_eq!(one.fractions, eight.fractions);
    }
}

#[test]
fn fractions_do_not_depend_on_where_the_patient_lies() {
    let mut straight = cube(26, |p| (p - DVec3::new(12.3, 12.9, 9.6)).length() < 8.7);
    let want = Relaxed::new(&straight).fractions;
    let turn = Random(3).rotation();
    for direction in [turn, turn * DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0))] {
        straight.grid.direction = direction;
        straight.grid.origin_mm = DVec3::new(31.0, -57.0, 83.0);
        let got = Relaxed::new(&straight).fractions;
        let off = want.iter().zip(&got).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off < 2e-3, "{off}");
    }
}

#[test]
fn slices_over_three_times_as_thick_as_wide_are_refused() {
    let ball = |thick: f64| {
        lumen(Grid::axis_aligned([9, 9, 9], [0.7, 0.7, thick]), |p| {
            (p - DVec3::new(3.0, 3.0, 4.0 * thick)).length() < 2.0
        })
    };
    let made = |l: &Lumen| RelaxInput::new(&extract(l, &Midpoint), l).err();
    assert_eq!(made(&ball(2.1)), None);
    let Some(RelaxError::SpacingRatio { ratio }) = made(&ball(2.8)) else { panic!("not refused") };
    assert!((ratio - 4.0).abs() < 1e-9);
    let default = |z| relaxes_by_default(DVec3::new(0.7, 0.7, z));
    assert!(default(0.7) && default(1.4) && !default(1.5));
}

/// An implicit shape about the origin: signed distance, mm.
type Shape = fn(DVec3) -> f64;

fn ball(p: DVec3) -> f64 {
    p.length() - 20.0
}
fn torus(p: DVec3) -> f64 {
    (p.truncate().length() - 14.0).hypot(p.z) - 5.0
}
fn tube_2(p: DVec3) -> f64 {
    p.truncate().length() - 2.0
}
fn tube_5(p: DVec3) -> f64 {
    p.truncate().length() - 5.0
}
fn capsule(p: DVec3) -> f64 {
    (p - DVec3::Z * p.z.clamp(-10.0, 10.0)).length() - 7.0
}
fn plate(p: DVec3) -> f64 {
    p.z.abs() - 0.75
}

/// Distances of vertices to the true wall: rms of the halfway wall, and rms and mean (negative
/// inside the lumen) of the relaxed one.
#[derive(Clone, Copy, Default)]
struct Errors {
    halfway: f64,
    relaxed: f64,
    mean: f64,
}

/// Errors of a shape in one pose; shapes may leave the volume.
fn errors(shape: impl Fn(DVec3) -> f64, turn: DMat3, shift: DVec3, spacing: [f64; 3]) -> Errors {
    let h = DVec3::from(spacing);
    let dims = (48.0 / h).ceil();
    let centre = 0.5 * dims * h + shift * h;
    let at = |p: DVec3| shape(turn.transpose() * (p - centre));
    let lumen = lumen(Grid::axis_aligned(dims.as_uvec3().to_array(), spacing), |p| at(p) < 0.0);
    let relaxed = Relaxed::new(&lumen);
    let (mut sum, mut count) = (Errors::default(), 0.0);
    for (m, x) in relaxed.surface.mesh.positions.iter().zip(&relaxed.positions) {
        let v = m.as_dvec3() / h;
        // Not where the volume cuts the shape off.
        let is_near_edge = v.min_element() < 6.0 || (dims - v).min_element() < 7.0;
        if is_near_edge && lumen.touches_edge {
            continue;
        }
        let off = at(x.as_dvec3());
        sum.halfway += at(m.as_dvec3()).powi(2);
        sum.relaxed += off * off;
        sum.mean += off;
        count += 1.0;
    }
    assert!(count > 200.0, "{count} vertices");
    let rms = |sum: f64| (sum / count).sqrt();
    Errors { halfway: rms(sum.halfway), relaxed: rms(sum.relaxed), mean: sum.mean / count }
}

/// Mean errors over eight poses.
fn over_poses(shape: Shape, seed: u64, spacing: [f64; 3]) -> Errors {
    let mut random = Random(seed);
    let mut mean = Errors::default();
    for _ in 0..8 {
        let e = errors(shape, random.rotation(), random.point() - 0.5, spacing);
        mean.halfway += e.halfway / 8.0;
        mean.relaxed += e.relaxed / 8.0;
        mean.mean += e.mean / 8.0;
    }
    mean
}

#[test]
fn relaxed_walls_are_near_the_true_wall_in_random_poses() {
    let shapes: [(&str, Shape, f64); 6] = [
        ("ball", ball, 0.05),
        ("torus", torus, 0.065),
        ("tube 2", tube_2, 0.12),
        ("tube 5", tube_5, 0.08),
        ("capsule", capsule, 0.07),
        ("plate", plate, 0.2),
    ];
    for (name, shape, most) in shapes {
        let e = over_poses(shape, 0x5eed, [1.0; 3]);
        println!("{name:8} {:.3} -> {:.3}, mean {:+.3}", e.halfway, e.relaxed, e.mean);
        assert!(e.relaxed <= most, "{name}: rms {:.3} from {:.3}", e.relaxed, e.halfway);
        assert!(e.mean.abs() < 0.03, "{name}: mean {:.3}", e.mean);
    }
}

#[test]
fn relaxed_walls_are_near_the_true_wall_at_moderate_spacing_ratios() {
    for (ratio, most) in [(1.5, 0.07), (2.0, 0.09)] {
        let e = over_poses(ball, 0xfeed, [1.0, 1.0, ratio]);
        println!("ball, ratio {ratio}: {:.3} -> {:.3}", e.halfway, e.relaxed);
        assert!(e.relaxed <= most, "ratio {ratio}: rms {:.3} from {:.3}", e.relaxed, e.halfway);
    }
}

/// A torus along the grid has plateaus, which keep their phase.
#[test]
fn relaxed_walls_are_near_the_true_wall_of_a_torus_along_the_grid() {
    let e = errors(torus, DMat3::IDENTITY, DVec3::new(0.13, 0.21, 0.07), [1.0; 3]);
    println!("torus along the grid: {:.3} -> {:.3}", e.halfway, e.relaxed);
    assert!(e.relaxed < 0.12);
}

/// Mean height over the wall of balls on a tube of radius 12, halfway and relaxed.
fn polyp_heights(r: f64, spacing: [f64; 3]) -> [f64; 2] {
    const COUNT: usize = 56;
    let h = DVec3::from(spacing);
    let mut random = Random(77);
    let axis = DVec2::new(15.3, 15.6);
    let pitch = 2.0 * r + 7.0;
    let centers: Vec<DVec3> = (0..COUNT)
        .map(|i| {
            let (s, c) = (std::f64::consts::TAU * random.next()).sin_cos();
            let z = 8.0 + pitch * (i as f64 + 0.5) + random.next();
            (axis + 12.0 * DVec2::new(c, s)).extend(z)
        })
        .collect();
    let size = DVec3::new(31.0, 31.0, 16.0 + pitch * COUNT as f64);
    let dims = (size / h).ceil().as_uvec3().to_array();
    let lumen = lumen(Grid::axis_aligned(dims, spacing), |p| {
        let nearest = ((p.z - 8.0) / pitch).max(0.0) as usize;
        let near = nearest.saturating_sub(1)..(nearest + 2).min(COUNT);
        (p.truncate() - axis).length() < 12.0
            && !centers.get(near).is_some_and(|c| c.iter().any(|c| (p - *c).length() < r))
    });
    let relaxed = Relaxed::new(&lumen);
    [&relaxed.surface.mesh.positions, &relaxed.positions].map(|positions| {
        let top = |c: &DVec3| {
            let all = positions.iter().map(|p| p.as_dvec3());
            let on = all.filter(|p| (*p - *c).length() < r + 1.0);
            on.map(|p| 12.0 - (p.truncate() - axis).length()).fold(0.0, f64::max)
        };
        centers.iter().map(top).sum::<f64>() / COUNT as f64
    })
}

#[test]
fn polyps_keep_their_height_at_even_spacing() {
    for (r, share) in [(1.5, 0.15), (2.0, 0.05), (3.0, 0.03), (5.0, 0.03)] {
        let [halfway, relaxed] = polyp_heights(r, [1.0; 3]);
        println!("polyp {r}: {halfway:.2} -> {relaxed:.2}");
        assert!((relaxed / r - 1.0).abs() < share, "radius {r}: {relaxed:.3} from {halfway:.3}");
    }
}

#[test]
fn no_face_of_a_relaxed_wall_turns_by_a_right_angle_on_smooth_shapes() {
    let mut random = Random(5);
    for shape in [ball as Shape, torus, capsule] {
        let (turn, shift) = (random.rotation(), random.point());
        let lumen = cube(50, |p| shape(turn.transpose() * (p - 24.0 - shift)) < 0.0);
        let relaxed = Relaxed::new(&lumen);
        let (before, after) = (&relaxed.surface.mesh, relaxed.mesh());
        let cosine =
            |f: &[u32; 3]| before.face_cross(*f).normalize().dot(after.face_cross(*f).normalize());
        let least = before.faces.iter().map(cosine).fold(1.0, f32::min);
        println!("largest turn {:.1} degrees", least.acos().to_degrees());
        assert!(least > 0.2, "{least}");
    }
}

#[test]
fn volume_of_a_relaxed_ball_is_that_of_the_halfway_wall() {
    let lumen = cube(50, |p| (p - DVec3::new(24.3, 24.1, 24.8)).length() < 20.0);
    let relaxed = Relaxed::new(&lumen);
    let share = relaxed.mesh().volume_mm3() / relaxed.surface.mesh.volume_mm3();
    assert!((share - 1.0).abs() < 3e-3, "{share}");
}

#[test]
fn smoothed_normals_of_the_halfway_wall_beat_those_of_the_relaxed_faces() {
    let centre = DVec3::new(24.3, 24.1, 24.8);
    let lumen = cube(50, |p| (p - centre).length() < 20.0);
    let relaxed = Relaxed::new(&lumen);
    let mean = |normals: &[f32]| {
        let angle = |(p, n): (&Vec3, &[f32])| {
            let want = centre.as_vec3() - *p;
            want.angle_between(Vec3::from_slice(n)).to_degrees()
        };
        let sum: f32 = relaxed.positions.iter().zip(normals.chunks_exact(3)).map(angle).sum();
        sum / relaxed.positions.len() as f32
    };
    let faces = mean(&crate::surface::face_normals(&relaxed.mesh()));
    let halfway = mean(&crate::surface::face_normals(&relaxed.surface.mesh));
    let smooth = mean(&relaxed.normals);
    println!("mean angle: smoothed {smooth:.2}, faces {halfway:.2} -> {faces:.2}");
    assert!(smooth < faces && faces < 0.3 * halfway);
}
