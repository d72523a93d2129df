//! A colon in a body on a table, in air.

use glam::{DMat3, DVec3, UVec3};

use super::*;
use crate::volume::phantom::{Kind, Phantom};

const AIR: i16 = -1000;
const TISSUE: i16 = 40;
/// Padding value that scanners write outside the field of view.
const PADDING: i16 = -3024;

/// Scene of tissue and air around a colon; points are in mm from the middle of the colon.
struct Scene {
    colon: Phantom,
    has_colon: bool,
    /// Semi-axes of the body, an elliptic cylinder from feet to head.
    body_mm: [f64; 2],
    has_table: bool,
    /// Radius of the measured region, mm.
    field_of_view_mm: f64,
}

impl Scene {
    fn new() -> Self {
        let colon = Phantom::new(Kind::Colon, 64, [1.0; 3]).unwrap();
        let far = f64::INFINITY;
        let body_mm = [42.0, 36.0];
        Self { colon, has_colon: true, body_mm, has_table: true, field_of_view_mm: far }
    }

    fn filled_body(self) -> Self {
        Self { body_mm: [f64::INFINITY; 2], has_table: false, ..self }
    }

    fn holds(&self, p: DVec3) -> bool {
        self.has_colon && self.colon.field(p + DVec3::splat(31.5)) < 0.0
    }

    fn value(&self, p: DVec3) -> i16 {
        let in_body = (p.x / self.body_mm[0]).powi(2) + (p.y / self.body_mm[1]).powi(2) < 1.0;
        let in_plate = self.has_table && (37.0..39.0).contains(&p.y);
        if p.truncate().length() > self.field_of_view_mm {
            PADDING
        } else if self.holds(p) {
            -950
        } else if in_body || in_plate {
            TISSUE
        } else {
            AIR
        }
    }

    /// Samples the scene on a grid centred at `middle`.
    fn volume(&self, dims: [u64; 3], spacing_mm: DVec3, direction: DMat3, middle: DVec3) -> Volume {
        let half =
            direction * (0.5 * (UVec3::from(dims.map(|d| d as u32 - 1))).as_dvec3() * spacing_mm);
        let grid = Grid::new(dims, spacing_mm, middle - half, direction).unwrap();
        let at = grid.world_from_voxel();
        let value = |i| self.value(at.transform_point3(grid.voxel(i).as_dvec3()));
        Volume::new(grid, Samples::from((0..grid.len()).map(value).collect::<Vec<i16>>()))
    }

    fn axial(&self) -> Volume {
        self.volume([96, 96, 64], DVec3::ONE, DMat3::IDENTITY, DVec3::ZERO)
    }
}

fn take(volume: &Volume, lo: f64) -> Result<(Lumen, SegmentationStats), LumenError> {
    SegmentationOptions::new(IntensitySelection::Range { lo, hi: -500.0 }).apply(volume)
}

/// Takes the largest component that is not outside, and wants it to be the whole colon.
fn assert_colon(scene: &Scene, volume: &Volume, lo: f64) -> SegmentationStats {
    let (lumen, found) = take(volume, lo).unwrap();
    let at = volume.grid.world_from_voxel();
    let colon = |v: UVec3| scene.holds(at.transform_point3(v.as_dvec3()));
    let all = (0..volume.grid.len()).filter(|&i| colon(volume.grid.voxel(i))).count();
    let taken = |e: usize| colon(lumen.volume_voxel(lumen.bricks.voxel(e)).as_uvec3());
    assert!(lumen.elements(&lumen.inside).all(taken), "{found:?}");
    assert_eq!(found.taken.map(|c| c.voxels), Some(lumen.inside_voxels()));
    assert_eq!(lumen.inside_voxels() as usize, all);
    found
}

#[test]
fn the_air_around_a_patient_on_a_table_is_left_out_and_named() {
    let scene = Scene::new();
    let volume = scene.axial();
    let found = assert_colon(&scene, &volume, f64::NEG_INFINITY);
    // Above the table and below it; the first is far larger than the colon.
    assert_eq!(found.outside.len(), 2, "{found:?}");
    assert!(found.outside[0].voxels > 3 * found.taken.unwrap().voxels, "{found:?}");
    assert!(found.others.is_empty() && found.other_voxels == 0);
    assert_eq!(found.outside[0].first, UVec3::ZERO);
}

#[test]
fn air_is_known_on_sagittal_coronal_and_oblique_grids() {
    let scene = Scene::new();
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let turn = DMat3::from_euler(glam::EulerRot::XYZ, 0.2, -0.15, 0.5);
    for (direction, dims) in [
        (DMat3::from_cols(x, -z, y), [96, 64, 96]),
        (DMat3::from_cols(z, y, x), [64, 96, 96]),
        (turn, [96, 96, 64]),
        (turn * DMat3::from_cols(-x, z, -y), [96, 64, 96]),
    ] {
        let volume = scene.volume(dims, DVec3::ONE, direction, DVec3::ZERO);
        let (lumen, found) = take(&volume, f64::NEG_INFINITY).unwrap();
        let at = volume.grid.world_from_voxel();
        let first = at.transform_point3(found.taken.unwrap().first.as_dvec3());
        assert!(scene.holds(first) && lumen.inside_voxels() > 6_000, "{direction} {found:?}");
        assert!(found.outside[0].voxels > lumen.inside_voxels(), "{direction} {found:?}");
    }
}

#[test]
fn a_colon_that_a_side_face_cuts_stays() {
    // The face at the patient's left runs along the middle of the descending colon.
    let scene = Scene::new().filled_body();
    let cut = |scene: &Scene| {
        let grid = [54, 96, 64];
        scene.volume(grid, DVec3::ONE, DMat3::IDENTITY, DVec3::new(-5.0, 0.0, 0.0))
    };
    let volume = cut(&scene);
    let found = assert_largest_of_all(&volume);
    assert!(found.outside.is_empty(), "{found:?}");
    // The same in a body that leaves air before and behind it.
    let scene = Scene { body_mm: [200.0, 36.0], ..Scene::new() };
    let in_air = cut(&scene);
    let (lumen, in_air_found) = take(&in_air, f64::NEG_INFINITY).unwrap();
    assert_eq!(in_air_found.taken.unwrap().voxels, found.taken.unwrap().voxels);
    assert_eq!(in_air_found.outside.len(), 3, "{in_air_found:?}");
    assert!(lumen.touches_edge);
}

/// Asserts that the lumen is the largest component, whichever faces of the volume it touches.
fn assert_largest_of_all(volume: &Volume) -> SegmentationStats {
    let (lumen, found) = take(volume, f64::NEG_INFINITY).unwrap();
    let low: Vec<u8> = (0..volume.grid.len()).map(|i| u8::from(volume.real(i) < -500.0)).collect();
    let labels = Volume::new(volume.grid, Samples::from(low));
    let (largest, _) =
        SegmentationOptions::new(IntensitySelection::Labels(vec![])).apply(&labels).unwrap();
    assert_eq!(lumen.inside, largest.inside);
    let top = volume.grid.dims.x as i32 - 1;
    let cut = lumen
        .elements(&lumen.inside)
        .filter(|&e| lumen.volume_voxel(lumen.bricks.voxel(e)).x == top)
        .count();
    assert!(cut > 100, "the face cuts {cut} voxels");
    found
}

#[test]
fn without_air_around_the_body_nothing_is_left_out() {
    let scene = Scene::new().filled_body();
    let found = assert_colon(&scene, &scene.axial(), f64::NEG_INFINITY);
    assert!(found.outside.is_empty() && found.others.is_empty(), "{found:?}");
}

#[test]
fn air_inside_a_round_field_of_view_is_left_out_though_its_padding_is_not_in_the_range() {
    let scene = Scene { field_of_view_mm: 47.6, ..Scene::new() };
    let found = assert_colon(&scene, &scene.axial(), -1024.0);
    assert!(found.outside[0].voxels > found.taken.unwrap().voxels, "{found:?}");
}

#[test]
fn where_only_outside_air_is_left_the_error_says_how_much_and_what_helps() {
    let scene = Scene { has_colon: false, ..Scene::new() };
    let volume = scene.axial();
    let error = take(&volume, f64::NEG_INFINITY).unwrap_err();
    let LumenError::OnlyOutside { ml, .. } = error else { panic!("{error}") };
    let air = (0..volume.grid.len()).filter(|&i| volume.real(i) < -500.0).count();
    assert!((ml - air as f64 / 1000.0).abs() < 1e-9, "{ml}");
    let text = error.to_string();
    assert!(text.contains("threshold :-500") && text.contains("seed"), "{text}");
    assert!(!text.contains("--"), "a library names no flags: {text}");
    // With every component asked for, air is still no lumen.
    let window = IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: -500.0 };
    let all = SegmentationOptions { all_components: true, ..SegmentationOptions::new(window) };
    assert_eq!(all.apply(&volume).unwrap_err(), error);
}

#[test]
fn labels_and_bright_lumens_are_never_outside_air() {
    let scene = Scene { has_colon: false, ..Scene::new() };
    let volume = scene.axial();
    let air = (0..volume.grid.len()).map(|i| u8::from(volume.real(i) < -500.0));
    let labels = Volume::new(volume.grid, Samples::from(air.collect::<Vec<u8>>()));
    let (_, found) =
        SegmentationOptions::new(IntensitySelection::Labels(vec![])).apply(&labels).unwrap();
    assert!(found.outside.is_empty() && found.taken.unwrap().first == UVec3::ZERO);
    let bright = IntensitySelection::Range { lo: 0.0, hi: f64::INFINITY };
    let (_, found) = SegmentationOptions::new(bright).apply(&volume).unwrap();
    assert!(found.outside.is_empty(), "{found:?}");
}
