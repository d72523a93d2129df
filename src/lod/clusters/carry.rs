//! What a fine face stands for, carried along to the coarse faces it lies over.
//!
//! Each level stands for all of the original, so to measure it against the original anew takes as
//! long at every level. But what is near a fine face is near the coarse ones that this lies over
//! ([`super::image`]), by no more than both distances together; and as a group is as far off as its
//! worst place, that is nearly everywhere less than what the group errs anyway. Only what may be
//! farther is measured.

use super::image::Image;
use super::measure::{Draft, Measure};

/// What stands for something of the original, and how well.
#[derive(Clone, Copy, Default)]
pub struct Near {
    /// No point of it is farther than this, mm,
    pub far: f64,
    /// from all of these triangles of the cluster together, a bit for each; none if there is
    /// nothing.
    pub over: u64,
}

impl Near {
    /// Of a triangle that stands for what lies on it.
    pub fn itself(triangle: u8) -> Self {
        Self { far: 0.0, over: 1 << triangle }
    }

    /// Takes in what another stands for.
    pub fn join(&mut self, o: Self) {
        self.far = self.far.max(o.far);
        self.over |= o.over;
    }

    fn triangles(self) -> impl Iterator<Item = usize> {
        let rest = |bits: u64| (bits != 0).then_some(bits);
        std::iter::successors(rest(self.over), move |b| rest(b & (b - 1)))
            .map(|b| b.trailing_zeros() as usize)
    }
}

/// Where what a fine triangle stands for goes as it is: a coarse face, and what is near there then.
pub type Carried = Option<(u32, Near)>;

impl Measure<'_> {
    /// For each triangle of `d`, where what it stands for can go without being measured: that lies
    /// over faces of one cluster, no farther than `bound`, mm.
    ///
    /// * `first`: of its triangles among the fine faces of `image`.
    pub fn carried(&self, d: &Draft, first: usize, image: &Image, bound: f64) -> Vec<Carried> {
        let to = |near: &Near| {
            let mut over = 0;
            let (mut to, mut away) = (None, 0f64);
            for fine in near.triangles() {
                let laid = &image.over[image.laid[first + fine].clone()];
                if laid.is_empty() {
                    return None;
                }
                for &(face, far) in laid {
                    let (cluster, triangle) = self.owner[face as usize];
                    let (known, _) = *to.get_or_insert((cluster, face));
                    if known != cluster {
                        return None;
                    }
                    over |= 1 << triangle;
                    away = away.max(far);
                }
            }
            let far = near.far + away;
            to.filter(|_| far <= bound).map(|(_, face)| (face, Near { far, over }))
        };
        d.near.iter().map(to).collect()
    }
}
