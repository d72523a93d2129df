//! Fineness that a camera requires of each leaf: a function of the camera alone.

use super::fineness::Fineness;
use super::surface::{Leaf, SubdivisionSurface};
use crate::geometry::ViewFrustum;

/// Distance bound of a leaf to the original at a fineness, mm. Between two levels vertices are
/// between their places at both, so the bound is interpolated.
pub fn error_mm(leaf: &Leaf, q: Fineness) -> f32 {
    if q == 0 {
        return leaf.error_mm[0];
    }
    let (l, a) = (super::fineness::level(q) as usize, super::fineness::morph(q) as f32 / 8.0);
    (1.0 - a) * leaf.error_mm[l - 1] + a * leaf.error_mm[l]
}

/// The least fineness of a leaf whose screen-space error is at most `pixels`; 0 outside the frustum
/// and where every face is backfacing.
pub fn required_fineness(leaf: &Leaf, frustum: &ViewFrustum, pixels: f64, morph: bool) -> Fineness {
    if !frustum.intersects(&leaf.sphere) || frustum.is_backfacing(&leaf.sphere, &leaf.cone) {
        return 0;
    }
    let enough = |q: &Fineness| frustum.error_px(&leaf.sphere, error_mm(leaf, *q)) <= pixels;
    let finest = 8 * (leaf.error_mm.len() - 1) as Fineness;
    let q = (0..=finest).step_by(8).find(enough).unwrap_or(finest);
    if q == 0 || !morph {
        return q;
    }
    (q - 7..q).find(enough).unwrap_or(q)
}

/// Required fineness of every leaf. Subtrees of the octree stay at the base where they are outside
/// the frustum or the base is good enough.
pub fn select(surface: &SubdivisionSurface, frustum: &ViewFrustum, pixels: f64) -> Vec<Fineness> {
    let mut all = vec![0; surface.leaves.len()];
    let tree = &surface.tree;
    let mut open = vec![0];
    while let Some(at) = open.pop() {
        let node = &tree.nodes[at];
        let mut sphere = node.sphere;
        // Spheres of its leaves exceed theirs in the tree by no more than that.
        sphere.radius += surface.node_error_mm[at];
        if node.is_leaf() {
            let leaf = surface.leaf_at[at] as usize;
            let morph = surface.options.morph;
            all[leaf] = required_fineness(&surface.leaves[leaf], frustum, pixels, morph);
        } else if frustum.intersects(&sphere)
            && frustum.error_px(&sphere, surface.node_error_mm[at]) > pixels
        {
            open.extend(tree.children(at));
        }
    }
    all
}
