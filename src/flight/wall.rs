//! Exact distance to the wall: triangles in a uniform grid of buckets.

use glam::{DVec3, IVec3};

use crate::geometry::{Mesh, nearest_on_triangle};

/// Largest number of buckets: 2^22 starts are 16 MiB. There are also no more than triangles: most
/// of a wall's box is empty, and a flight asks some hundred times.
const MAX_BUCKETS: usize = 1 << 22;

/// Triangles of a wall in a grid, for queries by position.
#[derive(Clone, Debug)]
pub struct WallIndex {
    lo: DVec3,
    side_mm: f64,
    dims: IVec3,
    starts: Vec<u32>,
    faces: Vec<u32>,
    corners: Vec<[glam::Vec3; 3]>,
}

impl WallIndex {
    /// Sorts the triangles of a mesh (LPS mm) into buckets two edges wide or more. Triangles with a
    /// vertex that is not finite are left out.
    pub fn new(mesh: &Mesh) -> Self {
        let corners: Vec<[glam::Vec3; 3]> = mesh
            .faces
            .iter()
            .map(|f| f.map(|v| mesh.positions[v as usize]))
            .filter(|t| t.iter().all(|p| p.is_finite()))
            .collect();
        let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let mut edges = 0.0;
        for t in &corners {
            edges += f64::from(t[0].distance(t[1]));
            for p in t {
                lo = lo.min(p.as_dvec3());
                hi = hi.max(p.as_dvec3());
            }
        }
        if corners.is_empty() {
            (lo, hi) = (DVec3::ZERO, DVec3::ZERO);
        }
        let size = hi - lo;
        let mut side_mm = (2.0 * edges / corners.len().max(1) as f64).max(1e-3);
        let count = |side: f64| (size / side).floor() + 1.0;
        let most = corners.len().clamp(64, MAX_BUCKETS) as f64;
        while count(side_mm).element_product() > most {
            side_mm *= 1.25;
        }
        let dims = count(side_mm).as_ivec3();
        let mut index = Self {
            lo,
            side_mm,
            dims,
            starts: vec![0; dims.as_usizevec3().element_product() + 1],
            faces: Vec::new(),
            corners,
        };
        index.fill();
        index
    }

    /// Fills the buckets by counting sort: each bucket's triangles are contiguous, ascending.
    fn fill(&mut self) {
        let boxes: Vec<(IVec3, IVec3)> = self
            .corners
            .iter()
            .map(|t| {
                let lo = t[0].min(t[1]).min(t[2]).as_dvec3();
                let hi = t[0].max(t[1]).max(t[2]).as_dvec3();
                (self.bucket(lo), self.bucket(hi))
            })
            .collect();
        let mut starts = std::mem::take(&mut self.starts);
        let dims = self.dims;
        let each = |(lo, hi): &(IVec3, IVec3), visit: &mut dyn FnMut(usize)| {
            for z in lo.z..=hi.z {
                for y in lo.y..=hi.y {
                    (lo.x..=hi.x).for_each(|x| visit(slot(dims, IVec3::new(x, y, z))));
                }
            }
        };
        boxes.iter().for_each(|b| each(b, &mut |s| starts[s + 1] += 1));
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        self.faces = vec![0; starts[starts.len() - 1] as usize];
        for (i, b) in boxes.iter().enumerate() {
            each(b, &mut |s| {
                self.faces[next[s] as usize] = i as u32;
                next[s] += 1;
            });
        }
        self.starts = starts;
    }

    fn bucket(&self, p: DVec3) -> IVec3 {
        // Cut off once nothing is below 0: the same as rounding down, and no call.
        let b = (p - self.lo) / self.side_mm;
        b.clamp(DVec3::ZERO, (self.dims - 1).as_dvec3()).as_ivec3()
    }

    /// Returns the distance from a point (LPS mm) to the nearest triangle, mm, or `limit_mm` if
    /// none is nearer than that.
    pub fn distance(&self, p_mm: DVec3, limit_mm: f64) -> f64 {
        let mut best = limit_mm.max(0.0).powi(2);
        let (a, b) = (self.bucket(p_mm - limit_mm), self.bucket(p_mm + limit_mm));
        let home = self.bucket(p_mm);
        // Shells of buckets about the point's own; a shell k wide starts k - 1 sides away at least.
        let last = (home - a).max(b - home).max_element();
        for k in 0..=last {
            let gap = f64::from((k - 1).max(0)) * self.side_mm;
            // A point outside the box is even farther from a shell than that.
            if gap * gap > best {
                break;
            }
            let (lo, hi) = ((home - k).max(a), (home + k).min(b));
            for z in lo.z..=hi.z {
                for y in lo.y..=hi.y {
                    let face = (z - home.z).abs() == k || (y - home.y).abs() == k;
                    for x in lo.x..=hi.x {
                        if face || (x - home.x).abs() == k {
                            best = self.nearest_in(IVec3::new(x, y, z), p_mm, best);
                        }
                    }
                }
            }
        }
        best.sqrt()
    }

    fn nearest_in(&self, bucket: IVec3, p: DVec3, mut best: f64) -> f64 {
        let lo = self.lo + bucket.as_dvec3() * self.side_mm;
        let near = p.clamp(lo, lo + self.side_mm);
        // A hair of slack: bucket borders are rounded.
        if near.distance_squared(p) > best * (1.0 + 1e-9) + 1e-12 {
            return best;
        }
        let s = slot(self.dims, bucket);
        for f in &self.faces[self.starts[s] as usize..self.starts[s + 1] as usize] {
            let corners = self.corners[*f as usize].map(|v| v.as_dvec3());
            best = best.min(nearest_on_triangle(p, corners).0);
        }
        best
    }
}

fn slot(dims: IVec3, b: IVec3) -> usize {
    let d = dims.as_usizevec3();
    b.x as usize + d.x * (b.y as usize + d.y * b.z as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn random(i: u32) -> DVec3 {
        let r = |k: u32| f64::from((i * 3 + k).wrapping_mul(2_654_435_761) >> 8) / 16_777_216.0;
        DVec3::new(r(0), r(1), r(2))
    }

    #[test]
    fn buckets_give_the_distance_of_a_search_through_all_triangles() {
        let positions: Vec<Vec3> = (0..300u32)
            .map(|i| (random(i / 3) * 40.0 + random(1000 + i) * 5.0 - 20.0).as_vec3())
            .collect();
        let faces = (0..100).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let mesh = Mesh { positions, faces, ..Mesh::default() };
        let index = WallIndex::new(&mesh);
        for i in 0..500 {
            let p = random(5000 + i) * 60.0 - 30.0;
            let corners = index.corners.iter().map(|t| t.map(|v| v.as_dvec3()));
            let all = corners.map(|t| nearest_on_triangle(p, t).0.sqrt());
            let want = all.fold(f64::INFINITY, f64::min);
            assert!((index.distance(p, 1e3) - want).abs() < 1e-9, "{p}");
            assert!((index.distance(p, 2.0) - want.min(2.0)).abs() < 1e-9, "{p}");
        }
    }

    #[test]
    fn a_wall_without_triangles_is_at_the_limit() {
        assert_eq!(WallIndex::new(&Mesh::default()).distance(DVec3::ONE, 3.0), 3.0);
    }
}
