//! Nearest point on a triangle and on a segment.

use glam::DVec3;

/// Computes the squared distance from `p` to the triangle and the barycentric weights of the
/// nearest point, by the Voronoi regions of its corners and edges (Ericson 2005, Real-Time
/// Collision Detection, 5.1.5). A triangle without area counts as its sides.
#[inline]
pub fn nearest_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> (f64, DVec3) {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let longest2 = ab.length_squared().max(ac.length_squared());
    if ab.cross(ac).length_squared() <= 1e-24 * longest2 * longest2 {
        return nearest_on_sides(p, [a, b, c]);
    }
    let weights = 'found: {
        let (d1, d2) = (ab.dot(ap), ac.dot(ap));
        if d1 <= 0.0 && d2 <= 0.0 {
            break 'found DVec3::X;
        }
        let bp = p - b;
        let (d3, d4) = (ab.dot(bp), ac.dot(bp));
        if d3 >= 0.0 && d4 <= d3 {
            break 'found DVec3::Y;
        }
        let cp = p - c;
        let (d5, d6) = (ab.dot(cp), ac.dot(cp));
        if d6 >= 0.0 && d5 <= d6 {
            break 'found DVec3::Z;
        }
        let vc = d1 * d4 - d3 * d2;
        if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            let t = d1 / (d1 - d3);
            break 'found DVec3::new(1.0 - t, t, 0.0);
        }
        let vb = d5 * d2 - d1 * d6;
        if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            let t = d2 / (d2 - d6);
            break 'found DVec3::new(1.0 - t, 0.0, t);
        }
        let va = d3 * d6 - d5 * d4;
        if va <= 0.0 && d4 >= d3 && d5 >= d6 {
            let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
            break 'found DVec3::new(0.0, 1.0 - t, t);
        }
        let sum = va + vb + vc;
        DVec3::new(va / sum, vb / sum, vc / sum)
    };
    let on = a * weights.x + b * weights.y + c * weights.z;
    (p.distance_squared(on), weights)
}

/// Returns the squared distance and weights for a triangle without area: the nearest point on its
/// sides.
fn nearest_on_sides(p: DVec3, corners: [DVec3; 3]) -> (f64, DVec3) {
    let mut best = (f64::INFINITY, DVec3::X);
    for i in 0..3 {
        let j = (i + 1) % 3;
        let (a, b) = (corners[i], corners[j]);
        let t = share_of_segment(p, a, b);
        let d2 = p.distance_squared(a + t * (b - a));
        if d2 < best.0 {
            best = (d2, DVec3::AXES[i] * (1.0 - t) + DVec3::AXES[j] * t);
        }
    }
    best
}

/// Computes the distance from `p` to the triangle, in the unit of the points.
#[inline]
pub fn point_triangle_distance(p: DVec3, triangle: [DVec3; 3]) -> f64 {
    nearest_on_triangle(p, triangle).0.sqrt()
}

/// Computes the nearest point of the segment from `a` to `b`.
#[inline]
pub fn nearest_on_segment(p: DVec3, a: DVec3, b: DVec3) -> DVec3 {
    a + share_of_segment(p, a, b) * (b - a)
}

/// Computes the share of the segment before its nearest point; 0 on a segment without length.
#[inline]
fn share_of_segment(p: DVec3, a: DVec3, b: DVec3) -> f64 {
    let along = b - a;
    let length2 = along.length_squared();
    if length2 > 0.0 { (along.dot(p - a) / length2).clamp(0.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers from −1 to 1 that look random.
    fn noise(seed: &mut u64) -> f64 {
        *seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (*seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn point(seed: &mut u64) -> DVec3 {
        DVec3::new(noise(seed), noise(seed), noise(seed))
    }

    #[test]
    fn no_point_of_a_fine_grid_on_the_triangle_is_nearer() {
        let mut seed = 3;
        for _ in 0..300 {
            let t = [point(&mut seed), point(&mut seed), point(&mut seed)];
            let p = 2.0 * point(&mut seed);
            let got = nearest_on_triangle(p, t).0;
            for i in 0..=20 {
                for j in 0..=20 - i {
                    let (u, v) = (f64::from(i) / 20.0, f64::from(j) / 20.0);
                    let q = t[0] * (1.0 - u - v) + t[1] * u + t[2] * v;
                    assert!(got <= p.distance_squared(q) + 1e-12);
                }
            }
        }
    }

    #[test]
    fn triangles_without_area_give_finite_weights_and_the_distance_to_their_sides() {
        let (a, b) = (DVec3::ZERO, DVec3::X);
        for t in [[a, a, a], [a, b, b], [a, a, b], [a, b, a], [a, b, 0.5 * b], [a, 0.5 * b, b]] {
            let (d2, w) = nearest_on_triangle(DVec3::new(0.25, 2.0, 0.0), t);
            assert!(w.is_finite() && (4.0..4.1).contains(&d2), "{t:?}: {d2} {w}");
        }
    }
    #[test]
    fn corners_edges_and_faces_are_at_their_known_distances() {
        let t = [DVec3::ZERO, DVec3::new(4.0, 0.0, 0.0), DVec3::new(0.0, 3.0, 0.0)];
        let near = |x, y, z| {
            let (d2, w) = nearest_on_triangle(DVec3::new(x, y, z), t);
            (d2, t[0] * w.x + t[1] * w.y + t[2] * w.z)
        };
        assert_eq!(near(1.0, 0.75, 2.0), (4.0, DVec3::new(1.0, 0.75, 0.0)));
        assert_eq!(near(-3.0, -4.0, 0.0), (25.0, t[0]));
        assert_eq!(near(7.0, 0.0, 4.0), (25.0, t[1]));
        assert_eq!(near(0.0, 6.0, 4.0), (25.0, t[2]));
        assert_eq!(near(2.0, -1.0, 0.0), (1.0, DVec3::new(2.0, 0.0, 0.0)));
        assert_eq!(near(-2.0, 1.5, 0.0), (4.0, DVec3::new(0.0, 1.5, 0.0)));
        assert!((point_triangle_distance(DVec3::new(4.0, 3.0, 0.0), t) - 2.4).abs() < 1e-12);
        assert_eq!(point_triangle_distance(DVec3::Z, [DVec3::ZERO, DVec3::X, DVec3::X]), 1.0);
        assert_eq!(point_triangle_distance(DVec3::Z, [DVec3::ZERO; 3]), 1.0);
        assert_eq!(nearest_on_segment(DVec3::Y, DVec3::X, DVec3::X), DVec3::X);
    }
}
