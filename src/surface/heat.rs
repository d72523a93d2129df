//! Diffusion on a graph by a truncated Chebyshev series of the heat kernel.

/// Returns the coefficients of exp(−a (1 − S)) in Chebyshev polynomials of S: (2 − δ) e^−a I_k(a),
/// by downward (Miller) recurrence from where they vanish.
pub fn series(a: f64, count: usize) -> Vec<f64> {
    let from = 3 * terms(a, 1.0 / 15.0) + 20;
    let (mut above, mut here) = (0.0, 1e-280);
    let mut all = vec![0.0; from + 1];
    for k in (0..=from).rev() {
        all[k] = here;
        (above, here) = (here, above + 2.0 * k as f64 / a * here);
    }
    let sum = all[0] + 2.0 * all[1..].iter().sum::<f64>();
    (0..count)
        .map(|k| all.get(k).map_or(0.0, |i| if k == 0 { i / sum } else { 2.0 * i / sum }))
        .collect()
}

/// Returns the number of terms for which the truncation error is less than `cut` in every mode.
pub fn terms(a: f64, cut: f64) -> usize {
    (2.0 * a * -cut.ln()).sqrt().ceil() as usize + 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn truncated_heat_series_errs_by_less_than_its_bound() {
        for a in [0.5, 4.0, 64.0, 256.0, 4096.0] {
            for (count, most) in [
                (3 * terms(a, 1.0 / 15.0) + 20, 1e-9),
                (terms(a, 1.0 / 15.0), 1.0 / 15.0),
                (terms(a, 0.01), 0.01),
            ] {
                let c = series(a, count);
                for i in 0..=200 {
                    let s: f64 = -1.0 + f64::from(i) / 100.0;
                    let angle = s.acos();
                    let term = |(k, c): (usize, &f64)| c * (k as f64 * angle).cos();
                    let sum: f64 = c.iter().enumerate().map(term).sum();
                    let off = (sum - (-a * (1.0 - s)).exp()).abs();
                    assert!(off < most, "{a}, {count} terms, {s}: off by {off}");
                }
            }
        }
    }
}
