//! Patches as they lie on the device: every vertex with its own place and its place on the edge
//! that it splits, between which the vertex shader moves it (geomorph, Hoppe 1996,
//! doi:10.1145/237170.237216).

use super::scheme::Scheme;
use super::template::{PatchPoint, PatchShape};
use crate::geometry::Vertex;
pub use crate::lod::morph::{MORPH_STEPS, PatchVertex};

/// Vertices of a patch whose points have these samples.
pub fn vertices<'a>(
    shape: &'a PatchShape,
    samples: &'a [Vertex],
) -> impl Iterator<Item = PatchVertex> + 'a {
    let one = |(p, own): (&PatchPoint, &Vertex)| {
        let [a, b] = p.parents.map(|q| samples[q as usize]);
        // Addition commutes: patches on both sides of an edge get the same bits.
        let on_edge = Vertex::new(
            (a.position() + b.position()) * 0.5,
            (a.normal() + b.normal()).normalize_or_zero(),
            (a.w() + b.w()) * 0.5,
        );
        let carrier = PatchVertex::carrier_word(p.carrier, p.born);
        PatchVertex { own: *own, on_edge, carrier }
    };
    shape.points.iter().zip(samples).map(one)
}

/// Vertices of all patches, and the index templates.
#[derive(Clone, Debug, Default)]
pub struct ResidentPatches {
    /// Vertices of each patch, one patch after the other.
    pub(super) vertices: Vec<PatchVertex>,
    pub(super) scheme: Scheme,
}

impl ResidentPatches {
    pub(super) fn shape(&self) -> &'static PatchShape {
        PatchShape::of(self.scheme)
    }

    /// Bytes of all vertices.
    pub fn vertex_bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.vertices)
    }

    /// Vertices of one patch.
    pub fn patch_vertices(&self) -> u32 {
        self.shape().points.len() as u32
    }

    /// Number of patches.
    pub fn patches(&self) -> usize {
        self.vertices.len() / self.shape().points.len()
    }

    /// Vertices of a patch, in the order of [`PatchShape::points`](super::template::PatchShape).
    pub(super) fn vertices_of(&self, patch: u32) -> &[PatchVertex] {
        let points = self.shape().points.len();
        &self.vertices[patch as usize * points..][..points]
    }

    /// All index templates.
    pub fn indices(&self) -> &[u32] {
        &self.shape().indices
    }

    /// Triangles of a patch as the device draws them: twin of `project_patch` in
    /// `shaders/draw/surface.wgsl`.
    pub fn triangles(&self, d: &DrawnPatch) -> Vec<[Vertex; 3]> {
        let own = self.vertices_of(d.patch);
        let indices = &self.shape().indices[d.first_index as usize..][..3 * d.triangles as usize];
        let at = |i: &u32| own[*i as usize].morphed(d.morph);
        indices.chunks_exact(3).map(|t| [at(&t[0]), at(&t[1]), at(&t[2])]).collect()
    }
}

/// A patch of a cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DrawnPatch {
    /// Number of the patch.
    pub patch: u32,
    /// First index of its template.
    pub first_index: u32,
    /// Number of its triangles.
    pub triangles: u32,
    /// Fineness of the patch and of its three sides, a byte each.
    pub morph: u32,
    /// Whether the camera may see it.
    pub is_seen: bool,
}
