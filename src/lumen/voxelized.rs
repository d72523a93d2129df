//! Voxelization of a closed surface: every voxel whose centre lies inside.

use std::collections::BTreeSet;

use glam::{DVec2, DVec3, UVec3};

use super::BitVolume;
use crate::geometry::Mesh;
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

/// Voxels inside a closed surface, on a grid along the patient's axes.
///
/// * `spacing_mm`: side of a voxel; without one the surface's box gets about 2²⁴ voxels.
///
/// A voxel is inside where the surface winds about its centre, in whichever direction, so that
/// closed parts may overlap.
///
/// # Errors
/// [`VoxelizeError`].
pub fn voxelized(mesh: &Mesh, spacing_mm: Option<f64>) -> Result<(Grid, BitVolume), VoxelizeError> {
    let Some((low, high)) = mesh.bounds().filter(|_| !mesh.faces.is_empty()) else {
        return Err(VoxelizeError::Empty);
    };
    let open = open_edges(mesh);
    if open > 0 {
        return Err(VoxelizeError::Open(open));
    }
    let (low, extent) = (low.as_dvec3(), (high - low).as_dvec3().max(DVec3::splat(1e-3)));
    let usual = (extent.element_product() / USUAL_VOXELS).cbrt();
    let spacing_mm = spacing_mm.unwrap_or(usual);
    // A voxel of room on each side.
    let dims = (extent / spacing_mm).ceil() + 3.0;
    let voxels = dims.element_product();
    let is_side = spacing_mm.is_finite() && spacing_mm > 0.0;
    if !is_side || voxels > MAX_VOXELS {
        return Err(VoxelizeError::Spacing { spacing_mm, voxels });
    }
    let origin = low - spacing_mm;
    let side = DVec3::splat(spacing_mm);
    let dims = dims.to_array().map(|n| n as u64);
    let grid = Grid::new(dims, side, origin, glam::DMat3::IDENTITY)?;
    let places: Vec<DVec3> =
        mesh.positions.iter().map(|p| (p.as_dvec3() - origin) / spacing_mm).collect();

    let mut mask = BitVolume::new(grid.dims);
    let mut broken = None;
    for offset in OFFSETS {
        broken = fill(&mut mask, mesh, &places, DVec2::from(offset), broken.as_ref());
        let Some(_) = &broken else { return Ok((grid, mask)) };
    }
    let row = broken.and_then(|rows| rows.first().copied()).unwrap_or([0; 2]);
    let at = origin + spacing_mm * DVec3::new(0.0, f64::from(row[1]), f64::from(row[0]));
    Err(VoxelizeError::Crossing { x: at.x, y: at.y, z: at.z })
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

/// Fills rows along x, all or the given ones (z, y). Returns the rows whose rays did not end
/// outside the surface.
fn fill(
    mask: &mut BitVolume,
    mesh: &Mesh,
    places: &[DVec3],
    offset: DVec2,
    rows: Option<&BTreeSet<[u32; 2]>>,
) -> Option<BTreeSet<[u32; 2]>> {
    let UVec3 { x: nx, .. } = mask.dims();
    let mut crossings: Vec<([u32; 2], f64, i32)> = Vec::new();
    for face in &mesh.faces {
        let [a, b, c] = face.map(|v| places[v as usize]);
        let flat = [a, b, c].map(|p| DVec2::new(p.y, p.z) - offset);
        let low = flat[0].min(flat[1]).min(flat[2]).ceil().max(DVec2::ZERO);
        let high = flat[0].max(flat[1]).max(flat[2]).floor();
        let area = (flat[1] - flat[0]).perp_dot(flat[2] - flat[0]);
        if area == 0.0 {
            continue;
        }
        for z in low.y as i64..=high.y as i64 {
            for y in low.x as i64..=high.x as i64 {
                let row = [z as u32, y as u32];
                if rows.is_some_and(|r| !r.contains(&row)) {
                    continue;
                }
                let at = DVec2::new(y as f64, z as f64);
                // Signed areas opposite to each corner: an edge's is the same, but for its sign,
                // from both of its faces, as it is taken from its lower corner.
                let part = |i: usize, j: usize| {
                    let turned = face[i] > face[j];
                    let (p, q) = if turned { (flat[j], flat[i]) } else { (flat[i], flat[j]) };
                    let area = (q - p).perp_dot(at - p);
                    if turned { -area } else { area }
                };
                let w = [part(1, 2), part(2, 0), part(0, 1)];
                let inside = if area > 0.0 {
                    w.iter().all(|w| *w > 0.0)
                } else {
                    w.iter().all(|w| *w < 0.0)
                };
                if inside {
                    let sum: f64 = w.iter().sum();
                    let x = (w[0] * a.x + w[1] * b.x + w[2] * c.x) / sum;
                    crossings.push((row, x, if area > 0.0 { 1 } else { -1 }));
                }
            }
        }
    }
    crossings.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
    let mut broken = BTreeSet::new();
    for row in crossings.chunk_by(|a, b| a.0 == b.0) {
        let [z, y] = row[0].0;
        if row.iter().map(|c| c.2).sum::<i32>() != 0 {
            broken.insert(row[0].0);
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
    // A ray that hits an edge crosses neither of its faces, so its winding sum is not 0.
    (!broken.is_empty()).then_some(broken)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::shapes;

    fn inside(mesh: &Mesh, spacing_mm: f64, truth: impl Fn(DVec3) -> f64) {
        let (grid, mask) = voxelized(mesh, Some(spacing_mm)).unwrap();
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
        assert_eq!(voxelized(&sphere, None).unwrap_err(), VoxelizeError::Open(3));
        assert_eq!(voxelized(&Mesh::default(), None).unwrap_err(), VoxelizeError::Empty);
        let whole = shapes::sphere(5.0, 32);
        for bad in [0.0, -1.0, f64::NAN, 1e-6] {
            let error = voxelized(&whole, Some(bad)).unwrap_err();
            assert!(matches!(error, VoxelizeError::Spacing { .. }), "{error}");
        }
    }
}
