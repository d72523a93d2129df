//! Largest diameters of lesions of known size on the wall of a tube.

use std::sync::Arc;

use common::volumes::noise;
use glam::DVec3;
use intima::flight::LesionDiameter;
use intima::lumen::IntensitySelection;
use intima::session::{Session, Settings, Source, VolumeSource};
use intima::volume::{Grid, Volume};

const SPACING: f64 = 0.7;
/// Radius of the tube and half of its length, mm.
const TUBE: f64 = 16.0;
const HALF: f64 = 24.0;
/// Lowest place of the wall half way along, about which lesions stand.
const FLOOR: DVec3 = DVec3::new(0.0, -TUBE, 0.0);

/// Signed distance of a form, mm; negative inside.
type Form = fn(DVec3) -> f64;

/// A half ball on the wall.
fn sessile<const RADIUS: u32>(p: DVec3) -> f64 {
    p.distance(FLOOR) - f64::from(RADIUS)
}

/// Twice as long, along the tube and aslant, as it is wide.
fn long(p: DVec3) -> f64 {
    let along = DVec3::new(0.5, 0.0, 0.866);
    let end = 3.0 * along;
    let t = ((p - FLOOR + end).dot(along) / 6.0).clamp(0.0, 1.0);
    (p - FLOOR).distance(-end + 2.0 * t * end) - 3.0
}

/// A head of 8 mm on a stalk.
fn with_a_stalk(p: DVec3) -> f64 {
    let head = FLOOR + DVec3::Y * 8.0;
    let stalk = (p - FLOOR - DVec3::Y * (p.y - FLOOR.y).clamp(0.0, 8.0)).length() - 1.6;
    stalk.min(p.distance(head) - 4.0)
}

/// A ring about the lumen.
fn fold(p: DVec3) -> f64 {
    let inwards = TUBE - p.truncate().length();
    DVec3::new((inwards - 5.0).max(0.0), p.z, 0.0).length() - 1.8
}

fn nothing(_: DVec3) -> f64 {
    f64::INFINITY
}

/// The wall of a gas-filled tube with a form on it, as a CT shows it: blurred by 0.6 mm, with noise
/// of 20 HU.
fn session(form: Form) -> Session {
    let reach = DVec3::new(TUBE + 4.0, TUBE + 4.0, HALF + 4.0);
    let dims = (2.0 * reach / SPACING).ceil().as_uvec3();
    let grid = Grid { origin_mm: -reach, ..Grid::axis_aligned(dims.to_array(), [SPACING; 3]) };
    let value = |i: usize| {
        let v = grid.voxel(i);
        let p = grid.world_from_voxel().transform_point3(v.as_dvec3());
        let tube = (p.truncate().length() - TUBE).max(p.z.abs() - HALF);
        let lumen = tube.max(-form(p));
        // The normal distribution's integral, by a logistic curve of the same slope.
        let gas = 1.0 / (1.0 + (lumen / 0.6 * 1.6).exp());
        (40.0 - 990.0 * gas + 20.0 * noise(v, 5)).round() as i16
    };
    let values: Vec<i16> = (0..grid.len()).map(value).collect();
    let mut settings = Settings::default();
    settings.lumen.select = Some(IntensitySelection::Range { lo: -2000.0, hi: -450.0 });
    let volume = Arc::new(Volume::new(grid, values.into()));
    Session::new(Source::Image(VolumeSource::Memory(volume)), settings).unwrap()
}

/// Diameters as found from some places of the form, as far from each other as a pointer may be.
fn found(form: Form, places: &[DVec3]) -> Vec<Option<LesionDiameter>> {
    let session = session(form);
    let (wall, tree) = (session.wall().unwrap(), session.triangle_tree().unwrap());
    let of = |place: &DVec3| LesionDiameter::find(&wall.mesh, &tree, *place, SPACING);
    places.iter().map(of).collect()
}

/// The top of a form of this height, which is round to this radius, and places beside it.
fn about_the_top(height: f64, radius: f64) -> [DVec3; 3] {
    let top = FLOOR + DVec3::Y * height;
    let beside = |by: DVec3| top + by * (0.45 * radius) - DVec3::Y * (0.11 * radius);
    [top, beside(DVec3::X), beside(DVec3::new(-0.6, 0.0, 0.8))]
}

#[track_caller]
fn assert_sizes(what: &str, form: Form, [height, radius]: [f64; 2], truth: f64) {
    for diameter in found(form, &about_the_top(height, radius)) {
        let diameter = diameter.unwrap_or_else(|| panic!("{what}: no edge was found"));
        let length = diameter.length_mm();
        println!("{what}: {length:.2} of {truth} mm, {:.2} bounded", diameter.bounded);
        assert!((length - truth).abs() <= SPACING, "{what}: {length} of {truth} mm");
    }
}

#[test]
fn half_balls_on_the_wall_are_measured_to_a_voxel() {
    assert_sizes("6 mm", sessile::<3>, [3.0; 2], 6.0);
    assert_sizes("8 mm", sessile::<4>, [4.0; 2], 8.0);
    assert_sizes("10 mm", sessile::<5>, [5.0; 2], 10.0);
}

#[test]
fn a_long_lesion_is_measured_along_and_a_head_without_its_stalk() {
    assert_sizes("12 by 6 mm", long, [3.0; 2], 12.0);
    assert_sizes("head of 8 mm", with_a_stalk, [12.0, 4.0], 8.0);
    let along = found(long, &about_the_top(3.0, 3.0))[0].unwrap();
    let direction = (along.ends_mm[1] - along.ends_mm[0]).normalize();
    assert!(direction.dot(DVec3::new(0.5, 0.0, 0.866)).abs() > 0.97, "{direction}");
}

#[test]
fn a_flat_wall_and_a_fold_have_no_diameter() {
    assert_eq!(found(nothing, &[FLOOR, FLOOR + DVec3::Z * 6.0]), [None, None]);
    assert_eq!(found(fold, &[FLOOR + DVec3::Y * 6.8]), [None]);
}
