//! Multiscale normals: a scale space of area vectors whose bands are shrunk to the noise of the
//! voxel grid, so that every vertex is smoothed as far as its surroundings allow.
//!
//! Li et al. 2004 smooth every vertex by the same number of steps, with graph weights that diffuse
//! faster along the diagonals of faces, and unit normals, which count small faces like large ones.
//! Here area vectors diffuse by the cotangent Laplacian, which is isotropic on the surface, to five
//! scales; the mean of area vectors is the normal of the plane that a voxel staircase approximates.
//! Then the band between two scales is restored as far as it exceeds the noise that voxel steps of
//! this slope make (`shaders/scale_restore.wgsl`).

use glam::{DMat3, DVec3, Vec3, Vec4};
use rayon::prelude::*;

use super::{Adjacency, heat};
use crate::compute::{Buf, Plan};
use crate::geometry::Mesh;
use crate::kernels::{scale_bands, scale_pool, scale_restore, scale_step};

/// Standard deviations of the five smoothed scales over the largest voxel spacing. Each takes twice
/// the diffusion time of the one before.
const SCALES: [f64; 5] = [1.0, std::f64::consts::SQRT_2, 2.0, 2.0 * std::f64::consts::SQRT_2, 4.0];

/// Largest error of the truncated series in any mode. A smaller one changes no measured error by
/// more than 0.1 degree and needs a third more steps.
const CUT: f64 = 1.0 / 15.0;

/// Largest diffusion rate of a vertex, times the voxel's area. On the surface of a mask it limits
/// a quarter of the vertices, those with the smallest faces; at 6 the error on thick slices
/// doubles, above 8 nothing is gained.
const RATE: f64 = 8.0;

/// Number of averaging steps of the bands' energies: a standard deviation of 1.1 voxels.
const POOL_STEPS: u32 = 5;

/// Median angle between a normal and the mean around it at which a surface has the full noise of a
/// mask, rad. Masks of balls, tori, tubes and folds have 8.8 to 9.9 degrees, isotropic or not.
/// Surfaces from grey values have 1 to 2 degrees, and by that measure 1.3 to 1.7 times as much noise
/// in the coarser bands as masks, hence the divisor.
const MASK_ROUGHNESS: f32 = 0.152 / 1.4;

/// Noise of the finest band on an isotropic mask, rad: two standard deviations. The finest band is
/// mostly noise, on grey surfaces too: only creases exceed it.
const RAW: f64 = 0.6;

/// Number of vertex ranges for each thread.
const RANGES_PER_THREAD: usize = 2;

/// Axes and spacing of the voxel grid that a surface was extracted from: the steps to smooth away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VoxelFrame {
    /// Unit axes in patient space, in columns.
    pub direction: DMat3,
    /// Voxel spacing, mm.
    pub spacing_mm: DVec3,
}

impl VoxelFrame {
    /// Estimates the frame of a mesh that comes without a grid: axes of patient space, and along
    /// each the 99.5th percentile of the edges' extents, as marching cubes makes edges up to one
    /// voxel long. A mesh without extent gets 1 mm.
    pub fn of(mesh: &Mesh) -> Self {
        let span = |f: &[u32; 3], k: usize, axis: usize| {
            let p = |v: u32| mesh.positions[v as usize][axis];
            (p(f[k]) - p(f[(k + 1) % 3])).abs()
        };
        let spacing = [0, 1, 2].map(|axis| {
            let mut all: Vec<f32> =
                mesh.faces.iter().flat_map(|f| (0..3).map(move |k| span(f, k, axis))).collect();
            let at = all.len() * 199 / 200;
            let longest =
                (at < all.len()).then(|| *all.select_nth_unstable_by(at, f32::total_cmp).1);
            f64::from(longest.unwrap_or(0.0))
        });
        let spacing = DVec3::from(spacing);
        let most = spacing.max_element();
        let spacing_mm = if most > 0.0 && most.is_finite() {
            spacing.max(DVec3::splat(0.1 * most))
        } else {
            DVec3::ONE
        };
        Self { direction: DMat3::IDENTITY, spacing_mm }
    }
}

/// Initial values and weights of the diffusion.
pub struct MultiscaleNormals {
    /// Unit normals of the faces around each vertex, three floats a vertex.
    normals: Vec<f32>,
    /// Area vector over area of each vertex, and 0.
    density: Vec<Vec4>,
    /// Diffusion weight of every adjacency entry, as a share of `rate`.
    weight: Vec<f32>,
    /// Noise of this surface relative to a mask's, at most 1.
    pub noise: f32,
    /// Largest diffusion rate, 1/mm².
    rate: f64,
    frame: VoxelFrame,
}

impl MultiscaleNormals {
    /// Computes weights and area vectors of a mesh; `adjacency` is the mesh's own.
    pub fn new(mesh: &Mesh, adjacency: &Adjacency, frame: VoxelFrame) -> Self {
        let h = frame.spacing_mm;
        let (most, least) = (h.max_element(), h.min_element());
        // Bounded, or slices ten times as thick would need ten times the steps.
        let rate = RATE / (most * least.max(0.25 * most));
        let vertices = mesh.positions.len();
        let mut weight = vec![0.0f32; adjacency.near.len()];
        let mut density = vec![Vec4::ZERO; vertices];
        let mut normals = vec![0.0f32; 3 * vertices];
        let mut rest = (weight.as_mut_slice(), density.as_mut_slice(), normals.as_mut_slice());
        let count = RANGES_PER_THREAD * rayon::current_num_threads();
        let ranges: Vec<VertexRange<'_>> = (1..=count)
            .map(|i| {
                // About as many adjacency entries in each.
                let end = adjacency.near.len() * i / count;
                let end = adjacency.start.partition_point(|s| (*s as usize) < end);
                let end = if i == count { vertices } else { end };
                VertexRange::split(&mut rest, adjacency, end)
            })
            .collect();
        ranges.into_par_iter().for_each(|mut range| {
            range.sum(mesh, adjacency);
            range.scale(adjacency, rate as f32);
        });
        let noise = (roughness(&normals, adjacency) / MASK_ROUGHNESS).min(1.0);
        Self { normals, density, weight, noise, rate, frame }
    }
}

/// A range of vertices with their initial values. Each range is summed in a pass over all faces, so
/// that every sum is in the order of the faces whatever the number of ranges is.
struct VertexRange<'a> {
    /// Index of the range's first vertex.
    first: usize,
    /// Adjacency index of the first entry of that vertex.
    entry: usize,
    weight: &'a mut [f32],
    density: &'a mut [Vec4],
    normals: &'a mut [f32],
}

/// Remaining slices of weights, densities and normals, from which ranges are cut.
type Rest<'a> = (&'a mut [f32], &'a mut [Vec4], &'a mut [f32]);

impl<'a> VertexRange<'a> {
    /// Cuts the vertices before `end` off the remaining slices.
    fn split(rest: &mut Rest<'a>, adjacency: &Adjacency, end: usize) -> Self {
        let (weight, density, normals) = std::mem::take(rest);
        let first = adjacency.start.len() - 1 - density.len();
        let entry = adjacency.start[first] as usize;
        let (weight, later_weight) = weight.split_at_mut(adjacency.start[end] as usize - entry);
        let (density, later_density) = density.split_at_mut(end - first);
        let (normals, later_normals) = normals.split_at_mut(3 * (end - first));
        *rest = (later_weight, later_density, later_normals);
        Self { first, entry, weight, density, normals }
    }

    /// Sums area vectors and areas in `density`, and in `weight` half the two cotangents across
    /// each edge.
    fn sum(&mut self, mesh: &Mesh, adjacency: &Adjacency) {
        // Written before they are read: see `compute::array::Storage::touch`.
        self.weight.fill(0.0);
        self.density.fill(Vec4::ZERO);
        let own = self.first as u32..(self.first + self.density.len()) as u32;
        for f in &mesh.faces {
            if !f.iter().any(|v| own.contains(v)) {
                continue;
            }
            let p = f.map(|v| mesh.positions[v as usize]);
            let cross = (p[1] - p[0]).cross(p[2] - p[0]);
            let double_area = cross.length();
            let vector = cross / 6.0;
            let gain = vector.extend(vector.length());
            let cot = [0, 1, 2].map(|k| {
                let (a, b) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
                // A needle counts like an angle of a thousandth.
                let least = 1e-3 * a.length() * b.length();
                let c = 0.5 * a.dot(b) / double_area.max(least);
                if c.is_finite() { c } else { 0.0 }
            });
            for k in 0..3 {
                if !own.contains(&f[k]) {
                    continue;
                }
                let v = f[k] as usize;
                self.density[v - self.first] += gain;
                let row = adjacency.row(v);
                let at = adjacency.start[v] as usize - self.entry;
                // The edge to the next corner lies across from the one after it.
                for (w, cot) in
                    [(f[(k + 1) % 3], cot[(k + 2) % 3]), (f[(k + 2) % 3], cot[(k + 1) % 3])]
                {
                    if let Ok(i) = row.binary_search(&w) {
                        self.weight[at + i] += cot;
                    }
                }
            }
        }
    }

    /// Computes normals from the area vectors, and weights over area, or over an area enlarged such
    /// that they sum to `rate`.
    fn scale(&mut self, adjacency: &Adjacency, rate: f32) {
        let normals = self.normals.as_chunks_mut::<3>().0;
        let mut rest = &mut *self.weight;
        for (i, (d, normal)) in self.density.iter_mut().zip(normals).enumerate() {
            let (row, later) = rest.split_at_mut(adjacency.row(self.first + i).len());
            rest = later;
            *normal = d.truncate().try_normalize().unwrap_or(Vec3::Z).to_array();
            // Negative cotangents, of obtuse faces, count as 0.
            row.iter_mut().for_each(|w| *w = w.max(0.0));
            let exchange: f32 = row.iter().sum();
            let per = 1.0 / d.w.max(exchange / rate);
            // A vertex without area, or whose area overflows, does not diffuse.
            let sound = per.is_finite() && d.is_finite();
            row.iter_mut().for_each(|w| *w = if sound { *w * per / rate } else { 0.0 });
            *d = if sound { (d.truncate() * per).extend(0.0) } else { Vec4::ZERO };
        }
    }
}

/// Returns the median angle (as a chord) between normals and the mean of those adjacent to them,
/// over some thirty thousand vertices spread over the mesh.
fn roughness(normals: &[f32], adjacency: &Adjacency) -> f32 {
    let at = |v: usize| Vec3::from_slice(&normals[3 * v..]);
    let vertices = normals.len() / 3;
    let stride = vertices.div_ceil(1 << 15).max(1);
    let mut all: Vec<f32> = (0..vertices.div_ceil(stride))
        .into_par_iter()
        .with_min_len(4096)
        .map(|i| {
            let v = i * stride;
            let mean: Vec3 = adjacency.row(v).iter().map(|w| at(*w as usize)).sum();
            (at(v) - mean.normalize_or(at(v))).length()
        })
        .collect();
    let middle = all.len() / 2;
    if all.is_empty() { 0.0 } else { *all.select_nth_unstable_by(middle, f32::total_cmp).1 }
}

/// Appends the multiscale smoothing; returns unit normals, three floats a vertex.
pub fn multiscale_normals<'a>(
    plan: &mut Plan<'a>,
    adjacency: &'a Adjacency,
    initial: &'a MultiscaleNormals,
) -> Buf<f32> {
    let MultiscaleNormals { normals, density, weight, noise, rate, frame } = initial;
    let n = normals.len() / 3;
    let vertices = n as u32;
    let h = frame.spacing_mm;
    let (start, near) = adjacency.upload(plan);
    let weight = plan.upload("exchange", weight);
    let normal = plan.upload("face normals", normals);

    let level = plan.zeroed::<[f32; 4]>("smoothed normals", 5 * n);
    let mut now = plan.zeroed::<[f32; 4]>("series", n);
    let mut next = plan.upload("area vectors", bytemuck::cast_slice(density));
    let times = SCALES.map(|s| rate * 0.5 * (s * h.max_element()).powi(2));
    let series = times.map(|a| heat::series(a, heat::terms(a, CUT)));
    for k in 0..series[4].len() {
        let part = series.each_ref().map(|s| s.get(k).map_or(0.0, |c| *c as f32));
        let (turn, keep) = [(0.0, -1.0), (1.0, 0.0), (2.0, 1.0)][k.min(2)];
        let params = scale_step::Params {
            part: [part[0], part[1], part[2], part[3]],
            last_part: part[4],
            turn,
            keep,
            vertices,
        };
        let bindings = scale_step::Bindings { start, near, weight, now, next, level };
        plan.launch(&scale_step::KERNEL, bindings, params, n, n);
        std::mem::swap(&mut now, &mut next);
    }

    let mut energy = plan.undefined::<f32>("energy of bands", 5 * n);
    let mut pooled = plan.undefined::<f32>("pooled energy", 5 * n);
    let params = scale_bands::Params { vertices };
    let bindings = scale_bands::Bindings { normal, level, energy };
    plan.launch(&scale_bands::KERNEL, bindings, params, n, n);
    for _ in 0..POOL_STEPS {
        let bindings = scale_pool::Bindings { start, near, weight, energy, pooled };
        plan.launch(&scale_pool::KERNEL, bindings, scale_pool::Params { vertices }, n, n);
        std::mem::swap(&mut energy, &mut pooled);
    }

    let (most, least) = (h.max_element(), h.min_element());
    let axis = |k: usize| frame.direction.col(k).as_vec3().extend((h[k] / most) as f32).to_array();
    // Thick slices make sharper steps the finer the grid is within a slice.
    let terrace = |k: usize| (h[k] / most * (h[k] / least).powf(0.4)) as f32;
    let faired = plan.undefined::<f32>("faired normals", normals.len());
    let params = scale_restore::Params {
        axis_x: axis(0),
        axis_y: axis(1),
        axis_z: axis(2),
        terrace: [terrace(0), terrace(1), terrace(2), *noise],
        raw: noise * (RAW * most / least) as f32,
        vertices,
        ..Default::default()
    };
    let bindings = scale_restore::Bindings { normal, level, pooled: energy, faired };
    plan.launch(&scale_restore::KERNEL, bindings, params, n, n);
    faired
}
