//! Dilation that keeps the topology: what is added is a simple point, so that no two parts join, no
//! sheet between them is pierced and no hole is closed.

use glam::{DVec3, IVec3, UVec3};

use super::bricks::near_offset;
use super::{BitVolume, dilated};

/// Thickens a mask by some layers of voxels that share a side with it, within the allowed ones. Of a
/// layer, voxels with the least value come first: a sheet that the mask meets from both sides stays
/// where its values are greatest.
///
/// A voxel is added if it is simple: it has one 6-component of mask and one 26-component of
/// background around it (Bertrand & Malandain 1994, doi:10.1016/0167-8655(94)90046-9). That alone
/// would let a sheet with a free edge be eaten from there; so a voxel with mask on opposite sides is
/// never added.
pub fn thickened(
    mask: &BitVolume,
    allowed: &BitVolume,
    value: impl Fn(UVec3) -> f64,
    layers: usize,
) -> BitVolume {
    let tables = Neighborhood::tables();
    let mut out = mask.clone();
    for _ in 0..layers {
        crate::task::checkpoint();
        let mut next = dilated(&out, DVec3::ONE, 1.0);
        next.keep(allowed);
        next.remove(&out);
        let mut order: Vec<(f64, UVec3)> = next.voxels().map(|v| (value(v), v)).collect();
        // Voxels come in the order of their index; the sort keeps it among equal values.
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        // What waited for its neighbours may be simple the second time.
        for _ in 0..2 {
            order.retain(|(_, v)| {
                let near = neighbourhood(&out, v.as_ivec3());
                let joins = !tables.is_between(near) && tables.is_simple(near);
                if joins {
                    out.set(v.x, v.y, v.z);
                }
                !joins
            });
        }
    }
    out
}

/// Bit of the voxel itself in its 3³ neighbourhood.
const MIDDLE: u32 = 13;

/// Offset of a bit of a neighbourhood.
fn offset(bit: u32) -> IVec3 {
    near_offset(bit as usize)
}

/// Returns a bit for each of the 27 voxels about one: whether it is set.
fn neighbourhood(mask: &BitVolume, at: IVec3) -> u32 {
    (0..27).filter(|bit| mask.get(at + offset(*bit))).fold(0, |all, bit| all | 1 << bit)
}

/// Adjacency among the 27 voxels about one, as bits of x + 3 y + 9 z.
pub struct Neighborhood {
    /// 6-neighbours of each voxel, among the 18 that share a side or an edge with the middle.
    sides: [u32; 27],
    /// 26-neighbours of each voxel.
    all: [u32; 27],
    /// Voxels that share a side with the middle; `eighteen`: a side or an edge.
    six: u32,
    eighteen: u32,
    /// Pair of opposite 6-neighbours of the middle, for each axis.
    opposite: [u32; 3],
}

impl Neighborhood {
    /// Computes the tables.
    pub fn tables() -> Self {
        let among = |bit: u32, least: i32, most: i32| {
            let near = |other: &u32| {
                let d = offset(*other) - offset(bit);
                (least..=most).contains(&d.length_squared())
            };
            (0..27).filter(|other| *other != MIDDLE && near(other)).fold(0, |m, o| m | 1u32 << o)
        };
        let eighteen = among(MIDDLE, 1, 2);
        Self {
            sides: std::array::from_fn(|bit| among(bit as u32, 1, 1) & eighteen),
            all: std::array::from_fn(|bit| among(bit as u32, 1, 3)),
            six: among(MIDDLE, 1, 1),
            eighteen,
            opposite: [1, 3, 9].map(|step| 1 << (MIDDLE - step) | 1 << (MIDDLE + step)),
        }
    }

    /// Offset of a bit of a neighbourhood.
    pub fn offset(bit: u32) -> IVec3 {
        offset(bit)
    }

    /// Returns the 6-components of the mask that share a side with the middle, each by the bit of
    /// one such voxel, and their number. Adding the middle makes no new tunnel if they belong to
    /// different components of the whole mask.
    pub fn parts_beside(&self, mask: u32) -> ([u32; 6], usize) {
        let (mut parts, mut count) = ([0; 6], 0);
        let mut wanted = mask & self.six;
        while wanted != 0 {
            parts[count] = wanted.trailing_zeros();
            count += 1;
            wanted &= !component(mask & self.eighteen, &self.sides, wanted);
        }
        (parts, count)
    }

    /// Whether the mask lies on two opposite sides of the middle.
    fn is_between(&self, mask: u32) -> bool {
        self.opposite.iter().any(|two| mask & two == *two)
    }

    /// Whether the middle of a neighbourhood is simple.
    fn is_simple(&self, mask: u32) -> bool {
        let background = !mask & !(1 << MIDDLE) & ((1 << 27) - 1);
        is_one(mask & self.eighteen, &self.sides, self.six)
            && is_one(background, &self.all, u32::MAX)
    }
}

/// Whether exactly one component contains wanted voxels.
fn is_one(set: u32, neighbours: &[u32; 27], wanted: u32) -> bool {
    let first = set & wanted;
    if first == 0 {
        return false;
    }
    first & !component(set, neighbours, first) == 0
}

/// Returns the component that contains the lowest of some bits.
fn component(set: u32, neighbours: &[u32; 27], first: u32) -> u32 {
    let (mut found, mut open) = (0u32, first & first.wrapping_neg());
    while open != 0 {
        let bit = open.trailing_zeros();
        found |= 1 << bit;
        open = (open | neighbours[bit as usize] & set) & !found;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lumen::pieces;

    fn mask(dims: UVec3, inside: impl Fn(UVec3) -> bool) -> BitVolume {
        let mut out = BitVolume::new(dims);
        for z in 0..dims.z {
            for y in 0..dims.y {
                for x in 0..dims.x {
                    if inside(UVec3::new(x, y, z)) {
                        out.set(x, y, z);
                    }
                }
            }
        }
        out
    }

    #[test]
    fn a_sheet_between_two_rooms_stays_where_it_is_brightest() {
        let dims = UVec3::new(11, 8, 8);
        let within = |v: UVec3| v.min_element() > 0 && v.y < 7 && v.z < 7 && v.x < 10;
        let rooms = mask(dims, |v| within(v) && (v.x < 4 || v.x > 5));
        let allowed = mask(dims, within);
        for bright in [4, 5] {
            let value = |v: UVec3| if v.x == bright { 1.0 } else { 0.0 };
            let thick = thickened(&rooms, &allowed, value, 2);
            assert_eq!(pieces(&thick, 1).len(), 2, "they do not join");
            let all = (1..7).all(|y| (1..7).all(|z| !thick.at(bright, y, z)));
            assert!(all && thick.at(9 - bright, 3, 3));
        }
    }

    #[test]
    fn a_sheet_with_a_hole_or_a_free_edge_is_not_eaten_from_there() {
        let dims = UVec3::new(9, 9, 9);
        let within = |v: UVec3| v.min_element() > 0 && v.max_element() < 8;
        let sheet = |v: UVec3| v.x == 4 && v.z < 6 && !(v.y == 4 && v.z == 3);
        let rooms = mask(dims, |v| within(v) && !sheet(v));
        let thick = thickened(&rooms, &mask(dims, within), |_| 0.0, 2);
        let kept = |y: u32, z: u32| !thick.at(4, y, z);
        assert!((1..8).all(|y| (1..6).all(|z| kept(y, z) || (y, z) == (4, 3))));
        assert!(thick.at(4, 4, 3) && thick.at(4, 4, 6));
    }

    #[test]
    fn a_ball_grows_by_layers_and_not_beyond_what_is_allowed() {
        let dims = UVec3::splat(15);
        let far = |v: UVec3| (v.as_ivec3() - 7).length_squared();
        let ball = |r: i32| move |v: UVec3| far(v) <= r * r;
        let (small, room) = (mask(dims, ball(3)), mask(dims, ball(4)));
        let thick = thickened(&small, &room, |v| f64::from(far(v)), 3);
        assert_eq!(thick.count(), room.count());
    }
}
