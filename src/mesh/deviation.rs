//! Distance and normal deviation between two meshes, from samples of both.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::geometry::{ClosestPoint, Mesh, TriangleBvh};

/// Samples of each mesh by area, in addition to its vertices.
const SAMPLES: usize = 100_000;

/// Distances between two meshes, from samples of both.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Deviation {
    /// Largest distance of a sample of either mesh to the other, mm.
    pub hausdorff_mm: f64,
    /// Mean distance of the samples of one to the other, mean of both ways, mm.
    pub mean_mm: f64,
    /// Root mean square distance, likewise, mm.
    pub rms_mm: f64,
    /// Mean angle between the reference's normals and those at the nearest points, degrees.
    pub normal_mean_deg: f64,
    /// Largest such angle, degrees.
    pub normal_max_deg: f64,
}

/// A point to measure from.
struct SurfaceSample {
    at: DVec3,
    normal: DVec3,
}

/// Sums and maxima over the samples of one mesh.
#[derive(Clone, Copy, Default)]
struct OneWay {
    most: f64,
    sum: f64,
    squares: f64,
    angles: f64,
    most_angle: f64,
}

/// Compares a mesh with a reference, both ways, from the vertices and 100,000 samples of each,
/// distributed by area. Normals are the meshes' own, or area-weighted means of faces. The same at
/// any number of threads. `None` if either mesh has no area.
pub fn deviation(mesh: &Mesh, reference: &Mesh) -> Option<Deviation> {
    let (normals, wanted) = (normals(mesh), normals(reference));
    let from_reference = one_way(&samples(reference, &wanted)?, mesh, &normals)?;
    let from_mesh = one_way(&samples(mesh, &normals)?, reference, &wanted)?;
    let [r, m] = [from_reference, from_mesh];
    Some(Deviation {
        hausdorff_mm: r.most.max(m.most),
        mean_mm: 0.5 * (r.sum + m.sum),
        rms_mm: (0.5 * (r.squares + m.squares)).sqrt(),
        normal_mean_deg: r.angles.to_degrees(),
        normal_max_deg: r.most_angle.to_degrees(),
    })
}

/// Normals at vertices: the mesh's, or from its faces by area.
fn normals(mesh: &Mesh) -> Vec<Vec3> {
    if !mesh.normals.is_empty() {
        return mesh.normals.clone();
    }
    let mut sum = vec![Vec3::ZERO; mesh.positions.len()];
    for &f in &mesh.faces {
        let cross = mesh.face_cross(f);
        f.iter().for_each(|v| sum[*v as usize] += cross);
    }
    sum
}

fn mix<T: std::ops::Add<Output = T>>(
    list: [Vec3; 3],
    weights: [f64; 3],
    of: impl Fn(DVec3, f64) -> T,
) -> T {
    let [a, b, c] = [0, 1, 2].map(|i| of(list[i].as_dvec3(), weights[i]));
    a + b + c
}

/// The vertices that faces use, and samples at equal steps of area, placed within a face by the R2
/// low-discrepancy sequence (Roberts 2018, based on the plastic number).
fn samples(mesh: &Mesh, normals: &[Vec3]) -> Option<Vec<SurfaceSample>> {
    let area = mesh.area_mm2();
    if !(area > 0.0 && area.is_finite()) {
        return None;
    }
    let mut used = vec![false; mesh.positions.len()];
    mesh.faces.iter().flatten().for_each(|v| used[*v as usize] = true);
    let vertices = (0..mesh.positions.len()).filter(|v| used[*v]);
    let mut out: Vec<SurfaceSample> = vertices
        .map(|v| SurfaceSample { at: mesh.positions[v].as_dvec3(), normal: normals[v].as_dvec3() })
        .collect();
    let (mut before, mut next) = (0.0, 0usize);
    for f in &mesh.faces {
        before += 0.5 * f64::from(mesh.face_cross(*f).length());
        while next < SAMPLES && (next as f64 + 0.5) * area <= before * SAMPLES as f64 {
            let [mut u, mut v] = [0.754_877_666_246_693, 0.569_840_290_998_053]
                .map(|step| (0.5 + step * next as f64).fract());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let weights = [1.0 - u - v, u, v];
            let at = mix(f.map(|v| mesh.positions[v as usize]), weights, |p, w| p * w);
            let normal =
                mix(f.map(|v| normals[v as usize]), weights, |n, w| n.normalize_or_zero() * w);
            out.push(SurfaceSample { at, normal });
            next += 1;
        }
    }
    Some(out)
}

/// Means and largest values over all samples.
fn one_way(samples: &[SurfaceSample], mesh: &Mesh, normals: &[Vec3]) -> Option<OneWay> {
    let tree = TriangleBvh::new(mesh);
    let one = |s: &SurfaceSample| -> Option<(f64, f64)> {
        let ClosestPoint { at, distance_mm, .. } = tree.closest(s.at)?;
        let corners = mesh.faces[at.face as usize].map(|v| normals[v as usize]);
        let there = mix(corners, at.weights, |n, w| n.normalize_or_zero() * w);
        Some((distance_mm, s.normal.angle_between(there)))
    };
    let found: Vec<(f64, f64)> =
        samples.par_iter().with_min_len(1024).map(one).collect::<Option<_>>()?;
    // Summed in one order: the same at any number of threads.
    let mut all = OneWay::default();
    for (d, angle) in &found {
        let angle = if angle.is_nan() { 0.0 } else { *angle };
        all.most = all.most.max(*d);
        all.sum += d;
        all.squares += d * d;
        all.angles += angle;
        all.most_angle = all.most_angle.max(angle);
    }
    let n = found.len() as f64;
    all.sum /= n;
    all.squares /= n;
    all.angles /= n;
    Some(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::shapes::sphere;

    #[test]
    fn concentric_spheres_are_as_far_apart_as_their_radii() {
        let (a, b) = (sphere(5.0, 40), sphere(5.2, 40));
        let d = deviation(&a, &b).unwrap();
        assert!((d.mean_mm - 0.2).abs() < 0.005, "{d:?}");
        assert!(d.hausdorff_mm < 0.215 && d.rms_mm >= d.mean_mm, "{d:?}");
        assert!(d.normal_mean_deg < 0.5, "{d:?}");
        assert!(deviation(&a, &a).unwrap().hausdorff_mm < 1e-12);
    }

    #[test]
    fn a_single_dent_counts_whichever_mesh_is_the_reference() {
        let a = sphere(5.0, 40);
        let mut b = a.clone();
        b.positions[100] *= 0.9;
        for d in [deviation(&a, &b), deviation(&b, &a)] {
            let d = d.unwrap();
            assert!(d.hausdorff_mm > 0.3 && d.hausdorff_mm <= 0.5 && d.mean_mm < 0.01, "{d:?}");
        }
    }

    #[test]
    fn a_mesh_without_area_has_no_deviation() {
        let none =
            Mesh { positions: vec![Vec3::ZERO; 3], faces: vec![[0, 1, 2]], ..Mesh::default() };
        assert_eq!(deviation(&none, &sphere(1.0, 8)), None);
        assert_eq!(deviation(&sphere(1.0, 8), &Mesh::default()), None);
    }
}
