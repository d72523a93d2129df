//! The branching phantom: capsules joined at their ends.

use glam::DVec3;

/// A capsule of the tree.
#[derive(Clone, Copy, Debug)]
pub(super) struct Capsule {
    pub name: &'static str,
    pub parent: Option<usize>,
    pub a: DVec3,
    pub b: DVec3,
    pub radius: f64,
}

impl Capsule {
    /// Returns the signed distance to the capsule's wall.
    pub fn distance(&self, p: DVec3) -> f64 {
        let d = self.b - self.a;
        let t = ((p - self.a).dot(d) / d.length_squared()).clamp(0.0, 1.0);
        p.distance(self.a + t * d) - self.radius
    }
}

/// Returns the capsules: trunk, two branches, four twigs.
pub(super) fn tree() -> Vec<Capsule> {
    let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let (fork, left, right) = (at(0.02, 0.01, -0.08), at(-0.2, 0.03, 0.13), at(0.22, -0.04, 0.11));
    let s = |name, parent, a, b, radius| Capsule { name, parent, a, b, radius };
    vec![
        s("trunk", None, at(-0.01, 0.0, -0.37), fork, 0.075),
        s("left", Some(0), fork, left, 0.056),
        s("right", Some(0), fork, right, 0.056),
        s("left-a", Some(1), left, at(-0.36, -0.1, 0.38), 0.042),
        s("left-b", Some(1), left, at(-0.14, 0.23, 0.39), 0.042),
        s("right-a", Some(2), right, at(0.15, -0.27, 0.38), 0.042),
        s("right-b", Some(2), right, at(0.37, 0.11, 0.37), 0.042),
    ]
}
