//! Radius of straight tubes, and of a vessel that VMTK has measured.

use common::volumes::shared_file;
use glam::{DVec3, UVec3};
use intima::formats::{ReadOptions, read_volume};
use intima::lumen::IntensitySelection;
use intima::session::{Session, Settings, Source, VolumeSource};
use intima::volume::{Grid, Volume};

/// Radii of the path through a label map, less a fifth of it at either end.
fn radii(volume: Volume) -> Vec<f64> {
    let mut settings = Settings::default();
    settings.lumen.select = Some(IntensitySelection::Labels(Vec::new()));
    let source = Source::Image(VolumeSource::Memory(std::sync::Arc::new(volume)));
    let session = Session::new(source, settings).unwrap();
    let line = session.centerline().unwrap();
    let points = &line.line.branches[0].points;
    let fifth = points.len() / 5;
    points[fifth..points.len() - fifth].iter().map(|p| p.radius_mm).collect()
}

/// Says bias and rms of radii; whether they are within the limits.
fn is_true(what: &str, radii: &[f64], truth: f64) -> bool {
    let mean =
        |of: &dyn Fn(f64) -> f64| radii.iter().map(|r| of(*r)).sum::<f64>() / radii.len() as f64;
    let (bias, rms) = (mean(&|r| r - truth), mean(&|r| (r - truth).powi(2)).sqrt());
    println!("{what}: radius {truth:.3} mm, bias {bias:+.3}, rms {rms:.3}");
    bias.abs() <= 0.05 && rms <= 0.08
}

/// Voxels whose centres lie in a slanted tube; the radius of the disc that they fill.
fn tube(radius: f64, spacing: [f64; 3]) -> (Volume, f64) {
    let h = DVec3::from(spacing);
    let side = 2.0 * radius + 40.0;
    let size = DVec3::new(side, side, 70.0);
    let dims = (size / h).ceil().as_uvec3();
    let grid = Grid::axis_aligned(dims.to_array(), spacing);
    let along = DVec3::new(0.31, 0.17, 1.0).normalize();
    let middle = 0.5 * size + DVec3::new(0.21, -0.13, 0.0);
    let is_inside = |v: UVec3| {
        let p = v.as_dvec3() * h - middle;
        let t = p.dot(along);
        t.abs() < 30.0 && (p - along * t).length() < radius
    };
    let labels: Vec<u8> = (0..grid.len()).map(|i| u8::from(is_inside(grid.voxel(i)))).collect();
    let count = labels.iter().map(|l| u64::from(*l)).sum::<u64>() as f64;
    let truth = (count * grid.voxel_mm3() / 60.0 / std::f64::consts::PI).sqrt();
    (Volume::new(grid, labels.into()), truth)
}

#[test]
fn radii_of_tubes_are_those_of_their_walls() {
    let mut all = true;
    for spacing in [[1.0; 3], [0.7, 0.7, 1.25], [0.6; 3]] {
        for radius in [1.3, 1.9, 3.0, 5.0, 8.0] {
            let (volume, truth) = tube(radius, spacing);
            // Triangles are chords of a round wall: below two voxels from wall to middle they lie a
            // twentieth of the radius inside, and a tube of 1.3 voxels pinches.
            let is_resolved = radius >= 2.0 * spacing.iter().product::<f64>().cbrt();
            all &= is_true(&format!("{spacing:?}"), &radii(volume), truth) || !is_resolved;
        }
    }
    assert!(all);
}

#[test]
fn radii_of_the_shared_tubes_are_those_of_their_walls() {
    for (name, truth) in
        [("radius_tube_r3_1x1mm.nrrd", 2.97), ("radius_tube_r5_0.7x1.25mm.nrrd", 4.98)]
    {
        let Some(path) = shared_file(&format!("faults/{name}")) else { return };
        let volume = read_volume(&path, &ReadOptions::default()).unwrap();
        assert!(is_true(name, &radii(volume), truth), "{name}");
    }
}
