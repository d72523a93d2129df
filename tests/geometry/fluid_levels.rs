//! Levels of fluid in a tube of gas: found where there is one, with its area, and nowhere else.

use std::sync::Arc;

use glam::DVec3;
use intima::lumen::IntensitySelection;
use intima::session::{LumenSettings, Session, Settings, Source, VolumeSource};
use intima::volume::{Grid, Samples, Volume};
use intima::wall::{Evidence, FluidLevel};

const SPACING: f64 = 0.8;
const DIMS: [u32; 3] = [90, 60, 60];
const RADIUS: f64 = 16.0;
/// Axis of a tube along x, mm.
const AXIS: DVec3 = DVec3::new(0.0, 23.6, 23.6);

/// A tube of gas in soft tissue. Below a plane across `up` lies fluid.
///
/// * `level`: height of the plane over the axis, mm; no fluid where `None`.
fn session(up: DVec3, level: Option<f64>, fluid: f64, spacing: [f64; 3]) -> Session {
    let dims: [u32; 3] =
        std::array::from_fn(|k| (f64::from(DIMS[k]) * SPACING / spacing[k]).round() as u32);
    let grid = Grid::axis_aligned(dims, spacing);
    let mut seed = 5u64;
    let mut noise = || {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5) * 70.0
    };
    let value = |p: DVec3| match level {
        _ if DVec3::new(0.0, p.y - AXIS.y, p.z - AXIS.z).length() > RADIUS => 40.0,
        Some(height) if (p - AXIS - DVec3::X * 36.0).dot(up) < height => fluid,
        _ => -1000.0,
    };
    let voxel = |i: usize| {
        let v = grid.voxel(i).as_dvec3();
        let part = |k: usize| (k as f64 - 1.0) / 3.0;
        let points = (0..27).map(|k| v + DVec3::new(part(k % 3), part(k / 3 % 3), part(k / 9)));
        points.map(|p| value(p * DVec3::from(spacing))).sum::<f64>() / 27.0
    };
    let values: Vec<i16> = (0..grid.len()).map(|i| (voxel(i) + noise()) as i16).collect();
    let volume = Arc::new(Volume::new(grid, Samples::from(values)));
    let select = Some(IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: -500.0 });
    let lumen = LumenSettings { select, ..LumenSettings::default() };
    let settings = Settings { lumen, ..Settings::default() };
    Session::new(Source::Image(VolumeSource::Memory(volume)), settings).unwrap()
}

fn levels(session: &Session) -> Vec<FluidLevel> {
    session.wall().unwrap().levels.clone()
}

#[test]
fn a_level_is_found_with_its_area_on_whichever_side_the_patient_lies() {
    let length = f64::from(DIMS[0]) * SPACING;
    for (up, height, fluid) in
        [(DVec3::NEG_Y, -6.0, 40.0), (DVec3::NEG_Y, 4.0, 600.0), (DVec3::Y, -9.0, 15.0)]
    {
        let session = session(up, Some(height), fluid, [SPACING; 3]);
        let found = levels(&session);
        assert_eq!(found.len(), 1, "{up} {height} {fluid}: {found:?}");
        let area = 2.0 * (RADIUS * RADIUS - height * height).sqrt() * length;
        let share = found[0].area_mm2 / area;
        println!("{up} {height}: {share:.3} of the level's area");
        assert!((0.85..1.05).contains(&share), "{up} {height}: {share}");
        let off = (DVec3::from(found[0].place_mm) - AXIS).dot(up) - height;
        assert!(off.abs() < 0.5 * SPACING, "in the plane of the level: {off} mm");
        // It is no mucosa where the wall is coloured by its evidence.
        let evidence = session.evidence().unwrap();
        let marked = evidence.as_ref().as_ref().unwrap();
        let marked = marked.iter().filter(|e| **e == Evidence::FluidLevel).count();
        assert_eq!(marked, found[0].vertices.len());
    }
}

#[test]
fn a_level_between_thick_slices_is_found() {
    let session = session(DVec3::NEG_Y, Some(-5.0), 40.0, [0.8, 0.8, 2.5]);
    assert_eq!(levels(&session).len(), 1);
}

#[test]
fn walls_that_lie_are_no_levels() {
    // The bottom of a tube, a plane that rises by 20 degrees, and one across the body.
    assert_eq!(levels(&session(DVec3::NEG_Y, None, 40.0, [SPACING; 3])), []);
    let tilt = 20f64.to_radians();
    let tilted = DVec3::new(tilt.sin(), -tilt.cos(), 0.0);
    assert_eq!(levels(&session(tilted, Some(-3.0), 40.0, [SPACING; 3])), []);
    let upright = DVec3::new(0.0, 0.0, 1.0);
    assert_eq!(levels(&session(upright, Some(-3.0), 40.0, [SPACING; 3])), []);
}
