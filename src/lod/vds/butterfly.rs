//! Modified butterfly subdivision: where a smooth interpolating surface through the base has its new
//! vertices.
//!
//! After Zorin, Schröder & Sweldens 1996 (doi:10.1145/237170.237254): eight points around an edge
//! between two regular vertices, the one-ring of the extraordinary vertex otherwise, the mean of
//! both one-rings between two of them, four points along a boundary. Departure: points that an edge
//! near a boundary lacks are reflected, and a boundary vertex counts as regular, instead of the
//! five special rules of the paper's table.
//!
//! The paper names the butterfly as its scheme. Samples of the original are nearer to it: details
//! that the simplification removed are not in the base.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};

use super::base_mesh::BaseMesh;
use super::measure::in_child;
use super::original::Original;
use crate::geometry::{Mesh, Vertex};

/// Splits of the base at which the surface is evaluated: those of a patch and one more at its sides.
const SPLITS: u32 = 4;

/// The surface that the butterfly predicts from a base mesh, instead of samples of the original.
/// Errors are measured to the original all the same.
pub struct Predicted<'a> {
    original: &'a dyn Original,
    /// The base, split four times.
    fine: Mesh,
}

impl<'a> Predicted<'a> {
    pub fn new(base: &Mesh, original: &'a dyn Original) -> Self {
        let (positions, faces) = (base.positions.clone(), base.faces.clone());
        let mut fine = Mesh { positions, faces, ..Mesh::default() };
        for _ in 0..SPLITS {
            fine = subdivide(&fine);
        }
        fine.normals = vec![Vec3::ZERO; fine.positions.len()];
        for f in &fine.faces {
            let [a, b, c] = f.map(|v| fine.positions[v as usize]);
            let normal = (b - a).cross(c - a);
            f.iter().for_each(|v| fine.normals[*v as usize] += normal);
        }
        Self { original, fine }
    }
}

impl Original for Predicted<'_> {
    /// The vertex at the point, or the nearest one, as weights go.
    fn at(&self, face: u32, weights: [f64; 3]) -> Vertex {
        let (mut f, mut w) = (face as usize, weights);
        for _ in 0..SPLITS {
            let (child, inner) = in_child(w);
            (f, w) = (4 * f + child as usize, inner);
        }
        let corner = (0..3).max_by(|a, b| w[*a].total_cmp(&w[*b])).unwrap_or(0);
        let v = self.fine.faces[f][corner] as usize;
        let tint = self.original.at(face, weights).w();
        Vertex::new(self.fine.positions[v], self.fine.normals[v].normalize_or_zero(), tint)
    }

    fn is_sampled(&self) -> bool {
        false
    }

    fn vertices(&self) -> u32 {
        self.original.vertices()
    }

    fn vertex(&self, vertex: u32) -> Option<(u32, [f64; 3], Vertex)> {
        self.original.vertex(vertex)
    }

    fn faces(&self) -> u64 {
        self.original.faces()
    }

    fn distance_mm(&self, p: DVec3) -> f64 {
        self.original.distance_mm(p)
    }
}

/// Splits every face 1-to-4: old vertices keep their ids and positions, then one vertex for each
/// edge, where the modified butterfly puts it. Normals and caps are left out.
///
/// # Panics
/// If a face has a vertex index out of range.
fn subdivide(mesh: &Mesh) -> Mesh {
    let base = BaseMesh::new(mesh.faces.clone(), mesh.positions.len());
    let rings = VertexHalfEdges::new(&base);
    let at = |v: u32| mesh.positions[v as usize].as_dvec3();
    let mut positions = mesh.positions.clone();
    positions.extend((0..base.edges.len()).map(|e| predict(&base, &rings, e, &at).as_vec3()));
    let first = mesh.positions.len() as u32;
    let mut faces = Vec::with_capacity(4 * mesh.faces.len());
    for (&[a, b, c], edges) in mesh.faces.iter().zip(&base.face_edges) {
        let [ab, bc, ca] = edges.map(|e| first + (e >> 1));
        faces.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]]);
    }
    Mesh { positions, normals: Vec::new(), faces, caps: Vec::new() }
}

/// One outgoing half-edge (face, corner) of each vertex; on a boundary the first one.
struct VertexHalfEdges(Vec<Option<(u32, usize)>>);

impl VertexHalfEdges {
    fn new(base: &BaseMesh) -> Self {
        let mut first = vec![None; base.vertices];
        for (f, face) in base.faces.iter().enumerate() {
            for (c, v) in face.iter().enumerate() {
                let open = base.across(f as u32, c).is_none();
                let slot = &mut first[*v as usize];
                if slot.is_none() || open {
                    *slot = Some((f as u32, c));
                }
            }
        }
        Self(first)
    }

    /// One-ring in order, starting with `from`, for an inner vertex; `None` on a boundary or where
    /// the faces do not form a closed fan.
    fn closed(&self, base: &BaseMesh, v: u32, from: u32) -> Option<Vec<u32>> {
        let (first, corner) = self.0[v as usize]?;
        let (mut f, mut c) = (first, corner);
        let mut ring = Vec::new();
        loop {
            ring.push(base.faces[f as usize][(c + 1) % 3]);
            // Across the side that ends in v, to the next face.
            f = base.across(f, (c + 2) % 3)?;
            c = base.faces[f as usize].iter().position(|x| *x == v)?;
            if f == first || ring.len() > base.faces.len() {
                break;
            }
        }
        let start = ring.iter().position(|n| *n == from)?;
        ring.rotate_left(start);
        Some(ring)
    }

    /// The neighbour along the boundary that is not `from`.
    fn along(&self, base: &BaseMesh, v: u32, from: u32) -> Option<u32> {
        let (mut f, mut c) = self.0[v as usize]?;
        let right = base.faces[f as usize][(c + 1) % 3];
        if right != from {
            return Some(right);
        }
        for _ in 0..base.faces.len() {
            let Some(g) = base.across(f, (c + 2) % 3) else {
                return Some(base.faces[f as usize][(c + 2) % 3]);
            };
            f = g;
            c = base.faces[f as usize].iter().position(|x| *x == v)?;
        }
        None
    }
}

/// Predicted vertex of an edge.
fn predict(
    base: &BaseMesh,
    rings: &VertexHalfEdges,
    edge: usize,
    at: &dyn Fn(u32) -> DVec3,
) -> DVec3 {
    let e = base.edges[edge];
    let (f, c) = (e.faces[0], e.corner as usize);
    let [a, b] = [base.faces[f as usize][c], base.faces[f as usize][(c + 1) % 3]];
    let middle = 0.5 * (at(a) + at(b));
    if base.across(f, c).is_none() {
        let end = |v, from| rings.along(base, v, from).map(at);
        return match (end(a, b), end(b, a)) {
            (Some(p), Some(q)) => 1.125 * middle - 0.0625 * (p + q),
            _ => middle,
        };
    }
    let ring = |v: u32, from: u32| {
        let ring = rings.closed(base, v, from)?;
        (ring.len() != 6).then(|| extraordinary(at(v), &ring, at))
    };
    match (ring(a, b), ring(b, a)) {
        (Some(p), Some(q)) => 0.5 * (p + q),
        (Some(p), None) | (None, Some(p)) => p,
        (None, None) => regular(base, e.faces[0], c, at),
    }
}

/// Eight-point rule; missing points are reflected.
fn regular(base: &BaseMesh, f: u32, c: usize, at: &dyn Fn(u32) -> DVec3) -> DVec3 {
    let mut sum = DVec3::ZERO;
    let mut side = |f: u32, a: u32, b: u32| {
        let face = base.faces[f as usize];
        let Some(k) = (0..3).find(|k| face[*k] != a && face[*k] != b) else { return };
        let apex = face[k];
        sum += 0.5 * 0.5 * (at(a) + at(b)) + 0.125 * at(apex);
        for e in [k, (k + 2) % 3] {
            let (x, y, z) = (face[e], face[(e + 1) % 3], face[(e + 2) % 3]);
            let beyond = base
                .across(f, e)
                .and_then(|g| base.faces[g as usize].into_iter().find(|v| *v != x && *v != y));
            sum -= 0.0625 * beyond.map_or_else(|| at(x) + at(y) - at(z), at);
        }
    };
    let (a, b) = (base.faces[f as usize][c], base.faces[f as usize][(c + 1) % 3]);
    side(f, a, b);
    if let Some(g) = base.across(f, c) {
        side(g, a, b);
    }
    sum
}

/// Rule around an inner vertex of valence other than six; `ring` starts at the other end of the
/// edge.
fn extraordinary(v: DVec3, ring: &[u32], at: &dyn Fn(u32) -> DVec3) -> DVec3 {
    let k = ring.len();
    let weight = |j: usize| match (k, j) {
        (3, 0) => 5.0 / 12.0,
        (3, _) => -1.0 / 12.0,
        (4, 0) => 3.0 / 8.0,
        (4, 2) => -1.0 / 8.0,
        (4, _) => 0.0,
        _ => {
            let t = TAU * j as f64 / k as f64;
            (0.25 + t.cos() + 0.5 * (2.0 * t).cos()) / k as f64
        }
    };
    0.75 * v + ring.iter().enumerate().map(|(j, n)| weight(j) * at(*n)).sum::<DVec3>()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sheet of n × n quads, each halved, so that inner vertices have six neighbours.
    fn sheet(n: u32, height: impl Fn(f64, f64) -> f64) -> Mesh {
        let mut mesh = Mesh::default();
        for i in 0..=n {
            for j in 0..=n {
                let (x, y) = (f64::from(i) / 8.0, f64::from(j) / 8.0);
                mesh.positions.push(DVec3::new(x, y, height(x, y)).as_vec3());
                if i < n && j < n {
                    let id = |i, j| i * (n + 1) + j;
                    let [a, b, c, d] = [id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1)];
                    mesh.faces.extend([[a, b, c], [a, c, d]]);
                }
            }
        }
        mesh
    }

    /// Largest distance of new vertices from the function, `rim` quads away from the boundary.
    fn off(n: u32, rim: f32, height: impl Fn(f64, f64) -> f64) -> f64 {
        let fine = subdivide(&sheet(n, &height));
        let inner = |p: &&Vec3| {
            let far = n as f32 / 8.0 - rim / 8.0;
            (rim / 8.0..=far).contains(&p.x) && (rim / 8.0..=far).contains(&p.y)
        };
        let first = ((n + 1) * (n + 1)) as usize;
        let miss = |p: &Vec3| (f64::from(p.z) - height(f64::from(p.x), f64::from(p.y))).abs();
        fine.positions[first..].iter().filter(inner).map(miss).fold(0.0, f64::max)
    }

    #[test]
    fn planes_are_reproduced_up_to_the_boundary() {
        assert!(off(8, 0.0, |x, y| 2.0 * x - 3.0 * y + 1.0) < 1e-6);
    }

    #[test]
    fn regular_vertices_reproduce_cubics_but_not_quartics() {
        assert!(off(8, 2.0, |x, y| x * x - 2.0 * x * y + 3.0 * y * y) < 1e-6);
        assert!(off(8, 2.0, |x, y| x * x * x - 2.0 * x * x * y + x * y * y + y * y * y) < 1e-6);
        assert!(off(8, 2.0, |x, _| 8.0 * x.powi(4)) > 1e-4);
    }

    #[test]
    fn cubics_are_reproduced_along_a_boundary() {
        let height = |x: f64, _: f64| x * x * x - x;
        let fine = subdivide(&sheet(8, height));
        let on = |p: &&Vec3| p.y == 0.0 && p.x > 0.125 && p.x < 0.875;
        let miss = |p: &Vec3| (f64::from(p.z) - height(f64::from(p.x), 0.0)).abs();
        assert!(fine.positions.iter().filter(on).map(miss).fold(0.0, f64::max) < 1e-6);
    }

    #[test]
    fn extraordinary_rules_of_any_valence_reproduce_planes() {
        for k in 3..12u32 {
            // A flat ring: any weights that sum to one with the right first moments keep it flat,
            // and the new vertex of a straight spoke lies on that spoke.
            let at = |v: u32| {
                let t = TAU * f64::from(v) / f64::from(k);
                DVec3::new(t.cos(), t.sin(), 2.0)
            };
            let ring: Vec<u32> = (0..k).collect();
            let p = extraordinary(DVec3::new(0.0, 0.0, 2.0), &ring, &at);
            assert!((p - DVec3::new(0.5, 0.0, 2.0)).length() < 1e-12, "{k}: {p}");
        }
    }

    #[test]
    fn a_subdivided_octahedron_approaches_a_sphere() {
        let p = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
        let f = [
            [0, 2, 4],
            [2, 1, 4],
            [1, 3, 4],
            [3, 0, 4],
            [2, 0, 5],
            [1, 2, 5],
            [3, 1, 5],
            [0, 3, 5],
        ];
        let mut mesh = Mesh { positions: p.to_vec(), faces: f.to_vec(), ..Mesh::default() };
        mesh = subdivide(&mesh);
        assert_eq!((mesh.positions.len(), mesh.faces.len()), (18, 32));
        for p in &mesh.positions[6..] {
            assert!(p.length() > 0.75, "{p}");
        }
    }
}
