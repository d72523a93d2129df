//! What must not matter: background around the lumen, order and direction of axes, the value of a
//! label, the place of bricks. The same lumen has the same graph.

use common::curves::{self, Case};
use common::volumes::{shared_data, shared_file};
use glam::{DMat3, DVec3, UVec3};
use intima::centerline::RouteOptions;
use intima::formats::{ReadOptions, read_volume};
use intima::geometry::Centerline;
use intima::lumen::{BitVolume, IntensitySelection, Lumen, SegmentationOptions};
use intima::session::{Session, Settings, Source, VolumeSource};
use intima::volume::phantom::{Kind, Phantom};
use intima::volume::{Grid, Volume};

/// A label map with other storage: its voxels lie where they lay.
#[derive(Clone, Copy)]
struct Storage {
    /// Background added below and above along each canonical axis; negative where it is cut off.
    pad: [[i32; 2]; 3],
    /// Canonical axis of each stored one.
    axes: [usize; 3],
    reversed: [bool; 3],
    label: u8,
}

impl Storage {
    const PLAIN: Self = Self { pad: [[0; 2]; 3], axes: [0, 1, 2], reversed: [false; 3], label: 1 };

    /// Stores the voxels of a mask.
    fn of(self, grid: &Grid, mask: &BitVolume) -> Volume {
        let low = glam::IVec3::from(self.pad.map(|p| p[0]));
        let high = glam::IVec3::from(self.pad.map(|p| p[1]));
        let dims = (grid.dims.as_ivec3() + low + high).as_uvec3();
        let place = |stored: UVec3| {
            let mut v = glam::IVec3::ZERO;
            for (k, axis) in self.axes.into_iter().enumerate() {
                let last = dims[axis] as i32 - 1;
                let at = stored[k] as i32;
                v[axis] = if self.reversed[k] { last - at } else { at };
            }
            v - low
        };
        let column = |k: usize| {
            let axis = grid.direction.col(self.axes[k]);
            if self.reversed[k] { -axis } else { axis }
        };
        let origin = grid.world_from_voxel().transform_point3(place(UVec3::ZERO).as_dvec3());
        let stored = Grid::new(
            self.axes.map(|axis| u64::from(dims[axis])),
            DVec3::from(self.axes.map(|axis| grid.spacing_mm[axis])),
            origin,
            DMat3::from_cols(column(0), column(1), column(2)),
        )
        .unwrap();
        let label = |i| if mask.get(place(stored.voxel(i))) { self.label } else { 0 };
        Volume::new(stored, (0..stored.len()).map(label).collect::<Vec<u8>>().into())
    }
}

/// Storages of every kind.
fn storages() -> Vec<(String, Storage)> {
    let plain = Storage::PLAIN;
    let mut all = Vec::new();
    for pad in 1..=8 {
        all.push((format!("pad {pad}"), Storage { pad: [[pad; 2]; 3], ..plain }));
    }
    all.push(("pad one side".into(), Storage { pad: [[3, 0], [0, 5], [4, 1]], ..plain }));
    let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    for (i, axes) in orders.into_iter().enumerate() {
        all.push((format!("axes {axes:?}"), Storage { axes, ..plain }));
        let reversed = [i % 2 == 0, i % 3 != 0, i % 4 < 2];
        all.push((format!("axes {axes:?} {reversed:?}"), Storage { axes, reversed, ..plain }));
    }
    for flips in 0..8u32 {
        let reversed = [0, 1, 2].map(|k| flips >> k & 1 != 0);
        all.push((format!("flips {reversed:?}"), Storage { reversed, ..plain }));
    }
    all.push(("label 200".into(), Storage { label: 200, ..plain }));
    all
}

/// The tree of a volume, as a session makes it.
fn tree_of(volume: Volume) -> (Centerline, Vec<u8>) {
    let mut settings = Settings::default();
    settings.lumen.select = Some(IntensitySelection::Labels(Vec::new()));
    settings.centerline.tree = true;
    let source = Source::Image(VolumeSource::Memory(std::sync::Arc::new(volume)));
    let session = Session::new(source, settings).unwrap();
    (session.centerline().unwrap().line.clone(), session.lumen().unwrap().lumen.classes())
}

/// Bytes of all points.
fn points(line: &Centerline) -> Vec<u64> {
    let points = line.branches.iter().flat_map(|b| &b.points);
    points
        .flat_map(|p| [p.position_mm.x, p.position_mm.y, p.position_mm.z, p.radius_mm])
        .map(f64::to_bits)
        .collect()
}

fn assert_storage_is_lost(what: &str, grid: &Grid, mask: &BitVolume, kinds: &[(String, Storage)]) {
    let (plain, _) = tree_of(Storage::PLAIN.of(grid, mask));
    for (name, storage) in kinds {
        let volume = storage.of(grid, mask);
        let stored: Vec<u8> = (0..volume.grid.len()).map(|i| volume.real(i) as u8).collect();
        let (line, classes) = tree_of(volume);
        assert!(points(&line) == points(&plain), "{what}, {name}: the tree differs");
        // What is written is in the frame of the file that was read.
        let same = classes.iter().zip(&stored).all(|(class, label)| (*class > 0) == (*label > 0));
        assert!(same, "{what}, {name}: the written lumen is another");
    }
}

fn mask_of(volume: &Volume) -> BitVolume {
    let options = SegmentationOptions::new(IntensitySelection::Labels(Vec::new()));
    options.select(volume).unwrap().0
}

#[test]
fn a_tree_has_the_same_bytes_however_its_label_map_is_stored() {
    let y = Phantom::new(Kind::Y, 56, [1.0, 0.9, 0.8]).unwrap().mask();
    assert_storage_is_lost("Y", &y.grid, &mask_of(&y), &storages());
    // Oblique axes: the nearest order of axes is not the patient's.
    let turn = DMat3::from_rotation_x(0.2) * DMat3::from_rotation_z(0.3);
    let oblique = Grid { direction: turn, origin_mm: DVec3::new(-12.3, 45.6, -78.9), ..y.grid };
    let kinds: Vec<_> = storages().into_iter().step_by(3).collect();
    assert_storage_is_lost("oblique Y", &oblique, &mask_of(&y), &kinds);
}

/// Every shared label map, cropped to its lumen's box so that it is small enough to be stored in
/// many ways.
#[test]
fn trees_of_real_label_maps_have_the_same_bytes_however_they_are_stored() {
    let Some(data) = shared_data() else { return };
    let mut kinds = storages();
    kinds.retain(|(name, _)| name == "pad 1");
    kinds.push((
        "all".into(),
        Storage {
            pad: [[2, 3], [0, 5], [7, 1]],
            axes: [1, 2, 0],
            reversed: [true, false, true],
            label: 7,
        },
    ));
    let mut files: Vec<_> = std::fs::read_dir(&data)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.to_string_lossy().ends_with(".nii.gz"))
        .filter(|path| path.to_string_lossy().contains("label"))
        .collect();
    files.sort();
    assert!(files.len() > 10, "{} label maps", files.len());
    for path in files {
        let volume = read_volume(&path, &ReadOptions::default()).unwrap().canonical();
        let mask = mask_of(&volume);
        // Large lumens take too long in a build for tests.
        if mask.count() > 400_000 {
            continue;
        }
        let (low, high) = mask.bounds().unwrap();
        let (low, dims) = (low - 1, high - low + 3);
        let cropped = BitVolume::from_rows(dims, |y, z, row| {
            let (y, z) = (y + low.y, z + low.z);
            for x in (0..dims.x).filter(|x| mask.get(UVec3::new(x + low.x, y, z).as_ivec3())) {
                row[x as usize / 64] |= 1 << (x % 64);
            }
        });
        let origin_mm = volume.grid.world_from_voxel().transform_point3(low.as_dvec3());
        let grid =
            Grid { dims, origin_mm, order: intima::volume::AxisOrder::IDENTITY, ..volume.grid };
        assert_storage_is_lost(&path.display().to_string(), &grid, &cropped, &kinds);
    }
}

/// Trees from every place of the bricks' sides.
fn anchored(path: &str, every: usize, of: &mut dyn FnMut(UVec3, Case)) {
    let Some(path) = shared_file(path) else { return };
    let volume = read_volume(&path, &ReadOptions::default()).unwrap().canonical();
    let mask = mask_of(&volume);
    for i in (0..64u32).step_by(every) {
        let margin = UVec3::new(1 + (i & 3), 1 + (i >> 2 & 3), 1 + (i >> 4));
        let lumen = Lumen::with_margin(volume.grid, &mask, margin);
        let options = RouteOptions { tree: true, ..RouteOptions::default() };
        of(margin, curves::route_with(lumen, options));
    }
}

#[test]
fn a_tree_does_not_depend_on_where_the_sides_of_bricks_lie() {
    for (name, every) in [
        ("airway_label_lidc1.nii.gz", 21),
        ("colon_label_3.nii.gz", 63),
        ("pulmonary_arteries_label.nii.gz", 63),
    ] {
        let mut first: Option<Centerline> = None;
        anchored(name, every, &mut |margin, case| {
            let line = case.routed.line;
            let first = first.get_or_insert_with(|| line.clone());
            assert_eq!(line.branches.len(), first.branches.len(), "{name}, {margin}");
            for (a, b) in line.branches.iter().zip(&first.branches) {
                let (p, q) = (a.points[a.points.len() - 1], b.points[b.points.len() - 1]);
                assert!(p.position_mm.distance(q.position_mm) < 0.01, "{name}, {margin}: a tip");
            }
            let ratio = line.length_mm() / first.length_mm();
            assert!((ratio - 1.0).abs() < 1e-3, "{name}, {margin}: {ratio}");
        });
    }
}
