//! The distance transform against SciPy's, on every fixture mask, and against a search through all
//! external voxels, on deep random masks.

use common::fixtures::{devices, lumen, masks, path, volume};
use glam::{DVec3, IVec3};
use intima::compute::Plan;
use intima::device::Device;
use intima::field::{LumenBuffers, distance};
use intima::lumen::{BitVolume, Lumen};
use intima::volume::Grid;
use rayon::prelude::*;

#[test]
fn distance_is_scipys_and_its_isotropic_square_is_exact() {
    for mut device in devices() {
        let name_of_device = device.name().to_owned();
        let (mut worst, mut compared, mut squares) = (0.0f64, 0usize, 0usize);
        for (name, _) in masks() {
            let lumen = lumen(&name);
            let want = volume(&format!("mask/{name}.edt.nrrd"));
            let mut plan = Plan::new();
            let buffers = LumenBuffers::new(&mut plan, &lumen);
            let d = distance(&mut plan, &buffers);
            plan.download(d);
            let out = device.run(&plan).unwrap();
            let d = lumen.dense(out.get(d), 0.0);
            let square = format!("mask/{name}.edt2.nrrd");
            let square = path(&square).exists().then(|| volume(&square));
            let h = lumen.grid.spacing_mm;
            assert_eq!(square.is_some(), h.x == h.y && h.y == h.z, "{name}");
            for (i, &d) in d.iter().enumerate() {
                let (d, want) = (f64::from(d), want.real(i));
                let at = format!("{name} on {name_of_device}, voxel {}", lumen.grid.voxel(i));
                let error = (d - want).abs();
                assert!(error <= 1e-6 * want, "{at}: {d}, not {want}");
                worst = worst.max(error / want.max(1.0));
                compared += usize::from(want > 0.0);
                if let Some(square) = &square {
                    let got = (d / h.x).powi(2);
                    assert_eq!(got.round(), square.real(i), "{at}: {got}");
                    squares += usize::from(got > 0.0);
                }
            }
        }
        println!("{name_of_device}: {compared} voxels, {squares} squares, worst {worst:.1e}");
        assert!(compared > 40_000 && squares > 20_000, "{compared}, {squares}");
    }
}

/// Numbers from 0 to 1 that look random.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Balls of random places and radii, with specks of outside in them: `depth` voxels deep about.
fn random_mask(dims: [u32; 3], depth: f64, specks: usize, seed: u64) -> BitVolume {
    let mut noise = Noise(seed);
    let size = DVec3::from(dims.map(f64::from));
    let mut place = |share: f64| {
        let p = DVec3::new(noise.next(), noise.next(), noise.next());
        (size * (0.5 + share * (p - 0.5)), noise.next())
    };
    let balls: Vec<(DVec3, f64)> = std::iter::once((0.5 * size, depth + 2.0))
        .chain((0..12).map(|_| {
            let (p, r) = place(1.0);
            (p, depth * (0.2 + 0.6 * r))
        }))
        .collect();
    // Not in the middle, or nothing would be deep.
    let specks: Vec<IVec3> = (0..specks)
        .map(|_| place(1.0).0.as_ivec3())
        .filter(|s| s.as_dvec3().distance(0.5 * size) > depth)
        .collect();
    let mut bits = BitVolume::new(dims.into());
    let grid = Grid::axis_aligned(dims, [1.0; 3]);
    for v in (0..grid.len()).map(|i| grid.voxel(i)) {
        let p = v.as_dvec3();
        let is_inside = balls.iter().any(|(c, r)| p.distance(*c) <= *r);
        if is_inside && !specks.contains(&v.as_ivec3()) {
            bits.set(v.x, v.y, v.z);
        }
    }
    bits
}

/// Distance of some inside voxels to the nearest external voxel, by trying each that has an inside
/// 6-neighbour: the nearest one does, or one step towards the voxel would be nearer still.
fn by_search(lumen: &Lumen, every: usize) -> Vec<(usize, f64)> {
    let h = lumen.grid.spacing_mm;
    let steps = [IVec3::X, IVec3::Y, IVec3::Z].into_iter().flat_map(|d| [d, -d]);
    let mut external: Vec<[i32; 3]> = lumen
        .elements(&lumen.boundary)
        .flat_map(|e| steps.clone().map(move |d| lumen.bricks.voxel(e) + d))
        .filter(|v| !lumen.holds(*v))
        .map(|v| v.to_array())
        .collect();
    external.sort_unstable();
    external.dedup();
    let inside: Vec<usize> = lumen.elements(&lumen.inside).step_by(every).collect();
    inside
        .into_par_iter()
        .map(|e| {
            let p = lumen.bricks.voxel(e);
            let off = |v: &[i32; 3]| ((IVec3::from(*v) - p).as_dvec3() * h).length_squared();
            (e, external.iter().map(off).fold(f64::INFINITY, f64::min).sqrt())
        })
        .collect()
}

#[test]
fn distance_is_that_of_a_search_on_random_masks_20_to_40_voxels_deep() {
    let cases = [
        ([90, 70, 80], 22.0, 30, [1.0; 3], 11),
        ([96, 90, 100], 40.0, 12, [0.7, 0.7, 0.7], 5),
        ([80, 84, 60], 26.0, 20, [0.8, 0.6, 1.9], 3),
        // Touches all sides of the volume.
        ([50, 48, 44], 38.0, 6, [1.0, 1.0, 2.5], 17),
    ];
    let mut all: Vec<Device> = devices();
    for (dims, depth, specks, spacing, seed) in cases {
        let lumen = Lumen::of_volume(
            Grid::axis_aligned(dims, spacing),
            &random_mask(dims, depth, specks, seed),
        );
        let want = by_search(&lumen, 13);
        let deepest = want.iter().map(|w| w.1).fold(0.0, f64::max);
        let least = 20.0 * spacing[0].min(spacing[1]);
        assert!(deepest > least, "{dims:?}: only {deepest} mm deep");
        for device in &mut all {
            let mut plan = Plan::new();
            let buffers = LumenBuffers::new(&mut plan, &lumen);
            let d = distance(&mut plan, &buffers);
            plan.download(d);
            let out = device.run(&plan).unwrap();
            let d = out.get(d);
            for (e, want) in &want {
                let error = (f64::from(d[*e]) - want).abs();
                let at = lumen.bricks.voxel(*e);
                assert!(
                    error <= 1e-6 * want,
                    "{}, voxel {at}: {} not {want}",
                    device.name(),
                    d[*e]
                );
            }
            println!("{}: {} voxels to {deepest:.1} mm deep", device.name(), want.len());
        }
    }
}
