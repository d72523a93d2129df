//! Vertices that move into place as a patch gets finer (geomorph, Hoppe 1996,
//! doi:10.1145/237170.237216).

use bytemuck::{Pod, Zeroable};

use crate::geometry::Vertex;

/// Steps of a morph from one level to the next.
pub const MORPH_STEPS: u32 = 32;

/// A vertex of a patch, as the shader reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct PatchVertex {
    /// Vertex on the wall.
    pub own: Vertex,
    /// Middle of the edge that it splits.
    pub on_edge: Vertex,
    /// From the lowest bit on: 5 bits for the bit of the patch's word at which the fineness of its
    /// carrier begins; 8 for [`MORPH_STEPS`] times the level at which it is inserted; 19 for the slot
    /// of its face, of a refined face.
    pub carrier: u32,
}

impl PatchVertex {
    /// Word of a vertex that follows a carrier, 0 the patch and 1 + e its side e, and is inserted at
    /// a level.
    pub fn carrier_word(carrier: u32, born: u32) -> u32 {
        (8 * carrier) | ((MORPH_STEPS * born) << 5)
    }

    /// The same vertex in a slot.
    pub fn in_slot(self, slot: u32) -> Self {
        Self { carrier: self.carrier | slot << 13, ..self }
    }

    /// The vertex as the device draws it: twin of `morphed` in `shaders/draw/surface.wgsl`.
    ///
    /// * `word`: fineness of the patch and of its three sides, a byte each.
    pub fn morphed(&self, word: u32) -> Vertex {
        let fine = word >> (self.carrier & 31) & 0xff;
        let born = self.carrier >> 5 & 0xff;
        let gone = (fine + MORPH_STEPS).saturating_sub(born).min(MORPH_STEPS);
        if gone == MORPH_STEPS {
            return self.own;
        }
        let a = gone as f32 / MORPH_STEPS as f32;
        let mix = |p: glam::Vec3, q: glam::Vec3| p * (1.0 - a) + q * a;
        Vertex::new(
            mix(self.on_edge.position(), self.own.position()),
            mix(self.on_edge.normal(), self.own.normal()),
            self.on_edge.w() * (1.0 - a) + self.own.w() * a,
        )
    }
}
