//! Colours of the wall's vertices: what was missed, or how wide the lumen is.

use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::{Centerline, Mesh, TriangleBvh};
use crate::wall::Evidence;

/// Of wall that no picture has shown; linear, eight bits each, and the share of the tissue's colour
/// that it replaces.
const MISSED: [u8; 4] = [8, 60, 205, 235];
/// From narrow to wide: viridis of matplotlib (van der Walt and Smith 2015) at equal steps, as sRGB.
const VIRIDIS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 44, 122],
    [59, 81, 139],
    [44, 113, 142],
    [33, 144, 141],
    [39, 173, 129],
    [92, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];

/// Colour of wall where the scan shows none, sRGB.
pub const NO_WALL: [u8; 3] = [205, 50, 190];
/// Colour of wall drawn on a thin sheet, sRGB.
pub const SHEET: [u8; 3] = [235, 190, 60];

/// Marks the vertices where the scan shows no wall, and those where it shows a thin sheet.
pub fn evidence_colours(evidence: &[Evidence]) -> Vec<[u8; 4]> {
    let over =
        |[red, green, blue]: [u8; 3], share| [linear(red), linear(green), linear(blue), share];
    let (no_wall, sheet) = (over(NO_WALL, 225), over(SHEET, 150));
    let colour = |evidence: &Evidence| match evidence {
        Evidence::Profile => [0; 4],
        Evidence::Sheet => sheet,
        Evidence::Limit => no_wall,
    };
    evidence.iter().map(colour).collect()
}

fn linear(srgb: u8) -> u8 {
    let c = f64::from(srgb) / 255.0;
    let l = if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
    (l * 255.0).round() as u8
}

/// Marks the vertices of faces that were not seen; caps are no wall.
///
/// * `seen`: one flag a face.
pub fn missed_colours(wall: &Mesh, seen: &[bool]) -> Vec<[u8; 4]> {
    let mut colours = vec![[0; 4]; wall.positions.len()];
    for (i, (face, seen)) in wall.faces.iter().zip(seen).enumerate() {
        if !seen && !wall.caps.get(i).copied().unwrap_or(false) {
            face.iter().for_each(|v| colours[*v as usize] = MISSED);
        }
    }
    colours
}

/// A colour of the scale, encoded as sRGB, 0 to 1 from narrow to wide.
pub fn scale_colour(share: f64) -> [u8; 3] {
    let share = if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) };
    let at = share * (VIRIDIS.len() - 1) as f64;
    let i = (at as usize).min(VIRIDIS.len() - 2);
    let t = at - i as f64;
    let mix = |k: usize| {
        let (a, b) = (f64::from(VIRIDIS[i][k]), f64::from(VIRIDIS[i + 1][k]));
        (a + (b - a) * t).round() as u8
    };
    [mix(0), mix(1), mix(2)]
}

/// Distances of a wall's vertices from a centerline.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WallRadii {
    /// One a vertex, mm.
    pub mm: Vec<f32>,
    /// Where the scale of colours ends, mm: but for the widest fiftieth, all are below.
    pub widest_mm: f64,
}

impl WallRadii {
    /// Distance of each vertex from the nearest place of the line.
    pub fn new(wall: &Mesh, line: &Centerline) -> Self {
        // Segments as triangles without area: the hierarchy finds the nearest.
        let mut segments = Mesh::default();
        for branch in &line.branches {
            for w in branch.points.windows(2) {
                let first = segments.positions.len() as u32;
                segments.positions.extend(w.iter().map(|p| p.position_mm.as_vec3()));
                segments.faces.push([first, first + 1, first + 1]);
            }
        }
        let tree = TriangleBvh::new(&segments);
        let radius =
            |p: &Vec3| tree.closest(p.as_dvec3()).map_or(0.0, |near| near.distance_mm as f32);
        let mm: Vec<f32> = wall.positions.par_iter().with_min_len(1024).map(radius).collect();
        let mut sorted = mm.clone();
        sorted.sort_by(f32::total_cmp);
        let at = sorted.len().saturating_sub(1) * 49 / 50;
        let widest_mm = sorted.get(at).map_or(1.0, |r| f64::from(*r).max(1e-6));
        Self { mm, widest_mm }
    }

    /// Colours by distance.
    pub fn colours(&self) -> Vec<[u8; 4]> {
        let colour = |r: &f32| {
            let [red, green, blue] = scale_colour(f64::from(*r) / self.widest_mm).map(linear);
            [red, green, blue, 235]
        };
        self.mm.iter().map(colour).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Branch, CenterlinePoint, shapes};
    use glam::DVec3;

    #[test]
    fn vertices_of_a_face_that_was_not_seen_are_marked_and_caps_are_not() {
        let mut wall = shapes::boxed(2);
        let mut seen = vec![true; wall.faces.len()];
        (seen[3], seen[9]) = (false, false);
        wall.caps = vec![false; wall.faces.len()];
        wall.caps[9] = true;
        let colours = missed_colours(&wall, &seen);
        let marked: Vec<u32> =
            (0..colours.len() as u32).filter(|v| colours[*v as usize] != [0; 4]).collect();
        let mut wanted = wall.faces[3].to_vec();
        wanted.sort_unstable();
        assert_eq!(marked, wanted);
    }

    #[test]
    fn wall_on_nothing_and_wall_on_a_sheet_are_told_apart_and_plain_wall_stays_plain() {
        let colours = evidence_colours(&[Evidence::Profile, Evidence::Sheet, Evidence::Limit]);
        assert_eq!(colours[0][3], 0, "plain");
        assert!(colours[1][3] > 0 && colours[1][3] < colours[2][3], "a sheet shines through");
        let [red, green, _] = colours[2].map(i32::from)[..3] else { panic!() };
        assert!(red > 4 * green, "magenta");
    }

    #[test]
    fn a_tube_has_the_colour_of_its_radius_all_over() {
        let point =
            |x: f64| CenterlinePoint { position_mm: DVec3::X * x, radius_mm: 0.0, abscissa_mm: x };
        let branch = Branch { points: vec![point(0.0), point(50.0)], ..Branch::default() };
        let line = Centerline { branches: vec![branch] };
        let ring = |i: u32| {
            let a = i as f32;
            Vec3::new(i as f32 % 50.0, 4.0 * a.cos(), 4.0 * a.sin())
        };
        let wall = Mesh { positions: (0..300).map(ring).collect(), ..Mesh::default() };
        let radii = WallRadii::new(&wall, &line);
        assert!(radii.mm.iter().all(|r| (r - 4.0).abs() < 1e-5));
        assert!((radii.widest_mm - 4.0).abs() < 1e-5);
        assert_eq!(WallRadii::new(&Mesh::default(), &line).widest_mm, 1.0);
        let colours = WallRadii { widest_mm: 8.0, ..radii }.colours();
        assert!(colours.iter().all(|c| *c == colours[0]), "4 of 8 mm everywhere");
        assert_eq!(scale_colour(0.0), VIRIDIS[0]);
        assert_eq!(scale_colour(9.0), VIRIDIS[8]);
        assert_eq!(scale_colour(f64::NAN), VIRIDIS[0]);
    }
}
