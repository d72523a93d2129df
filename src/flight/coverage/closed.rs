//! Whether a wall is closed.

use crate::geometry::Mesh;

/// Whether every edge is walked as often one way as the other: the sum of a hash of each directed
/// edge, its reverse counted against it.
pub(super) fn is_closed(wall: &Mesh) -> bool {
    let mix = |a: u32, b: u32| {
        let n = u64::from(a) << 32 | u64::from(b);
        let n = (n ^ n >> 31).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let n = (n ^ n >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        n ^ n >> 32
    };
    let signed = |a: u32, b: u32| {
        if a < b { mix(a, b) } else { mix(b, a).wrapping_neg() }
    };
    let sum = wall.faces.iter().fold(0u64, |sum, [a, b, c]| {
        let edges = [(*a, *b), (*b, *c), (*c, *a)];
        edges.iter().filter(|e| e.0 != e.1).fold(sum, |s, e| s.wrapping_add(signed(e.0, e.1)))
    });
    sum == 0
}
