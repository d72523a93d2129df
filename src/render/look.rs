//! What the wall is made of and how it is lit.

/// Material and light. Colours are linear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Colour of the wall.
    pub tissue: [f32; 3],
    /// Light from everywhere.
    pub ambient: f32,
    /// Share scattered evenly.
    pub diffuse: f32,
    /// Strength of the highlight of a wet wall.
    pub specular: f32,
    /// Sharpness of the highlight, 16 or more.
    pub power: f32,
    /// Distance at which light is halved, mm; by default a multiple of the organ's mean radius.
    pub falloff_mm: Option<f32>,
    /// How strongly curvature shifts the colour; 0 leaves it out.
    pub relief: f32,
    /// Brightness before the tone curve.
    pub exposure: f32,
    /// Behind everything.
    pub background: [f32; 3],
}

impl Default for Look {
    /// Pink tissue under a head-light. Ambient, diffuse part and power are those of the endoscopy
    /// presets of clinical viewers; their highlight of 0.73 would lie as a white veil over every
    /// wall that faces a light this near.
    fn default() -> Self {
        Self {
            tissue: [0.76, 0.24, 0.175],
            ambient: 0.12,
            diffuse: 0.64,
            specular: 0.25,
            power: 50.0,
            falloff_mm: None,
            relief: 0.45,
            exposure: 2.3,
            background: [0.006, 0.007, 0.009],
        }
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
