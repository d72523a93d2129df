//! Moves a vertex to the minimum of its quadric after others collapsed onto it.

use glam::DVec3;

use super::HalfEdges;
use super::halfedge::prev;
use super::quadric::Quadric;

/// cos² of the largest angle that a face may turn by in one move, 30°.
const COS2_TURN: f64 = 0.75;
/// Largest step, as a share of the vertex's shortest edge.
const MAX_STEP: f64 = 0.5;

/// The minimum of the quadric of `v`, now at `at(v)`, or the point half or a quarter of the way
/// there: the first where no face around turns too much. `None` if there is none, or the quadric is
/// not less there.
pub fn better_place(
    edges: &HalfEdges,
    v: u32,
    quadric: &Quadric,
    at: impl Fn(u32) -> DVec3,
) -> Option<DVec3> {
    let old = at(v);
    let ring = || edges.around(v).map(|h| edges.target(h));
    let shortest2 = ring().map(|w| at(w).distance_squared(old)).fold(f64::INFINITY, f64::min);
    let step = quadric.step_to_minimum(old, MAX_STEP * shortest2.sqrt())?;
    let good = |p: DVec3| {
        edges.around(v).all(|h| {
            let (a, b) = (at(edges.target(h)), at(edges.origin(prev(h))));
            let (was, is) = ((a - old).cross(b - old), (a - p).cross(b - p));
            let along = was.dot(is);
            along > 0.0 && along * along > COS2_TURN * was.length_squared() * is.length_squared()
        })
    };
    [1.0, 0.5, 0.25]
        .map(|s| old + s * step)
        .into_iter()
        .find(|p| good(*p))
        .filter(|p| p.is_finite() && quadric.at(*p) < quadric.at(old))
}
