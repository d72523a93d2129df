//! Sub-voxel crossings interpolated from intensities.

use glam::IVec3;

use super::extract::{Crossing, clamp_fraction};
use crate::lumen::{GreyValues, IntensitySelection, Lumen};

/// Crossings of the two-sided threshold function f = max(LO − v, v − HI), negative inside, by
/// linear interpolation between voxel centres.
///
/// Signs follow the final mask: where f disagrees with it (filled cavities, neighbours in the
/// selection but not in the component) f is clamped to 0, on the mask's side. Integer thresholds
/// lie half a stored unit outside the inclusive bounds, so that f is never 0 on a sample.
pub struct Grey<'a> {
    lumen: &'a Lumen,
    values: GreyValues<'a>,
    lo: f64,
    hi: f64,
}

impl<'a> Grey<'a> {
    /// Prepares crossings for a range of intensities; `None` for labels, between which nothing is
    /// interpolated.
    pub fn new(
        lumen: &'a Lumen,
        values: GreyValues<'a>,
        selection: &IntensitySelection,
    ) -> Option<Self> {
        let IntensitySelection::Range { lo, hi } = *selection else { return None };
        let half = if values.is_integer() { 0.5 * values.rescale().slope.abs() } else { 0.0 };
        Some(Self { lumen, values, lo: lo - half, hi: hi + half })
    }

    fn value(&self, v: IVec3) -> Option<f64> {
        self.lumen.is_in_volume(v).then(|| {
            let real = self.values.real(self.lumen.volume_voxel(v).as_uvec3());
            (self.lo - real).max(real - self.hi)
        })
    }
}

impl Crossing for Grey<'_> {
    fn fraction(&self, inside: IVec3, outside: IVec3) -> f32 {
        let Some(a) = self.value(inside) else { return 0.5 };
        let Some(b) = self.value(outside) else { return 0.5 }; // the volume's edge
        let (a, b) = (a.min(0.0), b.max(0.0));
        clamp_fraction((a / (a - b)) as f32)
    }
}
