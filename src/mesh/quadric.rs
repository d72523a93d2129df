//! Quadric error: weighted sums of squared distances to planes.

use glam::{DMat3, DVec3};

/// Regularization of [`Quadric::step_to_minimum`]: share of the trace added to the diagonal, so that a
/// vertex does not move in directions its planes do not determine (within a flat, along a ridge).
const STIFFNESS: f64 = 1e-3;

/// Σ wᵢ (nᵢ·x + dᵢ)², as the ten numbers of its symmetric 4 × 4 matrix (Garland and Heckbert
/// 1997, doi:10.1145/258734.258849), mixed terms doubled, and Σ wᵢ.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quadric {
    xx: f64,
    yy: f64,
    zz: f64,
    xy: f64,
    xz: f64,
    yz: f64,
    x: f64,
    y: f64,
    z: f64,
    one: f64,
    /// Sum of the weights.
    pub weight: f64,
}

impl Quadric {
    /// The plane through `p` with unit normal `n`.
    #[inline]
    pub fn plane(n: DVec3, p: DVec3, weight: f64) -> Self {
        let (w, d) = (weight * n, -n.dot(p));
        Self {
            xx: w.x * n.x,
            yy: w.y * n.y,
            zz: w.z * n.z,
            xy: 2.0 * w.x * n.y,
            xz: 2.0 * w.x * n.z,
            yz: 2.0 * w.y * n.z,
            x: 2.0 * w.x * d,
            y: 2.0 * w.y * d,
            z: 2.0 * w.z * d,
            one: weight * d * d,
            weight,
        }
    }

    /// Multiplies the weights of all planes by `factor`.
    pub fn times(self, factor: f64) -> Self {
        Self {
            xx: factor * self.xx,
            yy: factor * self.yy,
            zz: factor * self.zz,
            xy: factor * self.xy,
            xz: factor * self.xz,
            yz: factor * self.yz,
            x: factor * self.x,
            y: factor * self.y,
            z: factor * self.z,
            one: factor * self.one,
            weight: factor * self.weight,
        }
    }

    /// Weighted sum of squared distances of `p`, never below 0.
    #[inline]
    pub fn at(&self, p: DVec3) -> f64 {
        self.sum(p).max(0.0)
    }

    /// Weighted sum of squared distances of `p` without the clamp of [`Self::at`]: rounding may
    /// take it below 0.
    #[inline]
    pub fn sum(&self, p: DVec3) -> f64 {
        let x = p.x * (self.xx * p.x + self.xy * p.y + self.xz * p.z + self.x);
        let y = p.y * (self.yy * p.y + self.yz * p.z + self.y);
        let z = p.z * (self.zz * p.z + self.z);
        (x + y) + (z + self.one)
    }

    /// Half the gradient at `p`, and the 3 × 3 matrix as columns: the sum falls along
    /// −matrix⁻¹ · gradient.
    pub fn slope(&self, p: DVec3) -> (DVec3, DMat3) {
        let (xy, xz, yz) = (0.5 * self.xy, 0.5 * self.xz, 0.5 * self.yz);
        let m = DMat3::from_cols(
            DVec3::new(self.xx, xy, xz),
            DVec3::new(xy, self.yy, yz),
            DVec3::new(xz, yz, self.zz),
        );
        (m * p + 0.5 * DVec3::new(self.x, self.y, self.z), m)
    }

    /// Step from `p` to the minimum, at most `longest`, in the unit of the points. `None` without
    /// planes.
    pub fn step_to_minimum(&self, p: DVec3, longest: f64) -> Option<DVec3> {
        let (slope, m) = self.slope(p);
        let trace = m.x_axis.x + m.y_axis.y + m.z_axis.z;
        if trace.is_nan() || trace <= 0.0 {
            return None;
        }
        let held = m + DMat3::from_diagonal(DVec3::splat(STIFFNESS * trace));
        Some((held.inverse() * -slope).clamp_length_max(longest))
    }
}

impl std::ops::AddAssign for Quadric {
    #[inline]
    fn add_assign(&mut self, o: Self) {
        self.xx += o.xx;
        self.yy += o.yy;
        self.zz += o.zz;
        self.xy += o.xy;
        self.xz += o.xz;
        self.yz += o.yz;
        self.x += o.x;
        self.y += o.y;
        self.z += o.z;
        self.one += o.one;
        self.weight += o.weight;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quadric_is_the_sum_of_squared_plane_distances() {
        let mut seed = 1u64;
        let mut noise = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        };
        for planes in [1, 2, 3, 10, 50] {
            let mut point = || DVec3::new(noise(), noise(), noise());
            let list: Vec<_> = (0..planes)
                .map(|i| (point().normalize(), point(), 0.1 + f64::from(i % 7)))
                .collect();
            let mut q = Quadric::default();
            for &(n, p, w) in &list {
                q += Quadric::plane(n, p, w);
            }
            for _ in 0..20 {
                let x = point();
                let want: f64 = list.iter().map(|(n, p, w)| w * n.dot(x - *p).powi(2)).sum();
                let got = q.at(x);
                assert!((got - want).abs() <= 1e-9 * want.max(1e-6), "{got} {want}");
                let (slope, m) = q.slope(x);
                let grad: DVec3 = list.iter().map(|(n, p, w)| *n * (w * n.dot(x - *p))).sum();
                assert!((slope - grad).length() <= 1e-9 * grad.length().max(1e-6));
                let curve: f64 = list.iter().map(|(n, _, w)| w * n.dot(x).powi(2)).sum();
                assert!((x.dot(m * x) - curve).abs() <= 1e-9 * curve);
            }
            let weight: f64 = list.iter().map(|l| l.2).sum();
            assert!((q.weight - weight).abs() < 1e-9);
        }
    }
}
