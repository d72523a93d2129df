//! Rotation-minimising frames along a curve.

use glam::DVec3;

/// Tangent and a normal that does not turn about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurveFrame {
    /// Unit tangent.
    pub tangent: DVec3,
    /// Unit normal.
    pub normal: DVec3,
}

/// Frames by double reflection, Wang, Jüttler et al. 2008, doi:10.1145/1330511.1330513.
///
/// * `first_normal`: where the first normal should point; made orthogonal, or replaced if it
///   cannot be.
///
/// Duplicate points keep the frame before them (the reflection is undefined there).
pub fn frames(points: &[DVec3], tangents: &[DVec3], first_normal: DVec3) -> Vec<CurveFrame> {
    let Some(&t0) = tangents.first() else { return Vec::new() };
    let n0 = (first_normal - t0 * first_normal.dot(t0)).try_normalize();
    let mut at =
        CurveFrame { tangent: t0, normal: n0.unwrap_or_else(|| t0.any_orthonormal_vector()) };
    let mut out = vec![at];
    for i in 1..points.len() {
        let v1 = points[i] - points[i - 1];
        let c1 = v1.length_squared();
        let (mut n, mut t) = (at.normal, at.tangent);
        if c1 > 0.0 {
            n -= v1 * (2.0 / c1 * v1.dot(n));
            t -= v1 * (2.0 / c1 * v1.dot(t));
        }
        let v2 = tangents[i] - t;
        let c2 = v2.length_squared();
        if c2 > 1e-24 {
            n -= v2 * (2.0 / c2 * v2.dot(n));
        }
        let t = tangents[i];
        let n = (n - t * n.dot(t)).try_normalize().unwrap_or_else(|| t.any_orthonormal_vector());
        at = CurveFrame { tangent: t, normal: n };
        out.push(at);
    }
    out
}

/// Unit tangents of a polyline by central differences; a lone or repeated point looks along +z.
pub fn tangents(points: &[DVec3]) -> Vec<DVec3> {
    let n = points.len();
    let mut last = DVec3::Z;
    (0..n)
        .map(|i| {
            let d = points[(i + 1).min(n - 1)] - points[i.saturating_sub(1)];
            last = d.try_normalize().unwrap_or(last);
            last
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// The frame on a helix rotates relative to the Frenet frame by minus the integral of torsion.
    #[test]
    fn frames_on_a_helix_follow_the_closed_form() {
        let (r, pitch) = (10.0, 12.0);
        let c = pitch / TAU;
        let speed = f64::hypot(r, c);
        let torsion = c / (r * r + c * c);
        let turn = |u: f64| {
            let p = DVec3::new(r * u.cos(), r * u.sin(), c * u);
            let t = DVec3::new(-r * u.sin(), r * u.cos(), c) / speed;
            (p, t, DVec3::new(-u.cos(), -u.sin(), 0.0))
        };
        let n = 40; // ten samples a turn
        let all: Vec<_> = (0..=n).map(|i| turn(f64::from(i) * TAU / 10.0)).collect();
        let p: Vec<_> = all.iter().map(|a| a.0).collect();
        let t: Vec<_> = all.iter().map(|a| a.1).collect();
        let f = frames(&p, &t, all[0].2);
        let (_, tangent, frenet) = all[n as usize];
        let angle = -torsion * speed * TAU / 10.0 * f64::from(n);
        let b = tangent.cross(frenet);
        let want = frenet * angle.cos() + b * angle.sin();
        let off = f[n as usize].normal.angle_between(want).to_degrees();
        assert!(off < 0.2, "{off}");
    }

    #[test]
    fn straight_and_repeated_points_keep_the_frame() {
        let p = [DVec3::ZERO, DVec3::X, DVec3::X, 2.0 * DVec3::X];
        let f = frames(&p, &tangents(&p), DVec3::Y);
        assert!(f.iter().all(|f| f.normal == DVec3::Y && f.tangent == DVec3::X));
    }
}
