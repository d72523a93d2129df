//! The one comparer of device results.

use intima::compute::Tolerance;

/// Worst element of a comparison that failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("element {at}: wanted {want}, got {got} ({used:.3} of the tolerance, {bad} of {of} fail)")]
pub struct Mismatch {
    /// Index of the worst element.
    pub at: usize,
    /// Reference value.
    pub want: f32,
    /// Value under test.
    pub got: f32,
    /// Error as a multiple of the tolerance.
    pub used: f32,
    /// Number of elements that fail.
    pub bad: usize,
    /// Number of elements compared.
    pub of: usize,
}

/// Compares `got` with `want`; returns the largest share of the tolerance used.
///
/// # Errors
/// [`Mismatch`] for the worst element when any is outside the tolerance, when lengths differ, or
/// when a value is NaN on one side alone; a wanted NaN must come back as NaN.
pub fn worst(want: &[f32], got: &[f32], tol: Tolerance) -> Result<f32, Mismatch> {
    let mut worst = Mismatch { at: 0, want: 0.0, got: 0.0, used: 0.0, bad: 0, of: want.len() };
    if want.len() != got.len() {
        return Err(Mismatch { at: want.len().min(got.len()), used: f32::INFINITY, ..worst });
    }
    for (at, (&w, &g)) in want.iter().zip(got).enumerate() {
        let used = if w == g || (w.is_nan() && g.is_nan()) {
            0.0
        } else {
            let u = (w - g).abs() / (tol.abs + tol.rel * w.abs());
            if u.is_nan() { f32::INFINITY } else { u }
        };
        worst.bad += usize::from(used > 1.0);
        if used > worst.used {
            worst = Mismatch { at, want: w, got: g, used, ..worst };
        }
    }
    if worst.bad > 0 { Err(worst) } else { Ok(worst.used) }
}

#[test]
fn the_comparer_can_fail() {
    let tol = Tolerance { abs: 1e-3, rel: 1e-4 };
    let want = [1.0, f32::INFINITY, 3.0];
    assert!(worst(&want, &want, tol).is_ok());
    for (i, bad) in [(0, f32::NAN), (1, 1.0), (2, 3.01)] {
        let mut got = want;
        got[i] = bad;
        assert_eq!(worst(&want, &got, tol).unwrap_err().at, i);
    }
    assert!(worst(&want, &want[..2], tol).is_err());
}

#[test]
fn a_later_good_value_does_not_hide_a_nan() {
    let tol = Tolerance { abs: 1.0, rel: 0.0 };
    assert!(worst(&[0.0, 0.0], &[f32::NAN, 0.5], tol).is_err());
}
