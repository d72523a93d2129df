//! Uniform cut: a mesh with the same error bound everywhere, independent of any camera.

use super::{Cluster, Clusters, NO_GROUP};
use crate::geometry::Mesh;

impl Clusters {
    /// The uniform cut: the coarsest surface of at least `faces` faces (all, if there are fewer),
    /// by closing groups in order of error; and its two-sided distance bound to the original, mm.
    /// As watertight as the original; vertices as drawn, no caps.
    pub fn uniform_cut(&self, faces: u64) -> (Mesh, f32) {
        let size = |c: &Cluster| u64::from(c.triangles);
        let mut groups: Vec<u32> = (0..self.groups.len() as u32).collect();
        let error = |g: u32| self.groups[g as usize].error_mm;
        groups.sort_by(|a, b| error(*a).total_cmp(&error(*b)));
        let (mut left, mut error_mm) = (self.finest_faces(), 0.0);
        // Groups of equal error close together: one may be made of another.
        for alike in groups.chunk_by(|a, b| error(*a) == error(*b)) {
            let of = |g: &u32| {
                let fine = self.inputs(*g).iter().map(|c| size(&self.clusters[*c as usize]));
                let coarse = self.outputs(*g).map(|c| size(&self.clusters[c as usize]));
                fine.sum::<u64>() - coarse.sum::<u64>()
            };
            let gone: u64 = alike.iter().map(of).sum();
            if left - gone < faces {
                break;
            }
            left -= gone;
            error_mm = error(alike[0]);
        }
        // Errors are monotonic along the hierarchy, so this is a valid cut.
        let closed = |g: u32| g != NO_GROUP && error(g) <= error_mm;
        let own = self.clusters.iter().zip(0..);
        let cut = own.filter(|(c, _)| {
            (c.output_of == NO_GROUP || closed(c.output_of)) && !closed(c.input_of)
        });
        let mut mesh = Mesh::default();
        let mut place = vec![NO_GROUP; self.vertices.len()];
        for (_, id) in cut {
            for v in self.vertex_ids(id) {
                let at = &mut place[*v as usize];
                if *at == NO_GROUP {
                    *at = mesh.positions.len() as u32;
                    let vertex = &self.vertices[*v as usize];
                    mesh.positions.push(vertex.position());
                    mesh.normals.push(vertex.normal());
                }
            }
            mesh.faces.extend(self.faces(id).map(|f| f.map(|v| place[v as usize])));
        }
        (mesh, error_mm)
    }
}
