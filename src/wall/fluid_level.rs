//! Levels of fluid in a wall about gas: planes across gravity, and no mucosa.
//!
//! Untagged fluid has the values of soft tissue, so that the surface of a pool is drawn as wall. It is
//! known by its form: wall whose normal points straight up, in one plane, and wide in both directions.
//! The bottom of a tube has such normals too, in a strip that is narrow across the tube.

use glam::{DMat2, DVec2, DVec3, Vec3};

use crate::geometry::{DisjointSets, Mesh};

/// Largest angle between normals of a level and the vertical, radians: that of its middle, and that of
/// its rim, where it meets the wall and normals are rounded.
const MAX_TILT_RAD: [f32; 2] = [0.087, 0.35];
/// Largest root mean square of heights about their mean, mean voxel sides; a rim's largest height above
/// or below it.
const MAX_ROUGHNESS: [f64; 2] = [0.25, 0.4];
/// Least standard deviation of places along the narrow side of the middle, mm: a rectangle 9 mm wide.
const MIN_SPREAD_MM: f64 = 2.6;
/// Least area of the middle, mm².
const MIN_AREA_MM2: f64 = 60.0;

/// The surface of a pool of fluid.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct FluidLevel {
    /// Middle, LPS mm.
    pub place_mm: [f64; 3],
    /// Area, mm².
    pub area_mm2: f64,
    /// Vertices of the wall on it.
    #[serde(skip)]
    pub vertices: Vec<u32>,
}

/// Finds the levels of fluid in a wall, the largest first. The patient lies on the back, the front or a
/// side; of these the direction with the largest area of levels is up.
///
/// * `mesh`: with normals; its axes are those of the patient.
/// * `side_mm`: mean side of a voxel.
pub fn fluid_levels(mesh: &Mesh, side_mm: f64) -> Vec<FluidLevel> {
    let ways = [Vec3::NEG_Y, Vec3::Y, Vec3::NEG_X, Vec3::X];
    let found = ways.map(|up| levels_across(mesh, up, side_mm));
    let area = |levels: &Vec<FluidLevel>| levels.iter().map(|l| l.area_mm2).sum::<f64>();
    let most = found.into_iter().reduce(|a, b| if area(&b) > area(&a) { b } else { a });
    let mut levels = most.unwrap_or_default();
    levels.sort_by(|a, b| b.area_mm2.total_cmp(&a.area_mm2));
    levels
}

/// A patch of wall in sums over its faces, weighted by their areas.
#[derive(Clone, Copy, Default)]
struct Patch {
    area_mm2: f64,
    place: DVec3,
    height: f64,
    height2: f64,
    across: DVec2,
    across2: [f64; 3],
}

impl Patch {
    fn add(&mut self, area: f64, place: DVec3, height: f64, across: DVec2) {
        self.area_mm2 += area;
        self.place += area * place;
        self.height += area * height;
        self.height2 += area * height * height;
        self.across += area * across;
        for (sum, product) in self.across2.iter_mut().zip([
            across.x * across.x,
            across.x * across.y,
            across.y * across.y,
        ]) {
            *sum += area * product;
        }
    }

    fn mean_height(&self) -> f64 {
        self.height / self.area_mm2
    }

    fn roughness(&self) -> f64 {
        (self.height2 / self.area_mm2 - self.mean_height().powi(2)).max(0.0).sqrt()
    }

    /// Standard deviation of places along the narrow side.
    fn spread(&self) -> f64 {
        let mean = self.across / self.area_mm2;
        let [xx, xy, yy] = self.across2.map(|sum| sum / self.area_mm2);
        let moments = DMat2::from_cols_array(&[
            xx - mean.x * mean.x,
            xy - mean.x * mean.y,
            xy - mean.x * mean.y,
            yy - mean.y * mean.y,
        ]);
        let half = 0.5 * (moments.x_axis.x + moments.y_axis.y);
        let root = (half * half - moments.determinant()).max(0.0).sqrt();
        (half - root).max(0.0).sqrt()
    }
}

/// Finds the levels whose normal points to one side of the patient.
fn levels_across(mesh: &Mesh, up: Vec3, side_mm: f64) -> Vec<FluidLevel> {
    let is_steep = |v: u32, tilt: f32| mesh.normals[v as usize].dot(up) > tilt.cos();
    let up = up.as_dvec3();
    let aside = DVec3::Z.cross(up);
    let height = |v: u32| mesh.positions[v as usize].as_dvec3().dot(up);

    // 1. Connected faces that look up, apart from caps.
    let mut sets = DisjointSets::new(mesh.positions.len());
    let is_wall = |face: &(usize, &[u32; 3])| !mesh.caps.get(face.0).is_some_and(|cap| *cap);
    let middles = |face: &(usize, &[u32; 3])| face.1.iter().all(|v| is_steep(*v, MAX_TILT_RAD[0]));
    let faces: Vec<[u32; 3]> =
        mesh.faces.iter().enumerate().filter(is_wall).filter(middles).map(|f| *f.1).collect();
    for [a, b, c] in &faces {
        sets.join(*a, *b);
        sets.join(*b, *c);
    }
    let mut patches = std::collections::BTreeMap::<u32, Patch>::new();
    for face in &faces {
        let area = 0.5 * f64::from(mesh.face_cross(*face).length());
        let corners = face.map(|v| mesh.positions[v as usize].as_dvec3());
        let place = corners.iter().sum::<DVec3>() / 3.0;
        let across = DVec2::new(place.z, place.dot(aside));
        patches.entry(sets.root(face[0])).or_default().add(area, place, place.dot(up), across);
    }

    // 2. Those that are wide and flat.
    patches.retain(|_, patch| {
        patch.area_mm2 >= MIN_AREA_MM2
            && patch.roughness() <= MAX_ROUGHNESS[0] * side_mm
            && patch.spread() >= MIN_SPREAD_MM
    });
    if patches.is_empty() {
        return Vec::new();
    }

    // 3. With their rims: the faces about them, in the same plane.
    let mut of_vertex = vec![u32::MAX; mesh.positions.len()];
    for face in &faces {
        let root = sets.root(face[0]);
        if patches.contains_key(&root) {
            face.iter().for_each(|v| of_vertex[*v as usize] = root);
        }
    }
    let may_join = |v: u32, patch: &Patch| {
        let off = (height(v) - patch.mean_height()).abs();
        off <= MAX_ROUGHNESS[1] * side_mm && is_steep(v, MAX_TILT_RAD[1])
    };
    let mut grows = true;
    while grows {
        grows = false;
        for face in mesh.faces.iter().enumerate().filter(is_wall).map(|f| f.1) {
            let root = face.iter().map(|v| of_vertex[*v as usize]).min().unwrap_or(u32::MAX);
            let Some(patch) = patches.get(&root) else { continue };
            for v in face.iter().filter(|v| may_join(**v, patch)) {
                let own = &mut of_vertex[*v as usize];
                grows |= *own == u32::MAX;
                *own = (*own).min(root);
            }
        }
    }

    // 4. Area of the faces on them.
    let mut levels: std::collections::BTreeMap<u32, FluidLevel> = patches
        .iter()
        .map(|(root, patch)| {
            let place_mm = (patch.place / patch.area_mm2).to_array();
            (*root, FluidLevel { place_mm, area_mm2: 0.0, vertices: Vec::new() })
        })
        .collect();
    for face in mesh.faces.iter().enumerate().filter(is_wall).map(|f| f.1) {
        let [a, b, c] = face.map(|v| of_vertex[v as usize]);
        if let Some(level) = levels.get_mut(&a).filter(|_| a == b && b == c) {
            level.area_mm2 += 0.5 * f64::from(mesh.face_cross(*face).length());
        }
    }
    for (v, root) in of_vertex.iter().enumerate() {
        levels.get_mut(root).into_iter().for_each(|level| level.vertices.push(v as u32));
    }
    levels.into_values().collect()
}
