//! The threshold at which a wall is drawn, from the greatest value that its profile reaches.
//!
//! A plate of thickness w between two media, blurred by a Gaussian, reaches a peak that decreases
//! with w over σ, and so does the value at the plate's near face. Both follow from w/σ alone, so
//! that the face's value is a function of the peak, without σ. Half of the maximum, the usual
//! choice (full width at half maximum), is right for thick plates only; of thin ones it lies in the
//! lumen.
//!
//! Values are normalised: 0 the lumen's, 1 the wall's; `beyond` is the value beyond the plate.

/// Number of entries of the table: peaks of 0, 8, …, 4096.
pub(super) const ENTRIES: usize = 513;
/// Largest threshold as a share of the peak, so that the voxels at the crest of a sheet one voxel
/// thick stay wall.
const MAX_OF_PEAK: f64 = 0.75;

/// Returns the thresholds by peak, both of 4096.
///
/// * `beyond`: value beyond the wall.
/// * `least`: least threshold, so that noise of the lumen is not drawn.
pub(super) fn table(beyond: f64, least: f64) -> Vec<i32> {
    let entry = |i: usize| {
        let peak = i as f64 / (ENTRIES - 1) as f64;
        let t = face_value(peak, beyond).min(MAX_OF_PEAK * peak).max(least);
        (4096.0 * t).round() as i32
    };
    (0..ENTRIES).map(entry).collect()
}

/// Returns the value at the face of a plate whose profile has this peak.
fn face_value(peak: f64, beyond: f64) -> f64 {
    0.5 - upper_tail(width_of(peak, beyond)) * (1.0 - beyond)
}

/// Returns the thickness over σ of the plate whose profile has this peak: 1 − (2 − beyond) Q(w /
/// 2σ).
fn width_of(peak: f64, beyond: f64) -> f64 {
    let q = ((1.0 - peak) / (2.0 - beyond)).clamp(0.0, 0.5);
    if q > 0.0 { 2.0 * upper_quantile(q) } else { f64::INFINITY }
}

/// Returns the largest slope, times σ, of the profile with this peak, before the peak.
pub(super) fn greatest_slope(peak: f64, beyond: f64) -> f64 {
    let width = width_of(peak, beyond);
    let density = |x: f64| (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt();
    let slope = |i: i32| {
        let x = 0.05 * f64::from(i);
        density(x) - (1.0 - beyond) * density(x - width)
    };
    (-40..=10).map(slope).fold(0.0, f64::max)
}

/// Returns the upper tail of the normal distribution (Abramowitz & Stegun 1964, 7.1.26; within
/// 1e-7).
fn upper_tail(x: f64) -> f64 {
    if x.is_infinite() {
        return 0.0;
    }
    let z = x.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let series = t
        * (0.254_829_592
            + t * (-0.284_496_736
                + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let tail = 0.5 * series * (-z * z).exp();
    if x >= 0.0 { tail } else { 1.0 - tail }
}

/// Returns the point at which the upper tail has the value `q`, at most a half.
fn upper_quantile(q: f64) -> f64 {
    let (mut low, mut high) = (0.0, 10.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if upper_tail(middle) > q { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Peak and face of a plate of width `w` over σ, by numerical convolution.
    fn blurred_plate(width: f64, beyond: f64) -> (f64, f64) {
        let value = |x: f64| match x {
            x if x < 0.0 => 0.0,
            x if x < width => 1.0,
            _ => beyond,
        };
        let at = |x: f64| {
            let step = 0.002;
            let sum: f64 = (-3000..3000)
                .map(|i| f64::from(i) * step)
                .map(|u| value(x + u) * (-0.5 * u * u).exp())
                .sum();
            sum * step / (2.0 * std::f64::consts::PI).sqrt()
        };
        let peak = (0..400).map(|i| at(width * f64::from(i) / 400.0)).fold(0.0, f64::max);
        (peak, at(0.0))
    }

    #[test]
    fn face_value_is_that_of_a_numerically_blurred_plate() {
        for beyond in [0.0, 0.1, 1.0] {
            for width in [0.8, 1.2, 2.0, 3.0, 4.0] {
                let (peak, face) = blurred_plate(width, beyond);
                // The law puts the peak in the middle of the plate; with unequal sides it is beside it.
                let off = (face_value(peak, beyond) - face).abs();
                let most = if beyond == 0.1 { 0.006 } else { 0.003 };
                assert!(off < most, "{beyond} {width}: {off}");
            }
        }
    }

    #[test]
    fn thresholds_are_half_of_a_full_peak_and_rise_with_the_peak() {
        let table = table(0.1, 0.04);
        assert_eq!(table[ENTRIES - 1], 2048);
        assert!(table.windows(2).all(|w| w[0] <= w[1]));
        let capped = |i: usize| table[i] <= (0.75 * 8.0 * i as f64).round() as i32;
        assert!((30..ENTRIES).all(capped) && table[0] == 164);
    }
}
