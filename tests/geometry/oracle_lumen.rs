//! Growing, filling, components and classes against SciPy's counts, exactly.

use common::fixtures::{self, int, ints, json, mask, masks, selected, volume, voxel};
use intima::lumen::{
    BitVolume, IntensitySelection, Lumen, LumenError, SegmentationOptions, grow, grow_controlled,
};
use intima::volume::Volume;
use serde_json::Value;

/// The voxels of a mask: as a label, parts that touch by edges would be joined.
const SELECTED: IntensitySelection = IntensitySelection::Range { lo: 1.0, hi: f64::INFINITY };

fn selection(case: &Value) -> IntensitySelection {
    let end = |v: &Value, open: f64| v.as_f64().unwrap_or(open);
    IntensitySelection::Range {
        lo: end(&case["low"], f64::NEG_INFINITY),
        hi: end(&case["high"], f64::INFINITY),
    }
}

/// Whether the set voxels are those of which `inside` says so.
fn is_set(bits: &BitVolume, level: &Volume, inside: impl Fn(f64) -> bool) -> bool {
    (0..level.grid.len()).all(|i| {
        let v = level.grid.voxel(i);
        bits.at(v.x, v.y, v.z) == inside(level.real(i))
    })
}

#[test]
fn every_recipe_grows_and_fills_as_many_voxels() {
    let (grey, all) = (volume("grow/grey.nrrd"), json("grow/recipes.json"));
    let seed = voxel(&all["seed"]).as_uvec3();
    for r in fixtures::list(&all["recipes"]) {
        let grown = grow(&grey, &selection(r), seed).unwrap();
        assert_eq!(grown.count() as i64, int(&r["grown"]), "{r}");
        let options =
            SegmentationOptions { seed: Some(seed), ..SegmentationOptions::new(selection(r)) };
        let (lumen, found) = options.apply(&grey).unwrap();
        assert_eq!(found.grown_voxels as i64, int(&r["grown"]), "{r}");
        assert_eq!(lumen.inside_voxels() as i64, int(&r["filled"]), "{r}");
    }
}

#[test]
fn growing_at_every_threshold_gives_the_sublevel_set_of_the_flood_level() {
    let (grey, level) = (volume("grow/grey.nrrd"), volume("grow/level.nrrd"));
    let seed = voxel(&json("grow/recipes.json")["seed"]).as_uvec3();
    let mut levels: Vec<i64> = (0..level.grid.len()).map(|i| level.real(i) as i64).collect();
    levels.sort_unstable();
    levels.dedup();
    assert!(levels.len() > 100, "{}", levels.len());
    for t in levels {
        let hi = t as f64;
        let grown =
            grow(&grey, &IntensitySelection::Range { lo: f64::NEG_INFINITY, hi }, seed).unwrap();
        assert!(is_set(&grown, &level, |c| c <= hi), "threshold {t}");
    }
}

#[test]
fn leak_control_keeps_a_sublevel_set_of_the_flood_level() {
    let level = volume("grow/level.nrrd");
    let seed = voxel(&json("grow/recipes.json")["seed"]).as_uvec3();
    // As it is, and with voxels so large that the thin place counts as a leak.
    for (scale, leaks) in [(1.0, false), (2.0, true)] {
        let mut grey = volume("grow/grey.nrrd");
        grey.grid.spacing_mm *= scale;
        let selection = IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: -500.0 };
        let (bits, report) = grow_controlled(&grey, &selection, seed).unwrap();
        println!("{report:?}");
        assert!(is_set(&bits, &level, |c| c <= report.threshold), "{report:?}");
        let ml = bits.count() as f64 * grey.grid.voxel_mm3() / 1000.0;
        assert!((report.volume_ml - ml).abs() < 1e-9 * ml);
        assert_eq!(report.leak_ml.is_some(), leaks, "{report:?}");
        // The tube's noise ends at about -900, the pocket behind the wall begins at -860.
        let below_the_pocket = report.threshold < -810.0 && report.threshold > -900.0;
        assert!(below_the_pocket == leaks, "{report:?}");
    }
}

fn assert_classes(lumen: &Lumen, want: &Value, what: &str) {
    assert_eq!(lumen.inside_voxels() as i64, int(&want["inside"]), "{what}: inside");
    assert_eq!(lumen.boundary_voxels as i64, int(&want["boundary"]), "{what}: boundary");
    assert_eq!(lumen.internal_voxels as i64, int(&want["internal"]), "{what}: internal");
    let classes = lumen.classes();
    let count = |class: u8| classes.iter().filter(|c| **c == class).count() as i64;
    assert_eq!(count(1), int(&want["internal"]), "{what}: class 1");
    assert_eq!(count(2), int(&want["boundary"]), "{what}: class 2");
}

#[test]
fn classes_of_every_mask_as_it_is_filled_and_its_largest_component() {
    for (name, want) in masks() {
        let volume = mask(&name);
        let options =
            SegmentationOptions { all_components: true, ..SegmentationOptions::new(SELECTED) };
        assert_classes(&Lumen::new(volume.grid, &selected(&volume)), &want, &name);
        let largest = SegmentationOptions { all_components: false, ..options.clone() };
        if int(&want["inside"]) == 0 {
            for r in [options, largest] {
                assert!(matches!(r.apply(&volume), Err(LumenError::Empty { .. })), "{name}");
            }
            continue;
        }
        let plain = SegmentationOptions { fill: false, ..options.clone() };
        assert_classes(&plain.apply(&volume).unwrap().0, &want, &name);
        let (lumen, found) = options.apply(&volume).unwrap();
        let mut filled = want["filled"].clone();
        assert_classes(&lumen, &filled, &format!("{name}, filled"));
        let added = int(&filled["inside"].take()) - int(&want["inside"]);
        assert_eq!(found.filled.0 as i64, added, "{name}: voxels filled");

        let one = &want["largest_filled"];
        let (lumen, found) = largest.apply(&volume).unwrap();
        assert_classes(&lumen, one, &format!("{name}, largest"));
        assert_eq!(found.grown_voxels as i64, int(&one["before_fill"]), "{name}");
        let mut sizes = vec![found.grown_voxels as i64];
        sizes.extend(found.others.iter().map(|c| c.voxels as i64));
        assert_eq!(sizes, ints(&want["component_sizes"]), "{name}: components");
        let first = lumen.classes().iter().position(|c| *c != 0).unwrap();
        assert_eq!(volume.grid.voxel(first).as_ivec3(), voxel(&one["first_voxel"]), "{name}");
    }
}

#[test]
fn components_grown_from_their_first_voxels_are_those_found() {
    for (name, want) in masks().into_iter().filter(|(_, w)| int(&w["inside"]) > 0) {
        let volume = mask(&name);
        let (_, found) = SegmentationOptions::new(SELECTED).apply(&volume).unwrap();
        for c in &found.others {
            let grown = grow(&volume, &SELECTED, c.first).unwrap();
            assert_eq!(grown.count(), c.voxels, "{name}: {c:?}");
        }
        let others = ints(&want["component_sizes"])[1..].iter().sum::<i64>();
        assert_eq!(found.other_voxels as i64, others, "{name}");
    }
}
