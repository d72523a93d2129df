//! Shape of a patch: its grid points, and the index templates that all patches share.
//!
//! A patch is a triangle split [`SPLITS`] times. It has the grid points of that, and on its sides
//! those of one split more. Its template at a level (0 ..= [`SPLITS`]) has the triangles of that
//! level; where a neighbour is a level finer, the triangles along that side are split to match
//! (red-green refinement: Bank, Sherman & Weiser 1983).

use std::sync::LazyLock;

/// Levels inside a patch.
pub const SPLITS: u32 = 3;
/// Steps of the grid along a side.
pub const STEPS: u32 = 2 << SPLITS;

/// A point of a triangular grid: barycentric coordinates, in steps.
pub type GridPoint = [u32; 3];

/// A point of a patch.
#[derive(Clone, Copy, Debug)]
pub struct PatchPoint {
    /// Coordinates; they add up to [`STEPS`].
    pub at: GridPoint,
    /// Level at which the point is inserted; 0 for corners.
    pub born: u32,
    /// Carrier of its morph: 0 the patch, 1 + e its side from corner e to e + 1.
    pub carrier: u32,
    /// Points at the ends of the edge that it splits; itself, twice, for corners.
    pub parents: [u32; 2],
}

/// The range of a template in [`PatchShape::indices`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Template {
    pub first: u32,
    pub triangles: u32,
}

/// Points and templates.
pub struct PatchShape {
    pub points: Vec<PatchPoint>,
    pub indices: Vec<u32>,
    /// Templates by level, and by which sides are split once more.
    templates: Vec<[Template; 8]>,
}

/// The shape of every patch.
pub static SHAPE: LazyLock<PatchShape> = LazyLock::new(PatchShape::new);

impl PatchShape {
    fn new() -> Self {
        let mut at = Vec::new();
        for i in 0..=STEPS {
            at.extend((0..=STEPS - i).map(|j| [i, j, STEPS - i - j]));
        }
        at.retain(|p| p.iter().all(|c| c % 2 == 0) || p.contains(&0));
        let id =
            |p: GridPoint| at.iter().position(|q| *q == p).expect("a point of the grid") as u32;
        let points = at.iter().map(|p| point(*p, &id)).collect();
        let mut shape = Self { points, indices: Vec::new(), templates: Vec::new() };
        for level in 0..=SPLITS {
            let of = |sides: u32| {
                let mut faces = Vec::new();
                let step = STEPS >> level;
                for t in triangles(1 << level) {
                    let t = t.map(|p| p.map(|c| c * step));
                    let middle = [0, 1, 2].map(|e| {
                        let (p, q) = (t[e], t[(e + 1) % 3]);
                        // The side opposite corner k has coordinate k = 0 and begins at k + 1.
                        let side = (0..3).find(|k| p[*k] == 0 && q[*k] == 0)?;
                        (sides >> ((side + 1) % 3) & 1 == 1)
                            .then(|| id([0, 1, 2].map(|k| (p[k] + q[k]) / 2)))
                    });
                    template(t.map(id), middle, &mut faces);
                }
                faces
            };
            let mut row = [Template::default(); 8];
            for (sides, place) in row.iter_mut().enumerate() {
                let faces = of(sides as u32);
                let first = shape.indices.len() as u32;
                *place = Template { first, triangles: faces.len() as u32 };
                shape.indices.extend(faces.into_iter().flatten());
            }
            shape.templates.push(row);
        }
        shape
    }

    /// The point with some coordinates.
    pub fn find(&self, at: GridPoint) -> Option<usize> {
        // In the order of the first coordinate, then of the second.
        self.points.binary_search_by_key(&at, |p| p.at).ok()
    }

    /// The template of a level; bit e of `sides` says that the side from corner e is split.
    pub fn template(&self, level: u32, sides: u32) -> Template {
        self.templates[level as usize][sides as usize]
    }

    /// Triangles of a template, as indices of points.
    pub fn faces(&self, t: Template) -> impl Iterator<Item = [usize; 3]> + '_ {
        let own = &self.indices[t.first as usize..][..3 * t.triangles as usize];
        own.chunks_exact(3).map(|t| [t[0] as usize, t[1] as usize, t[2] as usize])
    }
}

fn point(at: GridPoint, id: &dyn Fn(GridPoint) -> u32) -> PatchPoint {
    let unit = (at[0] | at[1] | at[2] | STEPS).trailing_zeros();
    let born = SPLITS + 1 - unit;
    let carrier = at.iter().position(|c| *c == 0).map_or(0, |zero| 1 + (zero as u32 + 1) % 3);
    if born == 0 {
        return PatchPoint { at, born, carrier: 0, parents: [id(at); 2] };
    }
    // Two coordinates are odd on the grid of that level: the edge runs along these.
    let even = (0..3).find(|k| at[*k] >> unit & 1 == 0).unwrap_or(0);
    let (i, j, d) = ((even + 1) % 3, (even + 2) % 3, 1 << unit);
    let (mut p, mut q) = (at, at);
    (p[i], p[j]) = (at[i] + d, at[j] - d);
    (q[i], q[j]) = (at[i] - d, at[j] + d);
    PatchPoint { at, born, carrier, parents: [id(p), id(q)] }
}

/// Triangles of a triangular grid with `m` steps a side, all oriented like the whole: first the
/// upright ones, then the inverted ones.
pub fn triangles(m: u32) -> impl Iterator<Item = [GridPoint; 3]> {
    let points = |s: u32| (0..=s).flat_map(move |a| (0..=s - a).map(move |b| [a, b, s - a - b]));
    let up = points(m - 1).map(|[a, b, c]| [[a + 1, b, c], [a, b + 1, c], [a, b, c + 1]]);
    let down = (m >= 2).then(|| points(m - 2)).into_iter().flatten();
    up.chain(down.map(|[a, b, c]| [[a, b + 1, c + 1], [a + 1, b, c + 1], [a + 1, b + 1, c]]))
}

/// Red-green templates: a triangle with some sides split at the midpoint becomes one to four
/// triangles.
pub fn template<T: Copy>(v: [T; 3], middle: [Option<T>; 3], faces: &mut Vec<[T; 3]>) {
    // One side, from the first to the second corner, is split.
    let one = |[a, b, c]: [T; 3], m| [[a, m, c], [m, b, c]];
    // It is not split, and the other two are.
    let two = |[a, b, c]: [T; 3], bc, ca| [[bc, c, ca], [a, b, bc], [a, bc, ca]];
    let [a, b, c] = v;
    match middle {
        [None, None, None] => faces.push(v),
        [Some(m), None, None] => faces.extend(one([a, b, c], m)),
        [None, Some(m), None] => faces.extend(one([b, c, a], m)),
        [None, None, Some(m)] => faces.extend(one([c, a, b], m)),
        [None, Some(bc), Some(ca)] => faces.extend(two([a, b, c], bc, ca)),
        [Some(ab), None, Some(ca)] => faces.extend(two([b, c, a], ca, ab)),
        [Some(ab), Some(bc), None] => faces.extend(two([c, a, b], ab, bc)),
        [Some(ab), Some(bc), Some(ca)] => {
            faces.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twice the area of a triangle on the grid, positive for the orientation of the whole.
    fn twice_area([a, b, c]: [GridPoint; 3]) -> i64 {
        let d = |p: GridPoint, q: GridPoint| [0, 1].map(|k| i64::from(q[k]) - i64::from(p[k]));
        let (u, v) = (d(a, b), d(a, c));
        u[0] * v[1] - u[1] * v[0]
    }

    #[test]
    fn templates_tile_the_patch_and_split_exactly_the_given_sides() {
        let whole = i64::from(STEPS * STEPS);
        for level in 0..=SPLITS {
            for sides in 0..8 {
                let t = SHAPE.template(level, sides);
                let at = |i: usize| SHAPE.points[i].at;
                let faces: Vec<_> = SHAPE.faces(t).map(|t| t.map(at)).collect();
                assert!(faces.iter().all(|t| twice_area(*t) > 0));
                assert_eq!(faces.iter().map(|t| twice_area(*t)).sum::<i64>(), whole);
                for e in 0..3 {
                    let on = |p: GridPoint| p[(e + 2) % 3] == 0;
                    let along: usize = faces
                        .iter()
                        .flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])])
                        .filter(|(p, q)| on(*p) && on(*q))
                        .count();
                    assert_eq!(along, 1 << (level + (sides >> e & 1)), "{level} {sides:03b} {e}");
                }
            }
        }
    }

    #[test]
    fn parents_of_a_point_are_older_and_on_its_side() {
        for p in &SHAPE.points {
            let [a, b] = p.parents.map(|q| SHAPE.points[q as usize]);
            for k in 0..3 {
                assert_eq!(a.at[k] + b.at[k], 2 * p.at[k]);
                assert!(p.at[k] > 0 || a.at[k] == 0 && b.at[k] == 0);
            }
            assert!(p.born == 0 || a.born < p.born && b.born < p.born);
        }
    }
}
