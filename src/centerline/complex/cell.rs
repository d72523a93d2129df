//! Sets of voxels of a cell as one word: bit x + 4 y + 16 z.

/// Voxels along a cell's side.
pub const SIDE: usize = 4;
/// Voxels with x = 0; y = 0; z = 0.
pub const LOW: [u64; 3] = [0x1111_1111_1111_1111, 0x000f_000f_000f_000f, 0xffff];
/// Change of a bit's index with a step along each axis.
pub const STEP: [u32; 3] = [1, 4, 16];

/// The set moved one step towards the low side of an axis; what leaves the cell is lost.
#[inline]
pub fn lower(bits: u64, axis: usize) -> u64 {
    (bits & !LOW[axis]) >> STEP[axis]
}

/// The set moved one step towards the high side.
#[inline]
fn higher(bits: u64, axis: usize) -> u64 {
    (bits & !(LOW[axis] << (3 * STEP[axis]))) << STEP[axis]
}

/// The 6-connected component of `set` that holds the voxels `seed`.
#[inline]
pub fn component(set: u64, seed: u64) -> u64 {
    let mut found = seed;
    loop {
        let around = (0..3).fold(found, |b, k| b | lower(found, k) | higher(found, k));
        let grown = around & set;
        if grown == found {
            return found;
        }
        found = grown;
    }
}

/// Voxels of a shortest way of face steps from one voxel of a set to another, both included; of
/// several the one through the lowest voxels, seen from the end. Empty if the set does not join them.
pub fn path(set: u64, from: u32, to: u32) -> Vec<u32> {
    let mut fronts = vec![1u64 << from & set];
    let mut seen = fronts[0];
    while seen >> to & 1 == 0 {
        let last = fronts[fronts.len() - 1];
        let next = (0..3).fold(0, |b, k| b | lower(last, k) | higher(last, k)) & set & !seen;
        if next == 0 {
            return Vec::new();
        }
        seen |= next;
        fronts.push(next);
    }
    let mut out = vec![to];
    for front in fronts.iter().rev().skip(1) {
        let here = 1u64 << out[out.len() - 1];
        let beside = (0..3).fold(0, |b, k| b | lower(here, k) | higher(here, k)) & front;
        out.push(beside.trailing_zeros());
    }
    out.reverse();
    out
}

/// The components of a set, that of the lowest voxel first.
pub fn components(mut set: u64) -> impl Iterator<Item = u64> {
    std::iter::from_fn(move || {
        (set != 0).then(|| {
            let found = component(set, set & set.wrapping_neg());
            set &= !found;
            found
        })
    })
}

/// Voxels of a set, by their bits, ascending.
pub fn voxels(mut set: u64) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        (set != 0).then(|| {
            let bit = set.trailing_zeros();
            set &= set - 1;
            bit
        })
    })
}

/// Euler characteristic of a set: voxels less pairs of face neighbours, plus squares of four, less
/// cubes of eight.
pub fn euler(set: u64) -> i64 {
    let count = |b: u64| i64::from(b.count_ones());
    let with = |b: u64, axis: usize| b & lower(b, axis);
    let [x, y, z] = [0, 1, 2].map(|k| with(set, k));
    let (xy, xz, yz) = (with(x, 1), with(x, 2), with(y, 2));
    count(set) - count(x) - count(y) - count(z) + count(xy) + count(xz) + count(yz)
        - count(with(xy, 2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bit(x: u32, y: u32, z: u32) -> u64 {
        1 << (x + 4 * y + 16 * z)
    }

    #[test]
    fn voxels_that_share_a_face_are_connected_and_no_others() {
        for a in 0..64u32 {
            for b in 0..64u32 {
                let at = |v: u32| [v & 3, v >> 2 & 3, v >> 4].map(i64::from);
                let apart: i64 = at(a).iter().zip(at(b)).map(|(p, q)| (p - q).abs()).sum();
                let joined = component(1 << a | 1 << b, 1 << a) >> b & 1 != 0;
                assert_eq!(joined, apart <= 1, "{a} {b}");
            }
        }
    }

    #[test]
    fn a_path_in_a_cell_takes_the_fewest_face_steps() {
        // A wall with one gap between the halves of the cell.
        let wall: u64 = (0..16).map(|i| bit(1, i % 4, i / 4)).sum();
        let set = !wall | bit(1, 2, 3);
        let way = path(set, 0, 3);
        let at = |v: u32| [v & 3, v >> 2 & 3, v >> 4].map(i64::from);
        for w in way.windows(2) {
            let (a, b) = (at(w[0]), at(w[1]));
            assert_eq!((0..3).map(|k| (a[k] - b[k]).abs()).sum::<i64>(), 1);
        }
        assert!(way.iter().all(|v| set >> v & 1 != 0));
        assert_eq!((way[0], way[way.len() - 1], way.len()), (0, 3, 14));
        assert!(path(set & !bit(1, 2, 3), 0, 3).is_empty());
        assert_eq!(path(1, 0, 0), [0]);
    }

    #[test]
    fn euler_characteristics_are_those_of_known_shapes() {
        assert_eq!(euler(0), 0);
        assert_eq!(euler(!0), 1);
        assert_eq!(euler(bit(0, 0, 0) | bit(1, 1, 0)), 2, "an edge does not join");
        // A ring of eight voxels, and a shell about one.
        let square: u64 = (0..9).map(|i| bit(i % 3, i / 3, 0)).sum();
        assert_eq!(euler(square & !bit(1, 1, 0)), 0);
        let cube: u64 = (0..3).map(|z| square << (16 * z)).sum();
        assert_eq!(euler(cube & !bit(1, 1, 1)), 2);
    }
}
