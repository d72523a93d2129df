//! The Z-order (Morton) curve through a box.

use glam::Vec3;

/// Order numbers of places in the box from `lo` to `hi`, by their cell of 1024³ in its longest side.
pub fn morton_code(lo: Vec3, hi: Vec3) -> impl Fn(Vec3) -> u32 {
    let scale = 1023.0 / (hi - lo).max_element().max(f32::MIN_POSITIVE);
    // Two zero bits before each of ten.
    let spread = |x: f32| {
        let mut x = x as u32 & 1023;
        for (shift, mask) in [(16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)] {
            x = (x | x << shift) & mask;
        }
        x
    };
    move |p| {
        let cell = (p - lo) * scale;
        spread(cell.x) | spread(cell.y) << 1 | spread(cell.z) << 2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_interleave_the_bits_of_a_cell() {
        let code = morton_code(Vec3::ZERO, Vec3::splat(1023.0));
        assert_eq!(code(Vec3::new(1.0, 0.0, 0.0)), 0b001);
        assert_eq!(code(Vec3::new(0.0, 3.0, 0.0)), 0b010_010);
        assert_eq!(code(Vec3::new(5.0, 0.0, 4.0)), 0b101_000_001);
        assert_eq!(code(Vec3::splat(1023.0)), (1 << 30) - 1);
    }
}
