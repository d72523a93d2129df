//! Outliers of a column by the modified z-score: robust, as the outliers themselves move neither
//! median nor median deviation.
//!
//! Source: Iglewicz, B., Hoaglin, D. C., *How to Detect and Handle Outliers*, ASQC Quality Press,
//! 1993, section 3.3: scores above 3.5 in magnitude; where half of the values are equal, the mean
//! deviation takes the place of the median one.

/// Scores of greater magnitude are outliers.
pub const MAX_SCORE: f64 = 3.5;
/// Fewer values than these say nothing about what is usual.
pub const MIN_VALUES: usize = 5;
/// Median absolute deviation of a normal distribution, in standard deviations.
const MEDIAN_DEVIATION: f64 = 0.6745;
/// Standard deviation of a normal distribution, in mean absolute deviations.
const MEAN_DEVIATION: f64 = 1.253314;

/// Modified z-score of each value; `None` where there is no value, too few of them, or no spread.
pub fn scores(values: &[Option<f64>]) -> Vec<Option<f64>> {
    let known: Vec<f64> = values.iter().flatten().copied().filter(|v| v.is_finite()).collect();
    let none = vec![None; values.len()];
    if known.len() < MIN_VALUES {
        return none;
    }
    let middle = median(&known);
    let deviations: Vec<f64> = known.iter().map(|v| (v - middle).abs()).collect();
    let (mad, mean) = (median(&deviations), deviations.iter().sum::<f64>() / known.len() as f64);
    let unit = if mad > 0.0 { mad / MEDIAN_DEVIATION } else { MEAN_DEVIATION * mean };
    if unit <= 0.0 {
        return none;
    }
    let score = |v: &Option<f64>| v.filter(|v| v.is_finite()).map(|v| (v - middle) / unit);
    values.iter().map(score).collect()
}

/// Median; the mean of the two middle values of an even number.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let half = sorted.len() / 2;
    match sorted.len() {
        0 => f64::NAN,
        n if n % 2 == 0 => f64::midpoint(sorted[half - 1], sorted[half]),
        _ => sorted[half],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outliers(values: &[f64]) -> Vec<usize> {
        let some: Vec<Option<f64>> = values.iter().copied().map(Some).collect();
        let is_out = |s: &Option<f64>| s.is_some_and(|s| s.abs() > MAX_SCORE);
        scores(&some).iter().enumerate().filter(|(_, s)| is_out(s)).map(|(i, _)| i).collect()
    }

    #[test]
    fn a_value_far_from_the_median_is_an_outlier() {
        // The book's example of masking: two outliers hide each other from the standard deviation.
        let values = [2.1, 2.6, 2.4, 2.5, 2.3, 2.1, 2.3, 2.6, 8.2, 8.3];
        assert_eq!(outliers(&values), [8, 9]);
        let some: Vec<_> = values.iter().copied().map(Some).collect();
        let score = scores(&some)[8].unwrap();
        assert!((score - 0.6745 * (8.2 - 2.45) / 0.15).abs() < 1e-9, "{score}");
    }

    #[test]
    fn equal_values_have_no_outliers_and_one_other_is_one() {
        assert!(outliers(&[1.0; 9]).is_empty());
        assert_eq!(outliers(&[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 9.0]), [10]);
    }

    #[test]
    fn too_few_values_have_no_outliers() {
        assert!(outliers(&[1.0, 1.1, 0.9, 50.0]).is_empty());
        let gaps = [Some(1.0), None, Some(f64::NAN), Some(2.0), Some(3.0), Some(90.0)];
        assert!(scores(&gaps).iter().all(Option::is_none));
    }
}
