//! Distances, opacity and rays against slow and simple ways.

use glam::{DVec3, IVec3, UVec3, Vec3};

use super::tissue::unpacked;
use super::*;
use crate::geometry::{Mesh, TriangleBvh};
use crate::lumen::{BitVolume, GreyValues, Lumen};
use crate::surface::{Midpoint, extract};
use crate::volume::{Grid, Samples, Volume};

/// A volume whose lumen holds some voxels, with the wall half way between voxels.
struct WalledVolume {
    lumen: Lumen,
    mesh: Mesh,
    volume: Volume,
}

impl WalledVolume {
    fn new(
        dims: [u32; 3],
        spacing_mm: [f64; 3],
        is_inside: impl Fn(DVec3) -> bool,
        value: impl Fn(DVec3) -> f32,
    ) -> Self {
        let grid = Grid::axis_aligned(dims, spacing_mm);
        let mut mask = BitVolume::new(grid.dims);
        let at = |v: UVec3| grid.world_from_voxel().transform_point3(v.as_dvec3());
        let voxels: Vec<UVec3> = (0..grid.len()).map(|i| grid.voxel(i)).collect();
        voxels.iter().filter(|v| is_inside(at(**v))).for_each(|v| mask.set(v.x, v.y, v.z));
        let values: Vec<f32> = voxels.iter().map(|v| value(at(*v))).collect();
        let lumen = Lumen::new(grid, &mask);
        let mesh = extract(&lumen, &Midpoint);
        Self { lumen, mesh, volume: Volume::new(grid, Samples::from(values)) }
    }

    fn tissue(&self, band_mm: f64) -> TissueField {
        let bricks = TissueBricks::new(&self.lumen, band_mm).unwrap();
        let tree = TriangleBvh::new(&self.mesh);
        TissueField::new(&self.lumen, bricks, GreyValues::Whole(&self.volume), &tree)
    }

    /// Word of a voxel of the lumen's grid.
    fn word(tissue: &TissueField, v: IVec3) -> Option<(f32, f32)> {
        let slot = tissue.bricks.slot(v >> 3i32)?;
        let l = (v & 7).as_usizevec3();
        let at = slot * TILE_SIDE.pow(3) + l.x + TILE_SIDE * (l.y + TILE_SIDE * l.z);
        Some(unpacked(tissue.words[at]))
    }
}

fn slab(z: f64) -> bool {
    z < 12.0
}

#[test]
fn distances_are_those_of_a_search_through_all_triangles_and_voxels() {
    let spacing = [0.7, 0.9, 1.4];
    let middle = DVec3::new(14.0, 14.0, 14.0);
    let inside = |p: DVec3| p.distance(middle) < 7.0 || (p.x - 14.0).abs() < 1.0 && p.y > 14.0;
    let scene = WalledVolume::new([40, 34, 22], spacing, inside, |p| p.x as f32);
    let tissue = scene.tissue(6.0);
    let tree = TriangleBvh::new(&scene.mesh);
    let world = scene.lumen.grid.world_from_voxel();
    let (mut near, mut far, mut counted) = (0f64, 0f64, 0);
    for place in tissue.bricks.places() {
        for i in 0..512 {
            let v = 8 * *place + IVec3::new(i & 7, i >> 3 & 7, i >> 6);
            let p = world.transform_point3(v.as_dvec3());
            let true_mm = tree.distance(p, 1e9);
            if true_mm > 6.0 {
                continue;
            }
            let (_, got) = WalledVolume::word(&tissue, v).unwrap();
            assert_eq!(got < 0.0, scene.lumen.holds(v), "{v}");
            let off = (f64::from(got.abs()) - true_mm).abs();
            let is_near = true_mm < if got < 0.0 { 0.9 } else { 2.0 };
            let most = if is_near { &mut near } else { &mut far };
            *most = most.max(off);
            counted += 1;
        }
    }
    assert!(counted > 10_000, "{counted}");
    assert!(near < 1.0 / 1024.0, "near the wall: {near} mm");
    assert!(far < 0.75, "up to half a voxel's diagonal off beyond: {far} mm");
}

#[test]
fn every_cell_within_the_band_has_its_values() {
    let value = |p: DVec3| (3.0 * p.x - 5.0 * p.y + 7.0 * p.z) as f32;
    let scene =
        WalledVolume::new([30, 30, 30], [1.0; 3], |p| p.distance(DVec3::splat(14.0)) < 6.0, value);
    let tissue = scene.tissue(4.0);
    let table = OpacityTable::new(Opacity::Colon, 1.0);
    let band = Band { skin_vox: 0.0, depth_mm: 4.0 };
    let mut seed = 3u32;
    for _ in 0..500 {
        let mut next = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            seed as f32 / u32::MAX as f32 - 0.5
        };
        let way = Vec3::new(next(), next(), next()).normalize();
        let at = DVec3::splat(14.0) + 7.5 * way.as_dvec3();
        let seen = cast::cast(&tissue, &table, &band, at, way);
        let most = seen.largest.unwrap();
        // The field is linear, so a ray's largest value is at one of its ends.
        let ends = [at, at + 2.6 * way.as_dvec3()].map(&value);
        assert!((most - ends[0].max(ends[1])).abs() < 15.0, "{most}, {ends:?}");
    }
}

#[test]
fn a_steep_and_a_grazing_ray_end_at_the_same_depth() {
    // Behind the wall at z = 12 lies soft tissue 4 mm thick, and bright tissue behind it.
    let value = |p: DVec3| {
        if p.z < 12.0 {
            -1000.0
        } else if p.z < 16.5 {
            40.0
        } else {
            600.0
        }
    };
    let scene = WalledVolume::new([60, 20, 40], [1.0; 3], |p| slab(p.z), value);
    let tissue = scene.tissue(6.0);
    let table = OpacityTable::new(Opacity::Colon, 1.0);
    let seen = |depth_mm, way: Vec3| {
        let band = Band { skin_vox: 1.3, depth_mm };
        cast::cast(&tissue, &table, &band, DVec3::new(20.0, 10.0, 11.5), way.normalize())
    };
    for way in [Vec3::Z, Vec3::new(1.0, 0.0, 1.0), Vec3::new(1.5, 0.0, 1.0)] {
        let [shallow, deep] = [3.5, 6.0].map(|depth| seen(depth, way));
        assert!(shallow.largest.unwrap() < 60.0, "{way}: {shallow:?}");
        assert!(deep.largest.unwrap() > 400.0, "{way}: {deep:?}");
        assert!(deep.normal.dot(Vec3::Z) > 0.999);
    }
}

#[test]
fn a_ray_that_leaves_a_fold_meets_the_next_wall() {
    // A fold 6 mm thick between z = 12 and 18; the next wall is at z = 30.
    let inside = |p: DVec3| p.z < 30.0 && !(12.0..18.0).contains(&p.z);
    let value = |p: DVec3| if inside(p) { -1000.0 } else { 40.0 };
    let scene = WalledVolume::new([24, 24, 44], [1.0; 3], inside, value);
    let tissue = scene.tissue(5.0);
    let table = OpacityTable::new(Opacity::Colon, 1.0);
    let band = Band { skin_vox: 1.3, depth_mm: 5.0 };
    for way in [Vec3::Z, Vec3::new(0.3, 0.2, 1.0)] {
        let way = way.normalize();
        let seen = cast::cast(&tissue, &table, &band, DVec3::new(8.0, 8.0, 11.5), way);
        let (place, normal) = seen.next_wall.unwrap();
        assert!((place.z - 29.5).abs() < 0.1, "{place}");
        assert!(normal.dot(Vec3::Z) > 0.99, "{normal}");
        assert!(seen.through > 0.2 && seen.through < 0.9, "{seen:?}");
    }
}

#[test]
fn an_entry_is_the_light_of_many_thin_pieces() {
    for opacity in [Opacity::Colon, Opacity::Airway, Opacity::Vessel(350.0)] {
        let (coarse, fine) = (OpacityTable::new(opacity, 1.0), OpacityTable::new(opacity, 0.01));
        for front in (-1000..1500).step_by(170) {
            for back in (-1000..1500).step_by(130) {
                let (front, back) = (front as f32, back as f32);
                let (mut through, mut light) = (1.0, [0.0; 3]);
                for i in 0..100 {
                    let value = front + (back - front) * (i as f32 + 0.5) / 100.0;
                    let e = fine.entry(value, value);
                    light = std::array::from_fn(|k| light[k] + through * e[k]);
                    through *= 1.0 - e[3];
                }
                let got = coarse.entry(front, back);
                assert!((got[3] - (1.0 - through)).abs() < 0.02, "{opacity:?} {front} {back}");
                let off = (0..3).map(|k| (got[k] - light[k]).abs()).fold(0.0, f32::max);
                assert!(off < 0.02, "{opacity:?} {front} {back}: {got:?} {light:?}");
            }
        }
    }
}

#[test]
fn too_many_bricks_are_refused_before_memory_is_taken() {
    let scene = WalledVolume::new([520, 520, 24], [1.0; 3], |p| slab(p.z), |_| 0.0);
    let error = TissueBricks::new(&scene.lumen, 25.0).map(|b| b.working_bytes());
    assert!(error.is_ok_and(|bytes| bytes < 200_000_000), "a slab of 520 x 520 voxels fits");
    let big = WalledVolume::new([1024, 1024, 24], [1.0; 3], |p| slab(p.z), |_| 0.0);
    let error = TissueBricks::new(&big.lumen, 25.0).unwrap_err();
    assert!(error.to_string().contains("look less far behind it"), "{error}");
}
