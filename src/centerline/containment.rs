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
    let way = IVec3::new(sign(d.x), sign(d.y), sign(d.z));
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

fn sign(d: f64) -> i32 {
    if d > 0.0 {
        1
    } else if d < 0.0 {
        -1
    } else {
        0
    }
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
        let l = Lumen::new(grid, &bits);
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
}
