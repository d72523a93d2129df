//! Moves the vertices that stayed to where they stand best for those that went.

use glam::{DMat3, DVec3};

use super::HalfEdges;
use super::halfedge::prev;
use super::quadric::Quadric;
use super::start::Freedom;

/// Share of the quadric's own stiffness that holds a vertex where it is: across a flat or along a
/// ridge, where planes say nothing, it stays.
const HOLD: f64 = 1e-3;
/// cos of the most that a face may turn by all moves, 30°.
const COS_TURN: f64 = 0.866_025_403_784_438_6;
/// A vertex moves by this share of its shortest edge at most.
const MOST_STEP: f64 = 0.5;

/// Moves each free vertex towards the least of its quadric, by id; all the way, or half of it, or
/// a quarter, if no face around turns too much; otherwise it stays.
pub fn relocate(edges: &HalfEdges, quadrics: &[Quadric], freedom: &[Freedom], at: &mut [DVec3]) {
    let before = at.to_vec();
    for v in 0..edges.vertex_count() as u32 {
        if freedom[v as usize] != Freedom::Free || edges.out(v) == super::halfedge::NONE {
            continue;
        }
        let old = at[v as usize];
        let (slope, m) = quadrics[v as usize].slope(old);
        let trace = m.x_axis.x + m.y_axis.y + m.z_axis.z;
        if !(trace > 0.0) {
            continue;
        }
        let step = -((m + DMat3::from_diagonal(DVec3::splat(HOLD * trace))).inverse() * slope);
        let ring = || edges.around(v).map(|h| edges.target(h));
        let shortest = ring().map(|w| at[w as usize].distance(old)).fold(f64::INFINITY, f64::min);
        let step = step.clamp_length_max(MOST_STEP * shortest);
        let good = |p: DVec3| {
            edges.around(v).all(|h| {
                let (a, b) = (edges.target(h) as usize, edges.origin(prev(h)) as usize);
                let was = (before[a] - before[v as usize]).cross(before[b] - before[v as usize]);
                let is = (at[a] - p).cross(at[b] - p);
                was.dot(is) > COS_TURN * was.length() * is.length()
            })
        };
        let goal = [1.0, 0.5, 0.25].map(|s| old + s * step).into_iter().find(|p| good(*p));
        at[v as usize] = goal.unwrap_or(old);
    }
}
