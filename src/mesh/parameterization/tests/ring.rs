//! Single collapses of awkward shape.

use std::f64::consts::{PI, TAU};

use glam::DVec2;

use super::driver::hears;
use super::*;

/// A fan around vertex 0: ring vertices 1.. in order.
struct Fan {
    mesh: Mesh,
    boundary: bool,
}

impl Fan {
    fn new(around: &[DVec3], boundary: bool) -> Self {
        let k = around.len() as u32;
        let at = std::iter::once(DVec3::ZERO).chain(around.iter().copied());
        let last = if boundary { k - 1 } else { k };
        let faces = (0..last).map(|i| [0, 1 + i, 1 + (i + 1) % k]).collect();
        let mesh = Mesh { positions: at.map(|p| p.as_vec3()).collect(), faces, ..Mesh::default() };
        Self { mesh, boundary }
    }

    /// Vertex 0 collapsed into the first ring vertex, or the last.
    fn collapse(&self, last: bool) -> Option<Parameterization> {
        let mut maps = Parameterization::new(&self.mesh).expect("small");
        let ring: Vec<u32> = (1..self.mesh.positions.len() as u32).collect();
        let faces: Vec<u32> = (0..self.mesh.faces.len() as u32).collect();
        let to = if last { ring[ring.len() - 1] } else { ring[0] };
        let boundary = self.boundary;
        let at = |v: &u32| DVec3::from(self.mesh.positions[*v as usize]);
        let ring_at: Vec<_> = ring.iter().map(at).collect();
        let (from_at, ring_at, faces) = (at(&0), &ring_at, &faces);
        let c = Collapse { from: 0, to, ring: &ring, faces, from_at, ring_at, boundary };
        let before = Parameterization { refused: 1, ..maps.clone() };
        if hears(&mut maps, &c) {
            return Some(maps);
        }
        assert_eq!(maps, before, "a refusal leaves no trace");
        None
    }
}

/// A ring of `k` at height `z` over distance `r(i)`.
fn around(k: usize, z: f64, r: impl Fn(usize) -> f64) -> Vec<DVec3> {
    let angle = |i| i as f64 / k as f64 * TAU;
    (0..k).map(|i| DVec2::from_angle(angle(i)).extend(z) * r(i)).collect()
}

fn comes_back(name: &str, fan: &Fan, maps: &Parameterization) {
    let all: Vec<u32> = (0..fan.mesh.faces.len() as u32).collect();
    let gap = fine_round_trip(&fan.mesh, maps, &places(&all, 5000, 5));
    assert!(gap <= ROUND_TRIP * diagonal(&fan.mesh), "{name}: {gap:e}");
    let tuple = maps.removed_vertices()[0];
    let home = point(&fan.mesh, maps.to_fine(tuple.at).unwrap().at).length();
    assert!(home <= ROUND_TRIP * diagonal(&fan.mesh), "{name}: vertex found at {home:e}");
}

#[test]
fn spikes_saddles_slivers_and_long_edges_are_mapped() {
    let saddle = |k: usize| {
        let at = |i: usize| {
            let a = i as f64 / k as f64 * TAU;
            DVec3::new(a.cos(), a.sin(), [1.5, -1.5][i % 2])
        };
        (0..k).map(at).collect::<Vec<_>>()
    };
    // Cone angles: 0.3 rad (a = 21), 2.1 rad (a = 3), over 6 turns of saddle (a < 0.3).
    let rings = [
        ("flat", around(6, 0.0, |_| 1.0)),
        ("valence 3", around(3, 0.3, |_| 1.0)),
        ("spike", around(5, 21.0, |_| 0.3)),
        ("cone", around(7, 2.8, |_| 2.0)),
        ("saddle", saddle(24)),
        ("long edge", around(6, 0.1, |i| if i == 2 { 40.0 } else { 1.0 })),
        ("short edge", around(6, 0.1, |i| if i == 0 { 1e-7 } else { 1.0 })),
        ("many", around(40, 0.2, |_| 1.0)),
    ];
    for (name, ring) in rings {
        let fan = Fan::new(&ring, false);
        let maps = fan.collapse(false).unwrap_or_else(|| panic!("{name}: refused"));
        comes_back(name, &fan, &maps);
    }
}

#[test]
fn a_vertex_on_another_and_faces_without_area_do_not_stop_a_collapse() {
    let mut ring = around(6, 0.1, |_| 1.0);
    ring[0] = DVec3::ZERO;
    let fan = Fan::new(&ring, false);
    comes_back("same place", &fan, &fan.collapse(false).expect("a vertex on its neighbour"));
    let mut ring = around(6, 0.1, |_| 1.0);
    ring[3] = ring[2] * 0.5;
    let fan = Fan::new(&ring, false);
    comes_back("no area", &fan, &fan.collapse(false).expect("a face without area"));
    let fan = Fan::new(&around(5, 0.0, |_| 0.0), false);
    comes_back("all in one", &fan, &fan.collapse(false).expect("all in one place"));
}

#[test]
fn a_reflex_corner_is_mapped_where_its_fan_stays_open_and_refused_where_it_folds() {
    let dented = around(8, 0.0, |i| if i == 4 { 0.3 } else { 1.0 });
    let fan = Fan::new(&dented, false);
    comes_back("opposite", &fan, &fan.collapse(false).expect("seen from the far side"));
    let beside = around(8, 0.0, |i| if i == 1 { 0.3 } else { 1.0 });
    assert!(Fan::new(&beside, false).collapse(false).is_none(), "the fan folds behind the corner");
}

#[test]
fn boundary_vertices_are_mapped_into_both_neighbours_and_ears_are_refused() {
    for (name, turn) in [("straight", PI), ("convex corner", 0.4), ("reflex corner", 5.5)] {
        for k in [3, 4, 7] {
            let at = |i: usize| {
                let a = turn * i as f64 / (k - 1) as f64;
                DVec3::new(a.cos(), a.sin(), 0.1 * i as f64)
            };
            let fan = Fan::new(&(0..k).map(at).collect::<Vec<_>>(), true);
            for last in [false, true] {
                let maps = fan.collapse(last).unwrap_or_else(|| panic!("{name} {k}: refused"));
                comes_back(name, &fan, &maps);
                assert_eq!(maps.base_faces().count(), k - 2);
            }
        }
    }
    let ear = Fan::new(&[DVec3::X, DVec3::Y], true);
    assert!(ear.collapse(false).is_none() && ear.collapse(true).is_none());
}

#[test]
fn places_that_are_not_numbers_are_refused() {
    for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for i in 0..5 {
            let mut ring = around(5, 0.1, |_| 1.0);
            ring[i].y = odd;
            assert!(Fan::new(&ring, false).collapse(false).is_none(), "{odd} at {i}");
        }
    }
}
