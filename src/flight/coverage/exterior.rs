//! Cells of a grid that lie wholly outside a closed wall: most of what the wall hides is found by
//! these alone, box by box.

use glam::{DVec3, IVec3};

use crate::geometry::Mesh;

/// Cells a face, about.
const CELLS_PER_FACE: usize = 1;
/// Most cells.
const MAX_CELLS: usize = 1 << 25;
/// Cells this near to a face, in cells, count as met by it: more than rounding adds up to.
const MARGIN: f64 = 1e-6;

/// Largest distance that is kept, in cells.
const FARTHEST: i8 = 100;
/// Most steps of a walk; what is not hidden by then counts as not known.
const MAX_STEPS: usize = 64;

/// A grid of cells about a wall. A cell is outside where no face meets it and the outside of the
/// grid is reached through such cells.
pub(super) struct Exterior {
    low: DVec3,
    /// Cells a mm.
    scale: f64,
    dims: IVec3,
    /// Chebyshev distance in cells: of a cell that is not outside to the nearest one that is, and of
    /// one that is outside, less than 0, to the nearest one that is not.
    distance: Vec<i8>,
}

impl Exterior {
    /// `None` of a wall that is not closed, or that has a vertex that is not finite: what is outside
    /// is not known then.
    pub fn new(wall: &Mesh) -> Option<Self> {
        let (low, high) = wall.bounds()?;
        let (low, high) = (low.as_dvec3(), high.as_dvec3());
        if !wall.positions.iter().all(|p| p.is_finite()) || !is_closed(wall) {
            return None;
        }
        let most = (CELLS_PER_FACE * wall.faces.len()).clamp(64, MAX_CELLS) as f64;
        let size = (high - low).max(DVec3::splat(1e-3));
        let mut side = (size.element_product() / most).cbrt();
        // A rim of one cell all around belongs to the outside.
        let dims = |side: f64| (size / side).ceil() + 3.0;
        while dims(side).element_product() > most.max(1000.0) {
            side *= 1.1;
        }
        let low = low - 1.5 * side;
        let dims = dims(side).as_ivec3();
        let mut grid = Self { low, scale: side.recip(), dims, distance: Vec::new() };
        let outside = grid.outside(&grid.met(wall));
        grid.distance = grid.distances(&outside);
        Some(grid)
    }

    fn index(&self, c: IVec3) -> usize {
        let (d, c) = (self.dims.as_usizevec3(), c.as_usizevec3());
        c.x + d.x * (c.y + d.y * c.z)
    }

    /// Cells that the box of some face meets.
    fn met(&self, wall: &Mesh) -> Vec<bool> {
        let mut met = vec![false; self.dims.as_usizevec3().element_product()];
        for f in &wall.faces {
            let [a, b, c] = f.map(|v| wall.positions[v as usize]);
            let cell = |p: glam::Vec3, slack: f64| {
                ((p.as_dvec3() - self.low) * self.scale + slack).as_ivec3()
            };
            let (lo, hi) = (cell(a.min(b).min(c), -MARGIN), cell(a.max(b).max(c), MARGIN));
            for z in lo.z..=hi.z {
                for y in lo.y..=hi.y {
                    let row = self.index(IVec3::new(lo.x, y, z));
                    met[row..=row + (hi.x - lo.x) as usize].fill(true);
                }
            }
        }
        met
    }

    /// Floods the cells that no face meets, from a corner of the rim.
    fn outside(&self, met: &[bool]) -> Vec<bool> {
        let mut outside = vec![false; met.len()];
        let mut open = vec![IVec3::ZERO];
        outside[0] = true;
        while let Some(c) = open.pop() {
            for d in [IVec3::X, IVec3::Y, IVec3::Z].into_iter().flat_map(|d| [d, -d]) {
                let to = c + d;
                if to.cmpge(IVec3::ZERO).all() && to.cmplt(self.dims).all() {
                    let i = self.index(to);
                    if !met[i] && !outside[i] {
                        outside[i] = true;
                        open.push(to);
                    }
                }
            }
        }
        outside
    }

    /// Signed distances by peeling: a cell is deeper than k where all 26 about it are k deep.
    fn distances(&self, outside: &[bool]) -> Vec<i8> {
        let mut distance: Vec<i8> = outside.iter().map(|o| if *o { -1 } else { 1 }).collect();
        let d = self.dims.as_usizevec3();
        for k in 1..FARTHEST {
            let deep = |v: i8| v.abs() >= k;
            let before = distance.clone();
            let mut changed = false;
            for z in 1..d.z - 1 {
                for y in 1..d.y - 1 {
                    let row = d.x * (y + d.y * z);
                    for x in 1..d.x - 1 {
                        let i = row + x;
                        if !deep(before[i]) {
                            continue;
                        }
                        let sign = before[i].signum();
                        let all = (0..27).all(|n| {
                            let j = i + n % 3 + d.x * (n / 3 % 3) + d.x * d.y * (n / 9)
                                - 1
                                - d.x
                                - d.x * d.y;
                            before[j] * sign >= k
                        });
                        if all {
                            distance[i] = sign * (k + 1);
                            changed = true;
                        }
                    }
                }
            }
            if !changed {
                break;
            }
        }
        distance
    }

    /// Distance of the cell that a place lies in; 0 off the grid.
    fn at(&self, p: DVec3) -> i8 {
        // Cut off, not rounded down: the rim is outside and so is what lies just before it.
        let c = p.as_ivec3();
        let inside = c.cmpge(IVec3::ZERO).all() && c.cmplt(self.dims).all();
        if inside { self.distance[self.index(c)] } else { 0 }
    }

    /// Whether an eye is in a cell that is not outside.
    pub fn holds(&self, eye: DVec3) -> bool {
        self.at((eye - self.low) * self.scale) > 0
    }

    /// Whether the wall hides all of a box from an eye that is not outside: somewhere on the way all
    /// lines of sight pass cells outside. `false` where that is not known.
    ///
    /// * `centre`: relative to the eye, mm; `half`: half its extent, mm.
    pub fn hides(&self, eye: DVec3, centre: DVec3, half: DVec3) -> bool {
        let from = (eye - self.low) * self.scale;
        let way = centre * self.scale;
        let extent = half.max_element() * self.scale;
        let each = way.abs().max_element().recip();
        let mut t = 0.0;
        for _ in 0..MAX_STEPS {
            let distance = self.at(from + t * way);
            // All cells nearer than the distance are outside as well, and the lines of sight are
            // `t * extent` off the middle one here.
            if distance < 0 && t * extent <= f64::from(-distance) - 1.0 {
                return true;
            }
            t += each * f64::from(distance - 1).max(0.5);
            if t >= 1.0 || distance == 0 {
                return false;
            }
        }
        false
    }
}

/// Whether every edge is walked as often one way as the other: the sum of a hash of each directed
/// edge, its reverse counted against it.
fn is_closed(wall: &Mesh) -> bool {
    let mix = |a: u32, b: u32| {
        let n = u64::from(a) << 32 | u64::from(b);
        let n = (n ^ n >> 31).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let n = (n ^ n >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        n ^ n >> 32
    };
    let signed = |a: u32, b: u32| {
        if a < b { mix(a, b) } else { mix(b, a).wrapping_neg() }
    };
    let sum = wall.faces.iter().fold(0u64, |sum, [a, b, c]| {
        let edges = [(*a, *b), (*b, *c), (*c, *a)];
        edges.iter().filter(|e| e.0 != e.1).fold(sum, |s, e| s.wrapping_add(signed(e.0, e.1)))
    });
    sum == 0
}
