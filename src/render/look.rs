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
    /// Sharpness of the highlight.
    pub power: f32,
    /// Distance at which light is halved, mm; by default a multiple of the organ's mean radius.
    pub falloff_mm: Option<f32>,
    /// How strongly curvature shifts the colour; 0 leaves it out.
    pub relief: f32,
    /// Brightness before the tone curve `1 - exp(-x)`.
    pub exposure: f32,
    /// Behind everything.
    pub background: [f32; 3],
}

impl Default for Look {
    /// Pink tissue under a head-light: the ratios that endoscopy presets of clinical viewers use,
    /// with a lower ambient part and highlight, because light here falls off with distance.
    fn default() -> Self {
        Self {
            tissue: [0.72, 0.27, 0.21],
            ambient: 0.12,
            diffuse: 0.64,
            specular: 0.73,
            power: 50.0,
            falloff_mm: None,
            relief: 0.5,
            exposure: 2.2,
            background: [0.006, 0.007, 0.009],
        }
    }
}

/// Light is halved after this many mean radii, unless [`Look::falloff_mm`] says otherwise.
pub(super) const FALLOFF_RADII: f32 = 3.0;
/// How far beside the eye the light sits, in mean radii.
pub(super) const LIGHT_RADII: f32 = 0.2;
