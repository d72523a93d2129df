//! Collision response: an eye that is moved by hand slides along the wall and never through it.

use glam::DVec3;

use super::{Clearance, SAFETY};
use crate::geometry::Lens;

/// Most substeps of one move; the rest of the move is dropped.
const MAX_SUBSTEPS: usize = 64;
/// Most corrections of one substep.
const MAX_CORRECTIONS: usize = 4;

/// Moves an eye by `delta_mm`, gliding along the wall where it is in the way.
///
/// * `from_mm`: position of the eye, LPS mm; where the lens has no room the eye does not move.
///
/// Each substep is at most half the proven distance to the wall. Where the near ball would come
/// nearer than it may, the component of the step towards the wall is removed and the eye is pushed
/// away from it. Every position returned is proven as for the frames of a flight: the wall is more
/// than the near ball's radius away ([`Clearance`]). A move ends before the straight line from its
/// start would cut the wall, as it may where the eye slides round a fold: between two frames the
/// eye is shown along that line.
pub fn collide_and_slide(
    from_mm: DVec3,
    delta_mm: DVec3,
    wall: &Clearance<'_>,
    lens: Lens,
) -> DVec3 {
    let need = SAFETY * f64::from(lens.near_ball_mm());
    let mut at = from_mm;
    let mut left = delta_mm;
    if !delta_mm.is_finite() {
        return at;
    }
    for _ in 0..MAX_SUBSTEPS {
        if left.length() < 1e-9 {
            break;
        }
        let room = wall.proven_mm(at, need.max((2.0 * left.length()).min(4.0 * need)));
        if room < need {
            break;
        }
        let mut step = left.clamp_length_max(0.5 * room);
        left -= step;
        let mut push = DVec3::ZERO;
        let mut next = None;
        for _ in 0..=MAX_CORRECTIONS {
            // Shorter than the room about `at`: the wall cannot be jumped.
            let to = at + (step + push).clamp_length_max(0.9 * room);
            let there = wall.proven_mm(to, need);
            if there >= need {
                next = Some(to);
                break;
            }
            let Some(away) = wall.away(to).or_else(|| wall.away(at)) else { break };
            step -= away.dot(step).min(0.0) * away;
            push += (need - there) * away;
        }
        match next.filter(|to| is_free(from_mm, *to, wall)) {
            Some(to) => at = to,
            None => break,
        }
    }
    at
}

/// Most steps of a march along a segment.
const MAX_MARCH: usize = 256;
/// Distance to the wall, mm, below which a segment counts as cut.
const TOUCH_MM: f64 = 1e-3;

/// Whether a segment keeps away from the wall: it is marched in steps as long as the distance to
/// the wall.
fn is_free(from: DVec3, to: DVec3, wall: &Clearance<'_>) -> bool {
    let mut at = from;
    for _ in 0..MAX_MARCH {
        let left = at.distance(to);
        let room = wall.proven_mm(at, left);
        if room >= left {
            return true;
        }
        if room < TOUCH_MM {
            return false;
        }
        at += (to - at) * (room / left);
    }
    false
}
