//! Fineness of every triangle, given the fineness that each octree leaf requires.
//!
//! Fineness counts eighths of a level: q = 8 (ℓ − 1) + a is level ℓ whose newest vertices have
//! moved a eighths of the way from the midpoint of the edge that they split (geomorph, Hoppe 1996,
//! doi:10.1145/237170.237216); 0 is the base. A triangle has the fineness of its leaf, and is at
//! most eight eighths coarser than each neighbour (a restricted, 2:1 balanced subdivision): q(t) =
//! max over s of (leaf(s) − 8 · dual distance of s and t). An edge has the larger fineness of its
//! triangles.

use super::base_mesh::BaseMesh;

/// Eighths of a level.
pub type Fineness = u8;

/// Level: how many times a triangle is split.
pub fn level(q: Fineness) -> u32 {
    u32::from(q).div_ceil(8)
}

/// Eighths of the way that the newest vertices have moved.
pub fn morph(q: Fineness) -> u32 {
    if q == 0 { 8 } else { (u32::from(q) - 1) % 8 + 1 }
}

/// Restores the balance near `seeds` (all triangles of all leaves that changed): `now` holds a
/// valid state for the previous leaves, and gets the one for `leaf`. `depth` is the finest level.
/// Returns the triangles that were visited.
pub fn balance(
    base: &BaseMesh,
    leaf: &dyn Fn(u32) -> Fineness,
    seeds: impl IntoIterator<Item = u32>,
    depth: u32,
    now: &mut [Fineness],
) -> Vec<u32> {
    // A leaf influences triangles less than `depth` steps away.
    let mut inside = vec![false; base.faces.len()];
    let mut region: Vec<u32> = Vec::new();
    for f in seeds {
        if !std::mem::replace(&mut inside[f as usize], true) {
            region.push(f);
        }
    }
    let mut from = 0;
    for _ in 1..depth {
        let to = region.len();
        for i in from..to {
            for e in 0..3 {
                if let Some(g) = base.across(region[i], e)
                    && !std::mem::replace(&mut inside[g as usize], true)
                {
                    region.push(g);
                }
            }
        }
        from = to;
    }
    let mut open: Vec<Vec<u32>> = vec![Vec::new(); 8 * depth as usize + 1];
    for &f in &region {
        let outer = (0..3)
            .filter_map(|e| base.across(f, e))
            .filter(|g| !inside[*g as usize])
            .map(|g| now[g as usize].saturating_sub(8));
        let q = outer.fold(leaf(f), Fineness::max);
        open[usize::from(q)].push(f);
        now[f as usize] = q;
    }
    for q in (9..open.len()).rev() {
        let mut i = 0;
        while i < open[q].len() {
            let f = open[q][i];
            i += 1;
            if usize::from(now[f as usize]) != q {
                continue;
            }
            for g in (0..3).filter_map(|e| base.across(f, e)) {
                if inside[g as usize] && usize::from(now[g as usize]) + 8 < q {
                    now[g as usize] = (q - 8) as Fineness;
                    open[q - 8].push(g);
                }
            }
        }
    }
    region
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of triangles.
    fn strip(n: u32) -> BaseMesh {
        let face = |i: u32| if i.is_multiple_of(2) { [i, i + 1, i + 2] } else { [i + 1, i, i + 2] };
        BaseMesh::new((0..n).map(face).collect(), n as usize + 2)
    }

    #[test]
    fn fineness_splits_into_level_and_morph() {
        assert_eq!([0, 1, 8, 9, 16].map(level), [0, 1, 1, 2, 2]);
        assert_eq!([0, 1, 8, 9, 16].map(morph), [8, 1, 8, 1, 8]);
    }

    #[test]
    fn neighbours_differ_by_one_level_after_refining_and_coarsening_a_leaf() {
        let base = strip(12);
        let mut now = vec![0; 12];
        let mut leaf = [0u8; 12];
        leaf[5] = 27;
        balance(&base, &|f| leaf[f as usize], [5], 4, &mut now);
        assert_eq!(now, [0, 0, 3, 11, 19, 27, 19, 11, 3, 0, 0, 0]);
        leaf[9] = 16;
        balance(&base, &|f| leaf[f as usize], [9], 4, &mut now);
        assert_eq!(now, [0, 0, 3, 11, 19, 27, 19, 11, 8, 16, 8, 0]);
        leaf[5] = 0;
        balance(&base, &|f| leaf[f as usize], [5], 4, &mut now);
        assert_eq!(now, [0, 0, 0, 0, 0, 0, 0, 0, 8, 16, 8, 0]);
    }
}
