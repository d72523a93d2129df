//! Outline of the wall in a slice: the plane's cut through its triangles, as fine lines.

use glam::{DVec2, DVec3};

use super::slices::{OUTLINE, SlicePlane};
use crate::geometry::TriangleBvh;

/// Half of a line's width, pixels; beyond it the line fades over one pixel.
const HALF_WIDTH: f64 = 0.35;

/// Draws the outline of a wall over a slice.
pub(super) fn draw_wall_outline(
    tree: &TriangleBvh,
    plane: &SlicePlane,
    size: [usize; 2],
    out: &mut [[u8; 3]],
) {
    cut(tree, plane, size, |a, b| line(a, b, size, out));
}

/// Passes on the segments, pixels, in which a plane cuts the triangles that the picture shows.
fn cut(
    tree: &TriangleBvh,
    plane: &SlicePlane,
    size: [usize; 2],
    mut segment: impl FnMut(DVec2, DVec2),
) {
    let axes = [plane.right, plane.down, plane.right.cross(plane.down)];
    let half_picture = size.map(|s| 0.5 * s as f64 * plane.mm_per_px);
    let reach = [half_picture[0], half_picture[1], 0.0];
    let mut open = vec![tree.root()];
    while let Some(part) = open.pop() {
        if part.count == 0 {
            continue;
        }
        let (lo, hi) = tree.bounds(part);
        let (lo, hi) = (lo.as_dvec3(), hi.as_dvec3());
        let (middle, half) = (0.5 * (lo + hi) - plane.centre_mm, 0.5 * (hi - lo));
        let is_beside = |(axis, reach): (&DVec3, f64)| {
            axis.dot(middle).abs() > reach + axis.abs().dot(half) + 1e-9
        };
        if axes.iter().zip(reach).any(is_beside) {
            continue;
        }
        if !part.is_leaf() {
            open.extend(part.children());
            continue;
        }
        for place in part.triangles() {
            let corners = tree.triangle(place).map(|c| c.as_dvec3() - plane.centre_mm);
            if let Some([a, b]) = cut_triangle(corners, axes[2]) {
                let px = |p: DVec3| {
                    let at = DVec2::new(p.dot(plane.right), p.dot(plane.down));
                    at / plane.mm_per_px + 0.5 * DVec2::new(size[0] as f64, size[1] as f64)
                };
                segment(px(a), px(b));
            }
        }
    }
}

/// The segment in which the plane through the origin cuts a triangle. Corners on the plane count as
/// behind it.
fn cut_triangle(corners: [DVec3; 3], normal: DVec3) -> Option<[DVec3; 2]> {
    let height = corners.map(|c| c.dot(normal));
    let mut ends = [None; 2];
    for (i, j) in [(0, 1), (1, 2), (2, 0)] {
        if (height[i] > 0.0) != (height[j] > 0.0) {
            let at = corners[i].lerp(corners[j], height[i] / (height[i] - height[j]));
            let free = ends.iter_mut().find(|end| end.is_none());
            free.into_iter().for_each(|end| *end = Some(at));
        }
    }
    let [a, b] = ends;
    Some([a?, b?])
}

/// Draws a line over the pixels near to it.
fn line(a: DVec2, b: DVec2, [width, height]: [usize; 2], out: &mut [[u8; 3]]) {
    let (low, high) = (a.min(b) - 1.5, a.max(b) + 1.5);
    let range = |low: f64, high: f64, size: usize| {
        let from = low.floor().clamp(0.0, size as f64) as usize;
        from..(high.ceil().clamp(0.0, size as f64) as usize)
    };
    let along = b - a;
    let length2 = along.length_squared().max(1e-12);
    for y in range(low.y, high.y, height) {
        for x in range(low.x, high.x, width) {
            let from_a = DVec2::new(x as f64 + 0.5, y as f64 + 0.5) - a;
            let share = (from_a.dot(along) / length2).clamp(0.0, 1.0);
            let off = (from_a - share * along).length();
            let alpha = (HALF_WIDTH + 0.5 - off).min(1.0);
            if alpha <= 0.0 {
                continue;
            }
            let pixel = &mut out[y * width + x];
            for (shown, line) in pixel.iter_mut().zip(OUTLINE) {
                // Of lines that meet in a pixel the nearer one counts, not their sum.
                let mixed = f64::from(*shown) * (1.0 - alpha) + f64::from(line) * alpha;
                // Rounded by truncation, which is no call.
                *shown = (mixed + 0.5) as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::action::Pane;
    use super::*;
    use crate::geometry::shapes::sphere;

    /// Slices showed the edge of the voxels instead of the wall: stairs of half a voxel.
    #[test]
    fn a_sphere_is_cut_to_a_round_and_closed_line() {
        let (radius, size) = (5.0, [240, 200]);
        let tree = TriangleBvh::new(&sphere(radius, 60));
        let mm_per_px = 0.07;
        let plane =
            SlicePlane::of(Pane::Coronal, DVec3::new(0.3, 3.0, 0.2), mm_per_px, None).unwrap();
        let mut out = vec![[0u8; 3]; size[0] * size[1]];
        draw_wall_outline(&tree, &plane, size, &mut out);
        let cut_radius = (f64::from(radius).powi(2) - 9.0).sqrt();
        let mut seen = [false; 90];
        for (i, _) in out.iter().enumerate().filter(|(_, p)| p[1] > 100) {
            let px = [(i % size[0]) as f64 + 0.5, (i / size[0]) as f64 + 0.5];
            let at = plane.at(px, size) - DVec3::new(0.0, 3.0, 0.0);
            assert!((at.length() - cut_radius).abs() < 1.2 * mm_per_px, "{at}");
            let angle = at.z.atan2(at.x).to_degrees().rem_euclid(360.0);
            seen[(angle / 4.0) as usize % 90] = true;
        }
        assert!(seen.iter().all(|s| *s), "the line is open");
    }

    #[test]
    fn a_plane_beside_the_wall_and_a_part_out_of_the_picture_draw_nothing() {
        let tree = TriangleBvh::new(&sphere(5.0, 20));
        let count = |centre: DVec3| {
            let plane = SlicePlane::of(Pane::Axial, centre, 0.1, None).unwrap();
            let mut n = 0;
            cut(&tree, &plane, [20, 20], |_, _| n += 1);
            n
        };
        assert_eq!(count(DVec3::new(0.0, 0.0, 6.0)), 0);
        assert_eq!(count(DVec3::ZERO), 0, "a picture of two millimetres in the middle");
        assert!(count(DVec3::new(5.0, 0.0, 0.0)) > 0);
    }
}
