//! Pictures on their way from the device to the caller.

use std::sync::{Arc, Mutex, PoisonError};

/// Memory of pictures that are not needed any more, to be filled anew: the system provides fresh
/// memory a page at a time, 675 of them for a picture of 1280 x 720.
#[derive(Clone, Debug, Default)]
pub struct Spares(Arc<Mutex<Vec<Vec<u8>>>>);

impl Spares {
    /// Takes a picture back, whatever its size.
    pub fn give(&self, picture: Vec<u8>) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(picture);
    }

    /// Returns a picture of so many bytes, with undefined content.
    pub(super) fn take(&self, bytes: usize) -> Vec<u8> {
        let spare = self.0.lock().unwrap_or_else(PoisonError::into_inner).pop();
        // Fresh zeros come from the system as they are; growing would write them.
        let mut picture = spare.unwrap_or_else(|| vec![0; bytes]);
        picture.resize(bytes, 0);
        picture
    }
}

/// Leaves the fourth byte of each pixel out. `rgb` holds as many pixels.
pub(super) fn without_alpha(rgba: &[u8], rgb: &mut [u8]) {
    // Four pixels at a time: twelve bytes are three words.
    let (fours, rest) = rgba.as_chunks::<4>().0.as_chunks::<4>();
    let (twelves, rest_to) = rgb.as_chunks_mut::<12>();
    for ([a, b, c, d], to) in fours.iter().zip(twelves) {
        let (a, b) = (u32::from_le_bytes(*a), u32::from_le_bytes(*b));
        let (c, d) = (u32::from_le_bytes(*c), u32::from_le_bytes(*d));
        to[..4].copy_from_slice(&(a & 0xff_ffff | b << 24).to_le_bytes());
        to[4..8].copy_from_slice(&(b >> 8 & 0xffff | c << 16).to_le_bytes());
        to[8..].copy_from_slice(&(c >> 16 & 0xff | d << 8).to_le_bytes());
    }
    for (pixel, to) in rest.iter().zip(rest_to.as_chunks_mut::<3>().0) {
        to.copy_from_slice(&pixel[..3]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fourth_byte_is_left_out_whatever_the_number_of_pixels() {
        for pixels in 0..11u8 {
            let rgba: Vec<u8> = (0..4 * pixels).map(|i| 3 + 23 * (i % 11) + i / 11).collect();
            let wanted: Vec<u8> =
                rgba.chunks_exact(4).flat_map(|p| p[..3].iter().copied()).collect();
            let mut rgb = vec![0xee; wanted.len()];
            without_alpha(&rgba, &mut rgb);
            assert_eq!(rgb, wanted);
        }
    }

    #[test]
    fn a_picture_given_back_is_filled_anew_at_the_size_asked_for() {
        let spares = Spares::default();
        let big = vec![7; 3000];
        let at = big.as_ptr();
        spares.clone().give(big);
        let again = spares.take(30);
        assert_eq!((again.as_ptr(), again.len()), (at, 30));
        assert_eq!(spares.take(12), [0; 12]);
    }
}
