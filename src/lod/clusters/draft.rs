//! Clusters under work, and what of the original each stands for.

use glam::DVec3;

use super::cover::Piece;
use super::measure::Original;
#[cfg(test)]
use crate::geometry::Mesh;

/// A piece of the original, and where it lies on the cluster that stands for it.
#[derive(Clone, Copy)]
pub struct Lies {
    /// The original's face id.
    pub face: u32,
    /// No point of it is farther than this, mm,
    pub far: f32,
    /// from all of these triangles together: a bit for each, at least one.
    pub over: u64,
}

impl Lies {
    /// One that is the triangle itself.
    pub fn on(face: u32, triangle: u8) -> Self {
        Self { face, far: 0.0, over: 1 << triangle }
    }

    /// One of the triangles.
    pub fn triangle(self) -> usize {
        self.over.trailing_zeros() as usize
    }

    /// All of them.
    pub fn triangles(self) -> impl Iterator<Item = usize> {
        let rest = |bits: u64| (bits != 0).then_some(bits);
        std::iter::successors(rest(self.over), move |b| rest(b & (b - 1)))
            .map(|b| b.trailing_zeros() as usize)
    }
}

/// Part of an original face that a cluster stands for.
#[derive(Clone, Copy)]
pub struct Part {
    /// Where it lies.
    pub lies: Lies,
    /// Where its corners begin among all.
    first: u32,
    /// How many there are.
    count: u8,
}

/// Parts of original faces.
#[derive(Default)]
pub struct Parts {
    /// Each of them.
    pub list: Vec<Part>,
    /// Their corners, mm.
    corners: Vec<DVec3>,
}

impl Parts {
    /// Adds one.
    pub fn push(&mut self, lies: Lies, corners: &[DVec3]) {
        let (first, count) = (self.corners.len() as u32, corners.len() as u8);
        self.corners.extend_from_slice(corners);
        self.list.push(Part { lies, first, count });
    }

    /// The corners of one, mm.
    pub fn corners(&self, part: &Part) -> &[DVec3] {
        &self.corners[part.first as usize..][..usize::from(part.count)]
    }
}

/// A cluster under work: with what it stands for.
pub struct Draft {
    /// The original's vertices, ascending.
    pub vertices: Vec<u32>,
    /// Places in `vertices`.
    pub triangles: Vec<[u8; 3]>,
    /// Original faces that it stands for as a whole.
    pub whole: Vec<Lies>,
    /// Those that were cut.
    pub parts: Parts,
    /// For each triangle, how far any point of it is from the original at most, mm.
    pub back: Vec<f32>,
    /// At least that, and how far any point of what it stands for is from it, mm.
    pub error: f64,
}

impl Draft {
    /// Its triangles by the original's vertices.
    pub fn faces(&self) -> impl Iterator<Item = [u32; 3]> + '_ {
        self.triangles.iter().map(|t| t.map(|v| self.vertices[usize::from(v)]))
    }

    /// What it stands for, and the corners of that.
    #[cfg(test)]
    pub fn stands_for(&self, original: &Mesh) -> Vec<(Lies, Vec<DVec3>)> {
        let corners = |f: u32| -> Vec<DVec3> {
            original.faces[f as usize].map(|v| original.positions[v as usize].as_dvec3()).to_vec()
        };
        let whole = self.whole.iter().map(|lies| (*lies, corners(lies.face)));
        let part = |p: &Part| (p.lies, self.parts.corners(p).to_vec());
        whole.chain(self.parts.list.iter().map(part)).collect()
    }

    /// Puts faces together again of which all parts are here.
    pub fn unite(&mut self, original: &Original<'_>) {
        let list = std::mem::take(&mut self.parts.list);
        let mut order: Vec<u64> =
            (0..).zip(&list).map(|(i, p)| u64::from(p.lies.face) << 32 | i).collect();
        order.sort_unstable();
        let part = |o: &u64| &list[*o as u32 as usize];
        for own in order.chunk_by(|a, b| a >> 32 == b >> 32) {
            let face = part(&own[0]).lies.face;
            let area = || own.iter().map(|o| Piece::new(self.parts.corners(part(o))).area());
            let whole = || Piece::new(&original.corners(face)).area();
            if own.len() > 1 && area().sum::<f64>() > (1.0 - 1e-6) * whole() {
                let far = own.iter().fold(0f32, |far, o| far.max(part(o).lies.far));
                let over = own.iter().fold(0, |over, o| over | part(o).lies.over);
                self.whole.push(Lies { face, far, over });
            } else {
                self.parts.list.extend(own.iter().map(part));
            }
        }
    }
}
