//! Tubes about skeletons: the path, the camera's frustum, the eye.

use glam::Vec3;

use crate::geometry::Vertex;

/// Triangles of tubes; the radius is added when they are drawn.
#[derive(Default)]
pub(super) struct Tubes {
    pub vertices: Vec<Vertex>,
    pub indices: Vec<u32>,
}

const SIDES: u32 = 8;
/// Length behind and in total for the lines of a camera, none of which lies ahead.
const ALL: (f32, f32) = (0.0, f32::INFINITY);

fn length(points: &[Vec3]) -> f32 {
    points.windows(2).map(|w| w[0].distance(w[1])).sum()
}

impl Tubes {
    /// Tubes along polylines; each vertex carries the share of all their length behind it.
    pub fn along(lines: &[Vec<Vec3>]) -> Self {
        let mut tubes = Self::default();
        let total: f32 = lines.iter().map(|l| length(l)).sum();
        let mut behind = 0.0;
        for line in lines {
            tubes.add(line, (behind, total));
            behind += length(line);
        }
        tubes
    }

    /// Builds the frustum of a camera at the origin that looks along -z, one unit deep and from -1
    /// to 1 at its base, with a tick that shows which way is up.
    pub fn frustum() -> Self {
        let base = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let corner = |i: usize| Vec3::new(base[i % 4].0, base[i % 4].1, -1.0);
        let mut tubes = Self::default();
        for i in 0..4 {
            tubes.add(&[Vec3::ZERO, corner(i)], ALL);
            tubes.add(&[corner(i), corner(i + 1)], ALL);
        }
        let tip = Vec3::new(0.0, 1.5, -1.0);
        tubes.add(&[Vec3::new(-0.4, 1.0, -1.0), tip], ALL);
        tubes.add(&[tip, Vec3::new(0.4, 1.0, -1.0)], ALL);
        tubes
    }

    /// Builds a ball whose skeleton is one point.
    pub fn ball() -> Self {
        const RINGS: u32 = 8;
        const SLICES: u32 = 12;
        let mut tubes = Self::default();
        for ring in 0..=RINGS {
            let a = std::f32::consts::PI * ring as f32 / RINGS as f32;
            for slice in 0..SLICES {
                let b = std::f32::consts::TAU * slice as f32 / SLICES as f32;
                let n = Vec3::new(a.sin() * b.cos(), a.sin() * b.sin(), a.cos());
                tubes.vertices.push(Vertex::new(Vec3::ZERO, n, 0.0));
            }
        }
        for ring in 0..RINGS {
            tubes.band(ring * SLICES, (ring + 1) * SLICES, SLICES);
        }
        tubes
    }

    /// Adds a tube along points.
    ///
    /// * `behind`, `total`: length before the first point, and of all lines.
    fn add(&mut self, points: &[Vec3], (behind, total): (f32, f32)) {
        let mut points = points.to_vec();
        points.dedup_by(|a, b| a.distance_squared(*b) < 1e-12);
        if points.len() < 2 {
            return;
        }
        let direction = |i: usize| {
            let (a, b) = (i.saturating_sub(1), (i + 1).min(points.len() - 1));
            (points[b] - points[a]).try_normalize()
        };
        let mut tangent = direction(0).unwrap_or(Vec3::Z);
        let mut side = tangent.any_orthonormal_vector();
        let mut length = behind;
        let first = self.vertices.len() as u32;
        for i in 0..points.len() {
            if i > 0 {
                length += points[i].distance(points[i - 1]);
            }
            tangent = direction(i).unwrap_or(tangent);
            // Carried along, so that the ring does not turn about the tube.
            side = (side - side.dot(tangent) * tangent)
                .try_normalize()
                .unwrap_or_else(|| tangent.any_orthonormal_vector());
            let up = tangent.cross(side);
            for k in 0..SIDES {
                let a = std::f32::consts::TAU * k as f32 / SIDES as f32;
                let n = a.cos() * side + a.sin() * up;
                self.vertices.push(Vertex::new(points[i], n, length / total));
            }
            if i > 0 {
                let ring = first + i as u32 * SIDES;
                self.band(ring - SIDES, ring, SIDES);
            }
        }
    }

    /// Adds two triangles between each pair of neighbours on two rings of `n`.
    fn band(&mut self, a: u32, b: u32, n: u32) {
        for k in 0..n {
            let l = (k + 1) % n;
            self.indices.extend([a + k, a + l, b + k, b + k, a + l, b + l]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_of_equal_points_draws_nothing_and_a_bent_one_counts_its_length() {
        assert!(Tubes::along(&[vec![Vec3::ONE; 5]]).indices.is_empty());
        assert!(Tubes::along(&[]).indices.is_empty());
        let bent = vec![Vec3::ZERO, Vec3::X, Vec3::X, Vec3::new(1.0, 3.0, 0.0)];
        let t = Tubes::along(std::slice::from_ref(&bent));
        assert_eq!(t.vertices.len(), 3 * SIDES as usize);
        let share = Vertex::w;
        assert!((share(&t.vertices[SIDES as usize]) - 0.25).abs() < 1e-4);
        assert!((share(t.vertices.last().unwrap()) - 1.0).abs() < 1e-4);
        assert!(t.indices.iter().all(|i| (*i as usize) < t.vertices.len()));
        // A second piece, as long, begins at half of the length; nothing joins the two.
        let two = Tubes::along(&[bent.clone(), bent.iter().map(|p| p + 9.0 * Vec3::Z).collect()]);
        let second = 3 * SIDES;
        assert!((share(&two.vertices[second as usize]) - 0.5).abs() < 1e-4);
        let joined = |t: &[u32]| t.iter().any(|i| *i < second) && t.iter().any(|i| *i >= second);
        assert!(!two.indices.chunks_exact(3).any(joined));
    }
}
