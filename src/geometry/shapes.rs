//! Meshes for the tests of several rooms.

use glam::Vec3;

use super::Mesh;

/// Builds a mesh of m × n vertices that closes in both directions; `at` gives position and normal
/// of a vertex by its two angles.
pub fn closed_lattice(m: u32, n: u32, at: impl Fn(f32, f32) -> (Vec3, Vec3)) -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..m {
        for j in 0..n {
            let turn = |k: u32, of: u32| std::f32::consts::TAU * k as f32 / of as f32;
            let (p, normal) = at(turn(i, m), turn(j, n));
            mesh.positions.push(p);
            mesh.normals.push(normal);
            let id = |i: u32, j: u32| (i % m) * n + j % n;
            let [a, b, c, d] = [id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1)];
            mesh.faces.extend([[a, c, b], [a, d, c]]);
        }
    }
    mesh
}

/// Builds a torus of radii 10 and 3 mm, 2 m n faces; normals point inwards.
pub fn torus(m: u32, n: u32) -> Mesh {
    closed_lattice(m, n, |a, b| {
        let out = Vec3::new(a.cos() * b.cos(), a.sin() * b.cos(), b.sin());
        (10.0 * Vec3::new(a.cos(), a.sin(), 0.0) + 3.0 * out, -out)
    })
}

/// Builds a sphere from a cube whose faces are cut into n² squares; normals point inwards.
pub fn sphere(radius: f32, n: u32) -> Mesh {
    let mut mesh = boxed(n);
    mesh.normals = mesh.positions.iter().map(|p| -p.normalize()).collect();
    mesh.positions = mesh.normals.iter().map(|p| -radius * p).collect();
    mesh
}

/// Builds the cube from −1 to 1, each face cut into n² squares; normals by face point inwards.
pub fn boxed(n: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let mut ids = std::collections::BTreeMap::new();
    for axis in 0..3 {
        for side in [0, n] {
            let mut id = |i: u32, j: u32| {
                let mut c = [0; 3];
                (c[axis], c[(axis + 1) % 3], c[(axis + 2) % 3]) = (side, i, j);
                *ids.entry(c).or_insert_with(|| {
                    mesh.positions.push(Vec3::from(c.map(|c| 2.0 * c as f32 / n as f32 - 1.0)));
                    mesh.positions.len() as u32 - 1
                })
            };
            let mut faces = Vec::new();
            for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
                let [a, b, c, d] = [id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1)];
                let pair = if side == 0 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] };
                faces.extend(pair);
            }
            mesh.faces.extend(faces);
        }
    }
    mesh
}
