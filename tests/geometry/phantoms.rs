//! Facts about the analytic phantoms: what they promise is what their voxels show.

use glam::{DVec3, IVec3};
use intima::volume::phantom::{Kind, Phantom};
use intima::volume::{Grid, Samples, Volume};

const ANISOTROPIC: [f64; 3] = [0.7, 0.7, 2.5];

fn make(kind: Kind, size: u32, spacing: [f64; 3]) -> Phantom {
    Phantom::new(kind, size, spacing).unwrap()
}

fn inside(volume: &Volume) -> &[u8] {
    match &volume.samples {
        Samples::U8(s) => s,
        other => panic!("a mask is u8, not {}", other.sample_type().name()),
    }
}

/// Sizes of the 6-connected components.
fn components(grid: &Grid, mask: &[u8]) -> Vec<usize> {
    let mut seen = vec![false; mask.len()];
    let mut sizes = Vec::new();
    for seed in 0..mask.len() {
        if mask[seed] == 0 || seen[seed] {
            continue;
        }
        seen[seed] = true;
        let (mut todo, mut size) = (vec![seed], 0);
        while let Some(i) = todo.pop() {
            size += 1;
            let v = grid.voxel(i).as_ivec3();
            for e in [IVec3::X, IVec3::Y, IVec3::Z] {
                for n in [v - e, v + e] {
                    if grid.contains(n) {
                        let j = grid.index(n.as_uvec3());
                        if mask[j] == 1 && !std::mem::replace(&mut seen[j], true) {
                            todo.push(j);
                        }
                    }
                }
            }
        }
        sizes.push(size);
    }
    sizes
}

#[test]
fn every_lumen_is_one_piece_clear_of_the_border() {
    for kind in Kind::ALL {
        for (size, spacing) in [(32, [1.0; 3]), (48, ANISOTROPIC), (96, [0.5; 3])] {
            let p = make(kind, size, spacing);
            let volume = p.mask();
            let (grid, mask) = (&volume.grid, inside(&volume));
            assert_eq!(grid.dims.min_element(), size);
            assert_eq!(components(grid, mask).len(), 1, "{} at {size}", kind.name());
            for i in (0..mask.len()).filter(|&i| mask[i] == 1) {
                let v = grid.voxel(i);
                let clear = v.cmpgt(glam::UVec3::ZERO).all() && (v + 1).cmplt(grid.dims).all();
                assert!(clear, "{} at {size} touches the border at {v}", kind.name());
            }
        }
    }
}

#[test]
fn mask_is_the_sign_of_the_field_in_every_voxel() {
    for kind in Kind::ALL {
        let p = make(kind, 40, ANISOTROPIC);
        let volume = p.mask();
        for (i, &m) in inside(&volume).iter().enumerate() {
            let at = volume.grid.voxel(i).as_dvec3() * volume.grid.spacing_mm;
            assert_eq!(m == 1, p.field(at) < 0.0, "{} at {at}", kind.name());
        }
    }
}

#[test]
fn volume_of_the_mask_is_the_analytic_one_within_two_percent() {
    for kind in [Kind::Tube, Kind::Ellipse, Kind::Bend, Kind::Helix, Kind::Torus] {
        for spacing in [[1.0; 3], ANISOTROPIC] {
            let p = make(kind, 96, spacing);
            let count = inside(&p.mask()).iter().filter(|&&m| m == 1).count();
            let ratio = count as f64 * p.grid().voxel_mm3() / p.volume_mm3().unwrap();
            assert!((ratio - 1.0).abs() < 0.02, "{}: {ratio}", kind.name());
        }
    }
}

#[test]
fn an_exact_field_is_as_far_as_a_search_over_the_wall_finds() {
    // From points around the lumen a step along the normal reaches the wall, and no point of a
    // dense sample of the wall is nearer than the field says.
    for kind in Kind::ALL.into_iter().filter(|&k| make(k, 32, [1.0; 3]).is_exact()) {
        let p = make(kind, 64, [1.0; 3]);
        let wall: Vec<DVec3> = (0..60_000)
            .filter_map(|i| {
                let golden = [0.819_172_513, 0.671_043_607, 0.549_700_478];
                let q = DVec3::from(golden.map(|g| (f64::from(i) * g).fract())) * 63.0;
                let f = p.field(q);
                (f.abs() < 12.0).then(|| q + f * p.normal(q))
            })
            .collect();
        assert!(wall.len() > 2000);
        let on_wall = wall.iter().filter(|&&w| p.field(w).abs() < 1e-6).count();
        // A foot is lost only where the point lay on the axis.
        assert!(on_wall + 30 > wall.len(), "{}: {on_wall} of {}", kind.name(), wall.len());
        for (i, &w) in wall.iter().enumerate().step_by(101) {
            let q = w + p.normal(w) * (i as f64 % 7.0 - 3.0);
            let near = wall.iter().map(|v| v.distance(q)).fold(f64::INFINITY, f64::min);
            let f = p.field(q).abs();
            assert!(near > f - 1e-6 && near < f + 1.6, "{}: {near} against {f}", kind.name());
        }
    }
}

#[test]
fn axis_is_inside_and_its_radius_is_the_depth() {
    for kind in Kind::ALL {
        let p = make(kind, 64, [1.0; 3]);
        let truth = p.truth();
        for b in &truth.branches {
            for &[x, y, z, r] in &b.points {
                let f = p.field(DVec3::new(x, y, z));
                assert!(f < 0.0, "{}", kind.name());
                let slack = if kind == Kind::Colon { 0.45 * r } else { 1e-9 };
                assert!((r + f).abs() <= slack, "{}: radius {r}, field {f}", kind.name());
            }
            for w in b.points.windows(2) {
                let step = (0..3).map(|k| (w[0][k] - w[1][k]).powi(2)).sum::<f64>().sqrt();
                assert!(step > 0.05 && step < 0.13, "{}: step {step}", kind.name());
            }
            assert_eq!(b.closed, b.points.first() == b.points.last());
        }
    }
}

#[test]
fn no_organ_touches_itself() {
    for kind in Kind::ALL.into_iter().filter(|&k| k != Kind::Y) {
        let p = make(kind, 65, [1.0; 3]);
        let axis = &p.truth().branches[0];
        let step = 0.125;
        let at = |i: usize| DVec3::from_slice(&axis.points[i][..3]);
        let n = axis.points.len();
        let r = axis.points.iter().map(|q| q[3]).fold(0.0, f64::max);
        for (i, j) in (0..n).step_by(8).flat_map(|i| (0..i).step_by(8).map(move |j| (i, j))) {
            let along =
                if axis.closed { (i - j).min(n - 1 - (i - j)) } else { i - j } as f64 * step;
            let gap = at(i).distance(at(j)) - 2.0 * r;
            assert!(
                along < 4.5 * r || gap > 4.0,
                "{}: {gap} mm at {} {}",
                kind.name(),
                at(i),
                at(j)
            );
        }
    }
}

#[test]
fn the_colons_axis_radius_is_the_largest_empty_ball() {
    let p = make(Kind::Colon, 64, [1.0; 3]);
    for &[x, y, z, r] in p.truth().branches[0].points.iter().step_by(37) {
        let c = DVec3::new(x, y, z);
        let mut touched = false;
        for i in 0..4000 {
            let (t, h) = (2.399_963 * f64::from(i), f64::from(i) / 2000.0 - 0.9998);
            let e = DVec3::new(t.cos(), t.sin(), 0.0) * (1.0 - h * h).sqrt() + DVec3::Z * h;
            assert!(p.field(c + 0.98 * r * e) < 0.0);
            touched |= p.field(c + 1.03 * r * e) > 0.0;
        }
        assert!(touched, "a ball of 1.03 times {r} mm about {c} still is inside");
    }
}

#[test]
fn normals_are_unit_and_point_into_the_lumen() {
    for kind in Kind::ALL {
        let p = make(kind, 64, ANISOTROPIC);
        let extent = (p.grid().dims.as_dvec3() - 1.0) * p.grid().spacing_mm;
        for i in 0..3000 {
            let golden = [0.819_172_513, 0.671_043_607, 0.549_700_478];
            let q = DVec3::from(golden.map(|g| (f64::from(i) * g).fract())) * extent;
            let n = p.normal(q);
            assert!((n.length() - 1.0).abs() < 1e-12);
            if p.field(q).abs() < 4.0 {
                assert!(p.field(q + 1e-3 * n) < p.field(q), "{}", kind.name());
            }
        }
    }
}

#[test]
fn branches_of_the_tree_hang_together_and_ends_are_its_tips() {
    let t = make(Kind::Y, 64, [1.0; 3]).truth();
    assert_eq!((t.branches.len(), t.ends.len()), (7, 4));
    for b in t.branches.iter().filter(|b| b.parent.is_some()) {
        let parent = &t.branches[b.parent.unwrap()];
        assert_eq!(b.points[0], *parent.points.last().unwrap());
    }
    let ring = make(Kind::Torus, 64, [1.0; 3]).truth();
    assert!(ring.branches[0].closed && ring.start.distance(ring.ends[0]) > 30.0);
}

#[test]
fn grey_values_agree_with_the_mask_and_noise_is_gaussian_and_repeatable() {
    for spacing in [[1.0; 3], ANISOTROPIC] {
        let p = make(Kind::Colon, 48, spacing);
        let mask = p.mask();
        let clean = p.grey(None, 0);
        let Samples::I16(hu) = &clean.samples else { panic!("a CT is i16") };
        for (&m, &v) in inside(&mask).iter().zip(hu.iter()) {
            assert!(
                if m == 1 { v <= -455 } else { v >= -455 },
                "the middle of the ramp is the wall"
            );
        }
        assert_eq!(clean.range(), Some((-950.0, 40.0)));
        let noisy = p.grey(Some(20.0), 7);
        let Samples::I16(with) = &noisy.samples else { panic!("a CT is i16") };
        let d: Vec<f64> = with.iter().zip(hu.iter()).map(|(a, b)| f64::from(a - b)).collect();
        let n = d.len() as f64;
        let mean = d.iter().sum::<f64>() / n;
        let sd = (d.iter().map(|v| v * v).sum::<f64>() / n).sqrt();
        assert!(mean.abs() < 0.2 && (sd - 20.0).abs() < 0.2, "mean {mean}, sd {sd}");
        let beyond = d.iter().filter(|v| v.abs() > 40.0).count() as f64 / n;
        assert!((beyond - 0.0455).abs() < 0.005, "{beyond} beyond two sigma");
        assert_ne!(noisy, p.grey(Some(20.0), 8));
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(noisy, one.install(|| p.grey(Some(20.0), 7)));
    }
}

#[test]
fn names_are_read_back_and_bad_numbers_are_errors() {
    for kind in Kind::ALL {
        assert_eq!(kind.name().parse(), Ok(kind));
    }
    assert!("sphere".parse::<Kind>().unwrap_err().to_string().contains("sphere"));
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(Phantom::new(Kind::Tube, 32, [1.0, bad, 1.0]).is_err(), "{bad}");
    }
    assert!(Phantom::new(Kind::Tube, 0, [1.0; 3]).is_err());
    assert!(Phantom::new(Kind::Tube, u32::MAX, [1.0; 3]).is_err());
    assert!(Phantom::new(Kind::Tube, 1, [1.0; 3]).is_ok());
}
