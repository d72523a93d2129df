//! Things in space that are parted again and again at medians.

use glam::Vec3;

/// A thing and its place, whose coordinates are kept as whole numbers in the same order: two are
/// then compared by one number each. It takes 16 bytes, and to move those is faster than to look
/// places up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    at: [u32; 3],
    id: u32,
}

impl Placed {
    /// A thing at `p`, where no coordinate is a NaN.
    pub fn new(p: Vec3, id: u32) -> Self {
        let ordered = |x: f32| {
            let bits = x.to_bits();
            // Negative ones the other way round, and below the others.
            bits ^ ((bits.cast_signed() >> 31).cast_unsigned() | 1 << 31)
        };
        Self { at: p.to_array().map(ordered), id }
    }

    /// Which thing.
    pub fn id(&self) -> u32 {
        self.id
    }

    /// Where it is.
    pub fn place(&self) -> Vec3 {
        place(self.at)
    }

    /// By place along an axis, equal ones by id.
    fn key(&self, axis: usize) -> u64 {
        u64::from(self.at[axis]) << 32 | u64::from(self.id)
    }
}

fn place(at: [u32; 3]) -> Vec3 {
    Vec3::from_array(
        at.map(|x| f32::from_bits(x ^ (!(x.cast_signed() >> 31).cast_unsigned() | 1 << 31))),
    )
}

/// The lowest and the highest coordinates of any.
pub fn bounds(items: &[Placed]) -> (Vec3, Vec3) {
    let (lo, hi) = items.iter().fold(([u32::MAX; 3], [0; 3]), |(lo, hi), i| {
        let each = |f: fn(u32, u32) -> u32, a: [u32; 3]| [0, 1, 2].map(|k| f(a[k], i.at[k]));
        (each(u32::min, lo), each(u32::max, hi))
    });
    (place(lo), place(hi))
}

/// Brings the `n` that are lowest along the longest side of the box of all to the front. No more
/// than there are; the order within both parts is whatever it becomes, but always the same.
pub fn part(items: &mut [Placed], n: usize) -> (&mut [Placed], &mut [Placed]) {
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
    fn the_lowest_along_the_longest_side_come_first_whatever_their_signs() {
        let xs = [3.5, -2.0, 0.0, -0.0, 1e-40, -1e-40, -7e8, 2e9, 1.0, -1.0, 5.0, -5.0];
        let all = || xs.iter().zip(0..).map(|(x, id)| Placed::new(Vec3::new(1.0, *x, -2.0), id));
        for (p, x) in all().zip(xs) {
            assert_eq!(p.place().to_array().map(f32::to_bits), [1.0, x, -2.0].map(f32::to_bits));
        }
        let mut ids: Vec<usize> = (0..xs.len()).collect();
        ids.sort_by(|a, b| xs[*a].total_cmp(&xs[*b]));
        for n in 0..=xs.len() {
            let mut items: Vec<Placed> = all().collect();
            assert_eq!(bounds(&items), (Vec3::new(1.0, -7e8, -2.0), Vec3::new(1.0, 2e9, -2.0)));
            let (low, high) = part(&mut items, n);
            let sorted = |of: &[Placed]| {
                let mut ids: Vec<usize> = of.iter().map(|p| p.id() as usize).collect();
                ids.sort_by(|a, b| xs[*a].total_cmp(&xs[*b]));
                ids
            };
            assert_eq!([sorted(low), sorted(high)].concat(), ids);
        }
    }

    #[test]
    fn equal_places_are_parted_by_id() {
        let mut items: Vec<Placed> = (0..9).rev().map(|id| Placed::new(Vec3::ONE, id)).collect();
        let (low, _) = part(&mut items, 4);
        let mut ids: Vec<u32> = low.iter().map(Placed::id).collect();
        ids.sort_unstable();
        assert_eq!(ids, [0, 1, 2, 3]);
    }
}
