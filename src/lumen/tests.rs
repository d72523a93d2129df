mod outside_air;

use super::*;
use crate::volume::Samples;

/// Deterministic noise: voxel inside with probability `p`/256.
fn noise(dims: [u32; 3], p: u32, seed: u64) -> Volume {
    let grid = Grid::axis_aligned(dims, [1.0, 1.0, 1.0]);
    let mut s = seed;
    let mut next = || {
        s = s.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (s >> 56) as u32
    };
    let v: Vec<u8> = (0..grid.len()).map(|_| u8::from(next() < p)).collect();
    Volume::new(grid, Samples::from(v))
}

fn inside(v: &Volume, p: IVec3) -> bool {
    v.grid.contains(p) && v.samples.get(v.grid.index(p.as_uvec3())) != 0.0
}

const SIX: [IVec3; 6] = [IVec3::X, IVec3::NEG_X, IVec3::Y, IVec3::NEG_Y, IVec3::Z, IVec3::NEG_Z];

/// Plain breadth-first flood, the oracle of the run and brick code.
fn flood(seed: IVec3, holds: impl Fn(IVec3) -> bool) -> std::collections::BTreeSet<[i32; 3]> {
    let mut seen = std::collections::BTreeSet::new();
    let mut open = vec![seed];
    while let Some(p) = open.pop() {
        if holds(p) && seen.insert(p.to_array()) {
            open.extend(SIX.map(|d| p + d));
        }
    }
    seen
}

/// The voxel of the volume that an element is.
fn place(lumen: &Lumen, element: usize) -> IVec3 {
    lumen.volume_voxel(lumen.bricks.voxel(element))
}

#[test]
fn growing_equals_a_plain_flood_and_bricks_hold_every_voxel_and_its_rim() {
    for (k, dims) in [[17, 9, 13], [8, 8, 8], [70, 5, 3], [1, 1, 1]].into_iter().enumerate() {
        let mut v = noise(dims, 150, k as u64 + 1);
        if let Samples::U8(s) = &mut v.samples {
            s[0] = 1;
        }
        let want = flood(IVec3::ZERO, |p| inside(&v, p));
        let options = SegmentationOptions {
            seed: Some(UVec3::ZERO),
            fill: false,
            ..SegmentationOptions::new(IntensitySelection::Range { lo: 1.0, hi: f64::INFINITY })
        };
        let (lumen, found) = options.apply(&v).unwrap();
        assert_eq!(found.grown_voxels as usize, want.len());
        let got: std::collections::BTreeSet<_> =
            lumen.elements(&lumen.inside).map(|e| place(&lumen, e).to_array()).collect();
        assert_eq!(got, want);
        for p in &want {
            for n in 0..27 {
                let d = IVec3::new(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1);
                let q = IVec3::from(*p) + d;
                let own = |v: IVec3| lumen.bricks.element(lumen.own_voxel(v));
                let e = own(q).expect("the rim has a brick");
                assert_eq!(place(&lumen, e), q);
                let from = own(IVec3::from(*p)).unwrap();
                assert_eq!(lumen.bricks.step(from, d), Some(e));
            }
        }
        let boundary =
            |p: &&[i32; 3]| SIX.iter().any(|d| !want.contains(&(IVec3::from(**p) + *d).to_array()));
        assert_eq!(lumen.boundary_voxels as usize, want.iter().filter(boundary).count());
        let classes = lumen.classes();
        assert_eq!(classes.iter().filter(|c| **c != 0).count(), want.len());
    }
}

#[test]
fn the_largest_component_is_kept_and_the_others_are_reported_with_size_and_place() {
    let grid = Grid::axis_aligned([10, 4, 4], [1.0; 3]);
    let mut s = vec![0u8; grid.len()];
    for (x, y, z) in [(0, 0, 0), (1, 0, 0), (2, 0, 0), (5, 1, 1), (6, 1, 1), (9, 3, 3)] {
        s[grid.index(UVec3::new(x, y, z))] = 7;
    }
    // What touches by an edge alone is joined.
    s[grid.index(UVec3::new(7, 2, 1))] = 7;
    let v = Volume::new(grid, Samples::from(s));
    let (lumen, found) =
        SegmentationOptions::new(IntensitySelection::Labels(vec![7])).apply(&v).unwrap();
    assert_eq!(lumen.inside_voxels(), 4);
    let others: Vec<_> = found.others.iter().map(|c| (c.voxels, c.first)).collect();
    let at = UVec3::new;
    assert_eq!(others, [(3, at(0, 0, 0)), (1, at(9, 3, 3))]);
    assert_eq!(found.joined, [at(7, 1, 1)]);
    assert!(!lumen.touches_edge);
}

#[test]
fn closed_cavities_are_filled_and_open_ones_are_not() {
    let grid = Grid::axis_aligned([9, 9, 9], [1.0; 3]);
    let shell = |p: UVec3| {
        let d = p.as_ivec3() - 4;
        d.abs().max_element() == 3
    };
    let mut s: Vec<u8> = (0..grid.len()).map(|i| u8::from(shell(grid.voxel(i)))).collect();
    let closed = Volume::new(grid, Samples::from(s.clone()));
    let (lumen, found) =
        SegmentationOptions::new(IntensitySelection::Labels(vec![])).apply(&closed).unwrap();
    assert_eq!((lumen.inside_voxels(), found.filled), (343, (125, 1)));
    s[grid.index(UVec3::new(4, 4, 1))] = 0;
    let open = Volume::new(grid, Samples::from(s));
    let (lumen, found) =
        SegmentationOptions::new(IntensitySelection::Labels(vec![])).apply(&open).unwrap();
    assert_eq!((lumen.inside_voxels(), found.filled), (217, (0, 0)));
}

#[test]
fn thresholds_are_inclusive_in_real_units_for_every_sign_of_slope() {
    let grid = Grid::axis_aligned([5, 1, 1], [1.0; 3]);
    let mut v = Volume::new(grid, Samples::from(vec![-3, -1, 0, 1, 3]));
    let count = |v: &Volume, lo, hi| IntensitySelection::Range { lo, hi }.select(v).count();
    let inf = f64::INFINITY;
    assert_eq!(count(&v, -1.0, 1.0), 3);
    assert_eq!(count(&v, -inf, -0.5), 2);
    assert_eq!(count(&v, 4.0, inf), 0);
    v.rescale = crate::volume::Rescale { slope: -2.0, intercept: 10.0 }; // 16 12 10 8 4
    assert_eq!(count(&v, 8.0, 12.0), 3);
    assert_eq!(count(&v, 12.0, inf), 2);
    v.samples = Samples::from(vec![f32::NAN, -1.0, f32::INFINITY, 0.0, 1.0]);
    v.rescale = crate::volume::Rescale::IDENTITY;
    assert_eq!(count(&v, -inf, inf), 4);
    assert_eq!(IntensitySelection::Labels(vec![]).select(&v).count(), 3);
    v.samples = Samples::from(vec![1, 2, 9, 4, 0]);
    assert_eq!(IntensitySelection::Labels(vec![1, 2, 9]).select(&v).count(), 3);
    assert_eq!(IntensitySelection::Labels(vec![-5, 300]).select(&v).count(), 0);
}

#[test]
fn a_leak_through_one_voxel_into_noise_is_stopped_below_it() {
    // A bright-walled tube whose wall has one weak voxel, in a parenchyma of rising values.
    let n = 48;
    let grid = Grid::axis_aligned([n; 3], [2.0; 3]);
    let mut s = vec![0i16; grid.len()];
    let mut lumen_voxels = 0;
    for (i, s) in s.iter_mut().enumerate() {
        let p = grid.voxel(i).as_vec3();
        let r = ((p.x - 24.0).powi(2) + (p.y - 24.0).powi(2)).sqrt();
        let ripple = ((i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as i16 & 0x7fff;
        let ripple = ripple % 41;
        *s = if r < 6.0 && p.z > 3.0 && p.z < 44.0 {
            lumen_voxels += 1;
            -990 + ripple
        } else if r < 8.0 {
            50
        } else {
            -850 + 3 * ripple
        };
        if (p.x, p.y, p.z) == (30.0, 24.0, 24.0) || (p.x, p.y, p.z) == (31.0, 24.0, 24.0) {
            *s = -880;
        }
    }
    let v = Volume::new(grid, Samples::from(s));
    let selection = IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: -500.0 };
    let seed = UVec3::new(24, 24, 24);
    let plain = grow(&v, &selection, seed).unwrap().count();
    assert!(plain > 4 * lumen_voxels, "the phantom leaks without control: {plain}");
    let (mask, report) = grow_controlled(&v, &selection, seed).unwrap();
    let extra = mask.count() as f64 / lumen_voxels as f64;
    assert!((0.99..1.01).contains(&extra), "{extra} {report:?}");
    assert!(report.threshold < -780.0 && report.leak_ml.is_some(), "{report:?}");
    // The flood at the chosen threshold is what growing there gives.
    let selection = IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: report.threshold };
    assert_eq!(grow(&v, &selection, seed).unwrap().count(), mask.count());
}

#[test]
fn bad_seeds_and_empty_selections_are_named() {
    let v = noise([4, 4, 4], 256, 3);
    let seeded = |seed, selection| {
        SegmentationOptions { seed: Some(seed), ..SegmentationOptions::new(selection) }.apply(&v)
    };
    let any = IntensitySelection::Labels(vec![]);
    let out = seeded(UVec3::new(4, 0, 0), any.clone()).unwrap_err();
    assert!(matches!(out, LumenError::SeedOutside { .. }));
    let high = IntensitySelection::Range { lo: 5.0, hi: f64::INFINITY };
    let wrong = seeded(UVec3::ZERO, high.clone()).unwrap_err();
    assert_eq!(wrong.to_string(), "seed [0, 0, 0] has value 1, which is not in threshold 5:");
    let empty = SegmentationOptions::new(high).apply(&v).unwrap_err();
    let text = "empty lumen: no voxel is in threshold 5: (values run from 1 to 1)";
    assert_eq!(empty.to_string(), text);
}

#[test]
fn an_intensity_selection_tests_rescaled_values() {
    use crate::volume::Rescale;
    let grid = Grid::axis_aligned([67, 3, 2], [1.0; 3]);
    let floats: Vec<f32> = (0..grid.len())
        .map(|i| if i % 11 == 0 { f32::NAN } else { (i % 7) as f32 - 3.0 })
        .collect();
    let shorts: Vec<i16> = (0..grid.len()).map(|i| (i % 9) as i16 - 4).collect();
    let bytes: Vec<u8> = (0..grid.len()).map(|i| (i * 37 % 5) as u8).collect();
    let selections = [
        IntensitySelection::Labels(vec![]),
        IntensitySelection::Labels(vec![2]),
        IntensitySelection::Labels(vec![-1, 3]),
        IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: 0.5 },
        IntensitySelection::Range { lo: -1.0, hi: 2.0 },
        IntensitySelection::Range { lo: 1e9, hi: 2e9 },
    ];
    for samples in [Samples::from(floats), Samples::from(shorts), Samples::from(bytes)] {
        // Of the last, no stored value is a real 0.
        for (slope, intercept) in [(1.0, 0.0), (-2.0, 4.0), (1.0, 0.25)] {
            let mut v = Volume::new(grid, samples.clone());
            v.rescale = Rescale { slope, intercept };
            for selection in &selections {
                let bits = selection.select(&v);
                for i in 0..grid.len() {
                    let p = grid.voxel(i);
                    let want = selection.holds(v.real(i));
                    assert_eq!(bits.at(p.x, p.y, p.z), want, "{selection} {p} {slope} {intercept}");
                }
                let some = (0..grid.len()).any(|i| selection.holds(v.real(i)));
                assert_eq!(!bits.is_empty(), some);
            }
        }
    }
}

#[test]
fn a_field_laid_out_densely_is_its_own_at_every_voxel() {
    for dims in [[17, 9, 13], [8, 8, 8], [3, 21, 16]] {
        let v = noise(dims, 60, 5);
        let options = SegmentationOptions {
            all_components: true,
            fill: false,
            ..SegmentationOptions::new(IntensitySelection::Labels(vec![]))
        };
        let (lumen, _) = options.apply(&v).unwrap();
        let field: Vec<u32> = (0..lumen.bricks.field_len() as u32).collect();
        let dense = lumen.dense(&field, u32::MAX);
        for (i, d) in dense.iter().enumerate() {
            let e = lumen.bricks.element(lumen.own_voxel(v.grid.voxel(i).as_ivec3()));
            assert_eq!(*d, e.map_or(u32::MAX, |e| e as u32));
        }
        let mut layers: Vec<Vec<u32>> = Vec::new();
        let put = &mut |layer: &[u32]| -> Result<(), ()> {
            layers.push(layer.to_vec());
            Ok(())
        };
        lumen.each_layer(&field, u32::MAX, put).unwrap();
        let most = 8 * dims[0] as usize * dims[1] as usize;
        assert!(layers.iter().all(|l| l.len() <= most));
        assert_eq!(layers.concat(), dense);
    }
}

#[test]
fn a_sheared_grid_is_refused_by_the_library_with_its_angle() {
    let mut v = noise([8, 8, 8], 128, 3);
    let any = SegmentationOptions::new(IntensitySelection::Labels(vec![]));
    for degrees in [0.0, 0.09, 0.2, 18.5] {
        let (sin, cos) = f64::to_radians(degrees).sin_cos();
        let direction =
            glam::DMat3::from_cols(glam::DVec3::X, glam::DVec3::Y, glam::DVec3::new(0.0, sin, cos));
        v.grid = Grid::new([8; 3], glam::DVec3::ONE, glam::DVec3::ZERO, direction).unwrap();
        match any.apply(&v) {
            Ok(_) => assert!(degrees < 0.1, "{degrees}"),
            Err(LumenError::Sheared { degrees: said }) => {
                assert!(degrees > 0.1 && (said - degrees).abs() < 1e-9, "{degrees}: {said}");
            }
            Err(e) => panic!("{e}"),
        }
    }
}

#[test]
fn a_leak_is_found_whatever_the_unit_of_the_values() {
    // A tube that opens into a large box through values between those of both.
    let grid = Grid::axis_aligned([64, 32, 32], [1.0; 3]);
    let level = |v: UVec3| {
        let r = (f64::from(v.y) - 16.0).hypot(f64::from(v.z) - 16.0);
        match v.x {
            0..24 if r < 4.0 => 0.05 + 0.001 * f64::from((v.x + v.y) % 7),
            24..26 if r < 1.5 => 0.6,
            26..62 if r < 15.0 => 0.3,
            _ => 1.0,
        }
    };
    let found = |scale: f64| {
        let values: Vec<f32> =
            (0..grid.len()).map(|i| (scale * level(grid.voxel(i))) as f32).collect();
        let v = Volume::new(grid, Samples::from(values));
        let selection = IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: 0.9 * scale };
        grow_controlled(&v, &selection, UVec3::new(10, 16, 16)).unwrap()
    };
    let (wide, narrow) = (found(1000.0), found(1.0));
    assert!(wide.1.leak_ml.is_some() && narrow.1.leak_ml.is_some(), "{:?}", (wide.1, narrow.1));
    assert_eq!(wide.0.count(), narrow.0.count());
}
