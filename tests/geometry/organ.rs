//! Organs found without a threshold, a seed or a click: on a torso whose truth is known by formula,
//! and on real volumes beside recipes that were counted by other programs.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use common::torso::Torso;
use common::volumes::{read, shared_data, unzip};
use glam::{DMat3, DVec3, UVec3};
use intima::lumen::{BitVolume, IntensitySelection, grow};
use intima::organ::{FoundOrgan, Organ, OrganError, OrganOptions, suggest};
use intima::volume::{Grid, Volume};

fn find(organ: Organ, volume: &Volume) -> Result<FoundOrgan, OrganError> {
    OrganOptions::from(organ).find(volume)
}

fn found(organ: impl Into<OrganOptions>, volume: &Volume) -> FoundOrgan {
    let options = organ.into();
    let found = options.find(volume).unwrap_or_else(|e| panic!("{e}"));
    println!("{}: confidence {:.2}", options.organ.name(), found.confidence);
    found.reasons.iter().for_each(|line| println!("  {line}"));
    assert!((0.0..=1.0).contains(&found.confidence) && !found.reasons.is_empty());
    found
}

/// An airway up to one threshold, without the thin bronchi beyond it.
const TREE: OrganOptions = OrganOptions { organ: Organ::Airway, tagged: false, thin: false };
/// A colon's gas alone.
const GAS: OrganOptions = OrganOptions { organ: Organ::Colon, tagged: false, thin: false };

fn refused(organ: Organ, volume: &Volume) -> String {
    let why = find(organ, volume).err().unwrap_or_else(|| panic!("{} was found", organ.name()));
    assert!(matches!(why, OrganError::NotFound { .. }), "{why}");
    why.to_string()
}

/// Dice's coefficient.
fn dice(a: &BitVolume, b: &BitVolume) -> f64 {
    let mut both = a.clone();
    both.keep(b);
    let dice = 2.0 * both.count() as f64 / (a.count() + b.count()) as f64;
    println!("  Dice {dice:.4}");
    dice
}

fn range(lo: f64, hi: f64) -> IntensitySelection {
    IntensitySelection::Range { lo, hi }
}

#[test]
fn each_organ_of_a_torso_is_found_and_nothing_else_taken_for_it() {
    let torso = Torso::default();
    let scan = torso.scan();
    let airway = found(TREE, &scan);
    assert!(dice(&airway.mask, &torso.truth(&torso.airway)) > 0.85);
    // Raising the threshold further takes in what is thin, not the lungs.
    let thin = found(Organ::Airway, &scan);
    assert!(thin.mask.count() >= airway.mask.count());
    assert!(dice(&thin.mask, &torso.truth(&torso.airway)) > 0.85);
    let colon = found(Organ::Colon, &scan);
    assert!(dice(&colon.mask, &torso.truth(&torso.colon)) > 0.9);
    let vessel = found(Organ::Vessel, &scan);
    assert!(dice(&vessel.mask, &torso.truth(&torso.aorta)) > 0.85);
    // The segments in order, from the rectum; neither stomach nor small bowel among them.
    let to_world = scan.grid.world_from_voxel();
    let at: Vec<usize> = colon
        .segments
        .iter()
        .map(|s| {
            let p = to_world.transform_point3(s.seed.as_dvec3());
            torso.colon.iter().position(|t| t.distance(p) < 0.0).expect("in a segment")
        })
        .collect();
    assert_eq!(at, [0, 1, 2, 3]);
    assert!(colon.reasons.iter().any(|r| r.contains("stomach")), "{:?}", colon.reasons);
    assert_eq!(suggest(&scan), Some(Organ::Airway));
}

/// What shows a fault: blood as bright as cortex, marrow as bright as blood, a stomach with a fluid level.
#[test]
fn bright_blood_bright_marrow_and_a_stomach_are_told_apart() {
    let Some(folder) = shared_data() else { return };
    let fault = |name: &str| read(&folder.join("faults").join(name)).unwrap();
    let ml = |found: &FoundOrgan, volume: &Volume| {
        found.mask.count() as f64 * volume.grid.voxel_mm3() / 1000.0
    };
    for name in ["s3_aorta_blood200_spine380.nrrd", "s3_aorta_blood300_spine380.nrrd"] {
        let volume = fault(name);
        let aorta = found(Organ::Vessel, &volume);
        assert!((58.0..66.0).contains(&ml(&aorta, &volume)), "{name}");
    }
    let volume = fault("s4r2_tcga_aorta_spine_crop_half.nrrd");
    let aorta = found(Organ::Vessel, &volume);
    // Lumbar vertebrae lie behind row 42 of the lower slices, the aorta in front of it.
    let behind = aorta.mask.voxels().filter(|v| v.z < 18 && v.y > 42).count();
    assert!(behind < 60 && ml(&aorta, &volume) < 75.0, "{behind}");
    let why = refused(Organ::Colon, &fault("s5_stomach_fluid_level.nrrd"));
    assert!(why.contains("ml of gas: stomach"), "{why}");
}

#[test]
fn an_organ_that_is_not_there_is_refused_with_the_gate_that_failed() {
    let none = Torso {
        airway: Vec::new(),
        colon: Vec::new(),
        aorta: Vec::new(),
        has_stomach: false,
        ..Torso::default()
    };
    let scan = none.scan();
    for (organ, words) in [
        (Organ::Airway, "cross sections"),
        (Organ::Colon, "below -900 HU"),
        (Organ::Vessel, "bright cross sections"),
    ] {
        let why = refused(organ, &scan);
        println!("{why}");
        assert!(why.contains(organ.name()) && why.contains(words), "{why}");
    }
    assert_eq!(suggest(&scan), None);
    let flat = Volume::new(scan.grid, vec![0i16; scan.grid.len()].into());
    Organ::ALL.iter().for_each(|organ| assert!(!refused(*organ, &flat).is_empty()));
}

/// The same scan, stored in another order or with another geometry.
fn with_axes(volume: &Volume, order: [usize; 3], flipped: [bool; 3], keep_world: bool) -> Volume {
    let g = &volume.grid;
    let dims = order.map(|axis| u64::from(g.dims[axis]));
    let from = |v: UVec3| {
        let mut out = UVec3::ZERO;
        for (k, axis) in order.into_iter().enumerate() {
            out[axis] = if flipped[k] { g.dims[axis] - 1 - v[k] } else { v[k] };
        }
        out
    };
    let spacing = DVec3::from(order.map(|axis| g.spacing_mm[axis]));
    let cols: [DVec3; 3] = std::array::from_fn(|k| {
        let way = g.direction.col(order[k]);
        if flipped[k] { -way } else { way }
    });
    let (direction, origin) = if keep_world {
        let origin = g.world_from_voxel().transform_point3(from(UVec3::ZERO).as_dvec3());
        (DMat3::from_cols(cols[0], cols[1], cols[2]), origin)
    } else {
        (DMat3::IDENTITY, DVec3::ZERO)
    };
    let grid = Grid::new(dims, spacing, origin, direction).unwrap();
    let values: Vec<i16> =
        (0..grid.len()).map(|i| volume.real(g.index(from(grid.voxel(i)))) as i16).collect();
    Volume::new(grid, values.into())
}

#[test]
fn the_order_in_which_voxels_are_stored_does_not_matter() {
    let torso = Torso::default();
    let scan = torso.scan();
    let plain: Vec<u64> = Organ::ALL.iter().map(|o| found(*o, &scan).mask.count()).collect();
    for (order, flipped, keep_world) in [
        ([0, 1, 2], [true, false, true], true),
        ([2, 0, 1], [false, true, false], true),
        // Without its geometry, a file's axes are anything.
        ([1, 2, 0], [false, false, true], false),
    ] {
        let turned = with_axes(&scan, order, flipped, keep_world);
        for (organ, wanted) in Organ::ALL.iter().zip(&plain) {
            let count = found(*organ, &turned).mask.count();
            // The longest chain of cross sections may begin elsewhere.
            let off = (count as f64 / *wanted as f64 - 1.0).abs();
            // Nothing tells left from right then, nor a stomach.
            let most = if keep_world || *organ != Organ::Colon { 0.01 } else { 0.4 };
            assert!(off < most, "{}: {count} for {wanted}", organ.name());
        }
    }
}

/// Adds noise of a standard deviation.
fn noisy(volume: &Volume, sigma: f64) -> Volume {
    let mut seed = 11u64;
    let mut random = || {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 40) as f64 / (1u64 << 24) as f64
    };
    let values: Vec<i16> = (0..volume.grid.len())
        .map(|i| {
            let normal = ((0..12).map(|_| random()).sum::<f64>() - 6.0) * sigma;
            (volume.real(i) + normal).round().clamp(-1024.0, 3071.0) as i16
        })
        .collect();
    Volume::new(volume.grid, values.into())
}

/// How much of each old slice lies in a new one.
fn slabs(slices: u32, ratio: f64) -> Vec<Vec<(u32, f64)>> {
    let count = (f64::from(slices) / ratio) as u32;
    let of = |k: u32| {
        let (from, to) = (f64::from(k) * ratio, f64::from(k + 1) * ratio);
        let part = |s: u32| f64::from(s + 1).min(to) - f64::from(s).max(from);
        (0..slices).map(|s| (s, part(s))).filter(|(_, part)| *part > 0.0).collect()
    };
    (0..count).map(of).collect()
}

/// Slices of another thickness, mm: means of what they hold.
fn thicker(volume: &Volume, slice_mm: f64) -> Volume {
    let g = &volume.grid;
    let slabs = slabs(g.dims.z, slice_mm / g.spacing_mm.z);
    let dims = [g.dims.x, g.dims.y, slabs.len() as u32];
    let spacing = DVec3::new(g.spacing_mm.x, g.spacing_mm.y, slice_mm);
    let grid = Grid::new(dims.map(u64::from), spacing, g.origin_mm, g.direction).unwrap();
    let values: Vec<i16> = (0..grid.len())
        .map(|i| {
            let v = grid.voxel(i);
            let slab = &slabs[v.z as usize];
            let at = |s: u32| volume.real(g.index(UVec3::new(v.x, v.y, s)));
            let sum: f64 = slab.iter().map(|(s, part)| at(*s) * part).sum();
            (sum / slab.iter().map(|s| s.1).sum::<f64>()).round() as i16
        })
        .collect();
    Volume::new(grid, values.into())
}

/// Voxels of thicker slices of which half or more is set.
fn thicker_mask(mask: &BitVolume, grid: &Grid, slice_mm: f64) -> BitVolume {
    let d = mask.dims();
    let slabs = slabs(d.z, slice_mm / grid.spacing_mm.z);
    let mut out = BitVolume::new(UVec3::new(d.x, d.y, slabs.len() as u32));
    for v in out.inverted().voxels() {
        let slab = &slabs[v.z as usize];
        let set = slab.iter().filter(|(s, _)| mask.at(v.x, v.y, *s)).map(|s| s.1).sum::<f64>();
        if 2.0 * set >= slab.iter().map(|s| s.1).sum() {
            out.set(v.x, v.y, v.z);
        }
    }
    out
}

/// Without its first fifth along an axis.
fn cropped(volume: &Volume, mask: &BitVolume, axis: usize) -> (Volume, BitVolume) {
    let mut from = UVec3::ZERO;
    from[axis] = volume.grid.dims[axis] / 5;
    part(volume, mask, from, volume.grid.dims)
}

/// The voxels of a box, its end excluded.
fn part(volume: &Volume, mask: &BitVolume, from: UVec3, end: UVec3) -> (Volume, BitVolume) {
    let g = &volume.grid;
    let origin = g.world_from_voxel().transform_point3(from.as_dvec3());
    let dims = (end - from).to_array();
    let grid = Grid::new(dims.map(u64::from), g.spacing_mm, origin, g.direction).unwrap();
    let values: Vec<i16> =
        (0..grid.len()).map(|i| volume.real(g.index(grid.voxel(i) + from)) as i16).collect();
    let mut out = BitVolume::new(grid.dims);
    mask.voxels().filter(|v| v.cmpge(from).all() && v.cmplt(end).all()).for_each(|v| {
        let w = v - from;
        out.set(w.x, w.y, w.z);
    });
    (Volume::new(grid, values.into()), out)
}

#[test]
fn the_airway_of_a_real_chest_is_found_in_noise_thick_slices_and_parts_of_it() {
    let Some(volume) = unzipped("chest_ct_fnndsc.zip") else { return };
    let truth =
        grow(&volume, &range(f64::NEG_INFINITY, -920.0), UVec3::new(240, 242, 155)).unwrap();
    assert_eq!(truth.count(), 48_194);
    let airway = |volume: &Volume, truth: &BitVolume| dice(&found(TREE, volume).mask, truth);
    assert!(airway(&volume, &truth) > 0.97);
    assert!(airway(&noisy(&volume, 40.0), &truth) > 0.9);
    assert!(airway(&thicker(&volume, 5.0), &thicker_mask(&truth, &volume.grid, 5.0)) > 0.91);
    // Slices thicker than bronchi show none of them, and that is said once.
    let thick = found(Organ::Airway, &thicker(&volume, 8.0));
    let said = thick.reasons.iter().filter(|r| r.contains("thinner than the slices show")).count();
    assert!(said == 1 && thick.confidence <= 0.5, "{:?}", thick.reasons);
    let eight = found(Organ::Airway, &thicker(&volume, 5.0)).mask.count() as f64 * 5.0 / 8.0;
    assert!((thick.mask.count() as f64) < eight);
    for axis in 0..3 {
        let (part, truth) = cropped(&volume, &truth, axis);
        assert!(airway(&part, &truth) > 0.97);
    }
    println!("{}\n{}", refused(Organ::Colon, &volume), refused(Organ::Vessel, &volume));
    assert_eq!(suggest(&volume), Some(Organ::Airway));
}

/// The volume of the series in an archive, unpacked and read once for all tests.
fn unzipped(name: &'static str) -> Option<Volume> {
    static READ: Mutex<BTreeMap<&str, Volume>> = Mutex::new(BTreeMap::new());
    let mut all = READ.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(volume) = all.get(name) {
        return Some(volume.clone());
    }
    let folder = unzip(name)?;
    let inner = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
    let inner = if inner.is_dir() { inner } else { inner.parent().unwrap().to_owned() };
    let volume = read(&inner).unwrap();
    all.insert(name, volume.clone());
    Some(volume)
}

/// Share of the voxels of a mask that are in another.
fn share(of: &BitVolume, inside: &BitVolume) -> f64 {
    let mut both = of.clone();
    both.keep(inside);
    let share = both.count() as f64 / of.count().max(1) as f64;
    println!("  share {share:.4}");
    share
}

#[test]
fn a_scan_that_ends_near_the_carina_shows_the_trachea() {
    let Some(volume) = unzipped("chest_ct_fnndsc.zip") else { return };
    let truth =
        grow(&volume, &range(f64::NEG_INFINITY, -920.0), UVec3::new(240, 242, 155)).unwrap();
    // The carina lies about slice 117.
    for first in [110, 125, 135] {
        let (top, truth) = part(&volume, &truth, UVec3::new(0, 0, first), volume.grid.dims);
        let airway = found(Organ::Airway, &top);
        assert!(share(&truth, &airway.mask) > 0.95 && airway.mask.count() < 2 * truth.count());
        assert!(airway.confidence < 0.8);
    }
    let (top, _) = part(&volume, &truth, UVec3::new(0, 0, 145), volume.grid.dims);
    assert!(refused(Organ::Airway, &top).contains("length of a trachea without lung"));
}

#[test]
fn bronchi_behind_a_plug_join_or_are_missed_with_a_word() {
    let Some(volume) = unzipped("chest_ct_fnndsc.zip") else { return };
    // Just below the carina: half of the airway lies behind it.
    let below_carina = UVec3::new(232, 289, 105);
    let tree = found(TREE, &volume).mask;
    for plug_hu in [-905, -880, -650] {
        let mut blocked = volume.clone();
        let grid = volume.grid;
        let values: Vec<i16> = (0..grid.len())
            .map(|i| {
                let v = grid.voxel(i).as_ivec3() - below_carina.as_ivec3();
                let is_plug = v.z.abs() <= 1 && v.x.abs() < 25 && v.y.abs() < 25;
                let value = volume.real(i) as i16;
                if is_plug { value.max(plug_hu) } else { value }
            })
            .collect();
        blocked.samples = values.into();
        blocked.rescale = intima::volume::Rescale::IDENTITY;
        let airway = found(Organ::Airway, &blocked);
        if plug_hu == -650 {
            assert!(airway.reasons.iter().any(|r| r.contains("main bronchus may be blocked")));
            assert!(airway.confidence <= 0.3);
            continue;
        }
        assert!(share(&tree, &airway.mask) > 0.9, "{plug_hu} HU");
        assert!((airway.mask.count() as f64) < 1.2 * tree.count() as f64);
    }
}

#[test]
fn a_trunk_on_a_hollow_table_has_its_airway_its_aorta_and_no_colon_of_litres() {
    let Some(volume) = unzipped("trunk_ct_contrast.zip") else { return };
    let ml = volume.grid.voxel_mm3() / 1000.0;
    let seed = UVec3::new(263, 254, 137);
    let bronchi = grow(&volume, &range(f64::NEG_INFINITY, -880.0), seed).unwrap();
    assert!(dice(&found(TREE, &volume).mask, &bronchi) > 0.95);
    let thin = found(Organ::Airway, &volume);
    assert!(share(&bronchi, &thin.mask) > 0.99 && thin.mask.count() as f64 * ml < 35.0);
    // The table lies behind row 330, and holds more than four litres of air.
    if let Ok(colon) = find(Organ::Colon, &volume) {
        assert!(colon.mask.voxels().all(|v| v.y < 330));
        assert!(colon.mask.count() as f64 * ml < 200.0 && colon.confidence < 0.2);
    }
    let seed = UVec3::new(260, 224, 37);
    let aorta = grow(&volume, &range(150.0, f64::INFINITY), seed).unwrap();
    assert_eq!(aorta.count(), 31_403);
    let vessel = found(Organ::Vessel, &volume);
    assert!(share(&aorta, &vessel.mask) > 0.95);
    assert!(vessel.mask.count() as f64 * ml < 150.0);
}

#[test]
fn the_colon_of_a_real_scan_is_found_with_all_its_segments() {
    let Some(folder) = shared_data() else { return };
    let volume = read(&folder.join("colon_ct_prone_half.nrrd")).unwrap();
    let label = read(&folder.join("colon_ct_prone_half_label.nrrd")).unwrap();
    let label = IntensitySelection::Labels(vec![1]).select(&label);
    let mut gas = range(f64::NEG_INFINITY, -450.0).select(&volume);
    gas.keep(&label);
    let colon = found(GAS, &volume);
    // The label leaves out the descending colon.
    assert!(dice(&colon.mask, &gas) > 0.95);
    assert_eq!(colon.segments.len(), 3);
    let low = colon.segments.iter().map(|s| s.seed.z).min();
    assert_eq!(Some(colon.segments[0].seed.z), low);
    // Tagged fluid is taken where there is some.
    assert!(dice(&found(Organ::Colon, &volume).mask, &label) > 0.9);
    assert!(dice(&found(GAS, &noisy(&volume, 40.0)).mask, &gas) > 0.95);
    let in_slices = |slice_mm: f64| {
        let mask = found(GAS, &thicker(&volume, slice_mm)).mask;
        dice(&mask, &thicker_mask(&gas, &volume.grid, slice_mm))
    };
    assert!(in_slices(4.0) > 0.95);
    // A diaphragm thinner than these joins the lung to the colon.
    assert!(in_slices(5.0) > 0.94);
    println!("{}\n{}", refused(Organ::Airway, &volume), refused(Organ::Vessel, &volume));
    assert_eq!(suggest(&volume), Some(Organ::Colon));
}

#[test]
fn vessels_of_real_angiograms_are_found_whatever_their_background() {
    let Some(folder) = shared_data() else { return };
    for (name, least, seed) in [
        ("aorta_mra.mha", 1100.0, [75, 133, 16]),
        ("aneurism.nrrd", 60.0, [110, 106, 160]),
        ("CT_AVM.nii.gz", 100.0, [68, 110, 25]),
        ("chris_MRA.nii.gz", 60.0, [38, 115, 0]),
    ] {
        println!("{name}");
        let volume = read(&folder.join(name)).unwrap();
        let truth = grow(&volume, &range(least, f64::INFINITY), UVec3::from(seed)).unwrap();
        assert!(dice(&found(Organ::Vessel, &volume).mask, &truth) > 0.96);
        // Noise reaches below a background that was set to zero.
        let (low, high) = volume.range().unwrap();
        let noisy = noisy(&volume, 0.02 * (high - low));
        assert!(dice(&found(Organ::Vessel, &noisy).mask, &truth) > 0.95);
        refused(Organ::Airway, &volume);
        refused(Organ::Colon, &volume);
    }
}

/// Means of 2³ voxels.
fn halved(volume: &Volume) -> Volume {
    let g = &volume.grid;
    let dims = g.dims / 2;
    let grid =
        Grid::new(dims.to_array().map(u64::from), 2.0 * g.spacing_mm, g.origin_mm, g.direction)
            .unwrap();
    let values: Vec<i16> = (0..grid.len())
        .map(|i| {
            let v = 2 * grid.voxel(i);
            let at = |n: u32| volume.real(g.index(v + UVec3::new(n & 1, n >> 1 & 1, n >> 2)));
            ((0..8).map(at).sum::<f64>() / 8.0).round() as i16
        })
        .collect();
    Volume::new(grid, values.into())
}

#[test]
fn organs_of_flipped_cropped_thick_and_noisy_scans_are_right_or_refused() {
    organs_of_variants_are_right_or_refused(halved, &[30.0], 2..3);
}

#[test]
#[ignore = "minutes: cargo test --release --test geometry whole_variants -- --ignored --nocapture"]
fn organs_of_whole_variants_are_right_or_refused() {
    organs_of_variants_are_right_or_refused(Volume::clone, &[20.0, 40.0, 80.0], 0..3);
}

/// * `scale`: makes the volume that is asked.
/// * `noise_hu`: noises that are added.
/// * `cropped`: axes at whose ends chests are cropped; the trunk and the colon are along each.
fn organs_of_variants_are_right_or_refused(
    scale: fn(&Volume) -> Volume,
    noise_hu: &[f64],
    cropped: std::ops::Range<usize>,
) {
    let chest = unzipped("chest_ct_fnndsc.zip");
    let trunk = unzipped("trunk_ct_contrast.zip");
    let Some((folder, (chest, trunk))) = shared_data().zip(chest.zip(trunk)) else { return };
    let read = |name: &str| read(&folder.join(name)).unwrap();
    // Whether an organ is in the scan.
    for (name, volume, has) in [
        ("chest", chest, [true, false, false]),
        ("trunk", trunk, [true, true, true]),
        ("colon", read("colon_ct_prone_half.nrrd"), [false, true, false]),
        ("sharp chest", read("chest_ct_sharp_3mm.nrrd"), [true, false, false]),
    ] {
        let volume = scale(&volume);
        let dims = volume.grid.dims;
        let all = BitVolume::new(dims).inverted();
        let references: Vec<Option<BitVolume>> =
            Organ::ALL.iter().map(|o| find(*o, &volume).ok().map(|f| f.mask)).collect();
        let (mut variants, mut right, mut refusals) = (0, 0, 0);
        let mut check = |what: &str, scan: &Volume, moved: &dyn Fn(&BitVolume) -> BitVolume| {
            variants += 1;
            for (k, organ) in Organ::ALL.into_iter().enumerate() {
                let Ok(found) = find(organ, scan) else {
                    refusals += 1;
                    continue;
                };
                println!("{name} {what} {}: {:.2}", organ.name(), found.confidence);
                assert!(has[k], "{name} {what}: {:?}", found.reasons);
                // Of a trunk's gas any part is a part of its bowel.
                if organ != Organ::Colon || name == "colon" {
                    let wanted = moved(references[k].as_ref().expect("found in the whole scan"));
                    assert!(dice(&found.mask, &wanted) > 0.75, "{:?}", found.reasons);
                } else {
                    let ml = found.mask.count() as f64 * scan.grid.voxel_mm3() / 1000.0;
                    assert!(ml < 200.0, "{:?}", found.reasons);
                }
                right += 1;
            }
        };
        let is_chest = name.ends_with("chest");
        for axis in if is_chest { cropped.clone() } else { 0..3 } {
            let fifth = dims[axis] / 5;
            let (mut from, mut end) = (UVec3::ZERO, dims);
            (from[axis], end[axis]) = (fifth, dims[axis] - fifth);
            for (what, from, end) in [("first", from, dims), ("last", UVec3::ZERO, end)] {
                let (scan, _) = part(&volume, &all, from, end);
                let what = format!("without its {what} fifth along {axis}");
                check(&what, &scan, &|mask| part(&volume, mask, from, end).1);
            }
        }
        for sigma in noise_hu {
            check(&format!("noise of {sigma} HU"), &noisy(&volume, *sigma), &BitVolume::clone);
        }
        let thick_mm = 1.5 * volume.grid.spacing_mm.z;
        check("thick slices", &thicker(&volume, thick_mm), &|mask| {
            thicker_mask(mask, &volume.grid, thick_mm)
        });
        let turned = with_axes(&volume, [2, 0, 1], [true, false, true], true);
        check("turned", &turned, &|mask| {
            let mut out = BitVolume::new(turned.grid.dims);
            for v in mask.voxels() {
                let at = UVec3::new(dims.z - 1 - v.z, v.x, dims.y - 1 - v.y);
                out.set(at.x, at.y, at.z);
            }
            out
        });
        println!("{name}: {right} right, {refusals} refused");
        assert!(right + 2 >= variants, "{name}: {right} of {variants}");
    }
}

#[test]
fn heads_and_label_maps_hold_no_airway_colon_or_vessel() {
    let Some(folder) = shared_data() else { return };
    let all = |path: &Path| {
        let volume = read(path).unwrap();
        Organ::ALL.iter().for_each(|organ| println!("{}", refused(*organ, &volume)));
        assert_eq!(suggest(&volume), None);
    };
    for name in [
        "head_ct_cranium.nrrd",
        "CT_pitch.nii.gz",
        "colon_label_1.nii.gz",
        "abdomen_labels_96.nrrd",
    ] {
        all(&folder.join(name));
    }
}

#[test]
fn padding_brighter_than_all_values_does_not_end_the_search_for_vessels() {
    let grid = Grid::axis_aligned([40, 40, 40], [1.0; 3]);
    let values: Vec<i16> = (0..grid.len())
        .map(|i| {
            let v = grid.voxel(i).as_dvec3();
            let is_vessel = (v.truncate() - 20.0).length() < 2.5;
            if v.x < 2.0 { 32_767 } else { i as i16 % 50 + if is_vessel { 900 } else { 100 } }
        })
        .collect();
    let mut volume = Volume::new(grid, values.into());
    volume.padding = Some([32_767.0; 2]);
    // Too short to be taken for one; but looked at.
    let why = refused(Organ::Vessel, &volume);
    assert!(why.contains("extent, mm"), "{why}");
}

#[test]
fn a_colon_is_flown_from_the_rectum_through_all_its_segments() {
    use intima::session::{LumenSettings, Session, Settings, Source, VolumeSource};
    let torso = Torso::default();
    let source = Source::Image(VolumeSource::Memory(std::sync::Arc::new(torso.scan())));
    let organ = Some(OrganOptions::from(Organ::Colon));
    let lumen = LumenSettings { organ, ..LumenSettings::default() };
    let session = Session::new(source, Settings { lumen, ..Settings::default() }).unwrap();
    let centered = session.centerline().unwrap();
    let at: Vec<Option<usize>> = centered
        .line
        .pieces()
        .map(|piece| {
            let middle = piece.points[piece.points.len() / 2].position_mm;
            torso.colon.iter().position(|t| t.distance(middle) < 0.0)
        })
        .collect();
    assert_eq!(at, [Some(0), Some(1), Some(2), Some(3)]);
    let ends = |p: &intima::geometry::Branch| [p.points[0], p.points[p.points.len() - 1]];
    let first = centered.line.pieces().next().map(ends).unwrap();
    assert!(first[0].position_mm.z < first[1].position_mm.z, "{first:?}");
}

#[test]
fn the_command_line_says_what_it_chose_and_why_and_draws_it() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    intima::formats::write_volume(&at("ct.nrrd"), &Torso::default().scan()).unwrap();
    let run = |flags: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_intima"));
        command.args(["--json", "segment"]).arg(at("ct.nrrd")).arg("-o").arg(at("mask.nrrd"));
        let out = command.args(flags).output().unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        (out.status.code(), text(out.stdout), text(out.stderr))
    };
    let picture = at("explain.png");
    let (code, out, err) = run(&["--organ", "colon", "--explain", picture.to_str().unwrap()]);
    assert_eq!(code, Some(0), "{err}");
    let answer: serde_json::Value = serde_json::from_str(out.lines().last().unwrap()).unwrap();
    let organ = &answer["organ"];
    assert_eq!(organ["name"], "colon");
    assert_eq!(organ["segments"].as_array().unwrap().len(), 4);
    assert_eq!(organ["seeds_mm"].as_array().unwrap().len(), 4);
    assert!(organ["confidence"].as_f64().unwrap() > 0.0 && organ["threshold"] == -450.0);
    let reasons = organ["reasons"].to_string();
    assert!(reasons.contains("share of the shell that is tissue"), "{reasons}");
    assert!(!err.contains("share of the shell"), "a choice is no warning: {err}");
    assert_eq!(answer["wall"]["method"], "field");
    assert!(answer["wall"]["closed_by_limit_share"].as_f64().unwrap() < 0.05);
    let (width, height, rgb) = intima::formats::read_png(&picture).unwrap();
    let coloured = rgb.chunks(3).filter(|p| p[0] > p[2].saturating_add(60)).count();
    assert!(width > 900 && height > 300 && coloured > 5000, "{width} {height} {coloured}");

    let (code, _, err) = run(&[]);
    assert_eq!(code, Some(2));
    assert!(err.contains("--organ airway (there seems to be one)"), "{err}");
    let (code, _, err) = run(&["--organ", "vessel", "--tagged"]);
    assert!(code == Some(2) && err.contains("--tagged needs --organ colon"), "{err}");
    let (code, _, err) = run(&["--organ", "colon", "--thin-bronchi"]);
    assert!(code == Some(2) && err.contains("--thin-bronchi needs --organ airway"), "{err}");
    let (code, _, _) = run(&["--organ", "colon", "--threshold", ":-800"]);
    assert_eq!(code, Some(2));
}
