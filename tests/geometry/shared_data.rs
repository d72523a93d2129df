//! Real volumes, where the checkout has them beside it: recipes grow as many voxels as SciPy
//! counted, and surfaces have the vertices and Euler number that their masks say.

use std::path::Path;

use common::curves;
use common::volumes::{shared_data, unzip};
use glam::{IVec3, UVec3};
use intima::formats::{ReadOptions, read_volume};
use intima::lumen::{BitVolume, IntensitySelection, Lumen, SegmentationOptions, grow};
use intima::surface::{Midpoint, Surface};
use intima::volume::Volume;

fn read(path: &Path) -> Volume {
    read_volume(path, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}"))
}

fn at_least(lo: f64) -> IntensitySelection {
    IntensitySelection::Range { lo, hi: f64::INFINITY }
}

fn at_most(hi: f64) -> IntensitySelection {
    IntensitySelection::Range { lo: f64::NEG_INFINITY, hi }
}

/// Vertices and Euler number of the surface, counted on the mask alone: in/out pairs, and twice
/// the solid's Euler number with the cells whose two outside corners lie across the body.
fn counted(bits: &BitVolume) -> (usize, i64) {
    let (lo, hi) = bits.bounds().expect("some voxel is inside");
    let (lo, hi) = (lo.as_ivec3() - 1, hi.as_ivec3());
    let (mut vertices, mut solid) = (0, 0i64);
    for z in lo.z..=hi.z {
        for y in lo.y..=hi.y {
            // Corner k of the cell lies at bits x, y, z of k.
            let column = |x: i32| -> [bool; 4] {
                std::array::from_fn(|k| {
                    bits.get(IVec3::new(x, y + (k as i32 & 1), z + (k as i32 >> 1)))
                })
            };
            let mut low = column(lo.x);
            for x in lo.x..=hi.x {
                let high = column(x + 1);
                let c: [bool; 8] =
                    std::array::from_fn(|k| if k & 1 == 0 { low[k >> 1] } else { high[k >> 1] });
                let pairs = [(0, 1), (0, 2), (0, 4)];
                vertices += pairs.iter().filter(|(a, b)| c[*a] != c[*b]).count();
                let all = |of: &[usize]| i64::from(of.iter().all(|k| c[*k]));
                let edges = all(&[0, 1]) + all(&[0, 2]) + all(&[0, 4]);
                let squares = all(&[0, 1, 2, 3]) + all(&[0, 1, 4, 5]) + all(&[0, 2, 4, 6]);
                let cube = all(&[0, 1, 2, 3, 4, 5, 6, 7]);
                let outside = c.iter().filter(|c| !**c).count();
                let across = outside == 2 && (0..4).any(|k| !c[k] && !c[7 - k]);
                solid += i64::from(c[0]) - edges + squares - cube + i64::from(across);
                low = high;
            }
        }
    }
    (vertices, 2 * solid)
}

/// A selection, how many voxels it grows to, and their inclusive box.
type Row = (IntensitySelection, u64, Option<[[u32; 2]; 3]>);

/// Grows each selection from the seed and checks counts and, where given, the inclusive box.
fn assert_grown(volume: &Volume, what: &str, seed: [u32; 3], rows: &[Row]) {
    for (selection, voxels, extent) in rows {
        let bits = grow(volume, selection, UVec3::from(seed)).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(bits.count(), *voxels, "{what}, {selection}");
        if let Some(e) = extent {
            let (lo, hi) = bits.bounds().unwrap();
            let got = [[lo.x, hi.x], [lo.y, hi.y], [lo.z, hi.z]];
            assert_eq!(got, *e, "{what}, {selection}");
        }
    }
}

/// The surface of what the options select, as it is and with its cavities filled; how many those
/// are is compared where SciPy has counted them.
fn assert_surface(
    volume: &Volume,
    what: &str,
    selection: &IntensitySelection,
    seed: [u32; 3],
    cavities: Option<usize>,
) {
    let seed = UVec3::from(seed);
    let grown = grow(volume, selection, seed).unwrap();
    let plain = Lumen::new(volume.grid, &grown);
    let options =
        SegmentationOptions { seed: Some(seed), ..SegmentationOptions::new(selection.clone()) };
    let (filled, found) = options.apply(volume).unwrap();
    if let Some(cavities) = cavities {
        assert_eq!(found.filled.1, cavities, "{what}: cavities");
    }
    let mut solid = BitVolume::new(volume.grid.dims);
    for e in filled.elements(&filled.inside) {
        let v = filled.volume_voxel(filled.bricks.voxel(e)).as_uvec3();
        solid.set(v.x, v.y, v.z);
    }
    for (lumen, bits, how) in [(&plain, &grown, "as grown"), (&filled, &solid, "filled")] {
        let t = Surface::new(lumen, &Midpoint, None).topology;
        println!("{what}, {how}: {} voxels, {t:?}", bits.count());
        assert_eq!((t.vertices, t.euler), counted(bits), "{what}, {how}");
        assert!(t.watertight, "{what}, {how}");
    }
}

#[test]
fn the_aorta_grows_and_its_surface_is_the_masks() {
    let Some(data) = shared_data() else { return };
    let (volume, seed) = (read(&data.join("aorta_mra.mha")), [75, 133, 16]);
    let rows = [
        (at_least(900.0), 53_717, None),
        (at_least(1100.0), 42_453, Some([[25, 135], [0, 325], [0, 33]])),
        (at_least(1300.0), 32_581, Some([[35, 131], [16, 300], [0, 33]])),
        (at_least(1500.0), 22_893, None),
    ];
    assert_grown(&volume, "aorta", seed, &rows);
    assert_surface(&volume, "aorta", &at_least(1300.0), seed, Some(10));
}

#[test]
fn the_arteries_of_the_head_grow_and_their_surface_is_the_masks() {
    let Some(data) = shared_data() else { return };
    let (volume, seed) = (read(&data.join("aneurism.nrrd")), [110, 106, 160]);
    let rows = [
        (at_least(40.0), 88_596, None),
        (at_least(60.0), 78_523, Some([[65, 233], [24, 234], [7, 239]])),
        (at_least(80.0), 70_812, None),
    ];
    assert_grown(&volume, "aneurysm", seed, &rows);
    assert_surface(&volume, "aneurysm", &at_least(60.0), seed, None);
}

#[test]
fn oblique_and_rescaled_angiograms_grow() {
    let Some(data) = shared_data() else { return };
    let mra = read(&data.join("chris_MRA.nii.gz"));
    let extent = Some([[10, 194], [109, 252], [0, 112]]);
    assert_grown(&mra, "carotid", [38, 115, 0], &[(at_least(60.0), 24_737, extent)]);
    assert_grown(&mra, "carotid", [74, 151, 29], &[(at_least(100.0), 17_487, None)]);
    let avm = read(&data.join("CT_AVM.nii.gz"));
    let extent = Some([[0, 203], [13, 239], [0, 145]]);
    assert_grown(&avm, "AVM", [68, 110, 25], &[(at_least(100.0), 171_294, extent)]);
    assert_grown(&avm, "AVM", [31, 86, 40], &[(at_least(150.0), 130_164, None)]);
    for (volume, what, selection, seed) in [
        (&mra, "carotid", at_least(60.0), [38, 115, 0]),
        (&avm, "AVM", at_least(100.0), [68, 110, 25]),
    ] {
        assert_surface(volume, what, &selection, seed, None);
    }
}

#[test]
fn the_colon_grows_and_its_surface_is_the_masks() {
    let Some(data) = shared_data() else { return };
    let (volume, seed) = (read(&data.join("colon_ct_prone_half.nrrd")), [52, 110, 118]);
    let rows = [
        (at_most(-900.0), 641_113, None),
        (at_most(-800.0), 672_870, Some([[10, 245], [48, 175], [75, 208]])),
        (at_most(-700.0), 690_406, None),
        (at_most(-600.0), 864_797, None),
    ];
    assert_grown(&volume, "colon", seed, &rows);
    let rectum = Some([[98, 172], [70, 158], [0, 71]]);
    assert_grown(&volume, "rectum", [112, 136, 26], &[(at_most(-800.0), 75_086, rectum)]);
    assert_surface(&volume, "colon", &at_most(-800.0), seed, None);

    let options = SegmentationOptions {
        seed: Some(seed.into()),
        ..SegmentationOptions::new(at_most(-800.0))
    };
    let case = curves::route(options.apply(&volume).unwrap().0, false);
    let line = case.points(0);
    case.assert_inside(&line, "colon");
    let turns = curves::turns(&line);
    let mean = turns.iter().sum::<f64>() / turns.len() as f64;
    let proof = case.routed.proof;
    println!("colon: {} mm, {mean:.2} degrees a mm, {proof:?}", turns.len());
    assert!(mean <= 3.0 && proof.replaced == 0, "{mean} degrees a mm, {proof:?}");
}

#[test]
fn the_airway_grows_from_dicom_and_its_surface_is_the_masks() {
    let Some(folder) = unzip("chest_ct_fnndsc.zip") else { return };
    let (volume, seed) = (read(folder.path()), [240, 242, 155]);
    let rows = [
        (at_most(-980.0), 39_364, None),
        (at_most(-950.0), 44_479, None),
        (at_most(-920.0), 48_194, Some([[156, 329], [215, 355], [0, 174]])),
        (at_most(-900.0), 50_526, Some([[148, 329], [215, 356], [0, 174]])),
        (at_most(-890.0), 407_680, None),
    ];
    assert_grown(&volume, "airway", seed, &rows);
    assert_surface(&volume, "airway", &at_most(-920.0), seed, Some(255));
    let options = SegmentationOptions {
        seed: Some(seed.into()),
        ..SegmentationOptions::new(at_most(-920.0))
    };
    assert_eq!(options.apply(&volume).unwrap().0.inside_voxels(), 48_983);
}

/// The largest component that is not outside air: voxels of it, of the largest outside and of the
/// largest left out in the body.
fn largest_inside(volume: &Volume, what: &str, hi: f64) -> [u64; 3] {
    let (lumen, found) = SegmentationOptions::new(at_most(hi)).apply(volume).unwrap();
    println!(
        "{what}: {:?}, air {:?}",
        found.taken,
        found.outside.iter().take(8).collect::<Vec<_>>()
    );
    let taken = found.taken.unwrap().voxels;
    assert_eq!(taken, found.grown_voxels);
    assert!(lumen.inside_voxels() >= taken);
    [taken, found.outside[0].voxels, found.others[0].voxels]
}

#[test]
fn air_around_a_patient_on_a_table_is_not_the_lumen() {
    let Some(data) = shared_data() else { return };
    let colon = read(&data.join("colon_ct_prone_half.nrrd"));
    assert_eq!(largest_inside(&colon, "colon", -800.0), [672_870, 5_321_542, 147_024]);
    let Some(folder) = unzip("chest_ct_fnndsc.zip") else { return };
    // The airway is the second: emphysema is larger here. Air below the table and between its
    // plates is outside too.
    let chest = read(folder.path());
    assert_eq!(largest_inside(&chest, "chest", -920.0), [50_594, 17_044_261, 48_194]);
}
