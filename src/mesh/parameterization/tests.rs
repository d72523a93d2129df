use std::collections::BTreeMap;

use glam::DVec3;
use rayon::prelude::*;

use super::*;
use driver::{Dice, diagonal, patch, point, simplify, sphere, torus, tube};

mod driver;
mod meshes;
mod overlay;
mod ring;

/// Round trips err by less than this share of the box.
const ROUND_TRIP: f64 = 1e-9;
/// Both sides of an edge agree to this share of the box.
const CONTINUITY: f64 = 1e-5;

/// A mesh and its parameterisation over what is left of it.
struct Case {
    name: &'static str,
    mesh: Mesh,
    maps: Parameterization,
}

/// Closed meshes of genus 0 and 1, and open ones, reduced to a tenth.
fn cases() -> Vec<Case> {
    let meshes = [("sphere", sphere(4)), ("torus", torus()), ("tube", tube()), ("patch", patch())];
    let case = |(name, mesh): (&'static str, Mesh)| {
        let mut maps = Parameterization::new(&mesh).expect("small enough");
        let left = simplify(&mesh, mesh.faces.len() / 10, 7, &mut maps);
        let slots = left.iter().enumerate();
        let base: Vec<_> = slots.filter_map(|(s, t)| Some((s as u32, (*t)?))).collect();
        assert_eq!(maps.base_faces().collect::<Vec<_>>(), base, "{name}: base faces");
        assert!(base.len() < mesh.faces.len() / 6, "{name}: {} faces left", base.len());
        Case { name, mesh, maps }
    };
    meshes.into_iter().map(case).collect()
}

impl Parameterization {
    /// [`Parameterization::to_base`] of many places.
    fn to_base_all(&self, at: &[MeshPoint]) -> Result<Vec<MappedPoint>, ParameterizationError> {
        at.par_iter().map(|p| self.to_base(*p)).collect()
    }

    /// [`Parameterization::to_fine`] of many places.
    fn to_fine_all(&self, at: &[MeshPoint]) -> Result<Vec<MappedPoint>, ParameterizationError> {
        at.par_iter().map(|p| self.to_fine(*p)).collect()
    }
}

/// Random points on faces named by `ids`.
fn places(ids: &[u32], n: usize, seed: u64) -> Vec<MeshPoint> {
    let mut dice = Dice::new(seed);
    let place = |_| MeshPoint { face: ids[dice.below(ids.len())], weights: dice.weights() };
    (0..n).map(place).collect()
}

/// Largest distance between points and their images after mapping to the base and back.
fn fine_round_trip(mesh: &Mesh, maps: &Parameterization, at: &[MeshPoint]) -> f64 {
    let base: Vec<MeshPoint> = maps.to_base_all(at).unwrap().iter().map(|m| m.at).collect();
    let back = maps.to_fine_all(&base).unwrap();
    let gap = |(a, b): (&MeshPoint, &MappedPoint)| (point(mesh, *a) - point(mesh, b.at)).length();
    at.iter().zip(&back).map(gap).fold(0.0, f64::max)
}

/// Position of a base point on the flat base mesh.
fn base_point(mesh: &Mesh, faces: &BTreeMap<u32, [u32; 3]>, at: MeshPoint) -> DVec3 {
    let corners = faces[&at.face].map(|v| DVec3::from(mesh.positions[v as usize]));
    corners.into_iter().zip(at.weights).map(|(p, w)| p * w).sum()
}

/// Largest distance between the images of a base edge's points by its two faces.
fn widest_gap(mesh: &Mesh, maps: &Parameterization, fine: impl Fn(MeshPoint) -> MeshPoint) -> f64 {
    let mut sides: BTreeMap<(u32, u32), Vec<(u32, usize)>> = BTreeMap::new();
    for (slot, t) in maps.base_faces() {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            sides.entry((a.min(b), a.max(b))).or_default().push((slot, k));
        }
    }
    let faces: BTreeMap<u32, [u32; 3]> = maps.base_faces().collect();
    let mut widest = 0.0f64;
    for (&(low, _), sides) in &sides {
        let [one, other] = sides[..] else { continue };
        for i in 0..100 {
            let x = (f64::from(i) + 0.5) / 100.0;
            let [p, q] = [one, other].map(|(face, k)| {
                let mut weights = [0.0; 3];
                let ahead = faces[&face][k] == low;
                weights[k] = if ahead { 1.0 - x } else { x };
                weights[(k + 1) % 3] = 1.0 - weights[k];
                point(mesh, fine(MeshPoint { face, weights }))
            });
            widest = widest.max((p - q).length());
        }
    }
    widest
}

#[test]
fn points_come_back_from_both_round_trips() {
    for Case { name, mesh, maps } in cases() {
        let bound = ROUND_TRIP * diagonal(&mesh);
        let all: Vec<u32> = (0..mesh.faces.len() as u32).collect();
        let gap = fine_round_trip(&mesh, &maps, &places(&all, 20_000, 1));
        assert!(gap <= bound, "{name}: original to base and back: {gap:e}");

        let faces: BTreeMap<u32, [u32; 3]> = maps.base_faces().collect();
        let ids: Vec<u32> = faces.keys().copied().collect();
        for at in places(&ids, 20_000, 2) {
            let back = maps.to_base(maps.to_fine(at).unwrap().at).unwrap().at;
            let gap = (base_point(&mesh, &faces, at) - base_point(&mesh, &faces, back)).length();
            assert!(gap <= bound, "{name}: base to original and back: {gap:e}");
        }
    }
}

#[test]
fn both_faces_of_every_base_edge_put_its_points_in_one_place() {
    for Case { name, mesh, maps } in cases() {
        let gap = widest_gap(&mesh, &maps, |p| maps.to_fine(p).unwrap().at);
        assert!(gap <= CONTINUITY * diagonal(&mesh), "{name}: {gap:e}");
    }
}

/// Weights taken in another order at every hop: invisible to a round trip that turns them back.
#[test]
fn weights_in_the_wrong_order_pass_the_round_trip_but_tear_base_edges_apart() {
    for Case { name, mesh, maps } in cases() {
        let fine = |p| maps.to_fine_with(p, |[a, b, c]| [b, c, a]).unwrap().at;
        let base = |p| maps.to_base_with(p, |[a, b, c]| [c, a, b]).unwrap().at;
        let ids: Vec<u32> = maps.base_faces().map(|f| f.0).collect();
        let faces: BTreeMap<u32, [u32; 3]> = maps.base_faces().collect();
        // Not on edges, where the torn map has two answers.
        let inner = |at: &MeshPoint| at.weights.iter().all(|w| *w > 1e-4);
        for at in places(&ids, 2000, 3).into_iter().filter(inner) {
            let gap = base_point(&mesh, &faces, at) - base_point(&mesh, &faces, base(fine(at)));
            assert!(gap.length() <= ROUND_TRIP * diagonal(&mesh), "{name}: {gap}");
        }
        let gap = widest_gap(&mesh, &maps, fine);
        assert!(gap > 0.01 * diagonal(&mesh), "{name}: the fault went unnoticed: {gap:e}");
    }
}

#[test]
fn every_removed_vertex_is_found_by_its_tuple_and_every_other_where_it_was() {
    for Case { name, mesh, maps } in cases() {
        let tuples = maps.removed_vertices();
        assert_eq!(tuples.len(), maps.collapses(), "{name}");
        let kept = maps.base_faces().flat_map(|(face, t)| {
            [0, 1, 2].map(|k| {
                let mut weights = [0.0; 3];
                weights[k] = 1.0;
                RemovedVertex { vertex: t[k], at: MeshPoint { face, weights } }
            })
        });
        let mut seen = vec![false; mesh.positions.len()];
        for RemovedVertex { vertex, at } in tuples.iter().copied().chain(kept) {
            let found = point(&mesh, maps.to_fine(at).unwrap().at);
            let gap = (found - DVec3::from(mesh.positions[vertex as usize])).length();
            assert!(gap <= ROUND_TRIP * diagonal(&mesh), "{name}: vertex {vertex}: {gap:e}");
            seen[vertex as usize] = true;
        }
        assert!(seen.iter().all(|s| *s), "{name}: a vertex without a place");
    }
}

/// Share of faces turned away from the original surface after each base face is divided in
/// 4^level and its points are mapped.
fn turned(mesh: &Mesh, maps: &Parameterization, level: u32) -> f64 {
    let n = 1u32 << level;
    let (mut turned, mut all) = (0, 0);
    let cross = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
    for (face, _) in maps.base_faces() {
        let at = |i: u32, j: u32, third: f64| {
            let (a, b) =
                ((f64::from(i) + third) / f64::from(n), (f64::from(j) + third) / f64::from(n));
            maps.to_fine(MeshPoint { face, weights: [1.0 - a - b, a, b] }).unwrap().at
        };
        for i in 0..n {
            for j in 0..n - i {
                let up = [(i, j), (i + 1, j), (i, j + 1)];
                let down = [(i + 1, j), (i + 1, j + 1), (i, j + 1)];
                let middle = [(i, j, 1.0 / 3.0), (i, j, 2.0 / 3.0)];
                let some = if i + j + 1 < n { 2 } else { 1 };
                for ((i, j, third), corners) in middle.into_iter().zip([up, down]).take(some) {
                    let original = mesh.faces[at(i, j, third).face as usize];
                    let normal = cross(original.map(|v| DVec3::from(mesh.positions[v as usize])));
                    let divided = cross(corners.map(|(i, j)| point(mesh, at(i, j, 0.0))));
                    all += 1;
                    let ahead = divided.dot(normal) > 0.0;
                    turned += i32::from(!ahead);
                }
            }
        }
    }
    f64::from(turned) / f64::from(all)
}

#[test]
fn base_faces_divided_three_times_follow_the_surface_without_turning_over() {
    for Case { name, mesh, maps } in cases() {
        let share = turned(&mesh, &maps, 3);
        assert!(share < 0.005, "{name}: {:.2} % of faces turned", 100.0 * share);
    }
}

/// Every original face cut along all fans on its way down, exactly: the pieces that end in a base
/// face fill it once.
#[test]
fn the_faces_of_the_original_fill_every_base_face_exactly_once() {
    for Case { name, mesh, maps } in cases() {
        let mut filled: BTreeMap<u32, f64> = maps.base_faces().map(|f| (f.0, 0.0)).collect();
        let mut checked = 0;
        for face in 0..mesh.faces.len() as u32 {
            for piece in overlay::pieces(&maps, face) {
                assert!(piece.area > 0.0, "{name}: a piece of face {face} is turned over");
                *filled.get_mut(&piece.base.face).expect("a base face") += piece.area;
                // The evaluation agrees with the cutting, one piece in three.
                if piece.area > 1e-6 && face % 3 == 0 {
                    let there = maps.to_base(piece.fine).unwrap().at;
                    assert_eq!(there.face, piece.base.face, "{name}: face {face}");
                    for (a, b) in there.weights.iter().zip(piece.base.weights) {
                        assert!((a - b).abs() < 1e-8, "{name}: face {face}: {a} or {b}");
                    }
                    checked += 1;
                }
            }
        }
        assert!(checked > 500, "{name}: {checked} pieces compared");
        for (slot, area) in filled {
            assert!((area - 1.0).abs() < 1e-8, "{name}: base face {slot} filled {area} times");
        }
    }
}

#[test]
fn results_are_the_same_bytes_at_any_number_of_threads() {
    let mesh = torus();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut maps = Parameterization::new(&mesh).unwrap();
            simplify(&mesh, 300, 3, &mut maps);
            let ids: Vec<u32> = (0..mesh.faces.len() as u32).collect();
            let down = maps.to_base_all(&places(&ids, 5000, 4)).unwrap();
            let removed = maps.removed_vertices();
            (maps, removed, down)
        })
    };
    assert_eq!(run(1), run(4));
}

#[test]
fn faces_that_are_not_there_are_refused_and_odd_weights_give_no_odd_numbers() {
    let Case { mesh, maps, .. } = cases().swap_remove(1);
    let at = |face, weights| MeshPoint { face, weights };
    let gone = (0..mesh.faces.len() as u32).find(|f| maps.base_faces().all(|b| b.0 != *f)).unwrap();
    for face in [mesh.faces.len() as u32, u32::MAX] {
        let answer = maps.to_base(at(face, [1.0, 0.0, 0.0]));
        assert!(
            matches!(answer, Err(ParameterizationError::NoFace { mesh: "original", .. })),
            "{answer:?}"
        );
    }
    for face in [gone, mesh.faces.len() as u32, u32::MAX] {
        let answer = maps.to_fine_all(&[at(face, [1.0, 0.0, 0.0])]);
        assert!(
            matches!(answer, Err(ParameterizationError::NoFace { mesh: "base", .. })),
            "{answer:?}"
        );
    }
    let odd =
        [0.0, -0.0, -1.0, 1e-320, 1e300, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX];
    for (a, b, c) in odd.iter().flat_map(|a| odd.iter().flat_map(move |b| odd.map(|c| (*a, *b, c))))
    {
        for face in 0..40 {
            let there = maps.to_base(at(face, [a, b, c])).unwrap().at;
            let sum: f64 = there.weights.iter().sum();
            assert!(there.weights.iter().all(|w| *w >= 0.0) && (sum - 1.0).abs() < 1e-12);
            assert!(point(&mesh, maps.to_fine(there).unwrap().at).is_finite());
        }
    }
}
