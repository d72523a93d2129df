//! Flat walls, where rounding is the only deviation.

use std::time::Instant;

use glam::Vec3;

use super::super::Clusters;
use crate::geometry::{Mesh, TriangleBvh};
use crate::surface::shading;

/// A closed box of unit squares, `n` to a side, its corner at `low`.
fn cube(n: u32, low: f32) -> Mesh {
    let mut mesh = Mesh::default();
    let mut ids = std::collections::HashMap::new();
    let mut vertex = |p: [u32; 3], mesh: &mut Mesh| {
        *ids.entry(p).or_insert_with(|| {
            let q = Vec3::from_array(p.map(|c| c as f32));
            mesh.positions.push(q + Vec3::splat(low));
            mesh.positions.len() as u32 - 1
        })
    };
    for axis in 0..3 {
        for side in [0, n] {
            for i in 0..n * n {
                let at = |di: u32, dj: u32| {
                    let mut p = [0; 3];
                    p[axis] = side;
                    p[(axis + 1) % 3] = i % n + di;
                    p[(axis + 2) % 3] = i / n + dj;
                    p
                };
                let [a, b, c, d] =
                    [at(0, 0), at(1, 0), at(1, 1), at(0, 1)].map(|p| vertex(p, &mut mesh));
                // Faces are counter-clockwise from inside.
                let faces = if side == 0 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] };
                mesh.faces.extend(faces);
            }
        }
    }
    mesh
}

/// Measuring rounding errors took a hundred times as long as an organ of as many faces; the limit
/// is a multiple of the time of shading, which is linear.
#[test]
fn flat_walls_are_clustered_in_time_proportional_to_shading() {
    let mesh = cube(32, 60.3);
    let times = [(); 5].map(|()| {
        let start = Instant::now();
        (shading(&mesh).vertices, start.elapsed().as_secs_f64())
    });
    let unit = times.iter().map(|t| t.1).fold(0.0, f64::max);
    let start = Instant::now();
    // Down to the last level: rounding adds up on the way.
    let built = Clusters::build_with(&mesh, &times[0].0, &TriangleBvh::new(&mesh), 1, true)
        .expect("a sound mesh");
    let took = start.elapsed().as_secs_f64();
    assert!(built.groups().len() > 20);
    assert!(took < 1200.0 * unit, "{took:.3} s, shading {unit:.5} s");
}
