//! A vertex as the device draws it.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

/// Vertex of twenty bytes, the same for walls and lines.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Vertex {
    /// Position, LPS mm, as bits so that equal means equal.
    position: [u32; 3],
    /// Unit normal and `w`, as fractions of 32767.
    normal: [i16; 4],
}

impl Vertex {
    /// Creates a vertex; `normal` and `w` are clamped to -1 ..= 1.
    pub fn new(position: Vec3, normal: Vec3, w: f32) -> Self {
        let fraction = |v: f32| (v.clamp(-1.0, 1.0) * 32767.0).round() as i16;
        let n = normal.extend(w);
        Self { position: position.to_array().map(f32::to_bits), normal: n.to_array().map(fraction) }
    }

    /// Returns the position, LPS mm.
    pub fn position(&self) -> Vec3 {
        Vec3::from(self.position.map(f32::from_bits))
    }

    /// Returns the normal as stored: unit but for rounding.
    pub fn normal(&self) -> Vec3 {
        let [x, y, z, _] = self.normal.map(|v| f32::from(v) / 32767.0);
        Vec3::new(x, y, z)
    }

    /// Returns the fourth number: curvature tint of a wall, share of the path of a line.
    pub fn w(&self) -> f32 {
        f32::from(self.normal[3]) / 32767.0
    }
}
