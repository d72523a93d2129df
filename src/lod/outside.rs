//! What lies outside a closed wall, coarsely: whatever is seen through it is hidden by the wall.
//!
//! A bent organ comes past the eye several times. Half of the triangles in a picture of a colon lie
//! in other loops than the eye's, behind centimetres of tissue, where neither the picture's edge nor
//! their backs leave them out. Space is cut into cells; those that no triangle comes near and that
//! can be reached from the rim of all are outside. The test is on the safe side: what it calls hidden,
//! no ray from an eye within the wall can reach.

use glam::{DVec3, IVec3, UVec3, Vec3};

use super::Sphere;
use crate::geometry::Mesh;

/// Cells, about.
const CELLS: f64 = 262_144.0;
/// More steps are not told apart.
const STEPS_MAX: u8 = 12;

/// Space around a closed wall in cells: those outside, and how far each is from all others.
#[derive(Debug)]
pub struct Cells {
    lo: DVec3,
    side_mm: f64,
    dims: UVec3,
    /// Steps of a king from each cell to the nearest that is not outside, 0 there.
    steps: Vec<u8>,
}

/// What a closed wall hides.
#[derive(Debug)]
pub struct Outside {
    cells: Cells,
    margin_mm: f64,
}

impl Cells {
    /// Sorts space out around a wall (LPS mm), which must be closed. 262,144 cells, a byte each.
    pub fn new(mesh: &Mesh) -> Self {
        let around = |(lo, hi): (Vec3, Vec3), p: &Vec3| (lo.min(*p), hi.max(*p));
        let (lo, hi) = mesh.positions.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), around);
        let size = if mesh.positions.is_empty() { DVec3::ZERO } else { (hi - lo).as_dvec3() };
        let lo = if mesh.positions.is_empty() { DVec3::ZERO } else { lo.as_dvec3() };
        let side_mm = (size.element_product() / CELLS).cbrt().max(size.max_element() / 255.0);
        let side_mm = side_mm.max(1e-3);
        // A cell more on every side.
        let dims = ((size / side_mm).floor() + 3.0).as_uvec3();
        let mut this = Self { lo: lo - side_mm, side_mm, dims, steps: Vec::new() };
        this.steps = vec![STEPS_MAX; dims.as_usizevec3().element_product()];
        for f in &mesh.faces {
            let [a, b, c] = f.map(|v| mesh.positions[v as usize]);
            // Rounding must not leave out a cell that is touched.
            let hair = 1e-6 * (1.0 + size.max_element());
            let first = this.cell(a.min(b).min(c).as_dvec3() - hair);
            let last = this.cell(a.max(b).max(c).as_dvec3() + hair);
            for z in first.z..=last.z {
                for y in first.y..=last.y {
                    let row = this.at(IVec3::new(first.x, y, z));
                    this.steps[row..=row + (last.x - first.x) as usize].fill(0);
                }
            }
        }
        this.keep_reached();
        this.spread();
        this
    }

    fn cell(&self, p: DVec3) -> IVec3 {
        // Cut off, not rounded down: what is below 0 becomes 0 either way.
        let c = ((p - self.lo) / self.side_mm).as_ivec3();
        c.clamp(IVec3::ZERO, self.dims.as_ivec3() - 1)
    }

    fn at(&self, c: IVec3) -> usize {
        let [x, y, z] = c.as_uvec3().to_array().map(|v| v as usize);
        x + self.dims.x as usize * (y + self.dims.y as usize * z)
    }

    /// Of the untouched cells, only what can be reached from the rim of all is outside.
    fn keep_reached(&mut self) {
        let d = self.dims.as_usizevec3();
        let (row, layer) = (d.x, d.x * d.y);
        let rim = |k: usize, n: usize| k == 0 || k == n - 1;
        let mut reached = vec![false; self.steps.len()];
        for (k, own) in reached.chunks_exact_mut(row).enumerate() {
            if rim(k % d.y, d.y) || rim(k / d.y, d.z) {
                own.fill(true);
            }
            (own[0], own[row - 1]) = (true, true);
        }
        // What begins beside the rim and is not the rim has all its neighbours in the grid.
        let beside = |i: usize| [i - 1, i + 1, i - row, i + row, i - layer, i + layer];
        let inner = |i: &usize| !reached[*i] && beside(*i).iter().any(|j| reached[*j]);
        let mut open: Vec<usize> = (0..self.steps.len()).filter(inner).collect();
        while let Some(i) = open.pop() {
            if self.steps[i] > 0 && !std::mem::replace(&mut reached[i], true) {
                open.extend(beside(i).into_iter().filter(|j| !reached[*j]));
            }
        }
        self.steps.iter_mut().zip(reached).filter(|s| !s.1).for_each(|s| *s.0 = 0);
    }

    /// Counts steps from what is 0: what comes before a cell in memory tells it forwards, what comes
    /// after it backwards, which for a king's steps is exact (Borgefors 1986,
    /// doi:10.1016/S0734-189X(86)80047-0).
    fn spread(&mut self) {
        let [nx, ny, nz] = self.dims.to_array().map(|n| n as usize);
        let rows = ny * nz;
        let mut near = vec![0u8; nx];
        for forwards in [true, false] {
            for k in 0..rows {
                let at = if forwards { k } else { rows - 1 - k };
                let (y, z) = (at % ny, at / ny);
                // Rows of the layer before this one, and the row before in its own.
                let step =
                    |n: usize, by: isize| n.checked_add_signed(if forwards { by } else { -by });
                let others = [(-1, -1), (0, -1), (1, -1), (-1, 0)].map(|(dy, dz)| {
                    let y = step(y, dy).filter(|y| *y < ny)?;
                    let z = step(z, dz).filter(|z| *z < nz)?;
                    Some((y + ny * z) * nx)
                });
                near.fill(STEPS_MAX);
                for first in others.into_iter().flatten() {
                    let row = &self.steps[first..first + nx];
                    near.iter_mut().zip(row).for_each(|(n, s)| *n = (*n).min(*s));
                }
                let own = &mut self.steps[at * nx..][..nx];
                let beside = |x: usize| near[x.saturating_sub(1)].min(near[(x + 1).min(nx - 1)]);
                (0..nx).for_each(|x| own[x] = own[x].min(near[x].min(beside(x)) + 1));
                let mut last = STEPS_MAX;
                let mut along = |s: &mut u8| {
                    *s = (*s).min(last + 1);
                    last = *s;
                };
                if forwards {
                    own.iter_mut().for_each(&mut along);
                } else {
                    own.iter_mut().rev().for_each(&mut along);
                }
            }
        }
    }

    /// At least how far a point is from all that is not outside, mm.
    fn clear_mm(&self, p: DVec3) -> f64 {
        let steps = self.steps[self.at(self.cell(p))];
        f64::from(steps.saturating_sub(1)) * self.side_mm
    }
}

impl Outside {
    /// * `cells`: of the wall.
    /// * `margin_mm`: how far what is drawn may be from the wall at most.
    pub fn new(cells: Cells, margin_mm: f64) -> Self {
        Self { cells, margin_mm }
    }

    /// Whether the wall hides all of a sphere from an eye within it.
    ///
    /// Every segment from the eye to a point of the sphere passes through each of the balls between:
    /// the sphere made smaller towards the eye. If one of them lies outside, the segment has crossed
    /// the wall before.
    pub fn hides(&self, eye: DVec3, s: &Sphere) -> bool {
        let way = s.centre.as_dvec3() - eye;
        let length = way.length();
        let radius = f64::from(s.radius) * (1.0 + 1e-6) + 1e-6;
        let mut gone = 0.0;
        while gone < length - radius {
            let t = gone / length;
            let wanted = radius * t + self.margin_mm;
            let clear = self.cells.clear_mm(eye + way * t);
            if clear > wanted {
                return true;
            }
            // Nowhere nearer can be clear enough but for whole cells.
            gone += (wanted - clear).max(0.5 * self.cells.side_mm);
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::shapes::closed_lattice;

    const MAJOR: f64 = 30.0;
    const MINOR: f64 = 8.0;

    /// A torus about z.
    fn ring(around: u32, across: u32) -> Mesh {
        closed_lattice(around, across, |u, v| {
            let out = Vec3::new(u.cos() * v.cos(), u.sin() * v.cos(), v.sin());
            let middle = Vec3::new(u.cos(), u.sin(), 0.0);
            (MAJOR as f32 * middle + MINOR as f32 * out, -out)
        })
    }

    #[test]
    fn steps_are_those_of_a_king() {
        let cells = Cells::new(&ring(60, 30));
        let d = cells.dims.as_ivec3();
        let all = || {
            (0..d.z).flat_map(|z| {
                (0..d.y).flat_map(move |y| (0..d.x).map(move |x| IVec3::new(x, y, z)))
            })
        };
        let none: Vec<IVec3> = all().filter(|c| cells.steps[cells.at(*c)] == 0).collect();
        for c in all().step_by(97) {
            let steps = none.iter().map(|n| (c - *n).abs().max_element()).min().unwrap_or(i32::MAX);
            let found = i32::from(cells.steps[cells.at(c)]);
            assert_eq!(found, steps.min(i32::from(STEPS_MAX)), "{c}");
        }
    }

    /// How far a point is beyond the torus.
    fn beyond(p: DVec3) -> f64 {
        DVec3::new(p.truncate().length() - MAJOR, p.z, 0.0).length() - MINOR
    }

    #[test]
    fn what_is_hidden_in_a_ring_is_seen_by_no_ray_and_most_of_its_far_side_is() {
        let outside = Outside::new(Cells::new(&ring(300, 90)), 0.1);
        let mut seed = 3u64;
        let mut noise = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 40) as f64 / (1u64 << 24) as f64
        };
        let (mut hidden, mut far) = (0, 0);
        for _ in 0..4000 {
            let eye = DVec3::new(MAJOR + 5.0 * (2.0 * noise() - 1.0), 0.0, 4.0 * noise());
            let u = std::f64::consts::TAU * noise();
            let centre = DVec3::new(MAJOR * u.cos(), MAJOR * u.sin(), 3.0 * noise()).as_vec3();
            let s = Sphere { centre, radius: (3.0 * noise()) as f32 };
            let opposite = u.cos() < -0.7;
            far += usize::from(opposite);
            if !outside.hides(eye, &s) {
                continue;
            }
            hidden += usize::from(opposite);
            for _ in 0..20 {
                let at = DVec3::new(noise(), noise(), noise()) * 2.0 - 1.0;
                let p = centre.as_dvec3() + at.clamp_length_max(1.0) * f64::from(s.radius);
                let most = (0..400).map(|k| beyond(eye.lerp(p, f64::from(k) / 400.0)));
                assert!(most.fold(f64::NEG_INFINITY, f64::max) > 0.1, "{p} is seen from {eye}");
            }
        }
        assert!(far > 500 && hidden > far * 9 / 10, "{hidden} of {far} on the far side are hidden");
    }

    #[test]
    fn nothing_is_outside_where_cells_are_too_large_or_there_is_no_wall() {
        for mesh in [Mesh::default(), ring(12, 5)] {
            let outside = Outside::new(Cells::new(&mesh), 100.0);
            let s = Sphere { centre: Vec3::new(-30.0, 0.0, 0.0), radius: 1.0 };
            assert!(!outside.hides(DVec3::new(30.0, 0.0, 0.0), &s));
        }
    }

    #[test]
    fn a_hollow_within_is_not_outside() {
        // The far side of a ring within a larger closed box: what is between them is not reached.
        let mut mesh = ring(300, 90);
        let first = mesh.positions.len() as u32;
        let corner = |k: u32| Vec3::new(k as f32, (k >> 1) as f32, (k >> 2) as f32) % 2.0;
        mesh.positions.extend((0..8).map(|k| (corner(k) - 0.5) * 90.0));
        let sides =
            [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
        for s in sides {
            let [a, b, c, d] = s.map(|k: u32| first + k);
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
        let outside = Outside::new(Cells::new(&mesh), 0.1);
        let s = Sphere { centre: Vec3::new(-30.0, 0.0, 0.0), radius: 1.0 };
        assert!(!outside.hides(DVec3::new(30.0, 0.0, 0.0), &s));
    }
}
