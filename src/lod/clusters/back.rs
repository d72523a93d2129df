//! The coarse faces of a group back to the original, by way of the fine ones.
//!
//! The fine faces, which have the same rim, are laid upon the coarse ones ([`super::image`]). Every
//! point of a coarse face that they cover has a fine one no farther away than the map moves any, and
//! the original is not farther from that than what is known of the fine face. Coarse faces that are
//! not known to be covered are cut up along the fine ones instead, and so are those where the sum of
//! distances is too much.

use glam::DVec3;

use super::build::up;
use super::cover::{Piece, Target};
use super::draft::Draft;
use super::group::Places;
use super::image::Image;
use super::measure::Measure;
use super::partition::{self, NONE};

/// The fine faces of a group, as the way from the coarse ones back to the original.
pub struct Fine<'a> {
    /// The faces, with the vertex ids of the coarse ones; the tree is not asked.
    pub target: Target<'a>,
    /// For each, how far any point of it is from the original at most, mm.
    pub known: Vec<f32>,
    /// One of the faces at each vertex.
    pub face_at: Vec<u32>,
    /// Its vertices among all.
    pub ids: &'a [u32],
    /// All vertices.
    pub places: &'a Places,
    /// The surface to ask before the original.
    pub earlier: Option<&'a Earlier>,
    /// A coarse face near each vertex.
    pub coarse_at: Vec<u32>,
}

/// A surface between the original and the fine one: three levels below the coarse one, or the first.
pub struct Earlier {
    /// Its faces, by ids of all vertices.
    pub faces: Vec<[u32; 3]>,
    /// Face across each edge.
    pub beside: Vec<[u32; 3]>,
    /// For each, how far any point of it is from the original at most, mm.
    pub known: Vec<f32>,
    /// A face at each vertex that it has.
    pub face_at: Vec<u32>,
}

impl Fine<'_> {
    /// Where a vertex is.
    pub fn at(&self, v: u32) -> DVec3 {
        self.target.positions[v as usize].as_dvec3()
    }
}

impl Earlier {
    /// The surface of live clusters; `vertices`: how many there are of all levels.
    pub fn new<'a>(live: impl Iterator<Item = &'a Draft> + Clone, vertices: usize) -> Self {
        let faces: Vec<[u32; 3]> = live.clone().flat_map(Draft::faces).collect();
        let mut face_at = vec![NONE; vertices];
        for (f, i) in faces.iter().zip(0..) {
            f.iter().for_each(|v| face_at[*v as usize] = i);
        }
        let beside = partition::beside(&faces, vertices);
        Self { beside, known: live.flat_map(|d| d.back.iter().copied()).collect(), faces, face_at }
    }
}

impl Measure<'_> {
    /// The coarse faces against the original: the largest distance, and that of each face. `image`:
    /// of the fine faces.
    pub fn back(&self, bound: f64, fine: &Fine<'_>, image: &Image) -> (f64, Vec<f32>) {
        let far = by_image(image, &fine.known, bound);
        let mut bound = bound;
        let far = (0..).zip(far).map(|(t, far)| match far {
            Some(far) => up(far),
            None => up(self.cut_back(t, fine, &mut bound)),
        });
        let far = far.collect();
        (bound, far)
    }

    /// A coarse face is cut up along the fine ones, whose known distances add to that to those;
    /// where the sum is too much, the original itself is asked.
    fn cut_back(&self, face: u32, fine: &Fine<'_>, bound: &mut f64) -> f64 {
        let piece = Piece::new(&self.target.corners(face));
        let mut far: f64 = 0.0;
        let from = fine.face_at[self.target.faces[face as usize][0] as usize];
        fine.target.part(&piece, from, &mut |t, part, away| {
            let sum = away + f64::from(fine.known[t as usize]);
            if sum <= *bound {
                far = far.max(sum);
                return;
            }
            let vertex = fine.ids[fine.target.faces[t as usize][0] as usize];
            self.asked(part, vertex, fine, bound, &mut far);
        });
        far
    }

    /// A part of a coarse face near a fine vertex against the original, and first against the
    /// earlier surface: raises `far`, and `bound` where need be.
    fn asked(&self, part: &Piece, vertex: u32, fine: &Fine<'_>, bound: &mut f64, far: &mut f64) {
        let places = fine.places;
        let original = |part: &Piece, vertex: u32, bound: &mut f64, far: &mut f64| {
            let start = places.face_at[vertex as usize];
            self.original.target.cover(part, start, bound, |_, _, d| *far = far.max(d));
        };
        let Some(earlier) = fine.earlier else {
            return original(part, vertex, bound, far);
        };
        // What moved since was somewhere then.
        let at = |v: u32| earlier.face_at.get(v as usize).copied().unwrap_or(NONE);
        let mut then = vertex;
        while at(then) == NONE {
            match places.before[then as usize] {
                NONE => return original(part, vertex, bound, far),
                before => then = before,
            }
        }
        let target = Target {
            positions: &places.positions,
            normals: &places.normals,
            faces: &earlier.faces,
            beside: &earlier.beside,
            ..self.original.target
        };
        target.part(part, at(then), &mut |t, part, away| {
            let sum = away + f64::from(earlier.known[t as usize]);
            if sum <= *bound {
                *far = far.max(sum);
            } else {
                original(part, earlier.faces[t as usize][0], bound, far);
            }
        });
    }
}

/// For each coarse face, how far any point of it is from the original at most by way of the fine
/// faces that cover it; `None` if they do not or if that is more than `bound`. `known`: the same of
/// the fine faces.
pub fn by_image(image: &Image, known: &[f32], bound: f64) -> Vec<Option<f64>> {
    let mut far: Vec<f64> =
        image.covered.iter().map(|c| if *c { 0.0 } else { f64::INFINITY }).collect();
    for (range, known) in image.laid.iter().zip(known) {
        for (t, away) in &image.over[range.clone()] {
            let sum = away + f64::from(*known);
            far[*t as usize] = far[*t as usize].max(sum);
        }
    }
    far.into_iter().map(|f| (f.is_finite() && f <= bound).then_some(f)).collect()
}
