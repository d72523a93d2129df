//! Meshes of `INTIMA_MESHES` with a flight along their axis, for what is measured by hand.

use glam::{DVec3, Vec3};
use intima::formats::read_mesh;
use intima::geometry::{Lens, Mesh, Pose};
use serde_json::Value;

/// Mesh and axis by name, or `None` where the folder is not given or does not hold it. The axis lies beside the mesh
/// as `{"branches": [{"points": [[x, y, z, …], …]}]}`, LPS mm.
pub fn named(name: &str) -> Option<(Mesh, Vec<DVec3>)> {
    let folder = std::path::PathBuf::from(std::env::var_os("INTIMA_MESHES")?);
    let file = folder.join(format!("{name}.ply"));
    if !file.exists() {
        return None;
    }
    let mut mesh = read_mesh(&file, None).unwrap().0;
    // Others let faces look outwards.
    if mesh.volume_mm3() < 0.0 {
        mesh.faces.iter_mut().for_each(|f| f.swap(1, 2));
        mesh.normals.iter_mut().for_each(|n| *n = -*n);
    }
    let json = std::fs::read(folder.join(format!("{name}.json"))).unwrap();
    let json: Value = serde_json::from_slice(&json).unwrap();
    let points = json["branches"][0]["points"].as_array().unwrap();
    let number = |p: &Value, k: usize| p[k].as_f64().unwrap();
    let axis = points.iter().map(|p| DVec3::new(number(p, 0), number(p, 1), number(p, 2)));
    Some((mesh, axis.collect()))
}

/// Points every quarter of a millimetre.
fn even(axis: &[DVec3]) -> Vec<DVec3> {
    let mut out = vec![axis[0]];
    let mut left = 0.25;
    for w in axis.windows(2) {
        let (mut at, step) = (w[0], w[1] - w[0]);
        let mut length = step.length();
        while length >= left {
            at += step.normalize() * left;
            length -= left;
            out.push(at);
            left = 0.25;
        }
        left -= length;
    }
    out
}

/// Poses from 3 to 90 per cent of the axis, each looking 4 mm ahead.
pub fn poses(axis: &[DVec3], frames: usize) -> Vec<Pose> {
    let p = even(axis);
    let (low, high) = (0.03 * p.len() as f64, 0.9 * p.len() as f64);
    let mut up = Vec3::Y;
    (0..frames)
        .map(|i| {
            let t = i as f64 / (frames.max(2) - 1) as f64;
            let k = (low + t * (high - low)) as usize;
            let ahead = p[(k + 16).min(p.len() - 1)];
            let pose = Pose::looking(p[k].as_vec3(), (ahead - p[k]).as_vec3(), up);
            up = pose.up();
            pose
        })
        .collect()
}

/// A lens of `fov_deg`, 16 to 9.
pub fn lens(fov_deg: f32) -> Lens {
    Lens { fov_y_rad: fov_deg.to_radians(), aspect: 16.0 / 9.0, near_mm: 0.2 }
}
