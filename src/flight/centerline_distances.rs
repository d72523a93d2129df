//! Distances of the wall from the path.

use glam::Vec3;
use rayon::prelude::*;

use super::CenterlinePlaces;
use crate::geometry::{Attachment, Centerline, Mesh, TriangleBvh};

/// Distances of a wall's vertices from a centerline.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CenterlineDistances {
    /// One a vertex, mm.
    pub mm: Vec<f32>,
    /// Returns the end of a scale of colours, mm: all but the widest fiftieth are below.
    pub widest_mm: f64,
}

/// Segment of the centerline that a vertex belongs to, and the distance to it, mm.
type Owned = Option<(Attachment, f64)>;

impl CenterlineDistances {
    /// Distance of each vertex from the stretch of the line that its part of the wall is about. A
    /// vertex belongs to the nearest place of the line if no wall lies between; else to the
    /// stretch of its neighbours on the wall. So the line of a neighbouring bend does not count,
    /// however near it passes behind the wall.
    ///
    /// * `tree`: hierarchy of `wall`.
    pub fn new(wall: &Mesh, tree: &TriangleBvh, line: &Centerline) -> Self {
        let places = CenterlinePlaces::new(line);
        let own = |p: &Vec3| -> Owned {
            let near = places.nearest(p.as_dvec3())?;
            // Boxes are entered in single precision.
            let eye = near.position_mm.as_vec3().as_dvec3();
            let along = (1.0 - AT_THE_WALL) * (p.as_dvec3() - eye);
            let clear = tree.occluder(eye, along, usize::MAX);
            clear.is_none().then_some((near.at, near.distance_mm))
        };
        let mut owned: Vec<Owned> = wall.positions.par_iter().with_min_len(1024).map(own).collect();
        spread(wall, &places, &mut owned);
        let anywhere = |p: &Vec3| places.nearest(p.as_dvec3()).map_or(0.0, |near| near.distance_mm);
        let distance =
            |(owned, p): (&Owned, &Vec3)| owned.map_or_else(|| anywhere(p), |(_, mm)| mm) as f32;
        let mm: Vec<f32> =
            owned.par_iter().zip(&wall.positions).with_min_len(1024).map(distance).collect();
        let mut sorted = mm.clone();
        sorted.sort_by(f32::total_cmp);
        let at = sorted.len().saturating_sub(1) * 49 / 50;
        let widest_mm = sorted.get(at).map_or(1.0, |r| f64::from(*r).max(1e-6));
        Self { mm, widest_mm }
    }
}

/// Share of the way to a vertex within which faces are its own.
const AT_THE_WALL: f64 = 0.02;

/// Gives vertices that belong to no segment that of their neighbours, ring by ring: of several, the
/// one that leads to the least distance, then the first.
fn spread(wall: &Mesh, places: &CenterlinePlaces, owned: &mut [Owned]) {
    let is_open =
        |face: &[u32; 3], owned: &[Owned]| face.iter().any(|v| owned[*v as usize].is_none());
    let mut faces: Vec<[u32; 3]> = wall.faces.clone();
    loop {
        faces.retain(|face| is_open(face, owned));
        let mut ring: Vec<(u32, Attachment, f64)> = Vec::new();
        for face in &faces {
            for v in face.iter().filter(|v| owned[**v as usize].is_none()) {
                let p = wall.positions[*v as usize].as_dvec3();
                let neighbours = face.iter().filter_map(|n| owned[*n as usize]);
                ring.extend(neighbours.map(|(at, _)| {
                    let (at, mm) = places.nearest_about(p, at);
                    (*v, at, mm)
                }));
            }
        }
        if ring.is_empty() {
            return;
        }
        ring.sort_by(|a, b| a.0.cmp(&b.0).then(a.2.total_cmp(&b.2)).then(a.1.cmp(&b.1)));
        ring.dedup_by_key(|(v, ..)| *v);
        for (v, at, mm) in ring {
            owned[v as usize] = Some((at, mm));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::shapes::closed_lattice;
    use crate::geometry::{Branch, CenterlinePoint};
    use glam::DVec3;

    #[test]
    fn the_wall_of_a_tube_is_everywhere_as_far_as_its_radius() {
        let point =
            |x: f64| CenterlinePoint { position_mm: DVec3::X * x, radius_mm: 0.0, abscissa_mm: x };
        let branch = Branch { points: vec![point(0.0), point(50.0)], ..Branch::default() };
        let line = Centerline { branches: vec![branch] };
        let ring = |i: u32| {
            let a = i as f32;
            Vec3::new(i as f32 % 50.0, 4.0 * a.cos(), 4.0 * a.sin())
        };
        let wall = Mesh { positions: (0..300).map(ring).collect(), ..Mesh::default() };
        let of = |wall: &Mesh| CenterlineDistances::new(wall, &TriangleBvh::new(wall), &line);
        let distances = of(&wall);
        assert!(distances.mm.iter().all(|r| (r - 4.0).abs() < 1e-5));
        assert!((distances.widest_mm - 4.0).abs() < 1e-5);
        assert_eq!(of(&Mesh::default()).widest_mm, 1.0);
    }

    #[test]
    fn the_colour_of_a_wide_bend_does_not_show_the_path_of_a_narrow_one_behind_its_wall() {
        // Two tubes along x, 10 and 2 mm wide, a millimetre of wall between them.
        let tube = |y: f32, radius: f32| {
            closed_lattice(40, 60, |along, about| {
                let x = 40.0 * (0.5 * along).sin();
                let out = Vec3::new(0.0, about.cos(), about.sin());
                (Vec3::new(x, y, 0.0) + radius * out, -out)
            })
        };
        let mut wall = tube(0.0, 10.0);
        let wide = wall.positions.len();
        let narrow = tube(13.0, 2.0);
        wall.positions.extend(&narrow.positions);
        wall.faces.extend(narrow.faces.iter().map(|f| f.map(|v| v + wide as u32)));
        let branch = |y: f64| {
            let point = |x: f64| CenterlinePoint {
                position_mm: DVec3::new(x, y, 0.0),
                radius_mm: 0.0,
                abscissa_mm: x,
            };
            Branch { points: (5..=35).map(|x| point(f64::from(x))).collect(), ..Branch::default() }
        };
        let line = Centerline { branches: vec![branch(0.0), branch(13.0)] };
        let distances = CenterlineDistances::new(&wall, &TriangleBvh::new(&wall), &line);
        for (i, mm) in distances.mm.iter().enumerate() {
            // Beyond the ends of the lines they are farther.
            if !(5.0..=35.0).contains(&wall.positions[i].x) {
                continue;
            }
            let wanted = if i < wide { 10.0 } else { 2.0 };
            assert!((mm - wanted).abs() < 0.01, "vertex {i} at {}: {mm}", wall.positions[i]);
        }
    }
}
