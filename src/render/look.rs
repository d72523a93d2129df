//! How the wall is lit. What it is made of stands in the shader.

/// Light and background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Distance at which light is halved, mm; by default a multiple of the organ's mean radius.
    pub falloff_mm: Option<f32>,
    /// Behind everything; linear.
    pub background: [f32; 3],
}

impl Default for Look {
    fn default() -> Self {
        Self { falloff_mm: None, background: [0.006, 0.007, 0.009] }
    }
}

/// Light is halved after this many mean radii, unless [`Look::falloff_mm`] says otherwise.
pub(super) const FALLOFF_RADII: f32 = 2.4;
/// How far beside the eye the light sits, in mean radii.
pub(super) const LIGHT_RADII: f32 = 0.2;

/// A linear colour as sRGB stores it (IEC 61966-2-1).
pub(super) fn srgb(linear: [f32; 3]) -> [f32; 3] {
    let one = |c: f32| {
        if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
    };
    linear.map(one)
}
