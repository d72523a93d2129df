//! Colours of the wall's vertices: what was missed, or how wide the lumen is.

use crate::flight::CenterlineDistances;
use crate::geometry::Mesh;
use crate::render::MISSED;
use crate::wall::Evidence;

/// Colour scale from narrow to wide, sRGB at equal steps: viridis (van der Walt and Smith 2015).
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
pub const NO_WALL: [u8; 3] = [184, 11, 136];
/// Colour of wall drawn on a thin sheet, sRGB.
pub const SHEET: [u8; 3] = [244, 238, 60];

/// Colour of the surface of a pool of fluid, sRGB.
pub const LEVEL: [u8; 3] = [62, 119, 248];

/// Marks the vertices where the scan shows no wall, a thin sheet, or the surface of a pool of fluid.
pub fn evidence_colours(evidence: &[Evidence]) -> Vec<[u8; 4]> {
    let over =
        |[red, green, blue]: [u8; 3], share| [linear(red), linear(green), linear(blue), share];
    let (no_wall, sheet, level) = (over(NO_WALL, 225), over(SHEET, 150), over(LEVEL, 200));
    let colour = |evidence: &Evidence| match evidence {
        Evidence::Profile => [0; 4],
        Evidence::Sheet => sheet,
        Evidence::Limit => no_wall,
        Evidence::FluidLevel => level,
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

/// Colours by distance from the centerline.
pub fn distance_colours(distances: &CenterlineDistances) -> Vec<[u8; 4]> {
    let colour = |mm: &f32| {
        let share = f64::from(*mm) / distances.widest_mm;
        let [red, green, blue] = scale_colour(share).map(linear);
        [red, green, blue, 235]
    };
    distances.mm.iter().map(colour).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::shapes;

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
    fn distances_take_the_colours_of_the_scale_up_to_where_it_ends() {
        let of = |mm: [f32; 3]| {
            distance_colours(&CenterlineDistances { mm: mm.to_vec(), widest_mm: 8.0 })
        };
        let colours = of([4.0, 4.0, 9.0]);
        assert_eq!(colours[0], colours[1]);
        assert_eq!(colours[2], of([8.0; 3])[0], "wider than the scale: its end");
        assert_ne!(colours[0], colours[2]);
        assert_eq!(scale_colour(0.0), VIRIDIS[0]);
        assert_eq!(scale_colour(9.0), VIRIDIS[8]);
        assert_eq!(scale_colour(f64::NAN), VIRIDIS[0]);
    }
}
