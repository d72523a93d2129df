//! Narrow places of a phantom artery with known losses of diameter.

use common::volumes::noise;
use glam::DVec3;
use intima::lumen::IntensitySelection;
use intima::session::{Session, Settings, Source, VolumeSource};
use intima::volume::{Grid, Volume};

const SPACING: f64 = 0.6;
/// Radius of the bend and length of the artery, mm.
const BEND: f64 = 120.0;
const LENGTH: f64 = 250.0;
/// Arc length of the branch.
const FORK: f64 = 150.0;
/// Place, length and loss of diameter of each narrowing.
const LOSSES: [(f64, f64, f64); 4] =
    [(35.0, 12.0, 0.3), (80.0, 14.0, 0.5), (118.0, 14.0, 0.7), (205.0, 36.0, 0.4)];

fn radius(s: f64) -> f64 {
    // The step is where the branch takes its share.
    let healthy = if s < FORK { 4.8 - 0.003 * s } else { 4.0 - 0.008 * (s - FORK) };
    let loss = LOSSES.iter().map(|(at, length, loss)| {
        let off = (s - at).abs() / (0.5 * length);
        if off < 1.0 { loss * 0.5 * (1.0 + (std::f64::consts::PI * off).cos()) } else { 0.0 }
    });
    healthy * (1.0 - loss.fold(0.0, f64::max))
}

/// Point of the axis, and its direction.
fn axis(s: f64) -> (DVec3, DVec3) {
    let (sin, cos) = ((s - 0.5 * LENGTH) / BEND).sin_cos();
    (DVec3::new(BEND * sin, 0.0, BEND * cos), DVec3::new(cos, 0.0, -sin))
}

/// Signed distance to the wall, about; negative inside.
fn wall(p: DVec3) -> f64 {
    let s = BEND * p.x.atan2(p.z) + 0.5 * LENGTH;
    let on = s.clamp(0.0, LENGTH);
    let trunk = p.distance(axis(on).0) - radius(on);
    let (fork, along) = axis(FORK);
    let way = (along + 1.2 * DVec3::Y).normalize();
    let t = (p - fork).dot(way).clamp(0.0, 40.0);
    trunk.min(p.distance(fork + way * t) - 2.2)
}

/// A scan of the artery: 350 HU in 40, blurred by 0.55 mm, with noise of 20 HU.
fn scan() -> Volume {
    let (low, high) = (DVec3::new(-108.0, -9.0, 50.0), DVec3::new(108.0, 40.0, 128.0));
    let dims = ((high - low) / SPACING).ceil().as_uvec3();
    let grid = Grid { origin_mm: low, ..Grid::axis_aligned(dims.to_array(), [SPACING; 3]) };
    let value = |i: usize| {
        let v = grid.voxel(i);
        let off = wall(grid.world_from_voxel().transform_point3(v.as_dvec3()));
        // The normal distribution's integral, by a logistic curve of the same slope.
        let inside = 1.0 / (1.0 + (1.702 * off / 0.55).exp());
        (40.0 + 310.0 * inside + 20.0 * noise(v, 77)).round() as i16
    };
    Volume::new(grid, (0..grid.len()).map(value).collect::<Vec<i16>>().into())
}

#[test]
fn losses_of_diameter_of_an_artery_are_within_three_points() {
    let mut settings = Settings::default();
    settings.lumen.select = Some(IntensitySelection::Range { lo: 195.0, hi: f64::INFINITY });
    let source = Source::Image(VolumeSource::Memory(std::sync::Arc::new(scan())));
    let session = Session::new(source, settings).unwrap();
    let profile = session.lumen_profile().unwrap();
    println!("{:#?}", profile.narrowest);
    for (at, _, loss) in LOSSES {
        let place = axis(at).0;
        let off = |n: &&intima::flight::NarrowPlace| DVec3::from(n.center_mm).distance(place);
        let near = profile.narrowest.iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
        assert!(off(&near) < 4.0, "{at} mm: nothing is listed near {place}");
        assert!(
            (near.narrowing - loss).abs() < 0.03,
            "{at} mm: {} instead of {loss}",
            near.narrowing
        );
        let area = 1.0 - (1.0 - loss).powi(2);
        assert!((near.narrowing_area - area).abs() < 0.05, "{at} mm: area {}", near.narrowing_area);
    }
    assert_eq!(profile.narrowest.len(), LOSSES.len(), "the branch is no narrowing");
}
