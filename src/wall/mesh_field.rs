//! Offsets from a mesh at the voxel centres about it, where no grey values say them.
//!
//! The wall of a label map is a mesh of relaxed positions and smoothed normals. Its offsets are a
//! moving average of the planes through nearby vertices (implicit moving least squares: Kolluri 2008,
//! doi:10.1145/1361192.1361195). Departure: each plane is turned halfway to the mean normal, which is
//! exact on spheres; with the planes themselves a tube of three voxels is 0.05 voxel too wide.

use glam::{DVec3, IVec3, Vec3, Vec4};
use rayon::prelude::*;

use super::spline::MIN_OFFSET;
use crate::geometry::Mesh;
use crate::lumen::Lumen;
use crate::lumen::bricks::{BRICK, NONE, SIDE};

/// Standard deviation of the weights of vertices by their distance, mean spacings.
const SIGMA: f32 = 0.8;
/// Voxels along each axis within which vertices count.
const REACH: i32 = 2;
/// Weight of a row of voxels beside a vertex below which the row does not count.
const MIN_WEIGHT: f32 = 5e-3;
/// Largest distance from a vertex at which an offset is averaged, mean spacings. Farther voxels are
/// as far as the spline looks.
const NEAR: f32 = 1.9;
/// Offset of the voxels farther away, mean spacings.
const AWAY: f32 = 2.0;
/// Least cosine between a vertex's normal and the mean: others are of another sheet.
const MIN_COSINE: f32 = 0.2;
/// Largest distance of a voxel on the wrong side of a vertex's plane, mean spacings: a vertex of
/// another sheet has it farther on that side.
const SLACK: f32 = 0.35;

/// Voxels along each axis about that of a vertex.
const ABOUT: usize = 2 * REACH as usize + 1;
/// Groups of four voxels of a brick: four voxels of a row are computed at once.
const FOURS: usize = BRICK / 4;

/// A vertex in the frame of a brick: index axes, mm from the brick's first voxel.
struct Neighbour {
    at: Vec3,
    normal: Vec3,
    voxel: IVec3,
    /// Share of the weight of the voxels about it, by axis.
    weights: [[f32; ABOUT]; 3],
}

/// Four voxels of a row, from a vertex.
struct Four {
    /// Ways from the vertex, mm: along x one a voxel.
    x: Vec4,
    y: f32,
    z: f32,
    /// Weights of the vertex; 0 out of its reach.
    weight: Vec4,
}

/// Returns the offset of each voxel of a lumen's bricks from a mesh of its wall, mm, negative
/// inside; no voxel centre changes sides.
pub fn mesh_offsets(lumen: &Lumen, mesh: &Mesh) -> Vec<f32> {
    let grid = &lumen.grid;
    let to_voxel = grid.voxel_from_world();
    let voxels: Vec<DVec3> = mesh
        .positions
        .par_iter()
        .with_min_len(4096)
        .map(|p| to_voxel.transform_point3(p.as_dvec3()))
        .collect();

    // 1. Vertices by the brick they lie in.
    let slot = |v: &DVec3| lumen.bricks.slot_of(v.round().as_ivec3());
    let mut by_brick: Vec<(usize, u32)> =
        (0u32..).zip(&voxels).filter_map(|(i, v)| Some((slot(v)?, i))).collect();
    by_brick.par_sort_unstable();
    let count = lumen.bricks.len();
    let mut first = vec![0u32; count + 1];
    by_brick.iter().for_each(|(slot, _)| first[slot + 1] += 1);
    (0..count).for_each(|s| first[s + 1] += first[s]);

    // 2. Offsets, brick by brick.
    let spacing = grid.spacing_mm.as_vec3();
    let direction = grid.direction.transpose();
    let steps = spacing / (SIGMA * spacing.element_product().cbrt());
    let falls = steps.to_array().map(fall_of_steps);
    let mut offsets = vec![0.0; count * BRICK];
    offsets.par_chunks_exact_mut(BRICK).enumerate().with_min_len(4).for_each(|(slot, out)| {
        crate::task::checkpoint();
        let corner = IVec3::from(lumen.bricks.corners()[slot]);
        let mut near = Vec::new();
        for brick in lumen.bricks.near()[slot].into_iter().filter(|s| *s != NONE) {
            for (_, v) in
                &by_brick[first[brick as usize] as usize..first[brick as usize + 1] as usize]
            {
                let at = voxels[*v as usize] - corner.as_dvec3();
                let voxel = at.round().as_ivec3();
                let reaches = voxel.cmpge(IVec3::splat(-REACH)).all()
                    && voxel.cmplt(IVec3::splat(SIDE + REACH)).all();
                if reaches {
                    let normal = direction * mesh.normals[*v as usize].as_dvec3();
                    near.push(Neighbour::new(at.as_vec3(), normal.as_vec3(), spacing, &falls));
                }
            }
        }
        let sides = &lumen.inside[slot * 8..][..8];
        of_brick(&near, spacing, sides, out);
    });
    offsets
}

/// Offsets of the voxels of a brick.
///
/// * `sides`: a bit for each voxel inside, a word for each layer.
fn of_brick(near: &[Neighbour], spacing: Vec3, sides: &[u64], out: &mut [f32]) {
    let mean = spacing.element_product().cbrt();
    let is_inside = |i: usize| sides[i / 64] >> (i % 64) & 1 != 0;
    let side_of = |four: usize| {
        Vec4::from([0, 1, 2, 3].map(|k| if is_inside(4 * four + k) { 1.0 } else { -1.0 }))
    };
    let side: [Vec4; FOURS] = std::array::from_fn(side_of);
    let slack = Vec4::splat(-SLACK * mean);

    // 1. Mean normal of the vertices that have the voxel on its side of their plane.
    let mut mean_normal = [[Vec4::ZERO; 3]; FOURS];
    for n in near {
        n.about(spacing, |i, four| {
            let is_beside = (side[i] * four.along(n.normal)).cmpgt(slack);
            let weight = Vec4::select(is_beside, four.weight, Vec4::ZERO);
            for (sum, along) in mean_normal[i].iter_mut().zip(n.normal.to_array()) {
                *sum += weight * along;
            }
        });
    }
    for normal in &mut mean_normal {
        let [x, y, z] = *normal;
        let square = x * x + y * y + z * z;
        let scale = square.to_array().map(|s| if s > 0.0 { s.sqrt().recip() } else { 0.0 });
        *normal = normal.map(|along| along * Vec4::from(scale));
    }

    // 2. Mean of the planes, each turned halfway to the mean normal and so shortened.
    let mut sums = [[Vec4::ZERO; 2]; FOURS];
    for n in near {
        n.about(spacing, |i, four| {
            let [x, y, z] = mean_normal[i];
            let cosine = x * n.normal.x + y * n.normal.y + z * n.normal.z;
            let off = four.along(n.normal);
            let counts = cosine.cmpge(Vec4::splat(MIN_COSINE)) & (side[i] * off).cmpgt(slack);
            let weight = Vec4::select(counts, cosine * cosine * four.weight, Vec4::ZERO);
            let by_mean = x * four.x + y * four.y + z * four.z;
            // Vertices that do not count may have a cosine of -1.
            let turned = (off + by_mean) / (1.0 + cosine).max(Vec4::ONE);
            sums[i][0] += weight * turned;
            sums[i][1] += weight;
        });
    }
    // Weight of one vertex at the largest distance.
    let least = (-0.5 * (NEAR / SIGMA) * (NEAR / SIGMA)).exp();
    for (i, out) in out.iter_mut().enumerate() {
        let [sum, weights] = sums[i / 4].map(|four| four[i % 4]);
        let side = side[i / 4][i % 4];
        let size = if weights > least { side * sum / weights } else { AWAY * mean };
        *out = -side * size.clamp(MIN_OFFSET * mean, AWAY * mean);
    }
}

/// Shares exp(-(k d)² / 2) for the voxels k about a vertex.
///
/// * `step`: spacing along the axis, standard deviations.
fn fall_of_steps(step: f32) -> [f32; ABOUT] {
    std::array::from_fn(|k| (-0.5 * ((k as i32 - REACH) as f32 * step).powi(2)).exp())
}

impl Neighbour {
    /// * `at`: voxels from the first of the brick.
    /// * `falls`: [`fall_of_steps`], by axis.
    fn new(at: Vec3, normal: Vec3, spacing: Vec3, falls: &[[f32; ABOUT]; 3]) -> Self {
        let voxel = at.round().as_ivec3();
        let deviation = SIGMA * spacing.element_product().cbrt();
        // exp(-(a + k d)² / 2) for the voxels k of an axis: two exponentials of the vertex, and the
        // share that is the same of all vertices.
        let along = |axis: usize| {
            let step = spacing[axis] / deviation;
            let first = (voxel[axis] as f32 - at[axis]) * step;
            let (middle, ratio) = ((-0.5 * first * first).exp(), (-first * step).exp());
            std::array::from_fn(|k| middle * ratio.powi(k as i32 - REACH) * falls[axis][k])
        };
        Self { at: at * spacing, normal, voxel, weights: [0, 1, 2].map(along) }
    }

    /// Calls `each` with the voxels of a brick about the vertex, by the number of their four.
    fn about(&self, spacing: Vec3, mut each: impl FnMut(usize, Four)) {
        let in_reach = |axis: usize| {
            let first = (self.voxel[axis] - REACH).max(0);
            (first..(self.voxel[axis] + REACH + 1).min(SIDE)).map(move |v| {
                let weight = self.weights[axis][(v - self.voxel[axis] + REACH) as usize];
                (v as usize, v as f32 * spacing[axis] - self.at[axis], weight)
            })
        };
        let mut row = [Vec4::ZERO; 2];
        in_reach(0).for_each(|(x, _, weight)| row[x / 4][x % 4] = weight);
        for (z, z_mm, z_weight) in in_reach(2) {
            for (y, y_mm, y_weight) in in_reach(1) {
                let weight = y_weight * z_weight;
                if weight < MIN_WEIGHT {
                    continue;
                }
                for (half, along) in row.into_iter().enumerate() {
                    if along == Vec4::ZERO {
                        continue;
                    }
                    let first = 4.0 * half as f32;
                    let x = Vec4::new(first, first + 1.0, first + 2.0, first + 3.0) * spacing.x
                        - self.at.x;
                    let four = Four { x, y: y_mm, z: z_mm, weight: along * weight };
                    each(half + 2 * y + 16 * z, four);
                }
            }
        }
    }
}

impl Four {
    /// Ways from the vertex along a direction, mm.
    fn along(&self, way: Vec3) -> Vec4 {
        self.x * way.x + (self.y * way.y + self.z * way.z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::{Midpoint, extract};
    use crate::volume::Grid;
    use crate::wall::WallSpline;

    /// A tube of this radius about a slanted axis, with vertices and normals as they should be.
    fn tube(radius: f64) -> (Lumen, Mesh, impl Fn(DVec3) -> f64) {
        let grid = Grid::axis_aligned([40; 3], [0.8; 3]);
        let (on, along) = (DVec3::new(16.1, 15.7, 15.9), DVec3::new(1.0, 0.4, 0.2).normalize());
        let offset = move |p: DVec3| {
            let d = p - on;
            (d - d.dot(along) * along).length() - radius
        };
        let mut mask = crate::lumen::BitVolume::new(grid.dims);
        for i in 0..grid.len() {
            let v = grid.voxel(i);
            if offset(v.as_dvec3() * 0.8) < 0.0 && v.x > 1 && v.x < 38 {
                mask.set(v.x, v.y, v.z);
            }
        }
        let lumen = Lumen::of_volume(grid, &mask);
        let mut mesh = extract(&lumen, &Midpoint);
        let inwards = |p: DVec3| {
            let d = p - on;
            -(d - d.dot(along) * along).normalize()
        };
        mesh.normals = mesh.positions.iter().map(|p| inwards(p.as_dvec3()).as_vec3()).collect();
        for p in &mut mesh.positions {
            let at = p.as_dvec3();
            *p = (at + offset(at) * inwards(at)).as_vec3();
        }
        (lumen, mesh, offset)
    }

    #[test]
    fn the_spline_of_a_mesh_of_a_tube_has_its_radius() {
        for radius in [2.4, 6.4] {
            let (lumen, mesh, offset) = tube(radius);
            let spline = WallSpline::of_mesh(&lumen, &mesh);
            let vertices = mesh.positions.iter().zip(&mesh.normals);
            let middle = vertices.filter(|(p, _)| (8.0..24.0).contains(&p.x));
            let (mut sum, mut square, mut count) = (0.0, 0.0, 0);
            for (p, way) in middle {
                let way = *way;
                let Some(t) = spline.root(*p, way, 0.6) else { continue };
                let off = offset((*p + t * way).as_dvec3());
                (sum, square, count) = (sum + off, square + off * off, count + 1);
            }
            let (mean, rms) = (sum / f64::from(count), (square / f64::from(count)).sqrt());
            assert!(count > 300, "{count}");
            // A twentieth of a voxel.
            assert!(mean.abs() < 0.02 && rms < 0.04, "{radius}: {mean} {rms}");
        }
    }

    #[test]
    fn no_voxel_centre_changes_sides() {
        let (lumen, mesh, _) = tube(1.3);
        let offsets = mesh_offsets(&lumen, &mesh);
        assert!((0..offsets.len()).all(|i| lumen.is_inside(i) == (offsets[i] < 0.0)));
    }
}
