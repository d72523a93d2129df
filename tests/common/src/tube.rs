//! A closed tube with folds about a bent axis, built by formula: what the picture tests look at.

use glam::Vec3;
use intima::geometry::{Mesh, Pose};

/// Length of the straight part and radius of the bend, mm.
const STRAIGHT: f32 = 120.0;
const BEND: f32 = 60.0;
/// Radius of the tube, mm.
pub const RADIUS: f32 = 18.0;

/// Length of the axis, mm.
pub fn length() -> f32 {
    STRAIGHT + BEND * std::f32::consts::PI * 0.75
}

/// Axis point at arc length `s`, and the direction there. The tube rises along z, then bends to
/// the patient's left and down again.
pub fn axis(s: f32) -> (Vec3, Vec3) {
    if s < STRAIGHT {
        return (Vec3::new(0.0, 0.0, s), Vec3::Z);
    }
    let a = (s - STRAIGHT) / BEND;
    let at = Vec3::new(BEND * (1.0 - a.cos()), 0.0, STRAIGHT + BEND * a.sin());
    (at, Vec3::new(a.sin(), 0.0, a.cos()))
}

/// Points of the axis, every `step` mm.
pub fn path(from: f32, to: f32, step: f32) -> Vec<Vec3> {
    let n = ((to - from) / step).ceil() as usize;
    (0..=n).map(|i| axis(from + (to - from) * i as f32 / n as f32).0).collect()
}

/// An eye on the axis that looks along it.
pub fn pose(s: f32) -> Pose {
    let (at, forward) = axis(s);
    Pose::looking(at, forward, Vec3::Y)
}

/// Folds every 24 mm that stand a quarter of the radius into the lumen, three to a turn.
fn radius(s: f32, phi: f32) -> f32 {
    let wave = (0.5 + 0.5 * (std::f32::consts::TAU * s / 24.0).cos()).powi(6);
    let round = 0.75 + 0.25 * (3.0 * phi).cos();
    // Both ends close like a ball.
    let end = s.min(length() - s).clamp(0.0, RADIUS) / RADIUS;
    let close = (end * (2.0 - end)).sqrt();
    RADIUS * close * (1.0 - 0.28 * wave * round)
}

/// The tube with `rings` rings of `sides` vertices, normals by the formula's differences.
pub fn tube(rings: u32, sides: u32) -> Mesh {
    let point = |s: f32, phi: f32| {
        let (at, forward) = axis(s.clamp(0.0, length()));
        let side = Vec3::Y;
        let up = forward.cross(side);
        at + radius(s, phi) * (phi.cos() * side + phi.sin() * up)
    };
    let mut mesh = Mesh::default();
    // Rings from just inside one pole to just inside the other, then the poles.
    let s_of = |i: u32| length() * (i as f32 + 0.5) / rings as f32;
    for i in 0..rings {
        for k in 0..sides {
            let (s, phi) = (s_of(i), std::f32::consts::TAU * k as f32 / sides as f32);
            let (ds, dphi) = (0.02, 1e-3);
            let along = point(s + ds, phi) - point(s - ds, phi);
            let around = point(s, phi + dphi) - point(s, phi - dphi);
            mesh.positions.push(point(s, phi));
            let n = along.cross(around).normalize();
            let inwards = axis(s).0 - point(s, phi);
            mesh.normals.push(if n.dot(inwards) < 0.0 { -n } else { n });
        }
    }
    let poles = [axis(0.0), axis(length())];
    for (p, inwards) in [(poles[0].0, poles[0].1), (poles[1].0, -poles[1].1)] {
        mesh.positions.push(p);
        mesh.normals.push(inwards);
    }
    let last = rings * sides;
    for k in 0..sides {
        let l = (k + 1) % sides;
        for i in 0..rings - 1 {
            let (a, b) = (i * sides, (i + 1) * sides);
            mesh.faces.push([a + k, b + k, a + l]);
            mesh.faces.push([a + l, b + k, b + l]);
        }
        let end = (rings - 1) * sides;
        mesh.faces.push([last, k, l]);
        mesh.faces.push([last + 1, end + l, end + k]);
    }
    if mesh.volume_mm3() < 0.0 {
        mesh.faces.iter_mut().for_each(|f| f.swap(1, 2));
    }
    mesh
}
