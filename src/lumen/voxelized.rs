//! Voxelization of a closed surface: every voxel whose centre lies inside.

use glam::{DVec2, DVec3, UVec3};

use super::BitVolume;
use crate::geometry::Mesh;
use crate::task::checkpoint;
use crate::volume::{Grid, GridError};

/// Number of voxels in a surface's bounding box where no spacing is requested.
const USUAL_VOXELS: f64 = (1u64 << 24) as f64;
/// Largest number of voxels in the grid.
const MAX_VOXELS: f64 = (1u64 << 31) as f64;
/// Offsets of rays from the voxel's centre, in voxel sides. They are tried in turn where a ray hits
/// an edge or a corner of the surface.
const OFFSETS: [[f64; 2]; 4] =
    [[0.0137, 0.0071], [-0.0113, 0.0173], [0.0059, -0.0191], [-0.0211, -0.0127]];

/// Reasons why a surface encloses no lumen.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum VoxelizeError {
    /// The mesh has no faces.
    #[error("the mesh has no faces")]
    Empty,
    /// The mesh has a boundary, or an edge whose faces are not consistently oriented.
    #[error("the mesh is not closed: {0} edges without a neighbouring face")]
    Open(usize),
    /// The spacing is not a positive length, or gives more than the largest number of voxels.
    #[error(
        "voxels of {spacing_mm} mm: the mesh would need {voxels:.0} of them, at most {MAX_VOXELS:.0}"
    )]
    Spacing {
        /// Side of a voxel, mm.
        spacing_mm: f64,
        /// Number of voxels needed.
        voxels: f64,
    },
    /// No ray of a row passes the surface without meeting an edge.
    #[error("the mesh is not closed near ({x:.2}, {y:.2}, {z:.2}) mm")]
    Crossing {
        /// First coordinate, LPS mm.
        x: f64,
        /// Second coordinate, LPS mm.
        y: f64,
        /// Third coordinate, LPS mm.
        z: f64,
    },
    /// The grid of voxels cannot be made.
    #[error(transparent)]
    Grid(#[from] GridError),
}

/// Grid of the voxels that a surface encloses.
///
/// * `spacing_mm`: side of a voxel; without one the grid gets at most about 2²⁴ voxels.
///
/// # Errors
/// [`VoxelizeError::Empty`], [`VoxelizeError::Spacing`], [`VoxelizeError::Grid`].
pub fn enclosing_grid(mesh: &Mesh, spacing_mm: Option<f64>) -> Result<Grid, VoxelizeError> {
    let Some((low, high)) = mesh.bounds().filter(|_| !mesh.faces.is_empty()) else {
        return Err(VoxelizeError::Empty);
    };
    let (low, extent) = (low.as_dvec3(), (high - low).as_dvec3());
    // A voxel of room on each side.
    let dims = |spacing: f64| (extent / spacing).ceil() + 3.0;
    let spacing_mm = spacing_mm.unwrap_or_else(|| {
        // Of a box whose sides are alike the cube root; the room about a flat one takes more.
        let mut spacing = (extent.element_product() / USUAL_VOXELS).cbrt().max(1e-6);
        let is_large = |dims: DVec3| {
            dims.element_product() > 1.25 * USUAL_VOXELS
                || dims.max_element() > Grid::MAX_SIDE as f64
        };
        while is_large(dims(spacing)) {
            spacing *= 1.05;
        }
        spacing
    });
    let voxels = dims(spacing_mm).element_product();
    let is_side = spacing_mm.is_finite() && spacing_mm > 0.0;
    if !is_side || voxels > MAX_VOXELS {
        return Err(VoxelizeError::Spacing { spacing_mm, voxels });
    }
    let dims = dims(spacing_mm).to_array().map(|n| n as u64);
    let side = DVec3::splat(spacing_mm);
    Ok(Grid::new(dims, side, low - spacing_mm, glam::DMat3::IDENTITY)?)
}

/// Voxels of `grid` inside a closed surface.
///
/// A voxel is inside where the surface winds about its centre, in whichever direction, so that
/// closed parts may overlap. Rows of voxels are filled a layer at a time: memory follows the faces
/// and the voxels, not how often the surface covers itself.
///
/// # Errors
/// [`VoxelizeError`].
pub fn voxelized(mesh: &Mesh, grid: &Grid) -> Result<BitVolume, VoxelizeError> {
    let open = open_edges(mesh);
    if open > 0 {
        return Err(VoxelizeError::Open(open));
    }
    let origin = grid.origin_mm;
    let places: Vec<DVec3> =
        mesh.positions.iter().map(|p| (p.as_dvec3() - origin) / grid.spacing_mm).collect();

    let mut mask = BitVolume::new(grid.dims);
    let mut broken: Option<BrokenRows> = None;
    for offset in OFFSETS {
        let left = fill(&mut mask, mesh, &places, DVec2::from(offset), broken.as_ref());
        if left.first.is_none() {
            return Ok(mask);
        }
        broken = Some(left);
    }
    let [y, z] = broken.and_then(|rows| rows.first).unwrap_or([0; 2]);
    let at = origin + grid.spacing_mm * DVec3::new(0.0, f64::from(y), f64::from(z));
    Err(VoxelizeError::Crossing { x: at.x, y: at.y, z: at.z })
}

/// Rows whose rays did not end outside the surface.
struct BrokenRows {
    /// One bit a row, y fastest.
    bits: Vec<u64>,
    rows_y: usize,
    /// y and z of the first of them.
    first: Option<[u32; 2]>,
}

impl BrokenRows {
    fn new(dims: UVec3) -> Self {
        let rows = dims.y as usize * dims.z as usize;
        Self { bits: vec![0; rows.div_ceil(64)], rows_y: dims.y as usize, first: None }
    }

    fn insert(&mut self, y: u32, z: u32) {
        let row = z as usize * self.rows_y + y as usize;
        self.bits[row / 64] |= 1 << (row % 64);
        self.first.get_or_insert([y, z]);
    }

    fn contains(&self, y: u32, z: u32) -> bool {
        let row = z as usize * self.rows_y + y as usize;
        self.bits[row / 64] >> (row % 64) & 1 == 1
    }
}

/// Counts the uses of edges by faces that no use in the opposite direction balances.
fn open_edges(mesh: &Mesh) -> usize {
    let mut edges: Vec<([u32; 2], bool)> = mesh
        .faces
        .iter()
        .flat_map(|f| [[f[0], f[1]], [f[1], f[2]], [f[2], f[0]]])
        .map(|[a, b]| ([a.min(b), a.max(b)], a < b))
        .collect();
    edges.sort_unstable();
    let balance = |same: &[([u32; 2], bool)]| {
        let forward = same.iter().filter(|e| e.1).count();
        forward.abs_diff(same.len() - forward)
    };
    edges.chunk_by(|a, b| a.0 == b.0).map(balance).sum()
}

/// A face in voxels, and the rows of its layers that its box covers.
struct FlatFace {
    face: usize,
    /// First and last layer.
    layers: [i64; 2],
}

/// Fills rows along x, all or the given ones. Returns those whose rays did not end outside the
/// surface.
fn fill(
    mask: &mut BitVolume,
    mesh: &Mesh,
    places: &[DVec3],
    offset: DVec2,
    only: Option<&BrokenRows>,
) -> BrokenRows {
    let UVec3 { x: nx, z: nz, .. } = mask.dims();
    let mut broken = BrokenRows::new(mask.dims());
    let flat = |v: u32| {
        let p = places[v as usize];
        DVec2::new(p.y, p.z) - offset
    };
    let mut faces: Vec<FlatFace> = Vec::with_capacity(mesh.faces.len());
    for (face, corners) in mesh.faces.iter().enumerate() {
        let z = corners.map(|v| flat(v).y);
        let low = z[0].min(z[1]).min(z[2]).ceil().max(0.0) as i64;
        let high = z[0].max(z[1]).max(z[2]).floor() as i64;
        if low <= high {
            faces.push(FlatFace { face, layers: [low, high] });
        }
    }
    faces.sort_unstable_by_key(|f| (f.layers[0], f.face));
    let mut waiting = faces.into_iter().peekable();
    let mut active: Vec<FlatFace> = Vec::new();
    let mut crossings: Vec<(u32, f64, i32)> = Vec::new();
    for z in 0..nz {
        checkpoint();
        active.retain(|f| f.layers[1] >= i64::from(z));
        while let Some(f) = waiting.next_if(|f| f.layers[0] <= i64::from(z)) {
            active.push(f);
        }
        crossings.clear();
        for FlatFace { face, .. } in &active {
            let face = mesh.faces[*face];
            let cross = |y: u32, x: f64, sign: i32| crossings.push((y, x, sign));
            cross_rows(face, face.map(|v| places[v as usize].x), face.map(flat), z, only, cross);
        }
        crossings
            .sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        for row in crossings.chunk_by(|a, b| a.0 == b.0) {
            let y = row[0].0;
            // A ray that hits an edge crosses neither of its faces, so its winding sum is not 0.
            if row.iter().map(|c| c.2).sum::<i32>() != 0 {
                broken.insert(y, z);
                continue;
            }
            let mut winding = 0;
            for pair in row.windows(2) {
                winding += pair[0].2;
                let (first, last) = (pair[0].1.ceil().max(0.0), pair[1].1.floor());
                if winding != 0 && first <= last {
                    mask.set_run((first as u32, (last as u32).min(nx - 1)), y, z);
                }
            }
        }
    }
    broken
}

/// Finds where the rays along x of one layer cross a face; `cross` takes the row's y, x and the
/// sign of the crossing.
fn cross_rows(
    face: [u32; 3],
    x: [f64; 3],
    flat: [DVec2; 3],
    z: u32,
    only: Option<&BrokenRows>,
    mut cross: impl FnMut(u32, f64, i32),
) {
    let area = (flat[1] - flat[0]).perp_dot(flat[2] - flat[0]);
    if area == 0.0 {
        return;
    }
    let low = flat[0].x.min(flat[1].x).min(flat[2].x).ceil().max(0.0) as i64;
    let high = flat[0].x.max(flat[1].x).max(flat[2].x).floor() as i64;
    for y in low..=high {
        if only.is_some_and(|rows| !rows.contains(y as u32, z)) {
            continue;
        }
        let at = DVec2::new(y as f64, f64::from(z));
        // Signed areas opposite to each corner: an edge's is the same, but for its sign, from both
        // of its faces, as it is taken from its lower corner.
        let part = |i: usize, j: usize| {
            let turned = face[i] > face[j];
            let (p, q) = if turned { (flat[j], flat[i]) } else { (flat[i], flat[j]) };
            let area = (q - p).perp_dot(at - p);
            if turned { -area } else { area }
        };
        let w = [part(1, 2), part(2, 0), part(0, 1)];
        let is_inside =
            if area > 0.0 { w.iter().all(|w| *w > 0.0) } else { w.iter().all(|w| *w < 0.0) };
        if is_inside {
            let sum: f64 = w.iter().sum();
            let x = (w[0] * x[0] + w[1] * x[1] + w[2] * x[2]) / sum;
            cross(y as u32, x, if area > 0.0 { 1 } else { -1 });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::shapes;

    fn inside(mesh: &Mesh, spacing_mm: f64, truth: impl Fn(DVec3) -> f64) {
        let grid = enclosing_grid(mesh, Some(spacing_mm)).unwrap();
        let mask = voxelized(mesh, &grid).unwrap();
        let to_world = grid.world_from_voxel();
        let mut count = 0;
        for v in BitVolume::new(grid.dims).inverted().voxels() {
            let distance = truth(to_world.transform_point3(v.as_dvec3()));
            // Facets lie a little inside the shape they stand for.
            if distance.abs() > 0.03 {
                assert_eq!(mask.get(v.as_ivec3()), distance < 0.0, "{v}: {distance}");
                count += 1;
            }
        }
        assert!(count > 1000);
    }

    #[test]
    fn voxels_inside_a_sphere_a_torus_and_both_at_once_are_found() {
        let sphere = shapes::sphere(5.0, 128);
        let ball = |p: DVec3| p.length() - 5.0;
        inside(&sphere, 0.37, ball);
        // Corners of the box lie on rays of whole voxels.
        inside(&shapes::boxed(8), 0.125, |p| {
            let (low, high) = shapes::boxed(8).bounds().unwrap();
            let (a, b) = (low.as_dvec3() - p, p - high.as_dvec3());
            a.max(b).max_element()
        });
        // Closed parts that overlap, one of them inside out.
        let mut both = sphere.clone();
        let first = both.positions.len() as u32;
        both.positions.extend(sphere.positions.iter().map(|p| *p + glam::Vec3::X * 4.0));
        both.faces.extend(sphere.faces.iter().map(|f| f.map(|v| v + first)));
        inside(&both, 0.5, |p| ball(p).min(ball(p - 4.0 * DVec3::X)));
    }

    #[test]
    fn a_surface_with_a_hole_or_without_faces_is_refused() {
        let mut sphere = shapes::sphere(5.0, 32);
        sphere.faces.pop();
        let grid = enclosing_grid(&sphere, None).unwrap();
        assert_eq!(voxelized(&sphere, &grid).unwrap_err(), VoxelizeError::Open(3));
        assert_eq!(enclosing_grid(&Mesh::default(), None).unwrap_err(), VoxelizeError::Empty);
        let whole = shapes::sphere(5.0, 32);
        for bad in [0.0, -1.0, f64::NAN, 1e-6] {
            let error = enclosing_grid(&whole, Some(bad)).unwrap_err();
            assert!(matches!(error, VoxelizeError::Spacing { .. }), "{error}");
        }
    }

    /// A box of 0.001 x 700 x 700 mm once got 2·10⁹ voxels, and its rays 4 GB of crossings.
    #[test]
    fn a_sheet_gets_no_more_voxels_than_a_cube() {
        let unit = shapes::boxed(1);
        let (low, high) = unit.bounds().unwrap();
        for side in [[1e-3, 700.0, 700.0], [700.0, 1e-3, 700.0], [1e-3, 1e-3, 700.0], [1e-9; 3]] {
            let mut flat = unit.clone();
            for p in &mut flat.positions {
                *p = (*p - low) / (high - low) * glam::Vec3::from(side);
            }
            let grid = enclosing_grid(&flat, None).unwrap();
            assert!(grid.len() as f64 <= 1.25 * USUAL_VOXELS, "{side:?}: {}", grid.dims);
            voxelized(&flat, &grid).unwrap();
        }
    }
}
