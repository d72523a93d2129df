//! Shape of a patch: its grid points, and the index templates that all patches share.
//!
//! A patch is a triangle subdivided by a [`Scheme`] a few times. It has the vertices of all levels,
//! and on its sides those of one level more. Its template at a level has the triangles of that
//! level; where a neighbour is a level finer, the triangles along that side are split to match
//! (red-green refinement: Bank, Sherman & Weiser 1983).
//!
//! - 1-to-4: every side is halved.
//! - 4-8 (Velho & Zorin 2001, doi:10.1016/S0167-8396(01)00039-5): a vertex at the centre, so that
//!   each side is the diagonal of a quad; then each triangle is bisected from its newest corner.
//!   Departure: pairs of faces are not joined.
//! - √3 (Kobbelt 2000, doi:10.1145/344779.344835): a vertex at the centre of each triangle, then
//!   edges between old vertices are flipped. Two steps split a side in three. Edges on the sides of
//!   a patch wait for the second step, as those at the border of a refined region do in the paper:
//!   so a patch depends on its sides alone.

use std::collections::{BTreeSet, HashMap};
use std::sync::LazyLock;

use super::scheme::Scheme;

/// Levels inside a patch of 1-to-4 splits.
pub const SPLITS: u32 = 3;
/// Steps of its grid along a side.
const STEPS: u32 = 2 << SPLITS;
/// Steps of the grids of √3, four levels of it, and of 4-8.
const SQRT3_STEPS: u32 = 9;
const FOUR_EIGHT_STEPS: u32 = 48;
/// Most levels of any shape, the coarsest included.
pub const LEVELS: usize = 6;

/// A point of a triangular grid: barycentric coordinates, in steps.
pub type GridPoint = [u32; 3];

/// A point of a patch.
#[derive(Clone, Copy, Debug)]
pub struct PatchPoint {
    /// Coordinates; they add up to [`PatchShape::steps`].
    pub at: GridPoint,
    /// Level at which the point is inserted; 0 for corners.
    pub born: u32,
    /// Carrier of its morph: 0 the patch, 1 + e its side from corner e to e + 1.
    pub carrier: u32,
    /// Points at the ends of the edge that it splits; itself, twice, where it splits none.
    pub parents: [u32; 2],
}

/// The range of a template in [`PatchShape::indices`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Template {
    pub first: u32,
    pub triangles: u32,
}

/// An edge of a level: points at its ends, and the one at its middle, if there is one.
#[derive(Clone, Copy, Debug)]
pub struct PatchEdge {
    pub ends: [u32; 2],
    pub middle: Option<u32>,
}

/// Points and templates.
pub struct PatchShape {
    /// Steps of the grid along a side.
    pub steps: u32,
    pub points: Vec<PatchPoint>,
    pub indices: Vec<u32>,
    /// Templates by level, and by which sides are split once more.
    templates: Vec<[Template; 8]>,
    /// Edges by level, each once.
    edges: Vec<Vec<PatchEdge>>,
}

type GridTriangle = [GridPoint; 3];

impl PatchShape {
    /// The shape of every patch of a scheme.
    pub fn of(scheme: Scheme) -> &'static Self {
        static ONE_TO_FOUR: LazyLock<PatchShape> = LazyLock::new(|| {
            let scaled =
                |l: u32| triangles(1 << l).map(move |t| t.map(|p| p.map(|c| c * (STEPS >> l))));
            PatchShape::new(STEPS, (0..=SPLITS).map(|l| scaled(l).collect()).collect(), 2)
        });
        static SQRT3: LazyLock<PatchShape> =
            LazyLock::new(|| PatchShape::new(SQRT3_STEPS, sqrt3_levels(), 1));
        static FOUR_EIGHT: LazyLock<PatchShape> =
            LazyLock::new(|| PatchShape::new(FOUR_EIGHT_STEPS, four_eight_levels(), 1));
        match scheme {
            Scheme::OneToFour | Scheme::Butterfly => &ONE_TO_FOUR,
            Scheme::Sqrt3 => &SQRT3,
            Scheme::FourEight => &FOUR_EIGHT,
        }
    }

    /// * `levels`: triangles of each level, on the grid.
    /// * `beyond`: into how many parts one level more would split a segment of a side.
    fn new(steps: u32, levels: Vec<Vec<GridTriangle>>, beyond: u32) -> Self {
        let sides = points_on_sides(&levels, beyond);
        let born = levels_of_birth(&levels, &sides);
        let mut at: Vec<GridPoint> = born.keys().copied().collect();
        at.sort_unstable();
        let id = |p: GridPoint| at.binary_search(&p).expect("a point of the grid") as u32;
        let point = |p: &GridPoint| {
            let born = born[p];
            let before = (born > 0).then(|| &levels[born as usize - 1]);
            let (a, b) = before.and_then(|l| edge_split_at(l, *p)).unwrap_or((*p, *p));
            let zero = p.iter().position(|c| *c == 0).filter(|_| born > 0);
            let carrier = zero.map_or(0, |zero| 1 + (zero as u32 + 1) % 3);
            PatchPoint { at: *p, born, carrier, parents: [id(a), id(b)] }
        };
        let mut indices = Vec::new();
        let mut template = |faces: Vec<GridTriangle>| {
            let first = indices.len() as u32;
            indices.extend(faces.iter().flatten().map(|p| id(*p)));
            Template { first, triangles: faces.len() as u32 }
        };
        let row = |(triangles, next): (&Vec<GridTriangle>, &BTreeSet<GridPoint>)| {
            let with = |s| triangles.iter().flat_map(|t| split_sides(*t, s, next)).collect();
            [0, 1, 2, 3, 4, 5, 6, 7].map(|sides| template(with(sides)))
        };
        let templates = levels.iter().zip(&sides[1..]).map(row).collect();
        let middle = |ends: [u32; 2]| {
            let [p, q] = ends.map(|i| at[i as usize]);
            let middle = is_whole(p, q, 2).then(|| part(p, q, 1, 2))?;
            at.binary_search(&middle).ok().map(|i| i as u32)
        };
        let edges = |triangles: &Vec<GridTriangle>| {
            let ends = triangles.iter().flat_map(edges_of).map(|(p, q)| [id(p), id(q)]);
            let once: BTreeSet<[u32; 2]> = ends.map(|[a, b]| [a.min(b), a.max(b)]).collect();
            once.into_iter().map(|ends| PatchEdge { ends, middle: middle(ends) }).collect()
        };
        let edges = levels.iter().map(edges).collect();
        Self { steps, points: at.iter().map(point).collect(), indices, templates, edges }
    }

    /// The finest level.
    pub fn finest(&self) -> u32 {
        self.templates.len() as u32 - 1
    }

    /// The template of a level; bit e of `sides` says that the side from corner e is split.
    pub fn template(&self, level: u32, sides: u32) -> Template {
        self.templates[level as usize][sides as usize]
    }

    /// Triangles of a level.
    pub fn triangles(&self, level: u32) -> u64 {
        u64::from(self.template(level, 0).triangles)
    }

    /// Edges of a level, each once.
    pub fn edges(&self, level: u32) -> &[PatchEdge] {
        &self.edges[level as usize]
    }

    /// Triangles of a template, as indices of points.
    pub fn faces(&self, t: Template) -> impl Iterator<Item = [usize; 3]> + '_ {
        let own = &self.indices[t.first as usize..][..3 * t.triangles as usize];
        own.chunks_exact(3).map(|t| [t[0] as usize, t[1] as usize, t[2] as usize])
    }
}

fn edges_of(t: &GridTriangle) -> [(GridPoint, GridPoint); 3] {
    [0, 1, 2].map(|e| (t[e], t[(e + 1) % 3]))
}

/// Points on the sides of a patch by level, and those of one level more.
fn points_on_sides(levels: &[Vec<GridTriangle>], beyond: u32) -> Vec<BTreeSet<GridPoint>> {
    let on_sides = |level: &Vec<GridTriangle>| {
        level.iter().flatten().copied().filter(|p| p.contains(&0)).collect()
    };
    let mut sides: Vec<BTreeSet<GridPoint>> = levels.iter().map(on_sides).collect();
    let finest = levels.last().into_iter().flatten();
    let segments = finest.flat_map(edges_of).filter(|(p, q)| side_of(*p, *q).is_some());
    let new = segments.flat_map(|(p, q)| (1..beyond).map(move |i| part(p, q, i, beyond)));
    let next = sides.last().into_iter().flatten().copied().chain(new).collect();
    sides.push(next);
    sides
}

/// The level at which each point is inserted.
fn levels_of_birth(
    levels: &[Vec<GridTriangle>],
    sides: &[BTreeSet<GridPoint>],
) -> HashMap<GridPoint, u32> {
    let mut born = HashMap::new();
    for (level, on_sides) in (0..).zip(sides) {
        let inside = levels.get(level as usize).into_iter().flatten().flatten();
        inside.chain(on_sides).for_each(|p| {
            born.entry(*p).or_insert(level);
        });
    }
    born
}

/// The edge of a level of which a point is the middle.
fn edge_split_at(level: &[GridTriangle], p: GridPoint) -> Option<(GridPoint, GridPoint)> {
    let halves = |a: GridPoint, b: GridPoint| (0..3).all(|k| a[k] + b[k] == 2 * p[k]);
    level.iter().flat_map(edges_of).find(|(a, b)| halves(*a, *b))
}

/// The point `i` of `n` parts along an edge.
fn part(p: GridPoint, q: GridPoint, i: u32, n: u32) -> GridPoint {
    [0, 1, 2].map(|k| (p[k] * (n - i) + q[k] * i) / n)
}

/// The side of the patch on which an edge lies.
fn side_of(p: GridPoint, q: GridPoint) -> Option<usize> {
    // The side opposite corner k has coordinate k = 0 and begins at k + 1.
    (0..3).find(|k| p[*k] == 0 && q[*k] == 0).map(|k| (k + 1) % 3)
}

/// A triangle, split at the points `next` that lie within its edges on sides of the set `sides`.
fn split_sides(t: GridTriangle, sides: usize, next: &BTreeSet<GridPoint>) -> Vec<GridTriangle> {
    let within = edges_of(&t).map(|(p, q)| {
        let chosen = side_of(p, q).is_some_and(|side| sides >> side & 1 == 1);
        let splits = |n: &u32| chosen && is_whole(p, q, *n) && next.contains(&part(p, q, 1, *n));
        let parts = [2, 3].into_iter().find(splits).unwrap_or(1);
        (1..parts).map(|i| part(p, q, i, parts)).collect::<Vec<_>>()
    });
    let mut faces = Vec::new();
    match within.iter().position(|w| w.len() > 1) {
        // In three: a fan. Only one side of such a triangle is on a side of the patch.
        Some(e) => {
            let (p, q, apex) = (t[e], t[(e + 1) % 3], t[(e + 2) % 3]);
            faces.extend([[p, within[e][0], apex], [within[e][0], within[e][1], apex]]);
            faces.push([within[e][1], q, apex]);
        }
        None => template(t, within.map(|w| w.first().copied()), &mut faces),
    }
    faces
}

/// Whether the first of `n` parts along an edge ends at a point of the grid.
fn is_whole(p: GridPoint, q: GridPoint, n: u32) -> bool {
    (0..3).all(|k| (p[k] * (n - 1) + q[k]).is_multiple_of(n))
}

/// Levels of 4-8 subdivision: triangles (a, b, c) whose next split side is (a, b), opposite the
/// newest corner c.
fn four_eight_levels() -> Vec<Vec<GridTriangle>> {
    let n = FOUR_EIGHT_STEPS;
    let [a, b, c] = [[n, 0, 0], [0, n, 0], [0, 0, n]];
    let m = [n / 3; 3];
    let mut levels = vec![vec![[a, b, m], [b, c, m], [c, a, m]]];
    for _ in 1..LEVELS {
        let bisect = |[a, b, c]: &GridTriangle| {
            let m = part(*a, *b, 1, 2);
            [[*c, *a, m], [*b, *c, m]]
        };
        let next = levels[levels.len() - 1].iter().flat_map(bisect).collect();
        levels.push(next);
    }
    levels
}

/// Levels of √3 subdivision: at even levels the sides are in three parts, and all within is a grid;
/// at odd ones each of its triangles has a vertex at its centre and edges within are flipped.
fn sqrt3_levels() -> Vec<Vec<GridTriangle>> {
    let even =
        |n: u32| triangles(n).map(move |t| t.map(|p| p.map(|c| c * (SQRT3_STEPS / n)))).collect();
    let odd = |n: u32| {
        let grid: Vec<GridTriangle> = even(n);
        let centre = |t: &GridTriangle| [0, 1, 2].map(|k| (t[0][k] + t[1][k] + t[2][k]) / 3);
        let left: HashMap<(GridPoint, GridPoint), GridPoint> =
            grid.iter().flat_map(|t| edges_of(t).map(|e| (e, centre(t)))).collect();
        let mut faces = Vec::new();
        for t in &grid {
            for (p, q) in edges_of(t) {
                match left.get(&(q, p)) {
                    None => faces.push([p, q, centre(t)]),
                    // Each of the two triangles at the edge makes one of the new ones.
                    Some(beyond) => faces.push([p, *beyond, centre(t)]),
                }
            }
        }
        faces
    };
    vec![even(1), odd(1), even(3), odd(3), even(SQRT3_STEPS)]
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

    const ALL: [Scheme; 3] = [Scheme::OneToFour, Scheme::Sqrt3, Scheme::FourEight];

    #[test]
    fn templates_tile_the_patch_and_split_exactly_the_given_sides() {
        for scheme in ALL {
            let shape = PatchShape::of(scheme);
            let whole = i64::from(shape.steps * shape.steps);
            // Parts of a side, by level.
            let parts = |level: u32| match scheme {
                Scheme::Sqrt3 => 3usize.pow(level / 2),
                Scheme::FourEight => 1 << level.div_ceil(2),
                _ => 1 << level,
            };
            for level in 0..=shape.finest() {
                for sides in 0..8 {
                    let t = shape.template(level, sides);
                    let at = |i: usize| shape.points[i].at;
                    let faces: Vec<_> = shape.faces(t).map(|t| t.map(at)).collect();
                    assert!(faces.iter().all(|t| twice_area(*t) > 0), "{scheme:?} {level}");
                    assert_eq!(faces.iter().map(|t| twice_area(*t)).sum::<i64>(), whole);
                    for e in 0..3 {
                        let on = |p: GridPoint| p[(e + 2) % 3] == 0;
                        let along = faces.iter().flat_map(edges_of);
                        let along = along.filter(|(p, q)| on(*p) && on(*q)).count();
                        let wanted = parts(level + (sides >> e & 1));
                        assert_eq!(along, wanted, "{scheme:?} {level} {sides:03b} {e}");
                    }
                }
            }
        }
    }

    #[test]
    fn schemes_have_three_two_and_four_times_the_triangles_at_each_level() {
        let triangles = |scheme| {
            let shape = PatchShape::of(scheme);
            (0..=shape.finest()).map(|l| shape.triangles(l)).collect::<Vec<_>>()
        };
        assert_eq!(triangles(Scheme::OneToFour), [1, 4, 16, 64]);
        assert_eq!(triangles(Scheme::Sqrt3), [1, 3, 9, 27, 81]);
        assert_eq!(triangles(Scheme::FourEight), [3, 6, 12, 24, 48, 96]);
    }

    /// Neighbours of vertices inside: six for 1-to-4 and √3, four or eight for 4-8 and fewer on its
    /// newest triangles.
    #[test]
    fn vertices_inside_have_the_neighbours_of_their_scheme() {
        for (scheme, wanted) in [
            (Scheme::OneToFour, &[6][..]),
            (Scheme::Sqrt3, &[6]),
            (Scheme::FourEight, &[3, 4, 6, 8]),
        ] {
            let shape = PatchShape::of(scheme);
            let mut around = vec![0; shape.points.len()];
            for e in shape.edges(shape.finest()) {
                e.ends.iter().for_each(|i| around[*i as usize] += 1);
            }
            let inside = shape.points.iter().zip(around).filter(|(p, _)| !p.at.contains(&0));
            let found: BTreeSet<i32> = inside.map(|(_, n)| n).filter(|n| *n > 0).collect();
            assert!(found.iter().all(|n| wanted.contains(n)), "{scheme:?}: {found:?}");
        }
    }

    #[test]
    fn parents_of_a_point_are_older_and_on_its_side() {
        for scheme in ALL {
            let shape = PatchShape::of(scheme);
            for p in &shape.points {
                let [a, b] = p.parents.map(|q| shape.points[q as usize]);
                for k in 0..3 {
                    assert_eq!(a.at[k] + b.at[k], 2 * p.at[k]);
                    assert!(p.at[k] > 0 || a.at[k] == 0 && b.at[k] == 0);
                }
                let older = a.born < p.born && b.born < p.born;
                assert!(p.born == 0 || older || !scheme.morphs());
            }
        }
    }
}
