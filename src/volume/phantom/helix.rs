//! A helix and the distance to it.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::DVec3;

/// A helix about z, centred at the origin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Helix {
    pub radius: f64,
    pub turns: f64,
    pub height: f64,
}

impl Helix {
    fn rise(&self) -> f64 {
        self.height / (TAU * self.turns)
    }

    /// Returns the length of the curve.
    pub fn length(&self) -> f64 {
        TAU * self.turns * self.radius.hypot(self.rise())
    }

    /// Returns the point at a fraction of the length.
    pub fn at(&self, fraction: f64) -> DVec3 {
        self.at_angle(fraction * TAU * self.turns)
    }

    fn at_angle(&self, t: f64) -> DVec3 {
        let (sin, cos) = t.sin_cos();
        let z = self.rise() * t - 0.5 * self.height;
        DVec3::new(self.radius * cos, self.radius * sin, z)
    }

    /// Returns the distance to the curve. Near the z axis, where windings are almost equally
    /// distant, it is accurate to one part in a hundred.
    pub fn distance(&self, p: DVec3) -> f64 {
        let (end, k) = (TAU * self.turns, self.rise());
        let phase = p.y.atan2(p.x);
        let reach = p.x.hypot(p.y) * self.radius;
        let level = (p.z + 0.5 * self.height) / k;
        let winding = ((level - phase) / TAU).round();
        let ends = p.distance(self.at_angle(0.0)).min(p.distance(self.at_angle(end)));
        [winding - 1.0, winding, winding + 1.0].into_iter().fold(ends, |best, n| {
            let near = phase + TAU * n;
            let mut t = near;
            // Newton on the derivative of the squared distance, within the quarter turns where it
            // is convex.
            for _ in 0..8 {
                let slope = reach * (t - near).sin() + k * k * (t - level);
                let bend = reach * (t - near).cos().max(0.0) + k * k;
                let next = (t - slope / bend).clamp(near - FRAC_PI_2, near + FRAC_PI_2);
                if (next - t).abs() < 1e-14 {
                    break;
                }
                t = next;
            }
            best.min(p.distance(self.at_angle(t.clamp(0.0, end))))
        })
    }
}
