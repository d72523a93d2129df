//! Volumes that are read in parts: the same results as of those in memory, and memory that follows
//! the lumen.

use std::path::{Path, PathBuf};

use crate::COUNTED;
use common::child;
use common::volumes::{fixture, read};
use glam::UVec3;
use intima::device::DeviceChoice;
use intima::formats::{ReadOptions, VolumeParts, write_volume};
use intima::lumen::IntensitySelection;
use intima::session::{
    Product, Reading, Seed, Session, Settings, Source, VolumeSource, WallMethod,
};
use intima::volume::phantom::{Kind, Phantom};
use intima::volume::{Grid, Rescale, Volume};
use serde_json::json;

fn session(path: &Path, reading: Reading, settings: &Settings) -> Session {
    let settings = Settings { device: DeviceChoice::Cpu, reading, ..settings.clone() };
    Session::new(Source::Image(VolumeSource::file(path)), settings).unwrap()
}

fn threshold(lo: f64, hi: f64) -> Settings {
    let mut settings = Settings::default();
    settings.lumen.select = Some(IntensitySelection::Range { lo, hi });
    settings
}

/// Writes a volume as a Zarr array of raw chunks.
fn write_zarr(dir: &Path, volume: &Volume, chunk: [u32; 3]) -> PathBuf {
    std::fs::create_dir_all(dir).unwrap();
    let (dims, size) = (volume.grid.dims, volume.samples.sample_type().size());
    let kind = if size == 1 { "|u1" } else { "<i2" };
    let zyx = |v: [u32; 3]| [v[2], v[1], v[0]];
    let array = json!({ "zarr_format": 2, "shape": zyx(dims.to_array()), "chunks": zyx(chunk),
        "dtype": kind, "compressor": null, "fill_value": 0, "order": "C", "filters": null });
    std::fs::write(dir.join(".zarray"), array.to_string()).unwrap();
    let step = UVec3::from(chunk);
    let count = (dims + step - 1) / step;
    for n in (0..count.element_product())
        .map(|i| UVec3::new(i % count.x, i / count.x % count.y, i / count.x / count.y))
    {
        let mut bytes = Vec::new();
        for z in 0..chunk[2] {
            for y in 0..chunk[1] {
                for x in 0..chunk[0] {
                    let v = (n * step + UVec3::new(x, y, z)).min(dims - 1);
                    let at = volume.grid.index(v) * size;
                    bytes.extend(&volume.samples.bytes()[at..at + size]);
                }
            }
        }
        std::fs::write(dir.join(format!("{}.{}.{}", n.z, n.y, n.x)), bytes).unwrap();
    }
    dir.to_owned()
}

/// Everything up to the centerline, as bytes.
fn products(session: &Session) -> Vec<(&'static str, Vec<u8>)> {
    let (lumen, wall) = (session.lumen().unwrap(), session.wall().unwrap());
    let line = session.centerline().unwrap();
    let points: Vec<[f64; 3]> = line
        .line
        .branches
        .iter()
        .flat_map(|b| &b.points)
        .map(|p| p.position_mm.to_array())
        .collect();
    vec![
        ("hash", session.identity().unwrap().as_bytes().to_vec()),
        ("lumen", bytemuck::cast_slice(&lumen.lumen.inside).to_vec()),
        ("corners", bytemuck::cast_slice(lumen.lumen.bricks.corners()).to_vec()),
        ("notes", lumen.notes.join("\n").into_bytes()),
        ("distance", bytemuck::cast_slice(&session.distance().unwrap()).to_vec()),
        (
            "positions",
            wall.mesh
                .positions
                .iter()
                .flat_map(|p| p.to_array())
                .flat_map(f32::to_le_bytes)
                .collect(),
        ),
        (
            "normals",
            wall.mesh
                .normals
                .iter()
                .flat_map(|p| p.to_array())
                .flat_map(f32::to_le_bytes)
                .collect(),
        ),
        ("faces", bytemuck::cast_slice(&wall.mesh.faces).to_vec()),
        ("path", bytemuck::cast_slice(&points).to_vec()),
    ]
}

#[test]
fn a_volume_read_in_parts_gives_the_same_bytes_as_one_in_memory() {
    let dir = tempfile::tempdir().unwrap();
    let grey = Phantom::new(Kind::Y, 56, [0.7, 0.7, 0.9]).unwrap();
    let grey = grey.grey(None, 3);
    let mut flipped = grey.clone();
    flipped.rescale = Rescale { slope: -2.0, intercept: -40.0 };
    let air = threshold(f64::NEG_INFINITY, -500.0);
    let exact = |mut s: Settings| {
        s.lumen.wall = WallMethod::Exact;
        s
    };
    let mut seeded = air.clone();
    seeded.lumen.seed = Some(Seed::Voxel({
        let whole = Session::new(
            Source::Image(VolumeSource::Memory(grey.clone().into())),
            Settings { device: DeviceChoice::Cpu, ..air.clone() },
        );
        whole.unwrap().core().unwrap().mask.voxels().nth(1000).unwrap()
    }));
    let mut all = air.clone();
    (all.lumen.all_components, all.lumen.fill) = (true, false);
    let cases = [
        ("field.nii", &grey, air.clone()),
        ("exact.nii", &grey, exact(air.clone())),
        ("rescaled.nii", &flipped, exact(threshold(0.0, f64::INFINITY))),
        ("seeded", &grey, exact(seeded)),
        ("field", &grey, air),
        ("all", &grey, exact(all)),
    ];
    for (name, volume, settings) in cases {
        let mut path = dir.path().join(name);
        match name.ends_with(".nii") {
            true => write_volume(&path, volume).unwrap(),
            // Chunks that bricks straddle, of which the last ones reach beyond the volume.
            false => path = write_zarr(&path, volume, [20, 13, 11]),
        }
        let whole = products(&session(&path, Reading::Whole, &settings));
        let parts = products(&session(&path, Reading::Parts, &settings));
        for ((what, a), (_, b)) in whole.iter().zip(&parts) {
            assert!(a == b, "{name}: {what} differs");
        }
    }
}

#[test]
fn what_is_read_in_parts_reads_the_file_again_for_its_wall() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("y.nii");
    let volume = Phantom::new(Kind::Y, 40, [1.0; 3]).unwrap().grey(None, 3);
    for (reading, is_kept) in
        [(Reading::Whole, true), (Reading::Auto, true), (Reading::Parts, false)]
    {
        write_volume(&path, &volume).unwrap();
        let session = session(&path, reading, &threshold(f64::NEG_INFINITY, -500.0));
        session.prepare(&[Product::Core]).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert_eq!(session.lumen().is_ok(), is_kept, "{reading:?}");
    }
    // As where a limit of memory is below the volume's own size.
    let large =
        Volume::new(Grid::axis_aligned([200, 200, 100], [1.0; 3]), vec![0u8; 4_000_000].into());
    write_volume(&path, &large).unwrap();
    let mut settings = threshold(1.0, 2.0);
    settings.max_memory_mb = Some(3);
    let refused = session(&path, Reading::Auto, &settings).core().err().unwrap().to_string();
    assert!(refused.contains("in parts"), "{refused}");
    settings.lumen.select = None;
    let refused = session(&path, Reading::Auto, &settings).core().err().unwrap().to_string();
    assert!(refused.contains("a range of values or labels"), "{refused}");
}

#[test]
fn components_of_a_volume_read_in_parts_are_those_of_scipy() {
    let counts: serde_json::Value =
        serde_json::from_reader(std::fs::File::open(fixture("counts.json")).unwrap()).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let mut several = 0;
    for (name, mask) in counts.as_object().unwrap() {
        let sizes: Vec<u64> = mask["component_sizes"]
            .as_array()
            .unwrap()
            .iter()
            .map(|n| n.as_u64().unwrap())
            .collect();
        if sizes.is_empty() {
            continue;
        }
        let volume = read(&fixture(&format!("mask/{name}.mask.nrrd"))).unwrap();
        let path = write_zarr(&dir.path().join(name), &volume, [5, 7, 3]);
        let mut settings = Settings::default();
        settings.lumen.select = Some(IntensitySelection::Range { lo: 1.0, hi: f64::INFINITY });
        let core = session(&path, Reading::Parts, &settings).core().unwrap();
        let others: Vec<u64> = core.found.others.iter().map(|c| c.voxels).collect();
        assert_eq!(core.found.taken.unwrap().voxels, sizes[0], "{name}");
        assert_eq!(others, sizes[1..], "{name}");
        several += usize::from(sizes.len() > 1);
    }
    assert!(several > 2);
}

#[test]
fn any_box_of_a_raw_file_or_of_chunks_is_the_volumes() {
    let dir = tempfile::tempdir().unwrap();
    let volume = Phantom::new(Kind::Y, 24, [1.0; 3]).unwrap().grey(None, 5);
    let raw = dir.path().join("a.nii");
    write_volume(&raw, &volume).unwrap();
    let zarr = write_zarr(&dir.path().join("a"), &volume, [7, 24, 5]);
    let dims = volume.grid.dims;
    for path in [raw, zarr] {
        let parts = VolumeParts::open(&path, &ReadOptions::default()).unwrap().unwrap();
        for (lo, hi) in [
            (UVec3::ZERO, dims),
            (UVec3::new(0, 0, 3), UVec3::new(dims.x, dims.y, 9)),
            (UVec3::new(0, 5, 3), UVec3::new(dims.x, 11, 9)),
            (UVec3::new(2, 5, 3), UVec3::new(9, 6, 20)),
            (dims - 1, dims),
        ] {
            let samples = parts.read(lo, hi).unwrap();
            let extent = Grid::axis_aligned((hi - lo).to_array(), [1.0; 3]);
            for i in 0..samples.len() {
                let v = lo + extent.voxel(i);
                assert_eq!(samples.get(i), volume.samples.get(volume.grid.index(v)), "{v}");
            }
        }
    }
}

/// A file of 400 MB whose samples are holes of the file system, with a lumen of 0.3 MB.
#[test]
fn memory_of_a_volume_read_in_parts_follows_its_lumen() {
    if !child::alone("in_parts::memory_of_a_volume_read_in_parts_follows_its_lumen") {
        return;
    }
    use std::io::{Seek, SeekFrom, Write};
    let dir = tempfile::tempdir().unwrap();
    let header = dir.path().join("tube.nhdr");
    let text = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 800 800 640\nspacings: 0.3 0.3 0.3\n\
                encoding: raw\ndata file: tube.raw\n\n";
    std::fs::write(&header, text).unwrap();
    let mut file = std::fs::File::create(dir.path().join("tube.raw")).unwrap();
    file.set_len(800 * 800 * 640).unwrap();
    for z in 8..632u64 {
        for y in 0..16 {
            let at = 200 + z / 2 + 800 * (400 + y + 800 * z);
            file.seek(SeekFrom::Start(at)).unwrap();
            file.write_all(&[200; 16]).unwrap();
        }
    }
    drop(file);
    let session = session(&header, Reading::Parts, &threshold(100.0, f64::INFINITY));
    COUNTED.reset_peak_usage();
    let lumen = session.lumen().unwrap();
    let peak = COUNTED.peak_usage();
    println!("{} bricks, {peak} bytes at most", lumen.lumen.bricks.len());
    assert!(lumen.lumen.inside_voxels() > 100_000);
    // A slab of 32 MiB while it is read, then 20 KB a brick of the wall field.
    assert!(peak < 120_000_000, "{peak} bytes of a volume of 409,600,000");
}
