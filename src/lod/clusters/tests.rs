use super::*;
use crate::geometry::Mesh;
use crate::surface::shading;
use std::time::Instant;

#[test]
#[ignore = "needs INTIMA_MESHES"]
fn measure_build() {
    let dir = std::env::var("INTIMA_MESHES").unwrap();
    let name = std::env::var("MESH").unwrap_or("vessel_143k".into());
    let path = std::path::Path::new(&dir).join(format!("{name}.ply"));
    let mesh: Mesh = crate::formats::read_mesh(&path, None).unwrap().0;
    let s = shading(&mesh);
    let t = Instant::now();
    let c = Clusters::build(&mesh, &s.vertices).unwrap();
    println!(
        "{name}: {:.2} s, {} clusters, {} groups",
        t.elapsed().as_secs_f64(),
        c.clusters.len(),
        c.groups.len()
    );
    println!(
        "{} roots, {:.1} MB, {:.1} triangles a cluster",
        c.roots().count(),
        c.bytes() as f64 / 1e6,
        c.triangles.len() as f64 / c.clusters.len() as f64
    );
    let mut level = vec![0usize; c.groups.len()];
    let mut rows: Vec<(usize, usize, usize, f32, f32, f32)> = Vec::new();
    for g in 0..c.groups.len() {
        let up = c
            .inputs(g as u32)
            .iter()
            .map(|i| c.clusters[*i as usize].made_by)
            .filter(|m| *m != NONE)
            .map(|m| level[m as usize] + 1)
            .max()
            .unwrap_or(0);
        level[g] = up;
        if rows.len() <= up {
            rows.push((0, 0, 0, 0.0, 0.0, 0.0));
        }
        let r = &mut rows[up];
        r.0 += 1;
        r.1 += c
            .inputs(g as u32)
            .iter()
            .map(|i| c.clusters[*i as usize].triangles as usize)
            .sum::<usize>();
        r.2 +=
            c.outputs(g as u32).map(|i| c.clusters[i as usize].triangles as usize).sum::<usize>();
        r.3 += c.groups[g].error_mm;
        r.4 += c.groups[g].angle_rad;
        r.5 += c.groups[g].reach.radius / c.groups[g].sphere.radius;
    }
    for r in rows {
        let n = r.0 as f32;
        println!(
            "{:5} groups {:8} -> {:8} faces, mean error {:.4} mm, angle {:.3}, reach/own {:.2}",
            r.0,
            r.1,
            r.2,
            r.3 / n,
            r.4 / n,
            r.5 / n
        );
    }
}
