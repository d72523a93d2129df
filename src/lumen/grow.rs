//! Region growing: the 6-component of a seed, by spans. It visits what it fills and the rows
//! beside that, reading the stored type.

use glam::UVec3;

use super::window::{StoredWindow, check_seed};
use super::{BitVolume, LumenError, Window};
use crate::volume::{Sample, Volume, with_samples};

/// The 6-connected component of `seed` in `window`.
///
/// # Errors
/// [`LumenError::SeedOutside`], [`LumenError::SeedValue`].
pub fn grow(volume: &Volume, window: &Window, seed: UVec3) -> Result<BitVolume, LumenError> {
    check_seed(volume, window, seed)?;
    let mut bits = BitVolume::new(volume.grid.dims);
    with_samples!(&volume.samples, |s| spans(&window.stored(volume, s), s, seed, &mut bits));
    Ok(bits)
}

fn spans<T: Sample>(window: &StoredWindow<T>, samples: &[T], seed: UVec3, bits: &mut BitVolume) {
    let dims = bits.dims();
    let nx = dims.x as usize;
    let row = |y: u32, z: u32| {
        let s = nx * (y as usize + dims.y as usize * z as usize);
        &samples[s..s + nx]
    };
    let mut open = vec![(seed.x, seed.y, seed.z)];
    while let Some((x, y, z)) = open.pop() {
        if bits.at(x, y, z) {
            continue;
        }
        let values = row(y, z);
        let mut a = x;
        while a > 0 && window.holds(values[a as usize - 1]) {
            a -= 1;
        }
        let mut b = x;
        while b + 1 < dims.x && window.holds(values[b as usize + 1]) {
            b += 1;
        }
        bits.set_run((a, b), y, z);
        let mut beside = |y: u32, z: u32| {
            let values = &row(y, z)[a as usize..=b as usize];
            let mut fresh = false;
            for (i, &v) in values.iter().enumerate() {
                let x = a + i as u32;
                let enters = window.holds(v) && !bits.at(x, y, z);
                if enters && !fresh {
                    open.push((x, y, z));
                }
                fresh = enters;
            }
        };
        if y > 0 {
            beside(y - 1, z);
        }
        if y + 1 < dims.y {
            beside(y + 1, z);
        }
        if z > 0 {
            beside(y, z - 1);
        }
        if z + 1 < dims.z {
            beside(y, z + 1);
        }
    }
}
