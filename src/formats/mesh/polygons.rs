//! Triangles of concave polygons. A fan covers a polygon only where all of it is seen from its first
//! corner.

use earcut::Earcut;
use earcut::utils3d::project3d_to_2d;
use glam::DVec3;

use super::RawMesh;

/// Most corners of a polygon that is cut by its shape: one with more stays a fan.
const MAX_CORNERS: usize = 10_000;

impl RawMesh {
    /// Cuts the fans of concave polygons anew, into as many triangles.
    pub fn cut_concave(&mut self) {
        let mut cutter = Earcut::new();
        let (mut flat, mut cut) = (Vec::new(), Vec::<u32>::new());
        for &(first, count) in &self.polygons {
            if count + 2 > MAX_CORNERS {
                continue;
            }
            let fan = &mut self.faces[first..first + count];
            let corners = corners(fan);
            let at: Vec<DVec3> =
                corners.iter().map(|v| self.positions[*v as usize].as_dvec3()).collect();
            let normal = normal(&at);
            let faces_back = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).dot(normal) < 0.0;
            if !at[1..].windows(2).any(|w| faces_back([at[0], w[0], w[1]])) {
                continue;
            }
            let places: Vec<[f64; 3]> = at.iter().map(|p| p.to_array()).collect();
            if !project3d_to_2d(&places, places.len(), &mut flat) {
                continue;
            }
            cutter.earcut(flat.iter().copied(), &[], &mut cut);
            // Of a polygon that crosses itself fewer triangles are left.
            if cut.len() != 3 * count {
                continue;
            }
            for (face, of) in fan.iter_mut().zip(cut.chunks_exact(3)) {
                let [a, b, c] = [of[0], of[1], of[2]].map(|k| k as usize);
                let is_turned = faces_back([at[a], at[b], at[c]]);
                let [b, c] = if is_turned { [c, b] } else { [b, c] };
                *face = [corners[a], corners[b], corners[c]];
            }
        }
    }
}

/// The corners of a polygon from its fan.
fn corners(fan: &[[u32; 3]]) -> Vec<u32> {
    let first = fan.first().into_iter().flat_map(|face| [face[0], face[1]]);
    first.chain(fan.iter().map(|face| face[2])).collect()
}

/// The normal of a polygon by Newell's sum, as long as twice its area.
fn normal(at: &[DVec3]) -> DVec3 {
    let next = at.iter().skip(1).chain(at.first());
    at.iter().zip(next).map(|(a, b)| (*a - at[0]).cross(*b - at[0])).sum()
}
