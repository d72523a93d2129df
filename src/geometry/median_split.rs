//! Median split of points along the longest side of their box: the step of a kd-tree build.

use glam::Vec3;

/// A position and the id of the item there. Coordinates are stored as integers of the same order,
/// so that a coordinate and the id compare as one u64. 16 bytes, which are moved faster than looked
/// up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyedPoint {
    at: [u32; 3],
    id: u32,
}

impl KeyedPoint {
    /// Stores item `id` at `p`, of which no coordinate may be NaN.
    pub fn new(p: Vec3, id: u32) -> Self {
        let ordered = |x: f32| {
            let bits = x.to_bits();
            // The order of negative floats is reversed, and they come below the others.
            bits ^ ((bits.cast_signed() >> 31).cast_unsigned() | 1 << 31)
        };
        Self { at: p.to_array().map(ordered), id }
    }

    /// Returns the id of the item.
    pub fn id(&self) -> u32 {
        self.id
    }

    /// Returns the position of the item.
    pub fn position(&self) -> Vec3 {
        float(self.at)
    }

    /// Returns the sort key: coordinate along an axis, then id.
    fn key(&self, axis: usize) -> u64 {
        u64::from(self.at[axis]) << 32 | u64::from(self.id)
    }
}

fn float(at: [u32; 3]) -> Vec3 {
    Vec3::from_array(
        at.map(|x| f32::from_bits(x ^ (!(x.cast_signed() >> 31).cast_unsigned() | 1 << 31))),
    )
}

/// Returns the smallest and largest corner of the box around all positions.
pub fn bounds(items: &[KeyedPoint]) -> (Vec3, Vec3) {
    let (lo, hi) = items.iter().fold(([u32::MAX; 3], [0; 3]), |(lo, hi), i| {
        let each = |f: fn(u32, u32) -> u32, a: [u32; 3]| [0, 1, 2].map(|k| f(a[k], i.at[k]));
        (each(u32::min, lo), each(u32::max, hi))
    });
    (float(lo), float(hi))
}

/// Partitions so that the `n` items lowest along the longest side of their box come first, and
/// splits there; `n` is at most their number. The order within both parts is unspecified but
/// deterministic.
pub fn split(items: &mut [KeyedPoint], n: usize) -> (&mut [KeyedPoint], &mut [KeyedPoint]) {
    if n > 0 && n < items.len() {
        let (lo, hi) = bounds(items);
        let size = hi - lo;
        let axis = (0..3).fold(0, |best, k| if size[k] > size[best] { k } else { best });
        items.select_nth_unstable_by_key(n, |i| i.key(axis));
    }
    items.split_at_mut(n)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn split_puts_the_lowest_along_the_longest_side_first_for_all_signs() {
        let xs = [3.5, -2.0, 0.0, -0.0, 1e-40, -1e-40, -7e8, 2e9, 1.0, -1.0, 5.0, -5.0];
        let all =
            || xs.iter().zip(0..).map(|(x, id)| KeyedPoint::new(Vec3::new(1.0, *x, -2.0), id));
        for (p, x) in all().zip(xs) {
            assert_eq!(p.position().to_array().map(f32::to_bits), [1.0, x, -2.0].map(f32::to_bits));
        }
        let mut ids: Vec<usize> = (0..xs.len()).collect();
        ids.sort_by(|a, b| xs[*a].total_cmp(&xs[*b]));
        for n in 0..=xs.len() {
            let mut items: Vec<KeyedPoint> = all().collect();
            assert_eq!(bounds(&items), (Vec3::new(1.0, -7e8, -2.0), Vec3::new(1.0, 2e9, -2.0)));
            let (low, high) = split(&mut items, n);
            let sorted = |of: &[KeyedPoint]| {
                let mut ids: Vec<usize> = of.iter().map(|p| p.id() as usize).collect();
                ids.sort_by(|a, b| xs[*a].total_cmp(&xs[*b]));
                ids
            };
            assert_eq!([sorted(low), sorted(high)].concat(), ids);
        }
    }

    #[test]
    fn equal_positions_are_split_by_id() {
        let mut items: Vec<KeyedPoint> =
            (0..9).rev().map(|id| KeyedPoint::new(Vec3::ONE, id)).collect();
        let (low, _) = split(&mut items, 4);
        let mut ids: Vec<u32> = low.iter().map(KeyedPoint::id).collect();
        ids.sort_unstable();
        assert_eq!(ids, [0, 1, 2, 3]);
    }
}
