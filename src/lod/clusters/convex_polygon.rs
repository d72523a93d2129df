//! Planar convex polygons with few corners, and their splits by planes.

use glam::DVec3;

/// Most corners of a polygon.
pub const MAX_CORNERS: usize = 8;

/// A planar convex polygon, mm.
#[derive(Clone, Copy)]
pub struct ConvexPolygon {
    pub(super) count: usize,
    pub(super) at: [DVec3; MAX_CORNERS],
}

impl ConvexPolygon {
    /// Creates a polygon from its corners; those beyond [`MAX_CORNERS`] are dropped.
    pub fn new(corners: &[DVec3]) -> Self {
        let mut piece =
            Self { count: corners.len().min(MAX_CORNERS), at: [DVec3::ZERO; MAX_CORNERS] };
        piece.at[..piece.count].copy_from_slice(&corners[..piece.count]);
        piece
    }

    /// Corners.
    pub fn corners(&self) -> &[DVec3] {
        &self.at[..self.count]
    }

    /// Mean of its corners.
    pub fn centre(&self) -> DVec3 {
        self.corners().iter().sum::<DVec3>() / self.count.max(1) as f64
    }

    /// Area, mm².
    pub fn area(&self) -> f64 {
        let p = self.corners();
        let fan = p.windows(2).map(|w| (w[0] - p[0]).cross(w[1] - p[0])).sum::<DVec3>();
        0.5 * fan.length()
    }

    /// Signed distances of its corners from a plane.
    pub fn heights(&self, normal: DVec3, through: DVec3) -> [f64; MAX_CORNERS] {
        let mut heights = [0.0; MAX_CORNERS];
        let corners = self.corners().iter();
        heights.iter_mut().zip(corners).for_each(|(h, p)| *h = normal.dot(*p - through));
        heights
    }

    /// Splits by a plane; the part on the side of the normal comes second. `None` if a part had too
    /// many corners.
    pub fn split(&self, normal: DVec3, through: DVec3) -> Option<[Self; 2]> {
        self.split_at(&self.heights(normal, through))
    }

    /// [`Self::split`] by the plane that the corners have these signed distances from.
    pub fn split_at(&self, heights: &[f64; MAX_CORNERS]) -> Option<[Self; 2]> {
        let mut out = [Self { count: 0, at: [DVec3::ZERO; MAX_CORNERS] }; 2];
        let mut put = |side: usize, p: DVec3| {
            let o = &mut out[side];
            *o.at.get_mut(o.count)? = p;
            o.count += 1;
            Some(())
        };
        let corners = self.corners();
        for (i, &p) in corners.iter().enumerate() {
            let j = if i + 1 < corners.len() { i + 1 } else { 0 };
            let (q, hp, hq) = (corners[j], heights[i], heights[j]);
            if hp <= 0.0 {
                put(0, p)?;
            }
            if hp >= 0.0 {
                put(1, p)?;
            }
            if hp * hq < 0.0 {
                let crossing = p + (q - p) * (hp / (hp - hq));
                put(0, crossing)?;
                put(1, crossing)?;
            }
        }
        Some(out)
    }

    /// Longest diagonal: its length and its ends.
    pub fn longest_diagonal(&self) -> (f64, DVec3, DVec3) {
        let p = self.corners();
        let mut best = (0.0, DVec3::ZERO, DVec3::ZERO);
        for i in 0..p.len() {
            for j in 0..i {
                let d = p[i].distance_squared(p[j]);
                if d > best.0 {
                    best = (d, p[i], p[j]);
                }
            }
        }
        (best.0.sqrt(), best.1, best.2)
    }
}
