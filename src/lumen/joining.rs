//! Joining of a label map's components that touch by an edge or a corner of voxels.
//!
//! The lumen is 6-connected; labels of others often are not: 11 % of one airway and 27 % of a vessel
//! tree touched the rest by edges or corners alone, and were left out. As few voxels as possible are
//! added: one where two components touch by an edge, two where they touch by a corner.

use glam::{IVec3, UVec3};

use super::BitVolume;
use super::bits::Run;
use super::components::RunSet;

/// A place where runs of two components touch.
struct Touch {
    /// Number of voxels that join the components.
    cost: u8,
    /// Voxels of either component.
    pair: [IVec3; 2],
    runs: [u32; 2],
}

/// Joins all components that touch by an edge or a corner, over the cheapest touches first; returns
/// the voxels that were added.
pub fn join_touching(bits: &mut BitVolume) -> Vec<UVec3> {
    let Some((lo, hi)) = bits.bounds() else { return Vec::new() };
    let mut set = RunSet::of(bits, lo, hi, false);
    let mut touches = touches(&mut set);
    touches.sort_by_key(|t| (t.cost, t.pair[0].z, t.pair[0].y, t.pair[0].x, t.runs));
    let mut added = Vec::new();
    for touch in touches {
        let [i, j] = touch.runs;
        if set.sets.join(i, j) {
            for v in link(bits, touch.pair) {
                let v = v.as_uvec3();
                bits.set(v.x, v.y, v.z);
                added.push(v);
            }
        }
    }
    added
}

/// Touches of different components.
fn touches(set: &mut RunSet) -> Vec<Touch> {
    let mut out = Vec::new();
    let rows: Vec<(usize, u32, u32)> = set.rows().collect();
    let depth = rows.len() / set.rows_y as usize;
    for (r, y, z) in rows {
        crate::task::checkpoint();
        for (dy, dz) in [(1, 0), (0, 1), (1, 1), (-1, 1)] {
            let (row, slice) = (r as i32 % set.rows_y as i32 + dy, r / set.rows_y as usize + dz);
            if !(0..set.rows_y as i32).contains(&row) || slice >= depth {
                continue;
            }
            let other = slice * set.rows_y as usize + row as usize;
            let place = IVec3::new(0, y as i32, z as i32);
            touches_of_rows(set, [r, other], place, IVec3::new(0, dy, dz as i32), &mut out);
        }
    }
    out
}

/// Appends the touches between the runs of two rows.
///
/// * `place`: first voxel of the first row; `step`: from it to that of the second.
fn touches_of_rows(
    set: &mut RunSet,
    [first, second]: [usize; 2],
    place: IVec3,
    step: IVec3,
    out: &mut Vec<Touch>,
) {
    let is_diagonal = step.y != 0 && step.z != 0;
    let (a, b) = (set.row(first), set.row(second));
    let (mut i, mut j) = (a.start, b.start);
    while i < a.end && j < b.end {
        let (p, q): (Run, Run) = (set.runs[i], set.runs[j]);
        let meet = p.0 <= q.1 && q.0 <= p.1;
        let beside = p.1 + 1 == q.0 || q.1 + 1 == p.0;
        let cost = match (is_diagonal, meet, beside) {
            (false, false, true) | (true, true, _) => Some(1),
            (true, false, true) => Some(2),
            _ => None,
        };
        let is_apart = set.sets.root(i as u32) != set.sets.root(j as u32);
        if let Some(cost) = cost.filter(|_| is_apart) {
            let [x, to] = match (meet, p.1 < q.0) {
                (true, _) => [p.0.max(q.0); 2],
                (false, true) => [p.1, q.0],
                (false, false) => [p.0, q.1],
            };
            let pair = [place + IVec3::X * x as i32, place + step + IVec3::X * to as i32];
            out.push(Touch { cost, pair, runs: [i as u32, j as u32] });
        }
        if p.1 < q.1 { i += 1 } else { j += 1 }
    }
}

/// Voxels between two that touch by an edge or a corner, each sharing a face with the next: of
/// several ways the one with most voxels of the mask around it.
fn link(bits: &BitVolume, [a, b]: [IVec3; 2]) -> Vec<IVec3> {
    const ORDERS: [[usize; 3]; 6] =
        [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let step = b - a;
    let around = |v: IVec3| {
        let sides = IVec3::AXES.into_iter().flat_map(|d| [v + d, v - d]);
        sides.filter(|s| bits.get(*s)).count()
    };
    let way = |order: &[usize; 3]| {
        let mut at = a;
        let mut way = Vec::new();
        for axis in order.iter().filter(|axis| step[**axis] != 0) {
            at[*axis] += step[*axis];
            if at != b {
                way.push(at);
            }
        }
        way
    };
    let ways = ORDERS.iter().map(way);
    let support = |way: &Vec<IVec3>| way.iter().map(|v| around(*v)).sum::<usize>();
    // The first of equal ones.
    ways.reduce(|best, next| if support(&next) > support(&best) { next } else { best })
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lumen::pieces;

    fn mask(voxels: &[[u32; 3]]) -> BitVolume {
        let mut bits = BitVolume::new(UVec3::splat(12));
        voxels.iter().for_each(|v| bits.set(v[0], v[1], v[2]));
        bits
    }

    #[test]
    fn components_that_touch_by_an_edge_or_a_corner_are_joined_by_one_or_two_voxels() {
        for a in 0..27u32 {
            let step = [a % 3, a / 3 % 3, a / 9].map(|d| d as i32 - 1);
            let apart = step.iter().filter(|d| **d != 0).count();
            let to = [0, 1, 2].map(|k| (5 + step[k]) as u32);
            let mut bits = mask(&[[5, 5, 5], to]);
            let added = join_touching(&mut bits);
            assert_eq!(added.len(), apart.saturating_sub(1), "{step:?}");
            assert_eq!(pieces(&bits, 1).len(), 1, "{step:?}");
        }
        let mut far = mask(&[[1, 1, 1], [3, 1, 1], [5, 5, 5], [6, 6, 5]]);
        assert_eq!(join_touching(&mut far).len(), 1, "a gap is not bridged");
        assert_eq!(pieces(&far, 1).len(), 3);
    }

    #[test]
    fn two_components_are_joined_once_where_it_takes_fewest_voxels() {
        // They touch by a corner and, farther on, by an edge.
        let mut bits = mask(&[[2, 2, 2], [2, 2, 3], [2, 2, 4], [3, 3, 5], [3, 3, 4]]);
        assert_eq!(join_touching(&mut bits), [UVec3::new(3, 2, 4)]);
        assert_eq!(pieces(&bits, 1).len(), 1);
    }
}
