//! Three ways to split a base mesh until it follows the original: the paper's 1-to-4, and √3
//! (Kobbelt 2000, doi:10.1145/344779.344835) and 4-8 (Velho & Zorin 2001,
//! doi:10.1016/S0167-8396(01)00039-5), which the paper leaves to the future.
//!
//! New vertices lie on the original; what a smooth scheme would have predicted is in
//! [`butterfly`]. All three are adaptive and leave no crack: 1-to-4 closes gaps by templates, √3
//! by turning an edge only when both of its triangles were split, 4-8 by splitting the neighbour
//! first. The rendering ([`super::Vds`]) uses the first: only there do the triangles of a level
//! stay within a base face, which is what makes a leaf's pages independent of all but its edges.
//! √3 leaves the base's edges at every odd step, and 4-8 begins with three triangles for one.

pub mod butterfly;
mod eight;
mod net;
mod quad;
mod root;

use crate::geometry::Mesh;
use net::Net;

use super::Original;
use super::base::Base;

/// How triangles are split.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// One to four, gaps closed by templates.
    Quad,
    /// A vertex in the middle, then edges turned: one to three. Needs a closed base; along a
    /// boundary edges stay as they are.
    Root,
    /// Halving at the middle of one side.
    Eight,
}

/// The faces of a scheme at work.
trait Work {
    /// Splits each face that `too_far` names, and what has to be split with it. Returns how many
    /// were named.
    fn round(&mut self, net: &mut Net, too_far: &dyn Fn(&Net, [u32; 3]) -> bool) -> usize;

    /// Faces as they are to be drawn.
    fn faces(&self, net: &Net) -> Vec<[u32; 3]>;
}

/// Splits `base` by `scheme` where the original is further than `tolerance_mm` from a face, judged
/// at its centre and the middles of its sides, in at most `rounds` rounds. A tolerance below zero
/// splits everywhere.
///
/// # Panics
/// If a face of `base` names a vertex that is not there.
pub fn refine(
    base: &Mesh,
    original: &dyn Original,
    scheme: Scheme,
    tolerance_mm: f64,
    rounds: u32,
) -> Mesh {
    let base = Base::new(base.faces.clone(), base.positions.len());
    let mut net = Net::new(&base, original);
    let mut work: Box<dyn Work> = match scheme {
        Scheme::Quad => Box::new(quad::Quad::new(&net)),
        Scheme::Root => Box::new(root::Root::new(&net)),
        Scheme::Eight => Box::new(eight::Eight::new(&mut net)),
    };
    let too_far = |net: &Net, t| tolerance_mm < 0.0 || net.error_mm(t) > tolerance_mm;
    for _ in 0..rounds {
        if work.round(&mut net, &too_far) == 0 {
            break;
        }
    }
    let faces = work.faces(&net);
    Mesh {
        positions: net.vertices.iter().map(|v| v.position()).collect(),
        normals: net.vertices.iter().map(|v| v.normal()).collect(),
        faces,
        caps: Vec::new(),
    }
}

#[cfg(test)]
mod tests;
