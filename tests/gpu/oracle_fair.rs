//! Normal smoothing against a sparse f64 iteration, and against analytic normals.

use common::fixtures::{bytes, devices, int, json};
use glam::{DVec3, UVec3, Vec3};
use intima::compute::Plan;
use intima::device::Device;
use intima::geometry::Mesh;
use intima::lumen::{BitVolume, Lumen};
use intima::surface::{
    Adjacency, Crossing, Fairing, Midpoint, MultiscaleNormals, Surface, VoxelFrame, Weights,
    face_normals, fair, multiscale_normals, weights,
};
use intima::volume::Grid;

const BOTH: [Weights; 2] = [Weights::Uniform, Weights::InverseDistance];

fn faired(
    device: &mut Device,
    mesh: &Mesh,
    adjacency: &Adjacency,
    start: &[f32],
    kind: Weights,
) -> Vec<DVec3> {
    let weight = weights(mesh, adjacency, kind);
    let mut plan = Plan::new();
    let fairing = Fairing { weights: kind, ..Fairing::PAPER };
    let out = fair(&mut plan, adjacency, &weight, start, fairing);
    plan.download(out);
    let out = device.run(&plan).unwrap();
    let id = plan.downloads()[0];
    let words = out.words(id).iter().map(|w| f64::from(f32::from_bits(*w)));
    let flat: Vec<f64> = words.collect();
    flat.chunks_exact(3).map(DVec3::from_slice).collect()
}

fn floats<const N: usize, T>(bytes: &[u8], of: fn([u8; N]) -> T) -> Vec<T> {
    bytes.chunks_exact(N).map(|b| of(b.try_into().unwrap())).collect()
}

#[test]
fn thirty_smoothing_steps_equal_the_sparse_iteration_within_1e_4_rad() {
    let about = json("fair/about.json");
    for mut device in devices() {
        let device_name = device.name().to_owned();
        for (name, about) in about.as_object().unwrap() {
            let n = int(&about["vertices"]) as usize;
            let input = floats(&bytes(&format!("fair/{name}.in.f32")), f32::from_le_bytes);
            let ids = floats(&bytes(&format!("fair/{name}.faces.u32")), u32::from_le_bytes);
            let want = floats(&bytes(&format!("fair/{name}.out.f64")), f64::from_le_bytes);
            assert_eq!((input.len(), want.len()), (6 * n, 6 * n));
            let mesh = Mesh {
                positions: input[..3 * n].chunks_exact(3).map(Vec3::from_slice).collect(),
                faces: ids.chunks_exact(3).map(|f| [f[0], f[1], f[2]]).collect(),
                ..Mesh::default()
            };
            let start = &input[3 * n..];
            for (own, start) in face_normals(&mesh).iter().zip(start) {
                assert!((own - start).abs() < 1e-6, "{name}: {own}, not {start}");
            }
            let (adjacency, watertight) = Adjacency::of(&mesh);
            assert!(watertight, "{name}");
            for (kind, want) in BOTH.into_iter().zip(want.chunks_exact(3 * n)) {
                let got = faired(&mut device, &mesh, &adjacency, start, kind);
                let worst = got
                    .iter()
                    .zip(want.chunks_exact(3).map(DVec3::from_slice))
                    .map(|(a, b)| a.cross(b).length().atan2(a.dot(b)))
                    .fold(0.0, f64::max);
                println!("{device_name}: {name}, {kind:?}: {worst:.1e} rad");
                assert!(worst <= 1e-4, "{name}, {kind:?}: {worst} rad");
            }
        }
    }
}

/// A shape, its spacing, and the least RMS error (degrees) that any number of smoothing steps reaches
/// on it with uniform and with inverse-distance weights.
struct Row {
    name: &'static str,
    spacing: [f64; 3],
    /// Radius of the ring of a torus, 0 for a ball; and of the ball or tube.
    ring: f64,
    radius: f64,
    best: [f64; 2],
    /// How much smaller than at the start the error must be.
    gain: f64,
}

const THICK: [f64; 3] = [1.0, 1.0, 2.5];
const ISO: [f64; 3] = [1.0; 3];
const TABLE: [Row; 4] = [
    Row {
        name: "sphere R20",
        spacing: ISO,
        ring: 0.0,
        radius: 20.0,
        best: [1.75, 2.09],
        gain: 4.0,
    },
    Row { name: "sphere R5", spacing: ISO, ring: 0.0, radius: 5.0, best: [4.34, 3.15], gain: 2.5 },
    Row {
        name: "torus 24/8",
        spacing: ISO,
        ring: 24.0,
        radius: 8.0,
        best: [2.81, 2.61],
        gain: 4.0,
    },
    Row {
        name: "torus, thick",
        spacing: THICK,
        ring: 24.0,
        radius: 8.0,
        best: [5.41, 3.94],
        gain: 4.0,
    },
];

impl Row {
    /// Off the grid, as the table's: a centre on a voxel gives poles of a single voxel.
    fn centre(&self) -> DVec3 {
        let h = DVec3::from(self.spacing);
        let half = DVec3::new(self.ring + self.radius, self.ring + self.radius, self.radius);
        ((half / h).ceil() + 2.0 + DVec3::new(0.3, 0.2, 0.1)) * h
    }

    /// From the nearest point of the axis.
    fn off_axis(&self, p: DVec3) -> DVec3 {
        let q = p - self.centre();
        q - q.with_z(0.0).normalize_or_zero() * self.ring
    }

    fn lumen(&self) -> Lumen {
        let h = DVec3::from(self.spacing);
        let dims = (2.0 * self.centre() / h).round().as_uvec3() + UVec3::ONE;
        let grid = Grid::axis_aligned(dims.to_array(), self.spacing);
        let mut bits = BitVolume::new(dims);
        for v in (0..grid.len()).map(|i| grid.voxel(i)) {
            if self.off_axis(v.as_dvec3() * h).length() <= self.radius {
                bits.set(v.x, v.y, v.z);
            }
        }
        Lumen::of_volume(grid, &bits)
    }

    /// Root of the mean square angle to the analytic normals, degrees.
    fn rms(&self, mesh: &Mesh, normals: impl Iterator<Item = DVec3>) -> f64 {
        let angle = |(p, n): (&Vec3, DVec3)| {
            let inward = -self.off_axis(p.as_dvec3());
            inward.angle_between(n).to_degrees().powi(2)
        };
        let sum: f64 = mesh.positions.iter().zip(normals).map(angle).sum();
        (sum / mesh.positions.len() as f64).sqrt()
    }
}

#[test]
fn thirty_smoothing_steps_are_near_the_best_number_on_balls_and_tori() {
    println!("{:14} {:>8} {:>16} {:>16}", "degrees RMS", "start", "uniform", "inverse");
    let mut failed = Vec::new();
    for row in &TABLE {
        let surface = Surface::new(&row.lumen(), &Midpoint, None);
        let start = face_normals(&surface.mesh);
        let initial = start.chunks_exact(3).map(|n| Vec3::from_slice(n).as_dvec3());
        let initial = row.rms(&surface.mesh, initial);
        let mut line = format!("{:14} {initial:8.2}", row.name);
        for (kind, best) in BOTH.into_iter().zip(row.best) {
            let mut cpu = Device::Cpu;
            let normals = faired(&mut cpu, &surface.mesh, &surface.adjacency, &start, kind);
            let rms = row.rms(&surface.mesh, normals.into_iter());
            line += &format!(" {rms:8.2} ({best:.2})");
            if rms > 1.4 * best || rms * row.gain > initial {
                failed.push(format!("{}, {kind:?}: {initial} to {rms}, {best}", row.name));
            }
        }
        println!("{line}");
    }
    assert!(failed.is_empty(), "{failed:#?}");
}

fn frame(lumen: &Lumen) -> VoxelFrame {
    VoxelFrame { direction: lumen.grid.direction, spacing_mm: lumen.grid.spacing_mm }
}

fn scaled(device: &mut Device, surface: &Surface, frame: VoxelFrame) -> Vec<DVec3> {
    let scales = MultiscaleNormals::new(&surface.mesh, &surface.adjacency, frame);
    let mut plan = Plan::new();
    let out = multiscale_normals(&mut plan, &surface.adjacency, &scales);
    plan.download(out);
    let got = device.run(&plan).unwrap();
    got.get(out).chunks_exact(3).map(|n| Vec3::from_slice(n).as_dvec3()).collect()
}

/// Errors of thirty steps with the better weights, and of multiscale normals.
fn both(row: &Row, surface: &Surface, frame: VoxelFrame) -> [f64; 2] {
    let start = face_normals(&surface.mesh);
    let steps = BOTH.map(|kind| {
        let (mesh, adjacency) = (&surface.mesh, &surface.adjacency);
        row.rms(mesh, faired(&mut Device::Cpu, mesh, adjacency, &start, kind).into_iter())
    });
    let scales = scaled(&mut Device::Cpu, surface, frame).into_iter();
    [steps[0].min(steps[1]), row.rms(&surface.mesh, scales)]
}

#[test]
fn multiscale_normals_of_ball_and_torus_masks_beat_any_number_of_steps() {
    // Degrees RMS; the last row, three slices to a radius, is where steps are still better.
    for (row, most) in TABLE.iter().zip([0.8, 1.5, 2.2, 5.5]) {
        let lumen = row.lumen();
        let surface = Surface::new(&lumen, &Midpoint, None);
        let [steps, scales] = both(row, &surface, frame(&lumen));
        let [_, guessed] = both(row, &surface, VoxelFrame::of(&surface.mesh));
        println!("{:14} {steps:.2} by steps, {scales:.2}, {guessed:.2} by scales", row.name);
        let best = row.best[0].min(row.best[1]);
        assert!(scales < most, "{}: {scales}", row.name);
        assert!(scales < best || row.spacing == THICK, "{}: {scales}, not {best}", row.name);
        assert!(guessed < 1.1 * scales, "{}: {guessed} without the grid, {scales}", row.name);
    }
}

/// Crossings of the true surface.
struct Exact<'a>(&'a Row, DVec3);

impl Crossing for Exact<'_> {
    fn fraction(&self, inside: glam::IVec3, outside: glam::IVec3) -> f32 {
        let f = |v: glam::IVec3| self.0.off_axis(v.as_dvec3() * self.1).length() - self.0.radius;
        let (a, b) = (f(inside), f(outside));
        ((a / (a - b)) as f32).clamp(0.01, 0.99)
    }
}

#[test]
fn multiscale_normals_of_exact_surfaces_are_as_good_as_by_steps() {
    // Of the better weights' error at thirty steps; three slices to a radius are the hard case.
    for (row, share) in TABLE.iter().zip([1.0, 0.7, 0.8, 1.15]) {
        let lumen = row.lumen();
        let exact = Exact(row, DVec3::from(row.spacing));
        let surface = Surface::new(&lumen, &exact, None);
        let noise = MultiscaleNormals::new(&surface.mesh, &surface.adjacency, frame(&lumen)).noise;
        let [steps, scales] = both(row, &surface, frame(&lumen));
        println!("{:14} {noise:.2} noise, {steps:.2} by steps, {scales:.2} by scales", row.name);
        assert!(noise < 0.5, "{}: noise {noise}", row.name);
        assert!(scales < share * steps, "{}: {steps} by steps, {scales} by scales", row.name);
    }
}

#[test]
fn multiscale_normals_keep_box_faces_flat_and_edges_sharper_than_steps() {
    let grid = Grid::axis_aligned([40, 40, 40], [1.0; 3]);
    let mut bits = BitVolume::new(grid.dims);
    for v in (0..grid.len()).map(|i| grid.voxel(i)) {
        if v.cmpge(UVec3::splat(6)).all() && v.cmplt(UVec3::splat(34)).all() {
            bits.set(v.x, v.y, v.z);
        }
    }
    let surface = Surface::new(&Lumen::of_volume(grid, &bits), &Midpoint, None);
    let off = |normals: &[DVec3], near: f64, far: f64| {
        // Largest and mean turn from the nearest side, between two distances from the box's edge.
        let angles: Vec<f64> = surface
            .mesh
            .positions
            .iter()
            .zip(normals)
            .filter_map(|(p, n)| {
                let q = (p.as_dvec3() - 19.5).abs();
                let mut sorted = q.to_array();
                sorted.sort_by(f64::total_cmp);
                let from_edge = 14.0 - sorted[1];
                (from_edge >= near && from_edge < far)
                    .then(|| n.abs().max_element().min(1.0).acos().to_degrees())
            })
            .collect();
        angles.iter().sum::<f64>() / angles.len() as f64
    };
    let scales = scaled(&mut Device::Cpu, &surface, VoxelFrame::of(&surface.mesh));
    let start = face_normals(&surface.mesh);
    let (mesh, adjacency) = (&surface.mesh, &surface.adjacency);
    let steps = faired(&mut Device::Cpu, mesh, adjacency, &start, Weights::Uniform);
    let [a, b] = [&scales, &steps].map(|n| [off(n, 0.0, 4.0), off(n, 4.0, 20.0)]);
    println!("by scales {a:.2?}, by steps {b:.2?} degrees near edges and away");
    assert!(a[0] < 0.6 * b[0] && a[1] < 1.0, "{a:?}, {b:?}");
}

#[test]
fn multiscale_normals_agree_between_devices_and_thread_counts() {
    let lumen = TABLE[3].lumen();
    let surface = Surface::new(&lumen, &Midpoint, None);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| scaled(&mut Device::Cpu, &surface, frame(&lumen)))
    };
    let want = on(1);
    assert_eq!(want, on(3));
    for mut device in devices() {
        let got = scaled(&mut device, &surface, frame(&lumen));
        let worst = got.iter().zip(&want).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        println!("{}: {worst:.1e}", device.name());
        assert!(worst < 1e-3, "{}: {worst}", device.name());
    }
}

#[test]
fn multiscale_normals_of_broken_meshes_are_unit_vectors() {
    let far = Vec3::splat(f32::MAX / 4.0);
    let meshes = [
        Mesh::default(),
        Mesh { positions: vec![Vec3::ZERO; 3], faces: vec![[0, 1, 2]], ..Mesh::default() },
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE, far],
            faces: vec![[0, 1, 2], [0, 1, 2], [0, 0, 1], [4, 1, 2]],
            ..Mesh::default()
        },
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, 2.0 * Vec3::X, 1e-30 * Vec3::Y],
            faces: vec![[0, 1, 2], [0, 3, 1]],
            ..Mesh::default()
        },
    ];
    for (i, mesh) in meshes.into_iter().enumerate() {
        let (adjacency, _) = Adjacency::of(&mesh);
        let frame = VoxelFrame::of(&mesh);
        let scales = MultiscaleNormals::new(&mesh, &adjacency, frame);
        let mut plan = Plan::new();
        let out = multiscale_normals(&mut plan, &adjacency, &scales);
        plan.download(out);
        let got = intima::compute::run_cpu(&plan);
        for n in got.get(out).chunks_exact(3).map(Vec3::from_slice) {
            assert!((n.length() - 1.0).abs() < 1e-5, "mesh {i}: {n}");
        }
    }
}
