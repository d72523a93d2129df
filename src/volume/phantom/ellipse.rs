//! Exact distance to an ellipse.

/// Returns the signed distance to an ellipse with semi-axes `wide >= thin` for a point of the first
/// quadrant.
pub(super) fn distance(wide: f64, thin: f64, x: f64, y: f64) -> f64 {
    let (zx, zy) = (x / wide, y / thin);
    let level = zx * zx + zy * zy - 1.0;
    let ratio = (wide / thin) * (wide / thin);
    // The foot is (ratio x / (w + ratio - 1), y / w) for the largest root w of a function that is
    // convex and falls; from the left Newton's steps never pass the root.
    let mut w = zy.max(ratio * (zx - 1.0) + 1.0);
    for _ in 0..200 {
        let (u, v) = (ratio * zx / (w + ratio - 1.0), if zy > 0.0 { zy / w } else { 0.0 });
        let curve = if zy > 0.0 { v * v / w } else { 0.0 };
        let step = (u * u + v * v - 1.0) / (2.0 * (u * u / (w + ratio - 1.0) + curve));
        if step.is_nan() || step <= 1e-15 * w {
            break;
        }
        w += step;
    }
    let (fx, fy) = if zy > 0.0 {
        (ratio * x / (w + ratio - 1.0), y / w)
    } else if x * wide < wide * wide - thin * thin {
        // On the wide axis, between the centres of curvature of the tips, the nearest point is off
        // that axis.
        let c = x * wide / (wide * wide - thin * thin);
        (wide * c, thin * (1.0 - c * c).sqrt())
    } else {
        (wide, 0.0)
    };
    (x - fx).hypot(y - fy).copysign(level)
}
