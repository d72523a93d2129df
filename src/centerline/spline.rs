//! Least-squares cubic B-splines through noisy points.

use glam::DVec3;

/// A uniform cubic B-spline curve over parameters 0 to `spans`.
#[derive(Clone, Debug)]
pub struct Spline {
    control: Vec<DVec3>,
}

/// Basis values of the four control points that matter at fraction `t` of a span, and their
/// derivatives in the parameter.
fn basis(t: f64) -> ([f64; 4], [f64; 4]) {
    let s = 1.0 - t;
    let b = [
        s * s * s / 6.0,
        (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0,
        (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0,
        t * t * t / 6.0,
    ];
    let d =
        [-s * s / 2.0, (3.0 * t * t - 4.0 * t) / 2.0, (4.0 * s - 3.0 * s * s) / 2.0, t * t / 2.0];
    (b, d)
}

impl Spline {
    /// Fits points at ascending parameters in [0, spans]. The first and last point are
    /// interpolated (weight 10⁶ against 1); a trace of second-difference smoothing keeps spans
    /// without points determined.
    ///
    /// * `stiffness`: weight of squared third differences of neighbouring control points (a P-spline,
    ///   Eilers & Marx 1996, doi:10.1214/ss/1038425655), against 1 for all points of a mean span.
    ///   Parabolas cost nothing, so bends are not flattened as second differences would have them.
    ///
    /// # Panics
    /// With fewer than two points or spans < 1: the caller decides what a curve is.
    pub fn fit(points: &[DVec3], parameters: &[f64], spans: usize, stiffness: f64) -> Self {
        assert!(points.len() >= 2 && points.len() == parameters.len() && spans >= 1);
        let n = spans + 3;
        // Normal equations, symmetric with three bands above the diagonal.
        let mut a = vec![[0.0f64; 4]; n];
        let mut rhs = vec![DVec3::ZERO; n];
        let last = points.len() - 1;
        for (i, (p, u)) in points.iter().zip(parameters).enumerate() {
            let w = if i == 0 || i == last { 1e6 } else { 1.0 };
            let u = u.clamp(0.0, spans as f64);
            let s = (u.floor() as usize).min(spans - 1);
            let (b, _) = basis(u - s as f64);
            for r in 0..4 {
                for c in r..4 {
                    a[s + r][c - r] += w * b[r] * b[c];
                }
                rhs[s + r] += w * b[r] * *p;
            }
        }
        const TRACE: f64 = 1e-3;
        let stiffness = stiffness * points.len() as f64 / spans as f64;
        penalise(&mut a, [1.0, -2.0, 1.0], TRACE);
        penalise(&mut a, [-1.0, 3.0, -3.0, 1.0], stiffness);
        Self { control: solve(a, rhs) }
    }

    /// Number of spans.
    pub fn spans(&self) -> usize {
        self.control.len() - 3
    }

    /// Point and derivative at a parameter.
    pub fn at(&self, u: f64) -> (DVec3, DVec3) {
        let u = u.clamp(0.0, self.spans() as f64);
        let s = (u.floor() as usize).min(self.spans() - 1);
        let (b, d) = basis(u - s as f64);
        let c = &self.control[s..s + 4];
        let sum = |w: [f64; 4]| c.iter().zip(w).map(|(c, w)| *c * w).sum();
        (sum(b), sum(d))
    }
}

/// Adds a weighted sum of squared differences of control points to normal equations.
fn penalise<const N: usize>(a: &mut [[f64; 4]], difference: [f64; N], weight: f64) {
    for i in 0..a.len() + 1 - N {
        for r in 0..N {
            for c in r..N {
                a[i + r][c - r] += weight * difference[r] * difference[c];
            }
        }
    }
}

/// Cholesky factorisation and solution of a banded system.
fn solve(mut a: Vec<[f64; 4]>, mut x: Vec<DVec3>) -> Vec<DVec3> {
    let n = a.len();
    for i in 0..n {
        for k in 1..4.min(i + 1) {
            // Row i - k reaches i through its band k.
            let f = a[i - k][k];
            for j in 0..4 - k {
                let g = a[i - k][k + j];
                a[i][j] -= f * g;
            }
            let up = x[i - k];
            x[i] -= f * up;
        }
        let root = a[i][0].max(1e-12).sqrt();
        for v in &mut a[i] {
            *v /= root;
        }
        x[i] /= root;
    }
    for i in (0..n).rev() {
        let mut v = x[i];
        for k in 1..4.min(n - i) {
            v -= a[i][k] * x[i + k];
        }
        x[i] = v / a[i][0];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_is_reproduced_and_the_ends_are_met() {
        let f = |u: f64| DVec3::new(u, 0.1 * u * u * u - u * u, 3.0 - u);
        let u: Vec<f64> = (0..60).map(|i| f64::from(i) / 59.0 * 5.0).collect();
        let p: Vec<DVec3> = u.iter().map(|u| f(*u)).collect();
        let s = Spline::fit(&p, &u, 5, 0.0);
        for u in u {
            assert!(s.at(u).0.distance(f(u)) < 2e-2, "{u}");
        }
        assert!(s.at(0.0).0.distance(f(0.0)) < 1e-5 && s.at(5.0).0.distance(f(5.0)) < 1e-5);
        let (a, b) = (s.at(2.0).0, s.at(2.0 + 1e-6).0);
        assert!(((b - a) / 1e-6).distance(s.at(2.0).1) < 1e-4);
    }

    #[test]
    fn spline_stiffness_removes_noise_and_keeps_a_parabola() {
        let f = |u: f64| DVec3::new(u, 0.2 * u * u, 1.0);
        let u: Vec<f64> = (0..200).map(|i| f64::from(i) / 199.0 * 20.0).collect();
        let noise = |i: usize| DVec3::Z * if (i / 12).is_multiple_of(2) { 0.1 } else { -0.1 };
        let clean: Vec<DVec3> = u.iter().map(|u| f(*u)).collect();
        let noisy: Vec<DVec3> = clean.iter().enumerate().map(|(i, p)| *p + noise(i)).collect();
        let worst = |points: &[DVec3], stiffness: f64| {
            let s = Spline::fit(points, &u, 20, stiffness);
            let off = u.iter().skip(20).take(160).map(|u| s.at(*u).0.distance(f(*u)));
            off.fold(0.0, f64::max)
        };
        assert!(worst(&clean, 10.0) < 1e-2, "{}", worst(&clean, 10.0));
        let (loose, stiff) = (worst(&noisy, 0.0), worst(&noisy, 0.3));
        assert!(stiff < 0.3 * loose, "{stiff} and {loose}");
    }

    #[test]
    fn two_points_make_a_straight_line() {
        let p = [DVec3::ZERO, DVec3::new(4.0, 2.0, 0.0)];
        let s = Spline::fit(&p, &[0.0, 1.0], 1, 0.0);
        assert!(s.at(0.5).0.distance(DVec3::new(2.0, 1.0, 0.0)) < 1e-6);
    }
}
