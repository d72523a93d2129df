//! Walls of phantoms with known truth.

use glam::{DVec3, IVec3, UVec3};
use rayon::prelude::*;

use super::*;
use crate::compute::Plan;
use crate::compute::run_cpu;
use crate::lumen::{BitVolume, fill_cavities};
use crate::surface::{Adjacency, extract};
use crate::volume::{Grid, Volume};

/// Spacing of the phantoms, mm.
const H: f64 = 0.7;

/// A CT of values by place (mm), averaged over 3³ samples a voxel, blurred by 0.6 voxel, with noise.
fn scan(dims: [u32; 3], noise: f64, value: impl Fn(DVec3) -> f64 + Sync) -> Volume {
    let grid = Grid::axis_aligned(dims, [H; 3]);
    let raw: Vec<f64> = (0..grid.len())
        .into_par_iter()
        .map(|i| {
            let v = grid.voxel(i).as_dvec3();
            let part = |k: i32| (f64::from(k) - 1.0) / 3.0;
            let samples =
                (0..27).map(|k| v + DVec3::new(part(k % 3), part(k / 3 % 3), part(k / 9)));
            samples.map(|p| value(p * H)).sum::<f64>() / 27.0
        })
        .collect();
    let mut values = raw;
    for axis in 0..3 {
        let weight = [0.664, 0.166, 0.002].map(|w: f64| w / (0.664 + 2.0 * 0.168));
        let at = |values: &[f64], v: UVec3, k: i32| {
            let mut p = v.as_ivec3();
            p[axis] = (p[axis] + k).clamp(0, dims[axis] as i32 - 1);
            values[grid.index(p.as_uvec3())]
        };
        values = (0..grid.len())
            .into_par_iter()
            .map(|i| {
                let v = grid.voxel(i);
                (-2i32..=2).map(|k| weight[k.unsigned_abs() as usize] * at(&values, v, k)).sum()
            })
            .collect();
    }
    let mut seed = 9u64;
    let mut uniform = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as f64 / (1u64 << 31) as f64 - 0.5
    };
    let samples: Vec<i16> = values
        .iter()
        .map(|v| (v + noise * (0..12).map(|_| uniform()).sum::<f64>()).round() as i16)
        .collect();
    Volume::new(grid, samples.into())
}

/// Voxels below a value of the component of a seed.
fn core(volume: &Volume, below: f64, seed: UVec3) -> BitVolume {
    let range = crate::lumen::IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: below };
    let mut core = crate::lumen::grow(volume, &range, seed).expect("a seed in the lumen");
    fill_cavities(&mut core);
    core
}

fn wall_of(volume: &Volume, core: &BitVolume, tissue: Tissue) -> (Lumen, WallField) {
    wall_of_input(WallInput::new(volume.into(), core, tissue).expect("contrast"))
}

fn wall_of_input(input: WallInput<'_>) -> (Lumen, WallField) {
    let (buffers, mut out) = {
        let mut plan = Plan::new();
        let buffers = input.profile(&mut plan);
        (buffers, run_cpu(&plan))
    };
    let profile = input.select(&buffers, &mut out).expect("a lumen");
    let moved = {
        let mut plan = Plan::new();
        let moved = profile.correct(&mut plan);
        run_cpu(&plan).take(moved)
    };
    profile.finish(&moved).expect("a lumen")
}

/// A tilted tube of air with a wall in lung, the signed distance from its inner face.
fn tube(radius: f64) -> impl Fn(DVec3) -> f64 + Sync + Copy {
    move |p: DVec3| {
        let along = DVec3::new(0.2, -0.15, 1.0).normalize();
        let q = p - DVec3::new(13.1, 15.4, 0.0);
        q.reject_from_normalized(along).length() - radius
    }
}

fn bronchus(radius: f64, noise: f64) -> (Volume, BitVolume) {
    let off = tube(radius);
    let volume = scan([44, 42, 30], noise, |p| match off(p) {
        d if d < 0.0 => -950.0,
        d if d < 1.2 => 40.0,
        _ => -850.0,
    });
    let seed = UVec3::new(21, 20, 15);
    let core = core(&volume, -890.0, seed);
    (volume, core)
}

/// Mean and rms of the vertices' distance from a wall, away from the volume's ends, mm.
fn error(lumen: &Lumen, field: &WallField, off: impl Fn(DVec3) -> f64) -> (f64, f64) {
    let mesh = extract(lumen, &FieldCrossing { lumen, field });
    let top = (f64::from(lumen.volume_grid().dims.z) - 4.0) * H;
    let inner = |p: &&glam::Vec3| (3.0 * H..top).contains(&f64::from(p.z));
    let all: Vec<f64> = mesh.positions.iter().filter(inner).map(|p| off(p.as_dvec3())).collect();
    assert!(all.len() > 200, "{} vertices", all.len());
    let n = all.len() as f64;
    (all.iter().sum::<f64>() / n, (all.iter().map(|d| d * d).sum::<f64>() / n).sqrt())
}

#[test]
fn a_splinter_that_the_field_parts_from_its_vessel_is_no_piece_to_fly_through() {
    // A vessel and a side branch on one core; the field closes the way between them.
    let parted = |branch: u32, in_one_core: bool| {
        let mut core = BitVolume::new(UVec3::new(64, 48, 48));
        let boxed = |mask: &mut BitVolume, lo: [u32; 3], hi: [u32; 3]| {
            for z in lo[2]..hi[2] {
                for y in lo[1]..hi[1] {
                    mask.set_run((lo[0], hi[0] - 1), y, z);
                }
            }
        };
        boxed(&mut core, [4, 4, 4], [34, 34, 34]);
        boxed(&mut core, [40, 8, 8], [40 + branch, 8 + branch, 8 + branch]);
        let parts = core.clone();
        if in_one_core {
            boxed(&mut core, [34, 9, 9], [40, 10, 10]);
        }
        let bricks = crate::lumen::surrounding_bricks(&core, 2.0);
        let is_lumen = |e: usize| {
            let v = bricks.voxel(e);
            let is_in = v.cmpge(IVec3::ZERO).all() && v.cmplt(IVec3::new(64, 48, 48)).all();
            is_in && parts.at(v.x as u32, v.y as u32, v.z as u32)
        };
        select::lumen(&bricks, &core, is_lumen).expect("a lumen").count() - 27_000
    };
    assert_eq!(parted(5, true), 0, "125 of 27,000 voxels are a splinter");
    assert_eq!(parted(5, false), 125, "with a core of its own it was asked for");
    assert_eq!(parted(6, true), 216, "a larger part is kept");
}

#[test]
fn a_hole_in_a_bronchus_is_wall_not_seen_and_the_rest_is_seen() {
    let off = tube(3.0);
    // On one side, over nine millimetres, air goes on as if there were no wall.
    let in_hole = |p: DVec3| p.x > 13.1 + 0.2 && (6.0..15.0).contains(&p.z);
    let volume = scan([44, 42, 30], 0.0, |p| match off(p) {
        d if d < 0.0 || (d < 5.0 && in_hole(p)) => -950.0,
        d if d < 1.2 => 40.0,
        _ => -850.0,
    });
    let mut core = BitVolume::new(volume.grid.dims);
    for i in 0..volume.grid.len() {
        let v = volume.grid.voxel(i);
        if off(v.as_dvec3() * H) < -0.6 {
            core.set(v.x, v.y, v.z);
        }
    }
    let (lumen, field) = wall_of(&volume, &core, Tissue::Airway);
    let mesh = extract(&lumen, &FieldCrossing { lumen: &lumen, field: &field });
    let evidence = vertex_evidence(&lumen, &field, &mesh);
    let share_of_limit = |is_in: &dyn Fn(DVec3) -> bool| {
        let at = mesh.positions.iter().zip(&evidence);
        let all: Vec<bool> =
            at.filter(|(p, _)| is_in(p.as_dvec3())).map(|(_, e)| *e == Evidence::Limit).collect();
        assert!(all.len() > 60, "{} vertices", all.len());
        all.iter().filter(|l| **l).count() as f64 / all.len() as f64
    };
    let deep = share_of_limit(&|p| p.x > 13.1 + 1.8 && (8.0..13.0).contains(&p.z));
    let elsewhere = share_of_limit(&|p| (17.4..19.4).contains(&p.z));
    assert!(deep > 0.8 && elsewhere < 0.02, "{deep} in the hole, {elsewhere} elsewhere");
}

#[test]
fn walls_of_bronchi_lie_where_tissue_begins() {
    for (radius, noise, most_mean, most_rms) in [
        (1.5, 0.0, 0.08, 0.09),
        (2.5, 0.0, 0.04, 0.05),
        (5.0, 0.0, 0.02, 0.04),
        (2.5, 20.0, 0.05, 0.06),
    ] {
        let (volume, core) = bronchus(radius, noise);
        let (lumen, field) = wall_of(&volume, &core, Tissue::Airway);
        let (mean, rms) = error(&lumen, &field, tube(radius));
        assert!(mean.abs() < most_mean && rms < most_rms, "r {radius}, {noise} HU: {mean} {rms}");
        // The core's own threshold is most of a millimetre too narrow.
        let volume_of = |mask: &BitVolume| mask.count() as f64;
        assert!(volume_of(&core) < 0.8 * lumen.inside_voxels() as f64);
    }
}

#[test]
fn wall_field_is_the_same_bytes_at_any_number_of_threads() {
    let (volume, core) = bronchus(2.5, 30.0);
    let made: Vec<(Vec<u64>, Vec<u32>)> = [1, 2, 3, 8]
        .map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let (lumen, field) = pool.install(|| wall_of(&volume, &core, Tissue::Airway));
            (lumen.inside, field.offset_mm.iter().map(|o| o.to_bits()).collect())
        })
        .to_vec();
    assert!(made.windows(2).all(|w| w[0] == w[1]));
}

/// A box of gas in tissue, 20 mm wide, with what `extra` puts into it.
fn gas_box(extra: impl Fn(DVec3) -> Option<f64> + Sync) -> (Volume, BitVolume) {
    let volume = scan([48, 48, 40], 20.0, |p| {
        let off = (p - DVec3::new(16.8, 16.8, 14.0)).abs() - 10.0;
        if off.max_element() > 0.0 { 40.0 } else { extra(p).unwrap_or(-1000.0) }
    });
    let core = core(&volume, -800.0, UVec3::new(16, 24, 20));
    (volume, core)
}

#[test]
fn a_fold_one_voxel_thick_is_whole_and_a_faint_streak_is_not_drawn() {
    // A tilted fold that reaches half way across.
    let across = DVec3::new(1.0, 0.3, 0.2).normalize();
    let fold = |p: DVec3| {
        let d = (p - DVec3::new(18.0, 16.8, 14.0)).dot(across);
        (d.abs() < 0.35 && p.y < 17.0).then_some(40.0)
    };
    let (volume, core) = gas_box(fold);
    let (lumen, _) = wall_of(&volume, &core, Tissue::Colon);
    let (mut crossed, mut open) = (0, 0);
    for z in 10..30 {
        for y in 13..21 {
            // Along x through the fold: is there a voxel of wall?
            let wall = (19..34).any(|x| !lumen.holds(lumen.own_voxel(IVec3::new(x, y, z))));
            crossed += 1;
            open += u32::from(!wall);
        }
    }
    assert_eq!(open, 0, "{open} of {crossed} lines pass the fold");
    let streak = |p: DVec3| ((p.x - 17.0).abs() < 0.7 && p.y < 17.0).then_some(-900.0);
    let (volume, core) = gas_box(streak);
    let (lumen, _) = wall_of(&volume, &core, Tissue::Colon);
    let inside = |x: i32| {
        (12..30).all(|z| (13..30).all(|y| lumen.holds(lumen.own_voxel(IVec3::new(x, y, z)))))
    };
    assert!((16..32).all(inside), "the streak is wall");
}

#[test]
fn tagged_fluid_has_no_tunnels_at_its_level_or_in_its_noise() {
    let off = |p: DVec3| DVec3::new(p.x - 16.8, p.y - 16.8, 0.0).length() - 12.0;
    let volume = scan([48, 48, 40], 50.0, |p| match off(p) {
        d if d > 0.0 => 40.0,
        _ if p.y > 18.0 => 700.0,
        _ => -1000.0,
    });
    let grid = volume.grid;
    let core = core(&volume, -800.0, UVec3::new(24, 18, 20));
    let [mut mask, mut fluid] = [0, 1].map(|_| BitVolume::new(grid.dims));
    for v in (0..grid.len()).map(|i| grid.voxel(i)) {
        let value = volume.real(grid.index(v));
        if off(v.as_dvec3() * H) < 0.0 {
            mask.set(v.x, v.y, v.z);
            if value > 370.0 {
                fluid.set(v.x, v.y, v.z);
            }
        }
    }
    let made = CleansedFluid::new(&volume, &core, &mask, &fluid, IVec3::Y).expect("contrast");
    let (lumen, field) = wall_of_input(WallInput::cleansed(&made));
    let mesh = extract(&lumen, &FieldCrossing { lumen: &lumen, field: &field });
    let (adjacency, watertight) = Adjacency::of(&mesh);
    let topology = adjacency.topology(&mesh, watertight);
    assert_eq!((topology.components, topology.tunnels()), (1, 0));
    let (mean, rms) = error(&lumen, &field, off);
    assert!(mean.abs() < 0.08 && rms < 0.15, "{mean} {rms}");
}

#[test]
fn small_bridges_through_a_sheet_are_cut_and_wide_ones_stay() {
    // Two rooms that meet at one end; the sheet between them has a hole.
    let opened = |hole: i32, in_zone: bool| {
        let dims = UVec3::new(24, 24, 40);
        let (mut mask, mut zone) = (BitVolume::new(dims), BitVolume::new(dims));
        for v in (0..24 * 24 * 40).map(|i| UVec3::new(i % 24, i / 24 % 24, i / 576)) {
            let p = v.as_ivec3();
            let is_room = p.cmpge(IVec3::splat(2)).all() && p.cmplt(IVec3::new(22, 22, 38)).all();
            let is_hole = (10..10 + hole).contains(&p.y) && (10..10 + hole).contains(&p.z);
            if is_room && (p.x != 12 || p.z > 30 || is_hole) {
                mask.set(v.x, v.y, v.z);
            }
            if in_zone && p.z < 30 {
                zone.set(v.x, v.y, v.z);
            }
        }
        let bricks = crate::lumen::surrounding_bricks(&mask, 1.0);
        let before = mask.count();
        let is_sheet = |e: usize| (bricks.voxel(e).x == 12).into();
        bridges::cut_bridges(&mut mask, &zone, &bricks, is_sheet, 12);
        before - mask.count()
    };
    assert_eq!(opened(1, true), 1);
    assert_eq!(opened(3, true), 9);
    assert_eq!((opened(5, true), opened(3, false)), (0, 0));
}

#[test]
fn two_bronchi_that_touch_have_a_wall_between_them() {
    // A fork along z whose branches lie side by side, with a hole in the wall between them.
    let off = |p: DVec3| {
        let tube = |x: f64| (p.x - x).hypot(p.y - 14.0) - 3.0;
        let trunk = (p.x - 14.0).hypot(p.y - 14.0) - 7.0;
        let hole = (p - DVec3::new(14.0, 14.0, 16.0)).length() - 1.4;
        tube(10.5).min(tube(17.5)).min(if p.z < 6.0 { trunk } else { hole })
    };
    let volume = scan([40, 40, 40], 20.0, |p| match off(p) {
        d if d < 0.0 => -950.0,
        d if d < 1.2 => 40.0,
        _ => -850.0,
    });
    let core = core(&volume, -890.0, UVec3::new(15, 20, 20));
    let tunnels = |tissue: Tissue| {
        let (lumen, field) = wall_of(&volume, &core, tissue);
        let mesh = extract(&lumen, &FieldCrossing { lumen: &lumen, field: &field });
        let (adjacency, watertight) = Adjacency::of(&mesh);
        let topology = adjacency.topology(&mesh, watertight);
        assert_eq!((topology.components, watertight), (1, true));
        topology.tunnels()
    };
    assert_eq!((tunnels(Tissue::Unknown), tunnels(Tissue::Airway)), (1, 0));
}

#[test]
fn the_wall_of_a_bulge_of_thick_tissue_does_not_lie_too_far_in() {
    // A tilted post, lower on both sides as a sheet is.
    let along = DVec3::new(0.2, -0.1, 1.0).normalize();
    let foot = DVec3::new(16.8, 16.8, 14.0);
    let off = |p: DVec3| (p - foot).reject_from_normalized(along).length() - 3.0;
    let (volume, core) = gas_box(|p| (off(p) < 0.0).then_some(40.0));
    let (lumen, field) = wall_of(&volume, &core, Tissue::Airway);
    let mesh = extract(&lumen, &FieldCrossing { lumen: &lumen, field: &field });
    let of_post = |p: &DVec3| off(*p) < 3.0 && (p.z - foot.z).abs() < 7.0;
    let places = mesh.positions.iter().map(|p| p.as_dvec3()).filter(of_post);
    let far: Vec<f64> = places.map(off).collect();
    let most = far.iter().fold(0.0, |most: f64, d| most.max(d.abs()));
    assert!(far.len() > 300 && most < 0.25, "{most} mm of {}", far.len());
}

#[test]
fn polyps_keep_their_volume_and_specks_of_noise_vanish() {
    let centre = DVec3::new(16.8, 6.8, 14.0);
    let radius = 1.5 * H + 0.6;
    let polyp = |p: DVec3| {
        let speck = (p - DVec3::new(16.8, 17.5, 14.0)).abs().max_element() < 0.36;
        (p.distance(centre) < radius || speck).then_some(if speck { -700.0 } else { 40.0 })
    };
    let (volume, core) = gas_box(polyp);
    let (lumen, field) = wall_of(&volume, &core, Tissue::Colon);
    assert!(lumen.holds(lumen.own_voxel(IVec3::new(24, 25, 20))), "the speck is wall");
    // Height of the polyp above the wall of the box at y = 6.8 mm.
    let mesh = extract(&lumen, &FieldCrossing { lumen: &lumen, field: &field });
    let near = |p: &&glam::Vec3| {
        let q = p.as_dvec3() - centre;
        q.x.abs() < 0.5 && q.z.abs() < 0.5 && q.y > -1.0 && q.y < 4.0
    };
    let top = mesh.positions.iter().filter(near).map(|p| f64::from(p.y) - 6.8).fold(0.0, f64::max);
    assert!((0.75 * radius..1.25 * radius).contains(&top), "{top} of {radius} mm");
}

#[test]
fn a_bright_vessel_and_its_negative_have_the_same_wall() {
    let off = tube(3.0);
    let vessel = |sign: f64| {
        let volume =
            scan([44, 42, 30], 0.0, move |p| sign * if off(p) < 0.0 { 400.0 } else { 50.0 });
        let (lo, hi) = if sign > 0.0 { (300.0, 900.0) } else { (-900.0, -300.0) };
        let range = crate::lumen::IntensitySelection::Range { lo, hi };
        let core = crate::lumen::grow(&volume, &range, UVec3::new(21, 20, 15)).unwrap();
        wall_of(&volume, &core, Tissue::Vessel)
    };
    let ((bright, field), (dark, negative)) = (vessel(1.0), vessel(-1.0));
    assert_eq!(bright.inside, dark.inside);
    assert_eq!(field.offset_mm, negative.offset_mm);
    let (mean, rms) = error(&bright, &field, off);
    assert!(mean.abs() < 0.05 && rms < 0.06, "{mean} {rms}");
}

#[test]
fn a_core_without_contrast_is_refused() {
    let volume = scan([12, 12, 12], 0.0, |_| 7.0);
    let mut core = BitVolume::new(volume.grid.dims);
    core.set(6, 6, 6);
    let refused = WallInput::new((&volume).into(), &core, Tissue::Vessel).err();
    assert_eq!(refused, Some(WallError::NoContrast));
}
