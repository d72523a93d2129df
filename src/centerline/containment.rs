//! Proof that a curve stays inside.

use glam::{DVec3, IVec3};

use crate::field::Sampler;
use crate::lumen::Lumen;

/// Numbers of a curve's segments by the way they were proven to stay inside.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Proof {
    /// Number of segments proven by the distance field: every point keeps a voxel's diagonal from
    /// external voxel centres.
    pub by_distance: usize,
    /// Number of segments proven by walking the voxels they cross, all of them inside.
    pub by_voxels: usize,
    /// Number of points of the smooth curve that were replaced by the voxel route.
    pub replaced: usize,
}

/// Whether a segment (local mm) stays a voxel's diagonal away from every external voxel centre.
///
/// The trilinear distance has a Lipschitz constant of at most √3; between two ends it falls below
/// their mean by at most √3/2 of their distance.
pub fn safe_by_distance(a: DVec3, b: DVec3, distance: Sampler<'_>) -> bool {
    let r = distance.lumen.grid.diagonal_mm();
    let slack = 0.5 * 3f64.sqrt() * a.distance(b);
    distance.at(a).min(distance.at(b)) >= r + slack
}

/// Whether every voxel a segment (local mm) touches is inside: an exact walk over voxel faces.
pub fn safe_by_voxels(a: DVec3, b: DVec3, lumen: &Lumen) -> bool {
    let h = lumen.grid.spacing_mm;
    // Voxel centres are integers: voxel v spans v - 1/2 to v + 1/2.
    let (a, b) = (a / h + 0.5, b / h + 0.5);
    let mut v = a.floor().as_ivec3();
    let end = b.floor().as_ivec3();
    let d = b - a;
    // An axis along which nothing changes is never stepped along.
    let way = d.signum().as_ivec3();
    let mut next = [0.0f64; 3];
    let mut each = [f64::INFINITY; 3];
    for k in 0..3 {
        let face = if way[k] > 0 { f64::from(v[k]) + 1.0 } else { f64::from(v[k]) };
        next[k] = if d[k] == 0.0 { f64::INFINITY } else { (face - a[k]) / d[k] };
        each[k] = if d[k] == 0.0 { f64::INFINITY } else { (1.0 / d[k]).abs() };
    }
    let limit = (end - v).abs().element_sum() + 3;
    for _ in 0..=limit {
        if !lumen.holds(v) {
            return false;
        }
        let k = (0..3).min_by(|&i, &j| next[i].total_cmp(&next[j])).unwrap_or(0);
        if next[k] > 1.0 {
            return lumen.holds(end);
        }
        v[k] += way[k];
        next[k] += each[k];
    }
    lumen.holds(end)
}

/// Whether a segment (local mm) can be proven inside one way or the other.
pub fn safe(a: DVec3, b: DVec3, distance: Sampler<'_>) -> bool {
    safe_by_distance(a, b, distance) || safe_by_voxels(a, b, distance.lumen)
}

/// Makes a curve safe: pieces that cannot be proven inside are replaced by the stretch of the
/// voxel route nearest to them, whose legal steps are inside by construction.
///
/// * `route`: centres of inside voxels, local mm, consecutive ones a legal step apart.
///
/// `None` when not even the start can be joined to the route.
pub fn mend(
    curve: &[DVec3],
    route: &[DVec3],
    distance: Sampler<'_>,
) -> Option<(Vec<DVec3>, Proof)> {
    let safe = |a: DVec3, b: DVec3| safe(a, b, distance);
    let nearest = |p: DVec3, from: usize| {
        (from..route.len())
            .min_by(|&i, &j| route[i].distance_squared(p).total_cmp(&route[j].distance_squared(p)))
            .unwrap_or(route.len() - 1)
    };
    let mut out = vec![curve[0]];
    let mut proof = Proof::default();
    let mut passed = 0;
    let mut i = 0;
    while i + 1 < curve.len() {
        let here = *out.last()?;
        if safe(here, curve[i + 1]) {
            out.push(curve[i + 1]);
            i += 1;
            continue;
        }
        // Back to where the route can be reached, along it, and off at the first curve point that
        // can be reached safely again; a curve without one ends as the route does.
        let mut at = nearest(here, passed);
        while !safe(*out.last()?, route[at]) {
            out.pop();
            proof.replaced += 1;
            at = nearest(*out.last()?, passed);
        }
        out.push(route[at]);
        loop {
            proof.replaced += 1;
            i += 1;
            let off = if i < curve.len() { nearest(curve[i], at) } else { route.len() - 1 };
            out.extend(&route[at + 1..=off]);
            at = off;
            if i == curve.len() {
                break;
            }
            if safe(route[at], curve[i]) {
                out.push(curve[i]);
                break;
            }
        }
        passed = at;
    }
    for w in out.windows(2) {
        if safe_by_distance(w[0], w[1], distance) {
            proof.by_distance += 1;
        } else {
            proof.by_voxels += 1;
        }
    }
    Some((out, proof))
}

/// Distance from a voxel's side below which a point counts as on it, in voxels: coordinates are
/// rounded on their way through files.
const ON_SIDE: f64 = 1.0 / 256.0;
/// Share of the way to a voxel's centre that a point on its side is moved.
const INWARDS: f64 = 0.125;

/// Moves points off the sides of voxels, so that the voxel nearest to each point is inside: where a
/// curve passes an edge or a corner between two voxels, others that touch there may be external. Such
/// a point becomes two, one in either voxel, with the edge or corner between them; where a curve
/// cannot be proven to stay inside that way, the point stays.
///
/// * `free`: whether the first and the last point may be moved.
pub fn settle(curve: &[DVec3], free: [bool; 2], lumen: &Lumen) -> Vec<DVec3> {
    let mut out: Vec<DVec3> = Vec::with_capacity(curve.len());
    for (i, here) in curve.iter().copied().enumerate() {
        let (first, last) = (i == 0, i + 1 == curve.len());
        if is_clearly_inside(here, lumen) || first && !free[0] || last && !free[1] {
            out.push(here);
            continue;
        }
        let before = out.last().copied();
        let after = (!last).then(|| curve[i + 1]);
        let cells: Vec<IVec3> = touching(here, lumen).filter(|v| lumen.holds(*v)).collect();
        let joins = |to: Option<DVec3>, cell: IVec3| {
            let inner = inwards(here, cell, lumen);
            to.is_none_or(|p| touches(p, cell, lumen) || safe_by_voxels(p, inner, lumen))
        };
        let from = cells.iter().copied().find(|cell| joins(before, *cell));
        let to = cells.iter().copied().find(|cell| joins(after, *cell));
        match (from, to) {
            (Some(from), Some(to)) => {
                out.push(inwards(here, from, lumen));
                if from != to && !first && !last {
                    out.push(inwards(here, to, lumen));
                }
            }
            _ => out.push(here),
        }
    }
    out
}

/// A point that touches a voxel, a little nearer to its centre. Of two voxels that touch at a point,
/// the places that this gives lie on a line through what the voxels share.
fn inwards(p: DVec3, cell: IVec3, lumen: &Lumen) -> DVec3 {
    p.lerp(cell.as_dvec3() * lumen.grid.spacing_mm, INWARDS)
}

/// Whether a point (local mm) lies in a voxel, its sides included.
fn touches(p: DVec3, cell: IVec3, lumen: &Lumen) -> bool {
    (p / lumen.grid.spacing_mm - cell.as_dvec3()).abs().max_element() <= 0.5 + 1e-9
}

/// Whether every voxel that a point (local mm) may be rounded to is inside.
fn is_clearly_inside(p: DVec3, lumen: &Lumen) -> bool {
    touching(p, lumen).all(|v| lumen.holds(v))
}

/// The voxels that a point (local mm) may be rounded to, some of them repeatedly.
fn touching(p: DVec3, lumen: &Lumen) -> impl Iterator<Item = IVec3> {
    let v = p / lumen.grid.spacing_mm + 0.5;
    let (low, high) = ((v - ON_SIDE).floor().as_ivec3(), (v + ON_SIDE).floor().as_ivec3());
    (0..8).map(move |n| low + (high - low) * IVec3::new(n & 1, n >> 1 & 1, n >> 2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lumen::BitVolume;
    use crate::volume::Grid;
    use glam::UVec3;

    #[test]
    fn voxel_traversal_visits_every_voxel_a_segment_crosses() {
        let grid = Grid::axis_aligned([20, 20, 20], [1.0, 2.0, 0.5]);
        let mut bits = BitVolume::new(grid.dims);
        for v in (0..grid.len()).map(|i| grid.voxel(i)) {
            if v != UVec3::new(10, 9, 8) {
                bits.set(v.x, v.y, v.z);
            }
        }
        let l = Lumen::of_volume(grid, &bits);
        let h = grid.spacing_mm;
        let hole = DVec3::new(10.0, 9.0, 8.0);
        for i in 0..200u32 {
            let r = |k: u32| f64::from((i * 7919 + k * 104_729) % 1000) / 1000.0 - 0.5;
            let through = hole + DVec3::new(r(1), r(2), r(3)) * 0.98;
            let dir = DVec3::new(r(4), r(5), r(6)).normalize_or(DVec3::X);
            let (a, b) = ((through - dir * 4.3) * h, (through + dir * 4.9) * h);
            assert!(!safe_by_voxels(a, b, &l) && !safe_by_voxels(b, a, &l), "{i}");
        }
        let at_side =
            |x: f64| safe_by_voxels(DVec3::new(x, 4.0, 4.0), DVec3::new(x, 30.0, 4.0), &l);
        assert!(at_side(9.4) && at_side(10.6) && !at_side(9.6) && !at_side(10.4));
        assert!(!safe_by_voxels(DVec3::ZERO, DVec3::new(-1.0, 0.0, 0.0), &l));
    }

    /// Readers that round a point to a voxel found external ones at diagonal steps.
    #[test]
    fn a_point_where_voxels_meet_is_moved_into_voxels_that_are_inside() {
        let grid = Grid::axis_aligned([8, 8, 8], [1.0, 2.0, 0.5]);
        let mut bits = BitVolume::new(grid.dims);
        for v in [[1, 2, 3], [2, 3, 3], [3, 4, 4], [3, 5, 3]] {
            bits.set(v[0], v[1], v[2]);
        }
        let lumen = Lumen::of_volume(grid, &bits);
        let h = grid.spacing_mm;
        let place = |x, y, z| DVec3::new(x, y, z) * h;
        // Through two edges and a corner; the curve bends at the last edge.
        let curve = vec![
            place(1.0, 2.0, 3.0),
            place(1.5, 2.5, 3.0),
            place(2.0, 3.0, 3.0),
            place(2.5, 3.5, 3.5),
            place(3.0, 4.0, 4.0),
            place(3.25, 4.5, 3.5),
            place(3.0, 5.0, 3.0),
        ];
        let settled = settle(&curve, [true; 2], &lumen);
        assert!(settled.iter().all(|p| is_clearly_inside(*p, &lumen)), "{settled:?}");
        assert_eq!(settled.len(), curve.len() + 3, "two points for each on a side");
        let kept = curve.iter().filter(|p| settled.contains(*p));
        assert_eq!(kept.count(), 4, "centres stay");
        // Between its two points the curve passes what the voxels share.
        for (pair, edge) in [(1, curve[1]), (4, curve[3])] {
            assert!(settled[pair].midpoint(settled[pair + 1]).distance(edge) < 1e-12);
        }
        let bend = settled[7].midpoint(settled[8]) / h;
        assert!((bend.y - 4.5).abs() < 1e-12 && (bend.z - 3.5).abs() < 1e-12, "{bend}");

        // An end on a side moves if it may; a point outside stays.
        let ends = [curve[1], curve[2], curve[3]];
        assert_eq!(settle(&ends, [false; 2], &lumen), ends);
        let moved = settle(&ends, [true; 2], &lumen);
        assert!(moved.len() == 3 && moved.iter().all(|p| is_clearly_inside(*p, &lumen)));
        let outside = [place(1.0, 2.0, 3.0), place(6.0, 6.0, 6.0), place(3.0, 4.0, 4.0)];
        assert_eq!(settle(&outside, [true; 2], &lumen), outside);
    }
}
