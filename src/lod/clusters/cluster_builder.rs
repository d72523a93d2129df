//! Clusters while they are built, with their correspondence to the original.

use glam::DVec3;

use super::convex_polygon::ConvexPolygon;
#[cfg(test)]
use crate::geometry::Mesh;

/// Correspondence: a piece of an original face, and the triangles of a cluster that are within a
/// distance of it.
#[derive(Clone, Copy)]
pub struct Correspondence {
    /// Face of the original.
    pub face: u32,
    /// Every point of the piece is within this distance of the union of the triangles, mm.
    pub distance_mm: f32,
    /// The triangles: one bit each, at least one.
    pub triangle_mask: u64,
}

impl Correspondence {
    /// Identity: the face is the triangle itself.
    pub fn on(face: u32, triangle: u8) -> Self {
        Self { face, distance_mm: 0.0, triangle_mask: 1 << triangle }
    }

    /// The first of the triangles.
    pub fn triangle(self) -> usize {
        self.triangle_mask.trailing_zeros() as usize
    }

    /// All of the triangles.
    pub fn triangles(self) -> impl Iterator<Item = usize> {
        let rest = |bits: u64| (bits != 0).then_some(bits);
        std::iter::successors(rest(self.triangle_mask), move |b| rest(b & (b - 1)))
            .map(|b| b.trailing_zeros() as usize)
    }
}

/// A convex part of an original face.
#[derive(Clone, Copy)]
pub struct FacePart {
    /// Correspondence of the part.
    pub corr: Correspondence,
    /// Index of the part's first corner.
    first: u32,
    /// Number of corners.
    count: u8,
}

/// Parts of original faces.
#[derive(Default)]
pub struct FaceParts {
    /// The parts.
    pub list: Vec<FacePart>,
    /// Corners of all parts, mm.
    corners: Vec<DVec3>,
}

impl FaceParts {
    /// Adds a part.
    pub fn push(&mut self, corr: Correspondence, corners: &[DVec3]) {
        let (first, count) = (self.corners.len() as u32, corners.len() as u8);
        self.corners.extend_from_slice(corners);
        self.list.push(FacePart { corr, first, count });
    }

    /// Corners of a part, mm.
    pub fn corners(&self, part: &FacePart) -> &[DVec3] {
        &self.corners[part.first as usize..][..usize::from(part.count)]
    }
}

/// A cluster while it is built, with the source patch that it replaces.
pub struct ClusterBuilder {
    /// Vertex ids, ascending.
    pub vertices: Vec<u32>,
    /// Indices into `vertices`.
    pub triangles: Vec<[u8; 3]>,
    /// Whole faces of the source patch.
    pub whole_faces: Vec<Correspondence>,
    /// Faces of the source patch that are split between clusters.
    pub parts: FaceParts,
    /// One-sided distance bound of each triangle to the original, mm.
    pub to_original_mm: Vec<f32>,
    /// Two-sided distance bound to the source patch, mm.
    pub error: f64,
}

impl ClusterBuilder {
    /// Triangles by vertex ids.
    pub fn faces(&self) -> impl Iterator<Item = [u32; 3]> + '_ {
        self.triangles.iter().map(|t| t.map(|v| self.vertices[usize::from(v)]))
    }

    /// The source patch: correspondences and their corners.
    #[cfg(test)]
    pub fn source_patch(&self, original: &Mesh) -> Vec<(Correspondence, Vec<DVec3>)> {
        let corners = |f: u32| -> Vec<DVec3> {
            original.faces[f as usize].map(|v| original.positions[v as usize].as_dvec3()).to_vec()
        };
        let whole = self.whole_faces.iter().map(|corr| (*corr, corners(corr.face)));
        let part = |p: &FacePart| (p.corr, self.parts.corners(p).to_vec());
        whole.chain(self.parts.list.iter().map(part)).collect()
    }

    /// Merges the parts of a face again if the cluster has all of them.
    ///
    /// * `corners`: of a face of the original, mm.
    pub fn merge_parts(&mut self, corners: impl Fn(u32) -> [DVec3; 3]) {
        let list = std::mem::take(&mut self.parts.list);
        let mut order: Vec<u64> =
            (0..).zip(&list).map(|(i, p)| u64::from(p.corr.face) << 32 | i).collect();
        order.sort_unstable();
        let part = |o: &u64| &list[*o as u32 as usize];
        for own in order.chunk_by(|a, b| a >> 32 == b >> 32) {
            let face = part(&own[0]).corr.face;
            let area =
                || own.iter().map(|o| ConvexPolygon::new(self.parts.corners(part(o))).area());
            let whole = || ConvexPolygon::new(&corners(face)).area();
            if own.len() > 1 && area().sum::<f64>() > (1.0 - 1e-6) * whole() {
                let far = own.iter().fold(0f32, |far, o| far.max(part(o).corr.distance_mm));
                let over = own.iter().fold(0, |over, o| over | part(o).corr.triangle_mask);
                self.whole_faces.push(Correspondence {
                    face,
                    distance_mm: far,
                    triangle_mask: over,
                });
            } else {
                self.parts.list.extend(own.iter().map(part));
            }
        }
    }
}
