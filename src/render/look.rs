//! Light on the wall. Its material is in the shader.

/// Light and background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Distance at which light is halved, mm; by default a multiple of the room about the eye.
    pub falloff_mm: Option<f32>,
    /// Colour of the background, linear.
    pub background: [f32; 3],
    /// Opacity of the overview's wall: 0 none, 1 as glass, 2 solid.
    pub opacity: f32,
    /// Share by which light departs farther from smooth light in an inside view; 0 leaves it as it is.
    pub local_contrast: f32,
}

/// Colour of wall that no picture has shown: linear, eight bits each, and the share of the tissue's
/// colour that it replaces.
pub const MISSED: [u8; 4] = [8, 60, 205, 235];

impl Default for Look {
    fn default() -> Self {
        Self {
            falloff_mm: None,
            background: [0.006, 0.007, 0.009],
            opacity: 1.0,
            local_contrast: 0.0,
        }
    }
}

/// Distance at which light is halved, in rooms about the eye, unless [`Look::falloff_mm`] gives
/// one.
pub(super) const FALLOFF_ROOMS: f32 = 20.0;
/// Height of the light above the eye, as a share of the room.
pub(super) const LIGHT_ROOMS: f32 = 0.35;

/// Encodes a linear colour as sRGB (IEC 61966-2-1).
pub(super) fn srgb(linear: [f32; 3]) -> [f32; 3] {
    let one = |c: f32| {
        if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
    };
    linear.map(one)
}

#[cfg(test)]
mod tests {
    use super::srgb;

    /// The fraction's five numbers, as the shader has them.
    fn fraction() -> [f64; 5] {
        let shader = include_str!("../../shaders/draw/surface.wgsl");
        let body = shader.split("fn encoded").nth(1).and_then(|b| b.split("let others").next());
        let numbers =
            body.expect("the shader's `encoded`").split(|c: char| !"0123456789.".contains(c));
        let found: Vec<f64> =
            numbers.filter(|n| n.len() > 5).map(|n| n.parse().expect("a number")).collect();
        found.try_into().expect("five numbers")
    }

    #[test]
    fn the_shaders_fraction_is_srgb_within_half_a_step_of_eight_bits() {
        let [a, b, c, d, e] = fraction();
        let mut most: f64 = 0.0;
        for i in 0..=100_000 {
            let x = (f64::from(i) * 1e-5).powi(2);
            let [curve, ..] = srgb([x as f32; 3]);
            let fraction = x * (a + x * b) / (1.0 + x * (c + x * (d - x * e)));
            most = most.max(255.0 * (fraction - f64::from(curve)).abs());
        }
        assert!(most < 0.47, "{most} of 255");
    }
}
