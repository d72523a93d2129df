//! Simplification of a large mesh in parts, in parallel.
//!
//! Collapses in the order of their costs access a mesh at random, and nearly each of them misses the
//! cache. A part is small enough to stay in the cache, and threads share the parts. A vertex on a
//! cut is kept, and no vertex collapses onto it, so that the parts are independent: together they
//! do what one run over the whole mesh would do with those vertices locked. A last run over what is
//! left has no cuts.

use rayon::prelude::*;

use super::Log;
use super::edge_collapse::{Decimation, Placement, Stop, SubMesh};
use super::halfedge::{HalfEdges, NONE, face};
use super::input::Input;
use super::quadric::Quadric;
use super::vertex_quadrics::Freedom;
use crate::geometry::median_split::{self, KeyedPoint};
use crate::geometry::morton_code;

/// Faces of a part, at most; their working set is 1.4 MB.
const PART_FACES: usize = 12_288;
/// Meshes below this many faces are not divided.
const MIN_FACES: usize = 2 * PART_FACES;
/// Rounds end within this fraction of the target, as its reciprocal.
const NEAR: usize = 32;

/// A part and its log.
struct Part<L> {
    run: Decimation,
    log: L,
}

/// Simplifies in parts down to where the vertices on cuts are missed, and returns the run over what
/// is left, with the logs of the parts in order. `None` for a mesh too small to divide.
pub fn in_parts<L: Log>(input: &Input<'_>, stop: &Stop) -> Option<(Decimation, Vec<L>)> {
    let faces = input.mesh.faces.len();
    if faces < MIN_FACES || stop.faces > faces / 2 {
        return None;
    }
    let mut order = centroids(input);
    let mut pieces = Vec::new();
    cut(&mut order, faces.div_ceil(PART_FACES), &mut pieces);
    let mut rank = vec![NONE; faces];
    order.iter().zip(0..).for_each(|(f, i)| rank[f.id() as usize] = i);
    let scratch = || vec![NONE; input.mesh.positions.len()];
    let mut parts: Vec<Part<L>> = pieces
        .par_iter()
        .map_init(scratch, |local, &(begin, end)| {
            crate::task::checkpoint();
            let ids = order[begin..end].iter().map(KeyedPoint::id).collect();
            let inside = |f: u32| {
                let at = rank[f as usize] as usize;
                (begin..end).contains(&at).then(|| (at - begin) as u32)
            };
            Part { run: part(input, ids, inside, local), log: L::default() }
        })
        .collect();
    drop((order, rank, pieces));
    rounds(input, &mut parts, stop);
    Some(join(input, parts))
}

/// Three times the centroid of each face, with its id.
fn centroids(input: &Input<'_>) -> Vec<KeyedPoint> {
    let at = |v: &u32| input.mesh.positions[*v as usize];
    let faces = input.mesh.faces.par_iter().with_min_len(8192).enumerate();
    faces.map(|(i, f)| KeyedPoint::new(f.iter().map(at).sum(), i as u32)).collect()
}

/// Orders faces so that each of `parts` parts is contiguous, by recursive median splits; appends begin
/// and end of each. Within a part faces follow a space-filling curve.
fn cut(faces: &mut [KeyedPoint], parts: usize, ends: &mut Vec<(usize, usize)>) {
    fn halve(faces: &mut [KeyedPoint], parts: usize) -> Vec<usize> {
        if parts <= 1 {
            sort_by_morton_code(faces);
            return vec![faces.len()];
        }
        let middle = faces.len() * (parts / 2) / parts;
        let (a, b) = median_split::split(faces, middle);
        let (mut sizes, more) = rayon::join(|| halve(a, parts / 2), || halve(b, parts - parts / 2));
        sizes.extend(more);
        sizes
    }
    let mut begin = 0;
    for size in halve(faces, parts) {
        ends.push((begin, begin + size));
        begin += size;
    }
}

/// Orders faces by the Morton code of their cell in their box, then by id.
fn sort_by_morton_code(faces: &mut [KeyedPoint]) {
    let (lo, hi) = median_split::bounds(faces);
    let code = morton_code(lo, hi);
    faces.sort_by_cached_key(|f| (code(f.position()), f.id()));
}

/// The run over the faces `face_ids`; `inside` gives the index of a face among them. `local` is
/// scratch space for the vertices, all `NONE` before and after.
fn part(
    input: &Input<'_>,
    face_ids: Vec<u32>,
    inside: impl Fn(u32) -> Option<u32>,
    local: &mut [u32],
) -> Decimation {
    let mesh = input.mesh;
    let mut vertex_ids = Vec::with_capacity(face_ids.len() / 2);
    for v in face_ids.iter().flat_map(|f| mesh.faces[*f as usize]) {
        if local[v as usize] == NONE {
            local[v as usize] = vertex_ids.len() as u32;
            vertex_ids.push(v);
        }
    }
    let mut freedom: Vec<_> = vertex_ids.iter().map(|v| input.freedom[*v as usize]).collect();
    let faces = face_ids.iter().map(|&f| {
        let corners = mesh.faces[f as usize].map(|v| local[v as usize]);
        let pairs = [0, 1, 2].map(|c| {
            let pair = input.edges.pair(4 * f + c);
            if pair == NONE {
                return NONE;
            }
            if let Some(other) = inside(face(pair)) {
                return 4 * other + (pair & 3);
            }
            for c in [c, (c + 1) % 3] {
                freedom[corners[c as usize] as usize] = Freedom::Foreign;
            }
            NONE
        });
        (corners, pairs, input.edges.mark(f))
    });
    let edges = HalfEdges::from_pairs(faces, vertex_ids.len());
    vertex_ids.iter().for_each(|v| local[*v as usize] = NONE);
    Decimation::new(input, SubMesh { vertex_ids, face_ids }, edges, freedom)
}

/// Simplifies all parts in rounds: in each, every part makes its collapses up to a common cost, so
/// that in the end no part is simplified more than the others. Two faces a vertex on a cut are left
/// to the last run, which removes those vertices.
fn rounds<L: Log>(input: &Input<'_>, parts: &mut [Part<L>], stop: &Stop) {
    let mut foreign: Vec<u32> = parts.iter().flat_map(|p| p.run.foreign()).collect();
    foreign.sort_unstable();
    foreign.dedup();
    let goal = stop.faces + 2 * foreign.len();
    let mut left = input.mesh.faces.len();
    let mut costs: Vec<u64> = Vec::new();
    while left > goal + goal / NEAR {
        let wanted = left - goal;
        costs.clear();
        costs.extend(parts.iter().flat_map(|p| p.run.costs()));
        // A collapse raises the cost of its neighbours, so up to this cost there are fewer than half
        // of those wanted: a round does not overshoot the target.
        let rank = (wanted / 2).min(costs.len().saturating_sub(1));
        // Each round makes a collapse or brings a cost up to date, so the loop ends.
        let none = parts.iter().all(|p| p.run.faces() * wanted / left == 0);
        if costs.is_empty() || none {
            return;
        }
        let most = *costs.select_nth_unstable(rank).1;
        parts.par_iter_mut().for_each(|p| {
            let share = p.run.faces() * wanted / left;
            let stop = Stop { faces: p.run.faces() - share, most, ..*stop };
            p.run.run(input, &stop, &mut p.log);
        });
        left = parts.iter().map(|p| p.run.faces()).sum();
    }
}

/// A face that a part left, by input ids.
struct Left {
    id: u32,
    corners: [u32; 3],
    /// Half-edges.
    pairs: [u32; 3],
}

/// The run over what the parts left, and their logs. Each part is freed as soon as it is read.
fn join<L>(input: &Input<'_>, parts: Vec<Part<L>>) -> (Decimation, Vec<L>) {
    let mut alive: Vec<Left> = Vec::with_capacity(parts.iter().map(|p| p.run.faces()).sum());
    let mut stay: Vec<(u32, Option<(Placement, Quadric)>)> =
        Vec::with_capacity(parts.iter().map(|p| p.run.stay().count()).sum());
    let mut logs = Vec::with_capacity(parts.len());
    let (mut collapses, mut error_mm) = (0, 0f64);
    for Part { run, log } in parts {
        alive.extend(run.faces_left().map(|(id, f)| Left {
            id,
            corners: [0, 1, 2].map(|c| run.vertex_id(run.edges.origin(4 * f + c))),
            pairs: [0, 1, 2].map(|c| match run.edges.pair(4 * f + c) {
                // At a cut the pairs are those of the input: faces at cuts are kept.
                NONE => input.edges.pair(4 * id + c),
                p => 4 * run.face_id(face(p)) + (p & 3),
            }),
        }));
        stay.extend(run.vertices_left());
        collapses += run.collapses;
        error_mm = error_mm.max(run.error_mm);
        logs.push(log);
    }
    alive.sort_unstable_by_key(|f| f.id);
    stay.sort_by_key(|v| v.0);
    stay.dedup_by_key(|v| v.0);
    let mut new_face = vec![NONE; input.mesh.faces.len()];
    alive.iter().zip(0..).for_each(|(f, i)| new_face[f.id as usize] = i);
    let mut new_vertex = vec![NONE; input.mesh.positions.len()];
    stay.iter().zip(0..).for_each(|(v, i)| new_vertex[v.0 as usize] = i);
    let faces = alive.iter().map(|f| {
        // Where the adjacent face is removed, there is a boundary.
        let pairs = f.pairs.map(|pair| match new_face.get(face(pair) as usize) {
            Some(&other) if pair != NONE && other != NONE => 4 * other + (pair & 3),
            _ => NONE,
        });
        (f.corners.map(|v| new_vertex[v as usize]), pairs, input.edges.mark(f.id))
    });
    let edges = HalfEdges::from_pairs(faces, stay.len());
    let vertex_ids: Vec<u32> = stay.iter().map(|v| v.0).collect();
    let piece = SubMesh { vertex_ids, face_ids: alive.iter().map(|f| f.id).collect() };
    drop((alive, new_face, new_vertex));
    let known: Vec<_> = stay.into_iter().map(|v| v.1).collect();
    let mut run = Decimation::resume(input, piece, edges, known);
    (run.collapses, run.error_mm) = (collapses, error_mm);
    (run, logs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Mesh;
    use crate::geometry::shapes::torus;
    use crate::mesh::simplify::{left_of, whole};
    use crate::mesh::{Metric, SimplifyOptions, deviation};

    #[test]
    fn simplification_in_parts_is_as_accurate_as_in_one_piece() {
        let mesh = torus(250, 100);
        for metric in [Metric::NormalQem, Metric::Qem] {
            let options = SimplifyOptions { metric, ..SimplifyOptions::to_faces(2000) };
            let input = Input::new(&mesh, &options).unwrap();
            let stop = Stop { faces: 2000, most: u64::MAX, max_error_mm: None };
            let (mut parts, logs) = in_parts::<()>(&input, &stop).unwrap();
            assert_eq!(logs.len(), 5);
            parts.edges.check().unwrap();
            // Most collapses are made in parts, and none of them below the target.
            assert!((2000..6000).contains(&parts.faces()), "{}", parts.faces());
            let end = |run: &mut Decimation| -> Mesh {
                run.run(&input, &stop, &mut ());
                run.edges.check().unwrap();
                left_of(&mesh, run).0
            };
            let (one, cut) = (end(&mut whole(&input)), end(&mut parts));
            assert_eq!((one.faces.len(), cut.faces.len()), (2000, 2000));
            let [one, cut] = [one, cut].map(|m| deviation(&m, &mesh).unwrap().rms_mm);
            assert!(cut < 1.1 * one, "{metric:?}: {cut} and {one} mm");
        }
    }
}
