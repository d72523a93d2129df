//! Volumes that are written while they are made.

use std::io;
use std::path::Path;

use intima::formats::{FormatError, ReadOptions, read_volume, write_layers, write_volume};
use intima::volume::{Grid, Volume};

/// Bytes of all files in a folder.
fn bytes_in(folder: &Path) -> u64 {
    let files = std::fs::read_dir(folder).unwrap().flatten();
    files.map(|f| f.metadata().unwrap().len()).sum()
}

#[test]
fn a_volume_in_layers_is_on_disk_while_it_is_made_and_the_same_as_in_one_piece() {
    let tmp = tempfile::tempdir().unwrap();
    let grid = Grid::axis_aligned([512, 512, 12], [0.5, 0.5, 2.0]);
    let mut seed = 1u64;
    let mut noise = || {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 40) as u16
    };
    let all: Vec<u16> = (0..grid.len()).map(|_| noise()).collect();
    let layer = 512 * 512 * 2;
    // What was handed over and is not on disk is no more than a layer and what is buffered.
    let mut most_held = 0;
    let path = tmp.path().join("layers.nrrd");
    let layers = |put: &mut dyn FnMut(&[u16]) -> io::Result<()>| {
        all.chunks(layer).enumerate().try_for_each(|(i, l)| {
            most_held = most_held.max((2 * i * layer) as i64 - bytes_in(tmp.path()) as i64);
            put(l)
        })
    };
    write_layers(&path, &grid, layers).unwrap();
    assert!(most_held < 2 * layer as i64, "{most_held} bytes of {}", 2 * all.len());
    let whole = tmp.path().join("whole.nrrd");
    write_volume(&whole, &Volume::new(grid, all.clone().into())).unwrap();
    let read = |path: &Path| read_volume(path, &ReadOptions::default()).unwrap();
    assert!(read(&path) == read(&whole));
}

type Put<'a> = &'a mut dyn FnMut(&[u8]) -> io::Result<()>;

#[test]
fn layers_that_do_not_fill_their_grid_leave_no_file() {
    let tmp = tempfile::tempdir().unwrap();
    let grid = Grid::axis_aligned([4, 4, 4], [1.0; 3]);
    let path = tmp.path().join("o.nrrd");
    for layers in [vec![vec![0u8; 63]], vec![vec![0; 64], vec![0]], vec![]] {
        let layers = |put: Put<'_>| layers.iter().try_for_each(|l: &Vec<u8>| put(l));
        assert!(write_layers(&path, &grid, layers).is_err());
        assert_eq!(bytes_in(tmp.path()), 0);
    }
    let what = write_layers(&tmp.path().join("o.nii"), &grid, |put: Put<'_>| put(&[0u8; 64]));
    assert!(matches!(what, Err(FormatError::Unsupported { .. })));
}
