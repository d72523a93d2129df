//! Three adaptive subdivision schemes for a base mesh: the paper's 1-to-4, and √3 (Kobbelt 2000,
//! doi:10.1145/344779.344835) and 4-8 (Velho & Zorin 2001, doi:10.1016/S0167-8396(01)00039-5),
//! which the paper leaves to the future.
//!
//! New vertices lie on the original; what a smooth scheme would predict is in [`butterfly`]. All
//! three leave no crack: 1-to-4 closes gaps by templates, √3 flips an edge only when both of its
//! triangles are split, 4-8 bisects the neighbour first. The renderer ([`super::Vds`]) uses 1-to-4:
//! only there do the triangles of a level stay within a base face, which makes the pages of a leaf
//! depend on its edges alone. √3 leaves the edges of the base at every odd step, and 4-8 starts
//! with three triangles for one.

pub mod butterfly;
mod four_eight;
mod net;
mod one_to_four;
mod sqrt3;

use crate::geometry::Mesh;
use net::RefinedNet;

use super::Original;
use super::base_mesh::BaseMesh;

/// Subdivision scheme.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// 1-to-4 split, gaps closed by templates.
    OneToFour,
    /// √3: a vertex at the centre, then edges flipped: 1 to 3. Needs a closed base; boundary edges
    /// stay as they are.
    Sqrt3,
    /// 4-8: bisection at the midpoint of one side.
    FourEight,
}

/// State of a scheme.
trait AdaptiveScheme {
    /// Splits each face that `exceeds_tolerance` selects, and those that must be split with it.
    /// Returns how many were selected.
    fn refine_once(
        &mut self,
        net: &mut RefinedNet,
        exceeds_tolerance: &dyn Fn(&RefinedNet, [u32; 3]) -> bool,
    ) -> usize;

    /// Faces to draw.
    fn faces(&self, net: &RefinedNet) -> Vec<[u32; 3]>;
}

/// Subdivides `base` by `scheme` where the original is further than `tolerance_mm` from a face,
/// measured at its centre and the midpoints of its sides, in at most `rounds` rounds. A negative
/// tolerance splits everywhere.
///
/// # Panics
/// If a face of `base` has a vertex index out of range.
pub fn refine(
    base: &Mesh,
    original: &dyn Original,
    scheme: Scheme,
    tolerance_mm: f64,
    rounds: u32,
) -> Mesh {
    let base = BaseMesh::new(base.faces.clone(), base.positions.len());
    let mut net = RefinedNet::new(&base, original);
    let mut work: Box<dyn AdaptiveScheme> = match scheme {
        Scheme::OneToFour => Box::new(one_to_four::OneToFour::new(&net)),
        Scheme::Sqrt3 => Box::new(sqrt3::Sqrt3::new(&net)),
        Scheme::FourEight => Box::new(four_eight::FourEight::new(&mut net)),
    };
    let exceeds_tolerance =
        |net: &RefinedNet, t| tolerance_mm < 0.0 || net.error_mm(t) > tolerance_mm;
    for _ in 0..rounds {
        if work.refine_once(&mut net, &exceeds_tolerance) == 0 {
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
