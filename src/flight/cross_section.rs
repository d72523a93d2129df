//! The cross-section of a closed wall: the outline, about a point, of the part of a plane that is
//! inside.

use glam::{DVec2, DVec3};

use crate::geometry::{Mesh, TriangleBvh};

/// Cross-section of the lumen by a plane, about a point.
#[derive(Clone, Debug, PartialEq)]
pub struct CrossSection {
    /// Area of the lumen, mm²; holes are not part of it.
    pub area_mm2: f64,
    /// Length of the outer outline, mm.
    pub perimeter_mm: f64,
    /// Largest Feret diameter, mm: the largest distance of two points of the outline.
    pub largest_diameter_mm: f64,
    /// Least Feret diameter, mm: the least distance of two parallel lines with the outline between
    /// them.
    pub smallest_diameter_mm: f64,
    /// The outer outline, LPS mm, closed; once around.
    pub outline: Vec<DVec3>,
}

/// An edge of the mesh by its vertices, the lower one first.
pub(super) type FaceEdge = (u32, u32);

/// A piece of outline across one face, from the edge where it enters to the edge where it leaves.
pub(super) struct OutlineSegment {
    pub from: FaceEdge,
    pub to: FaceEdge,
    pub start: DVec2,
}

/// A closed outline in the plane.
struct Outline {
    points: Vec<DVec2>,
    /// Signed area, positive counter-clockwise.
    area: f64,
}

impl Outline {
    /// Whether the outline winds about a point.
    fn holds(&self, p: DVec2) -> bool {
        let mut inside = false;
        for (a, b) in closed(&self.points) {
            if (a.y > p.y) != (b.y > p.y) {
                let x = a.x + (p.y - a.y) / (b.y - a.y) * (b.x - a.x);
                inside ^= p.x < x;
            }
        }
        inside
    }
}

/// Pairs each point with the next one, the last with the first.
fn closed(points: &[DVec2]) -> impl Iterator<Item = (DVec2, DVec2)> {
    points.iter().zip(points.iter().cycle().skip(1)).map(|(a, b)| (*a, *b))
}

/// Cuts a wall with the plane through `at_mm` across `normal`. `None` if no closed outline goes round
/// that point: it is outside, or the wall is open there.
///
/// * `wall`: closed, LPS mm; `tree` is its hierarchy.
///
/// Vertices on the plane count as behind it, so that every face that is cut has two cut edges and
/// outlines of a closed wall close. Exact but for rounding: areas are those of the polygon that the
/// plane cuts out of the triangles.
pub fn cross_section(
    wall: &Mesh,
    tree: &TriangleBvh,
    at_mm: DVec3,
    normal: DVec3,
) -> Option<CrossSection> {
    let n = normal.try_normalize()?;
    if !at_mm.is_finite() {
        return None;
    }
    let u = n.any_orthonormal_vector();
    let v = n.cross(u);
    // Outlines do not cross, so all that hold the point lie in one another: what a sphere about the
    // point has of them decides as soon as it has one.
    let (low, high) = tree.bounds(tree.root());
    let diagonal = f64::from(low.distance(high));
    let reaches = [diagonal / 16.0, diagonal / 4.0, f64::INFINITY];
    let (outlines, outer) = reaches.into_iter().find_map(|reach| {
        let outlines = outlines(pieces(wall, tree, at_mm, [n, u, v], reach));
        let holding = (0..outlines.len()).filter(|i| outlines[*i].holds(DVec2::ZERO));
        let size = |i: &usize| outlines[*i].area.abs();
        let outer = holding.min_by(|a, b| size(a).total_cmp(&size(b)))?;
        Some((outlines, outer))
    })?;
    // Faces look into the lumen: it is on the right of each piece.
    let outer = Some(&outlines[outer]).filter(|o| o.area < 0.0)?;
    // Holes turn the other way; those of an island within a hole belong to the island.
    let is_hole = |o: &&Outline| {
        let first = o.points[0];
        let parent = outlines
            .iter()
            .filter(|p| !std::ptr::eq(*p, *o) && p.holds(first))
            .min_by(|a, b| a.area.abs().total_cmp(&b.area.abs()));
        o.area > 0.0 && parent.is_some_and(|p| std::ptr::eq(p, outer))
    };
    let holes: f64 = outlines.iter().filter(is_hole).map(|o| o.area.abs()).sum();
    let (largest, smallest) = feret_diameters(&outer.points);
    Some(CrossSection {
        area_mm2: outer.area.abs() - holes,
        perimeter_mm: closed(&outer.points).map(|(a, b)| a.distance(b)).sum(),
        largest_diameter_mm: largest,
        smallest_diameter_mm: smallest,
        outline: outer.points.iter().map(|p| at_mm + u * p.x + v * p.y).collect(),
    })
}

/// Returns the segments in which the plane cuts the faces that come within `reach` of the point, each
/// with the inside on the same side, and some of those beyond.
pub(super) fn pieces(
    wall: &Mesh,
    tree: &TriangleBvh,
    at: DVec3,
    [n, u, v]: [DVec3; 3],
    reach: f64,
) -> Vec<OutlineSegment> {
    let mut out = Vec::new();
    let mut open = vec![tree.root()];
    while let Some(s) = open.pop() {
        if s.count == 0 {
            continue;
        }
        let (lo, hi) = tree.bounds(s);
        let (lo, hi) = (lo.as_dvec3(), hi.as_dvec3());
        let (centre, half) = (0.5 * (lo + hi) - at, 0.5 * (hi - lo));
        let beside = n.dot(centre).abs() > n.abs().dot(half) * (1.0 + 1e-9) + 1e-9;
        if beside || (centre.abs() - half).max(DVec3::ZERO).length() > reach {
            continue;
        }
        if !s.is_leaf() {
            open.extend(s.children());
            continue;
        }
        for place in s.triangles() {
            let face = wall.faces[tree.face(place) as usize];
            let corner = face.map(|i| wall.positions[i as usize].as_dvec3() - at);
            let height = corner.map(|c| n.dot(c));
            // Edges from before the plane to behind it and back, walking round the face.
            let (mut falls, mut rises) = (None, None);
            for i in 0..3 {
                let j = (i + 1) % 3;
                match (height[i] > 0.0, height[j] > 0.0) {
                    (true, false) => falls = Some((i, j)),
                    (false, true) => rises = Some((i, j)),
                    _ => {}
                }
            }
            let (Some(falls), Some(rises)) = (falls, rises) else { continue };
            let edge = |(i, j): (usize, usize)| -> FaceEdge {
                (face[i].min(face[j]), face[i].max(face[j]))
            };
            let (i, j) = falls;
            // From the lower vertex on, so that both faces of an edge find the same point.
            let (a, b) = if face[i] < face[j] { (i, j) } else { (j, i) };
            let p = corner[a].lerp(corner[b], height[a] / (height[a] - height[b]));
            let start = DVec2::new(u.dot(p), v.dot(p));
            out.push(OutlineSegment { from: edge(falls), to: edge(rises), start });
        }
    }
    out
}

/// Links pieces that share an edge into closed outlines; open ones are left out.
fn outlines(mut pieces: Vec<OutlineSegment>) -> Vec<Outline> {
    pieces.sort_by_key(|p| (p.from, p.to));
    let mut used = vec![false; pieces.len()];
    let mut out = Vec::new();
    for first in 0..pieces.len() {
        let (mut points, mut at, mut is_closed) = (Vec::new(), first, false);
        while !used[at] {
            used[at] = true;
            points.push(pieces[at].start);
            let goal = pieces[at].to;
            is_closed = goal == pieces[first].from;
            let from = pieces.partition_point(|p| p.from < goal);
            let next =
                (from..pieces.len()).take_while(|i| pieces[*i].from == goal).find(|i| !used[*i]);
            match next.filter(|_| !is_closed) {
                Some(next) => at = next,
                None => break,
            }
        }
        if is_closed && points.len() > 2 {
            let area = 0.5 * closed(&points).map(|(a, b)| a.perp_dot(b)).sum::<f64>();
            out.push(Outline { points, area });
        }
    }
    out
}

/// Returns the largest and smallest Feret diameter of points.
fn feret_diameters(points: &[DVec2]) -> (f64, f64) {
    let hull = convex_hull(points);
    let mut largest: f64 = 0.0;
    let mut smallest = f64::INFINITY;
    for (i, (a, b)) in closed(&hull).enumerate() {
        largest = hull[i..].iter().fold(largest, |m, p| m.max(a.distance(*p)));
        if let Some(across) = (b - a).try_normalize().map(DVec2::perp) {
            let width = hull.iter().map(|p| across.dot(*p - a).abs()).fold(0.0, f64::max);
            smallest = smallest.min(width);
        }
    }
    (largest, if smallest.is_finite() { smallest } else { 0.0 })
}

/// Returns the convex hull, counter-clockwise, by Andrew's monotone chain (1979,
/// doi:10.1016/0020-0190(79)90072-3).
fn convex_hull(points: &[DVec2]) -> Vec<DVec2> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    sorted.dedup();
    let chain = |points: &mut dyn Iterator<Item = &DVec2>| {
        let mut hull: Vec<DVec2> = Vec::new();
        for p in points {
            while let [.., a, b] = hull[..]
                && (b - a).perp_dot(*p - b) <= 0.0
            {
                hull.pop();
            }
            hull.push(*p);
        }
        hull.pop();
        hull
    };
    if sorted.len() < 3 {
        return sorted;
    }
    let mut hull = chain(&mut sorted.iter());
    hull.extend(chain(&mut sorted.iter().rev()));
    hull
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::shapes::{boxed, sphere};
    use std::f64::consts::PI;

    fn cut(mesh: &Mesh, at: DVec3, normal: DVec3) -> Option<CrossSection> {
        cross_section(mesh, &TriangleBvh::new(mesh), at, normal)
    }

    #[test]
    fn planes_through_a_sphere_cut_circles() {
        let mesh = sphere(10.0, 64);
        for (at, normal) in [
            (DVec3::ZERO, DVec3::Z),
            (DVec3::new(1.0, 2.0, 3.0), DVec3::new(0.3, -0.5, 0.8)),
            (DVec3::new(0.0, 0.0, 9.0), DVec3::new(0.1, 0.0, 1.0)),
        ] {
            let s = cut(&mesh, at, normal).unwrap();
            let n = normal.normalize();
            let r = (100.0 - n.dot(at).powi(2)).sqrt();
            assert!((s.area_mm2 / (PI * r * r) - 1.0).abs() < 4e-3, "{} {r}", s.area_mm2);
            assert!((s.perimeter_mm / (2.0 * PI * r) - 1.0).abs() < 3e-3);
            assert!((s.largest_diameter_mm / (2.0 * r) - 1.0).abs() < 3e-3);
            assert!((s.smallest_diameter_mm / (2.0 * r) - 1.0).abs() < 3e-3);
            assert!(s.outline.iter().all(|p| n.dot(*p - at).abs() < 1e-6));
        }
        assert_eq!(cut(&mesh, DVec3::X * 10.5, DVec3::Z), None);
        assert_eq!(cut(&mesh, DVec3::ZERO, DVec3::ZERO), None);
        assert_eq!(cut(&mesh, DVec3::NAN, DVec3::Z), None);
    }

    #[test]
    fn a_box_is_cut_to_its_sides_also_where_vertices_lie_on_the_plane() {
        let mut mesh = boxed(4);
        mesh.positions.iter_mut().for_each(|p| *p *= glam::Vec3::new(3.0, 2.0, 1.0));
        for z in [0.0, 0.25, -0.5] {
            let s = cut(&mesh, DVec3::new(0.1, 0.2, z), DVec3::Z).unwrap();
            assert!((s.area_mm2 - 24.0).abs() < 1e-5, "{}", s.area_mm2);
            assert!((s.largest_diameter_mm - 52f64.sqrt()).abs() < 1e-5);
            assert!((s.smallest_diameter_mm - 4.0).abs() < 1e-5);
            assert!((s.perimeter_mm - 20.0).abs() < 1e-5);
        }
    }

    #[test]
    fn a_pillar_is_a_hole_and_what_is_beside_is_not_counted() {
        let outer = sphere(10.0, 48);
        let mut mesh = outer.clone();
        // A ball of wall inside the lumen, seen from outside; and another lumen far away.
        let turned = |f: &[u32; 3], first: u32| [f[0] + first, f[2] + first, f[1] + first];
        for (shift, radius, flip) in [(5.0, 2.0, true), (40.0, 10.0, false)] {
            let first = mesh.positions.len() as u32;
            let ball = sphere(radius, 48);
            mesh.positions.extend(ball.positions.iter().map(|p| *p + shift * glam::Vec3::X));
            mesh.faces.extend(ball.faces.iter().map(|f| match flip {
                true => turned(f, first),
                false => f.map(|v| v + first),
            }));
        }
        let s = cut(&mesh, DVec3::ZERO, DVec3::Z).unwrap();
        let whole = cut(&outer, DVec3::ZERO, DVec3::Z).unwrap();
        assert!((s.area_mm2 - (whole.area_mm2 - PI * 4.0)).abs() < 0.05, "{}", s.area_mm2);
        assert_eq!(s.largest_diameter_mm, whole.largest_diameter_mm);
        assert_eq!(cut(&mesh, DVec3::X * 5.0, DVec3::Z), None, "within the pillar");
        let beside = cut(&mesh, DVec3::X * 40.0, DVec3::Z).unwrap();
        assert!((beside.area_mm2 - whole.area_mm2).abs() < 1e-3);
    }

    #[test]
    fn a_small_lumen_far_from_others_is_cut_as_if_it_were_alone() {
        let alone = sphere(10.0, 32);
        let mut mesh = alone.clone();
        // About the small one, so that an outline goes round an outline.
        let far = sphere(200.0, 32);
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(&far.positions);
        mesh.faces.extend(far.faces.iter().map(|f| f.map(|v| v + first)));
        let normal = DVec3::new(0.1, 0.2, 1.0);
        assert_eq!(cut(&mesh, DVec3::X, normal), cut(&alone, DVec3::X, normal));
        let beyond = DVec3::X * 100.0;
        let [both, large] = [&mesh, &far].map(|m| cut(m, beyond, normal).unwrap());
        assert_eq!(both.outline, large.outline);
    }

    #[test]
    fn an_ellipse_has_its_axes_as_diameters() {
        let mut mesh = sphere(1.0, 96);
        mesh.positions.iter_mut().for_each(|p| *p *= glam::Vec3::new(12.0, 7.0, 30.0));
        let s = cut(&mesh, DVec3::new(2.0, 1.0, 0.0), DVec3::Z).unwrap();
        assert!((s.largest_diameter_mm - 24.0).abs() < 0.05, "{}", s.largest_diameter_mm);
        assert!((s.smallest_diameter_mm - 14.0).abs() < 0.05, "{}", s.smallest_diameter_mm);
        assert!((s.area_mm2 / (PI * 84.0) - 1.0).abs() < 2e-3);
    }
}
