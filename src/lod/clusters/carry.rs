//! What a fine face stands for, carried along to the coarse faces it lies over.
//!
//! Each level stands for all of the original, so to measure it against the original anew takes as
//! long at every level. But what is near fine faces is near the coarse ones that these lie over
//! ([`super::image`]), by no more than both distances together; and as a group is as far off as its
//! worst place, that is nearly everywhere less than what the group errs anyway. Only what may be
//! farther is measured, and what lies over faces of several clusters.

use std::cmp::Ordering;

use super::build::up;
use super::draft::Lies;
use super::image::Image;
use super::measure::Measure;

/// Coarse faces of one cluster that a fine one lies over.
#[derive(Clone, Copy)]
pub struct Below {
    /// One of them.
    face: u32,
    /// The cluster,
    cluster: u16,
    /// and a bit for each of its triangles.
    over: u64,
    /// How far the fine face is from them at most, mm.
    away: f64,
}

/// Where a piece of the original goes along to.
#[derive(Clone, Copy)]
pub struct Carried {
    /// A coarse face that it is near to.
    pub near: u32,
    /// The cluster of that,
    pub cluster: u16,
    /// and where it lies there.
    pub lies: Lies,
}

impl Carried {
    /// How far it is from there at most, mm.
    pub fn far(&self) -> f64 {
        f64::from(self.lies.far)
    }
}

/// Something that goes along if the bound rises enough.
pub struct Late {
    /// Where to.
    pub to: Carried,
    /// Place of its cluster among the inputs.
    pub draft: u32,
    /// Its place there: whole faces first, then parts.
    pub piece: u32,
}

impl Late {
    /// The farthest first.
    pub fn before(&self, o: &Self) -> Ordering {
        let far = o.to.lies.far.total_cmp(&self.to.lies.far);
        far.then((self.draft, self.piece).cmp(&(o.draft, o.piece)))
    }
}

impl Measure<'_> {
    /// For each fine face, what it lies over, if that is of one cluster.
    pub fn below(&self, image: &Image) -> Vec<Option<Below>> {
        let of = |range: &std::ops::Range<usize>| {
            let laid = &image.over[range.clone()];
            let face = laid.first()?.0;
            let (cluster, _) = self.owner[face as usize];
            let (mut over, mut away) = (0, 0f64);
            for (face, far) in laid {
                let (other, triangle) = self.owner[*face as usize];
                if other != cluster {
                    return None;
                }
                over |= 1 << triangle;
                away = away.max(*far);
            }
            Some(Below { face, cluster, over, away })
        };
        image.laid.iter().map(of).collect()
    }
}

/// Where a piece of the original can go without being measured: all that it may lie over has to lie
/// over faces of one cluster. `below`: of the triangles of the cluster that stands for it.
pub fn carried(lies: &Lies, below: &[Option<Below>]) -> Option<Carried> {
    let home = below[lies.triangle()]?;
    let (mut over, mut away) = (0, 0f64);
    for t in lies.triangles() {
        let other = below[t]?;
        if other.cluster != home.cluster {
            return None;
        }
        over |= other.over;
        away = away.max(other.away);
    }
    let far = up(f64::from(lies.far) + away);
    Some(Carried { near: home.face, cluster: home.cluster, lies: Lies { far, over, ..*lies } })
}
