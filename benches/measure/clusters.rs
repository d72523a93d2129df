//! Statistics of the cluster hierarchy of a large mesh, and of a flight through it.

use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;
use intima::geometry::{Camera, Lens, Pose, TriangleBvh, ViewFrustum};
use intima::lod::clusters::{ClusterLod, Clusters, NO_GROUP};
use intima::lod::{LodHierarchy, PageCache, Tolerance};
use intima::surface::shading;

/// `MESH=colon_1m` for another than the vessel.
pub fn statistics_of_a_large_mesh() {
    let dir = std::env::var("INTIMA_MESHES").unwrap();
    let name = std::env::var("MESH").unwrap_or("vessel_143k".into());
    let path = std::path::Path::new(&dir).join(format!("{name}.ply"));
    let mesh = intima::formats::read_mesh(&path, None).unwrap().0;
    let vertices = shading(&mesh).vertices;
    let clock = Instant::now();
    let c = Clusters::build(&mesh, &vertices, &TriangleBvh::new(&mesh)).unwrap();
    let seconds = clock.elapsed().as_secs_f64();
    let all = c.clusters().len();
    let stuck = c.roots().filter(|r| c.clusters()[*r as usize].output_of == NO_GROUP).count();
    let triangles: f64 = c.clusters().iter().map(|k| f64::from(k.triangles)).sum();
    let mean = triangles / all as f64;
    println!(
        "{name}: {seconds:.2} s, {all} clusters of {mean:.1} triangles, {} groups, {} roots, {stuck} of them finest, {:.1} MB",
        c.groups().len(),
        c.roots().count(),
        c.bytes() as f64 / 1e6
    );
    let mut level = vec![0usize; c.groups().len()];
    let mut rows: Vec<[f64; 6]> = Vec::new();
    for (id, g) in c.groups().iter().enumerate() {
        let below = c.inputs(id as u32).iter().map(|i| c.clusters()[*i as usize].output_of);
        level[id] =
            below.filter(|m| *m != NO_GROUP).map(|m| level[m as usize] + 1).max().unwrap_or(0);
        if rows.len() <= level[id] {
            rows.push([0.0; 6]);
        }
        let faces = |of: &mut dyn Iterator<Item = u32>| {
            of.map(|i| f64::from(c.clusters()[i as usize].triangles)).sum::<f64>()
        };
        let r = &mut rows[level[id]];
        r[0] += 1.0;
        r[1] += faces(&mut c.inputs(id as u32).iter().copied());
        r[2] += faces(&mut c.outputs(id as u32));
        r[3] += f64::from(g.error_mm);
        r[4] += f64::from(g.angle_rad);
        r[5] += f64::from(g.subtree_sphere.radius / g.sphere.radius);
    }
    for [n, before, after, error, angle, reach] in rows {
        println!(
            "{n:5} groups, {before:8} -> {after:8} faces, mean error {:.4} mm, angle {:.4}, reach {:.2}",
            error / n,
            angle / n,
            reach / n
        );
    }
    let clock = Instant::now();
    let bytes = c.to_bytes();
    let wrote = clock.elapsed();
    Clusters::from_bytes(&bytes, &mesh, &vertices).unwrap();
    println!("{} bytes in {wrote:?}, out of them in {:?}", bytes.len(), clock.elapsed() - wrote);
    let text = std::fs::read_to_string(path.with_extension("json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let points: Vec<Vec3> = json["branches"][0]["points"]
        .as_array()
        .unwrap()
        .iter()
        .map(|p| Vec3::from_array([0, 1, 2].map(|k| p[k].as_f64().unwrap() as f32)))
        .collect();
    let c = Arc::new(c);
    for (px, angle) in [
        (1.0, f32::INFINITY),
        (1.0, 0.3),
        (1.0, 0.1),
        (1.0, 0.05),
        (0.5, f32::INFINITY),
        (2.0, f32::INFINITY),
    ] {
        let mut lod = ClusterLod::new(Arc::clone(&c), angle);
        let mut cache = PageCache::new(20_000, 20_000, 2);
        let (mut shown, mut drawn, mut seen, mut took) = (vec![], vec![], vec![], vec![]);
        let ahead = |i: usize| {
            let far = |p: &Vec3| p.distance(points[i]) >= 4.0;
            points[i..].iter().copied().find(far)
        };
        let steps = (points.len() / 400).max(1);
        for i in (0..points.len()).step_by(steps) {
            let Some(to) = ahead(i) else { break };
            let lens = Lens { fov_y_rad: 90f32.to_radians(), aspect: 16.0 / 9.0, near_mm: 0.2 };
            let up = Vec3::new(0.1, 0.2, 1.0);
            let cam =
                Camera { pose: Pose::looking(points[i], to - points[i], up), lens, height_px: 720 };
            let frustum = ViewFrustum::new(&cam);
            cache.begin_step();
            let clock = Instant::now();
            let step = lod.step(&cam, &Tolerance { pixels: px }, &mut cache);
            took.push(clock.elapsed().as_secs_f64() * 1e3);
            shown.push(step.drawn.len() as f64);
            drawn.push(step.drawn.iter().map(|d| f64::from(d.triangles)).sum::<f64>());
            let in_view = step.drawn.iter().filter(|d| frustum.intersects(&d.sphere));
            seen.push(in_view.map(|d| f64::from(d.triangles)).sum::<f64>());
        }
        let stat = |v: &mut Vec<f64>| {
            v.sort_by(f64::total_cmp);
            format!("{:.2}/{:.2}/{:.2}", v[v.len() / 2], v[v.len() * 99 / 100], v[v.len() - 1])
        };
        println!(
            "{px} px, {angle} rad: clusters {}, triangles {}, in view {}, step {} ms (median/p99/max)",
            stat(&mut shown),
            stat(&mut drawn),
            stat(&mut seen),
            stat(&mut took)
        );
    }
}
