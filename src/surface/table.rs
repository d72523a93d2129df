//! The 256-case table of the cell extraction, built once from a rule instead of typed in.
//!
//! Corner `c` of a cell is at (c & 1, c >> 1 & 1, c >> 2); bit c of a case says it is inside. On a
//! face whose inside corners are diagonal, inside corners are separated: the mesh then realises
//! 6-connectivity of the inside and 18 of the outside. A polygon is triangulated without a chord
//! between two points of one face, so that every mesh edge belongs to exactly two triangles.
//!
//! Rule after Nielson 2003, doi:10.1109/TVCG.2003.1207437, and Lorensen & Cline 1987,
//! doi:10.1145/37401.37422, whose table this replaces: theirs is ambiguous.

use std::sync::LazyLock;

/// An edge of the cell: its lower corner and its axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellEdge {
    /// Index of the corner with the smaller coordinate.
    pub corner: u8,
    /// Axis of the edge: 0 x, 1 y, 2 z.
    pub axis: u8,
}

/// Edges of the cell: index `corner_rank + 4 axis`.
pub const EDGES: [CellEdge; 12] = {
    let low = [[0, 2, 4, 6], [0, 1, 4, 5], [0, 1, 2, 3]];
    let mut e = [CellEdge { corner: 0, axis: 0 }; 12];
    let mut i = 0;
    while i < 12 {
        e[i] = CellEdge { corner: low[i / 4][i % 4], axis: (i / 4) as u8 };
        i += 1;
    }
    e
};

/// Corners of each face, counter-clockwise seen from outside the cell.
const FACES: [[u8; 4]; 6] =
    [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// Triangles of every case, as triples of edge indices; normals by the right-hand rule point to
/// the inside corners.
pub static TRIANGLES: LazyLock<[Vec<[u8; 3]>; 256]> =
    LazyLock::new(|| std::array::from_fn(|case| triangles(case as u8)));

fn edge_between(a: u8, b: u8) -> u8 {
    let (corner, axis) = (a & b, (a ^ b).trailing_zeros() as u8);
    EDGES.iter().position(|e| e.corner == corner && e.axis == axis).expect("adjacent corners") as u8
}

/// Returns the faces an edge lies on, as bits.
fn faces_of(edge: u8) -> u8 {
    let e = EDGES[edge as usize];
    let (a, b) = (e.corner, e.corner | 1 << e.axis);
    (0..6).filter(|&f| FACES[f].contains(&a) && FACES[f].contains(&b)).fold(0, |m, f| m | 1 << f)
}

/// Returns the closed polygons of a case.
fn polygons(case: u8) -> Vec<Vec<u8>> {
    let inside = |c: u8| case >> c & 1 != 0;
    let mut next = [None; 12];
    for face in FACES {
        for i in 0..4 {
            // A run of inside corners starts at i; it ends at the first outside corner after it.
            let (before, first) = (face[(i + 3) % 4], face[i]);
            if inside(before) || !inside(first) {
                continue;
            }
            let last = (0..4).map(|k| (i + k) % 4).take_while(|&k| inside(face[k])).last();
            let last = last.expect("the run holds its first corner");
            let enters = edge_between(before, first);
            let leaves = edge_between(face[last], face[(last + 1) % 4]);
            next[leaves as usize] = Some(enters);
        }
    }
    let mut loops = Vec::new();
    for start in 0..12u8 {
        let mut polygon = Vec::new();
        let mut at = start;
        while let Some(to) = next[at as usize].take() {
            polygon.push(at);
            at = to;
        }
        if !polygon.is_empty() {
            loops.push(polygon);
        }
    }
    loops
}

/// Returns the first triangulation, in lexical order, without chords inside a face.
fn triangulate(polygon: &[u8]) -> Option<Vec<[u8; 3]>> {
    let n = polygon.len();
    if n < 3 {
        return Some(Vec::new());
    }
    // The triangle on the side from the last to the first point, with every possible third.
    (1..n - 1).find_map(|k| {
        let chord = |i: usize, j: usize| {
            j == i + 1 || (i == 0 && j == n - 1) || faces_of(polygon[i]) & faces_of(polygon[j]) == 0
        };
        if !chord(0, k) || !chord(k, n - 1) {
            return None;
        }
        let mut out = triangulate(&polygon[..=k])?;
        out.push([polygon[0], polygon[k], polygon[n - 1]]);
        out.extend(triangulate(&polygon[k..])?);
        Some(out)
    })
}

fn triangles(case: u8) -> Vec<[u8; 3]> {
    polygons(case)
        .iter()
        .flat_map(|p| triangulate(p).expect("every polygon of the rule has such a triangulation"))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn a_lone_inside_corner_has_a_triangle_that_faces_it() {
        let t = &TRIANGLES[1];
        assert_eq!(t.len(), 1);
        let at = |e: u8| {
            let e = EDGES[e as usize];
            let mut p = [e.corner & 1, e.corner >> 1 & 1, e.corner >> 2].map(f32::from);
            p[e.axis as usize] += 0.5;
            glam::Vec3::from(p)
        };
        let [a, b, c] = t[0].map(at);
        assert!((b - a).cross(c - a).dot(glam::Vec3::ZERO - a) > 0.0);
    }

    #[test]
    fn every_case_uses_each_crossed_edge_and_closes_inside_the_cell() {
        for case in 0..=255u8 {
            let mut count: BTreeMap<(u8, u8), i32> = BTreeMap::new();
            let mut used = 0u16;
            for t in &TRIANGLES[case as usize] {
                for k in 0..3 {
                    used |= 1 << t[k];
                    *count.entry((t[k], t[(k + 1) % 3])).or_default() += 1;
                }
            }
            for (i, e) in EDGES.iter().enumerate() {
                let other = e.corner | 1 << e.axis;
                let crossed = (case >> e.corner ^ case >> other) & 1 != 0;
                assert_eq!(used >> i & 1 != 0, crossed, "case {case} edge {i}");
            }
            for ((a, b), n) in &count {
                assert_eq!(*n, 1, "case {case}");
                let shared = count.contains_key(&(*b, *a));
                let on_face = faces_of(*a) & faces_of(*b) != 0;
                assert!(shared != on_face, "case {case}: edge {a}-{b}");
            }
        }
    }

    /// All 2^12 pairs of cells that share a face agree on the segments in it, each in opposite
    /// directions, for all three directions.
    #[test]
    fn neighbouring_cells_agree_on_their_shared_face() {
        for axis in 0..3u8 {
            // Corners of the face at the upper end of `axis`, and their twins at the lower end.
            let upper: Vec<u8> = (0..8).filter(|c| c >> axis & 1 == 1).collect();
            for bits in 0..4096u16 {
                let (own, shared, other) = (bits & 15, bits >> 4 & 15, bits >> 8);
                let case = |on_face: u16, far: u16, face_up: bool| {
                    let mut case = 0u8;
                    for (i, &u) in upper.iter().enumerate() {
                        let (f, b) = if face_up { (u, u ^ 1 << axis) } else { (u ^ 1 << axis, u) };
                        case |= ((on_face >> i & 1) as u8) << f | ((far >> i & 1) as u8) << b;
                    }
                    case
                };
                let segments = |case: u8, face_up: bool| {
                    let mut out: Vec<(u8, u8)> = Vec::new();
                    for t in &TRIANGLES[case as usize] {
                        for k in 0..3 {
                            let ends = [t[k], t[(k + 1) % 3]].map(|e| EDGES[e as usize]);
                            let on = |e: &CellEdge| {
                                e.axis != axis && (e.corner >> axis & 1 == 1) == face_up
                            };
                            if ends.iter().all(on) {
                                let id = |e: CellEdge| (e.corner & !(1 << axis)) * 3 + e.axis;
                                out.push((id(ends[0]), id(ends[1])));
                            }
                        }
                    }
                    out.sort_unstable();
                    out
                };
                let a = segments(case(shared, own, true), true);
                let mut b: Vec<_> = segments(case(shared, other, false), false)
                    .iter()
                    .map(|s| (s.1, s.0))
                    .collect();
                b.sort_unstable();
                assert_eq!(a, b, "axis {axis} case {bits:012b}");
            }
        }
    }
}
