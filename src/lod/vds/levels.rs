//! How fine every triangle is, given how fine each leaf asks to be.
//!
//! Fineness counts in eighths of a level: q = 8 (ℓ − 1) + a is level ℓ of which the newest
//! vertices have gone a eighths of their way from the middle of the edge that they split (geomorph,
//! Hoppe 1996, doi:10.1145/237170.237216); 0 is the base. A triangle is as fine as its leaf asks,
//! and at most eight eighths coarser than each neighbour: q(t) = max over s of
//! (leaf(s) − 8 · steps from s to t). An edge is as fine as the finer of its triangles.

use super::base::Base;

/// Eighths of a level.
pub type Fineness = u8;

/// Level: how often a triangle is split.
pub fn level(q: Fineness) -> u32 {
    u32::from(q).div_ceil(8)
}

/// Eighths of their way that the newest vertices have gone.
pub fn morph(q: Fineness) -> u32 {
    if q == 0 { 8 } else { (u32::from(q) - 1) % 8 + 1 }
}

/// Works the triangles near `seeds` (all triangles of all leaves that changed) out anew: `now`
/// holds a valid answer for the leaves as they were, and gets the one for `leaf`. `depth` is the
/// finest level. Returns the triangles that were looked at.
pub fn spread(
    base: &Base,
    leaf: &dyn Fn(u32) -> Fineness,
    seeds: impl IntoIterator<Item = u32>,
    depth: u32,
    now: &mut [Fineness],
) -> Vec<u32> {
    // A leaf reaches less than `depth` steps beyond its own triangles.
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

    /// A strip of triangles, each joined to the next.
    fn strip(n: u32) -> Base {
        let face = |i: u32| if i.is_multiple_of(2) { [i, i + 1, i + 2] } else { [i + 1, i, i + 2] };
        Base::new((0..n).map(face).collect(), n as usize + 2)
    }

    #[test]
    fn a_fineness_is_a_level_and_a_share_of_it() {
        assert_eq!([0, 1, 8, 9, 16].map(level), [0, 1, 1, 2, 2]);
        assert_eq!([0, 1, 8, 9, 16].map(morph), [8, 1, 8, 1, 8]);
    }

    #[test]
    fn a_leaf_pulls_its_neighbours_up_step_by_step_and_lets_them_fall_again() {
        let base = strip(12);
        let mut now = vec![0; 12];
        let mut leaf = [0u8; 12];
        leaf[5] = 27;
        spread(&base, &|f| leaf[f as usize], [5], 4, &mut now);
        assert_eq!(now, [0, 0, 3, 11, 19, 27, 19, 11, 3, 0, 0, 0]);
        leaf[9] = 16;
        spread(&base, &|f| leaf[f as usize], [9], 4, &mut now);
        assert_eq!(now, [0, 0, 3, 11, 19, 27, 19, 11, 8, 16, 8, 0]);
        leaf[5] = 0;
        spread(&base, &|f| leaf[f as usize], [5], 4, &mut now);
        assert_eq!(now, [0, 0, 0, 0, 0, 0, 0, 0, 8, 16, 8, 0]);
    }
}
