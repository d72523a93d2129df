//! Points of a refined face, and the index templates that all refined faces share.
//!
//! A face is split 1-to-4 a few times. Its points are in the order in which levels insert them, so
//! that a coarser level has the first of them. A template has the triangles of one level inside, and
//! on each side the points of a level of its own: rows inside are a regular grid, and the row along
//! a side is stitched to the points on the side. So a side depends on its own level alone, whatever
//! the faces at it have.

use std::sync::LazyLock;

/// Most splits of a face.
pub const MAX_LEVEL: u32 = 4;
/// Steps along a side of the grid of all points.
pub const STEPS: u32 = 1 << MAX_LEVEL;
/// Levels of a side, none included.
const LEVELS: usize = MAX_LEVEL as usize + 1;

/// Barycentric coordinates, in steps.
type FaceCoordinates = [u32; 3];

/// A point of a face.
#[derive(Clone, Copy, Debug)]
pub struct FacePoint {
    /// Coordinates; they add up to [`STEPS`].
    pub at: FaceCoordinates,
    /// Level that inserts the point; 0 for corners.
    pub born: u32,
    /// Carrier of its morph: 0 the face, 1 + e its side from corner e to e + 1.
    pub carrier: u32,
    /// Points at the ends of the edge that it splits; itself, twice, of a corner.
    pub parents: [usize; 2],
}

/// Range of a template in [`FaceGrid::indices`].
#[derive(Clone, Copy, Debug, Default)]
pub struct FaceTemplate {
    pub first: u32,
    pub triangles: u32,
}

/// Points and templates of all faces.
pub struct FaceGrid {
    pub points: Vec<FacePoint>,
    pub indices: Vec<u32>,
    /// Templates by level inside, from 1, and by level of each side.
    templates: Vec<FaceTemplate>,
}

impl FaceGrid {
    /// Returns the grid.
    pub fn get() -> &'static Self {
        static GRID: LazyLock<FaceGrid> = LazyLock::new(FaceGrid::new);
        &GRID
    }

    fn new() -> Self {
        let points = points();
        let number = |at: FaceCoordinates| {
            let found = points.iter().position(|p| p.at == at);
            found.expect("a point of the grid") as u32
        };
        let (mut indices, mut templates) = (Vec::new(), Vec::new());
        for level in 1..=MAX_LEVEL {
            for sides in 0..LEVELS.pow(3) {
                let sides = [sides % LEVELS, sides / LEVELS % LEVELS, sides / LEVELS.pow(2)];
                let first = indices.len() as u32;
                // No side is finer than the inside.
                if sides.iter().all(|s| *s as u32 <= level) {
                    let faces = triangles(level, sides.map(|s| s as u32));
                    indices.extend(faces.into_iter().flatten().map(number));
                }
                let triangles = (indices.len() as u32 - first) / 3;
                templates.push(FaceTemplate { first, triangles });
            }
        }
        Self { points, indices, templates }
    }

    /// Returns the number of points up to a level.
    pub const fn points_at(level: u32) -> usize {
        let n = 1 << level;
        (n + 1) * (n + 2) / 2
    }

    /// Returns the points at the corners of a template's triangles.
    pub fn indices_of(&self, level: u32, sides: [u32; 3]) -> &[u32] {
        let t = self.template(level, sides);
        &self.indices[t.first as usize..][..3 * t.triangles as usize]
    }

    /// Returns the template of a level inside, from 1, and levels of the sides, which are at most as
    /// fine.
    pub fn template(&self, level: u32, sides: [u32; 3]) -> FaceTemplate {
        let [a, b, c] = sides.map(|s| s as usize);
        self.templates[(level as usize - 1) * LEVELS.pow(3) + a + LEVELS * (b + LEVELS * c)]
    }
}

/// All points, those of coarser levels first.
fn points() -> Vec<FacePoint> {
    let mut points: Vec<FacePoint> = Vec::new();
    for born in 0..=MAX_LEVEL {
        let step = STEPS >> born;
        for a in (0..=STEPS).rev().step_by(step as usize) {
            for b in (0..=STEPS - a).rev().step_by(step as usize) {
                let at = [a, b, STEPS - a - b];
                if points.iter().any(|p| p.at == at) {
                    continue;
                }
                // Two coordinates are odd, the ends of the edge are one step away in both.
                let odd: Vec<usize> = (0..3).filter(|k| at[*k] / step % 2 == 1).collect();
                let parents = match odd[..] {
                    [j, k] if born > 0 => {
                        let mut ends = [at; 2];
                        for (end, [up, down]) in ends.iter_mut().zip([[j, k], [k, j]]) {
                            end[up] += step;
                            end[down] -= step;
                        }
                        let number = |end: FaceCoordinates| points.iter().position(|p| p.at == end);
                        ends.map(|end| number(end).expect("a point of a coarser level"))
                    }
                    _ => [points.len(); 2],
                };
                let zero = at.iter().position(|c| *c == 0).filter(|_| born > 0);
                let carrier = zero.map_or(0, |zero| 1 + (zero as u32 + 1) % 3);
                points.push(FacePoint { at, born, carrier, parents });
            }
        }
    }
    points
}

/// Triangles of a level inside and of levels on the sides.
fn triangles(level: u32, sides: [u32; 3]) -> Vec<[FaceCoordinates; 3]> {
    let step = STEPS >> level;
    let corner = |e: usize| {
        let mut at = [0; 3];
        at[e % 3] = STEPS;
        at
    };
    // 1. Points on each side, from corner e up to corner e + 1.
    let outer = |e: usize| -> Vec<FaceCoordinates> {
        let one = |k: u32| {
            let mut at = [0; 3];
            at[(e + 1) % 3] = k;
            at[e] = STEPS - k;
            at
        };
        (0..=STEPS).step_by((STEPS >> sides[e]) as usize).map(one).collect()
    };
    if level == 1 {
        return with_split_sides([0, 1, 2].map(corner), sides.map(|s| s > 0));
    }

    // 2. A regular grid inside, one step away from the sides.
    let mut faces = Vec::new();
    let inner_steps = (1 << level) - 3;
    let inner = |a: u32, b: u32| {
        let (a, b) = (step * (1 + a), step * (1 + b));
        [a, b, STEPS - a - b]
    };
    for a in 0..inner_steps {
        for b in 0..inner_steps - a {
            faces.push([inner(a, b), inner(a + 1, b), inner(a, b + 1)]);
            if a + b + 1 < inner_steps {
                faces.push([inner(a + 1, b), inner(a + 1, b + 1), inner(a, b + 1)]);
            }
        }
    }

    // 3. The rows between.
    for e in 0..3 {
        let [from, to, away] = [e, (e + 1) % 3, (e + 2) % 3];
        let row = |k: u32| {
            let mut at = [0; 3];
            at[away] = step;
            at[to] = step * (1 + k);
            at[from] = STEPS - at[away] - at[to];
            at
        };
        let inner: Vec<FaceCoordinates> = (0..=inner_steps).map(row).collect();
        stitch(&outer(e), &inner, |p| 2 * p[to] + p[away], &mut faces);
    }
    faces
}

/// Appends the triangles between two rows of points; `along` orders the points of both.
fn stitch(
    outer: &[FaceCoordinates],
    inner: &[FaceCoordinates],
    along: impl Fn(FaceCoordinates) -> u32,
    faces: &mut Vec<[FaceCoordinates; 3]>,
) {
    let (mut o, mut i) = (0, 0);
    while o + 1 < outer.len() || i + 1 < inner.len() {
        let middle = |row: &[FaceCoordinates], k: usize| {
            row.get(k + 1).map_or(u32::MAX, |next| along(row[k]) + along(*next))
        };
        if middle(outer, o) <= middle(inner, i) {
            faces.push([outer[o], outer[o + 1], inner[i]]);
            o += 1;
        } else {
            faces.push([outer[o], inner[i + 1], inner[i]]);
            i += 1;
        }
    }
}

/// Triangles of a triangle of which some sides are halved.
fn with_split_sides(
    [a, b, c]: [FaceCoordinates; 3],
    is_split: [bool; 3],
) -> Vec<[FaceCoordinates; 3]> {
    let middle = |p: FaceCoordinates, q: FaceCoordinates| [0, 1, 2].map(|k| (p[k] + q[k]) / 2);
    let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
    match is_split {
        [true, true, true] => vec![[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]],
        [false, false, false] => vec![[a, b, c]],
        [true, false, false] => vec![[a, ab, c], [ab, b, c]],
        [true, true, false] => vec![[ab, b, bc], [a, ab, c], [ab, bc, c]],
        [split_ab, _, _] => {
            // The same with the corners turned.
            let turned = [is_split[1], is_split[2], split_ab];
            with_split_sides([b, c, a], turned)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn twice_area([a, b, c]: [FaceCoordinates; 3]) -> i64 {
        let d = |p: FaceCoordinates, q: FaceCoordinates| {
            [0, 1].map(|k| i64::from(q[k]) - i64::from(p[k]))
        };
        let (u, v) = (d(a, b), d(a, c));
        u[0] * v[1] - u[1] * v[0]
    }

    #[test]
    fn templates_tile_the_face_and_have_the_points_of_their_level_on_each_side() {
        let grid = FaceGrid::get();
        let mut templates = 0;
        for level in 1..=MAX_LEVEL {
            for code in 0..(level + 1).pow(3) {
                let n = level + 1;
                let sides = [code % n, code / n % n, code / (n * n)];
                let own = grid.indices_of(level, sides);
                let faces: Vec<[FaceCoordinates; 3]> = own
                    .chunks_exact(3)
                    .map(|t| [t[0], t[1], t[2]].map(|i| grid.points[i as usize].at))
                    .collect();
                assert!(faces.iter().all(|t| twice_area(*t) > 0), "{level} {sides:?}");
                let area: i64 = faces.iter().map(|t| twice_area(*t)).sum();
                assert_eq!(area, i64::from(STEPS * STEPS), "{level} {sides:?}");
                let edges = || faces.iter().flat_map(|t| [0, 1, 2].map(|e| [t[e], t[(e + 1) % 3]]));
                for e in 0..3 {
                    let on = |p: &FaceCoordinates| p[(e + 2) % 3] == 0;
                    let along = edges().filter(|[p, q]| on(p) && on(q)).count();
                    assert_eq!(along, 1 << sides[e], "{level} {sides:?} {e}");
                }
                // Every edge inside has its twin.
                let inside = edges().filter(|[p, q]| !(0..3).any(|k| p[k] == 0 && q[k] == 0));
                for [p, q] in inside {
                    assert_eq!(edges().filter(|e| *e == [q, p]).count(), 1);
                }
                let last = own.iter().copied().max().unwrap() as usize;
                assert!(last < FaceGrid::points_at(level));
                templates += 1;
            }
        }
        assert_eq!(templates, 8 + 27 + 64 + 125);
    }

    #[test]
    fn a_point_is_in_the_middle_of_older_parents_on_its_own_side() {
        let grid = FaceGrid::get();
        assert_eq!(grid.points.len(), FaceGrid::points_at(MAX_LEVEL));
        for (i, p) in grid.points.iter().enumerate().skip(3) {
            assert!((FaceGrid::points_at(p.born - 1)..FaceGrid::points_at(p.born)).contains(&i));
            let [a, b] = p.parents.map(|q| grid.points[q]);
            assert!(a.born < p.born && b.born < p.born);
            for k in 0..3 {
                assert_eq!(a.at[k] + b.at[k], 2 * p.at[k]);
                assert!(p.at[k] > 0 || a.at[k] == 0 && b.at[k] == 0);
            }
        }
    }
}
